"""The command line: what it imports, what it says, and the pure parts of its small commands."""

import subprocess
import sys
from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest

from babble.worlds import WORLDS
from services.launcher.authority import issue, make_authority
from services.launcher.cli import main
from services.launcher.doctor import (
    certificates,
    dashboard_finding,
    docker_finding,
    packages,
    requirements,
)
from services.launcher.status_command import status_lines
from services.launcher.worlds_command import world_lines
from tests.unit.analytic_run import write_run

HEAVY = {"torch", "stable_baselines3", "onnx", "matplotlib", "mujoco", "rerun"}


def modules_after(code: str) -> set[str]:
    program = f"{code}\nimport sys; print(*{{name.partition('.')[0] for name in sys.modules}})"
    said = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, timeout=60, check=True
    )
    return set(said.stdout.splitlines()[-1].split())


def test_the_launcher_loads_nothing_heavy_and_its_help_next_to_nothing() -> None:
    service = modules_after("import services.launcher.up, services.launcher.status_command")
    assert not service & HEAVY
    helped = modules_after(
        "from services.launcher.cli import main\ntry: main(['--help'])\nexcept SystemExit: pass"
    )
    assert not helped & (HEAVY | {"numpy", "pydantic", "zenoh", "rich", "gymnasium"})


def test_without_a_command_it_helps(capsys: pytest.CaptureFixture[str]) -> None:
    assert main([]) == 0
    said = capsys.readouterr().out
    for command in (
        "up",
        "actor",
        "prepare",
        "watch",
        "certs",
        "status",
        "view",
        "report",
        "score",
        "worlds",
        "doctor",
    ):
        assert f"    {command} " in said


def test_version(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["--version"]) == 0
    assert capsys.readouterr().out.startswith("babble 0.")


def test_a_missing_package_is_one_sentence(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delitem(sys.modules, "services.launcher.worlds_command")
    monkeypatch.setitem(sys.modules, "babble.worlds", None)
    monkeypatch.setattr("services.launcher.cli.OURS", ())
    assert main(["worlds"]) == 2
    assert capsys.readouterr().err.count("\n") == 1


def test_worlds_are_told_with_parameters_defaults_and_diameter() -> None:
    lines = "\n".join(world_lines(WORLDS["Dumbbell"]))
    for needed in ("lobe_centre = 0.9", "bridge_radius = 0.15", "= 2.8", "babble/Dumbbell-v0"):
        assert needed in lines


def test_the_doctor_names_what_is_missing_and_the_extra_to_install() -> None:
    found = packages("learner", ["numpy", "torch"], {"numpy": "2.4"}.get)
    assert not found.good
    assert "without torch;" in found.text
    assert "--extra learner" in found.text
    assert packages("actor", ["numpy"], {"numpy": "2.4"}.get).text == "numpy 2.4"


def test_the_doctor_knows_the_packages_of_an_extra_through_other_extras() -> None:
    assert {"eclipse-zenoh", "msgpack", "torch", "stable-baselines3"} <= set(requirements("learner"))
    assert "torch" not in requirements("actor")
    assert {"rich", "onnxruntime"} <= set(requirements("launcher"))


def test_a_run_can_do_without_what_the_dashboard_needs() -> None:
    found = dashboard_finding(lambda name: None if name == "rerun-sdk" else "1.0")
    assert (found.good, found.needed) == (False, False)
    assert "without rerun-sdk;" in found.text
    assert "--extra dashboard" in found.text
    assert dashboard_finding(lambda name: "1.0").good


def test_the_doctor_says_what_containers_would_need_and_that_nothing_else_does(tmp_path: Path) -> None:
    none = docker_finding(None)
    assert (none.good, none.needed) == (False, False)
    assert none.text == "not found; needed only for `docker compose up`"
    for engine, compose, words in (
        ("20.10.24", "2.40.3", "engine 20.10.24, compose 2.40.3"),
        ("", "2.40.3", "engine none answers, compose 2.40.3; start the engine"),
        ("20.10.24", "", "engine 20.10.24, compose not found; install the plugin"),
    ):
        docker = tmp_path / "docker"
        choose = f'[ "$1" = compose ] && said="{compose}" || said="{engine}"'
        docker.write_text(f'#!/bin/sh\n{choose}\necho "$said"\n[ "$said" ]\n')
        docker.chmod(0o755)
        found = docker_finding(str(docker))
        assert found.text.startswith(words)
        assert (found.good, found.needed) == (bool(engine and compose), False)


def test_the_doctor_names_certificates_that_expire(tmp_path: Path) -> None:
    authority, now = make_authority(), datetime.now(UTC)
    (tmp_path / "router").mkdir()
    (tmp_path / "ca.pem").write_bytes(authority.certificate_pem)
    router, actor = tmp_path / "router" / "router.pem", tmp_path / "actor.lab.pem"
    router.write_bytes(issue(authority, "router", days=100))
    actor.write_bytes(issue(authority, "actor.lab", days=60))
    good = certificates(tmp_path, now)
    assert good.good
    assert good.text == f"2 credentials in {tmp_path}/, all good until {now + timedelta(days=60):%Y-%m-%d}"
    soon = certificates(tmp_path, now + timedelta(days=40))
    assert (soon.good, soon.needed) == (False, False)
    assert f"{actor} expires on {now + timedelta(days=60):%Y-%m-%d}; see `babble certs list`" in soon.text
    both = certificates(tmp_path, now + timedelta(days=80))
    assert f"{actor} expired on" in both.text
    assert f"{router} expires on" in both.text
    actor.write_text("rubbish")
    assert f"{actor} is no credential" in certificates(tmp_path, now).text


def test_status_tells_phase_members_and_scores() -> None:
    row = {"block": "body", "iteration": 0, "policy": "mean", "separation": 0.5, "z_min": 0.25, "z_goal": 1.0}
    told = {
        "run": "r",
        "phase": "evaluate",
        "evaluates": "practise",
        "iteration": 1,
        "iterations": 4,
        "term": 8,
        "waiting": "waiting for policy_learner",
        "members": [{"life": "actor-1", "totals": {"env_steps": 1234}, "versions": {"encoder/body": 2}}],
        "unlisted": 1_200,
        "scores": [{**row, "switch_success": 1.0, "crossing": None}],
        "best": [{"block": "body", "iteration": 0, "reason": "iteration 0 is nearest"}],
    }
    lines = status_lines(told)
    assert lines[:2] == [
        "run r: EVALUATE after PRACTISE, iteration 1 of 4, term 8",
        "waiting for policy_learner",
    ]
    assert any(
        line.startswith("actor-1 ") and line.endswith("1,234 steps; encoder/body v2") for line in lines
    )
    assert "and 1,200 more" in lines
    assert lines[-1] == "best of body: iteration 0 is nearest"
    above = status_lines({**told, "level": 1})
    assert above[0] == "run r: EVALUATE after PRACTISE, iteration 1 of 4, level 1, term 8"


def test_status_tells_what_was_heard_besides_and_where_the_dashboard_is() -> None:
    told: dict[str, object] = {
        "run": "r",
        "phase": "babble",
        "evaluates": None,
        "iteration": 0,
        "iterations": 4,
        "term": 1,
    }
    told |= {"waiting": "", "members": [{"life": "actor-1"}], "unlisted": 0, "scores": [], "best": []}
    events = [{"time": "2026-01-02T03:04:05.678+00:00", "text": "actor-1 (actor) joined"}]
    events += [{"text": "no time"}, {"time": "yesterday", "text": "no time either"}]
    lines = status_lines(told, dashboard="http://127.0.0.1:9090", facts=["", "actor-1  0.3 s"], events=events)
    assert lines[:4] == [
        "run r: BABBLE, term 1",
        "dashboard http://127.0.0.1:9090",
        "",
        "actor-1  0.3 s",
    ]
    assert lines[-1].endswith(":04:05  actor-1 (actor) joined")


def test_status_of_a_run_that_is_over_says_whether_to_go_on_or_what_to_read(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = write_run(tmp_path / "run", [], phase="walk (level 0, iteration 1, term 5)")
    assert main(["status", str(folder)]) == 2
    assert f"go on with `babble up --resume {folder}`" in capsys.readouterr().err
    (folder / "result.json").write_text('{"scores_secs": 1.5}')
    assert main(["status", str(folder)]) == 2
    assert f"is completed; read {folder}/report.md" in capsys.readouterr().err
