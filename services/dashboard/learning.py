"""What the learners measure, and the scores of each evaluation."""

from collections.abc import Collection, Iterable, Mapping, Sequence

from protocol.messages import Score, Status
from services.dashboard.canvas import Canvas, Due, Lines, page
from services.dashboard.colours import (
    BLUE,
    GREEN,
    GREY,
    ORANGE,
    PURPLE,
    SKY,
    VERMILLION,
    WHITE,
    YELLOW,
    Colour,
    of_index,
)

MEASURES: Mapping[str, Mapping[str, tuple[str, Colour]]] = {
    "encoder": {
        "loss": ("InfoNCE loss", SKY),
        "accuracy": ("accuracy", GREEN),
        "alignment": ("alignment", ORANGE),
        "uniformity": ("uniformity", PURPLE),
    },
    "policy": {
        "reward_mean": ("reward per step", GREEN),
        "loss": ("all", WHITE),
        "policy_loss": ("policy", SKY),
        "value_loss": ("value loss", ORANGE),
        "explained_variance": ("explained variance", BLUE),
        "approx_kl": ("KL divergence", PURPLE),
        "clip_fraction": ("clipped", YELLOW),
        "entropy": ("entropy", SKY),
        "std": ("deviation of actions", GREY),
        "lag_mean": ("mean", SKY),
        "lag_max": ("most", VERMILLION),
    },
}
"""By learner and measure: name and colour of the line. `Status.metrics` has <block>/<learner>/<measure>."""
SCORES: Mapping[str, tuple[str, Colour]] = {
    "separation": ("separation", SKY),
    "separation_worst": ("worst separation", BLUE),
    "z_min": ("z_min", ORANGE),
    "z_goal": ("z_goal", GREEN),
    "switch_success": ("switches", PURPLE),
    "crossing": ("crossings", YELLOW),
    "external_reward": ("task's reward", VERMILLION),
}
THIN_SECS = 2.0
MOST_ROWS = 16
"""of the table of scores; the newest"""
MOST_LIVES = 64
"""of learners, whose totals are kept"""

Key = tuple[str, int, str, str]


class LearningPanel:
    """Under /learning/<block> and /scores/<block>; a measure is a row only after work that changed it."""

    def __init__(self, blocks: Collection[str], levels: Sequence[Sequence[str]] = ()) -> None:
        """`levels`: the names of the blocks of each level, that of the leaves first."""
        self._blocks, self._levels = tuple(blocks), levels
        self._lines = Lines()
        self._totals: dict[str, Mapping[str, int]] = {}
        self._measured: dict[str, float] = {}
        self._scores: dict[Key, Score] = {}
        self._found: list[Score] = []
        self._due = Due(THIN_SECS)

    @property
    def scores(self) -> list[Score]:
        """The scores heard so far, in that order."""
        return list(self._scores.values())

    def recall(self, scores: Iterable[Score]) -> None:
        """Take scores from before this dashboard began, for the table alone: they have no time."""
        for score in scores:
            if score.block in self._blocks:
                self._scores.setdefault(_key(score), score)

    def hear_status(self, status: Status) -> None:
        """Take a learner's measures and scores."""
        for score in status.scores:
            if score.block in self._blocks and _key(score) not in self._scores:
                self._found.append(score)
                self._scores[_key(score)] = score
        if not status.service.endswith("_learner") or self._totals.get(status.life) == status.totals:
            return
        self._totals.pop(status.life, None)
        self._totals[status.life] = status.totals
        if len(self._totals) > MOST_LIVES:
            del self._totals[next(iter(self._totals))]
        for name, value in status.metrics.items():
            block, _, rest = name.partition("/")
            learner, _, measure = rest.partition("/")
            if block in self._blocks and measure in MEASURES.get(learner, ()):
                self._measured[name] = value

    def begin(self, canvas: Canvas) -> None:
        """Name the lines, and say the scores so far."""
        self._lines.begin(canvas)
        canvas.log("/status/scores", page(self._table()))

    def draw(self, canvas: Canvas, now_secs: float) -> None:
        """Log what is new."""
        if self._measured:
            thin = self._due(now_secs)
            for name, value in self._measured.items():
                self._lines.name(canvas, f"/learning/{name}", *self._style(name))
                self._lines.add(canvas, f"/learning/{name}", value, thin=thin)
            self._measured.clear()
        if self._found:
            for score in self._found:
                self._draw_score(canvas, score)
            self._found.clear()
            canvas.log("/status/scores", page(self._table()))

    def _table(self) -> str:
        deep = len(self._levels) > 1
        return tree_scores_table(self.scores, self._levels) if deep else scores_table(self.scores)

    def _style(self, name: str) -> tuple[str, Colour]:
        """Name and colour of a measure's line; the lag of all blocks is in one plot."""
        block, learner, measure = name.split("/")
        title, colour = MEASURES[learner][measure]
        if measure.startswith("lag_") and len(self._blocks) > 1:
            return f"{block}: {title}", of_index(2 * self._blocks.index(block) + (measure == "lag_max"))
        return title, colour

    def _draw_score(self, canvas: Canvas, score: Score) -> None:
        """A dot per evaluation; the mean actions' only, or there would be two at a time."""
        if score.policy != "mean":
            return
        for name, (title, colour) in SCORES.items():
            path = f"/scores/{score.block}/{name}"
            value = getattr(score, name)
            if value is not None:
                if path not in self._lines:
                    self._lines.name(canvas, path, title, colour, 2.0, dots=True)
                self._lines.add(canvas, path, value)


def _key(score: Score) -> Key:
    return score.block, score.iteration, str(score.phase), score.policy


def scores_table(scores: Collection[Score]) -> str:
    """The newest scores as a table in Markdown, the last on top."""
    if not scores:
        return "There are scores after the first evaluation, which follows on ground."
    return _table(["block"], [([score.block], score) for score in reversed(list(scores)[-MOST_ROWS:])])


def tree_scores_table(scores: Collection[Score], levels: Sequence[Sequence[str]]) -> str:
    """The newest score of each block's mean actions, by level, the top one first."""
    newest = {score.block: score for score in scores if score.policy == "mean"}
    rows = [
        ([str(level), block], newest[block])
        for level, blocks in reversed(list(enumerate(levels)))
        for block in blocks
        if block in newest
    ]
    return _table(["level", "block"], rows) if rows else scores_table(())


def _table(heads: Sequence[str], rows: Iterable[tuple[Sequence[str], Score]]) -> str:
    """Scores in Markdown, after cells of their own."""
    names = [*heads, "after", "actions", *(title for title, _ in SCORES.values())]
    lines = ["| " + " | ".join(names) + " |", "|" + "---|" * len(names)]
    for cells, score in rows:
        after = f"{score.phase} {score.iteration}" if score.iteration else str(score.phase)
        values = [getattr(score, name) for name in SCORES]
        numbers = ["" if value is None else f"{value:.3f}" for value in values]
        lines.append("| " + " | ".join([*cells, after, score.policy, *numbers]) + " |")
    return "\n".join(lines)
