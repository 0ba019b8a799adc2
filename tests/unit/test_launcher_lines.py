"""Words and tables that people read, and where they are shown."""

import io

import pytest

from services.launcher.conclusion import print_rows
from services.launcher.display import LiveDisplay, PlainDisplay, display_for
from services.launcher.lines import brief, clock_words, cpu_table, progress_line, score_table
from tests.unit.launcher_picture import practising, row, sharing


def test_the_score_table_fits_60_and_names_blocks_only_if_there_are_several() -> None:
    table = score_table([row(0), row(1, "sampled")])
    assert table[0].split() == ["iter", "policy", "separation", "z_min", "z_goal", "switch", "crossing"]
    assert table[2].split() == ["1", "sampled", "0.988", "0.500", "0.750", "1.000", "0.500"]
    assert max(map(len, table)) <= 60
    assert "crossing" not in score_table([row(0, crossing=None)])[0]
    assert score_table([row(0, block="arm"), row(0, block="leg")])[1::2] == ["arm:", "leg:"]
    assert len(score_table([row(i) for i in range(9)], newest=4)) == 5


@pytest.mark.parametrize("crossing", [None, 0.5])
@pytest.mark.parametrize("landmarks", [{}, {"open": 1.0, "closed": 0.5}])
@pytest.mark.parametrize("reward", [None, 0.25, -1234.5678, 3e30])
def test_whatever_the_rows_have_the_score_table_is_never_wider_than_60(
    crossing: float | None, landmarks: dict[str, float], reward: float | None
) -> None:
    rows = [
        {**row(999, "sampled", crossing, block), "landmarks": landmarks, "external_reward": reward}
        for block in ("arm", "b" * 64)
    ]
    table = score_table(rows)
    assert max(map(len, table)) <= 60
    asked = ["z_min", *(["crossing"] if crossing else []), *(["landmark"] if landmarks else ["separation"])]
    assert set(asked) <= set(table[0].split()), "what success is asked of is always shown"


def test_durations_and_cpu() -> None:
    assert [clock_words(secs) for secs in (-1, 42.4, 725, 3723)] == ["0:00", "0:42", "12:05", "1:02:03"]
    assert cpu_table({"router": 1.0, "actor-0": 2.25}) == [
        "router       1.0 s",
        "actor-0      2.2 s",
        "all          3.2 s",
    ]


def test_plain_lines_come_on_changes_and_every_ten_seconds() -> None:
    out = io.StringIO()
    seen = practising()
    seen.news.clear()
    seen.scores = []
    with PlainDisplay(out) as display:
        for tenth in range(250):
            if tenth == 30:
                seen.news.append("actor-9 is there")
            if tenth == 40:
                seen.scores = [row(0)]
            display.show(seen, tenth / 10)
    lines = out.getvalue().splitlines()
    assert [line.split(" s  ")[0].strip() for line in lines] == ["3.0", "4.0", "10.0", "20.0"]
    assert lines[0].endswith("actor-9 is there")
    assert "iteration 0, mean policy: separation 0.988" in lines[1]
    assert "PRACTISE 2 of 4: body 1,228,800 of 12,288,000 steps" in lines[2]
    assert lines[2].endswith("InfoNCE 2.35, reward -0.25")


def test_a_plain_line_tells_several_learners_apart_and_who_waits_for_one() -> None:
    assert progress_line(sharing(), 1.0) == (
        "GROUND: policy_learner-arm: arm0 50 of 100 steps; policy_learner-leg: leg0 50 of 100 steps"
    )
    assert progress_line(sharing(lost=True), 2.5) == (
        "GROUND: arm0 50 of 100 steps; waiting for a learner: leg0"
    )


def test_of_many_blocks_a_plain_line_tells_together() -> None:
    assert progress_line(sharing(blocks=9, lost=True), 2.5) == (
        "GROUND: 9 blocks 450 of 900 steps, least of arm0 50 of 100; "
        "waiting for a learner: leg0, leg1, leg2, leg3, 5 more"
    )


def test_of_a_long_run_a_plain_line_comes_each_minute() -> None:
    out = io.StringIO()
    seen = practising()
    seen.news.clear()
    seen.scores = []
    with PlainDisplay(out) as display:
        for second in range(7201):
            display.show(seen, float(second))
    lines = [float(line.split(" s  ")[0]) for line in out.getvalue().splitlines()]
    assert lines[:3] == [10.0, 20.0, 30.0]
    assert lines[-1] - lines[-2] == 60.0
    assert len(lines) < 160


def test_without_a_router_the_plain_view_says_so() -> None:
    seen = practising()
    seen.link(False, 3.0)
    assert progress_line(seen, 4.0) == "waiting for the router"


class _Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


@pytest.mark.parametrize(
    ("out", "term", "kind"),
    [
        (io.StringIO(), "xterm-256color", PlainDisplay),
        (_Terminal(), "dumb", PlainDisplay),
        (_Terminal(), "xterm-256color", LiveDisplay),
    ],
)
def test_only_a_terminal_that_can_redraw_gets_the_live_view(
    out: io.StringIO, term: str, kind: type, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("TERM", term)
    assert isinstance(display_for(out), kind)


def test_of_long_runs_the_newest_iterations_of_each_block_and_the_kept_one_are_shown() -> None:
    rows = [
        row(i, policy, block=b) for i in range(200) for b in ("arm", "leg") for policy in ("mean", "sampled")
    ]
    shown = brief(rows, {"arm": {"iteration": 7}, "leg": {"iteration": 199}}, 3)
    found = {(each["block"], each["iteration"]) for each in shown}
    assert found == {("arm", i) for i in (7, 197, 198, 199)} | {("leg", i) for i in (197, 198, 199)}
    assert len(shown) == 2 * len(found)
    assert next(each["iteration"] for each in shown if each["block"] == "arm") == 7
    assert brief(rows[:4], {}, 3) == rows[:4]


def test_at_the_end_of_a_run_of_many_blocks_each_has_one_line(capsys: pytest.CaptureFixture[str]) -> None:
    rows = [
        row(i, policy, block=f"part_{b}")
        for b in range(23)
        for i in range(3)
        for policy in ("mean", "sampled")
    ]
    best = {f"part_{b}": {"iteration": b % 3, "reason": "made up"} for b in range(23)}
    print_rows(rows, best, "runs/x/scores.jsonl")
    lines = capsys.readouterr().out.splitlines()
    kept = {tuple(line.split()[:3]) for line in lines if line.startswith("part_")}
    assert kept == {(f"part_{b}", str(b % 3), "mean") for b in range(23)}
    assert len(lines) == 25
