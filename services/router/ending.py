"""When a router that was told `--until-done` ends by itself (pure: time is given)."""

import logging

log = logging.getLogger(__name__)

FAREWELL_SECS = 30.0
"""After the run is done, clients have so long to leave."""
LEFT_SECS = 120.0
"""Of a run that goes on somebody is always connected, or back sooner: a crash ends one process, and
Docker waits for at most a minute before it starts one again. So after this time nobody is waited for: a
router that was itself started again in the meantime may have missed that the run is done."""
NOBODY_SECS = 600.0
"""Likewise while nobody has come yet."""


class Ending:
    """Is told at each poll how things are."""

    def __init__(self) -> None:
        self._done_secs: float | None = None
        self._alone_secs: float | None = None
        self._patience_secs = NOBODY_SECS

    def may_end(self, now_secs: float, *, done: bool, connections: int) -> bool:
        """True once the run is done and all have left or had time to, or nobody comes any more."""
        if connections:
            self._alone_secs, self._patience_secs = None, LEFT_SECS
        elif self._alone_secs is None:
            self._alone_secs = now_secs
        if not done:
            self._done_secs = None
            return self._is_forsaken(now_secs)
        if not connections:
            log.info("the run is done and all have left")
            return True
        if self._done_secs is None:
            self._done_secs = now_secs
        return now_secs - self._done_secs >= FAREWELL_SECS

    def _is_forsaken(self, now_secs: float) -> bool:
        if self._alone_secs is None or now_secs - self._alone_secs < self._patience_secs:
            return False
        log.warning("ending, for nobody was connected for %.0f s", self._patience_secs)
        return True
