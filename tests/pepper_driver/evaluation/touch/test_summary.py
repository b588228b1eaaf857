"""Results of the judge of touch against robots made by hand, whose results one counts on paper."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from typing import Any

import pytest

from pepper_driver.evaluation.touch.comparison import paired
from pepper_driver.evaluation.touch.n90 import poisson_interval, wilson_interval
from pepper_driver.evaluation.touch.records import ObserverRecord, RobotRecord, TorqueEstimate
from pepper_driver.evaluation.touch.summary import (
    group_of,
    main_results,
    passing_time,
    summarise_touch,
)
from pepper_driver.evaluation.touch.summary_data import (
    ALL,
    Fraction,
    Quantiles,
    TouchSummary,
)
from support.evaluation import ROBOT
from support.touch_records import FORCES, OURS, drawn_robot, ours, reported, robot, take, touched


def summed(
    *records: RobotRecord, observers: tuple[str, ...] = (OURS,), **more: Any
) -> TouchSummary:
    return summarise_touch(records, observers, ROBOT, **more)


def detected_from(min_force: float, delay: float, *, place: str = "hand", **changes: Any) -> Any:
    """A take with a touch of each force, reported ``delay`` after its onset from ``min_force`` newtons on."""
    touches = [touched(5.0 * n, place, force, **changes) for n, force in enumerate(FORCES, 1)]
    events = [
        event
        for n, touch in enumerate(touches)
        if (touch.force or 0.0) >= min_force
        for event in reported(n, touch.onset + delay, touch.release + 0.1, touch.limb)
    ]
    return touches, events


def standing(touches: Any, events: Any = (), **changes: Any) -> Any:
    return take(touches, {OURS: ObserverRecord(events=tuple(events))}, **changes)


# -- fractions --------------------------------------------------------------------------------------------------------


def test_states_that_are_pooled_are_counted_once_and_others_not() -> None:
    touches, events = detected_from(8.0, 0.2)
    states = (
        "standing",
        "after-motion",
        "attentive",
        "gesturing",
        "driving",
        "reflexes",
        "lowered",
    )
    summary = summed(robot(*(standing(touches, events, state=state) for state in states)))
    counts = {cell.state: cell.detected for cell in ours(summary).groups}
    assert counts == {
        "standing": Fraction.counted(8, 14),
        "attentive": Fraction.counted(4, 7),
        "in motion": Fraction.counted(8, 14),
    }
    assert {cell.state for cell in ours(summary).cells} == set(states)
    assert group_of("lowered") == "lowered"


def test_a_cell_has_fractions_by_force_the_bound_and_n90() -> None:
    touches, events = detected_from(8.0, 0.2)
    # A touch that would tip the robot: 20 N were asked for, and 13 acted.
    touches[5] = replace(touches[5], force=13.0, friction_bound=9.0)
    cell = ours(summed(robot(standing(touches, events)))).group("nominal", "hand", "standing")
    assert cell is not None
    assert cell.n90 is not None
    assert [(one.asked, one.detected.count, one.detected.of) for one in cell.forces] == [
        (force, int(force >= 8.0), 1) for force in FORCES
    ]
    assert [one.acted for one in cell.forces if one.asked == 20.0] == [13.0]
    assert cell.bound == 6.0
    assert 5.0 < cell.n90.newtons <= 9.0
    assert cell.n90.touches == 7
    assert cell.forces[0].detected == Fraction(
        count=0, of=1, fraction=0.0, low=0.0, high=wilson_interval(0, 1)[1]
    )


def test_rows_are_separate_by_law_place_and_group_but_only_where_there_are_two() -> None:
    touches = [
        touched(5.0, "hand", 12.0, row="tap"),
        touched(10.0, "head", 12.0, row="tap", force=10.0),
        touched(15.0, "hand", None, row="grip", force=7.0, rise=None),
    ]
    first = standing(touches, reported(1, 5.1, 5.5))
    second = standing(
        touches, [*reported(1, 5.1, 5.5), *reported(2, 10.2, 10.5, "head")], state="driving"
    )
    rows = ours(summed(robot(first), robot(second, name="b", law="integral"))).rows
    fractions = {
        (r.row, r.law, r.place, r.state): (r.detected.count, r.detected.of, r.force) for r in rows
    }
    assert fractions["tap", "all", "all", "all"] == (3, 4, 11.0)
    assert fractions["tap", "nominal", "all", "all"] == (1, 2, 11.0)
    assert fractions["tap", "all", "hand", "all"] == (2, 2, 12.0)
    assert fractions["tap", "integral", "head", "all"] == (1, 1, 10.0)
    assert fractions["tap", "all", "all", "in motion"] == (2, 2, 11.0)
    assert fractions["grip", "all", "all", "standing"] == (0, 1, 7.0)
    assert not [key for key in fractions if key[0] == "grip" and key[2] != "all"]


def test_rows_of_several_forces_have_an_n90_by_law_and_place() -> None:
    forces = (5.0, 8.0, 12.0, 20.0)
    taps = [touched(5.0 * n, "hand", force, row="tap") for n, force in enumerate(forces, 1)]
    few = [touched(5.0 * n, "hand", 8.0, row="grip") for n in (5, 6, 7, 8)]
    events = [event for n in (3, 4) for event in reported(n, 5.0 * n + 0.1, 5.0 * n + 0.5)]
    one_place = standing([*taps, *few], events)
    two_places = standing([*taps, touched(50.0, "head", 8.0, row="tap")], events)
    for taken, place in ((one_place, ALL), (two_places, "hand")):
        (found,) = [row for row in ours(summed(robot(taken))).rows if row.n90 is not None]
        assert (found.row, found.law, found.place, found.state) == ("tap", "nominal", place, ALL)
        assert found.n90 is not None
        assert found.n90.touches == 4
        assert 8.0 < found.n90.newtons < 20.0


def test_lowered_forces_are_counted_by_place() -> None:
    touches = [
        touched(5.0, "trunk", 30.0, force=29.2),
        touched(10.0, "trunk", 30.0, force=29.0),
        touched(15.0, "hand", None, force=5.0),
    ]
    (lowered,) = summed(robot(standing(touches))).lowered
    assert (lowered.place, lowered.lowered, lowered.of, lowered.max_force) == ("trunk", 1, 2, 29.2)


# -- false contacts ---------------------------------------------------------------------------------------------------


def test_false_contacts_are_counted_by_suite_law_state_robot_part_and_joint() -> None:
    wrist = list(reported(1, 100.0, 130.0, "right_arm", joint="RWristYaw"))
    moved = replace(wrist[0], phase="update", time=110.0, shown_by="RElbowRoll")
    events = [wrist[0], moved, wrist[1], *reported(2, 200.0, 201.0, "trunk")]
    free = standing((), events, suite="free", state="driving")
    quiet = standing((), (), suite="free", seconds=1800.0)
    # 10 s to 11 s and the grace: the left arm is exposed a little less than an hour.
    touch = standing([touched(10.0)], [*reported(1, 11.9, 12.4), *reported(2, 10.5, 10.6, "head")])
    summary = summed(robot(free, quiet), robot(touch, name="b", law="integral"), observers=(OURS,))
    found = ours(summary)
    alone = found.false_contacts("free")
    assert alone is not None
    assert (alone.begins, alone.moves, alone.events, alone.hours) == (2, 1, 3, 1.5)
    assert alone.rate.per_hour == 2.0
    assert (alone.rate.low, alone.rate.high) == poisson_interval(3, 1.5)
    assert alone.seconds == pytest.approx(31.0)
    assert alone.seconds_per_hour == pytest.approx(31.0 / 1.5)
    assert alone.fraction_of_time == pytest.approx(31.0 / 5400.0)
    touching = found.false_contacts("touch", "integral")
    assert touching is not None
    assert touching.hours == pytest.approx(1.0 - 1.3 / 4.0 / 3600.0)
    assert (touching.begins, touching.after_release, touching.other_touched) == (2, 1, 1)

    def events_of(by: Any, name: str, **where: Any) -> tuple[int, int] | None:
        contacts = found.false_contacts(by=by, name=name, **where)
        return None if contacts is None else (contacts.begins, contacts.moves)

    assert events_of("part", "wrists and hands") == (1, 0)
    assert events_of("part", "arms") == (1, 1)
    assert events_of("part", "trunk") == events_of("joint", "trunk") == (1, 0)
    assert events_of("joint", "WristYaw", law="nominal") == (1, 0)
    assert events_of("joint", "ElbowRoll") == (0, 1)
    assert events_of("limb", "right_arm") == (1, 1)
    assert events_of("state", "driving") == (2, 1)
    assert events_of("state", "standing", suite="free") == (0, 0)
    assert events_of("robot", "b") == (2, 0)
    assert events_of("robot", "b", law="nominal") is None
    parts = [events_of("part", part) for part in ("arms", "wrists and hands", "head", "trunk")]
    assert sum(sum(part) for part in parts if part is not None) == 5


# -- where, when, how much --------------------------------------------------------------------------------------------


def test_places_and_directions_are_scored_at_the_alarm_and_later() -> None:
    # The torques are 2.0, 1.5 and 0.1 N m on shoulder roll, elbow roll and wrist.
    touches = [touched(5.0 + 5.0 * n) for n in range(4)]
    elbow = list(reported(1, 5.2, 6.1, joint="LElbowRoll"))
    update = replace(elbow[0], phase="update", time=5.3, joint="LShoulderRoll", direction=-1)
    events = [elbow[0], update, elbow[1], *reported(2, 10.2, 11.1, joint="LWristYaw")]
    events += [
        *reported(3, 15.1, 15.2, "head"),
        *reported(4, 15.3, 16.1),
        *reported(5, 20.1, 20.4, "head"),
    ]
    (where, nominal) = ours(summed(robot(standing(touches, events)))).located
    assert (where.law, nominal.law) == ("all", "nominal")
    assert (where.first_limb.count, where.first_limb.of) == (2, 4)
    assert (where.joint.count, where.joint.of) == (2, 3)
    assert (where.largest.count, where.largest.of) == (1, 3)
    assert (where.joint_later.count, where.largest_later.count) == (2, 2)
    # The wrist has too little torque to have a direction.
    assert (where.direction.count, where.direction.of) == (2, 2)
    assert (where.direction_later.count, where.direction_later.of) == (1, 2)


@pytest.mark.parametrize(
    ("force", "newtons", "time"),
    [(20.0, 10.0, 0.05), (10.0, 10.0, 0.1), (40.0, 10.0, 0.1 / 3.0), (10.0, 0.0, 0.0)],
)
def test_a_force_rises_along_half_a_cosine(force: float, newtons: float, time: float) -> None:
    assert passing_time(force, 0.1, newtons) == pytest.approx(time)
    # As the simulation pushes: F / 2 (1 - cos(pi t / rise)).
    assert force / 2.0 * (1.0 - math.cos(math.pi * time / 0.1)) == pytest.approx(newtons)


def test_delays_of_slow_touches_count_from_where_the_force_passes_n90() -> None:
    touches, events = detected_from(8.0, 0.2)
    held = touched(100.0, asked=12.0, standing_start=True)
    grip = touched(110.0, asked=12.0, rise=None, row="grip")
    tap = touched(120.0, asked=12.0, rise=0.05, row="tap")
    missed = touched(130.0, asked=12.0, rise=0.02, row="tap")
    later = (event for n in (100, 110, 120) for event in reported(n, n + 0.3, n + 0.9))
    found = ours(summed(robot(standing([*touches, held, grip, tap, missed], [*events, *later]))))
    cell = found.cell("nominal", "hand", "standing")
    assert cell is not None
    assert cell.n90 is not None
    limit = cell.n90.newtons
    delays = found.delays[0]
    assert delays.fast.median == pytest.approx(0.3)
    assert (delays.fast.count, delays.fast.of) == (1, 2)
    expected = sorted(0.2 - passing_time(f, 0.1, limit) for f in FORCES if f >= limit)
    assert (delays.slow.count, delays.slow.of) == (len(expected), len(expected)) == (4, 4)
    assert delays.slow.median == pytest.approx((expected[1] + expected[2]) / 2.0)
    strong = [f for f in FORCES if f >= 2.0 * limit]
    assert delays.strong.of == len(strong) + 2 * (2.0 * limit <= 12.0)


def test_nothing_passes_an_n90_that_is_not_reached() -> None:
    touches, events = detected_from(30.0, 0.2)
    found = ours(summed(robot(standing(touches, events), standing(touches))))
    cell = found.cell("nominal", "hand", "standing")
    assert cell is not None
    assert cell.n90 is not None
    assert cell.n90.text == cell.n90.worst_text == "> 30"
    assert found.delays[0].slow == found.delays[0].strong == Quantiles.among([], 0)


def test_ends_count_where_no_other_touch_of_the_limb_is_near() -> None:
    touches = [
        touched(5.0),
        touched(20.0),
        touched(22.0),
        touched(40.0),
        touched(50.0),
        touched(60.0),
    ]
    events = [
        *reported(1, 5.2, 6.15),
        *reported(2, 20.2, 21.9),
        *reported(3, 40.2, 40.5),
        *reported(4, 60.2, None),
    ]
    (ends, _) = ours(summed(robot(standing(touches, events)))).ends
    assert (ends.error.count, ends.error.of, ends.open) == (2, 3, 1)
    assert ends.error.median == pytest.approx((0.15 - 0.5) / 2.0)
    assert (ends.early.count, ends.early.of) == (1, 2)


def test_torques_are_compared_over_all_pairs() -> None:
    pairs = [(1.0, 1.5), (-2.0, -2.5), (3.0, 3.0)]
    torques = tuple(
        TorqueEstimate(touch=0, joint="LElbowRoll", true=true, estimate=estimate)
        for true, estimate in pairs
    )
    observed = ObserverRecord(events=tuple(reported(1, 5.2, 6.1)), torques=torques)
    (torque, _) = ours(summed(robot(take([touched(5.0)], {OURS: observed})))).torques
    assert torque.pairs == 3
    assert torque.rmse == pytest.approx(math.sqrt(0.5 / 3.0))
    mean = 2.0 / 3.0
    assert torque.r2 == pytest.approx(1.0 - 0.5 / sum((true - mean) ** 2 for true, _ in pairs))


def test_touches_at_rest_and_in_motion_are_separate() -> None:
    touches = [touched(5.0 * n, moving=n > 1) for n in range(1, 5)]
    (motion, _) = ours(summed(robot(standing(touches, reported(1, 10.2, 11.0))))).motion
    assert (motion.rest.of, motion.rest.count) == (1, 0)
    assert (motion.moving.of, motion.moving.count) == (3, 1)


def kinds_of(summary: TouchSummary) -> dict[str, Any]:
    return {one.true: one for one in ours(summary).kinds}


def test_kinds_are_counted_by_the_true_and_the_reported_one() -> None:
    touches = [touched(5.0 * n, release=5.0 * n + 0.1, row="tap") for n in range(1, 7)]
    touches += [touched(50.0 + 5.0 * n) for n in range(3)]
    touches += [touched(100.0, asked=20.0, rise=0.02), touched(110.0, rise=None, row="grip")]
    kinds = {5: "tap", 10: "tap", 15: "tap", 20: "double tap", 25: "push"}
    kinds |= {50: "push", 55: "tap", 60: "hold", 100: "collision", 110: "grip"}
    ends = {5: 0.42, 10: 0.44, 15: 0.5, 20: 0.3}
    events = [
        event
        for n, kind in kinds.items()
        for event in reported(n, n + 0.06, n + 0.1 + ends.get(n, 0.9), kind=kind)
    ]
    found = kinds_of(summed(robot(standing(touches, events))))
    assert list(found) == ["collision", "push", "tap"]
    assert found["tap"].reported == {"tap": 3, "double tap": 1, "push": 1}
    assert found["tap"].not_detected == 1
    assert found["tap"].right == Fraction.counted(3, 5)
    assert found["tap"].end.median == pytest.approx(0.44)
    assert (found["tap"].end.count, found["tap"].end.of) == (3, 3)
    assert found["push"].reported == {"push": 1, "tap": 1, "hold": 1}
    assert found["push"].right == Fraction.counted(1, 3)
    assert found["collision"].right == Fraction.counted(1, 1)

    lost = robot(take(touches, state="standing"), name="b", failure="too little motion")
    both = kinds_of(summed(robot(standing(touches, events)), lost))
    assert (both["tap"].right, both["tap"].not_detected) == (Fraction.counted(3, 5), 7)
    data = summed(robot(standing(touches, events))).as_json()["observers"][0]["kinds"]
    assert [one["true"] for one in data] == ["collision", "push", "tap"]
    assert json.loads(json.dumps(data))[2]["reported"] == found["tap"].reported


def test_an_observer_that_reports_no_kinds_is_not_scored_by_them() -> None:
    touches, events = [touched(5.0), touched(10.0)], [*reported(1, 5.2, 6.0)]
    hard = reported(2, 10.2, 11.0, kind="collision")
    assert ours(summed(robot(standing(touches, [*events, *hard])))).kinds == ()
    assert ours(summed(robot(standing(touches)))).kinds == ()


def test_a_label_refutes_neither_a_collision_nor_a_grip() -> None:
    values: dict[str, Any] = {"row": "log", "rise": None, "force": None, "torque": {}}
    touches = [touched(5.0 * n, **values) for n in range(1, 6)]
    kinds = {1: "push", 2: "collision", 3: "grip", 4: "tap"}
    events = [
        event
        for n, kind in kinds.items()
        for event in reported(n, 5.0 * n + 0.1, 5.0 * n + 1.1, kind=kind)
    ]
    log = robot(standing(touches, events, state="log"), law=None, draw=None)
    (push,) = kinds_of(summed(log)).values()
    assert push.reported == {"push": 1, "collision": 1, "grip": 1, "tap": 1}
    assert (push.not_detected, push.right) == (1, Fraction.counted(1, 2))


# -- what is missing --------------------------------------------------------------------------------------------------


def test_touches_of_a_robot_that_could_not_be_identified_are_not_detected() -> None:
    touches, events = detected_from(3.0, 0.2)
    good = robot(standing(touches, events), fit={"HeadYaw": 90.0, "HeadPitch": 94.0})
    bad = robot(take(touches, state="standing"), name="b", failure="too little motion")
    summary = summed(good, bad)
    found = ours(summary)
    assert found.detected() == Fraction.counted(6, 14)
    cell = found.group("nominal", "hand", "standing")
    assert cell is not None
    assert cell.n90 is not None
    assert cell.n90.worst_robot == "b"
    assert cell.n90.worst_text == "> 30"
    contacts = found.false_contacts()
    assert contacts is not None
    assert contacts.hours == pytest.approx(1.0, rel=0.01)
    assert [r.failure for r in summary.robots] == ["", "too little motion"]
    assert [r.fit for r in summary.robots] == [92.0, None]
    assert [r.identified for r in found.robots] == [True, False]


def test_an_observer_that_did_not_see_a_robot_has_no_result_of_it() -> None:
    touches, events = detected_from(3.0, 0.2)
    observed = ObserverRecord(events=tuple(events))
    both = robot(take(touches, {OURS: observed, "momentum": ObserverRecord()}))
    half = robot(
        take(touches, {OURS: observed, "momentum": observed}),
        take(touches, {OURS: observed}),
        name="b",
    )
    failed = robot(take(touches), name="c", failure="too little motion")
    summary = summed(both, half, failed, observers=(OURS, "momentum", "oracle"))
    momentum = summary.observer("momentum")
    assert momentum is not None
    assert momentum.left_out == ("b",)
    assert momentum.detected() == Fraction.counted(0, 14)
    assert ours(summary).detected() == Fraction.counted(18, 28)
    assert summary.observer("oracle") is None
    assert summary.observers[2].left_out == ("random 0", "b", "c")
    assert summary.observer("unknown") is None


def test_an_observer_that_fails_has_detected_nothing_and_no_hours() -> None:
    touches, _ = detected_from(3.0, 0.2)
    lost = take(touches, {OURS: ObserverRecord(failure="ValueError: no")})
    found = ours(summed(robot(lost, standing((), suite="free"))))
    assert found.failures == {"ValueError: no": 1}
    assert found.detected() == Fraction.counted(0, 7)
    contacts = found.false_contacts()
    assert contacts is not None
    assert contacts.hours == 1.0


def test_takes_that_failed_or_were_drawn_again_are_reported() -> None:
    lost = take(
        state="driving",
        failure="it tipped",
        seconds=0.0,
        planned=(("even", "hand", 8.0), ("even", "head", 8.0)),
    )
    again = standing((), suite="free", redrawn=2, reasons=("it tipped", "it tipped"))
    (one,) = summed(robot(lost, again)).robots
    assert one.failed_takes == {"touch driving 0": "it tipped"}
    assert (one.failed_touches, one.takes, one.redrawn, one.hours) == (2, 1, 1, 1.0)
    assert one.redraws == {"it tipped": 2}


@pytest.mark.parametrize("records", [(), (robot(standing((), suite="free")),), (robot(),)])
def test_without_touches_there_are_no_results_of_touches(records: tuple[RobotRecord, ...]) -> None:
    summary = summed(*records)
    observer = summary.observer(OURS)
    assert (observer is None) == (not records)
    if observer is not None:
        assert not any((observer.groups, observer.cells, observer.rows))
        assert observer.located[0].first_limb == Fraction.counted(0, 0)
        assert observer.detected() == Fraction.counted(0, 0)
        assert observer.detected().fraction is None
    json.dumps(summary.as_json(), allow_nan=False)
    assert main_results(records).n90_standing_nominal is None


def test_touches_of_a_log_are_scored_without_force_or_law() -> None:
    values: dict[str, Any] = {"row": "log", "rise": None, "torque": {}, "friction_bound": None}
    touches = [touched(5.0, asked=None, **values), touched(10.0, asked=None, **values)]
    log = robot(standing(touches, reported(1, 5.2, 6.0), state="log"), law=None, draw=None)
    summary = summed(log)
    (cell,) = ours(summary).cells
    assert (cell.law, cell.state, cell.detected.count, cell.detected.of) == ("unknown", "log", 1, 2)
    assert cell.n90 is None
    assert cell.forces == ()
    assert cell.bound is None
    assert ours(summary).located[0].joint == Fraction.counted(0, 0)
    assert ours(summary).delays[0].fast.of == 0
    json.dumps(summary.as_json(), allow_nan=False)


# -- many robots ------------------------------------------------------------------------------------------------------


def split(robots: int = 6) -> list[RobotRecord]:
    """Robots of both laws; half of the touches of a hand are detected at 5 N (nominal) or 3 N."""
    records = []
    for number in range(robots):
        hand = 3.0 if number % 2 else 5.0
        places = {
            "hand": {OURS: hand, "fusion-without-model": 2.0 * hand},
            "trunk": {OURS: math.inf, "fusion-without-model": math.inf},
        }
        records.append(
            drawn_robot(
                number,
                "integral" if number % 2 else "nominal",
                {state: places for state in ("standing", "after-motion", "gesturing")},
                false={OURS: 2.0, "fusion-without-model": 12.0},
                forces=[force for force in FORCES for _ in range(6)],
                free_hours=2.0,
                spread=0.0,
            )
        )
    return records


def test_n90_of_robots_drawn_from_known_curves() -> None:
    records = split()
    summary = summed(*records, observers=(OURS, "fusion-without-model"))
    for law, middle in (("nominal", 5.0), ("integral", 3.0)):
        cell = ours(summary).group(law, "hand", "standing")
        assert cell is not None
        assert cell.n90 is not None
        assert cell.n90.low is not None
        assert cell.n90.newtons == pytest.approx(middle * 9.0**0.25, rel=0.2)
        trunk = ours(summary).group(law, "trunk", "in motion")
        assert trunk is not None
        assert trunk.n90 is not None
        assert trunk.n90.text == "> 30"
    other = summary.observer("fusion-without-model")
    assert other is not None
    assert other.cells == ()
    assert len(other.groups) == len(ours(summary).groups)
    assert len(ours(summary).cells) == 2 * 2 * 3

    results = main_results(records)
    cell = ours(summary).group("integral", "hand", "in motion")
    assert cell is not None
    assert cell.n90 is not None
    assert results.n90_moving_integral == cell.n90.newtons
    free = ours(summary).false_contacts("free")
    assert free is not None
    assert results.false_contacts == free.events
    assert results.hours == pytest.approx(36.0)

    data = json.loads(json.dumps(summary.as_json(), allow_nan=False))
    trunk = next(c for c in data["observers"][0]["groups"] if c["place"] == "trunk")
    assert trunk["n90"]["newtons"] is None
    assert trunk["n90"]["text"] == "> 30"


def test_observers_are_compared_robot_by_robot() -> None:
    records = split()
    summary = summed(*records, observers=(OURS, "fusion-without-model"))
    other = summary.observer("fusion-without-model")
    assert other is not None
    pair = paired(ours(summary), other)
    assert pair.robots == 6
    assert pair.detected is not None
    assert pair.false_per_hour is not None
    mine, theirs = ours(summary).detected().fraction, other.detected().fraction
    assert mine is not None
    assert theirs is not None
    assert pair.detected.value == pytest.approx(theirs - mine)
    assert pair.detected.high is not None
    assert pair.detected.high < 0.0
    assert pair.false_per_hour.low is not None
    assert pair.false_per_hour.low > 0.0
    rates = [o.false_contacts() for o in (ours(summary), other)]
    a, b = (one.rate.per_hour for one in rates if one is not None)
    assert a is not None
    assert b is not None
    assert pair.false_per_hour.value == pytest.approx(b - a)
    same = paired(ours(summary), ours(summary), "nominal")
    assert same.robots == 3
    assert same.detected is not None
    assert (same.detected.value, same.detected.low, same.detected.high) == (0.0, 0.0, 0.0)


def test_of_one_robot_a_difference_has_no_interval_and_of_none_there_is_none() -> None:
    touches, events = detected_from(8.0, 0.2)
    hearings = {OURS: ObserverRecord(events=tuple(events)), "error": ObserverRecord()}
    bad = robot(take(touches), name="b", failure="too little motion")
    summary = summed(robot(take(touches, hearings)), bad, observers=(OURS, "error"))
    other = summary.observer("error")
    assert other is not None
    pair = paired(ours(summary), other)
    assert pair.robots == 1
    assert pair.detected is not None
    assert pair.detected.value == pytest.approx(-4 / 7)
    assert (pair.detected.low, pair.detected.high) == (None, None)
    nothing = paired(ours(summary), other, "integral")
    assert (nothing.robots, nothing.detected, nothing.false_per_hour) == (0, None, None)
