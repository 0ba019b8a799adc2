"""The compose files say what deploy/README.md promises, without an engine."""

import importlib.util
import re
from pathlib import Path
from typing import Any

import pytest
import yaml

from services.runtime.sharing import VARIABLE as LEARNER_INDEX

ROOT = Path(__file__).resolve().parents[2]
DEPLOY = ROOT / "deploy"
FILES = {name: DEPLOY / f"compose{name}.yaml" for name in ("", ".hosts", ".actors")}
ONE_HOST, HOSTS, ACTORS = FILES[""], FILES[".hosts"], FILES[".actors"]
VARIABLE = re.compile(r"\$\{(BABBLE_[A-Z_]+)")


def services(path: Path) -> dict[str, Any]:
    """The services of a file, with its anchors resolved."""
    found: dict[str, Any] = yaml.safe_load(path.read_text())["services"]
    return found


HARDENED = [(path.name, name) for path in (ONE_HOST, ACTORS) for name in services(path)]


def test_the_root_file_is_the_one_host_file() -> None:
    assert yaml.safe_load((ROOT / "compose.yaml").read_text())["include"] == ["deploy/compose.yaml"]


def test_one_host_publishes_on_loopback_only_and_lets_nobody_out_but_for_that() -> None:
    ports = {name: service["ports"] for name, service in services(ONE_HOST).items() if "ports" in service}
    assert set(ports) == {"dashboard", "view"}
    assert all(port.startswith("127.0.0.1:") for listed in ports.values() for port in listed)
    networks = yaml.safe_load(ONE_HOST.read_text())["networks"]
    outside = {name for name, network in networks.items() if not network.get("internal")}
    assert outside == {"outside"}
    assert {
        name for name, service in services(ONE_HOST).items() if "outside" in service.get("networks", [])
    } == set(ports)


def test_actors_share_a_network_with_the_router_alone() -> None:
    there = {name for name, service in services(ONE_HOST).items() if "actors" in service.get("networks", [])}
    assert there == {"router", "actor"}
    assert services(ONE_HOST)["actor"]["networks"] == ["actors"]
    assert "volumes" not in services(ONE_HOST)["actor"]


@pytest.mark.parametrize(("file", "name"), HARDENED)
def test_every_container_is_read_only_without_rights_and_bounded(file: str, name: str) -> None:
    service = services(DEPLOY / file)[name]
    assert service["read_only"] is True
    assert service["cap_drop"] == ["ALL"]
    assert service["security_opt"] == ["no-new-privileges:true"]
    assert service["user"] == "${BABBLE_UID:-1000}:${BABBLE_GID:-1000}"
    assert service["init"] is True
    assert service["tmpfs"] == ["/tmp:size=256m,mode=1777"]
    assert set(service["logging"]["options"]) == {"max-size", "max-file"}
    assert service["restart"] == "no" or re.fullmatch(r"on-failure:\d+", service["restart"])
    assert not {"privileged", "cap_add", "pid", "ipc", "devices"} & set(service)


def test_over_several_hosts_everybody_has_a_credential_of_its_own_and_nobody_talks_plainly() -> None:
    overlay = services(HOSTS)
    assert set(overlay) == set(services(ONE_HOST)) - {"prepare", "view"}
    assert overlay["router"]["environment"]["BABBLE_LISTEN"].startswith("tls/")
    assert overlay["router"]["environment"]["BABBLE_PLAIN"] == "0"
    others = {name: service for name, service in overlay.items() if name != "router"}
    assert all(service["environment"]["BABBLE_CONNECT"].startswith("tls/") for service in others.values())
    sources = {name: service["secrets"][0]["source"] for name, service in others.items()}
    assert sources == {**{name: name for name in others}, "report": "launcher", "babble": "launcher"}


def test_the_second_learners_differ_from_the_first_in_their_index_alone() -> None:
    added = services(DEPLOY / "compose.learners.yaml")
    for kind in ("encoder_learner", "policy_learner"):
        assert added.pop(f"{kind}_1") == {
            "extends": {"file": ONE_HOST.name, "service": kind},
            "environment": {LEARNER_INDEX: "1"},
        }
        assert LEARNER_INDEX not in services(ONE_HOST)[kind]["environment"], "the first has index 0"
    assert not added


def test_no_file_holds_a_secret() -> None:
    for path in [*DEPLOY.iterdir(), ROOT / "compose.yaml", ROOT / ".env.example", ROOT / ".dockerignore"]:
        if path.is_file():
            assert "PRIVATE KEY" not in path.read_text()
            assert not re.search(r"(?i)(password|token|secret)\s*[=:]\s*['\"]?\w{6}", path.read_text()), path


@pytest.mark.parametrize("path", FILES.values(), ids=lambda path: path.name)
def test_every_variable_is_explained_in_the_readme_and_in_the_example(path: Path) -> None:
    readme, example = (DEPLOY / "README.md").read_text(), (ROOT / ".env.example").read_text()
    for name in set(VARIABLE.findall(path.read_text())):
        assert f"`{name}`" in readme, f"{name} is not in deploy/README.md"
        assert re.search(rf"^#? ?{name}=", example, re.MULTILINE), f"{name} is not in .env.example"


def test_the_images_are_built_with_the_uv_of_a_checkout() -> None:
    spec = importlib.util.spec_from_file_location("bootstrap", DEPLOY / "bootstrap.py")
    assert spec is not None
    assert spec.loader is not None
    bootstrap = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(bootstrap)
    assert f"ARG UV_VERSION={bootstrap.UV_VERSION}\n" in (DEPLOY / "Dockerfile").read_text()


def test_old_engines_can_build_the_images() -> None:
    text = (DEPLOY / "Dockerfile").read_text()
    assert "syntax=" not in text, "it would fetch a frontend"
    assert "<<" not in text, "heredocs need a newer frontend"


def test_the_builder_is_sent_only_what_is_listed() -> None:
    rules = [line for line in (ROOT / ".dockerignore").read_text().splitlines() if line and line[0] != "#"]
    assert rules[0] == "*"
    assert {"**/*.pem", "**/*.key"} <= set(rules[rules.index("!scenarios/**") :])
