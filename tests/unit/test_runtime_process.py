"""The loop's rules that need no process: when it polls, sleeps, stops and gives up."""

import json
import logging
import re
from collections.abc import Iterator
from pathlib import Path

import pytest
from pydantic import TypeAdapter

from protocol.messages import Name
from services.runtime import process
from services.runtime.bus import Wakeup
from services.runtime.clock import HandClock
from services.runtime.process import STOP_SECS, log_to_stderr, loop, new_life, run_process
from services.runtime.settings import SettingsError, parse


class Sleepless(Wakeup):
    """A wakeup whose sleep turns the clock."""

    def __init__(self, clock: HandClock) -> None:
        super().__init__()
        self.slept_secs: list[float] = []
        self._clock = clock

    def wait(self, timeout_secs: float) -> bool:
        self.slept_secs.append(timeout_secs)
        self._clock.advance(timeout_secs)
        return False


class Scripted:
    """Returns the delays given, and stops `after_stop` polls after being told to."""

    def __init__(self, delays: list[float | None], after_stop: int | None = None) -> None:
        self.polled_secs: list[float] = []
        self.stops = 0
        self._delays = delays
        self._after_stop = after_stop
        self._since_stop = 0

    def poll(self, now_secs: float) -> float | None:
        self.polled_secs.append(now_secs)
        if self.stops:
            self._since_stop += 1
            if self._since_stop == self._after_stop:
                return None
        return self._delays.pop(0) if self._delays else 0.1

    def stop(self) -> None:
        self.stops += 1


def test_it_sleeps_as_long_as_asked_but_not_over_a_quarter_of_a_second() -> None:
    clock = HandClock()
    wakeup = Sleepless(clock)
    loop(Scripted([0.0, 0.1, 5.0, None]), clock, wakeup, lambda: False)
    assert wakeup.slept_secs == [0.1, 0.25]


def test_a_stop_is_said_once_and_polling_goes_on_until_the_service_is_done() -> None:
    clock = HandClock()
    service = Scripted([], after_stop=7)
    loop(service, clock, Sleepless(clock), lambda: clock.now_secs() >= 1.0)
    assert service.stops == 1
    assert clock.now_secs() < 1.0 + 0.1 * 8


def test_a_service_that_does_not_stop_is_left_at_the_deadline() -> None:
    clock = HandClock()
    service = Scripted([])
    loop(service, clock, Sleepless(clock), lambda: clock.now_secs() >= 1.0)
    assert service.stops == 1
    assert STOP_SECS < clock.now_secs() < 1.0 + STOP_SECS + 0.5


def test_life_names_are_new_each_time_and_fit_into_keys() -> None:
    lives = {new_life("encoder_learner") for _ in range(50)}
    assert len(lives) == 50
    for life in lives:
        assert re.fullmatch(r"encoder_learner-[0-9a-f]{8}", life)
        TypeAdapter(Name).validate_python(life)


def test_a_life_of_a_host_with_a_credential_names_the_host() -> None:
    assert re.fullmatch(r"actor-lab_2-[0-9a-f]{8}", new_life("actor", "lab_2"))


@pytest.fixture
def logging_restored() -> Iterator[None]:
    """Leaves pytest's own handlers as they were."""
    root = logging.getLogger()
    handlers, level, raising = [*root.handlers], root.level, logging.raiseExceptions
    yield
    root.handlers, root.level, logging.raiseExceptions = handlers, level, raising


@pytest.mark.usefixtures("logging_restored")
@pytest.mark.parametrize(("told", "said"), [("warning", ["careful"]), ("", ["by the way", "careful"])])
def test_the_environment_says_how_much_is_logged(
    told: str, said: list[str], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("BABBLE_LOG", told)
    log_to_stderr("actor-1")
    logging.getLogger("x").info("by the way")
    logging.getLogger("x").warning("careful")
    assert [line.split(maxsplit=3)[3] for line in capsys.readouterr().err.splitlines()] == said


@pytest.mark.usefixtures("logging_restored")
def test_a_level_that_there_is_not_is_said_and_not_obeyed(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("BABBLE_LOG", "loud")
    log_to_stderr("actor-1")
    logging.getLogger("x").info("by the way")
    assert re.search(r"BABBLE_LOG=loud is none of debug, info.*\n.*by the way", capsys.readouterr().err)


def started(*arguments: str, by_name: bool = True) -> int:
    """The exit code of a service that must not get as far as a bus."""

    def build(_: object) -> Scripted:
        raise AssertionError("it must not start")

    return run_process("actor", build, arguments, by_name=by_name)


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The folder of a run; nothing in the environment says anything of a run."""
    for name in ("BABBLE_RUN", "BABBLE_CONNECT", "BABBLE_CREDENTIAL"):
        monkeypatch.delenv(name, raising=False)
    (tmp_path / "config.toml").write_text('scenario = "here"')
    (tmp_path / "run.json").write_text('{"run": "r"}')
    return tmp_path


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        ([], "give --run NAME or --run-dir DIR"),
        (["--run", "r", "--run-dir", "."], "--run-dir: not allowed with argument --run"),
        (["--run", "R/x"], "'R/x' is no name of a run: 1 to 64 of a-z"),
        (["--run", ""], "'' is no name of a run"),
        (["--run", "r", "--config", "c.toml"], "--config goes with --run-dir"),
    ],
)
@pytest.mark.usefixtures("folder")
def test_a_run_is_given_by_its_name_or_by_its_folder(
    arguments: list[str], sentence: str, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as ended:
        started(*arguments)
    assert ended.value.code == 2
    assert sentence in capsys.readouterr().err


@pytest.mark.usefixtures("folder")
def test_a_service_with_files_needs_its_folder(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("BABBLE_RUN", "r")
    with pytest.raises(SystemExit):
        started(by_name=False)
    assert "--run-dir is required" in capsys.readouterr().err


@pytest.mark.usefixtures("logging_restored")
def test_a_folder_on_the_command_line_counts_before_a_name_in_the_environment(
    folder: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("BABBLE_RUN", "another")
    assert started("--run-dir", str(folder), "--print-config") == 0
    assert json.loads(capsys.readouterr().out)["scenario"] == "here"


@pytest.mark.usefixtures("logging_restored")
@pytest.mark.parametrize("which", ["--run=r", "--run-dir=FOLDER"])
def test_a_closed_address_without_a_credential_is_refused_before_anything_is_tried(
    which: str, folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    which = which.replace("FOLDER", str(folder))
    assert started(which, "--connect", "tls/nowhere.invalid:7447") == 2
    (sentence,) = capsys.readouterr().err.splitlines()
    assert sentence.startswith("actor: tls/nowhere.invalid:7447 needs a credential; give --credential FILE")


def test_a_settings_error_is_one_for_people_and_still_a_value_error() -> None:
    with pytest.raises(ValueError, match="x: scenario") as failure:
        parse({}, origin="x")
    assert isinstance(failure.value, SettingsError)


@pytest.mark.usefixtures("logging_restored")
@pytest.mark.parametrize("asked_to_stop", [False, True])
def test_a_process_that_is_told_to_stop_while_it_leaves_does_not_begin_anew(
    asked_to_stop: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    def leave(one: process._Process) -> None:
        one.outdated, one.signals.received = True, asked_to_stop

    begun: list[str] = []
    monkeypatch.setattr(process._Process, "run", leave)
    monkeypatch.setattr(process._Signals, "listen", lambda _: None)
    monkeypatch.setattr("os.execv", lambda program, _: begun.append(program))
    code = run_process("actor", lambda _: Scripted([]), ["--run", "x"], by_name=True)
    assert (code, bool(begun)) == (0, not asked_to_stop)


def test_a_wrong_command_line_is_one_line(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit, match="2"):
        run_process("actor", lambda _: Scripted([]), ["--run", "No Name"], by_name=True)
    (line,) = capsys.readouterr().err.splitlines()
    assert "'No Name' is no name of a run" in line
