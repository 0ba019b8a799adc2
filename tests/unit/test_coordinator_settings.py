"""What the coordinator tells actors that have only the run's name."""

from collections.abc import Iterator
from pathlib import Path

import pytest

from services.runtime.settings import SettingsError, parse, parse_announced
from tests.unit.coordinator_stage import Stage


@pytest.fixture
def stage(tmp_path: Path) -> Iterator[Stage]:
    stage = Stage(tmp_path)
    stage.start("coordinator-1")
    yield stage
    if stage.coordinator is not None:
        stage.coordinator.stop()
        stage.poll()


def test_a_late_comer_is_told_the_settings_and_when_the_run_began(stage: Stage) -> None:
    stage.poll()
    told = stage.told_settings("late-1")
    assert parse_announced(told.config, origin="test") == stage.settings
    assert told.began_ms == round(1000 * stage.clock.now_secs())


def test_a_run_that_is_gone_on_with_says_that_it_began_when_it_did(stage: Stage) -> None:
    stage.poll()
    before = stage.told_settings("late-1")
    stage.kill()
    stage.clock.advance(1000.0)
    stage.start("coordinator-2")
    stage.poll()
    after = stage.told_settings("late-2")
    assert (after.began_ms, after.config) == (before.began_ms, before.config)
    assert after.life == "coordinator-2"


def test_a_run_begun_again_under_the_same_name_says_another_beginning(stage: Stage, tmp_path: Path) -> None:
    stage.poll()
    before = stage.told_settings("late-1")
    stage.kill()
    stage.clock.advance(1000.0)
    stage.run_dir = tmp_path / "anew"
    stage.start("coordinator-2")
    stage.poll()
    assert stage.told_settings("late-2").began_ms == before.began_ms + 1_000_000


def test_settings_too_long_to_be_told_are_refused_at_the_start(tmp_path: Path) -> None:
    block = {"name": "body", "observes": list(range(200_000))}
    long = parse({"scenario": "test", "block": [block]}, origin="test")
    with pytest.raises(SettingsError, match="shorten the lists of what blocks observe"):
        Stage(tmp_path, long).start("coordinator-1")
