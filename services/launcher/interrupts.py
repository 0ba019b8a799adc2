"""SIGINT and SIGTERM as something that a loop asks about."""

import signal


class Interrupts:
    """The signals that came while it was entered; the loop asks.

    The handler only notes the number: a lock that it took could be held by the very code it interrupts.
    """

    def __init__(self) -> None:
        self.numbers: list[int] = []
        self._before = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}

    def __enter__(self) -> "Interrupts":
        for number in self._before:
            signal.signal(number, lambda received, _: self.numbers.append(received))
        return self

    def __exit__(self, *_: object) -> None:
        for number, handler in self._before.items():
            signal.signal(number, handler)
