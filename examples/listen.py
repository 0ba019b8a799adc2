"""Listen to a run: what phase it is in, and what each process says of itself.

    python examples/listen.py runs/NAME        # a run that `babble up` is doing
    python examples/listen.py runs/NAME --connect tcp/HOST:7447 --secs 30

It shows how little it takes to join a run: a key expression, an inbox, and the protocol's decoder.
"""

import argparse
import time
from pathlib import Path

from protocol import keys
from protocol.gate import Gate
from protocol.messages import PhaseAnnounced, Status
from services.runtime.bus import Frame, Inbox, Wakeup
from services.runtime.process import new_life, read_run_name
from services.runtime.zenoh_bus import ZenohBus


def listen(run: str, endpoint: str, secs: float) -> int:
    """Print what is heard for so long; returns how many messages that were."""
    wakeup = Wakeup()
    inbox = Inbox(wakeup)
    gate = Gate(run, {"phase", "status"})
    heard = 0
    bus = ZenohBus(endpoint, new_life("listener"), wakeup, connect_secs=5.0)
    try:
        bus.subscribe("phase", keys.phase(run), inbox)
        bus.subscribe("status", keys.status(run, "*", "*"), inbox)
        deadline = time.monotonic() + secs
        while (left := deadline - time.monotonic()) > 0:
            wakeup.wait(min(left, 0.5))
            for arrival in inbox.take_all():
                message = gate.admit(arrival.key, arrival.data) if isinstance(arrival, Frame) else None
                match message:
                    case PhaseAnnounced():
                        print(f"term {message.term}: {message.phase}", flush=True)
                        heard += 1
                    case Status():
                        print(f"  {message.life}: {message.totals} {message.waiting_for}", flush=True)
                        heard += 1
    finally:
        bus.close()
    return heard


def main() -> None:
    """Parse the command line and listen."""
    parser = argparse.ArgumentParser(description="Listen to a run.")
    parser.add_argument("run_dir", type=Path, help="the run's folder")
    parser.add_argument("--connect", help="the router's address (default: the one in the run's folder)")
    parser.add_argument("--secs", type=float, default=10.0)
    arguments = parser.parse_args()
    try:
        endpoint = arguments.connect or (arguments.run_dir / "endpoint").read_text().strip()
    except OSError:
        raise SystemExit(f"{arguments.run_dir} is no run that is going on; or give --connect") from None
    listen(read_run_name(arguments.run_dir), endpoint, arguments.secs)


if __name__ == "__main__":
    main()
