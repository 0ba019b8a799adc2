"""Hypothesis strategies for every message."""

import string
from typing import Any

import numpy as np
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from protocol.contents import (
    MODEL_ARRAYS,
    RECORDED_ARRAYS,
    RECORDED_OF_BLOCK,
    SEGMENT_ARRAYS,
    VIEW_ARRAYS,
    ArrayRule,
    Rules,
)
from protocol.messages import (
    ALL_BLOCKS,
    RECORDER,
    Ack,
    Command,
    Frozen,
    Message,
    Model,
    ModelFloor,
    Phase,
    PhaseAnnounced,
    Progress,
    Reply,
    Score,
    Segment,
    SettingsAnnounced,
    Status,
    View,
)

names = st.from_regex(r"[a-z0-9][a-z0-9_-]{0,63}", fullmatch=True)
counts = st.integers(0, 2**53)
labels = st.text(max_size=20)
texts = st.text(max_size=100)
fingerprints = st.text("0123456789abcdef", min_size=16, max_size=16)
digests = st.text("0123456789abcdef", min_size=64, max_size=64)
finite = st.floats(allow_nan=False, allow_infinity=False)
phases = st.sampled_from(Phase)
policies = st.sampled_from(["random", "sampled", "mean"])
header = {"run": names, "term": counts, "block": names, "life": names, "seq": counts}


@st.composite
def arrays_for(draw: st.DrawFn, rules: Rules, sizes: dict[str, int]) -> dict[str, np.ndarray]:
    """Arrays that fit the rules, optional ones now and then; letters get small sizes."""
    made, sizes = {}, dict(sizes)
    for name, rule in rules.items():
        if rule.required or draw(st.booleans()):
            shape = []
            for letter in rule.shape:
                if letter == "...":
                    shape += draw(st.lists(st.integers(1, 3), max_size=2))
                elif isinstance(letter, int):
                    shape.append(letter)
                else:
                    shape.append(sizes.setdefault(letter, draw(st.integers(1, 4))))
            made[name] = draw(hnp.arrays(np.dtype(rule.dtype), tuple(shape)))
    return made


@st.composite
def recorded_rules(draw: st.DrawFn) -> Rules:
    """What the recorder is sent, of some blocks."""
    blocks = draw(st.lists(names, max_size=3, unique=True))
    return RECORDED_ARRAYS | {
        f"{what}/{block}": ArrayRule("<f4", ("T", "E", f"d of {block}"))
        for block in blocks
        for what in RECORDED_OF_BLOCK
    }


@st.composite
def segments(draw: st.DrawFn, **fixed: Any) -> Segment:
    """Segments of every phase that has any, for learners and for the recorder."""
    fields = {
        **header,
        "consumer": names | st.just(RECORDER),
        "fingerprint": fingerprints,
        "phase": st.sampled_from(sorted(SEGMENT_ARRAYS)).map(Phase),
        "level": counts,
        "iteration": counts,
        "encoder_version": counts,
        "policy_version": counts,
        "policy": policies,
        "steps": st.integers(1, 4),
        "columns": st.integers(1, 4),
        "first_step": counts,
    }
    drawn = {name: fixed[name] if name in fixed else draw(field) for name, field in fields.items()}
    sizes = {"T": drawn["steps"], "E": drawn["columns"]}
    if drawn["consumer"] == RECORDER:
        rules = draw(recorded_rules())
        return Segment(**drawn | {"block": ALL_BLOCKS}, arrays=draw(arrays_for(rules, sizes)))
    arrays = arrays_for(SEGMENT_ARRAYS[drawn["phase"]], sizes)
    if drawn["phase"] in (Phase.BABBLE, Phase.WALK):
        arrays = arrays.filter(lambda made: {"observation", "image"} & made.keys())
    return Segment(**drawn, arrays=draw(arrays))


acks = st.builds(
    Ack,
    **header,
    to=names,
    consumer=names,
    upto=counts,
    granted=counts,
    policy_floor=counts,
    want=policies,
    progress=st.floats(0, 1),
)
models = st.builds(
    Model,
    **header,
    model=st.sampled_from(["encoder", "policy"]),
    version=st.integers(1, 2**53),
    encoder_version=counts,
    fingerprint=fingerprints,
    digest=digests,
    arrays=arrays_for(MODEL_ARRAYS, {}),
)
floors = st.builds(ModelFloor, encoder=counts, policy=counts)
frozen = st.builds(Frozen, encoder=counts, policy=counts, of_encoder=counts, of_policy=counts)
announcements = st.builds(
    PhaseAnnounced,
    **header,
    phase=phases,
    level=counts,
    iteration=counts,
    iterations=counts,
    evaluates=st.none() | phases,
    blocks=st.dictionaries(names, floors, max_size=3),
    frozen=st.dictionaries(names, frozen, max_size=3),
)
settings = st.builds(
    SettingsAnnounced, **header, config=st.text(string.printable[:95], max_size=100), began_ms=counts
)
progresses = st.builds(
    Progress,
    block=names,
    done=counts,
    wanted=counts,
    unit=st.sampled_from(["steps", "updates", "columns"]),
    finished=st.booleans(),
)
scores = st.builds(
    Score,
    run=names,
    block=names,
    iteration=counts,
    phase=phases,
    separation=finite,
    separation_worst=finite,
    z_min=finite,
    z_goal=finite,
    switch_success=finite,
    crossing=st.none() | finite,
    landmarks=st.dictionaries(labels, finite, max_size=3),
    landmark_vertices=st.dictionaries(labels, counts, max_size=3),
    external_reward=st.none() | finite,
    external_reward_by_vertex=st.none() | st.lists(st.none() | finite, max_size=3),
    policy=st.sampled_from(["mean", "sampled"]),
    steps=counts,
    encoder_version=counts,
    policy_version=counts,
)
totals = st.dictionaries(labels, counts, max_size=3)
statuses = st.builds(
    Status,
    **header,
    service=names,
    phase=st.none() | phases,
    versions=totals,
    totals=totals,
    progress=st.lists(progresses, max_size=2),
    scores=st.lists(scores, max_size=2),
    metrics=st.dictionaries(labels, st.floats(), max_size=3),
    queue_depth=counts,
    lost=counts,
    duplicated=counts,
    refused=totals,
    waiting_for=texts,
    last_error=texts,
)


@st.composite
def views(draw: st.DrawFn) -> View:
    """Views of every sort."""
    what = draw(st.sampled_from(sorted(VIEW_ARRAYS)))
    fields = {name: draw(field) for name, field in header.items()}
    arrays = draw(arrays_for(VIEW_ARRAYS[what], {}))
    return View(**fields, view=what, env_step=draw(counts), title=draw(texts), arrays=arrays)


commands = st.builds(Command, **header, id=names, name=st.sampled_from(["stop", "describe"]))
replies = st.builds(Reply, **header, id=names, ok=st.booleans(), text=texts)

messages: dict[str, st.SearchStrategy[Message]] = {
    "segment": segments(),
    "ack": acks,
    "model": models,
    "phase": announcements,
    "settings": settings,
    "status": statuses,
    "view": views(),
    "command": commands,
    "reply": replies,
}
