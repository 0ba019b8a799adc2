"""Makes .venv with uv in it, using nothing but the standard library.

With Debian's python3-venv (or any complete Python) pip installs uv, so that pip's own settings
(mirror, certificates) hold. A bare Debian Python has no ensurepip; there the wheel of uv is taken
from the index, checked against the digest stated there, and unpacked.
"""

import hashlib
import io
import json
import os
import platform
import subprocess
import sys
import urllib.parse
import urllib.request
import venv
import zipfile
from pathlib import Path

UV_VERSION = "0.13.9"
VENV = Path(".venv")
DEADLINE_SECS = 120


def main() -> int:
    """Make the environment; returns the exit code."""
    if not (3, 11) <= sys.version_info < (3, 14):
        found = f"this is {platform.python_version()} ({sys.executable})"
        return _refuse(f"Babble needs Python 3.11, 3.12 or 3.13; {found}; try `make setup PYTHON=python3.11`")
    uv = VENV / "bin" / "uv"
    if not (VENV / "bin" / "python").exists():
        venv.create(VENV, with_pip=False, symlinks=True)
    if uv.exists() and UV_VERSION in subprocess.run([uv, "--version"], capture_output=True, text=True).stdout:
        return 0
    try:
        _install_with_pip() if _has_ensurepip() else _install_wheel(uv)
    except (OSError, subprocess.CalledProcessError, ValueError) as error:
        return _refuse(
            f"cannot install uv {UV_VERSION} into {VENV}: {error}; check the network and try again"
        )
    return 0


def _has_ensurepip() -> bool:
    try:
        import ensurepip  # noqa: F401
    except ImportError:
        return False
    return True


def _install_with_pip() -> None:
    python = str(VENV / "bin" / "python")
    subprocess.run([python, "-m", "ensurepip", "--default-pip"], check=True, stdout=subprocess.DEVNULL)
    command = [python, "-m", "pip", "install", "--quiet", "--disable-pip-version-check", f"uv=={UV_VERSION}"]
    subprocess.run(command, check=True)


def _install_wheel(uv: Path) -> None:
    name, url, sha256 = _wheel(platform.machine())
    with urllib.request.urlopen(url, timeout=DEADLINE_SECS) as download:
        wheel = download.read()
    if hashlib.sha256(wheel).hexdigest() != sha256:
        raise ValueError(f"{name} does not have the digest that the index states")
    with zipfile.ZipFile(io.BytesIO(wheel)) as archive:
        program = next(n for n in archive.namelist() if n.endswith("/scripts/uv"))
        uv.write_bytes(archive.read(program))
    uv.chmod(0o755)


def _wheel(machine: str) -> tuple[str, str, str]:
    """Name, address and digest of uv's Linux wheel, from the index's JSON form (PEP 691)."""
    page = f"{os.environ.get('PIP_INDEX_URL', 'https://pypi.org/simple').rstrip('/')}/uv/"
    request = urllib.request.Request(page, headers={"Accept": "application/vnd.pypi.simple.v1+json"})
    with urllib.request.urlopen(request, timeout=DEADLINE_SECS) as answer:
        files = json.load(answer)["files"]
    for file in files:
        name = file["filename"]
        if name.startswith(f"uv-{UV_VERSION}-") and "manylinux" in name and name.endswith(f"{machine}.whl"):
            return name, urllib.parse.urljoin(page, file["url"]), file["hashes"]["sha256"]
    raise ValueError(f"the index has no Linux wheel of it for {machine}")


def _refuse(sentence: str) -> int:
    print(sentence, file=sys.stderr)
    return 1


if __name__ == "__main__":
    sys.exit(main())
