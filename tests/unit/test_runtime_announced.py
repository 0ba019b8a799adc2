"""An actor that has only the run's name: what it is told, what it says if it is not, when it begins anew."""

import json
import re
from pathlib import Path

import pytest

from protocol import keys
from protocol.codec import encode
from protocol.messages import SettingsAnnounced
from services.runtime.announced import AnnouncedSettings, UnknownRunError
from services.runtime.bus import Wakeup
from services.runtime.clock import HandClock
from services.runtime.memory_bus import MemoryBus
from services.runtime.settings import RunSettings, SettingsError, announced_text, load, parse, parse_announced

ROOT = Path(__file__).resolve().parents[2]
SCENARIOS = [
    path
    for path in sorted((ROOT / "scenarios").rglob("*.toml"))
    if "[[condition]]" not in path.read_text(encoding="utf-8")
]
"""Without the studies, which lie beside them."""
WHERE = "tls/robots.lab:7447"
SETTINGS = parse({"scenario": "cuboid", "actors": {"count": 3}}, origin="test")


class Turning(Wakeup):
    """A wakeup whose sleep turns the clock."""

    def __init__(self, clock: HandClock) -> None:
        super().__init__()
        self._clock = clock

    def wait(self, timeout_secs: float) -> bool:
        self._clock.advance(timeout_secs)
        return False


class Stage:
    """A bus on which the test plays coordinators."""

    def __init__(self) -> None:
        self.hub = MemoryBus()
        self.clock = HandClock(50.0)

    def announce(
        self,
        life: str,
        settings: RunSettings = SETTINGS,
        run: str = "cuboid",
        began_ms: int = 1,
        **fields: object,
    ) -> None:
        said = {"config": announced_text(settings), **fields}
        message = SettingsAnnounced(
            run=run,
            term=1,
            block="all",
            life=life,
            seq=0,
            began_ms=began_ms,
            **said,  # type: ignore[arg-type]
        )
        frame = encode(message)
        self.hub.connect(life).publish("settings", keys.settings(run), frame)

    def join(self, life: str = "actor-1") -> AnnouncedSettings:
        return AnnouncedSettings(self.hub.connect(life), "cuboid", self.clock, Turning(self.clock))


def test_it_hears_the_settings_whether_it_comes_before_or_after_the_coordinator() -> None:
    stage = Stage()
    early = stage.join("actor-early")
    stage.announce("coordinator-1")
    late = stage.join("actor-late")
    assert early.wait(WHERE, 20.0) == late.wait(WHERE, 20.0) == SETTINGS
    assert not early.replaced()


def test_after_the_deadline_it_says_which_run_is_missing_where_and_which_there_are() -> None:
    stage = Stage()
    stage.announce("coordinator-1", run="hand-2")
    with pytest.raises(UnknownRunError) as error:
        stage.join().wait(WHERE, 20.0)
    assert 70.0 <= stage.clock.now_secs() < 71.0
    assert str(error.value) == (
        "no run 'cuboid' is announced at tls/robots.lab:7447 (there is 'hand-2'): check --run (the run's "
        "name, see `babble status` there), or the coordinator is not up yet"
    )


def test_a_frame_of_another_protocol_is_named_instead_of_a_run_that_is_missing() -> None:
    stage = Stage()
    stage.hub.connect("coordinator-1").publish(
        "settings", keys.settings("cuboid"), b"\x83\xa1p\x01\xa1k\xa8settings\xa1h\x80"
    )
    with pytest.raises(
        UnknownRunError, match="speaks protocol 1, this process speaks 3; run the same version"
    ):
        stage.join().wait(WHERE, 1.0)


def test_a_coordinator_that_starts_again_with_the_same_settings_changes_nothing() -> None:
    stage = Stage()
    stage.announce("coordinator-1")
    heard = stage.join()
    heard.wait(WHERE, 20.0)
    stage.hub.crash("coordinator-1")
    stage.announce("coordinator-2")
    assert not heard.replaced()


@pytest.mark.parametrize(
    "change",
    [{"settings": parse({"scenario": "cuboid", "actors": {"window": 9}}, origin="test")}, {"began_ms": 2}],
    ids=["other settings", "the run begun again"],
)
def test_other_settings_or_another_run_of_the_name_are_noticed(change: dict[str, object]) -> None:
    stage = Stage()
    stage.announce("coordinator-1")
    heard = stage.join()
    heard.wait(WHERE, 20.0)
    stage.announce("coordinator-2", **change)  # type: ignore[arg-type]
    assert heard.replaced()


def test_another_run_of_another_name_is_not_its_business() -> None:
    stage = Stage()
    stage.announce("coordinator-1")
    heard = stage.join()
    heard.wait(WHERE, 20.0)
    stage.announce("coordinator-2", run="other", began_ms=7)
    assert not heard.replaced()


@pytest.mark.parametrize("path", SCENARIOS, ids=lambda path: path.stem)
def test_every_scenario_arrives_as_it_was_announced(path: Path) -> None:
    settings = load(path)
    assert parse_announced(announced_text(settings), origin="x") == settings


def test_deadlines_without_end_arrive_too() -> None:
    settings = parse({"scenario": "x", "wire": {"stall_secs": float("inf")}}, origin="test")
    assert parse_announced(announced_text(settings), origin="x") == settings


def changed(**tables: object) -> str:
    """The settings with other entries, as another version would announce them."""
    return json.dumps({**json.loads(announced_text(SETTINGS)), **tables})


@pytest.mark.parametrize(
    ("text", "fault"),
    [
        (changed(gripper={}), "gripper: is not a known key"),
        (changed(encoder={"dropout": 0.1}), "encoder.dropout: is not a known key"),
        (changed(seed=-1), "seed: input should be greater than or equal to 0, got -1"),
        ("[]", "are no JSON object (not an object)"),
        ("{", "are no JSON object"),
        ("[" * 100_000, "are no JSON object"),
    ],
)
def test_settings_of_another_version_are_refused_in_one_sentence_that_says_so(text: str, fault: str) -> None:
    with pytest.raises(SettingsError, match=re.escape(fault)) as error:
        parse_announced(text, origin="the settings of run 'cuboid'")
    assert str(error.value).startswith("the settings of run 'cuboid'")
    assert str(error.value).endswith(
        "the coordinator's side has another version of babble, install the same one on both"
    )
    assert "\n" not in str(error.value)


def test_settings_too_long_to_be_told_are_refused_by_the_one_who_would_tell_them() -> None:
    block = {"name": "body", "observes": list(range(200_000))}
    with pytest.raises(SettingsError, match="actors can be told 1,048,576; shorten the lists"):
        announced_text(parse({"scenario": "x", "block": [block]}, origin="test"))


def test_what_is_wrong_with_settings_of_a_million_characters_is_a_short_sentence() -> None:
    said = json.loads(announced_text(SETTINGS))
    for wrong in ({"seed": [0] * 300_000}, {"scenario": "x" * 900_000}, {"k" * 900_000: 0}):
        with pytest.raises(SettingsError, match=r"another version of babble") as refused:
            parse_announced(json.dumps({**said, **wrong}), origin="the settings of run 'x'")
        assert len(str(refused.value)) < 1000
