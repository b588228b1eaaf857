"""Page and pictures of the judge of touch: of robots drawn from known curves, and of little or no data."""

from __future__ import annotations

import itertools
import math
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.text import Text

from pepper_driver.evaluation.touch.map import n90_figure, newtons_text
from pepper_driver.evaluation.touch.n90 import wilson_interval
from pepper_driver.evaluation.touch.page import (
    fraction_text,
    ledger_table,
    rate_text,
    short_number,
    touch_page,
)
from pepper_driver.evaluation.touch.recall import (
    recall_by_group,
    recall_by_observer,
    recall_figure,
    write_touch_pictures,
)
from pepper_driver.evaluation.touch.records import RobotRecord
from pepper_driver.evaluation.touch.summary import summarise_touch
from pepper_driver.evaluation.touch.summary_data import Fraction, Rate, TouchSummary
from support.evaluation import ROBOT
from support.touch_records import (
    LINKS,
    OURS,
    drawn_robot,
    lasting,
    ours,
    reported,
    robot,
    take,
    touched,
)

WITHOUT = "fusion-without-model"
OBSERVERS = (OURS, "momentum", "momentum@matched", WITHOUT, "oracle")
STATES = ("standing", "attentive", "gesturing", "lowered")
MIDDLES = {"hand": 5.0, "forearm": 9.0, "head": 6.0, "trunk": math.inf, "base": math.inf}


def one(number: int) -> RobotRecord:
    factors = {OURS: 1.0, "momentum": 1.5, "momentum@matched": 2.0, WITHOUT: 1.3}
    middles = {
        state: {
            place: {name: middle * factor for name, factor in factors.items()}
            for place, middle in MIDDLES.items()
        }
        for state in STATES
    }
    return drawn_robot(
        number,
        "integral" if number % 2 else "nominal",
        middles,
        false={OURS: 1.0, "momentum": 30.0, "momentum@matched": 1.0, WITHOUT: 8.0},
        rows={"tap of 0.1 s": {"rise": 0.02}},
        free_hours=0.5,
    )


@cache
def drawn() -> tuple[RobotRecord, ...]:
    return tuple(one(number) for number in range(4))


@cache
def summary_of_drawn() -> TouchSummary:
    return summarise_touch(drawn(), OBSERVERS, ROBOT)


def text(summary: TouchSummary, pictures: dict[str, str] | None = None, **more: Any) -> str:
    return "\n\n".join(part for part in touch_page(summary, pictures or {}, **more) if part)


def line(page: str, start: str) -> str:
    (found,) = (one for one in page.splitlines() if one.startswith(f"| {start} |"))
    return found


def check_tables(page: str) -> None:
    """Each row of a table has as many cells as its header."""
    for block in page.split("\n\n"):
        widths = {row.count("|") for row in block.splitlines() if row.startswith("|")}
        assert len(widths) <= 1, block
    assert "None" not in page
    assert "nan" not in page


def test_the_page_says_what_the_summary_has() -> None:
    summary = summary_of_drawn()
    page = text(summary, {"results/touch_map.png": "N90 by place."})
    check_tables(page)
    assert "![touch_map](results/touch_map.png)\n\nN90 by place." in page
    for law in summary.laws:
        cells = [
            ours(summary).group(law, "hand", g) for g in ("standing", "attentive", "in motion")
        ]
        expected = []
        for cell in cells:
            assert cell is not None
            assert cell.n90 is not None
            expected.append(f"{cell.n90.text}; worst {cell.n90.worst_text}")
        assert line(page, f"hand, `{law}`") == f"| hand, `{law}` | {' | '.join(expected)} |"
    free = ours(summary).false_contacts("free", "nominal")
    assert free is not None
    row = line(page, "false contacts an hour (begins and moves), left alone")
    assert f"{rate_text(free.rate)}, {free.events} in 4.0 h" in row
    assert line(page, "trunk, STANDING").count("> 30") == 4
    # `attentive` is a group of its own, and not written twice.
    assert "hand, ATTENTIVE" in page
    assert "| hand, attentive |" not in page
    taps = next(
        r
        for r in ours(summary).rows
        if (r.row, r.law, r.place) == ("tap of 0.1 s", "nominal", "hand")
    )
    assert f"| ... hand | {fraction_text(taps.detected)} |" in page
    for name in ("`momentum`", "`momentum@matched`", f"`{WITHOUT}`"):
        assert f"| {name} |" in page
    assert "`oracle` was judged on no robot." in page
    assert "In simulation" in page
    assert "Few robots (2 of `nominal`, 2 of `integral`)" in page


def test_the_worst_robot_left_alone_is_the_one_with_most_false_contacts_there() -> None:
    """A robot that is worst while people touch it is no worst one for those left alone."""
    summary = summary_of_drawn()
    one = ours(summary)
    rates = {
        robot.robot: found.events / found.hours
        for robot in one.robots
        if (found := one.false_contacts("free", robot.law, "robot", robot.robot)) is not None
    }
    worst = max(rates, key=lambda name: rates[name])
    row = line(text(summary), "the same, left alone, worst robot").split(" | ")
    assert f"({worst})" in row[-1]
    assert all(f"({name})" not in row[-1] for name in rates if name != worst)


def test_a_short_time_in_contacts_that_are_none_is_not_rounded_away() -> None:
    """One second in ten hours is 0.003 % of the time; the limit of the project is 0.01 %."""
    summary = summary_of_drawn()
    one = ours(summary)
    short = replace(
        one,
        false=tuple(
            replace(
                group,
                contacts=replace(
                    group.contacts, fraction_of_time=1.0 / 36_000.0, seconds_per_hour=0.1
                ),
            )
            for group in one.false
        ),
    )
    others = tuple(short if entry is one else entry for entry in summary.observers)
    page = text(replace(summary, observers=others))
    row = line(page, "time an hour in contacts that are none; fraction of it, left alone")
    assert row.count("0.10 s; 0.003 %") == row.count("|") - 2


def test_rows_of_several_forces_have_their_n90_on_the_page() -> None:
    summary = summary_of_drawn()
    assert "N90 of these touches" not in text(summary)
    cell = ours(summary).group("nominal", "hand", "standing")
    assert cell is not None
    assert cell.n90 is not None
    rows = tuple(
        replace(row, n90=cell.n90) if (row.law, row.place) == ("nominal", "hand") else row
        for row in ours(summary).rows
    )
    page = text(
        replace(
            summary,
            observers=tuple(
                replace(one, rows=rows) if one.name == OURS else one for one in summary.observers
            ),
        )
    )
    check_tables(page)
    expected = f"| {cell.n90.text}; {cell.n90.touches} touches | - |"
    assert line(page, "tap of 0.1 s, hand") == f"| tap of 0.1 s, hand {expected}"


def test_an_ablation_is_written_as_difference_and_a_baseline_as_result() -> None:
    page = text(summary_of_drawn())
    ablation, baseline = line(page, f"`{WITHOUT}`"), line(page, "`momentum`")
    detected, _, alarms = ablation.split("|")[2:5]
    assert float(detected.split()[0]) < 0.0
    assert float(alarms.split()[0]) > 0.0
    other = summary_of_drawn().observer("momentum")
    assert other is not None
    assert fraction_text(other.detected()) in baseline


def test_the_ledger_is_written_with_its_number_of_looks() -> None:
    lines = [
        {"look": "1", "commit": "0123456789abcdef", "note": "first | look"},
        {"look": "2", "commit": "fedcba9876543210", "note": ""},
    ]
    page = "\n\n".join(ledger_table(lines))
    check_tables(page)
    assert "2 looks" in page
    assert "| 1 | 0123456789 | first / look |" in page
    assert "| 2 | fedcba9876 | - |" in page
    assert "7 looks" in "\n".join(ledger_table(lines, 7))
    assert "No look" in "\n".join(ledger_table([]))


def test_what_failed_is_named() -> None:
    first, second, *_ = drawn()
    # The oracle saw the first robot alone, and failed there.
    seen = replace(first, takes=tuple(_with_failure(t) for t in first.takes), warnings=("worn",))
    lost = take(state="driving", failure="it tipped", planned=(("even", "hand", 8.0),))
    bad = replace(second, failure="too little motion", takes=(*second.takes, lost))
    heavy = robot(
        take(
            [touched(5.0, "trunk", 30.0, force=14.0)],
            {name: first.takes[0].hearings[OURS] for name in OBSERVERS[:-1]},
        ),
        name="heavy",
    )
    page = text(summarise_touch((seen, bad, heavy), OBSERVERS, ROBOT), development=True)
    check_tables(page)
    touches = sum(len(t.touches) for t in second.takes)
    assert (
        f"random 1 (`integral`) could not be identified: too little motion. Its {touches} touches"
        in page
    )
    assert "random 1, take touch driving 0 could not be performed: it tipped" in page
    assert "1 touches planned" in page
    assert "`oracle` has no result of 8 takes" in page
    assert "`oracle` did not see every take of heavy" in page
    assert "warned of 1 robots: random 0" in page
    assert line(page, "trunk").startswith("| trunk | 1 |")
    assert "constants may have been chosen on them" in page
    assert "1 of them could not be identified" in page
    # No touch of the one robot of its law that could not be identified is detected, and it is no worst one.
    assert line(page, "hand, `integral`") == "| hand, `integral` | > 30 | > 30 | > 30 |"


def _with_failure(one: Any) -> Any:
    failed = replace(one.hearings[OURS], events=(), torques=(), failure="ValueError: no")
    return replace(one, hearings={**one.hearings, "oracle": failed})


def test_one_robot_has_neither_an_interval_nor_a_worst_one() -> None:
    page = text(summarise_touch(drawn()[:1], (OURS,), ROBOT))
    check_tables(page)
    row = line(page, "hand, `nominal`")
    assert "worst" not in row
    assert "(" not in row
    assert "## Compared with other observers" not in page
    assert "## Without each part" not in page


@pytest.mark.parametrize("records", [(), (robot(),), (drawn_robot(0, "nominal", {}),)])
def test_a_page_without_touches_still_has_rules_and_limits(
    records: tuple[RobotRecord, ...],
) -> None:
    page = text(summarise_touch(records, (OURS,), ROBOT))
    check_tables(page)
    assert "## How touches are scored" in page
    assert "## Limits" in page
    assert "## N90 by place and state" not in page
    assert ("was judged on no robot" in page) == (not records)


def test_free_takes_alone_have_false_contacts() -> None:
    observed = drawn()[0].takes[0].hearings[OURS]
    observed = replace(observed, events=tuple(reported(1, 100.0, 101.0, "head")), torques=())
    page = text(summarise_touch((robot(take((), {OURS: observed}, suite="free")),), (OURS,), ROBOT))
    check_tables(page)
    assert "| **head** | 1, 1.0 (0.03-5.6)/h |" in page


def test_a_log_has_its_places_without_groups_or_simulation(tmp_path: Path) -> None:
    values: dict[str, Any] = {"row": "log", "rise": None, "torque": {}, "friction_bound": None}
    touches = [lasting(touched(0.0, asked=None, **values), onset) for onset in (5.0, 10.0)]
    observed = replace(
        drawn()[0].takes[0].hearings[OURS], events=tuple(reported(1, 5.2, 6.0)), torques=()
    )
    log = robot(take(touches, {OURS: observed}, state="log"), law=None, draw=None)
    summary = summarise_touch((log,), (OURS,), ROBOT)
    page = text(summary, simulated=False)
    check_tables(page)
    assert "In simulation" not in page
    assert "| hand, log | - | - | 2 | - |" in page.splitlines()
    assert "0.50 (0.09-0.91), 1 of 2" in page
    assert write_touch_pictures(summary, tmp_path, ROBOT, simulated=False) == {}


def test_kinds_are_a_table_where_an_observer_reports_them() -> None:
    touches = [touched(5.0 * n, release=5.0 * n + 0.1) for n in range(1, 5)] + [touched(50.0)]
    kinds = {1: "tap", 2: "tap", 3: "push", 10: "push"}
    events = [
        e for n, k in kinds.items() for e in reported(n, 5.0 * n + 0.06, 5.0 * n + 0.5, kind=k)
    ]
    observed = replace(drawn()[0].takes[0].hearings[OURS], events=tuple(events), torques=())
    page = text(summarise_touch((robot(take(touches, {OURS: observed})),), (OURS,), ROBOT))
    check_tables(page)
    assert "| true kind | push | tap | not detected | right, of detected ones | end after" in page
    right = fraction_text(Fraction.counted(2, 3))
    assert line(page, "**tap**") == f"| **tap** | 1 | 2 | 1 | {right} | 400 / 400 ms (2 of 2) |"
    assert line(page, "**push**").startswith("| **push** | 1 | 0 | 0 | 1.00 ")
    # Its observer reports no kinds.
    assert "## Kinds of touches" not in text(summary_of_drawn())


def test_numbers_have_three_digits_at_most() -> None:
    assert [short_number(x) for x in (0.052, 0.52, 7.44, 13.4, 298.1, math.inf)] == [
        "0.05",
        "0.52",
        "7.4",
        "13",
        "298",
        "inf",
    ]
    assert fraction_text(Fraction.counted(10, 12)) == "0.83 (0.55-0.95), 10 of 12"
    assert fraction_text(Fraction.counted(0, 0)) == rate_text(Rate.counted(0, 0.0)) == "-"


# -- pictures ---------------------------------------------------------------------------------------------------------


def check_no_overlap(figure: Figure) -> None:
    """No two texts of the picture lie on each other, and none leaves it."""
    canvas: Any = FigureCanvasAgg(figure)
    canvas.draw()
    renderer = canvas.get_renderer()
    # Ticks beyond the limits are never drawn.
    hidden = {
        id(tick.label1)
        for axes in figure.axes
        for axis, (low, high) in ((axes.xaxis, axes.get_xlim()), (axes.yaxis, axes.get_ylim()))
        for tick in (*axis.get_major_ticks(), *axis.get_minor_ticks())
        if not low <= tick.get_loc() <= high
    }
    shown = [
        one
        for one in figure.findobj(Text)
        if isinstance(one, Text) and one.get_visible() and one.get_text().strip()
        if id(one) not in hidden
    ]
    boxes = [(t.get_text(), t.get_window_extent(renderer)) for t in shown]
    width, height = figure.bbox.width, figure.bbox.height
    for (a, first), (b, second) in itertools.combinations(boxes, 2):
        across = min(first.x1, second.x1) - max(first.x0, second.x0)
        along = min(first.y1, second.y1) - max(first.y0, second.y0)
        assert across < 1.0 or along < 1.0, (a, b)
    for name, box in boxes:
        assert box.x0 > -1.0, name
        assert box.y0 > -1.0, name
        assert box.x1 < width + 1.0, name
        assert box.y1 < height + 1.0, name


def test_the_map_has_the_number_of_each_place_and_no_label_on_another() -> None:
    summary = summary_of_drawn()
    picture = n90_figure(ours(summary), summary.laws, ROBOT)
    check_no_overlap(picture)
    panels = [axes for axes in picture.axes if axes.patches]
    assert len(panels) == 2 * 3
    for axes, (law, group) in zip(
        panels,
        itertools.product(summary.laws, ("standing", "attentive", "in motion")),
        strict=False,
    ):
        words = [t.get_text() for t in axes.texts]
        for place in MIDDLES:
            cell = ours(summary).group(law, place, group)
            assert cell is not None
            assert cell.n90 is not None
            assert newtons_text(cell.n90) in words
        assert set(LINKS) <= set(words)
        assert words.count("-") == len(LINKS) - len(MIDDLES)
        assert words.count(">30") >= 2
        hatched = [patch for patch in axes.patches if patch.get_hatch()]
        assert hatched


def test_the_map_of_one_law_and_one_group_is_drawn_alone() -> None:
    touches = [touched(5.0, "head", 8.0)]
    observed = replace(
        drawn()[0].takes[0].hearings[OURS], events=tuple(reported(1, 5.1, 6.0, "head")), torques=()
    )
    summary = summarise_touch((robot(take(touches, {OURS: observed})),), (OURS,), ROBOT)
    picture = n90_figure(ours(summary), summary.laws, ROBOT)
    check_no_overlap(picture)
    assert len([axes for axes in picture.axes if axes.patches]) == 1


def test_recall_is_drawn_at_the_force_that_acted_with_wilsons_interval() -> None:
    touches = [touched(5.0, "trunk", 30.0, force=14.0), touched(15.0, "trunk", 8.0)]
    observed = replace(
        drawn()[0].takes[0].hearings[OURS], events=tuple(reported(1, 5.1, 6.0, "trunk")), torques=()
    )
    summary = summarise_touch((robot(take(touches, {OURS: observed})),), (OURS,), ROBOT)
    panels = recall_by_group(ours(summary), "nominal", summary.places)
    assert list(panels) == ["trunk"]
    picture = recall_figure(panels, "Touches")
    (axes,) = (axes for axes in picture.axes if axes.containers)
    (bars,) = axes.containers
    points, _, (whiskers,) = bars.lines  # type: ignore[attr-defined]
    assert points.get_xdata() == pytest.approx([8.0, 14.0])
    assert points.get_ydata() == pytest.approx([0.0, 1.0])
    ends = [segment[:, 1].tolist() for segment in whiskers.get_segments()]
    assert ends == [pytest.approx(wilson_interval(n, 1)) for n in (0, 1)]


def test_all_pictures_are_written_and_old_ones_are_removed(tmp_path: Path) -> None:
    (tmp_path / "touch_recall_old.png").touch()
    (tmp_path / "figure2.png").touch()
    captions = write_touch_pictures(summary_of_drawn(), tmp_path, ROBOT)
    laws = summary_of_drawn().laws
    assert set(captions) == {
        "touch_map.png",
        *(f"touch_recall_{law}.png" for law in laws),
        *(f"touch_recall_observers_{law}.png" for law in laws),
    }
    assert {path.name for path in tmp_path.iterdir()} == {*captions, "figure2.png"}
    panels = recall_by_observer([ours(summary_of_drawn())], "nominal")
    assert set(panels) == {
        f"{place}, {group}"
        for group in ("standing", "in motion")
        for place in ("hand", "forearm", "head")
    }
    check_no_overlap(recall_figure(panels, "Touches"))
