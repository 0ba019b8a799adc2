"""What is in the images, how large they are, and what they may do."""

import json

import pytest

from tests.compose.projects import IMAGES, docker

ACTOR_MB = 220
"""Above its base. The official python:3.11-slim-bookworm has about 130 MB, so that it stays under 350."""
ALL = ("core", "actor", "dashboard", "learner", "recorder", "tools")
UNCOMPILED = """
import sys, {modules}
from pathlib import Path
ours = ("babble", "protocol", "services", "zenoh")
kept = {{n: getattr(m, "__cached__", None) for n, m in list(sys.modules.items()) if n.startswith(ours)}}
print([name for name, path in kept.items() if path and not Path(path).exists()])
"""
FORBIDDEN = """
import os
paths = [os.path.join(d, f) for d, _, fs in os.walk("/") if not d.startswith(("/proc", "/sys")) for f in fs]
keys = [p for p in paths if p.endswith(".pem") and "PRIVATE" in open(p).read()]
print(keys + [p for p in paths if p.endswith((".key", "/.env", "/uv")) or p.startswith("/runs/")])
"""

pytestmark = pytest.mark.usefixtures("images")


def size_mb(image: str) -> float:
    """In 10^6 bytes, as `docker images` shows it."""
    return float(docker("image", "inspect", "--format", "{{.Size}}", image)) / 1e6


def in_image(image: str, code: str) -> str:
    """What a piece of Python says in a container of the image that can reach nobody and write nowhere."""
    alone = ("--network", "none", "--read-only", "--user", "12345:12345", "--entrypoint", "python")
    return docker("run", "--rm", *alone, f"{IMAGES}-{image}", "-c", code).strip()


def test_the_actors_image_is_small_and_router_and_coordinator_have_a_smaller_one() -> None:
    base = size_mb("python:3.11-slim-bookworm")
    sizes = {image: size_mb(f"{IMAGES}-{image}") - base for image in ALL}
    assert sizes["actor"] <= ACTOR_MB, sizes
    assert sizes["core"] < sizes["actor"] < sizes["tools"] < sizes["learner"], sizes
    assert sizes["core"] < sizes["recorder"] < sizes["learner"], sizes


@pytest.mark.parametrize("image", ["core", "actor", "dashboard", "recorder", "tools"])
def test_only_learners_have_torch(image: str) -> None:
    assert in_image(image, "import importlib.util as u; print(u.find_spec('torch'))") == "None"


@pytest.mark.parametrize(
    ("image", "modules"),
    [
        ("core", "services.router.service, services.coordinator.service"),
        ("actor", "services.actor.service, babble.worlds"),
        ("dashboard", "services.dashboard.service"),
        ("learner", "services.encoder_learner.service, services.policy_learner.service"),
        ("recorder", "services.recorder.service, babble.worlds"),
        ("tools", "services.launcher.report, services.launcher.evaluate"),
    ],
)
def test_an_image_has_all_that_its_processes_load_compiled_and_for_any_user(image: str, modules: str) -> None:
    code = UNCOMPILED.format(modules=modules)
    assert in_image(image, code) == "[]"


@pytest.mark.parametrize("image", ALL)
def test_no_image_runs_as_root_or_holds_secrets_runs_or_installers(image: str) -> None:
    facts = json.loads(docker("image", "inspect", f"{IMAGES}-{image}"))[0]["Config"]
    assert facts["User"] == "1000:1000"
    assert in_image(image, FORBIDDEN) == "[]"
