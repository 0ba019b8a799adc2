"""Whether a process is well, from what it last published: `python -m services.runtime.health [FILE]`.

A process whose environment has `BABBLE_HEALTH=FILE` keeps its last status there. This reads it, prints one
sentence and exits with 0 if the status is recent and its process is linked to the router, else with 1. It
imports nothing but the standard library and as little of that as it can, because containers are asked every
few seconds: it takes 25 ms of processor time, and half of that is the interpreter's own start.
"""

import json
import os
import sys
import time
from collections.abc import Mapping

VARIABLE = "BABBLE_HEALTH"
"""The environment variable with the file's path."""
SILENT_SECS = 10.0
"""A status older than this, and than three of its process's intervals, is a bad sign."""
INTERVALS = 3
LONGEST_WORDS = 200


def judge(record: Mapping[str, object], now_secs: float) -> tuple[bool, str]:
    """Whether the process is well, and a sentence; `now_secs` by the machine's monotonic clock."""
    service, phase = str(record["service"]), record.get("phase")
    doing = f"{service} in {str(phase).upper()}" if phase else f"{service} before its first phase"
    age_secs = now_secs - float(str(record["published_secs"]))
    if age_secs < 0:
        return False, f"not healthy: nothing was heard since this machine started (last: {doing})"
    if age_secs > max(SILENT_SECS, INTERVALS * float(str(record["interval_secs"]))):
        return False, f"not healthy: silent for {age_secs:.0f} s (last: {doing}{_why(record)})"
    if record.get("unlinked_secs") is not None:
        away_secs = now_secs - float(str(record["unlinked_secs"]))
        return False, f"not healthy: not linked to the router for {away_secs:.0f} s ({doing})"
    return True, f"healthy: {doing}, {age_secs:.1f} s ago"


def main(arguments: list[str]) -> int:
    """Print how the process is; returns 0 if it is well, else 1."""
    path = arguments[0] if arguments else os.environ.get(VARIABLE, "")
    if not path:
        print(f"not healthy: no file to look into; set {VARIABLE} to the one that the process was given")
        return 1
    try:
        with open(path, encoding="utf-8") as file:
            well, sentence = judge(json.load(file), time.monotonic())
    except FileNotFoundError:
        well, sentence = False, f"not healthy: no word yet ({path} is not there)"
    except (OSError, ValueError, KeyError, TypeError, RecursionError) as error:
        well, sentence = False, f"not healthy: cannot read {path} ({error})"
    print(sentence)
    return 0 if well else 1


def _why(record: Mapping[str, object]) -> str:
    words = str(record.get("last_error") or record.get("waiting_for") or "")
    return f"; {words[:LONGEST_WORDS]}" if words else ""


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
