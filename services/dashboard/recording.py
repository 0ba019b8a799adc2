"""One recording of a run, twice: live to viewers through a gRPC server, and thinner to files."""

import errno
import ipaddress
import logging
import socket
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from services.dashboard.blueprint import ENV_STEPS, RUN_TIME
from services.dashboard.canvas import Canvas, Panel
from services.dashboard.copying import end
from services.dashboard.parts import Parts
from services.runtime.errors import UserError

log = logging.getLogger(__name__)

APPLICATION = "babble"
LIVE_FLUSH_SECS = 0.5
NEVER_SECS = 86_400.0
"""Files are flushed by `Parts` alone."""
CLOSE_SECS = 1.0


class Recording:
    """Opens the streams, keeps their times, begins the panels on each; use it from one thread.

    Raises `UserError` if the port cannot be had.
    """

    def __init__(
        self,
        run: str,
        *,
        folder: Path,
        bound_bytes: int,
        bind: str,
        grpc_port: int,
        server_memory_mb: int,
        stream_origins: Sequence[str],
        blueprint: rrb.Blueprint,
        panels: Sequence[Panel],
    ) -> None:
        self._run, self._panels = run, panels
        self.grpc_port = free_port(bind, grpc_port)
        """The port of the gRPC server."""
        self._live = self._stream(LIVE_FLUSH_SECS)
        sink = rr.GrpcServerSink(
            bind_ip=bind,
            port=self.grpc_port,
            server_memory_limit=f"{server_memory_mb}MB",
            cors_allow_origin=list(stream_origins),
        )
        self._live.set_sinks(sink, default_blueprint=blueprint)
        self._live.send_recording_name(run)
        self.parts = Parts(
            folder, bound_bytes, new_stream=lambda: self._stream(NEVER_SECS), blueprint=blueprint
        )
        self._begun = False
        self.rows = 0
        """logged so far, to either stream"""

    def draw(self, now_secs: float, run_secs: float, env_steps: int) -> None:
        """Let every panel log what is new, at this time of the run."""
        if not self._begun or self.parts.flush_if_due(now_secs):
            self._begin_part(now_secs, run_secs, env_steps)
        for stream in (self._live, self.parts.stream):
            if stream is not None:
                _set_times(stream, run_secs, env_steps)
        if not self._begun:
            self._begun = True
            self._begin(Canvas(live=self._live))
        canvas = Canvas(self._live, self.parts.stream)
        for panel in self._panels:
            panel.draw(canvas, now_secs)
        self.rows += canvas.rows

    def close(self) -> None:
        """Send viewers the last of it, finish the file, and stop serving."""
        self.parts.close()
        try:
            self._live.flush(timeout_sec=CLOSE_SECS)
        except (RuntimeError, ValueError) as error:
            log.warning("the last rows may not have reached every viewer: %s", error)
        end(self._live, CLOSE_SECS)

    def _begin_part(self, now_secs: float, run_secs: float, env_steps: int) -> None:
        self.parts.close()
        if self.parts.open(now_secs) and (stream := self.parts.stream) is not None:
            stream.send_recording_name(self._run)
            _set_times(stream, run_secs, env_steps)
            self._begin(Canvas(file=stream))

    def _begin(self, canvas: Canvas) -> None:
        for panel in self._panels:
            panel.begin(canvas)
        self.rows += canvas.rows

    def _stream(self, flush_secs: float) -> rr.RecordingStream:
        batching = rr.ChunkBatcherConfig(flush_tick=flush_secs)
        stream = rr.RecordingStream(APPLICATION, recording_id=self._run, batcher_config=batching)
        stream.set_log_tick_enabled(False)
        return stream


def free_port(bind: str, port: int) -> int:
    """The port, if it can be listened at; one that the kernel chooses for 0. Raises `UserError`.

    Rerun's server says nothing to its caller when it cannot listen, so it is tried before.
    """
    try:
        ipaddress.IPv4Address(bind)
        with socket.socket(socket.AF_INET, socket.SOCK_STREAM) as trial:
            trial.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            trial.bind((bind, port))
            return int(trial.getsockname()[1])
    except ValueError:
        raise UserError(f"--bind {bind!r} is no IPv4 address; give 127.0.0.1 or 0.0.0.0") from None
    except OSError as error:
        reason = "it is in use" if error.errno == errno.EADDRINUSE else (error.strerror or str(error)).lower()
        raise UserError(
            f"cannot listen at port {port} of {bind}: {reason}; give another port with --grpc-port"
        ) from None


def _set_times(stream: rr.RecordingStream, run_secs: float, env_steps: int) -> None:
    # Whole milliseconds: a float would be shown with its noise.
    stream.set_time(RUN_TIME, duration=np.timedelta64(round(run_secs * 1000), "ms"))
    stream.set_time(ENV_STEPS, sequence=env_steps)
