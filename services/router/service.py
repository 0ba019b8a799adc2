"""The router's life: open, say so, watch, end with the run or at a signal."""

import contextlib
import logging
import signal
import threading
from typing import Any

from services.router.config import LINKS_PER_LIFE, RouterConfig, check_address
from services.router.door import Door
from services.router.ending import Ending
from services.router.runs import Runs
from services.router.sockets import allow_many
from services.router.watch import POLL_SECS, Watch
from services.runtime.clock import RealClock

log = logging.getLogger(__name__)

STOP_SIGNALS = {signal.SIGTERM, signal.SIGINT}


def serve(config: RouterConfig, life: str) -> None:
    """Route until SIGTERM or SIGINT, or until the run is done. Raises `UserError` if it cannot open.

    The signals are blocked before Zenoh starts its threads, so that only one thread here takes them.
    """
    check_address(config)
    signal.pthread_sigmask(signal.SIG_BLOCK, STOP_SIGNALS)
    stopped = _listen_to_signals()
    clock = RealClock()
    service = RouterService(config, life)
    try:
        with contextlib.suppress(BrokenPipeError):
            print(f"router: ready at {config.listen}", flush=True)
        delay_secs: float | None = 0.0
        while delay_secs is not None and not stopped.wait(delay_secs):
            delay_secs = service.poll(clock.now_secs())
    finally:
        service.close()


class RouterService:
    """See `README.md`. Raises `UserError` for what a person must mend."""

    def __init__(self, config: RouterConfig, life: str) -> None:
        allow_many()
        self._ending = Ending() if config.until_done else None
        self._door = Door(config)
        self._runs = Runs(life)
        self._watch = Watch(config.limits) if self._door.closed_to_strangers else None
        self._attach()

    def poll(self, now_secs: float) -> float | None:
        """Seconds until the next poll; None once it may end by itself."""
        if self._door.renew():
            self._attach()
        self._runs.hear()
        if self._watch is not None:
            self._watch.poll(now_secs)
        self._runs.publish(now_secs, self._report)
        return None if self._may_end(now_secs) else POLL_SECS

    def close(self) -> None:
        """Leave all clients."""
        self._door.close()

    def _attach(self) -> None:
        self._runs.attach(self._door.router)
        if self._watch is not None:
            self._watch.attach(self._door.router, self._door.hosts)

    def _report(self) -> dict[str, Any]:
        if self._watch is not None:
            return self._watch.report()
        connections = len(self._door.router.links())
        return {"totals": {"connections": connections, "clients": -(-connections // LINKS_PER_LIFE)}}

    def _may_end(self, now_secs: float) -> bool:
        if self._ending is None:
            return False
        connections = len(self._door.router.links())
        return self._ending.may_end(now_secs, done=self._runs.done(), connections=connections)


def _listen_to_signals() -> threading.Event:
    """An event that is set once a signal to stop has come."""
    stopped = threading.Event()

    def wait() -> None:
        signal.sigwait(STOP_SIGNALS)
        stopped.set()

    threading.Thread(target=wait, name="signals", daemon=True).start()
    return stopped
