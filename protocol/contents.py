"""Which arrays each message carries: one table, which decides what is let out and what is let in.

Sizes are letters: T and E are the header's steps and columns; any other letter may be any size, but
the same one throughout a message.
"""

from dataclasses import dataclass
from re import fullmatch

from protocol.messages import ALL_BLOCKS, NAME_PATTERN, RECORDER, Phase, Segment, View, WithArrays
from protocol.refusal import Reason, Refused, shown


@dataclass(frozen=True)
class ArrayRule:
    """The type and shape that an array must have."""

    dtype: str
    shape: tuple[str | int, ...]
    """Letters and numbers; a last "..." stands for any further dimensions."""
    required: bool = True
    """False for an array that a message may lack."""

    @property
    def text(self) -> str:
        """The shape as people write it, such as "(T, E, d)"."""
        sizes = ", ".join(str(size) for size in self.shape)
        return f"({sizes},)" if len(self.shape) == 1 else f"({sizes})"


Rules = dict[str, ArrayRule]

_WALKED: Rules = {
    "observation": ArrayRule("<f4", ("T", "E", "..."), required=False),
    "image": ArrayRule("|u1", ("T", "E", "..."), required=False),
    "episode": ArrayRule("<i4", ("T", "E")),
}
_SENSED = ("observation", "image")
"""What was sensed while walking: vectors, images or both, but not neither."""
_ACTED: Rules = {
    "latent": ArrayRule("<f4", ("T", "E", "d")),
    "next_latent": ArrayRule("<f4", ("T", "E", "d")),
    "goal": ArrayRule("<f4", ("T", "E", "d")),
    "action": ArrayRule("<f4", ("T", "E", "a")),
    "log_prob": ArrayRule("<f4", ("T", "E")),
    "truncated": ArrayRule("|u1", ("T", "E")),
    "terminated": ArrayRule("|u1", ("T", "E")),
    "external_reward": ArrayRule("<f4", ("T", "E"), required=False),
}
_EVALUATED: Rules = {
    "start_posture": ArrayRule("<f4", ("E", "p"), required=False),
    "posture": ArrayRule("<f4", ("L", "E", "p")),
    "latent": ArrayRule("<f4", ("L", "E", "d")),
    "goal": ArrayRule("<i4", ("L", "E")),
    "external_reward": ArrayRule("<f4", ("L", "E"), required=False),
    "side": ArrayRule("<f4", ("L", "E"), required=False),
}
SEGMENT_ARRAYS: dict[str, Rules] = {
    Phase.BABBLE: _WALKED,
    Phase.WALK: _WALKED,
    Phase.GROUND: _ACTED,
    Phase.PRACTISE: _ACTED,
    Phase.EVALUATE: _EVALUATED,
}
"""By phase; in any other phase nobody sends experience."""
RECORDED_ARRAYS: Rules = {
    "state": ArrayRule("<f4", ("T", "E", "s")),
    "episode": ArrayRule("<i4", ("T", "E")),
    "external_reward": ArrayRule("<f4", ("T", "E"), required=False),
}
"""Of a segment for the recorder, in each of these phases."""
RECORDED_OF_BLOCK = ("latent", "goal")
"""And "<one of these>/<block>" (T, E, d) for each block that acts on a latent; d is the block's own."""
MODEL_ARRAYS: Rules = {"onnx": ArrayRule("|u1", ("n",))}
VIEW_ARRAYS: dict[str, Rules] = {
    "latent": {
        "latent": ArrayRule("<f4", ("E", "d")),
        "goal": ArrayRule("<f4", ("E", "d"), required=False),
        "posture": ArrayRule("<f4", ("E", "p"), required=False),
        "trail": ArrayRule("<f4", ("K", "d"), required=False),
        "path": ArrayRule("<f4", ("K", "p"), required=False),
    },
    "posture": {
        "posture": ArrayRule("<f4", ("E", "p")),
        "path": ArrayRule("<f4", ("K", "p"), required=False),
    },
    "pose": {
        "position": ArrayRule("<f4", ("B", 3)),
        "quaternion": ArrayRule("<f4", ("B", 4)),
        "touch": ArrayRule("<f4", ("N",), required=False),
    },
    "image": {"pixels": ArrayRule("|u1", ("H", "W", 3))},
}
"""By `View.view`."""


def check_arrays(message: WithArrays) -> None:
    """Check that the message carries the arrays that the tables say.

    Raises `Refused`: bad-array, or bad-header for a segment of a phase without experience.
    """
    rules, sizes = _rules(message)
    arrays = message.arrays
    for name, array in arrays.items():
        rule = rules.get(name)
        if rule is None:
            known = sorted(rules)
            raise Refused(Reason.BAD_ARRAY, f"{_place(message)} may have {known}, but not {shown(name)}")
        if array.dtype.str != rule.dtype or not _fits(rule.shape, array.shape, sizes):
            bound = ", ".join(f"{letter}={size}" for letter, size in sizes.items() if letter in rule.shape)
            raise Refused(
                Reason.BAD_ARRAY,
                f"{_place(message)}: array {name!r} must be {rule.dtype} of shape {rule.text}"
                f"{f' with {bound}' if bound else ''}, but it is {array.dtype.str} of shape {array.shape}",
            )
    if len(arrays) < len(rules):
        missing = sorted(name for name, rule in rules.items() if rule.required and name not in arrays)
        if missing:
            raise Refused(Reason.BAD_ARRAY, f"{_place(message)} has {sorted(arrays)}, but lacks {missing}")
    if rules is _WALKED and not any(name in arrays for name in _SENSED):
        sensed = " nor ".join(_SENSED)
        raise Refused(Reason.BAD_ARRAY, f"{_place(message)} has {sorted(arrays)}, but neither {sensed}")


def _rules(message: WithArrays) -> tuple[Rules, dict[str, int]]:
    if isinstance(message, Segment):
        rules = SEGMENT_ARRAYS.get(message.phase)
        if rules is None:
            raise Refused(
                Reason.BAD_HEADER, f"segment header: phase: nobody sends experience in {message.phase}"
            )
        if message.consumer == RECORDER:
            rules = _recorded(message)
        return rules, {"T": message.steps, "E": message.columns}
    if isinstance(message, View):
        return VIEW_ARRAYS[message.view], {}
    return MODEL_ARRAYS, {}


def _recorded(segment: Segment) -> Rules:
    """The rules of a segment for the recorder, with those of the blocks that it names."""
    if segment.block != ALL_BLOCKS:
        raise Refused(
            Reason.BAD_HEADER,
            f"segment header: block: the {RECORDER} is sent {ALL_BLOCKS!r}, not {shown(segment.block)}",
        )
    rules = dict(RECORDED_ARRAYS)
    for name in segment.arrays:
        what, _, block = name.partition("/")
        if what in RECORDED_OF_BLOCK and fullmatch(NAME_PATTERN, block):
            shape = ("T", "E", f"d of {block}")
            rules |= {f"{each}/{block}": ArrayRule("<f4", shape) for each in RECORDED_OF_BLOCK}
    return rules


def _place(message: WithArrays) -> str:
    match message:
        case Segment(consumer=consumer) if consumer == RECORDER:
            return f"a recorder's segment of {message.phase}"
        case Segment():
            return f"a segment of {message.phase}"
        case View():
            return f"a {message.view} view"
        case _:
            return f"a {message.kind}"


def _fits(rule: tuple[str | int, ...], shape: tuple[int, ...], sizes: dict[str, int]) -> bool:
    if rule[-1] == "...":
        rule = rule[:-1]
        shape = shape[: len(rule)]
    if len(rule) != len(shape):
        return False
    for wanted, size in zip(rule, shape, strict=True):
        if size != (sizes.setdefault(wanted, size) if isinstance(wanted, str) else wanted):
            return False
    return True
