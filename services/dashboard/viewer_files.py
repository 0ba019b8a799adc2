"""The web viewer's files: taken out of the installed rerun once per version, kept gzipped.

They lie inside rerun's own program, so it is started for a moment as a web server of this machine
alone, asked for them, and stopped. The cache holds them with a manifest of sizes and digests; what
does not agree with it is made anew. A server holds them in memory (14 MB), so that it does without the
cache: one that cannot be written, or that is deleted meanwhile.
"""

import hashlib
import http.client
import json
import logging
import os
import re
import subprocess
import tempfile
import threading
import time
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from importlib import metadata, util
from pathlib import Path

from services.runtime.checkpoint import write_atomically
from services.runtime.errors import StorageError, UserError
from services.runtime.tether import tethered

log = logging.getLogger(__name__)

NAMES = ("favicon.ico", "re_viewer.js", "re_viewer_bg.wasm")
MANIFEST = "manifest.json"
START_SECS = 60.0
"""So long may rerun take until it says where it serves."""
FETCH_SECS = 120.0
"""So long may one file take; all three take 2 to 6 s, and a minute on a machine that is very busy."""
STOP_SECS = 5.0
READ_BYTES = 1 << 20
GZIP_LEVEL = 6
"""Level 9 takes twice as long for 0.5 % less."""
SERVES = re.compile(r"Hosting a web-viewer at http://127\.0\.0\.1:(\d+)")
NOWHERE = "http://127.0.0.1:9/none.rrd"
"""Given something to show, rerun opens no port but the web server's; nobody fetches it."""


class ViewerFilesError(UserError):
    """The viewer's files cannot be had."""


@dataclass(frozen=True)
class ViewerFile:
    """One file of the viewer."""

    gzipped: bytes
    raw_bytes: int
    """Its size when unpacked."""
    sha256: str
    """Of the gzipped contents."""

    @classmethod
    def of(cls, gzipped: bytes, raw_bytes: int) -> "ViewerFile":
        """These contents, and their digest."""
        return cls(gzipped, raw_bytes, hashlib.sha256(gzipped).hexdigest())


@dataclass(frozen=True)
class ViewerFiles:
    """All files of one version of the viewer."""

    files: dict[str, ViewerFile]

    @property
    def digest(self) -> str:
        """Names these very files: 16 hexadecimal digits."""
        together = "".join(self.files[name].sha256 for name in NAMES)
        return hashlib.sha256(together.encode()).hexdigest()[:16]


def viewer_files(cancelled: threading.Event, cache: Path | None = None) -> ViewerFiles:
    """The files of the installed version; makes them if the cache has none that are whole.

    Takes about 40 ms from the cache and 3 s otherwise. A cache that cannot be written is done without.
    Raises `ViewerFilesError`.
    """
    try:
        version = metadata.version("rerun-sdk")
    except metadata.PackageNotFoundError:
        raise ViewerFilesError(
            "rerun-sdk is not installed here, so there is no viewer to serve; "
            "install it with `make setup`, or `.venv/bin/uv sync --locked --inexact --extra dashboard`"
        ) from None
    folder = (cache or cache_folder()) / f"viewer-{version}"
    if found := _stored(folder):
        return found
    started_secs = time.monotonic()
    try:
        fetched = _fetch_all(cancelled)
    except OSError as error:
        raise ViewerFilesError(f"the viewer's files cannot be made ready here: {error}; make room") from None
    made = ViewerFiles({name: ViewerFile.of(*contents) for name, contents in fetched.items()})
    try:
        _store(folder, made)
    except StorageError as error:
        log.warning("the viewer's files are not kept for the next time: %s", error.__cause__ or error)
    log.info("made the viewer's files ready in %.1f s", time.monotonic() - started_secs)
    return made


def cache_folder() -> Path:
    """Babble's folder in the user's cache ($XDG_CACHE_HOME, else ~/.cache)."""
    given = os.environ.get("XDG_CACHE_HOME", "")
    # By the XDG specification a path that is not absolute is not to be used.
    return (Path(given) if os.path.isabs(given) else Path(os.path.expanduser("~/.cache"))) / "babble"


def rerun_program() -> Path:
    """The rerun program of the installed package. Raises `ViewerFilesError`."""
    spec = util.find_spec("rerun_cli")
    program = Path(spec.origin).with_name("rerun") if spec is not None and spec.origin else None
    if program is None or not program.is_file():
        raise ViewerFilesError(
            "the installed rerun-sdk has no rerun program; install it again with `make setup`"
        )
    return program


def quiet_environment(folder: Path) -> dict[str, str]:
    """This environment, in which rerun sends no analytics and writes only into `folder`.

    Writes the settings that say so. There is no environment variable for it.
    """
    config, data = folder / "config", folder / "data"
    settings = {
        "analytics_enabled": False,
        "analytics_id": "",
        "metadata": {},
        "config_file_path": str(config / "rerun" / "analytics.json"),
        "data_dir_path": str(data),
    }
    (config / "rerun").mkdir(parents=True, exist_ok=True)
    (config / "rerun" / "analytics.json").write_text(json.dumps(settings))
    ours = {"XDG_CONFIG_HOME": str(config), "XDG_DATA_HOME": str(data)}
    return {**os.environ, **ours, "NO_COLOR": "1"}


def stop(child: "subprocess.Popen[bytes]") -> None:
    """End a process, by force if it takes longer than STOP_SECS."""
    child.terminate()
    try:
        child.wait(STOP_SECS)
    except subprocess.TimeoutExpired:
        child.kill()
        child.wait(STOP_SECS)


def _gzipped(folder: Path, name: str) -> Path:
    return folder / f"{name}.gz"


def _stored(folder: Path) -> ViewerFiles | None:
    """What lies in the folder, if it is all there and is what its manifest says."""
    try:
        rows = {row["name"]: row for row in json.loads((folder / MANIFEST).read_bytes())}
        files = {}
        for name in NAMES:
            files[name] = ViewerFile.of(_gzipped(folder, name).read_bytes(), int(rows[name]["raw_bytes"]))
            if files[name].sha256 != rows[name]["sha256"]:
                raise ValueError(f"{name} is not what was stored")
    except (FileNotFoundError, NotADirectoryError):
        return None
    except (OSError, ValueError, TypeError, KeyError) as error:
        log.warning("the viewer's files in %s are damaged (%s) and are made anew", folder, error)
        return None
    return ViewerFiles(files)


def _store(folder: Path, made: ViewerFiles) -> None:
    """Write files, and last the manifest that declares them whole. Raises `StorageError`.

    Another process may do the same at this moment: it writes the same bytes.
    """
    rows = []
    for name, file in made.files.items():
        write_atomically(_gzipped(folder, name), file.gzipped)
        rows.append({"name": name, "raw_bytes": file.raw_bytes, "sha256": file.sha256})
    write_atomically(folder / MANIFEST, json.dumps(rows).encode())


def _fetch_all(cancelled: threading.Event) -> dict[str, tuple[bytes, int]]:
    """Name -> gzipped contents and their size before. Raises `ViewerFilesError`."""
    with (
        tempfile.TemporaryDirectory(prefix="babble-rerun-", ignore_cleanup_errors=True) as scratch,
        _serving(Path(scratch), cancelled) as port,
    ):
        try:
            return {name: _fetch(port, name, cancelled) for name in NAMES}
        except (OSError, http.client.HTTPException) as error:
            raise ViewerFilesError(
                f"rerun's program did not give out the viewer's files ({error or type(error).__name__}); "
                "try again, or install rerun-sdk again with `make setup`"
            ) from None


@contextmanager
def _serving(scratch: Path, cancelled: threading.Event) -> Iterator[int]:
    """rerun's own web server on a port that the kernel chose, while the block runs."""
    said = scratch / "said"
    arguments = ["--serve-web", "--bind", "127.0.0.1", "--web-viewer-port", "0", NOWHERE]
    try:
        with said.open("wb") as output:
            child = subprocess.Popen(
                tethered([str(rerun_program()), *arguments]),
                stdin=subprocess.DEVNULL,
                stdout=output,
                stderr=output,
                env={**quiet_environment(scratch), "RUST_LOG": "info"},
            )
    except OSError as error:
        raise ViewerFilesError(f"rerun's program cannot be started here: {error.strerror}") from None
    try:
        yield _port(child, said, cancelled)
    finally:
        stop(child)


def _port(child: "subprocess.Popen[bytes]", said: Path, cancelled: threading.Event) -> int:
    deadline_secs = time.monotonic() + START_SECS
    while time.monotonic() < deadline_secs:
        if found := SERVES.search(said.read_text(errors="replace")):
            return int(found[1])
        if child.poll() is not None:
            words = said.read_text(errors="replace").strip().splitlines()
            raise ViewerFilesError(
                f"rerun's program ended with code {child.returncode} instead of serving its viewer "
                f"({words[-1] if words else 'it said nothing'}); install rerun-sdk again with `make setup`"
            )
        if cancelled.wait(0.02):
            raise ViewerFilesError("stopped before the viewer's files were ready")
    raise ViewerFilesError(
        f"rerun's program did not serve its viewer within {START_SECS:.0f} s; is this machine overloaded?"
    )


def _fetch(port: int, name: str, cancelled: threading.Event) -> tuple[bytes, int]:
    """One file, gzipped as it comes (the time stamp is 0: the same file gives the same bytes)."""
    deadline_secs = time.monotonic() + FETCH_SECS
    packer = zlib.compressobj(GZIP_LEVEL, zlib.DEFLATED, 16 + zlib.MAX_WBITS)
    packed, raw_bytes = [], 0
    connection = http.client.HTTPConnection("127.0.0.1", port, timeout=FETCH_SECS)
    try:
        connection.request("GET", f"/{name}")
        response = connection.getresponse()
        if response.status != http.HTTPStatus.OK:
            raise http.client.HTTPException(f"{name}: status {response.status}")
        while part := response.read(READ_BYTES):
            if cancelled.is_set() or time.monotonic() > deadline_secs:
                raise TimeoutError(f"{name} was not whole in time")
            packed.append(packer.compress(part))
            raw_bytes += len(part)
        stated = response.headers.get("rerun-final-length", str(raw_bytes))
    finally:
        connection.close()
    if stated != str(raw_bytes):
        raise http.client.HTTPException(f"{name}: {raw_bytes} bytes of {stated}")
    return b"".join([*packed, packer.flush()]), raw_bytes
