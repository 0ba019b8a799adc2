"""`python -m services.dashboard.replay`: shows the recordings of a run, without a run.

The page and the viewer are the live dashboard's; the viewer reads the parts of the recording from the
same web server. What a crash cut off is not served, and nothing is changed on disk.
"""

import argparse
import os
import re
import signal
import subprocess
import sys
import tempfile
import threading
import webbrowser
from collections.abc import Sequence
from pathlib import Path

from services.dashboard.pages import LOOPBACK, AddressError
from services.dashboard.salvage import RecordingError, Whole, measure
from services.dashboard.viewer_files import quiet_environment, rerun_program, stop
from services.dashboard.web_server import WebServer
from services.runtime.errors import UserError
from services.runtime.process import guarded, new_life, read_run_name
from services.runtime.tether import tethered

COMMAND = "babble view"
WEB_PORT = 9090
PART = re.compile(r"run-(\d+)\.rrd")
LOOK_SECS = 0.5
DISPLAYS = ("DISPLAY", "WAYLAND_DISPLAY")


def main(argv: Sequence[str] | None = None) -> int:
    """Show the recordings until Ctrl-C or SIGTERM; returns the exit code."""
    arguments = _parse(argv)
    stopped = threading.Event()
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: stopped.set())
    return guarded(COMMAND, lambda: replay(arguments, stopped))


def replay(arguments: argparse.Namespace, stopped: threading.Event) -> None:
    """Serve the recordings of `arguments.run_dir` until `stopped`, or until a native viewer is closed.

    Raises `UserError` if there is nothing to show, or no way to.
    """
    run = read_run_name(arguments.run_dir)
    parts = recordings(arguments.run_dir)
    if arguments.native:
        _check_display()
    shown = [path for path, whole in parts if whole.messages]
    server = _serve(arguments, run, shown)
    try:
        for line in [*damage(parts), summary(run, parts, server.url), *_elsewhere(server.url)]:
            print(line, flush=True)
        if arguments.native:
            _show_natively([f"{server.url}/recording/{path.name}" for path in shown], stopped)
        else:
            _show_in_browser(server, arguments.browser, stopped)
    finally:
        server.close()


def recordings(run_dir: Path) -> list[tuple[Path, Whole]]:
    """The parts of the run's recording in order, and how much of each is whole. Raises `RecordingError`."""
    folder = run_dir / "recording"
    numbered = [(PART.fullmatch(path.name), path) for path in folder.glob("run-*.rrd")]
    found = [path for _, path in sorted((int(name[1]), path) for name, path in numbered if name)]
    if not found:
        raise RecordingError(
            f"the run has no recording in {folder}; a run records while its dashboard is there, "
            "which needs view.recording_mb above 0 and no --no-dashboard"
        )
    parts = [(path, measure(path)) for path in found]
    if not any(whole.messages for _, whole in parts):
        raise RecordingError(f"nothing has been recorded yet in {folder}; try again in some seconds")
    return parts


def damage(parts: Sequence[tuple[Path, Whole]]) -> list[str]:
    """One sentence for each part that is not whole."""
    sentences = []
    for path, whole in parts:
        if whole.cut_bytes:
            why = "is being written, or was cut off by a crash" if path == parts[-1][0] else "was cut off"
            sentences.append(
                f"{path.name} {why}: its last {whole.cut_bytes:,} of {whole.file_bytes:,} bytes are no "
                f"whole message and are left out; its {whole.messages:,} whole messages are shown"
            )
    return sentences


def summary(run: str, parts: Sequence[tuple[Path, Whole]], url: str) -> str:
    """What is shown, and where."""
    sizes = [whole.whole_bytes for _, whole in parts if whole.messages]
    size_mb, count = sum(sizes) / 1e6, f"{len(sizes)} part{'s' if len(sizes) > 1 else ''}"
    return f"recording of {run} ({count}, {size_mb:,.1f} MB): {url} (Ctrl-C to end)"


def _serve(arguments: argparse.Namespace, run: str, shown: Sequence[Path]) -> WebServer:
    """A started server: at the port that was asked for, else at the usual one, else at a free one."""
    ports = [WEB_PORT, 0] if arguments.port is None else [arguments.port]
    for port in ports:
        server = WebServer(
            arguments.bind,
            port,
            None,
            run,
            new_life("view"),
            arguments.allow_origin,
            recordings=shown,
            port_option="--port",
        )
        try:
            server.start()
        except AddressError:
            if port == ports[-1]:
                raise
        else:
            return server
    raise AssertionError("unreachable: the last port is served or refused")


def _show_in_browser(server: WebServer, open_browser: bool, stopped: threading.Event) -> None:
    if open_browser and _has_browser() and not webbrowser.open(server.url):
        print("no browser could be started; open the address above in one", flush=True)
    while not stopped.wait(LOOK_SECS):
        if server.error:
            raise UserError(server.error)


def _show_natively(urls: Sequence[str], stopped: threading.Event) -> None:
    with tempfile.TemporaryDirectory(prefix="babble-rerun-", ignore_cleanup_errors=True) as scratch:
        options = ["--bind", LOOPBACK, "--port", "auto", "--hide-welcome-screen"]
        command = tethered([str(rerun_program()), *options, *urls])
        child = subprocess.Popen(command, env={**quiet_environment(Path(scratch)), "RUST_LOG": "error"})
        try:
            while child.poll() is None and not stopped.wait(LOOK_SECS):
                pass
        finally:
            stop(child)
    if child.returncode > 0:
        raise UserError(
            f"the native viewer ended with code {child.returncode}; leave out --native to use a browser"
        )


def _check_display() -> None:
    if sys.platform == "linux" and not any(os.environ.get(name) for name in DISPLAYS):
        raise UserError(
            "--native needs a screen, and neither DISPLAY nor WAYLAND_DISPLAY is set here; leave it out "
            "to see the recording in a browser, also one on another machine"
        )


def _has_browser() -> bool:
    """Whether a browser would open beside the terminal; one in the terminal is of no use."""
    wished = bool(os.environ.get("BROWSER"))
    return wished or sys.platform == "darwin" or any(os.environ.get(name) for name in DISPLAYS)


def _elsewhere(url: str) -> list[str]:
    """How to see it from where the terminal is, if that is another machine."""
    if not os.environ.get("SSH_CONNECTION"):
        return []
    port = url.rpartition(":")[2]
    return [f"from the machine you sit at: ssh -L {port}:{LOOPBACK}:{port} THIS-HOST, then open that address"]


def _parse(argv: Sequence[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        prog="python -m services.dashboard.replay",
        description="Serves the viewer and the recordings of a run; people use `babble view`.",
    )
    parser.add_argument("--run-dir", type=Path, required=True)
    parser.add_argument("--bind", default=LOOPBACK)
    parser.add_argument("--port", type=int)
    parser.add_argument("--allow-origin", action="append", default=[])
    parser.add_argument("--no-browser", dest="browser", action="store_false")
    parser.add_argument("--native", action="store_true")
    return parser.parse_args(argv)


if __name__ == "__main__":
    sys.exit(main())
