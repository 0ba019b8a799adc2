"""The dashboard as a process: hears views, statuses, phases and members, and lets the panels draw them.

The only room with a loop. Callbacks of the bus only fill bounded inboxes; all drawing happens here, so
that nothing in a viewer can reach further than this process.
"""

import logging
from collections.abc import Sequence
from typing import Any

from protocol import keys
from protocol.gate import Gate
from protocol.messages import PhaseAnnounced, Status, View
from protocol.refusal import Reason, Refused
from services.dashboard.blueprint import blueprint_of
from services.dashboard.body import BodyPanel
from services.dashboard.canvas import Due, Panel
from services.dashboard.config import DashboardOptions, created_secs, options_of, past_scores
from services.dashboard.goals import GoalsPanel
from services.dashboard.latent_book import LatentBook
from services.dashboard.latents import LatentsPanel
from services.dashboard.learning import LearningPanel
from services.dashboard.measures import MeasuresPanel
from services.dashboard.pages import stream_origins
from services.dashboard.phase import PhasePanel
from services.dashboard.recording import Recording
from services.dashboard.roster import News, Roster
from services.dashboard.system import SystemPanel
from services.dashboard.tree import Tree
from services.dashboard.web_server import WebServer
from services.runtime.bus import Frame, Inbox, Link, Membership
from services.runtime.phases import phase_words
from services.runtime.process import Context
from services.runtime.status import Heart

log = logging.getLogger(__name__)

SERVICE = "dashboard"
DRAW_SECS = 0.1
FAREWELL_SECS = 1.2
"""After DONE the last scores and statuses may take so long to come."""
MAX_VIEW_BYTES = 64 << 20
"""of frames with views that wait"""
RECORDING = "recording"
"""The folder of the files, in the run's folder."""
LEDGER = "counts.json"
"""In the same folder: what all processes had counted when a dashboard last lived."""
LEDGER_SECS = 20.0


class Dashboard:
    """See `README.md`. Raises `UserError` for ports and options that cannot be."""

    def __init__(self, context: Context) -> None:
        settings, options = context.settings, options_of(context.options)
        self._context = context
        self._created_secs, tree = created_secs(context.run_dir), Tree(settings)
        self._gate = Gate(context.run, {"view", "status", "phase"})
        self._books = {block.name: LatentBook(block.name, block.latent_dim) for block in settings.block}
        self._roster = Roster(settings.wire.status_secs)
        self._ledger_path = context.run_dir / RECORDING / LEDGER
        self._ledger_due = Due(LEDGER_SECS)
        self._roster.ledger.read(self._ledger_path)
        self._body = BodyPanel(settings)
        self._learning = LearningPanel(self._books, tree.levels)
        self._learning.recall(past_scores(context.run_dir))
        self._phase = PhasePanel(self._roster, self._books, settings)
        panels: list[Panel] = [
            self._phase,
            LatentsPanel(self._books),
            MeasuresPanel(self._books),
            GoalsPanel(tree, self._books),
            self._body,
            self._learning,
            SystemPanel(self._roster),
        ]
        self._recording = _recording(context, options, self._body, panels)
        self._web = _serving(context, options, self._recording)
        self._heart = _heart(context)
        self._superseded = self._views_drawn = 0
        self._done_secs: float | None = None
        self._drawn_secs = float("-inf")
        self._stopping = self._ended = False
        self._listen()

    def poll(self, now_secs: float) -> float | None:
        """Hear and draw if it is time; seconds until the next time, None once all is done and written."""
        if self._ended:
            return None
        left_secs = self._drawn_secs + DRAW_SECS - now_secs
        if 0 < left_secs <= DRAW_SECS and not self._stopping:
            return left_secs
        self._drawn_secs = now_secs
        self._hear(now_secs)
        self._draw(now_secs)
        over = self._done_secs is not None and now_secs - self._done_secs >= FAREWELL_SECS
        self._heart.poll(now_secs, self._report, urgent=over or self._stopping)
        if over or self._stopping:
            self._ended = True
            self._roster.ledger.write(self._ledger_path)
            self._recording.close()
            self._web.close()
            return None
        return DRAW_SECS

    def stop(self) -> None:
        """End at the next poll; what was drawn so far is written."""
        self._stopping = True

    def _listen(self) -> None:
        """The inboxes ring nobody: what they hold is looked at ten times a second, however much comes."""
        context, delivery = self._context, keys.DELIVERY
        self._views = Inbox(max_frames=delivery["view"].keep * len(self._books), max_bytes=MAX_VIEW_BYTES)
        self._statuses = Inbox(max_frames=delivery["status"].keep)
        self._control = Inbox(max_frames=delivery["status"].keep)
        context.bus.subscribe("phase", keys.phase(context.run), self._control)
        context.bus.watch_link(self._control)
        context.bus.watch(keys.alive(context.run, "*", "*"), self._control)
        context.bus.subscribe("status", keys.status(context.run, "*", "*"), self._statuses)
        context.bus.subscribe("view", keys.view(context.run, "*", "*"), self._views)

    def _hear(self, now_secs: float) -> None:
        arrivals = self._control.take_all()
        # By name, so that a dashboard that starts again gives those that are there their old short names.
        members = [arrival for arrival in arrivals if isinstance(arrival, Membership)]
        for member in sorted(members, key=lambda member: member.key):
            self._hear_member(member.key, member.present, now_secs)
        for arrival in arrivals:
            match arrival:
                case Link(up=up):
                    self._roster.link(up, now_secs)
                case Frame(key=key, data=data):
                    message = self._gate.admit(key, data)
                    if isinstance(message, PhaseAnnounced) and self._phase.hear(message):
                        self._begin_term(message, now_secs)
        self._hear_statuses(now_secs)
        self._hear_views(now_secs)

    def _hear_member(self, key: str, present: bool, now_secs: float) -> None:
        try:
            service, life = keys.member(key)
        except ValueError as error:
            log.warning("%s", error)
            return
        if present:
            self._roster.appeared(service, life, now_secs)
        else:
            self._roster.vanished(life, now_secs)

    def _begin_term(self, announced: PhaseAnnounced, now_secs: float) -> None:
        self._heart.enter(announced.term, announced.phase)
        self._roster.news.append(News(phase_words(announced)))
        if self._phase.done and self._done_secs is None:
            self._done_secs = now_secs

    def _hear_statuses(self, now_secs: float) -> None:
        for arrival in self._statuses.take_all():
            status = self._gate.admit(arrival.key, arrival.data) if isinstance(arrival, Frame) else None
            if isinstance(status, Status):
                self._roster.hear(status, now_secs)
                self._learning.hear_status(status)

    def _hear_views(self, now_secs: float) -> None:
        """Of what came since the last look only the newest of each kind is drawn."""
        newest: dict[tuple[str, str, str, str], View] = {}
        for arrival in self._views.take_all():
            view = self._gate.admit(arrival.key, arrival.data) if isinstance(arrival, Frame) else None
            if isinstance(view, View):
                kind = (view.life, view.view, view.block, view.title)
                self._superseded += kind in newest
                newest[kind] = view
        for view in newest.values():
            try:
                self._hear_view(view, now_secs)
                self._views_drawn += 1
            except ValueError as error:
                self._gate.refuse(Refused(Reason.UNEXPECTED, str(error)))

    def _hear_view(self, view: View, now_secs: float) -> None:
        """Raises ValueError for a view that does not belong to this run's blocks."""
        if view.view == "latent" and view.block not in self._books:
            raise ValueError(f"{view.life} sent latents of block {view.block!r}, which this run has not")
        label = self._roster.meet_actor(view.life, now_secs)
        if label is None:
            return
        if view.view == "latent":
            self._books[view.block].hear(label, view, now_secs)
        self._body.hear_view(view.model_copy(update={"life": label}), now_secs)

    def _draw(self, now_secs: float) -> None:
        self._roster.done = self._phase.done
        self._roster.settle(now_secs)
        self._phase.note([self._recording.parts.last_error, self._web.error])
        self._recording.draw(now_secs, now_secs - self._created_secs, self._roster.ledger["env_steps"])
        if self._ledger_due(now_secs):
            self._roster.ledger.write(self._ledger_path)

    def _report(self) -> dict[str, Any]:
        parts = self._recording.parts
        return {
            "totals": {
                "views": self._views_drawn,
                "superseded_views": self._superseded,
                "ignored_views": self._body.ignored,
                "dropped_views": self._views.dropped,
                "dropped_statuses": self._statuses.dropped + self._control.dropped,
                "rows": self._recording.rows,
                "recorded_bytes": parts.bytes,
                "recording_parts": parts.opened,
                "deleted_parts": parts.deleted,
                "recording_errors": parts.errors,
                "members_not_shown": self._roster.not_shown,
                "refused_connections": self._web.refused,
            },
            "refused": dict(self._gate.refused),
            "queue_depth": len(self._views) + len(self._statuses) + len(self._control),
            "last_error": parts.last_error or self._web.error or self._gate.last_refusal,
        }


def _recording(
    context: Context, options: DashboardOptions, body: BodyPanel, panels: Sequence[Panel]
) -> Recording:
    view = context.settings.view
    return Recording(
        context.run,
        folder=context.run_dir / RECORDING,
        bound_bytes=view.recording_mb * 1_000_000,
        bind=options.bind,
        grpc_port=options.grpc_port,
        server_memory_mb=options.server_memory_mb,
        stream_origins=stream_origins(options.bind, options.allow_origin),
        blueprint=blueprint_of(context.settings, body),
        panels=panels,
    )


def _serving(context: Context, options: DashboardOptions, recording: Recording) -> WebServer:
    """The page of the recording, which is closed where there can be none."""
    web = WebServer(
        options.bind,
        options.web_port,
        recording.grpc_port,
        context.run,
        context.life,
        options.allow_origin,
    )
    try:
        web.start()
    except BaseException:
        recording.close()
        raise
    log.info("the dashboard is at %s", web.url)
    return web


def _heart(context: Context) -> Heart:
    return Heart(
        context.bus,
        run=context.run,
        service=SERVICE,
        life=context.life,
        interval_secs=context.settings.wire.status_secs,
    )


def build(context: Context) -> Dashboard:
    """The dashboard of a run."""
    return Dashboard(context)
