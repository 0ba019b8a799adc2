"""Settings: unknown keys, bad values and combinations that cannot work are one sentence with the place."""

from pathlib import Path
from typing import Any

import pytest

from services.runtime.settings import SettingsError, load, parse

FILES = sorted((Path(__file__).parents[2] / "scenarios").glob("*.toml"))
SCENARIOS = [path for path in FILES if "[[condition]]" not in path.read_text(encoding="utf-8")]
"""Without the studies, which lie beside them."""


@pytest.mark.parametrize("path", SCENARIOS, ids=lambda path: path.stem)
def test_each_shipped_scenario_is_valid_and_named_after_its_file(path: Path) -> None:
    assert load(path).scenario == path.stem


@pytest.mark.parametrize(
    ("table", "sentence"),
    [
        ({"encoder": {"hiden": [3]}}, r"origin: encoder\.hiden: is not a known key"),
        (
            {"block": [{"name": "b", "latent_dim": 1}]},
            r"origin: block\.0\.latent_dim: .*greater than or equal to 2",
        ),
        ({"actors": {"count": 0}}, r"origin: actors\.count: .*greater than or equal to 1, got 0"),
        ({"block": [{"name": "b"}, {"name": "b"}]}, "block names must be distinct"),
        ({"block": [{"name": "all"}]}, "none may be 'all'"),
        ({"actors": {"envs_per_actor": 64}}, r"actors\.envs_per_actor: may be at most 48, .* got 64"),
        ({"encoder": {"blend": 0}}, r"encoder\.blend: .*greater than 0"),
        ({"policy": {"max_policy_lag": 0}}, r"policy\.max_policy_lag: .*greater than or equal to 1"),
        ({"goals": {"goal_weight": -1}}, r"goals\.goal_weight: .*greater than or equal to 0"),
        ({"goals": {"goal_weight": 0}}, "both 0, so nothing would be rewarded"),
        ({"goals": {"external_weight": float("inf")}}, r"goals\.external_weight: .*finite"),
        (
            {"evaluation": {"legs": 1024, "leg_steps": 1025}},
            r"origin: evaluation: legs x leg_steps may be at most 1,048,576, .* got 1049600",
        ),
        (
            {"view": {"latents_per_sec": 51}},
            r"origin: view\.latents_per_sec: .*less than or equal to 50, got 51",
        ),
        ({"view": {"poses_per_sec": -1}}, r"view\.poses_per_sec: .*greater than or equal to 0"),
        ({"view": {"images_per_sec": float("nan")}}, r"view\.images_per_sec: .*got nan"),
        ({"view": {"trail_steps": 1}}, r"view\.trail_steps: .*greater than or equal to 2"),
        ({"view": {"columns": 0}}, r"view\.columns: .*greater than or equal to 1"),
        ({"seed": -1}, r"origin: seed: .*greater than or equal to 0"),
    ],
)
def test_what_cannot_work_is_refused_with_its_place(table: dict[str, Any], sentence: str) -> None:
    with pytest.raises(SettingsError, match=sentence.lower()) as refusal:
        parse({"scenario": "x", **table}, origin="origin")
    assert "\n" not in str(refusal.value)


def test_a_file_that_is_no_toml_is_refused_with_the_line(tmp_path: Path) -> None:
    path = tmp_path / "broken.toml"
    path.write_text('scenario = "x"\nworld = = 1\n')
    with pytest.raises(SettingsError, match=r"broken\.toml is not valid TOML: .*line 2"):
        load(path)


def test_the_science_and_the_settings_have_the_same_defaults() -> None:
    from babble.policy.sb3 import PPOSettings

    policy = parse({"scenario": "x"}, origin="x").policy.model_dump()
    science = PPOSettings()
    for name, value in policy.items():
        if hasattr(science, name):
            ours = getattr(science, name)
            assert (list(ours) if isinstance(ours, tuple) else ours) == value, name
