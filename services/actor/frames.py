"""Whether the segments of a run fit into frames, before a long phase finds out (pure)."""

from collections.abc import Iterator

from protocol.keys import MAX_FRAME_BYTES
from services.actor.config import Body
from services.runtime.settings import RunSettings, SettingsError

ROOM_BYTES = MAX_FRAME_BYTES - (64 << 10)
"""What the arrays of a frame may take, with more than enough left for its header."""
Size = tuple[str, int, int, str]
"""The phases of a segment, its steps or legs, the bytes of one of them in one world, and what to lower."""


def check_frames(settings: RunSettings, body: Body) -> None:
    """Raise `SettingsError` if a segment of some phase would be larger than a frame may be.

    That for the recorder is of all blocks.
    """
    columns = settings.actors.envs_per_actor
    for block in body.layouts:
        for phases, rows, row_bytes, lower in _sizes(settings.of_block(block), body, block):
            _check(f"a segment of {phases} of block {block}", columns, rows, row_bytes, lower)
    if settings.recording.every_steps:
        rows, lower = settings.actors.segment_steps, "actors.envs_per_actor or actors.segment_steps"
        _check("a segment for the recorder", columns, rows, _row_bytes(body), lower)


def _check(what: str, columns: int, rows: int, row_bytes: int, lower: str) -> None:
    if rows * columns * row_bytes > ROOM_BYTES:
        raise SettingsError(
            f"{what} would have {rows * columns * row_bytes / 1e6:,.1f} MB ({rows:,} x {columns:,} worlds x "
            f"{row_bytes:,} bytes), and a frame holds {ROOM_BYTES / 1e6:.1f} MB; lower {lower}"
        )


def _row_bytes(body: Body) -> int:
    """Of a recorder's row, at most: all blocks act on a latent, and there is a task."""
    latents = sum(2 * spec.latent_dim for spec in body.tree.specs.values())
    return 4 * (len(body.world.state_names) + latents + 2)


def _sizes(settings: RunSettings, body: Body, block: str) -> Iterator[Size]:
    steps, legs = settings.actors.segment_steps, settings.evaluation.legs
    latent_dim, action_size = body.tree.specs[block].latent_dim, body.tree.action_size_of(block)
    lower = "actors.envs_per_actor or actors.segment_steps"
    walked_bytes = body.layouts[block].packed_bytes + 4
    yield "babble or walk", steps, walked_bytes, f"{lower}, or the resolution of the senses"
    acted_bytes = 4 * (3 * latent_dim + action_size + 1) + 2
    acted_bytes += 4 if settings.goals.external_weight else 0
    yield "ground or practise", steps, acted_bytes, lower
    evaluated_bytes = 4 * (2 * body.world.posture_size + latent_dim + 2)
    yield "evaluate", legs, evaluated_bytes, "actors.envs_per_actor or evaluation.legs"
