"""What the report says of one level of a tree: all its blocks side by side, and some of them in detail.

Of many blocks the weakest is shown in detail, and every block in the figures of all; so the time that a
report takes grows with the number of levels and hardly with that of blocks. Large bodies are slow to
simulate, so their blocks are rolled out in fewer worlds.
"""

from collections.abc import Sequence

from protocol.messages import Score
from services.launcher.child_ends import child_ends, table_of
from services.launcher.evaluate import COLUMNS, Rollout
from services.launcher.findings import ends_of, verdict
from services.launcher.judging import measures, shortfalls, tree_words, weakest
from services.launcher.report_blocks import (
    could_not,
    learning,
    not_rolled_out,
    roll_out_kept,
    rolled_out,
    rows_of,
    score_table,
    shown_version,
)
from services.launcher.report_tables import table_head, table_row
from services.launcher.scored_run import Run, RunError, Version
from services.launcher.survey import Survey

MOST_WORK = 30_000_000
"""Environment steps of a level times the square of the joints; some 3 s of a body on a floor."""
START_STEPS = 100
"""A random start of a body takes about as long as so many steps."""
LEAST_COLUMNS = 4
"""As many poses of each goal are pictured."""


def tree_summary(run: Run) -> str:
    """How many blocks reach their bars, by what was measured during the run."""
    kept = [_kept_row(run, shown_version(run, block)[0]) for block in run.blocks]
    return tree_words([block.name for block in run.settings.block], {row.block: row for row in kept})


def level_section(survey: Survey, level: int, *, rollouts: bool) -> list[str]:
    """The section of a level of which some blocks were evaluated."""
    run, blocks = survey.run, survey.run.levels[level]
    shown = {block: shown_version(run, block) for block in blocks}
    versions = [version for version, _ in shown.values()]
    troubles = [line for _, lines in shown.values() for line in lines]
    kept = [_kept_row(run, version) for version in versions]
    lines = [f"## Level {level}: {_named(blocks)}", "", *troubles, *_verdicts(run, kept), ""]
    table = [*score_table(run, rows_of(run, blocks)), ""]
    detailed = next(each for each in versions if each.block == weakest(kept).block)
    detail = [verdict(run, detailed, rows_of(run, blocks=[detailed.block])), ""]
    if rollouts:
        try:
            rollout = roll_out_kept(run, versions, columns_of(run, level))
            lines += [*_postures(rollout), *_side_by_side(rollout, detailed.block)]
            words, pictures = rolled_out(rollout, detailed)
            detail += [*words, "", *pictures]
        except RunError as error:
            detail += [could_not(error), ""]
    else:
        detail += [not_rolled_out(run), ""]
    if len(blocks) > 1:
        lines += [
            *_learning(survey, level),
            *table,
            f"### Block {detailed.block}, the weakest of level {level}",
            "",
        ]
    else:
        detail += table
    return [*lines, *detail, *learning(survey, detailed.block)]


def columns_of(run: Run, level: int) -> int:
    """How many fresh worlds the blocks of a level are rolled out in. Raises `RunError`."""
    told, joints = run.settings.of_level(level).evaluation, run.world(1, [0]).posture_size
    steps = START_STEPS + told.legs * told.leg_steps
    return max(LEAST_COLUMNS, min(COLUMNS, MOST_WORK // (joints**2 * steps)))


def _named(blocks: Sequence[str]) -> str:
    return f"{'block' if len(blocks) == 1 else 'blocks'} {', '.join(blocks)}"


def _kept_row(run: Run, version: Version) -> Score:
    """What was measured of it during the run, by mean actions if it was."""
    rows = [row for row in rows_of(run, [version.block]) if row.iteration == version.iteration]
    return min(rows, key=lambda row: row.policy)


def _verdicts(run: Run, kept: Sequence[Score]) -> list[str]:
    """A row per block."""
    lines = table_head(["block", "vertices", "iteration", "what success is asked of", "reached"])
    for row in kept:
        told = ", ".join(f"{name} {value:.2f}" for name, value in measures(row).items())
        missing = shortfalls(row)
        reached = f"no: {', '.join(missing)}" if missing else "yes"
        vertices = str(run.settings.one_block(row.block).latent_dim)
        lines.append(table_row([row.block, vertices, str(row.iteration), told, reached]))
    return lines


def _postures(rollout: Rollout) -> list[str]:
    """Where the children of each block end, by goal; empty for leaves."""
    lines = list[str]()
    for version in rollout.versions:
        ends = child_ends(rollout, version)
        if ends is None:
            continue
        cells = table_of(ends)
        lines += [
            f"Where the children of block {version.block} end in fresh worlds (mean actions), by its goal: "
            "the child's vertex, the mean of that component of its latent, and the landmark where most legs "
            "end, if there is one, with their share:",
            "",
            *table_head(cells[0]),
            *map(table_row, cells[1:]),
            "",
            *(f"- {line}" for line in ends.words()),
            "",
        ]
    return lines


def _side_by_side(rollout: Rollout, detailed: str) -> list[str]:
    """Where the goals of all blocks lead, in one figure; and the body at them, for blocks with children.

    The body is not pictured for the block that is shown in detail, where it is pictured anyway.
    """
    if len(rollout.versions) == 1:
        return []
    from services.launcher import level_figures
    from services.launcher.block_pictures import names_of, of_body
    from services.launcher.figures import picture

    run, level = rollout.run, rollout.tree.level_of(rollout.versions[0].block)
    world = run.world(1, [0, 6, 4])
    panels = [
        level_figures.panel_of(
            version.block,
            ends_of(rollout, version.block),
            rollout.parts[version.block],
            names_of(rollout, version.block, world),
            world,
        )
        for version in rollout.versions
    ]
    path = run.folder / "figures" / f"level-{level}-ends.png"
    level_figures.draw_ends(path, panels, f"{run.name}, level {level}: where goals lead")
    caption = (
        "Where each goal of each block leads in fresh worlds (mean actions), within the range of motion."
    )
    above = [each for each in rollout.versions if each.block in rollout.arrived and each.block != detailed]
    pictured = [line for version in above for line in of_body(rollout, version, world)]
    return [*picture(f"level-{level}-ends", caption), *pictured]


def _learning(survey: Survey, level: int) -> list[str]:
    from services.launcher import level_figures
    from services.launcher.figures import picture

    run = survey.run
    blocks = run.levels[level]
    path = run.folder / "figures" / f"level-{level}-learning.png"
    level_figures.draw_learning(path, blocks, rows_of(run, blocks), survey.curves, survey.timeline, level)
    caption = f"What the blocks of level {level} learned: scores by iteration, and what learners measured."
    return picture(f"level-{level}-learning", caption)
