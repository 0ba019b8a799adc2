"""`babble doctor`: what is missing on this machine, and what to install."""

import argparse
import importlib
import os
import platform
import re
import shutil
import subprocess
import sys
import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from importlib import metadata
from pathlib import Path

from babble.worlds import gl_advice
from services.launcher.address import CERTS, address_of
from services.launcher.dashboard import Choice, PortError, Ports, words
from services.launcher.run_folder import RUNS, installed
from services.runtime.credentials import WARN_DAYS, CredentialError, load_credential
from services.runtime.errors import BusError
from services.runtime.settings import SettingsError

OLDEST_PYTHON = (3, 11)
TOO_NEW_PYTHON = (3, 14)
LEAST_DISK_BYTES = 200 << 20
LEAST_MEMORY_BYTES = 2 << 30
"""Both learners need about 0.7 GB each, nearly all of it torch."""
LEAST_CORES = 2
ROUTER_SECS = 10.0
DOCKER_SECS = 5.0
MOST_BAD = 3


@dataclass(frozen=True, kw_only=True)
class Finding:
    """One thing that was looked at."""

    what: str
    text: str
    good: bool
    needed: bool = True
    """False for what only makes a run slow, or is needed for other uses only"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The arguments of `babble doctor`: none."""


def run(arguments: argparse.Namespace) -> int:
    """Print what was found; returns 1 if something is missing that `babble up` needs."""
    missing = False
    for finding in examine():
        mark = "ok" if finding.good else "MISSING" if finding.needed else "note"
        missing = missing or (finding.needed and not finding.good)
        print(f"{mark:<7}  {finding.what:<12}  {finding.text}", flush=True)
    print("\nsomething is missing; see above" if missing else "\n`babble up cuboid` can run here")
    return int(missing)


def examine() -> Iterable[Finding]:
    """All findings, the cheap ones first."""
    yield _python()
    for extra in ("router", "coordinator", "actor", "learner", "recorder", "launcher"):
        yield packages(extra, requirements(extra), installed)
    yield _onnxruntime()
    yield _eyes()
    yield dashboard_finding(installed)
    yield _router()
    yield _disk()
    yield _machine()
    yield docker_finding(shutil.which("docker"))
    if CERTS.is_dir():
        yield certificates(CERTS, datetime.now(UTC))


def requirements(extra: str) -> list[str]:
    """The names of the packages that an extra of babble asks for, also through other extras; sorted."""
    names: set[str] = set()
    for requirement in metadata.requires("babble") or []:
        if "extra ==" in requirement and not re.search(rf"extra == ['\"]{extra}['\"]", requirement):
            continue
        name, nested = _name_and_extras(requirement)
        if name != "babble":
            names.add(name)
        for inner in nested if name == "babble" else ():
            names.update(requirements(inner))
    return sorted(names)


def packages(extra: str, names: Iterable[str], version_of: Callable[[str], str | None]) -> Finding:
    """Whether the packages of an extra are there."""
    versions = {name: version_of(name) for name in names}
    if missing := [name for name, version in versions.items() if version is None]:
        what_to_do = (
            f"install it with `make setup`, or `.venv/bin/uv sync --locked --inexact --extra {extra}`"
        )
        return Finding(what=extra, text=f"without {', '.join(missing)}; {what_to_do}", good=False)
    return Finding(
        what=extra, text=", ".join(f"{name} {version}" for name, version in versions.items()), good=True
    )


def dashboard_finding(version_of: Callable[[str], str | None]) -> Finding:
    """Whether a run would have a dashboard here, and where; a run goes on without one."""
    found = packages("dashboard", requirements("dashboard"), version_of)
    if not found.good:
        return replace(found, text=f"{found.text}; a run goes on without a dashboard", needed=False)
    try:
        with Ports(Choice()) as ports:
            where = words(Choice(), ports)
    except PortError as error:
        return replace(found, text=str(error), good=False, needed=False)
    rerun = version_of("rerun-sdk")
    return replace(
        found,
        text=f"rerun-sdk {rerun}; a run's would be at {where}, for any browser with WebGL 2",
        needed=False,
    )


def docker_finding(docker: str | None) -> Finding:
    """Whether `docker compose up` could work here; `babble up` needs none of it."""
    use = "needed only for `docker compose up`"
    if docker is None:
        return Finding(what="docker", text=f"not found; {use}", good=False, needed=False)
    engine = _said(docker, "version", "--format", "{{.Server.Version}}")
    compose = _said(docker, "compose", "version", "--short")
    text = f"engine {engine or 'none answers'}, compose {compose or 'not found'}"
    if not engine:
        text += f"; start the engine, or join its group (`docker version` says more); {use}"
    elif not compose:
        text += f"; install the plugin docker-compose-plugin (v2); {use}"
    return Finding(what="docker", text=text, good=bool(engine and compose), needed=False)


def certificates(folder: Path, now: datetime) -> Finding:
    """Which of the credentials in the folder, and beside its router, cannot be used or soon cannot."""
    bad, ends = [], list[datetime]()
    paths = [path for path in (*folder.glob("*.pem"), *folder.glob("router/*.pem")) if path.name != "ca.pem"]
    for path in sorted(paths):
        try:
            end = load_credential(path).not_after
        except CredentialError as error:
            bad.append(str(error))
            continue
        ends.append(end)
        left_days = (end - now).days
        if left_days < WARN_DAYS:
            bad.append(f"{path} expire{'d' if end <= now else 's'} on {end:%Y-%m-%d}")
    if bad:
        text = "; ".join(bad[:MOST_BAD]) + (
            f"; and {len(bad) - MOST_BAD} more" if len(bad) > MOST_BAD else ""
        )
        what_to_do = "see `babble certs list`, renew with `babble certs renew --soon`"
        return Finding(what="certificates", text=f"{text}; {what_to_do}", good=False, needed=False)
    until = f", all good until {min(ends):%Y-%m-%d}" if ends else ""
    return Finding(what="certificates", text=f"{len(ends)} credentials in {folder}/{until}", good=True)


def _said(*command: str) -> str:
    """The first line that a program says; empty if it fails or says nothing in time."""
    try:
        said = subprocess.run(command, capture_output=True, text=True, timeout=DOCKER_SECS, check=True)
    except (OSError, subprocess.SubprocessError):
        return ""
    return said.stdout.strip().partition("\n")[0]


def _python() -> Finding:
    good = OLDEST_PYTHON <= sys.version_info < TOO_NEW_PYTHON
    text = f"{platform.python_version()} at {sys.executable}"
    return Finding(
        what="python", text=text if good else f"{text}; install Python 3.11, 3.12 or 3.13", good=good
    )


def _onnxruntime() -> Finding:
    try:
        onnxruntime = importlib.import_module("onnxruntime")
        providers = onnxruntime.get_available_providers()
    except ImportError as error:
        return Finding(what="onnxruntime", text=f"does not load ({error}); reinstall onnxruntime", good=False)
    good = "CPUExecutionProvider" in providers
    return Finding(what="onnxruntime", text=f"loads; it can run models on {', '.join(providers)}", good=good)


def _eyes() -> Finding:
    """Whether bodies that see can: draws one small picture."""
    use = "needed only for the sense of vision and for pictures of bodies"
    try:
        rendering = importlib.import_module("babble.worlds.senses.rendering")
        mujoco = importlib.import_module("mujoco")
    except (ImportError, AttributeError, OSError, RuntimeError) as error:
        return Finding(what="mujoco", text=f"does not load ({error}){gl_advice()}", good=False)
    model = mujoco.MjModel.from_xml_string("<mujoco><worldbody><geom size='1'/></worldbody></mujoco>")
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    try:
        rendering.picture(model, data, width=16, height=16)
    except ValueError as error:
        return Finding(what="vision", text=f"{error}; {use}", good=False, needed=False)
    return Finding(what="vision", text="pictures can be drawn without a screen", good=True)


def _router() -> Finding:
    """Starts a router on this machine and connects to it."""
    try:
        from services.runtime.bus import Wakeup
        from services.runtime.zenoh_bus import ZenohBus

        endpoint = address_of(None).connect
        command = [sys.executable, "-m", "services.router", "--listen", endpoint]
        with subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL) as router:
            try:
                began_secs = time.monotonic()
                ZenohBus(endpoint, "doctor", Wakeup(), ROUTER_SECS).close()
                took_secs = time.monotonic() - began_secs
            finally:
                router.terminate()
    except (ImportError, BusError, SettingsError) as error:
        return Finding(what="router", text=f"{error}; is a firewall in the way on 127.0.0.1?", good=False)
    return Finding(what="router", text=f"started and reached at {endpoint} in {took_secs:.1f} s", good=True)


def _disk() -> Finding:
    folder = RUNS if RUNS.is_dir() else RUNS.parent
    free = shutil.disk_usage(folder).free
    writable = os.access(folder, os.W_OK)
    text = f"{free / 1e9:,.1f} GB free for {RUNS}/"
    if not writable:
        text = f"{folder.resolve()} cannot be written; change to another folder, or use --run-dir"
    elif free < LEAST_DISK_BYTES:
        text += f"; make room, a run needs up to {LEAST_DISK_BYTES / 1e9:.1f} GB"
    return Finding(what="disk", text=text, good=writable and free >= LEAST_DISK_BYTES)


def _machine() -> Finding:
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    memory = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    good = cores >= LEAST_CORES and memory >= LEAST_MEMORY_BYTES
    text = f"{cores} cores, {memory / 1e9:.1f} GB of memory"
    if not good:
        text += f"; slow with fewer than {LEAST_CORES} cores or {LEAST_MEMORY_BYTES / 1e9:.0f} GB"
    return Finding(what="machine", text=text, good=good, needed=False)


def _name_and_extras(requirement: str) -> tuple[str, list[str]]:
    found = re.match(r"([A-Za-z0-9._-]+)(?:\[([^\]]*)\])?", requirement)
    assert found is not None
    return found[1], [extra.strip() for extra in (found[2] or "").split(",") if extra.strip()]
