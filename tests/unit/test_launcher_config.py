"""Scenarios as they are found, changed by the command line and tried out before anything starts."""

from pathlib import Path

import pytest

from services.launcher.config import check_world, scenario_path, scenario_settings
from services.runtime.settings import SettingsError, parse


def test_a_scenario_is_found_by_path_and_by_bare_name(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "scenarios").mkdir()
    (tmp_path / "scenarios" / "torus.toml").write_text('scenario = "torus"\n')
    monkeypatch.chdir(tmp_path)
    by_path = scenario_path("scenarios/torus.toml")
    assert by_path.samefile(scenario_path("torus"))
    assert by_path.samefile(scenario_path("torus.toml"))


def test_without_a_folder_here_the_repositorys_scenarios_are_known(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    assert scenario_settings("cuboid", actors=None, seed=None).scenario == "cuboid"
    with pytest.raises(SettingsError, match=r"no scenario 'torus'.*cuboid, .*dumbbell, ellipsoid"):
        scenario_path("torus")


def test_actors_and_seed_of_the_command_line_replace_the_scenarios() -> None:
    settings = scenario_settings("cuboid", actors=5, seed=7)
    assert (settings.actors.count, settings.seed) == (5, 7)
    assert scenario_settings("cuboid", actors=None, seed=None).actors.count == 2


@pytest.mark.parametrize(
    ("table", "sentence"),
    [
        ({"world": {"id": "Torus"}}, "no world 'Torus'"),
        ({"world": {"parameters": {"sped": 1}}}, "no parameter 'sped'"),
        ({"world": {"parameters": {"speed": "fast"}}}, "speed must be"),
        ({"block": [{"observes": [7]}]}, "observes 7"),
        ({"block": [{"drives": ["x", "w"]}]}, "no actuator matches 'w'; there are x, y, z"),
        (
            {"block": [{"name": "a", "drives": ["x"]}, {"name": "b", "drives": ["y"]}]},
            r"no block drives 1 of the world's 3 actuators \(z\)",
        ),
    ],
)
def test_worlds_and_blocks_are_tried_out(table: dict[str, object], sentence: str) -> None:
    settings = parse({"scenario": "x", **table}, origin="x.toml")
    with pytest.raises(SettingsError, match=sentence) as refused:
        check_world(settings, origin="x.toml")
    assert str(refused.value).startswith("x.toml: ")


def test_what_several_blocks_leave_out_or_share_is_told(capsys: pytest.CaptureFixture[str]) -> None:
    blocks = [
        {"name": "a", "observes": ["x", "y"], "drives": ["x"]},
        {"name": "b", "observes": ["y"], "drives": ["y", "z"]},
        {"name": "both", "children": ["a", "b"]},
    ]
    check_world(parse({"scenario": "x", "block": blocks}, origin="x.toml"), origin="x.toml")
    assert capsys.readouterr().err.splitlines() == [
        "x.toml: nobody observes 1 of 3 components (position/z)",
        "x.toml: more than one block observes 1 of 3 components (position/y)",
    ]


@pytest.mark.parametrize("block", [{}, {"observes": ["x"]}])
def test_one_block_is_not_remarked_upon(block: dict[str, object], capsys: pytest.CaptureFixture[str]) -> None:
    check_world(parse({"scenario": "x", "block": [block]}, origin="x.toml"), origin="x.toml")
    assert capsys.readouterr().err == ""
