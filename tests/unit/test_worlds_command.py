"""`babble worlds`: the worlds, and the names in one of them that blocks choose from."""

from pathlib import Path

import pytest

from services.launcher.cli import main


def told(capsys: pytest.CaptureFixture[str], *arguments: str) -> str:
    assert main(["worlds", *arguments]) == 0
    text = capsys.readouterr().out
    assert max(map(len, text.splitlines())) <= 100
    return text


def test_the_names_in_a_world_are_listed_by_sense(capsys: pytest.CaptureFixture[str]) -> None:
    actuators, observed = told(capsys, "MimoStandUp").split("\n\n")
    assert actuators.startswith("MimoStandUp has 37 actuators, which blocks drive:\n    act:hip_bend, ")
    assert observed.startswith("and 86 components of the observation, which blocks observe:\n  position/\n")
    assert "\n  velocity/\n    robot:hip_lean1, " in observed
    assert "\n  vestibular/\n    vestibular_acc (3), vestibular_gyro (3)" in observed


def test_a_scenario_names_its_world_as_it_has_it(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    scenario = tmp_path / "thumb.toml"
    world = 'id = "MimoFinger"\nparameters = { finger = "thumb", senses = ["velocity"] }\n'
    scenario.write_text(f'scenario = "thumb"\n[world]\n{world}')
    text = told(capsys, str(scenario))
    assert "act:right_thumb_middle" in text
    assert "  velocity/\n    robot:right_th_middle, robot:right_th_distal" in text


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ("MimoFoot", "there is no world 'MimoFoot'; the worlds are Cuboid, "),
        ("Mjcf", "Mjcf: file is missing"),
    ],
)
def test_a_world_that_is_not_there_or_cannot_be_built_is_one_sentence(
    given: str, words: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["worlds", given]) == 2
    said = capsys.readouterr().err
    assert said.startswith(f"babble worlds: {words}")
    assert said.count("\n") == 1
