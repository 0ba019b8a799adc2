"""The examples that draw bodies: every body and world, and where the goals of a run lead."""

from pathlib import Path

import matplotlib.image
import numpy as np
import pytest

from examples import pictures, vertices
from tests.unit.analytic_run import encoder, policy, write_run
from tests.unit.toy_room import skip_without_renderer


@pytest.fixture(autouse=True)
def _renderer() -> None:
    skip_without_renderer()


def test_every_body_and_world_is_drawn(tmp_path: Path) -> None:
    drawn = pictures.main(tmp_path)
    assert {path.stem for path in drawn} >= {"body-mitten-supine", "body-hand", *pictures.WORLDS}
    for path in drawn:
        pixels = matplotlib.image.imread(path)
        assert pixels.shape[:2] == (pictures.HEIGHT, pictures.WIDTH)
        assert pixels[..., :3].std() > 0.01, f"{path.stem} shows nothing"


def test_each_goal_of_a_run_is_pictured(tmp_path: Path) -> None:
    bent = (1.0, 1.0, 1.0)
    run = write_run(tmp_path / "run", [{"body": (encoder(bent), policy(bent))}], world="MimoFinger")
    assert vertices.main(str(run), tmp_path / "vertices.png") > 0.9
    flexed, extended = np.array_split(matplotlib.image.imread(tmp_path / "vertices.png")[..., :3], 2)
    assert min(flexed.std(), extended.std()) > 0.05
