"""Makes .venv with uv in it, using nothing but the standard library.

With Debian's python3-venv (or any complete Python) pip installs uv, so that pip's own settings
(mirror, certificates) hold. A bare Debian Python has no ensurepip; there the wheel of uv is taken
from PyPI, checked against the digest that PyPI states, and unpacked.
"""

import hashlib
import io
import json
import platform
import subprocess
import sys
import urllib.request
import venv
import zipfile
from pathlib import Path

UV_VERSION = "0.13.9"
VENV = Path(".venv")
DEADLINE_SECS = 120


def main() -> int:
    """Make the environment; returns the exit code."""
    if sys.version_info < (3, 11):
        return _refuse(f"Babble needs Python 3.11 or newer; this is {platform.python_version()} ({sys.executable})")
    uv = VENV / "bin" / "uv"
    if not (VENV / "bin" / "python").exists():
        venv.create(VENV, with_pip=False, symlinks=True)
    if uv.exists() and UV_VERSION in subprocess.run([uv, "--version"], capture_output=True, text=True).stdout:
        return 0
    try:
        _install_with_pip() if _has_ensurepip() else _install_wheel(uv)
    except (OSError, subprocess.CalledProcessError, ValueError) as error:
        return _refuse(f"cannot install uv {UV_VERSION} into {VENV}: {error}; check the network and try again")
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
    with urllib.request.urlopen(f"https://pypi.org/pypi/uv/{UV_VERSION}/json", timeout=DEADLINE_SECS) as page:
        files = json.load(page)["urls"]
    machine = platform.machine()
    chosen = [f for f in files if f["filename"].endswith(f"manylinux2014_{machine}.whl") or
              ("manylinux" in f["filename"] and machine in f["filename"])]
    if not chosen:
        raise ValueError(f"PyPI has no Linux wheel of it for {machine}")
    with urllib.request.urlopen(chosen[0]["url"], timeout=DEADLINE_SECS) as download:
        wheel = download.read()
    if hashlib.sha256(wheel).hexdigest() != chosen[0]["digests"]["sha256"]:
        raise ValueError("the downloaded wheel does not have the digest that PyPI states")
    with zipfile.ZipFile(io.BytesIO(wheel)) as archive:
        name = next(n for n in archive.namelist() if n.endswith("/scripts/uv"))
        uv.write_bytes(archive.read(name))
    uv.chmod(0o755)


def _refuse(sentence: str) -> int:
    print(sentence, file=sys.stderr)
    return 1


if __name__ == "__main__":
    sys.exit(main())
