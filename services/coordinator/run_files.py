"""What the coordinator leaves in the run folder for people and programs; all follows from the journal."""

import json
from collections.abc import Iterable, Mapping
from dataclasses import asdict
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from protocol.messages import Status
from services.coordinator.words import KeepBest, ScoreRow
from services.runtime.checkpoint import refuse_storage, write_atomically


class RunFiles:
    """`scores.jsonl`, `best.json`, `events.jsonl` and `metrics.jsonl` of one run.

    Every method raises `StorageError` if the disk refuses.
    """

    def __init__(self, run_dir: Path, run: str) -> None:
        self._run = run
        self._scores = run_dir / "scores.jsonl"
        self._best = run_dir / "best.json"
        self._events = run_dir / "events.jsonl"
        self._metrics = run_dir / "metrics.jsonl"
        self._last_totals: dict[str, Mapping[str, int]] = {}

    def restore(self, scores: Iterable[ScoreRow], best: Iterable[KeepBest]) -> None:
        """Make the files what the journal says, whatever a kill left of them."""
        write_atomically(self._scores, b"".join(_line(self._score(row)) for row in scores))
        self.write_best(best)
        if self._events.exists():
            whole, end, torn = self._events.read_bytes().rpartition(b"\n")
            if torn:
                write_atomically(self._events, whole + end)

    def add_scores(self, rows: Iterable[ScoreRow]) -> None:
        """Append rows to `scores.jsonl`."""
        self._append(self._scores, b"".join(_line(self._score(row)) for row in rows))

    def write_best(self, best: Iterable[KeepBest]) -> None:
        """Replace `best.json`: block -> iteration, versions and the reason."""
        table = {row.pop("block"): row for row in map(asdict, best)}
        write_atomically(self._best, json.dumps(table, indent=2).encode() + b"\n")

    def note(self, now_secs: float, what: str, text: str) -> None:
        """Append a milestone with its time to `events.jsonl`."""
        time = datetime.fromtimestamp(now_secs, UTC).isoformat(timespec="milliseconds")
        self._append(self._events, _line({"time": time, "secs": now_secs, "what": what, "text": text}))

    def add_metrics(self, now_secs: float, status: Status) -> None:
        """Append what a learner measures to `metrics.jsonl`, if it has worked since its last line."""
        if self._last_totals.get(status.life) == status.totals:
            return
        self._last_totals[status.life] = status.totals
        fields = {"term", "phase", "service", "life", "totals", "metrics"}
        record = {"now_secs": round(now_secs, 3), **status.model_dump(mode="json", include=fields)}
        self._append(self._metrics, _line(record))

    def _score(self, row: ScoreRow) -> dict[str, Any]:
        return {"run": self._run, **asdict(row)}

    def _append(self, path: Path, data: bytes) -> None:
        try:
            with path.open("ab") as file:
                file.write(data)
        except OSError as error:
            refuse_storage(path, error)


def _line(record: Mapping[str, Any]) -> bytes:
    return json.dumps(record, separators=(",", ":")).encode() + b"\n"
