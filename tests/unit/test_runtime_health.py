"""Whether a process is well is told from what it published, by a program of its own."""

import json
import logging
import subprocess
import sys
import time
from pathlib import Path

import pytest

from protocol.messages import Phase
from services.runtime import health
from services.runtime.status import Heart

HEAVY = {"numpy", "pydantic", "msgpack", "zenoh", "argparse", "logging", "pathlib"}


class Wire:
    """A bus of which a heart asks next to nothing."""

    def __init__(self) -> None:
        self.up = True

    def publish(self, kind: str, key: str, frame: bytes) -> None:
        """Nobody hears it."""

    def linked(self) -> bool:
        return self.up


@pytest.fixture
def file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    path = tmp_path / "health"
    monkeypatch.setenv(health.VARIABLE, str(path))
    return path


def heart(wire: Wire, interval_secs: float = 1.0) -> Heart:
    made = Heart(wire, run="r", service="actor", life="actor-1", interval_secs=interval_secs)
    made.enter(3, Phase.WALK)
    return made


def aged(path: Path, secs: float, **more: object) -> Path:
    """The file as if it had been written so long ago."""
    record = json.loads(path.read_text())
    record["published_secs"] -= secs
    path.write_text(json.dumps(record | more))
    return path


def told(path: Path, capsys: pytest.CaptureFixture[str]) -> tuple[int, str]:
    code = health.main([str(path)])
    return code, capsys.readouterr().out.strip()


def test_a_process_that_published_a_moment_ago_is_healthy(
    file: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    heart(Wire()).poll(1.0, dict)
    code, words = told(aged(file, 0.4), capsys)
    assert (code, words) == (0, "healthy: actor in WALK, 0.4 s ago")
    assert [path.name for path in file.parent.iterdir()] == [file.name], "a draft was left"


def test_a_silent_process_is_not_healthy_and_its_last_words_are_told(
    file: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    heart(Wire()).poll(1.0, lambda: {"waiting_for": "a policy"})
    code, words = told(aged(file, 12), capsys)
    assert (code, words) == (1, "not healthy: silent for 12 s (last: actor in WALK; a policy)")


def test_a_process_that_speaks_rarely_is_given_its_time(
    file: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    heart(Wire(), interval_secs=20.0).poll(1.0, dict)
    assert told(aged(file, 50), capsys)[0] == 0
    assert told(aged(file, 20), capsys)[0] == 1


def test_a_process_without_a_router_is_not_healthy_though_it_speaks(
    file: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    wire, now_secs = Wire(), [1000.0]
    monkeypatch.setattr(time, "monotonic", lambda: now_secs[0])
    beating = heart(wire)
    for wire.up in (True, False, False, False):
        now_secs[0] += 2.0
        beating.poll(now_secs[0], dict)
    code, words = told(file, capsys)
    assert (code, words) == (1, "not healthy: not linked to the router for 4 s (actor in WALK)")
    wire.up = True
    now_secs[0] += 2.0
    beating.poll(now_secs[0], dict)
    assert told(file, capsys)[0] == 0


def test_it_is_written_once_a_second_at_most(
    file: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    now_secs = [1000.0]
    monkeypatch.setattr(time, "monotonic", lambda: now_secs[0])
    beating, written = heart(Wire()), set[str]()
    for _ in range(40):
        now_secs[0] += 0.1
        beating.poll(now_secs[0], dict, urgent=True)
        written.add(file.read_text())
    assert len(written) == 4


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        (None, "no word yet"),
        ("", "cannot read"),
        ("[]", "cannot read"),
        ('{"service": "actor"}', "cannot read"),
        ('{"service": "actor", "published_secs": 1e18, "interval_secs": 1}', "since this machine started"),
    ],
)
def test_what_tells_nothing_is_not_healthy(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], text: str | None, sentence: str
) -> None:
    if text is not None:
        (tmp_path / "health").write_text(text)
    code, words = told(tmp_path / "health", capsys)
    assert code == 1
    assert sentence in words
    assert words.count("\n") == 0


def test_without_a_file_it_says_which_variable_to_set(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv(health.VARIABLE, raising=False)
    assert health.main([]) == 1
    assert health.VARIABLE in capsys.readouterr().out


def test_a_disk_that_refuses_is_told_once_and_ends_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setenv(health.VARIABLE, str(tmp_path / "missing" / "health"))
    now_secs = [1000.0]
    monkeypatch.setattr(time, "monotonic", lambda: now_secs[0])
    beating = heart(Wire())
    with caplog.at_level(logging.WARNING):
        for _ in range(3):
            now_secs[0] += 2.0
            beating.poll(now_secs[0], dict)
    assert len(caplog.records) == 1
    assert "missing/health" in caplog.text


@pytest.mark.parametrize("nowhere", [".", "/dev/null/x", "x" * 300])
def test_a_path_that_is_no_files_ends_nothing(
    nowhere: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv(health.VARIABLE, nowhere)
    heart(Wire()).poll(1.0, dict)
    assert "nobody can tell" in caplog.text
    assert not list(tmp_path.iterdir())


def test_as_a_program_it_exits_with_0_or_1_and_loads_nothing_heavy(file: Path) -> None:
    heart(Wire()).poll(1.0, dict)
    program = [sys.executable, "-X", "importtime", "-m", "services.runtime.health"]
    well = subprocess.run(program, capture_output=True, text=True, timeout=60, check=False)
    assert (well.returncode, well.stdout.startswith("healthy: actor in WALK, ")) == (0, True)
    loaded = {line.rpartition("|")[2].strip() for line in well.stderr.splitlines()}
    assert "json" in loaded
    assert not loaded & HEAVY
    ill = subprocess.run([*program, "/no/such/file"], capture_output=True, text=True, timeout=60, check=False)
    assert ill.returncode == 1
