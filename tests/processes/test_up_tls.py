"""`babble up --listen tls/...`: a laptop without containers takes further hosts, and nobody else."""

from collections.abc import Callable
from pathlib import Path

import pytest

from services.launcher.authority import issue, make_authority
from tests.processes.owned import Owner, Process
from tests.processes.test_up import RUN_SECS, START_SECS, TINY, refused

pytestmark = pytest.mark.processes

Babble = Callable[..., Process]


@pytest.fixture
def babble(owner: Owner) -> Babble:
    """Starts `babble <arguments>`."""

    def start(*arguments: str | Path) -> Process:
        return owner.start("babble", "-m", "services.launcher", *map(str, arguments))

    return start


def test_all_processes_of_a_run_show_who_they_are_and_whoever_asks_must_too(
    babble: Babble, tmp_path: Path
) -> None:
    certs, folder = tmp_path / "certs", tmp_path / "run"
    assert babble("certs", "init", "--dir", certs, "--host", "127.0.0.1").ended(START_SECS) == 0
    (tmp_path / "tiny.toml").write_text(TINY.replace("iterations = 1", "iterations = 60"))
    run = babble(
        "up",
        tmp_path / "tiny.toml",
        *("--listen", "tls/0.0.0.0:0", "--certs", certs, "--run-dir", folder),
        *("--dashboard-port", "0", "--dashboard-grpc-port", "0"),
    )
    endpoint = run.expect("router     tls/127.0.0.1:", START_SECS).split()[1]
    run.expect("WALK 1 of 60", RUN_SECS)
    known = ("--credential", certs / "launcher.pem")
    (tmp_path / "foreign.pem").write_bytes(issue(make_authority(), "launcher"))
    foreign = ("--credential", tmp_path / "foreign.pem")
    status = babble("status", folder, *known)
    watch = babble("watch", folder, *known)
    started = [
        (babble("status", folder), "needs a credential"),
        (babble("status", folder, *foreign), "authority|signed"),
        (babble("watch", folder, *foreign), "authority|signed"),
        (
            babble("status", folder, "--connect", endpoint.replace("tls", "tcp"), *known),
            "would not be used",
        ),
    ]
    watch.expect("actor-local-", START_SECS)
    assert status.ended(START_SECS) == 0, status.report()
    for member in (
        "router-",
        "coordinator-",
        "encoder_learner-",
        "policy_learner-",
        "dashboard-",
        "actor-local-",
    ):
        assert any(line.startswith(member) and line.rstrip()[-1].isdigit() for line in status.out), member
    for process, words in started:
        refused(process, words)
    run.interrupt()
    assert run.ended(START_SECS) == 143, run.report()
    for log in folder.glob("logs/*.log"):
        assert "PRIVATE" not in log.read_text(), "a key is in a log"


def test_what_is_wrong_with_the_door_is_one_sentence_before_anything_starts(
    babble: Babble, tmp_path: Path
) -> None:
    (tmp_path / "tiny.toml").write_text(TINY)
    folder, given = ("--run-dir", tmp_path / "run"), tmp_path / "tiny.toml"
    started = {
        r"anybody who reaches tcp/0\.0\.0\.0:7447 could take part": ("--listen", "tcp/0.0.0.0:7447"),
        r"there are no certificates in .*`babble certs init": (
            *("--listen", "tls/127.0.0.1:0", "--certs", tmp_path / "none"),
        ),
        r"--certs is of use for a tls/ address only": ("--certs", tmp_path),
    }
    for sentence, arguments in started.items():
        refused(babble("up", given, *folder, *arguments), sentence)
    assert not (tmp_path / "run").exists()


def test_a_router_that_refuses_its_settings_ends_the_run_with_its_own_words(
    owner: Owner, tmp_path: Path
) -> None:
    (tmp_path / "tiny.toml").write_text(TINY)
    arguments = ("up", str(tmp_path / "tiny.toml"), "--run-dir", str(tmp_path / "run"), "--no-dashboard")
    wrong = {"BABBLE_MOST_GARBAGE": "x"}
    run = owner.start("babble", "-m", "services.launcher", *arguments, environment=wrong)
    # The launcher is still connecting then, on a thread; it must end all the same, and with this code.
    refused(run, "--most-garbage: must be a whole number")
