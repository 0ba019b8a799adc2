"""What a block learns with: its level's settings and its own; budgets and scores in environment steps."""

from typing import Any

import numpy as np
import pytest

from babble.bodies import make_body
from babble.parts import part_of_block
from protocol.messages import ModelFloor, Phase, PhaseAnnounced, Segment
from services.encoder_learner import config as encoder_config
from services.encoder_learner.work import EncoderWork
from services.policy_learner import config as policy_config
from services.policy_learner.config import PolicyWorkConfig
from services.policy_learner.work import PolicyWork
from services.runtime.clock import HandClock
from services.runtime.settings import RunSettings, SettingsError, parse
from tests.unit.trees import tree_on

ROWS, COLUMNS = 4, 2
TABLE: dict[str, Any] = {
    "scenario": "tree",
    "block": [
        {"name": "x", "observes": [0], "drives": [0], "policy": {"epochs": 9}},
        {"name": "yz", "observes": [1, 2], "drives": [1, 2], "latent_dim": 3},
        {"name": "body", "children": ["x", "yz"], "encoder": {"batch": 8}},
    ],
    "level": [
        {},
        {
            "decision_steps": 5,
            "segment_steps": ROWS,
            "phases": {"babble_steps": 20, "walk_steps": 24, "ground_steps": 160, "practise_steps": 90},
            "encoder": {"encode": {"window_steps": 3}},
            "policy": {"rollout_columns": COLUMNS, "epochs": 2, "minibatch": 4},
            "goals": {"reward": "dense"},
            "evaluation": {"columns": COLUMNS, "legs": 3, "leg_steps": 50},
        },
    ],
    "actors": {"envs_per_actor": 2, "segment_steps": 16},
    "phases": {"babble_steps": 64},
}


def settings_of(**changes: Any) -> RunSettings:
    return parse(TABLE | changes, origin="test")


def policy_config_of(block: str) -> PolicyWorkConfig:
    settings = settings_of()
    world, tree = make_body("Cuboid", {}, settings.block, columns=1, seed=0)
    return policy_config.work_config(
        settings, tree, block, 0, run="r", posture_size=world.posture_size,
        part=part_of_block(world, tree, block),
    )  # fmt: skip


def encoder_config_of(block: str) -> encoder_config.EncoderWorkConfig:
    settings = settings_of()
    world, tree = make_body("Cuboid", {}, settings.block, columns=1, seed=0)
    return encoder_config.work_config(settings, tree, world.senses, block, 0)


def announce(phase: Phase, block: str = "body") -> PhaseAnnounced:
    return PhaseAnnounced(
        run="r", term=1, block="all", life="c", seq=0, phase=phase, level=1,
        evaluates=Phase.GROUND if phase is Phase.EVALUATE else None, blocks={block: ModelFloor(encoder=1)},
    )  # fmt: skip


def segment(phase: Phase, steps: int, arrays: dict[str, Any], **header: Any) -> Segment:
    return Segment(
        run="r", term=1, block="body", life="actor-1", seq=0, consumer="any", fingerprint="0" * 16,
        phase=phase, encoder_version=1, policy_version=1, steps=steps, columns=COLUMNS, first_step=0,
        arrays=arrays, **header,
    )  # fmt: skip


def test_each_block_has_the_settings_of_its_level_and_its_own() -> None:
    x, yz, body = (policy_config_of(name) for name in ("x", "yz", "body"))
    assert [config.policy.epochs for config in (x, yz, body)] == [9, 6, 2]
    assert [config.goals.reward for config in (x, body)] == ["squared", "dense"]
    assert [config.segment_steps for config in (x, body)] == [16, ROWS]
    assert [config.action_size for config in (x, yz, body)] == [1, 2, 5]
    low, high = encoder_config_of("yz"), encoder_config_of("body")
    assert (low.encoder.batch, high.encoder.batch) == (128, 8)
    assert (low.encoder.encode.window_steps, high.encoder.encode.window_steps) == (30, 3)
    assert (low.senses, high.senses) == ({"position": (2,)}, {"latent": (5,)})


def test_each_block_is_scored_by_what_it_moves() -> None:
    x, yz, body = (policy_config_of(name).part for name in ("x", "yz", "body"))
    assert [part.components.tolist() for part in (x, yz, body)] == [[0], [1, 2], [0, 1, 2]]
    assert x.diameter < body.diameter


def test_an_encoder_above_collects_in_rows_of_the_level_below_and_says_environment_steps() -> None:
    work = EncoderWork(encoder_config_of("body"), HandClock())
    work.begin(announce(Phase.BABBLE))
    assert work.wanted_columns() == 5, "20 environment steps, one a row, in columns of 4 rows"
    latents = np.random.default_rng(0).dirichlet([1] * 5, (ROWS, COLUMNS)).astype(np.float32)
    episodes = np.zeros((ROWS, COLUMNS), np.int32)
    assert work.take(segment(Phase.BABBLE, ROWS, {"observation": latents, "episode": episodes}))
    progress = work.progress()
    assert progress is not None
    assert (progress.done, progress.wanted, progress.unit) == (8, 20, "steps")


def test_on_the_third_level_a_row_is_a_decision_of_the_second() -> None:
    blocks = [
        {"name": "x", "observes": [0], "drives": [0]},
        {"name": "yz", "observes": [1, 2], "drives": [1, 2]},
        {"name": "pair", "children": ["x", "yz"]},
        {"name": "top", "children": ["pair"]},
    ]
    levels = [{}, {"decision_steps": 5}, {"decision_steps": 50, "phases": {"walk_steps": 1000}}]
    settings = settings_of(block=blocks, level=levels)
    world, tree = make_body("Cuboid", {}, settings.block, columns=1, seed=0)
    work = EncoderWork(encoder_config.work_config(settings, tree, world.senses, "top", 3), HandClock())
    work.begin(announce(Phase.WALK, "top"))
    assert work.wanted_columns() == 13, "1,000 environment steps are 200 rows, 12.5 columns of 16"
    latents = np.full((16, COLUMNS, 2), 0.5, np.float32)
    arrays = {"observation": latents, "episode": np.zeros((16, COLUMNS), np.int32)}
    assert work.take(segment(Phase.WALK, 16, arrays))
    progress = work.progress()
    assert progress is not None
    assert (progress.done, progress.wanted) == (160, 1000)


def test_a_policy_above_updates_by_decisions_and_says_environment_steps() -> None:
    config = policy_config_of("body")
    assert config.rollout_steps(Phase.GROUND) == ROWS * COLUMNS * 5
    assert (config.updates(Phase.GROUND), config.updates(Phase.PRACTISE)) == (4, 3)
    work, rng = PolicyWork(config), np.random.default_rng(1)
    work.begin(announce(Phase.GROUND))
    z = rng.dirichlet([1, 1], (ROWS, COLUMNS)).astype(np.float32)
    arrays = {
        "latent": z, "next_latent": z, "goal": np.eye(2, dtype=np.float32)[np.zeros((ROWS, COLUMNS), int)],
        "action": rng.normal(size=(ROWS, COLUMNS, 5)).astype(np.float32),
        "log_prob": np.zeros((ROWS, COLUMNS), np.float32),
        "truncated": np.zeros((ROWS, COLUMNS), np.uint8), "terminated": np.zeros((ROWS, COLUMNS), np.uint8),
    }  # fmt: skip
    assert work.take(segment(Phase.GROUND, ROWS, arrays, policy="sampled"))
    assert work.advance()
    progress = work.progress()
    assert progress is not None
    assert (progress.done, progress.wanted, progress.unit) == (40, 160, "steps")


def test_scores_count_environment_steps_and_legs_carry_the_whole_posture() -> None:
    work, goal = PolicyWork(policy_config_of("body")), np.array([[0, 1], [1, 0], [0, 1]], np.int32)
    work.begin(announce(Phase.EVALUATE))
    version = {"policy_version": 0, "encoder_version": 0}
    arrays = {
        "posture": np.repeat(goal[:, :, None] - 0.5, 3, axis=2).astype(np.float32),
        "latent": np.eye(2, dtype=np.float32)[goal],
        "goal": goal,
    }
    legs = segment(Phase.EVALUATE, 150, arrays, policy="mean").model_copy(update=version)
    assert work.take(legs)
    (score,) = work.scores()
    assert score.steps == 3 * COLUMNS * 50
    assert score.z_min == 1.0


@pytest.mark.parametrize(("blocks", "refused"), [(3, False), (6, True)])
def test_memory_is_asked_for_the_blocks_of_a_level_together_and_not_for_all_levels(
    blocks: int, refused: bool
) -> None:
    tree = [{"name": f"b{i}", "observes": [0], "drives": [i]} for i in range(blocks)]
    tree.append({"name": "top", "children": [block["name"] for block in tree]})
    settings = settings_of(block=tree, level=[], phases={"babble_steps": 100_000_000})
    built = tree_on(settings, 1, blocks)
    configs = [
        encoder_config.work_config(settings, built, {"position": (1,)}, block.name, index)
        for index, block in enumerate(settings.block)
    ]
    if refused:
        with pytest.raises(SettingsError, match=r"9\.6 GB .* limit of 8 GB"):
            encoder_config.check_memory(configs)
    else:
        encoder_config.check_memory(configs)
