"""What people see of a run in which nothing is learned, and which processes it has."""

from pathlib import Path
from typing import Any

import pytest

from protocol.messages import ALL_BLOCKS, ModelFloor, Phase, PhaseAnnounced, Progress, Status
from services.launcher.address import Address, address_of
from services.launcher.cli import main
from services.launcher.config import scenario_settings
from services.launcher.frame import facts, frame
from services.launcher.lines import progress_line
from services.launcher.members import Picture
from services.launcher.run_folder import RunFolder
from services.launcher.service import parts_of
from services.launcher.supervisor import Part
from services.launcher.timeline import timeline_of
from services.runtime.errors import UserError
from services.runtime.settings import RunSettings, SettingsError, parse
from tests.unit.launcher_picture import RUN, texts

OPEN_LOOP = {
    "scenario": "open",
    "actors": {"count": 2},
    "phases": {"open_loop": True, "babble_steps": 1000},
    "recording": {"every_steps": 1},
}
ADDRESS = Address(listen="tcp/127.0.0.1:1", connect="tcp/127.0.0.1:1")


def parts(tmp_path: Path, table: dict[str, Any]) -> dict[str, Part]:
    found = parts_of(RunFolder(tmp_path / "run", "r"), parse(table, origin="test"), ADDRESS)
    return {part.name: part for part in found}


def test_an_open_loop_has_a_recorder_and_no_learners(tmp_path: Path) -> None:
    found = parts(tmp_path, OPEN_LOOP)
    assert set(found) == {"router", "coordinator", "recorder", "actor-0", "actor-1"}
    recorder = found["recorder"]
    assert recorder.arguments[:4] == ("-m", "services.recorder", "--run-dir", str(tmp_path / "run"))
    assert recorder.must_finish
    assert not recorder.optional


def test_a_run_that_learns_has_a_recorder_where_it_records(tmp_path: Path) -> None:
    learning = {"scenario": "s"}
    assert "recorder" not in parts(tmp_path, learning)
    recorded = parts(tmp_path, learning | {"recording": {"every_steps": 5}})
    assert {"recorder", "encoder_learner", "policy_learner"} <= set(recorded)


def scenario(folder: Path, text: str) -> str:
    path = folder / "s.toml"
    path.write_text(f'scenario = "s"\n{text}')
    return str(path)


def test_every_nth_step_is_recorded_where_a_person_says_so(tmp_path: Path) -> None:
    path = scenario(tmp_path, "[recording]\nevery_steps = 3\ngroup_rows = 2048")
    told = [scenario_settings(path, actors=1, seed=None, record=n).recording for n in (None, 10)]
    assert [(each.every_steps, each.group_rows) for each in told] == [(3, 2048), (10, 2048)]


def test_an_open_loop_that_is_not_recorded_is_refused(tmp_path: Path) -> None:
    with pytest.raises(SettingsError, match=r"phases\.open_loop: needs recording\.every_steps"):
        scenario_settings(scenario(tmp_path, "[phases]\nopen_loop = true"), actors=None, seed=None)


@pytest.mark.parametrize(
    ("wrong", "sentence"),
    [("0", "of at least 1, got '0'"), ("-1", "--record"), ("x", "of at least 1, got 'x'")],
)
def test_a_wrong_number_of_steps_is_a_sentence(
    wrong: str, sentence: str, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as failure:
        main(["up", "cuboid", f"--record={wrong}"])
    assert failure.value.code == 2
    said = capsys.readouterr().err
    assert sentence in said
    assert "Traceback" not in said


def test_what_is_recorded_is_not_changed_by_a_resume(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["up", "--resume", "runs/x", "--record"]) == 2
    assert "leave out --record" in capsys.readouterr().err


def recording(done: int = 500, *, recorder: bool = True) -> Picture:
    """An open loop of which half is recorded."""
    seen = Picture(RUN, f"runs/{RUN}", 0.0)
    seen.know(parse(OPEN_LOOP, origin="test"))
    common = {"run": RUN, "block": ALL_BLOCKS, "seq": 0, "term": 1}
    seen.hear_phase(
        PhaseAnnounced(**common, life="c-1", phase=Phase.BABBLE, blocks={"body": ModelFloor()}), 0.0
    )
    if recorder:
        seen.appeared("recorder", "recorder-1", 0.0)
        for now in (1.0, 2.0):
            steps = round(done * now / 2)
            said = Status(
                **common,
                life="recorder-1",
                service="recorder",
                progress=[Progress(block="body", done=steps, wanted=1000, unit="steps")],
                totals={"rows": steps, "files": 2, "bytes": 1_500_000},
            )
            seen.hear_status(said, now)
    return seen


def test_the_views_tell_how_far_the_recording_is() -> None:
    for rows in (frame(recording(), 2.0, 80), facts(recording(), 2.0, 80)):
        shown = "\n".join(texts(rows))
        assert "500 of 1,000 steps" in shown
        assert "recorded: 500 rows in 2 files, 1.5 MB" in shown
        assert "learner" not in shown
    assert progress_line(recording(), 2.0) == (
        "BABBLE: body 500 of 1,000 steps, 0:02 left; 500 rows recorded"
    )


def test_rows_that_are_missing_are_told() -> None:
    seen = recording()
    status = seen.members("recorder")[0].status
    assert status is not None
    seen.hear_status(status.model_copy(update={"totals": {**status.totals, "gaps": 12}}), 3.0)
    assert "500 rows in 2 files, 1.5 MB; 12 rows are missing" in "\n".join(texts(frame(seen, 3.0, 80)))


def test_without_a_recorder_it_waits_for_one_and_not_for_a_learner() -> None:
    seen = recording(recorder=False)
    assert progress_line(seen, 5.0) == "BABBLE: waiting for a recorder: body"
    shown = "\n".join(texts(frame(seen, 5.0, 80)))
    assert "waiting for the recorder" in shown
    assert "learner" not in shown


def test_somebody_who_knows_only_the_name_learns_it_from_the_recorder() -> None:
    seen = Picture(RUN, "", 0.0)
    status = recording().members("recorder")[0].status
    assert status is not None
    seen.hear_status(status, 1.0)
    assert seen.worker == "recorder"


def test_in_an_open_loop_a_missing_recorder_is_waited_for_and_a_missing_learner_is_not() -> None:
    events = [
        {"secs": 100.0, "what": "phase", "text": "babble (level 0, iteration 0, term 1)"},
        {"secs": 101.0, "what": "joined", "text": "actor-1 (actor) joined"},
        {"secs": 103.0, "what": "joined", "text": "recorder-1 (recorder) joined"},
        {"secs": 110.0, "what": "phase", "text": "done (level 0, iteration 0, term 2)"},
    ]
    assert timeline_of(events, open_loop=True).waits == [(0.0, 3.0)]
    assert timeline_of(events).waits == [(0.0, 10.0)]
    assert timeline_of(events, open_loop=True).done


def test_a_recorder_needs_a_credential_only_where_it_records(tmp_path: Path) -> None:
    certs = tmp_path / "certs"
    assert main(["certs", "init", "--dir", str(certs), "--host", "127.0.0.1"]) == 0
    assert address_of("tls/127.0.0.1:0", certs=certs, records=True).certs == certs
    (certs / "recorder.pem").unlink()
    assert address_of("tls/127.0.0.1:0", certs=certs).certs == certs
    with pytest.raises(UserError, match=r"without .*recorder\.pem"):
        address_of("tls/127.0.0.1:0", certs=certs, records=True)


def test_there_is_nothing_to_score(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = RunFolder.create(RunSettings.model_validate(OPEN_LOOP), tmp_path / "run", ["babble"])
    assert main(["score", str(folder.path)]) == 2
    said = capsys.readouterr().err
    assert said.startswith("babble score: nothing was learned in ")
    assert f"babble coverage {folder.shown}" in said
