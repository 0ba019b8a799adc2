"""The dashboard on a bus: what its recording holds, what it refuses, and how it ends and begins again."""

import socket
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
import rerun as rr
from rerun.chunk import RrdReader

from protocol import keys
from protocol.messages import Phase
from services.runtime.errors import UserError
from tests.unit.dashboard_feed import RUN, announced, settings_of, view_of
from tests.unit.dashboard_reading import documents, parts_of, rows_of, scalars, states, verified
from tests.unit.dashboard_stage import BEGAN_SECS, Stage

Stages = list[Stage]


@pytest.fixture
def stages(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Stages]:
    """The stages that a test sets up; their dashboards end with it."""
    rr.set_strict_mode(True)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    made: Stages = []
    yield made
    for stage in made:
        stage.end()


def stage_of(
    stages: Stages, tmp_path: Path, *latent_dims: int, actors: int = 3, recording_mb: int = 512
) -> Stage:
    folder = tmp_path / f"run-{len(stages)}"
    folder.mkdir()
    stages.append(Stage(folder, settings_of(*latent_dims, recording_mb=recording_mb), actors=actors))
    return stages[-1]


@pytest.mark.parametrize("latent_dim", [2, 3, 4, 6])
def test_a_run_is_recorded(stages: Stages, tmp_path: Path, latent_dim: int) -> None:
    stage = stage_of(stages, tmp_path, latent_dim)
    stage.start()
    stage.everybody_joins()
    for term, phase in enumerate((Phase.BABBLE, Phase.ENCODE, Phase.GROUND, Phase.EVALUATE, Phase.WALK), 1):
        stage.say(announced(phase, term, iteration=int(phase is Phase.WALK)))
        stage.play(2.0, phase, term)
        if phase is Phase.EVALUATE:
            stage.say(stage.feed.scores(0, Phase.GROUND, term))
    stage.play(2.0, Phase.WALK, 5)
    stage.end()
    (path,) = paths = parts_of(stage.run_dir)
    assert verified(path, tmp_path / "home")
    assert states(paths, "/state/phase") == ["babble", "encode", "ground", "evaluate", "walk 1"]
    static = {row.entity for row in rows_of(paths) if row.run_secs is None}
    assert {
        "/latent/block/simplex/edges",
        "/latent/block/simplex/vertices",
        "/measures/block/usage/0",
    } <= static
    (vertices,) = rows_of(paths, "/latent/block/simplex/vertices")
    kind = "Points3D" if latent_dim == 4 else "Points2D"
    assert len(vertices.values[f"{kind}:positions"]) == latent_dim
    usage = [scalars(paths, f"/measures/block/usage/{vertex}") for vertex in range(latent_dim)]
    assert np.allclose(np.sum(usage, axis=0), 1.0)
    assert scalars(paths, "/scores/block/z_min") == [pytest.approx(0.6)]
    assert states(paths, "/members/a2") == ["alive"]
    assert any("WALK 1 of 4" in text for text in documents(paths, "/status/summary"))
    assert [entry.application_id for entry in RrdReader(str(path)).blueprints()] == ["babble"]
    (entry,) = RrdReader(str(path)).recordings()
    assert (entry.application_id, entry.recording_id) == ("babble", RUN)


def test_times_and_values_are_those_that_were_said(stages: Stages, tmp_path: Path) -> None:
    stage = stage_of(stages, tmp_path, 3, actors=1)
    stage.clock.advance(100.0)
    stage.start()
    stage.everybody_joins()
    latent = np.array([[1, 0, 0], [0.5, 0.5, 0]], np.float32)
    goal = np.array([[0, 1, 0], [0, 1, 0]], np.float32)
    stage.say(stage.feed.statuses(Phase.WALK, 1))
    stage.say(view_of(stage.feed.actors[0][0].life, "block", {"latent": latent, "goal": goal}))
    stage.poll(0.25)
    stage.end()
    paths = parts_of(stage.run_dir)
    assert scalars(paths, "/measures/block/goal_distance/mean") == [pytest.approx((2.0 + 0.5) / 2)]
    (row,) = rows_of(paths, "/measures/block/goal_distance/mean")[-1:]
    assert row.run_secs == pytest.approx(100.25)
    (now,) = [r for r in rows_of(paths, "/latent/block/now") if r.values.get("Points2D:positions")]
    assert now.values["Points2D:positions"][0] == pytest.approx([0.0, -1.0], abs=1e-6), "at vertex 0, on top"
    (name,) = [r for r in rows_of(paths, "/latent/block/now/names") if r.values.get("Points2D:labels")]
    assert name.values["Points2D:labels"] == ["a0"]
    steps = rows_of(paths, "/status/summary")[-1].env_steps
    assert steps is not None
    assert 300 < steps < 500


def test_blocks_are_apart(stages: Stages, tmp_path: Path) -> None:
    stage = stage_of(stages, tmp_path, 2, 3)
    stage.start()
    stage.everybody_joins()
    stage.play(2.0, Phase.WALK, 1)
    stage.end()
    paths = parts_of(stage.run_dir)
    for block, latent_dim in (("block-0", 2), ("block-1", 3)):
        assert scalars(paths, f"/measures/{block}/goal_distance/mean")
        assert scalars(paths, f"/measures/{block}/usage/{latent_dim - 1}")
        assert not scalars(paths, f"/measures/{block}/usage/{latent_dim}")
        assert scalars(paths, f"/learning/{block}/policy/reward_mean")


def test_what_does_not_belong_here_is_ignored_and_counted(stages: Stages, tmp_path: Path) -> None:
    stage = stage_of(stages, tmp_path, 3)
    stage.start()
    stage.everybody_joins()
    actor = stage.join("actor", "actor-odd")
    odd = np.full((2, 4), 0.25, np.float32)
    stage.say(
        [
            view_of("actor-odd", "elsewhere", {"latent": odd[:, :3]}),
            view_of("actor-odd", "block", {"latent": odd}),
        ]
    )
    actor.publish("view", keys.view(RUN, "latent", "actor-odd"), b"\xffnoise")
    stage.poll()
    stage.poll(1.0)
    status = stage.said()[-1]
    assert status.refused == {"unexpected": 2, "malformed": 1}
    assert status.totals["views"] == 0
    stage.play(1.5, Phase.WALK, 1)
    assert stage.said()[-1].totals["views"] > 0, "it goes on with the others"


def test_of_views_that_wait_only_the_newest_of_each_kind_is_drawn(stages: Stages, tmp_path: Path) -> None:
    stage = stage_of(stages, tmp_path, 3, actors=2)
    stage.start()
    stage.everybody_joins()
    for _ in range(5):
        stage.say(stage.feed.views())
    stage.poll()
    for _ in range(100):
        stage.say(stage.feed.views())
    stage.poll(1.0)
    totals = stage.said()[-1].totals
    assert totals["views"] == 4
    assert totals["superseded_views"] == 8 + 62
    assert totals["dropped_views"] == 200 - keys.DELIVERY["view"].keep


def test_a_member_that_dies_is_shown_as_lost_and_its_successor_takes_its_lane(
    stages: Stages, tmp_path: Path
) -> None:
    stage = stage_of(stages, tmp_path, 3)
    stage.start()
    stage.everybody_joins()
    stage.play(6.0, Phase.WALK, 1)
    stage.hub.crash(stage.feed.actors[1][0].life)
    stage.play(6.0, Phase.WALK, 1)
    stage.join("actor", "actor-new")
    stage.play(1.0, Phase.WALK, 1)
    stage.end()
    paths = parts_of(stage.run_dir)
    assert states(paths, "/members/a1") == ["alive", "lost", "alive"]
    assert states(paths, "/members/a0") == ["alive"]
    events = [row.values["TextLog:text"][0] for row in rows_of(paths, "/events")]
    assert f"a1 is lost ({stage.feed.actors[1][0].life})" in events
    assert "a1 is there (actor-new)" in events
    assert scalars(paths, "/system/steps_per_sec/a1")[-1] == 0.0


def test_it_ends_soon_after_the_run_is_done(stages: Stages, tmp_path: Path) -> None:
    stage = stage_of(stages, tmp_path, 3)
    stage.start()
    stage.everybody_joins()
    stage.play(1.0, Phase.PRACTISE, 1)
    stage.say(announced(Phase.DONE, 2))
    stage.say(stage.feed.scores(4, Phase.PRACTISE, 2))
    turns = 0
    while stage.poll() is not None:
        turns += 1
        assert turns <= 20, "it must end within two seconds"
    assert turns > 5, "the last words of the others are waited for"
    stage.dashboard = None
    paths = parts_of(stage.run_dir)
    assert verified(paths[0], tmp_path / "home")
    assert states(paths, "/state/phase")[-1] == "done"
    assert "# DONE" in documents(paths, "/status/summary")[-1]
    assert "practise 4" in documents(paths, "/status/scores")[-1]
    assert stage.said()[-1].phase is Phase.DONE


def test_started_late_and_again_it_goes_on_in_the_same_recording(stages: Stages, tmp_path: Path) -> None:
    stage = stage_of(stages, tmp_path, 3)
    stage.everybody_joins()
    stage.say(announced(Phase.WALK, 5, iteration=1))
    stage.clock.advance(50.0)
    for _ in range(2):
        stage.start()
        stage.play(2.0, Phase.WALK, 5)
        stage.end()
    _, second = paths = parts_of(stage.run_dir)
    assert [path.name for path in paths] == ["run-001.rrd", "run-002.rrd"]
    for path in paths:
        assert states([path], "/state/phase") == ["walk 1"], (
            "the coordinator's word is there for who comes late"
        )
        assert RrdReader(str(path)).recordings()[0].recording_id == RUN
    ends = [max(row.run_secs or 0.0 for row in rows_of([path], "/status/summary")) for path in paths]
    assert 50.0 < ends[0] < ends[1]
    assert states([second], "/members/a0") == ["alive"]


def test_a_resumed_run_goes_on_counting_steps_and_shows_its_scores(stages: Stages, tmp_path: Path) -> None:
    stage = stage_of(stages, tmp_path, 3)
    row = next(iter(stage.feed.scores(2, Phase.PRACTISE, 4).scores)).model_dump_json()
    (stage.run_dir / "scores.jsonl").write_text(f"{row}\n{row[:40]}")
    stage.everybody_joins()
    stage.start()
    stage.play(3.0, Phase.WALK, 5)
    stage.end()
    for _, life in stage.feed.lives:
        stage.hub.crash(life)
    stage.join("actor", "actor-resumed")
    stage.start()
    stage.poll()
    stage.end()
    first, second = paths = parts_of(stage.run_dir)
    steps = max(row.env_steps or 0 for row in rows_of([first]))
    assert steps > 3000
    assert rows_of([second], "/status/summary")[0].env_steps == steps
    for path in paths:
        assert "practise 2" in documents([path], "/status/scores")[0]


def test_the_lag_of_each_block_has_a_line_of_its_own_name(stages: Stages, tmp_path: Path) -> None:
    stage = stage_of(stages, tmp_path, 2, 3)
    stage.start()
    stage.everybody_joins()
    stage.play(1.0, Phase.WALK, 1)
    stage.end()
    styles = [row for row in rows_of(parts_of(stage.run_dir)) if row.entity.endswith(("lag_mean", "lag_max"))]
    named = {
        (row.values["SeriesLines:names"][0], row.values["SeriesLines:colors"][0])
        for row in styles
        if "SeriesLines:names" in row.values
    }
    assert {name for name, _ in named} == {f"block-{i}: {what}" for i in (0, 1) for what in ("mean", "most")}
    assert len({colour for _, colour in named}) == 4


def test_a_new_part_stands_alone(stages: Stages, tmp_path: Path) -> None:
    stage = stage_of(stages, tmp_path, 3, recording_mb=3)
    stage.start()
    stage.everybody_joins()
    stage.say(announced(Phase.WALK, 3, iteration=2))
    stage.play(205.0, Phase.WALK, 3)
    stage.end()
    paths = parts_of(stage.run_dir)
    totals = stage.said()[-1].totals
    assert totals["recording_parts"] > len(paths) > 1
    assert totals["deleted_parts"] == totals["recording_parts"] - len(paths)
    assert sum(path.stat().st_size for path in paths) <= 3_000_000
    newest = paths[-1:]
    assert verified(newest[0], tmp_path / "home")
    assert states(newest, "/state/phase") == ["walk 2"]
    assert rows_of(newest, "/latent/block/simplex/vertices")
    assert {row.entity for row in rows_of(newest) if "SeriesLines:names" in row.values} >= {
        "/system/steps_per_sec/a0",
        "/measures/block/goal_distance/mean",
        "/learning/block/policy/reward_mean",
    }


def test_when_the_disk_refuses_the_rest_goes_on_and_says_so(stages: Stages, tmp_path: Path) -> None:
    stage = stage_of(stages, tmp_path, 3)
    (stage.run_dir / "recording").write_text("in the way")
    stage.start()
    stage.everybody_joins()
    stage.play(2.0, Phase.WALK, 1)
    status = stage.said()[-1]
    assert status.totals["recording_errors"] == 1
    assert "nothing more is recorded" in status.last_error
    assert status.totals["rows"] > 100
    assert stage.dashboard is not None
    assert (stage.run_dir / "recording").read_text() == "in the way"


@pytest.mark.parametrize("option", ["grpc_port", "web_port"])
def test_a_port_in_use_is_one_sentence_that_names_the_option(
    stages: Stages, tmp_path: Path, option: str
) -> None:
    stage = stage_of(stages, tmp_path, 3)
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        with pytest.raises(UserError) as caught:
            stage.start(**{option: port})
    assert str(port) in str(caught.value)
    assert "--" + option.replace("_", "-") in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"grpc_port": 70000}, "--grpc-port is 70000"),
        ({"web_port": 9000, "grpc_port": 9000}, "both 9000"),
        ({"bind": "localhost"}, "--bind 'localhost'"),
        ({"server_memory_mb": 0}, "--server-memory-mb is 0"),
    ],
)
def test_options_that_cannot_be_are_told(
    stages: Stages, tmp_path: Path, options: dict[str, object], words: str
) -> None:
    stage = stage_of(stages, tmp_path, 3)
    with pytest.raises(UserError, match=words):
        stage.start(**options)


def test_a_run_folder_without_a_time_has_that_of_its_file(stages: Stages, tmp_path: Path) -> None:
    import os

    stage = stage_of(stages, tmp_path, 3)
    (stage.run_dir / "run.json").write_text('{"run": "made-up"}')
    os.utime(stage.run_dir / "run.json", (BEGAN_SECS - 7, BEGAN_SECS - 7))
    stage.start()
    stage.poll(0.0)
    stage.end()
    assert rows_of(parts_of(stage.run_dir), "/status/summary")[0].run_secs == pytest.approx(7.0)
