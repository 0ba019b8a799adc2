"""Where everything stands on the page: the tabs, their views, and the time panel that follows."""

from collections.abc import Sequence

import rerun as rr
import rerun.blueprint as rrb

from services.dashboard.body import BodyPanel, eye_path
from services.dashboard.latents import line_bounds
from services.dashboard.simplex import Simplex, simplex_of
from services.runtime.settings import BlockSettings, RunSettings

RUN_TIME = "run_time"
"""The timeline of the page: seconds since the run was made."""
ENV_STEPS = "env_steps"
"""The other timeline: environment steps of all actors."""
RECENT_SECS = 120
"""Plots of latents show so much of the past; the others all of it."""
TABS = ("Overview", "Latent", "Body", "Learning", "System")


def blueprint_of(settings: RunSettings, body: BodyPanel, tab: int = 0) -> rrb.Blueprint:
    """The page of a run, with this one of its `TABS` open."""
    blocks = settings.block
    tabs = [
        _overview(settings, body),
        _per_block("Latent", [_latent(block) for block in blocks]),
        _body(settings, body),
        _per_block("Learning", [_learning(block.name) for block in blocks]),
        _system(blocks),
    ]
    time_panel = rrb.TimePanel(state="collapsed", timeline=RUN_TIME, play_state="following")
    return rrb.Blueprint(
        rrb.Tabs(*tabs, active_tab=tab),
        rrb.BlueprintPanel(state="hidden"),
        rrb.SelectionPanel(state="hidden"),
        time_panel,
        auto_layout=False,
        auto_views=False,
    )


def _overview(settings: RunSettings, body: BodyPanel) -> rrb.Container:
    first, others = settings.block[0], len(settings.block) - 1
    name = "Latents" + (f" of {first.name}, one of {others + 1} blocks (all: tab Latent)" if others else "")
    latents = rrb.Vertical(_simplex(first, name), _usage(first.name, None), row_shares=[3, 1])
    facts = rrb.Vertical(
        rrb.TextDocumentView(origin="/status/summary", name="Status"),
        _plot("Squared distance to the goal, from ground on", [f"/measures/{first.name}/goal_distance/**"]),
        _plot("Reward per step, from ground on", [f"/learning/{first.name}/policy/reward_mean"]),
        _plot("Environment steps per second", ["/system/steps_per_sec/**"]),
        row_shares=[1.35, 1, 1, 1],
    )
    middle = [] if body.reason else [_seen(settings, body)]
    return rrb.Vertical(
        rrb.Horizontal(latents, *middle, facts, column_shares=[1.05, *([1.0] * len(middle)), 0.9]),
        rrb.StateTimelineView(origin="/state", name="Phase", time_view=_times(None)),
        row_shares=[7, 1],
        name=TABS[0],
    )


def _latent(block: BlockSettings) -> rrb.Container:
    measures = rrb.Vertical(
        _plot(
            f"Squared distance to the goal{_ago(RECENT_SECS)}",
            [f"/measures/{block.name}/goal_distance/**"],
            RECENT_SECS,
        ),
        _plot(
            f"Entropy, 0 to 1{_ago(RECENT_SECS)}",
            [f"/measures/{block.name}/latent_entropy", f"/measures/{block.name}/usage_entropy"],
            RECENT_SECS,
            axis=rrb.ScalarAxis(range=(0.0, 1.05)),
        ),
        _usage(block.name, RECENT_SECS),
    )
    reading = rrb.TextDocumentView(origin=f"/status/reading/{block.name}", name="How to read it")
    name = f"Latents of {block.name}, d = {block.latent_dim}"
    drawing = rrb.Vertical(_simplex(block, name), reading, row_shares=[7, 1])
    return rrb.Horizontal(drawing, measures, column_shares=[1.6, 1], name=block.name)


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


def _learning(block: str) -> rrb.Container:
    encoder, policy = f"/learning/{block}/encoder", f"/learning/{block}/policy"
    plots = [
        _plot("Encoder: InfoNCE loss", [f"{encoder}/loss"]),
        _plot("Encoder: alignment and uniformity", [f"{encoder}/alignment", f"{encoder}/uniformity"]),
        _plot("Encoder: accuracy", [f"{encoder}/accuracy"]),
        _plot("Policy: reward per step", [f"{policy}/reward_mean"]),
        _plot("Policy: losses of PPO", [f"{policy}/loss", f"{policy}/policy_loss", f"{policy}/value_loss"]),
        _plot("Policy: KL divergence and clipped share", [f"{policy}/approx_kl", f"{policy}/clip_fraction"]),
        _plot("Policy: entropy", [f"{policy}/entropy"]),
        _plot("Policy: explained variance", [f"{policy}/explained_variance"]),
        _plot("Scores of each evaluation", [f"/scores/{block}/**"]),
    ]
    table = rrb.TextDocumentView(origin="/status/scores", name="Scores")
    return rrb.Vertical(
        *(rrb.Horizontal(*plots[row : row + 3]) for row in range(0, len(plots), 3)),
        table,
        row_shares=[1, 1, 1, 0.8],
        name=block,
    )


def _system(blocks: Sequence[BlockSettings]) -> rrb.Container:
    lags = [f"/learning/{block.name}/policy/lag_{what}" for block in blocks for what in ("mean", "max")]
    return rrb.Horizontal(
        rrb.Vertical(
            _plot("Environment steps per second", ["/system/steps_per_sec/**", "/system/steps_per_sec_all"]),
            _plot("Policy lag of the experience, in versions", lags),
            _plot("Queue: segments on their way, frames waiting", ["/system/queue_depth/**"]),
        ),
        rrb.Vertical(
            _plot(
                "Frames lost, duplicated, refused", ["/system/lost", "/system/duplicated", "/system/refused"]
            ),
            _plot("CPU, cores", ["/system/cpu/**"]),
            _plot("Memory, MB", ["/system/rss_mb/**"]),
        ),
        rrb.Vertical(
            rrb.TextDocumentView(origin="/status/members", name="Members"),
            rrb.StateTimelineView(origin="/members", name="Who was there", time_view=_times(None)),
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


def _simplex(block: BlockSettings, name: str) -> rrb.View:
    drawing, origin = simplex_of(block.latent_dim), f"/latent/{block.name}"
    if drawing.solid:
        eye = rrb.EyeControls3D(position=(0.5, -2.6, 1.0), look_target=(0, 0, 0.1), eye_up=(0, 0, 1))
        return rrb.Spatial3DView(origin=origin, name=name, eye_controls=eye, line_grid=False)
    across, down = _bounds(drawing)
    bounds = rrb.VisualBounds2D(x_range=across, y_range=down)
    return rrb.Spatial2DView(origin=origin, name=name, visual_bounds=bounds)


def _bounds(drawing: Simplex) -> tuple[tuple[float, float], tuple[float, float]]:
    return line_bounds() if drawing.latent_dim == 2 else drawing.bounds()


def _usage(block: str, recent_secs: int | None) -> rrb.View:
    name = f"Share of recent latents nearest to each vertex{_ago(recent_secs)}"
    return _plot(name, [f"/measures/{block}/usage/**"], recent_secs, rrb.ScalarAxis(range=(0.0, 1.0)))


def _plot(
    name: str, paths: Sequence[str], recent_secs: int | None = None, axis: rrb.ScalarAxis | None = None
) -> rrb.View:
    """Lines over the run's time: the last `recent_secs`, or all of it."""
    return rrb.TimeSeriesView(
        origin="/",
        contents=[f"+ {path}" for path in paths],
        name=name,
        axis_x=_times(recent_secs),
        axis_y=axis,
        plot_legend=rrb.PlotLegend(corner=rrb.Corner2D.LeftTop),
    )


def _times(recent_secs: int | None) -> rrb.TimeAxis:
    """From so long before the cursor, or from the beginning, to the cursor."""
    start = rr.TimeRangeBoundary.infinite()
    if recent_secs is not None:
        start = rr.TimeRangeBoundary.cursor_relative(seconds=-recent_secs)
    return rrb.TimeAxis(view_range=rr.TimeRange(start=start, end=rr.TimeRangeBoundary.cursor_relative()))


def _ago(recent_secs: int | None) -> str:
    return "" if recent_secs is None else f", last {recent_secs // 60} min"


def _events() -> rrb.View:
    columns = rrb.TextLogColumns(timeline_columns=[RUN_TIME], text_log_columns=["LogLevel", "Body"])
    return rrb.TextLogView(origin="/events", name="Events", columns=columns)
