"""Where everything stands on the page: the tabs, their views, and the time panel that follows."""

from collections.abc import Sequence

import rerun.blueprint as rrb

from services.dashboard.block_pages import latent_page, learning_page
from services.dashboard.body import BodyPanel, eye_path
from services.dashboard.tree import Tree
from services.dashboard.tree_pages import by_block, families_tab, goals_tab, levels_tab, tree_view
from services.dashboard.views import compare, plot, simplex_view, times, usage
from services.runtime.settings import BlockSettings, RunSettings

RUN_TIME = "run_time"
"""The timeline of the page: seconds since the run was made."""
ENV_STEPS = "env_steps"
"""The other timeline: environment steps of all actors."""
TABS = ("Overview", "Latent", "Body", "Learning", "System")
"""With a tree of blocks, Goals comes after Overview."""

DISTANCE = "Squared distance to the goal, from ground on"
REWARD = "Reward per step, from ground on"


def blueprint_of(settings: RunSettings, body: BodyPanel, tab: int = 0) -> rrb.Blueprint:
    """The page of a run, with this one of its tabs open."""
    blocks, tree = settings.block, Tree(settings)
    overview, seen, system = _overview(settings, tree, body), _body(settings, body), _system(blocks)
    if tree.deep:
        latents, learning = families_tab(tree, TABS[1]), levels_tab(tree, TABS[3])
        tabs = [overview, goals_tab(tree), latents, seen, learning, system]
    else:
        latents = _per_block(TABS[1], [latent_page(block) for block in blocks])
        learning = _per_block(TABS[3], [learning_page(block.name) for block in blocks])
        tabs = [overview, latents, seen, learning, system]
    time_panel = rrb.TimePanel(state="collapsed", timeline=RUN_TIME, play_state="following")
    return rrb.Blueprint(
        rrb.Tabs(*tabs, active_tab=tab),
        rrb.BlueprintPanel(state="hidden"),
        rrb.SelectionPanel(state="hidden"),
        time_panel,
        auto_layout=False,
        auto_views=False,
    )


def _overview(settings: RunSettings, tree: Tree, body: BodyPanel) -> rrb.Container:
    latents, measured = _of_tree(tree) if tree.deep else _of_first(settings.block)
    facts = rrb.Vertical(
        rrb.TextDocumentView(origin="/status/summary", name="Status"),
        *measured,
        plot("Environment steps per second", ["/system/steps_per_sec/**"]),
        row_shares=[1.35, 1, 1, 1],
    )
    middle = [] if body.reason else [_seen(settings, body)]
    return rrb.Vertical(
        rrb.Horizontal(latents, *middle, facts, column_shares=[1.05, *([1.0] * len(middle)), 0.9]),
        rrb.StateTimelineView(origin="/state", name="Phase", time_view=times(None)),
        row_shares=[7, 1],
        name=TABS[0],
    )


def _of_first(blocks: Sequence[BlockSettings]) -> tuple[rrb.Container, list[rrb.View]]:
    """The latents of the first block, and its distance and reward."""
    first, others = blocks[0], len(blocks) - 1
    name = "Latents" + (f" of {first.name}, one of {others + 1} blocks (all: tab Latent)" if others else "")
    latents = rrb.Vertical(simplex_view(first, name), usage(first.name, None), row_shares=[3, 1])
    distance = plot(DISTANCE, [f"/measures/{first.name}/goal_distance/**"])
    return latents, [distance, plot(REWARD, [f"/learning/{first.name}/policy/reward_mean"])]


def _of_tree(tree: Tree) -> tuple[rrb.Container, list[rrb.View]]:
    """The flow of goals over the latents of the top block, and the distance and reward of all."""
    root, names = tree.roots[0], tree.order()
    top = simplex_view(root, f"Latents of {root.name} (all: tab Latent)")
    return rrb.Vertical(tree_view(tree, small=True), top, row_shares=[1.6, 1]), [
        compare(DISTANCE, by_block(names, "/measures/{}/goal_distance/mean")),
        compare(REWARD, by_block(names, "/learning/{}/policy/reward_mean")),
    ]


def _body(settings: RunSettings, body: BodyPanel) -> rrb.Container:
    return rrb.Horizontal(_seen(settings, body), name=TABS[2])


def _seen(settings: RunSettings, body: BodyPanel) -> rrb.Container | rrb.View:
    """The body, over what its eyes see."""
    view = body.body_view(f"Body of {settings.world.id}")
    if not body.eyes or body.reason:
        return view
    eyes = [
        rrb.Spatial2DView(origin=eye_path(eye), name=eye.replace("_", " ").capitalize()) for eye in body.eyes
    ]
    return rrb.Vertical(view, rrb.Horizontal(*eyes), row_shares=[2, 1])


def _system(blocks: Sequence[BlockSettings]) -> rrb.Container:
    lags = [f"/learning/{block.name}/policy/lag_{what}" for block in blocks for what in ("mean", "max")]
    return rrb.Horizontal(
        rrb.Vertical(
            plot("Environment steps per second", ["/system/steps_per_sec/**", "/system/steps_per_sec_all"]),
            plot("Policy lag of the experience, in versions", lags),
            plot("Queue: segments on their way, frames waiting", ["/system/queue_depth/**"]),
        ),
        rrb.Vertical(
            plot(
                "Frames lost, duplicated, refused", ["/system/lost", "/system/duplicated", "/system/refused"]
            ),
            plot("CPU, cores", ["/system/cpu/**"]),
            plot("Memory, MB", ["/system/rss_mb/**"]),
        ),
        rrb.Vertical(
            rrb.TextDocumentView(origin="/status/members", name="Members"),
            rrb.StateTimelineView(origin="/members", name="Who was there", time_view=times(None)),
            _events(),
            row_shares=[1, 1.2, 0.9],
        ),
        column_shares=[1, 1, 1.4],
        name=TABS[4],
    )


def _per_block(name: str, parts: Sequence[rrb.Container]) -> rrb.Container:
    """One part, or a tab for each block."""
    if len(parts) == 1:
        return rrb.Horizontal(*parts, name=name)
    return rrb.Tabs(*parts, name=name, active_tab=0)


def _events() -> rrb.View:
    columns = rrb.TextLogColumns(timeline_columns=[RUN_TIME], text_log_columns=["LogLevel", "Body"])
    return rrb.TextLogView(origin="/events", name="Events", columns=columns)
