"""The manifest for Kubernetes says what the code reads, and grants no more than an actor needs."""

import importlib.util
import re
import subprocess
import sys
from pathlib import Path, PurePosixPath
from typing import Any

import pytest
import yaml

from services.runtime import health
from services.runtime.credentials import CREDENTIAL_VARIABLE
from services.runtime.process import ENDPOINT_VARIABLE, RUN_VARIABLE, STOP_SECS
from services.runtime.transport import parse_address

ROOT = Path(__file__).resolve().parents[2]
MANIFEST = ROOT / "deploy" / "kubernetes" / "actors.yaml"
VALIDATOR = "kubernetes-validate"
VALIDATOR_VERSION = "1.37.0"

Table = dict[str, Any]


@pytest.fixture(scope="module")
def documents() -> dict[str, Table]:
    """The objects by their kind; one of each."""
    found = list(yaml.safe_load_all(MANIFEST.read_text()))
    assert len({document["kind"] for document in found}) == len(found)
    return {document["kind"]: document for document in found}


@pytest.fixture
def pod(documents: dict[str, Table]) -> Table:
    pod: Table = documents["Deployment"]["spec"]["template"]["spec"]
    return pod


@pytest.fixture
def container(pod: Table) -> Table:
    (container,) = pod["containers"]
    assert isinstance(container, dict)
    return container


@pytest.fixture
def environment(container: Table) -> dict[str, str]:
    return {entry["name"]: entry["value"] for entry in container["env"]}


def test_it_sets_the_variables_that_an_actor_reads(environment: dict[str, str]) -> None:
    assert set(environment) == {ENDPOINT_VARIABLE, RUN_VARIABLE, CREDENTIAL_VARIABLE, health.VARIABLE}
    assert parse_address(environment[ENDPOINT_VARIABLE]).protocol == "tls"


def test_its_commands_are_modules_that_there_are(container: Table) -> None:
    probes = [container[f"{name}Probe"]["exec"]["command"] for name in ("startup", "readiness", "liveness")]
    assert [*map(tuple, probes)] == [("python", "-m", "services.runtime.health")] * 3
    for command in (container["command"], *probes):
        assert importlib.util.find_spec(command[2]) is not None


def test_the_credential_is_a_secret_that_the_manifest_does_not_hold(
    documents: dict[str, Table], pod: Table, container: Table, environment: dict[str, str]
) -> None:
    assert "Secret" not in documents
    path = PurePosixPath(environment[CREDENTIAL_VARIABLE])
    (mount,) = (m for m in container["volumeMounts"] if m["mountPath"] == str(path.parent))
    assert mount["readOnly"]
    (volume,) = (v for v in pod["volumes"] if v["name"] == mount["name"])
    readme = MANIFEST.with_name("README.md").read_text()
    assert f"secret generic {volume['secret']['secretName']} --from-file={path.name}=" in readme


def test_all_that_is_written_is_written_to_memory(
    pod: Table, container: Table, environment: dict[str, str]
) -> None:
    writable = {m["mountPath"]: m["name"] for m in container["volumeMounts"] if not m.get("readOnly")}
    assert set(writable) == {"/tmp"}
    assert PurePosixPath(environment[health.VARIABLE]).parent == PurePosixPath("/tmp")
    (volume,) = (v for v in pod["volumes"] if v["name"] == writable["/tmp"])
    assert volume["emptyDir"]["medium"] == "Memory"


def test_it_asks_for_no_rights(documents: dict[str, Table], pod: Table, container: Table) -> None:
    assert documents["Namespace"]["metadata"]["labels"]["pod-security.kubernetes.io/enforce"] == "restricted"
    assert pod["automountServiceAccountToken"] is False
    assert pod["securityContext"]["runAsNonRoot"] is True
    assert pod["securityContext"]["seccompProfile"] == {"type": "RuntimeDefault"}
    assert container["securityContext"] == {
        "allowPrivilegeEscalation": False,
        "readOnlyRootFilesystem": True,
        "capabilities": {"drop": ["ALL"]},
    }
    assert not {"hostNetwork", "hostPID", "hostIPC"} & set(pod)


def test_it_runs_as_the_user_of_the_image(pod: Table) -> None:
    user = re.search(r" AS actor\n.*?^USER (\d+):(\d+)$", _dockerfile(), re.DOTALL | re.MULTILINE)
    assert user is not None
    context = pod["securityContext"]
    assert (context["runAsUser"], context["runAsGroup"]) == (int(user[1]), int(user[2]))


def test_an_actor_has_time_to_end_in_order(pod: Table) -> None:
    assert pod["terminationGracePeriodSeconds"] > STOP_SECS


def test_the_network_policy_is_for_these_pods_and_leaves_only_the_router(
    documents: dict[str, Table], environment: dict[str, str]
) -> None:
    policy, deployment = documents["NetworkPolicy"], documents["Deployment"]
    labels = deployment["spec"]["template"]["metadata"]["labels"]
    assert policy["spec"]["podSelector"]["matchLabels"] == labels
    assert deployment["spec"]["selector"]["matchLabels"] == labels
    assert {document["metadata"].get("namespace") for document in (policy, deployment)} == {"babble"}
    assert set(policy["spec"]["policyTypes"]) == {"Ingress", "Egress"}
    assert "ingress" not in policy["spec"]
    router = parse_address(environment[ENDPOINT_VARIABLE])
    assert policy["spec"]["egress"] == [
        {
            "to": [{"ipBlock": {"cidr": f"{router.host}/32"}}],
            "ports": [{"protocol": "TCP", "port": router.port}],
        }
    ]


@pytest.mark.slow
def test_it_fits_the_schema_of_kubernetes(tmp_path: Path) -> None:
    good = _validate(MANIFEST)
    assert good.returncode == 0, good.stdout + good.stderr
    wrong = tmp_path / "wrong.yaml"
    wrong.write_text(MANIFEST.read_text().replace("readOnlyRootFilesystem", "readOnlyRootFileSystem"))
    assert _validate(wrong).returncode != 0


def _dockerfile() -> str:
    return (ROOT / "deploy" / "Dockerfile").read_text()


def _validate(path: Path) -> subprocess.CompletedProcess[str]:
    """Run the validator, which uv fetches when it is not here yet (108 MB, so it is no dependency)."""
    uv = Path(sys.executable).with_name("uv")
    package = f"{VALIDATOR}=={VALIDATOR_VERSION}"
    command = [uv, "tool", "run", "--from", package, VALIDATOR, "--strict", path]
    return subprocess.run(command, capture_output=True, text=True, timeout=200)
