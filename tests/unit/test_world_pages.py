"""Each simulated world has a page that shows it and names its parameters."""

import re
import tomllib
from pathlib import Path

import pytest

from babble.worlds import WORLDS
from babble.worlds.physics.env import BodyParameters, MujocoEnv

PAGES = Path(__file__).parents[2] / "docs/worlds"
SIMULATED = [id for id, entry in WORLDS.items() if issubclass(entry.maker, MujocoEnv)]


def page_of(id: str) -> Path:
    return PAGES / (re.sub(r"(?<=[a-z])(?=[A-Z])", "-", id).lower() + ".md")


@pytest.mark.parametrize("id", SIMULATED)
def test_a_page_names_the_parameters_that_are_the_worlds_own(id: str) -> None:
    text = page_of(id).read_text()
    shared = BodyParameters()
    own = {
        name
        for name, value in WORLDS[id].defaults.items()
        if value != getattr(shared, name, value) or not hasattr(shared, name)
    }
    named = {part for row in re.findall(r"^\| (`.+?) \|", text, re.M) for part in re.findall(r"`(\w+)`", row)}
    assert own <= named


@pytest.mark.parametrize("id", SIMULATED)
def test_the_defaults_that_a_page_states_are_the_worlds(id: str) -> None:
    rows = re.findall(r"^\| `(\w+)` \| `?([^|`]+)`? \|", page_of(id).read_text(), re.M)
    stated = {name: tomllib.loads(f"value = {value.strip()}")["value"] for name, value in rows}
    defaults = {name: list(v) if isinstance(v, tuple) else v for name, v in WORLDS[id].defaults.items()}
    assert stated == {name: defaults[name] for name in stated}


@pytest.mark.parametrize("page", sorted(PAGES.glob("*.md")), ids=lambda page: page.stem)
def test_pictures_and_links_of_a_page_exist(page: Path) -> None:
    links = re.findall(r"\]\(([^)#:]+)[^)]*\)", page.read_text())
    missing = [link for link in links if link != "https" and not (page.parent / link).exists()]
    assert not missing


def test_the_list_of_shared_parameters_is_whole() -> None:
    text = (PAGES / "README.md").read_text()
    assert [name for name in vars(BodyParameters()) if f"`{name}`" not in text] == []
    assert [id for id in SIMULATED if f"[`{id}`]({page_of(id).name})" not in text] == []
