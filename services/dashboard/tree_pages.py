"""The tabs of a run with a tree of blocks: the flow of goals, and blocks by family and by level."""

import math
from collections.abc import Mapping, Sequence

import rerun.blueprint as rrb

from services.dashboard.block_pages import latent_page, learning_page
from services.dashboard.goals import aim_path, near_path, tree_bounds
from services.dashboard.tree import Family, Tree
from services.dashboard.views import MOST_NAMED, RECENT_SECS, ago, compare, simplex_view, times
from services.runtime.settings import BlockSettings

GOAL_SECS = 30
"""Goals change fast: their lanes show so much of the past."""
GOALS = "Goals"
SCORES = "Scores"
SHARE = rrb.ScalarAxis(range=(-0.03, 1.03))


def goals_tab(tree: Tree) -> rrb.Container:
    """The picture of the tree, beside the goals of each family over time."""
    families = [_flow(tree, family) for family in tree.families]
    flows = rrb.Tabs(*families, active_tab=0) if len(families) > 1 else families[0]
    reading = rrb.TextDocumentView(origin="/status/reading/goals", name="How to read it")
    picture = rrb.Vertical(tree_view(tree), reading, row_shares=[8, 1])
    return rrb.Horizontal(picture, flows, column_shares=[1.25, 1], name=GOALS)


def tree_view(tree: Tree, *, small: bool = False) -> rrb.View:
    """The blocks, what they aim at and how near they are; a small one leaves out texts that would not fit."""
    across, down = tree_bounds(tree)
    bounds = rrb.VisualBounds2D(x_range=across, y_range=down)
    bare = small and len(tree.order()) > MOST_NAMED
    contents = ["+ $origin/**", *(["- $origin/names/**"] if bare else [])]
    name = "Flow of goals" + (" (names: tab Goals)" if bare else "")
    return rrb.Spatial2DView(origin="/goals/tree", contents=contents, name=name, visual_bounds=bounds)


def families_tab(tree: Tree, name: str) -> rrb.Container:
    """A tab for each family, the top one first, and for each block that is in none."""
    alone = [latent_page(block) for block in tree.roots if not block.children]
    return rrb.Tabs(*(_family(family, tree) for family in tree.families), *alone, name=name, active_tab=0)


def levels_tab(tree: Tree, name: str) -> rrb.Container:
    """What is learned on each level, in the order in which they learn."""
    tabs = [_level(level, names) for level, names in enumerate(tree.levels)]
    return rrb.Tabs(*tabs, name=name, active_tab=0)


def by_block(names: Sequence[str], path: str) -> Mapping[str, str]:
    """Entities of blocks, by block; `path` has {} for the name."""
    return {name: path.format(name) for name in names}


def _flow(tree: Tree, family: Family) -> rrb.Container:
    """Lanes: what the parent aims at, above what it lets its children aim at; lines: how they follow."""
    names = [block.name for block in family.members]
    lanes = rrb.StateTimelineView(
        origin="/goals/aim",
        contents=[f"+ {aim_path(tree, name)}" for name in names],
        name=f"What {family.parent.name} and its children aim at",
        time_view=times(GOAL_SECS),
    )
    near = {name: near_path(name) for name in names}
    lines = compare("z_goal: how near they are", near, GOAL_SECS, SHARE)
    return rrb.Vertical(lanes, lines, row_shares=[1, 1], name=family.parent.name)


def _family(family: Family, tree: Tree) -> rrb.Container:
    """All simplexes of a family at once, then a tab for each block that has none in another family."""
    parent, children = family.parent, family.children
    names = [block.name for block in family.members]
    distances = compare(
        f"Squared distance to the goal{ago(RECENT_SECS)}",
        by_block(names, "/measures/{}/goal_distance/mean"),
        RECENT_SECS,
    )
    above = rrb.Vertical(_simplex(parent), distances, row_shares=[1.5, 1])
    below = rrb.Grid(*(_simplex(child) for child in children), grid_columns=_columns(len(children)))
    together = rrb.Horizontal(above, below, column_shares=[1, 1.4], name="together")
    own = [*([] if parent.name in tree.parents else [parent]), *children]
    return rrb.Tabs(together, *(latent_page(block) for block in own), name=parent.name, active_tab=0)


def _level(level: int, names: Sequence[str]) -> rrb.Container:
    """The blocks of a level side by side, then a tab for each."""
    compared = {
        "Encoder: InfoNCE loss": "/learning/{}/encoder/loss",
        "Encoder: accuracy": "/learning/{}/encoder/accuracy",
        "Policy: reward per step": "/learning/{}/policy/reward_mean",
        "Policy: entropy": "/learning/{}/policy/entropy",
        f"{SCORES}: z_min": "/scores/{}/z_min",
        f"{SCORES}: z_goal": "/scores/{}/z_goal",
    }
    plots = [
        compare(title, by_block(names, path), dots=title.startswith(SCORES))
        for title, path in compared.items()
    ]
    table = rrb.TextDocumentView(origin="/status/scores", name=SCORES)
    together = rrb.Vertical(
        *(rrb.Horizontal(*plots[row : row + 2]) for row in range(0, len(plots), 2)),
        table,
        row_shares=[1, 1, 1, 0.9],
        name="together",
    )
    pages = [learning_page(name) for name in names]
    return rrb.Tabs(together, *pages, name=f"Level {level}", active_tab=0)


def _simplex(block: BlockSettings) -> rrb.View:
    return simplex_view(block, f"{block.name}, d = {block.latent_dim}")


def _columns(count: int) -> int:
    return math.ceil(math.sqrt(count))
