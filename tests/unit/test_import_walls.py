"""What each process loads, and above all what it does not (each in a fresh interpreter)."""

import json
import subprocess
import sys

import pytest

SCIENCE = {"torch", "stable_baselines3", "onnx", "mujoco"}
WORLDS = {"babble", "gymnasium", "onnxruntime"}


def loaded_by(module: str) -> set[str]:
    """The top-level packages in memory after importing a module."""
    program = (
        f"import importlib, json, sys; importlib.import_module({module!r}); "
        "print(json.dumps(sorted({name.partition('.')[0] for name in sys.modules})))"
    )
    done = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, timeout=60, check=True
    )
    return set(json.loads(done.stdout))


@pytest.mark.parametrize(
    ("module", "absent", "present"),
    [
        ("services.actor.__main__", SCIENCE, {"onnxruntime"}),
        ("services.coordinator.__main__", SCIENCE | WORLDS, {"protocol"}),
        ("services.router.__main__", SCIENCE | WORLDS, {"services"}),
        ("services.launcher.__main__", SCIENCE | {"onnxruntime", "matplotlib"}, {"services"}),
        ("services.recorder.__main__", {"torch", "stable_baselines3", "onnx", "onnxruntime"}, {"pyarrow"}),
        ("services.dashboard.__main__", {"torch", "stable_baselines3", "onnx", "onnxruntime"}, {"rerun"}),
        ("services.runtime.zenoh_bus", SCIENCE | WORLDS, {"zenoh"}),
        ("services.runtime.process", SCIENCE | WORLDS | {"zenoh"}, {"protocol"}),
        ("babble.worlds", SCIENCE | {"zenoh", "protocol", "services"}, {"babble"}),
        ("babble.recording", SCIENCE | {"pyarrow", "zenoh", "protocol", "services"}, {"numpy"}),
        ("babble.policy.act", SCIENCE | {"zenoh", "protocol", "services"}, {"onnxruntime"}),
        ("protocol.gate", SCIENCE | WORLDS | {"zenoh", "services"}, {"msgpack"}),
    ],
)
def test_a_process_loads_only_what_it_needs(module: str, absent: set[str], present: set[str]) -> None:
    loaded = loaded_by(module)
    assert present <= loaded
    assert not absent & loaded
