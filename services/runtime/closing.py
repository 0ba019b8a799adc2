"""Closes what a program forgot to close, once its main thread ends."""

import threading
import weakref
from typing import Protocol


class Closeable(Protocol):
    """Whatever holds threads of its own until it is closed."""

    def close(self) -> None:
        """Let go of them; harmless when done twice."""
        ...


_open: weakref.WeakSet[Closeable] = weakref.WeakSet()
_lock = threading.Lock()
_guard: threading.Thread | None = None


def close_with_main_thread(closeable: Closeable) -> None:
    """Close it when the main thread ends, if it still exists, or its threads keep the process for ever."""
    global _guard
    with _lock:
        _open.add(closeable)
        if _guard is None:
            _guard = threading.Thread(target=_close_forgotten, name="bus-guard")
            _guard.start()


def _close_forgotten() -> None:
    threading.main_thread().join()
    for closeable in list(_open):
        closeable.close()
