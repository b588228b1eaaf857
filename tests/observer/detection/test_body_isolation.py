"""The part of the body that a contact is on, and its life, over residuals made by hand."""

from __future__ import annotations

import math
from typing import cast

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pepper_driver.config.robot import TRUNK
from pepper_driver.observer.constants import PUSH_TICKS, QUIET_RATIO, REPORT_DELAY
from pepper_driver.observer.detection.body_isolation import (
    BASE_LINK,
    COLLISION_TIME,
    HOLD_TIME,
    REISOLATION_TIMES,
    TAP_TIME,
    TRUNK_LINK,
    BodyTracker,
)
from pepper_driver.observer.detection.contact_force import ContactForce, ForceEstimator
from pepper_driver.observer.interface import (
    INTENSITY_STEP_DEG,
    TORQUE_STEP_STDS,
    Contact,
    JointState,
    Residuals,
)
from support.examples import examples
from support.fusion import check_lives
from support.observer import CYCLE, JOINTS, ROBOT, SETTINGS

# Another value for each joint, so that ratios and residuals differ.
THRESHOLDS = np.linspace(0.01, 0.04, JOINTS)
PERIOD = round(SETTINGS.update_period / CYCLE)
HELD = math.ceil(REPORT_DELAY / CYCLE)
GAP = round(SETTINGS.merge_gap / CYCLE)
QUIET = GAP + 3
FIRST, LAST = (math.ceil(span / CYCLE) for span in REISOLATION_TIMES)
BEFORE_LAST = math.floor(REISOLATION_TIMES[-1] / CYCLE) - 1


PITCH_AND_ROLL = [ROBOT.joint_index(name) for name in ("LShoulderPitch", "LShoulderRoll")]


class NoForces:
    """Estimate of a limb whose joints show no force."""

    def estimate(self, limb: str, *values: object) -> None:
        return None


NO_FORCES = cast(ForceEstimator, NoForces())


class Force:
    """Estimate of a force on the left arm, of which two joints of the shoulder carry most."""

    def __init__(self, torque: tuple[float, float]) -> None:
        self.asked: list[str] = []
        self.torque = torque

    def estimate(self, limb: str, *values: object) -> ContactForce:
        self.asked.append(limb)
        return ContactForce(
            vector=np.array([0.0, 0.0, 9.0]),
            covariance=np.eye(3),
            interval=(8.0, 10.0),
            point=np.zeros(3),
            point_covariance=np.eye(3),
            scale_known=False,
            torques=dict(zip(PITCH_AND_ROLL, ((t, 0.5) for t in self.torque), strict=True)),
        )


class Player:
    """Feeds residuals, in multiples of their thresholds, to the tracker of the whole body."""

    def __init__(self, forces: ForceEstimator = NO_FORCES) -> None:
        self.k = 0
        self.drives = False
        self.torque_known = True
        self.states = [JointState.BLIND] * JOINTS
        self.settled = [False] * JOINTS
        self.tracker = BodyTracker(
            ROBOT, SETTINGS, lambda joint, sign, threshold: max(self.k - 2, 0) * CYCLE, forces
        )

    def play(self, ticks: int, base: float = 0.0, **residuals: float) -> list[Contact]:
        """Events of so many ticks in which all other residuals are zero, and friction holds joints that hide."""
        ratio = np.zeros(JOINTS)
        for name, value in residuals.items():
            ratio[ROBOT.joint_index(name)] = value
        residual = ratio * THRESHOLDS
        signal = Residuals(
            expected=np.zeros(JOINTS),
            raw=residual,
            residual=residual,
            threshold=np.where(np.isnan(ratio), np.nan, THRESHOLDS),
            torque=-10.0 * residual if self.torque_known else np.full(JOINTS, math.nan),
            torque_std=np.where(np.isnan(ratio), np.nan, 0.1),
            friction_band=np.zeros(JOINTS),
            blind=np.isnan(ratio),
            doubtful=np.zeros(JOINTS, dtype=np.bool_),
            base_raw=base,
            base_residual=base,
            base_drives=self.drives,
        )
        events = []
        for _ in range(ticks):
            events += self.tracker.step(
                self.k * CYCLE, signal, np.zeros(JOINTS), self.states, self.settled
            )
            self.k += 1
        return events

    def state(self, joint: str) -> JointState:
        return self.states[ROBOT.joint_index(joint)]


def story(events: list[Contact]) -> list[tuple[int, str, str | None]]:
    return [(event.id, event.phase, event.joint) for event in events]


def test_a_touch_on_one_joint() -> None:
    player = Player()
    assert player.play(5, LElbowRoll=0.9) == []
    assert player.tracker.idle
    events = player.play(2 * PERIOD, LElbowRoll=-2.0)
    assert not player.tracker.idle
    events += player.play(QUIET)
    begin, end = events  # no update while nothing changes
    assert (begin.phase, begin.kind, begin.joint, begin.link) == (
        "begin",
        "contact",
        "LElbowRoll",
        "LForeArm",
    )
    assert begin.direction == 1
    threshold = THRESHOLDS[ROBOT.joint_index("LElbowRoll")]
    assert begin.intensity_deg == pytest.approx(math.degrees(2.0 * threshold))
    assert begin.torque == pytest.approx(20.0 * threshold)
    assert begin.torque_std == pytest.approx(0.1)
    assert begin.time == begin.detection_time == pytest.approx(5 * CYCLE)
    assert begin.onset_time == pytest.approx(3 * CYCLE)
    assert (end.phase, end.id) == ("end", 1)
    assert end.time == pytest.approx((5 + 2 * PERIOD) * CYCLE)
    assert player.tracker.idle


def test_joints_beyond_the_hand_are_shaken_but_less() -> None:
    weak, strong = 0.8 * QUIET_RATIO * 10.0, 1.2 * QUIET_RATIO * 10.0
    assert weak > 1.0
    events = Player().play(1, LShoulderRoll=10.0, LWristYaw=weak)
    assert story(events) == [(1, "begin", "LShoulderRoll")]
    events = Player().play(1, LShoulderRoll=10.0, LWristYaw=strong)
    assert story(events) == [(1, "begin", "LWristYaw")]
    # Within the threshold is not touched, however near.
    events = Player().play(1, LShoulderRoll=1.1, LWristYaw=0.99)
    assert story(events) == [(1, "begin", "LShoulderRoll")]


@pytest.mark.parametrize("revision", [FIRST, LAST])
def test_the_joint_is_named_again_at_each_revision_and_not_between(revision: int) -> None:
    player = Player()
    player.play(1, LShoulderRoll=5.0)
    player.play(revision - 2, LShoulderRoll=5.0)
    assert [
        e for e in player.play(1, LShoulderRoll=5.0, LElbowRoll=4.0) if e.joint == "LElbowRoll"
    ] == []
    [moved] = player.play(1, LShoulderRoll=5.0, LElbowRoll=4.0)
    assert (moved.id, moved.phase, moved.joint, moved.link) == (
        1,
        "update",
        "LElbowRoll",
        "LForeArm",
    )
    assert moved.time == pytest.approx(revision * CYCLE)
    assert moved.detection_time == 0.0
    elbow = THRESHOLDS[ROBOT.joint_index("LElbowRoll")]
    assert moved.intensity_deg == pytest.approx(math.degrees(4.0 * elbow))


def test_a_force_names_the_joint_and_not_the_link() -> None:
    forces = Force((5.0, 1.0))
    player = Player(cast(ForceEstimator, forces))
    events = player.play(1, LElbowRoll=2.0)
    forces.torque = (-4.0, 1.0)  # looked at again
    events += player.play(FIRST, LElbowRoll=2.0)
    forces.torque = (-3.0, 6.0)
    events += player.play(LAST - FIRST, LElbowRoll=2.0)
    forces.torque = (7.0, 8.0)  # later the joint stays
    events += player.play(PERIOD, LElbowRoll=4.0) + player.play(QUIET)
    assert [e.phase for e in events] == ["begin", "update", "update", "update", "end"]
    assert {e.link for e in events} == {"LForeArm"}
    assert [(e.joint, e.torque, e.direction) for e in events] == [
        ("LShoulderPitch", 5.0, 1),
        ("LShoulderPitch", -4.0, -1),
        ("LShoulderRoll", 6.0, 1),
        ("LShoulderRoll", 8.0, 1),
        ("LShoulderRoll", 8.0, 1),
    ]
    assert {e.torque_std for e in events} == {0.5}
    assert {e.force for e in events} == {(0.0, 0.0, 9.0)}
    elbow = THRESHOLDS[ROBOT.joint_index("LElbowRoll")]
    assert events[0].intensity_deg == pytest.approx(math.degrees(2.0 * elbow))
    assert forces.asked == ["left_arm"] * 4, "not of an end"


@pytest.mark.parametrize(
    ("torques", "joint", "direction"),
    [
        ((5.0, 1.1), "LShoulderPitch", 1),
        ((0.9, -1.1), "LShoulderRoll", -1),  # two of its standard deviations
        ((0.9, -0.8), "LElbowRoll", -1),  # the joint that shows it, whose side is certain
    ],
)
def test_at_the_detection_a_joint_is_named_whose_direction_is_known(
    torques: tuple[float, float], joint: str, direction: int
) -> None:
    player = Player(cast(ForceEstimator, Force(torques)))
    [begin] = player.play(1, LElbowRoll=2.0)
    assert (begin.joint, begin.direction) == (joint, direction)


def test_later_the_most_likely_joint_is_named() -> None:
    player = Player(cast(ForceEstimator, Force((0.9, -0.8))))
    [begin, update] = player.play(1 + FIRST, LElbowRoll=2.0)
    assert (begin.joint, update.joint, update.direction) == ("LElbowRoll", "LShoulderPitch", 1)


def test_a_hand_names_its_own_joint() -> None:
    """No torque of the arm shows what the fingers do."""
    forces = Force((5.0, 1.0))
    [begin] = Player(cast(ForceEstimator, forces)).play(1, LHand=2.0)
    assert (begin.joint, begin.direction) == ("LHand", -1)
    assert begin.force == (0.0, 0.0, 9.0)


def test_a_joint_that_ended_long_ago_says_nothing_of_the_end_of_another_one() -> None:
    player = Player()
    player.play(LAST + 5, LElbowRoll=3.0)
    player.play(QUIET + 500)
    second = player.k * CYCLE
    events = player.play(LAST + 5, LShoulderRoll=3.0)
    events += player.play(1, LShoulderRoll=math.nan)
    assert events[0].phase == "begin"
    assert (events[-1].phase, events[-1].kind) == ("end", events[-2].kind)
    assert events[-1].time == pytest.approx(second + (LAST + 5) * CYCLE)


def test_after_the_last_revision_it_stays() -> None:
    player = Player()
    player.play(LAST + 1, LShoulderRoll=5.0)
    events = player.play(3 * PERIOD, LShoulderRoll=5.0, LElbowRoll=4.0) + player.play(QUIET)
    assert {event.joint for event in events} == {"LShoulderRoll"}


def test_a_revision_may_move_inwards_when_the_first_blow_is_forgotten() -> None:
    player = Player()
    assert story(player.play(1, LShoulderRoll=3.0, LWristYaw=4.0)) == [(1, "begin", "LWristYaw")]
    # More than half of the largest ratio, until the last revision.
    events = player.play(LAST - 1, LShoulderRoll=6.0, LWristYaw=1.1)
    assert {event.joint for event in events} == {"LWristYaw"}
    events = player.play(1, LShoulderRoll=6.0, LWristYaw=1.1)
    assert story(events) == [(1, "update", "LShoulderRoll")]


@pytest.mark.parametrize(
    ("ago", "joint"), [(PUSH_TICKS - 1, "LWristYaw"), (PUSH_TICKS, "LShoulderRoll")]
)
def test_the_largest_ratios_of_the_last_twelve_ticks_count(ago: int, joint: str) -> None:
    """So long before the last revision the wrist was hit."""
    player = Player()
    events = player.play(LAST - ago, LShoulderRoll=6.0, LWristYaw=1.1)
    events += player.play(1, LShoulderRoll=6.0, LWristYaw=4.0)
    events += player.play(ago, LShoulderRoll=6.0, LWristYaw=1.1)
    assert player.k == LAST + 1
    assert [event.joint for event in events][:2] == ["LShoulderRoll", "LWristYaw"]
    assert events[-1].joint == joint


def test_a_joint_that_goes_blind_loses_the_contact() -> None:
    player = Player()
    player.play(LAST + 5, LShoulderRoll=5.0, LElbowRoll=4.0)
    [moved] = player.play(1, LShoulderRoll=5.0, LElbowRoll=math.nan)
    assert (moved.id, moved.phase, moved.joint) == (1, "update", "LShoulderRoll")
    assert player.state("LElbowRoll") is JointState.BLIND
    [end] = player.play(1, LShoulderRoll=math.nan, LElbowRoll=math.nan)
    assert (end.id, end.phase, end.torque) == (1, "end", None)


def test_what_the_legs_detect_is_on_the_trunk() -> None:
    events = Player().play(1 + HELD, HipRoll=2.0)
    reported = [(e.limb, e.joint, e.link, e.direction) for e in events]
    assert reported == [(TRUNK, None, TRUNK_LINK, -1)]
    assert events[0].torque is None
    hip = THRESHOLDS[ROBOT.joint_index("HipRoll")]
    assert events[0].intensity_deg == pytest.approx(math.degrees(2.0 * hip))
    # Together with the wheels it is still the trunk.
    [both] = Player().play(1 + HELD, base=1.5, HipPitch=3.0)
    assert (both.joint, both.link) == (None, TRUNK_LINK)


def test_what_only_the_wheels_detect_is_on_the_base() -> None:
    player = Player()
    [begin] = player.play(1 + HELD, base=1.5)
    assert (begin.joint, begin.link, begin.phase) == (None, BASE_LINK, "begin")
    assert begin.intensity_deg == 0.0  # wheels have no degrees
    [end] = player.play(QUIET)
    assert (end.id, end.link, end.phase) == (1, BASE_LINK, "end")
    assert Player().play(5, base=0.99) == []
    assert Player().play(5, base=math.nan) == []


def test_residuals_of_long_ago_are_no_place_of_a_contact() -> None:
    """The observer does not step the tracker while it is idle and nothing is detected."""
    player = Player()
    player.play(10, HipPitch=2.0)
    player.play(QUIET, HipPitch=0.9)
    assert player.tracker.idle
    player.k += 5000
    [begin] = player.play(HELD + 1, base=1.2)
    assert begin.link == BASE_LINK


@pytest.mark.parametrize("ticks", range(1, HELD + 1))
@pytest.mark.parametrize("first", [{"base": 1.5}, {"HipRoll": 2.0}])
def test_what_an_arm_detects_soon_after_the_trunk_is_first_reported_on_the_arm(
    first: dict[str, float], ticks: int
) -> None:
    player = Player()
    assert player.play(ticks, **first) == []
    assert not player.tracker.idle
    [begin] = player.play(1, **first, LElbowRoll=-3.0)
    assert (begin.id, begin.phase, begin.limb, begin.joint) == (
        1,
        "begin",
        "left_arm",
        "LElbowRoll",
    )
    assert begin.time == begin.detection_time == pytest.approx(ticks * CYCLE)
    assert begin.onset_time == 0.0  # that of what came first
    rest = player.play(PERIOD, LElbowRoll=-3.0) + player.play(QUIET)
    assert {(event.id, event.limb) for event in rest} == {(1, "left_arm")}


def test_a_contact_on_the_trunk_is_reported_late_even_if_it_is_over_then() -> None:
    player = Player()
    assert player.play(HELD, HipRoll=2.0) == []
    [begin] = player.play(1, HipRoll=2.0)
    assert (begin.id, begin.phase, begin.limb) == (1, "begin", TRUNK)
    assert begin.time == begin.detection_time == pytest.approx(HELD * CYCLE)
    player = Player()
    [begin, end] = player.play(1, base=1.5) + player.play(QUIET)
    assert (begin.phase, end.phase) == ("begin", "end")
    assert begin.time == end.time == pytest.approx(HELD * CYCLE)


@pytest.mark.parametrize("value", [math.nan, -2.0])
def test_no_contact_is_lost_that_ends_before_it_is_reported(value: float) -> None:
    """The joint goes blind, or swings back."""
    player = Player()
    assert player.play(1, HipRoll=2.0) == []
    events = player.play(1, HipRoll=value)
    assert [(e.id, e.phase, e.kind) for e in events[:2]] == [
        (1, "begin", "contact"),
        (1, "end", "tap"),
    ]
    assert {event.time for event in events} == {CYCLE}
    assert [event.kind for event in events[2:]] == ([] if math.isnan(value) else ["rebound"])


def test_a_contact_on_a_limb_is_reported_at_once() -> None:
    [begin] = Player().play(1, LElbowRoll=2.0)
    assert (begin.phase, begin.time) == ("begin", 0.0)


def test_a_collision_of_the_trunk_is_reported_as_one() -> None:
    [begin] = Player().play(1 + HELD, HipRoll=1.5 * SETTINGS.collision_factor)
    assert (begin.phase, begin.kind) == ("begin", "collision")


def test_an_arm_that_detects_a_push_later_than_the_trunk_takes_its_contact_over() -> None:
    player = Player()
    [begin] = player.play(1 + HELD, HipRoll=2.0)
    assert begin.joint is None
    player.play(BEFORE_LAST - 1 - HELD, HipRoll=2.0)
    events = player.play(1, HipRoll=2.0, LElbowRoll=-3.0)
    assert story(events) == [(1, "update", "LElbowRoll")]
    assert (events[0].link, events[0].direction) == ("LForeArm", 1)
    assert events[0].detection_time == begin.time
    assert events[0].onset_time <= begin.onset_time
    events = player.play(3 * PERIOD, HipRoll=2.0, LElbowRoll=-3.0) + player.play(QUIET)
    assert {event.id for event in events} == {1}
    assert {event.joint for event in events} == {"LElbowRoll"}
    assert events[-1].phase == "end"


@pytest.mark.parametrize("trunk", [{"base": 1.5}, {"HipRoll": 2.0}])
def test_the_limb_is_known_once_a_joint_of_it_shows_the_touch(trunk: dict[str, float]) -> None:
    player = Player()
    [begin] = player.play(1 + HELD, **trunk)
    assert (begin.limb, begin.limb_known) == (TRUNK, False)
    [moved] = player.play(1, **trunk, LElbowRoll=-3.0)
    assert (moved.id, moved.limb, moved.limb_known) == (begin.id, "left_arm", True)
    [end] = [event for event in player.play(QUIET) if event.phase == "end"]
    assert end.limb_known


@pytest.mark.parametrize("before", [1, HELD])
def test_a_base_that_answers_a_command_before_it_is_due_is_not_touched(before: int) -> None:
    player = Player()
    assert player.play(before, base=1.5) == []
    player.drives = True
    assert player.play(30, base=1.5) + player.play(QUIET) == []
    # While it drives, and where it was reported before, it is a contact.
    assert story(player.play(1 + HELD, base=1.5)) == [(1, "begin", None)]
    player = Player()
    [begin] = player.play(1 + HELD, base=1.5)
    player.drives = True
    assert {event.id for event in player.play(30, base=1.5)} <= {begin.id}
    assert [event.phase for event in player.play(QUIET)] == ["end"]


@pytest.mark.parametrize(("later", "reported"), [(0.9, False), (1.2, True)])
def test_a_limb_that_is_let_go_shakes_the_trunk_for_a_while(later: float, reported: bool) -> None:
    player = Player()
    player.play(10, LElbowRoll=3.0)
    player.play(round(later * SETTINGS.rebound_window / CYCLE))
    events = player.play(1 + HELD, base=1.5) + player.play(QUIET)
    assert any(event.limb == TRUNK for event in events) == reported


def test_later_the_arm_has_a_contact_of_its_own() -> None:
    player = Player()
    player.play(LAST + 2, HipRoll=2.0)
    events = player.play(2, HipRoll=2.0, LElbowRoll=3.0)
    assert story(events)[0] == (2, "begin", "LElbowRoll")
    ends = [event for event in player.play(QUIET) if event.phase == "end"]
    assert sorted(event.id for event in ends) == [1, 2]


def test_what_the_trunk_detects_of_a_push_on_an_arm_is_no_second_contact() -> None:
    player = Player()
    events = player.play(5, LElbowRoll=3.0)
    events += player.play(30, LElbowRoll=3.0, HipRoll=2.0, HipPitch=-2.0, base=2.0)
    # It does not become one either when the arm is released first.
    events += player.play(10, HipRoll=2.0) + player.play(QUIET)
    assert {event.id for event in events} == {1}
    assert {event.joint for event in events} == {"LElbowRoll"}
    # The next one on the trunk is its own again.
    assert story(player.play(1 + HELD, HipRoll=2.0)) == [(2, "begin", None)]


def test_two_limbs_at_once_have_two_contacts() -> None:
    player = Player()
    events = player.play(2, LElbowRoll=3.0, RElbowRoll=-3.0)
    begins = {event.joint: event for event in events if event.phase == "begin"}
    assert begins.keys() == {"LElbowRoll", "RElbowRoll"}
    assert begins["LElbowRoll"].id != begins["RElbowRoll"].id
    assert (begins["LElbowRoll"].direction, begins["RElbowRoll"].direction) == (-1, 1)
    # The one continues when the other ends.
    ends = [e for e in player.play(QUIET, LElbowRoll=3.0) if e.phase == "end"]
    assert [event.joint for event in ends] == ["RElbowRoll"]


def test_of_two_limbs_after_the_trunk_one_takes_its_contact() -> None:
    player = Player()
    player.play(1 + HELD, HipRoll=2.0)
    events = player.play(1, HipRoll=2.0, LElbowRoll=3.0, RElbowRoll=3.0)
    assert sorted((e.id, e.phase) for e in events) == [(1, "update"), (2, "begin")]


def test_updates_come_when_intensity_or_torque_have_changed() -> None:
    threshold = float(THRESHOLDS[ROBOT.joint_index("LElbowRoll")])

    def residual(degrees: float) -> float:
        return math.radians(degrees) / threshold

    def torque(size: float) -> float:  # of the player: 10 N m/rad
        return size / (10.0 * threshold)

    quiet = 2 * PERIOD
    player = Player()
    [begin] = player.play(1, LElbowRoll=residual(3.0))
    assert [e.kind for e in player.play(round(0.5 / CYCLE), LElbowRoll=residual(3.0))] == ["push"]
    start = player.k
    assert player.play(quiet, LElbowRoll=residual(3.0)) == []
    # The intensity is the largest so far: it only grows.
    assert player.play(quiet, LElbowRoll=residual(3.0 + 0.95 * INTENSITY_STEP_DEG)) == []
    [grown] = player.play(quiet, LElbowRoll=residual(3.0 + 1.05 * INTENSITY_STEP_DEG))
    assert (grown.phase, grown.id) == ("update", begin.id)
    assert grown.time == pytest.approx((start + 2 * quiet) * CYCLE)  # at once after so long
    assert grown.torque is not None
    # The torque of the player has a standard deviation of 0.1 N m.
    step = 0.1 * TORQUE_STEP_STDS
    assert player.play(quiet, LElbowRoll=torque(abs(grown.torque) - 0.95 * step)) == []
    [less] = player.play(quiet, LElbowRoll=torque(abs(grown.torque) - 1.05 * step))
    assert less.torque == pytest.approx(grown.torque + 1.05 * step)
    assert less.intensity_deg == grown.intensity_deg


def test_an_update_comes_when_a_torque_becomes_known_and_when_it_is_lost() -> None:
    player = Player()
    player.play(round(0.5 / CYCLE), LElbowRoll=2.0)
    for known in (False, True):
        player.torque_known = known
        [update] = player.play(2 * PERIOD, LElbowRoll=2.0)
        assert update.phase == "update"
        assert (update.torque is not None) == known


def test_updates_of_a_contact_that_grows_are_a_period_apart() -> None:
    player, events = Player(), []
    for k in range(3 * PERIOD):
        events += player.play(1, HipRoll=1.5 + 0.1 * k)
    growing = [event for event in events if event.kind == "contact"]
    apart = np.diff([event.time for event in growing])
    assert len(apart) >= 1
    assert apart.min() >= SETTINGS.update_period - 1e-6


def test_a_contact_that_gets_hard_is_a_collision() -> None:
    factor = SETTINGS.collision_factor
    player = Player()
    [soft] = player.play(1, LElbowRoll=0.98 * factor)
    assert soft.kind == "contact"
    [hard] = player.play(1, LElbowRoll=1.02 * factor)
    assert (hard.id, hard.phase, hard.kind) == (1, "update", "collision")
    # And stays one.
    events = player.play(PERIOD, LElbowRoll=1.5) + player.play(QUIET)
    assert {event.kind for event in events} == {"collision"}
    [at_once] = Player().play(1, LElbowRoll=1.02 * factor)
    assert (at_once.phase, at_once.kind) == ("begin", "collision")


def test_a_hand_that_pushes_harder_and_harder_makes_no_collision() -> None:
    player = Player()
    soft = player.play(math.floor(COLLISION_TIME / CYCLE) + 1, LElbowRoll=1.5)
    hard = player.play(5, LElbowRoll=3.0 * SETTINGS.collision_factor)
    assert {event.kind for event in soft + hard} == {"contact"}


# -- kinds ------------------------------------------------------------------------------------------------------------


def kinds(events: list[Contact]) -> list[tuple[int, str, str]]:
    """Events in which the kind is another than before."""
    reported: list[tuple[int, str, str]] = []
    for event in events:
        if not reported or (event.id, event.kind) != (reported[-1][0], reported[-1][2]):
            reported.append((event.id, event.phase, event.kind))
    return reported


def ticks(seconds: float) -> int:
    return round(seconds / CYCLE)


def test_a_push_becomes_a_hold() -> None:
    player = Player()
    events = player.play(ticks(HOLD_TIME + 0.5), LElbowRoll=2.0) + player.play(QUIET)
    assert kinds(events) == [(1, "begin", "contact"), (1, "update", "push"), (1, "update", "hold")]
    assert events[1].time - events[0].onset_time == pytest.approx(TAP_TIME, abs=1.1 * CYCLE)
    assert events[2].time - events[0].onset_time == pytest.approx(HOLD_TIME, abs=1.1 * CYCLE)
    assert (events[-1].phase, events[-1].kind) == ("end", "hold")


@pytest.mark.parametrize(("pause", "kind"), [(0.5, "double tap"), (1.5, "tap")])
def test_taps(pause: float, kind: str) -> None:
    player = Player()
    events = player.play(ticks(0.1), LElbowRoll=2.0) + player.play(ticks(pause))
    assert kinds(events) == [(1, "begin", "contact"), (1, "end", "tap")]
    # It is reported ``merge_gap`` after the release: then it is known that it was one.
    second = player.play(ticks(0.1), LElbowRoll=2.0) + player.play(QUIET)
    assert kinds(second) == [(2, "begin", "contact"), (2, "end", kind)]
    if kind == "double tap":  # a third one is the first of the next two
        third = player.play(ticks(0.1), LElbowRoll=2.0) + player.play(QUIET)
        assert third[-1].kind == "tap"


def test_a_long_touch_is_no_tap() -> None:
    player = Player()
    events = player.play(ticks(TAP_TIME + 0.1), LElbowRoll=2.0) + player.play(QUIET)
    assert (events[-1].phase, events[-1].kind) == ("end", "push")


@pytest.mark.parametrize(("pause", "kind"), [(0.36, "grip"), (0.48, "grip"), (0.56, "contact")])
def test_a_hand_that_pulls_soon_after_it_pushed_grips(pause: float, kind: str) -> None:
    """Within half a second."""
    player = Player()
    events = player.play(ticks(0.6), LElbowRoll=2.0) + player.play(ticks(pause))
    events += player.play(ticks(0.6), LElbowRoll=-2.0) + player.play(QUIET)
    begins = [(e.id, e.kind) for e in events if e.phase == "begin"]
    assert begins == [(1, "contact"), (2, kind)]
    assert events[-1].kind == ("grip" if kind == "grip" else "push")


@pytest.mark.parametrize(
    ("seconds", "joint", "ratio"),
    [(0.6, "LElbowRoll", 2.0), (0.6, "LShoulderRoll", -2.0), (0.1, "LElbowRoll", -2.0)],
    ids=["the same way", "on another joint", "after a tap"],
)
def test_another_push_is_no_grip(seconds: float, joint: str, ratio: float) -> None:
    player = Player()
    events = player.play(ticks(seconds), LElbowRoll=2.0) + player.play(ticks(0.36))
    events += player.play(ticks(0.6), **{joint: ratio}) + player.play(QUIET)
    assert {event.id for event in events} == {1, 2}
    assert "grip" not in {event.kind for event in events}


def test_a_base_that_swings_after_a_push_is_not_pushed_the_other_way() -> None:
    player = Player()
    events = player.play(ticks(0.2), base=3.0) + player.play(ticks(0.2), base=-3.0)
    events += player.play(QUIET)
    assert [(e.phase, e.kind) for e in events if e.kind != "push"] == [("begin", "contact")]
    assert [(e.phase, e.kind) for e in events][-1] == ("end", "push")
    assert {event.id for event in events} == {1}
    assert events[-1].time == pytest.approx(2 * ticks(0.2) * CYCLE)


def test_a_joint_that_swings_back_makes_a_rebound() -> None:
    player = Player()
    events = player.play(5, LElbowRoll=2.8) + player.play(3)
    events += player.play(5, LElbowRoll=-2.8) + player.play(QUIET)
    assert [(e.id, e.phase, e.kind) for e in events if e.phase != "update"] == [
        (1, "begin", "contact"),
        (1, "end", "tap"),
        (2, "begin", "rebound"),
        (2, "end", "rebound"),
    ]
    assert events[1].time == pytest.approx(5 * CYCLE)


def test_a_contact_that_moved_from_the_trunk_ends_no_earlier_than_it_moved() -> None:
    player = Player()
    events = player.play(1 + HELD, HipRoll=2.0) + player.play(2)
    events += player.play(1, LElbowRoll=3.0) + player.play(QUIET)
    assert {event.id for event in events} == {1}
    times = [event.time for event in events]
    assert times == sorted(times)


def test_reset_forgets() -> None:
    player = Player()
    player.play(10, LElbowRoll=5.0, HipRoll=5.0)
    player.tracker.reset()
    assert player.tracker.idle
    assert player.play(GAP + 5) == []
    assert player.play(1, LElbowRoll=2.0)[0].id == 1


NAMES = ("KneePitch", "HipRoll", "HeadYaw", "LShoulderRoll", "LElbowRoll", "LHand", "RWristYaw")
VALUES = st.sampled_from([0.0, 0.0, 0.5, 1.2, -1.2, 2.5, -4.0, 9.0, math.nan])
PART = st.tuples(
    st.integers(1, 40), st.dictionaries(st.sampled_from(NAMES), VALUES, max_size=4), VALUES
)


@examples(150)
@given(st.lists(PART, max_size=20))
def test_events_make_sense_for_any_residuals(
    parts: list[tuple[int, dict[str, float], float]],
) -> None:
    player = Player()
    events: list[Contact] = []
    for ticks, row, base in parts:
        for _ in range(ticks):
            idle = player.tracker.idle
            new = player.play(1, base, **row)
            values = [0.0 if math.isnan(v) else abs(v) for v in (*row.values(), base)]
            assert not (new and idle and max(values) <= 1.0)
            events += new
    events += player.play(3 * QUIET)
    check_lives(events)
    assert player.tracker.idle
    assert set(player.states) == {JointState.FREE}
