"""The process's OpenGL context, off screen, by EGL or OSMesa.

Nothing needs OpenGL before the first picture, which opens the context; it is closed when Python ends.
"""

import atexit
import importlib
import os
import sys
import threading
import weakref
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import mujoco

BACKENDS = ("egl", "osmesa")
"""In the order in which they are tried."""
ANY = ("", "enable", "enabled", "on", "true", "1")
"""Values of MUJOCO_GL that leave the choice open."""
ADVICE = (
    "on Debian or Ubuntu install libegl1 and libgl1-mesa-dri, or libosmesa6,"
    " and choose by MUJOCO_GL=egl or MUJOCO_GL=osmesa if need be"
)

FONT_SCALE = mujoco.mjtFontScale.mjFONTSCALE_50.value


class RendererError(ValueError):
    """No picture can be drawn; the text is one sentence for a person."""


class Screen:
    """The process's OpenGL context; one thread draws at a time."""

    def __init__(self) -> None:
        self._context: Any = None
        self._process = 0
        self._lock = threading.RLock()
        self._closers: list[weakref.finalize[Any, Any]] = []

    @contextmanager
    def current(self) -> Iterator[None]:
        """What happens inside may call OpenGL. Raises `RendererError` where it cannot be had."""
        with self._lock:
            if self._context is None:
                self._context, self._process = _opened(), os.getpid()
                # Registered after mujoco's own, which ends the display: so this one runs before it.
                atexit.register(self._close)
            elif self._process != os.getpid():
                raise RendererError(
                    "this process was forked from one that had drawn pictures, which OpenGL does not survive;"
                    ' start it with multiprocessing\'s "spawn", or draw nothing before the fork'
                )
            with self._context.as_current():
                yield

    def keep(self, owner: object, resource: Any) -> Callable[[], object]:
        """Frees the resource when its owner goes, when Python ends, or by the function returned."""
        closer = weakref.finalize(owner, self._free, resource)
        closer.atexit = False
        self._closers = [*(other for other in self._closers if other.alive), closer]
        return closer

    def _free(self, resource: Any) -> None:
        if self._process == os.getpid():
            with self.current():
                resource.free()

    def _close(self) -> None:
        if self._process == os.getpid():
            for closer in self._closers:
                closer()
            self._context.free()
            self._context = None


def _opened() -> Any:
    """A new OpenGL context of the first backend that works."""
    asked = os.environ.get("MUJOCO_GL", "").strip().lower()
    if asked not in (*ANY, *BACKENDS):
        raise RendererError(
            f"MUJOCO_GL={asked} cannot draw without a screen; set it to egl or osmesa, or unset it"
        )
    failures = []
    for backend in BACKENDS if asked in ANY else (asked,):
        try:
            return _context_of(backend)
        except Exception as error:  # noqa: BLE001 - a missing driver shows as any kind of error
            failures.append(f"{backend}: {_reason(error)}")
    raise RendererError(f"no off-screen renderer works here ({'; '.join(failures)}); {ADVICE}")


def _context_of(backend: str) -> Any:
    """A context in which MuJoCo can draw; a failure leaves no trace, so that the next can be tried."""
    loaded = set(sys.modules)
    before = {name: os.environ.get(name) for name in ("MUJOCO_GL", "PYOPENGL_PLATFORM")}
    # MuJoCo's C library reads this when it first looks for OpenGL's functions.
    os.environ["MUJOCO_GL"] = backend
    try:
        context = importlib.import_module(f"mujoco.{backend}").GLContext(1, 1)
        with context.as_current():
            mujoco.MjrContext(mujoco.MjModel.from_xml_string("<mujoco/>"), FONT_SCALE).free()
    except Exception:
        # PyOpenGL settles for one backend when it is first imported, even if that fails.
        for name in set(sys.modules) - loaded:
            if name.startswith(("OpenGL", f"mujoco.{backend}")):
                del sys.modules[name]
        _restore("PYOPENGL_PLATFORM", before["PYOPENGL_PLATFORM"])
        raise
    finally:
        _restore("MUJOCO_GL", before["MUJOCO_GL"])
    return context


def _restore(variable: str, value: str | None) -> None:
    if value is None:
        os.environ.pop(variable, None)
    else:
        os.environ[variable] = value


def _reason(error: Exception) -> str:
    if isinstance(error, AttributeError):  # PyOpenGL's way to say so
        return "its library is missing"
    return (str(error) or type(error).__name__).splitlines()[0].partition(". ")[0].rstrip(".")


screen = Screen()
