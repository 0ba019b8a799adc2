"""What the report says of one block: verdict, places, pictures, scores and what its learners measured."""

from collections.abc import Mapping, Sequence

from babble.scores import REACHED
from protocol.messages import Score
from services.launcher.evaluate import COLUMNS, Rollout, load_models, roll_out
from services.launcher.findings import ends_of, in_words, verdict
from services.launcher.judging import score_columns
from services.launcher.report_tables import table_head, table_row
from services.launcher.scored_run import Run, RunError, Version
from services.launcher.survey import Survey

HEADS = {"separation_worst": "worst", "switch_success": "switch success", "external_reward": "reward"}


def only_block(survey: Survey, block: str, *, rollouts: bool) -> list[str]:
    """The section of the only block of a run."""
    run, rows = survey.run, rows_of(survey.run, [block])
    version, troubles = shown_version(run, block)
    words, pictures = [not_rolled_out(run)], list[str]()
    if rollouts:
        try:
            words, pictures = rolled_out(roll_out_kept(run, [version]), version)
        except RunError as error:
            words = [could_not(error)]
    return [
        "## What was found",
        "",
        *troubles,
        verdict(run, version, rows),
        "",
        *words,
        "",
        *score_table(run, rows),
        "",
        *pictures,
        *learning(survey, block),
    ]


def shown_version(run: Run, block: str) -> tuple[Version, list[str]]:
    """The kept iteration of an evaluated block, and lines on why it is another one."""
    try:
        return run.version(block), []
    except RunError as error:
        # What is kept was not measured, as far as can be read.
        newest = run.version(block, max(run.versions(block)))
        return newest, [f"What is kept is not known here: {error}.", ""]


def roll_out_kept(run: Run, versions: Sequence[Version], columns: int = COLUMNS) -> Rollout:
    """The blocks of one level in fresh worlds, by mean actions. Raises `RunError`."""
    models = {version.block: load_models(run, version) for version in versions}
    return roll_out(run, versions, models, columns=columns)


def rolled_out(rollout: Rollout, version: Version) -> tuple[list[str], list[str]]:
    """Where each goal of a block ends in fresh worlds, in words, and the figures of it."""
    from services.launcher.block_pictures import pictures_of

    world = rollout.run.world(1, [0, 6, 4])
    ends = ends_of(rollout, version.block)
    return in_words(rollout, version, world), pictures_of(rollout, version, ends, world)


def not_rolled_out(run: Run) -> str:
    """Where the places are when they are not here."""
    return f"The saved models were not rolled out here; `babble report {run.shown}` does that."


def could_not(error: RunError) -> str:
    """Why there are no places."""
    return f"The saved models could not be rolled out: {error}."


def rows_of(run: Run, blocks: Sequence[str]) -> list[Score]:
    """What was measured of some blocks."""
    return [row for row in run.scores if row.block in blocks]


def score_table(run: Run, rows: Sequence[Score]) -> list[str]:
    """All rows of one or several blocks, in the order of blocks, iterations and modes."""
    place: Mapping[str, int] = {name: index for index, name in enumerate(run.blocks)}
    rows = sorted(rows, key=lambda row: (place[row.block], row.iteration, row.policy))
    several = len({row.block for row in rows}) > 1
    landmarks = list(dict.fromkeys(name for row in rows for name in row.landmarks))
    asked = (
        f"z_min and each of {', '.join(landmarks)}"
        if landmarks
        else "separation, z_min and, where there are two halves or sides, crossing"
    )
    columns = score_columns(rows)
    heads = ["iteration", "after", "actions", *(HEADS.get(name, name) for name in columns)]
    lines = [
        f"Scores during the run; success is {asked} of {REACHED} or more:",
        "",
        *table_head(["block", *heads] if several else heads),
    ]
    for index, row in enumerate(rows):
        best = " (best)" if row.iteration == run.best.get(row.block) else ""
        cells = [f"{row.iteration}{best}", row.phase.value, row.policy]
        numbers = [values[index] for values in columns.values()]
        cells += ["" if value is None else f"{value:.3f}" for value in numbers]
        lines.append(table_row([row.block, *cells] if several else cells))
    return lines


def learning(survey: Survey, block: str) -> list[str]:
    """The figure of a block's scores and of what its learners measured."""
    from services.launcher import learning_figure
    from services.launcher.figures import picture

    run, curves = survey.run, survey.curves
    rows = rows_of(run, [block])
    path = run.folder / "figures" / f"{block}-learning.png"
    title, level = f"{run.name}, block {block}: learning", run.settings.level_of(block)
    learning_figure.draw_learning(
        path, block, rows, run.best.get(block), curves, survey.timeline, title, level
    )
    told = ["Scores by iteration"] if rows else [f"What the learners measured of block {block}"]
    if not curves.of(block):
        told.append("no losses: there are none in metrics.jsonl")
    elif rows:
        told.append("what the learners measured, over the time in the phases in which they learned")
    return picture(f"{block}-learning", f"{', and '.join(told)}.")
