"""The router's life: open, say so, wait for a signal, close."""

import contextlib
import signal

from services.router.config import RouterConfig
from services.runtime.zenoh_bus import open_router

STOP_SIGNALS = {signal.SIGTERM, signal.SIGINT}


def serve(config: RouterConfig) -> None:
    """Route until SIGTERM or SIGINT. Raises `BusError` if the address cannot be had.

    The signals are blocked before Zenoh starts its threads, so that only the wait here takes them.
    """
    signal.pthread_sigmask(signal.SIG_BLOCK, STOP_SIGNALS)
    router = open_router(config.listen)
    try:
        with contextlib.suppress(BrokenPipeError):
            print(f"router: ready at {config.listen}", flush=True)
        signal.sigwait(STOP_SIGNALS)
    finally:
        router.close()
