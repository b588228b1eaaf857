"""Forces of touches in the judge: kept as they were reported, scored, and absent from older records."""

from __future__ import annotations

import gzip
import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from pepper_driver.evaluation.touch.observers import watch_all
from pepper_driver.evaluation.touch.page import touch_page
from pepper_driver.evaluation.touch.records import (
    ForceEstimate,
    ObserverRecord,
    RobotRecord,
    Touched,
    load_robot_record,
    save_robot,
)
from pepper_driver.evaluation.touch.summary import summarise_touch
from pepper_driver.evaluation.touch.summary_data import (
    ALL,
    OTHER_ARM,
    WEIGHT_ARM,
    Forces,
    ObserverSummary,
    TouchSummary,
)
from pepper_driver.observer import Contact
from support.evaluation import ROBOT, Script, contact, recording
from support.touch_records import OURS, ours, reported, robot, take, touched


def pressed(number: int, time: float, newtons: float | None, **changes: Any) -> Contact:
    """An event with a force across the limb, between 0.8 and 1.3 times its size."""
    force = None if newtons is None else (0.0, 0.6 * newtons, -0.8 * newtons)
    interval = None if newtons is None else (0.8 * newtons, 1.3 * newtons)
    return replace(
        contact(number, time), force=force, force_interval=interval, scale_known=True, **changes
    )


STILL = recording(6.0)
TOUCH = touched(2.0, "forearm", 20.0, release=4.0, rise=0.2)


def listened(touches: list[Touched], *events: Contact) -> tuple[ForceEstimate, ...]:
    return watch_all({"script": Script(events)}, STILL, touches, ROBOT)["script"].forces


# -- as it was reported -----------------------------------------------------------------------------------------------


def test_the_last_force_before_the_push_fades_counts() -> None:
    events = (
        pressed(1, 2.1, 6.0),
        pressed(1, 2.5, 18.0, phase="update"),
        pressed(1, 3.7, 22.0, phase="update"),
        pressed(1, 3.9, 9.0, phase="update"),  # it fades from 3.8 s on
        pressed(1, 4.1, 9.0, phase="end"),
    )
    (found,) = listened([TOUCH], *events)
    assert (found.touch, found.true, found.scale_known) == (0, 20.0, True)
    assert (found.estimate, found.low, found.high) == pytest.approx((22.0, 17.6, 28.6))


def test_forces_of_other_limbs_and_times_do_not_count() -> None:
    events = (
        pressed(1, 1.9, 9.0),
        pressed(2, 2.5, 9.0, limb="right_arm"),
        pressed(3, 2.6, None, phase="update"),
        pressed(4, 3.0, 9.0, phase="end"),
    )
    assert listened([TOUCH], *events) == ()


def test_a_hand_that_holds_on_has_no_force_to_compare_with() -> None:
    event = pressed(1, 2.5, 18.0)
    assert listened([replace(TOUCH, rise=None)], event) == ()
    assert listened([replace(TOUCH, force=None)], event) == ()
    # In a log no rise is known: its largest force counts, if a label or a simulation says one.
    (found,) = listened([replace(TOUCH, rise=None, row="log")], event)
    assert found.true == 20.0


# -- scores -----------------------------------------------------------------------------------------------------------


def estimated(touch: int, true: float, estimate: float, **changes: Any) -> ForceEstimate:
    values = {"low": 0.8 * estimate, "high": 1.3 * estimate, "scale_known": True, **changes}
    return ForceEstimate(touch=touch, true=true, estimate=estimate, **values)


def judged(*records: RobotRecord) -> tuple[TouchSummary, ObserverSummary]:
    summary = summarise_touch(records, (OURS,), ROBOT)
    return summary, ours(summary)


def forces(observer: ObserverSummary, **keys: str) -> Forces:
    found = observer.force(**keys)
    assert found is not None
    return found


def attentive(law: str = "nominal") -> RobotRecord:
    """Six pushes, all but the last one reported."""
    places = ("hand", "hand", "forearm", "forearm", "upper arm", "hand")
    sizes = (20.0, 20.0, 20.0, 8.0, 20.0, 20.0)
    touches = [touched(5.0 * n, places[n - 1], sizes[n - 1]) for n in range(1, 7)]
    events = [e for n in range(1, 6) for e in reported(n, 5.0 * n + 0.2, 5.0 * n + 1.1)]
    pairs = (
        estimated(0, 20.0, 24.0),
        estimated(1, 20.0, 13.9),  # 30.5 % off, and its interval ends at 18.1 N
        # None of the third.
        estimated(3, 8.0, 4.0),
        estimated(4, 20.0, 20.0),  # not at hand or forearm
    )
    observed = ObserverRecord(events=tuple(events), forces=pairs)
    return robot(take(touches, {OURS: observed}, state="attentive"), law=law)


def test_forces_count_at_hand_and_forearm_from_15_newtons_on() -> None:
    _, observer = judged(attentive())
    both = forces(observer, state="attentive")
    # The third has no force, which is wrong; the sixth is not detected, which another result says.
    assert (both.right.count, both.right.of) == (1, 3)
    assert (both.covered.count, both.covered.of) == (1, 2)
    assert (both.all_covered.count, both.all_covered.of) == (1, 3)
    assert (both.known.count, both.known.of) == (3, 3)
    assert (both.error.count, both.error.of) == (2, 3)
    assert both.error.median == pytest.approx(0.5 * (0.2 - 0.305))
    hand, forearm = (forces(observer, place=place) for place in ("hand", "forearm"))
    assert (hand.right.count, hand.right.of) == (1, 2)
    assert (forearm.right.count, forearm.right.of) == (0, 1)
    assert observer.force(place="upper arm") is None
    assert observer.force(state="standing") is None


def two_arms() -> RobotRecord:
    """Two pushes on the arm that held the weight, then two on the other one."""
    left = [touched(5.0 * n, "hand", 20.0) for n in (1, 2)]
    right = [replace(touched(5.0 * n, "hand", 20.0), limb="right_arm") for n in (3, 4)]
    events = [
        event
        for n, touch in enumerate((*left, *right), 1)
        for event in reported(n, 5.0 * n + 0.2, 5.0 * n + 1.1, touch.limb)
    ]
    pairs = (
        estimated(0, 20.0, 20.0),
        # None of the second.
        estimated(2, 20.0, 30.0, scale_known=False),
        estimated(3, 20.0, 21.0, scale_known=False),
    )
    observed = ObserverRecord(events=tuple(events), forces=pairs)
    return robot(take([*left, *right], {OURS: observed}))


def test_the_arm_that_held_the_weight_counts_apart() -> None:
    first = two_arms()
    (taken,) = first.takes
    observed = taken.hearings[OURS]
    # Of another robot, the wrist shows its torque by its current: its scale stays unknown, but it was weighed.
    unknown = replace(
        observed, forces=tuple(replace(pair, scale_known=False) for pair in observed.forces)
    )
    second = replace(
        first, robot="b", takes=(replace(taken, hearings={**taken.hearings, OURS: unknown}),)
    )
    _, observer = judged(first, second)
    found = {arm: forces(observer, arm=arm) for arm in (ALL, WEIGHT_ARM, OTHER_ARM)}
    assert {arm: (one.right.count, one.right.of) for arm, one in found.items()} == {
        ALL: (4, 8),
        WEIGHT_ARM: (2, 4),
        OTHER_ARM: (2, 4),
    }
    assert {arm: (one.known.count, one.known.of) for arm, one in found.items()} == {
        ALL: (1, 6),
        WEIGHT_ARM: (1, 2),
        OTHER_ARM: (0, 4),
    }


def test_without_a_weight_no_arm_held_it() -> None:
    observed = ObserverRecord(
        events=tuple(reported(1, 5.2, 6.1)),
        forces=(estimated(0, 20.0, 20.0, scale_known=False),),
    )
    _, observer = judged(robot(take([touched(5.0, "hand", 20.0)], {OURS: observed})))
    assert observer.force(arm=WEIGHT_ARM) is None
    assert forces(observer, arm=OTHER_ARM).right.count == 1


def test_taps_and_pushes_during_others_have_no_force_to_score() -> None:
    touches = [touched(5.0, release=5.2, rise=0.02), touched(10.0), touched(10.5)]
    events = [e for n, time in enumerate((5.1, 10.1)) for e in reported(n, time, time + 0.8)]
    pairs = tuple(estimated(n, 8.0, 8.0) for n in range(3))
    observed = ObserverRecord(events=tuple(events), forces=pairs)
    _, observer = judged(robot(take(touches, {OURS: observed})))
    assert observer.forces == ()


def test_the_page_has_fractions_of_right_forces_and_intervals() -> None:
    summary, _ = judged(attentive(), replace(attentive("integral"), robot="b"))
    page = "\n\n".join(touch_page(summary, {}))
    (right,) = [
        row for row in page.splitlines() if row.startswith("| force, attentive: within 30 %")
    ]
    assert right.count("1 of 3") == 2
    assert "| force, attentive, arm of the weight: scale known |" in page
    assert "| force, attentive, other arm: within 30 % |" in page
    assert "2 of 6" in right
    (held,) = [
        row for row in page.splitlines() if row.startswith("| force, attentive: in the stated")
    ]
    assert "2 of 4" in held
    (moving,) = [row for row in page.splitlines() if row.startswith("| force, in motion: within")]
    assert "of" not in moving.split("|", 2)[2]


# -- records ----------------------------------------------------------------------------------------------------------


def test_forces_are_kept(tmp_path: Path) -> None:
    record = attentive()
    save_robot(record, tmp_path / "a.json.gz")
    assert load_robot_record(tmp_path / "a.json.gz") == record


def test_a_record_of_an_earlier_look_has_no_forces_and_is_judged(tmp_path: Path) -> None:
    save_robot(attentive(), tmp_path / "new.json.gz")
    data = json.loads(gzip.decompress((tmp_path / "new.json.gz").read_bytes()))
    for one in data["takes"]:
        for observed in one["hearings"].values():
            del observed["forces"]
    old = tmp_path / "old.json.gz"
    old.write_bytes(gzip.compress(json.dumps(data).encode()))
    summary, observer = judged(load_robot_record(old))
    assert observer.forces == ()
    assert observer.detected().count == 5
    page = "\n\n".join(touch_page(summary, {}))
    (row,) = [row for row in page.splitlines() if row.startswith("| force: within 30 %")]
    assert set(row.split("|")[2:-1]) == {" - "}
