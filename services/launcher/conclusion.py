"""The end of a run for people: its scores, its report, and where all of it is."""

import os
import shutil
import signal
import sys
import textwrap
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress

from services.launcher.lines import Row, best_words, brief, has_many_blocks, kept_table, score_table
from services.launcher.recorded import outcome_words
from services.launcher.run_folder import RunFolder
from services.runtime.checkpoint import DRAFT_SUFFIX
from services.runtime.settings import RunSettings

VIEW_VARIABLE = "BABBLE_VIEW"
"""The environment variable with the command that shows a recording, where it is not `babble view`."""
MOST_COLUMNS = 100
MOST_ITERATIONS = 20
"""Of each block, in the table of scores at the end; the one that is kept is shown besides."""


def print_scores(folder: RunFolder) -> None:
    """The scores in the run's folder, which iteration is kept, and how many blocks of a tree reach the bar.

    Then what was recorded; that alone of a run in which nothing is learned. Raises `UserError` if scores are
    damaged.
    """
    settings = folder.settings()
    if not settings.phases.open_loop:
        _print_learned(folder, settings)
    for sentence in outcome_words(folder.path, folder.shown, settings):
        _print_sentence(sentence)


def _print_learned(folder: RunFolder, settings: RunSettings) -> None:
    print_rows(folder.scores(), folder.best(), f"{folder.shown}/scores.jsonl")
    if len(settings.block) > 1:
        # Worlds and what reads their models take their time, which runs of one block do not need.
        from services.launcher.judging import tree_words
        from services.launcher.scored_run import open_run

        names = [block.name for block in settings.block]
        _print_sentence(tree_words(names, open_run(folder.path).kept_scores()))


def print_rows(rows: Sequence[Row], best: Mapping[str, Row], where: str) -> None:
    """The newest rows, `where` all of them are, and which iteration is kept; of many blocks only that."""
    if not rows:
        print("there are no scores")
        return
    if has_many_blocks(rows):
        print("\n".join(kept_table(rows, best)))
        print(f"each block's kept iteration; all rows are in {where}")
        return
    shown = brief(rows, best, MOST_ITERATIONS)
    print("\n".join(score_table(shown)))
    if len(shown) < len(rows):
        print(f"{len(rows) - len(shown):,} older rows are in {where}")
    for sentence in best_words(best):
        _print_sentence(sentence)


def _print_sentence(sentence: str) -> None:
    width = min(MOST_COLUMNS, shutil.get_terminal_size().columns)
    # A folder or a command in it is to be copied, so it is not broken.
    whole = textwrap.TextWrapper(
        width, subsequent_indent="  ", break_on_hyphens=False, break_long_words=False
    )
    print(whole.fill(sentence), flush=True)


def say_how_to_see_it(folder: RunFolder) -> None:
    """How to see the recording again, if there is one."""
    if folder.recorded():
        command = os.environ.get(VIEW_VARIABLE) or f"babble view {folder.shown}"
        print(f"see it again with: {command}", flush=True)


def write_and_say(folder: RunFolder, *, rollouts: bool) -> None:
    """Write the report and say where the files are. Raises `UserError`."""
    from services.launcher.report import write_report

    report = write_report(folder.path, rollouts=rollouts)
    print(f"all files are in {folder.shown}; read {report.name} first")
    say_how_to_see_it(folder)


@contextmanager
def left_out_by(*numbers: signal.Signals, folder: RunFolder, code: int = 0) -> Iterator[None]:
    """While a report is written these signals end this process at once, without half-written files.

    The exit code is `code`, or 128 and the signal's number if that is 0. Afterwards they no longer do
    anything. No KeyboardInterrupt, because libraries turn one that hits them while they are imported into
    errors and tracebacks of their own.
    """

    def leave(number: int, _: object) -> None:
        sentence = f"\nthe report was not written; babble report {folder.shown} does it later\n"
        with suppress(OSError):
            for draft in folder.path.rglob(f".*.{os.getpid()}{DRAFT_SUFFIX}"):
                draft.unlink()
        with suppress(OSError):
            os.write(sys.stdout.fileno(), sentence.encode())
        os._exit(code or 128 + number)

    sys.stdout.flush()
    for number in numbers:
        signal.signal(number, leave)
    try:
        yield
    finally:
        # All is said and done but the interpreter's own end, which would answer with a traceback.
        for number in numbers:
            signal.signal(number, signal.SIG_IGN)
