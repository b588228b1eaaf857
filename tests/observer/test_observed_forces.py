"""Forces in the events of a contact observer, over ticks of a joint that another integrator simulates."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from pepper_driver.controller import RobotModel
from pepper_driver.controller.tick import Tick
from pepper_driver.observer.contact_observer import ContactObserver
from pepper_driver.observer.detection.contact_force import ContactForce, ForceEstimator
from pepper_driver.observer.models.measured_robot import MeasuredJoint
from support.fusion import (
    MODEL,
    drive,
    fusion_observer,
    fusion_set,
    push_profile,
    standing,
    ticks_of,
)
from support.observer import CYCLE, JOINTS, ROBOT, SETTINGS, measured, models, run, tick

ARM = ("LShoulderPitch", "LShoulderRoll", "LElbowYaw", "LElbowRoll")
FORCE, POINT = np.array([-6.0, 21.0, -18.0]), np.array([0.06, 0.0, 0.0])
"""[N] on the hand, in base_link; where, in the frame of l_wrist [m]."""

TORQUE = 5.0
"""[N m] On one joint."""


def pushed(joint: str = "LElbowRoll") -> list[Tick]:
    """A joint that stands is pushed for 1.5 s; no other one shows a torque."""
    motion = standing(4.0, load=1.0)
    push = push_profile(len(motion), 1.0, 1.5, TORQUE)
    return ticks_of(motion, drive(motion, torque=push), ROBOT.joint_index(joint))


def pushed_hand() -> list[Tick]:
    """The left hand is pushed for 1.5 s while the robot stands with all of its arm at 0."""
    motion, index = standing(4.0, load=1.0), [ROBOT.joint_index(name) for name in ARM]
    posture = tick(0).sent.position.copy()
    posture[index] = 0.0
    torque = RobotModel(ROBOT).point_jacobian("l_wrist", POINT, posture).T @ FORCE
    parts = []
    for joint in index:
        push = push_profile(len(motion), 1.0, 1.5, float(torque[joint]))
        parts.append(ticks_of(motion, drive(motion, torque=push), joint))
    ticks = parts[0]
    for joint, part in zip(index[1:], parts[1:], strict=True):
        for one, other in zip(ticks, part, strict=True):
            one.sent.position[joint] = other.sent.position[joint]
            one.reference.position[joint] = other.reference.position[joint]
            one.reference.load_torque[joint] = other.reference.load_torque[joint]
            one.measurement.position[joint] = other.measurement.position[joint]
            one.measurement.current[joint] = other.measurement.current[joint]
    return ticks


def test_a_push_on_the_hand_has_its_force_and_place_until_the_end() -> None:
    events = run(fusion_observer(), pushed_hand())[1]
    assert (events[0].phase, events[-1].phase) == ("begin", "end")
    assert {event.id for event in events} == {1}
    for event in events:
        size, interval = event.force_size, event.force_interval
        assert size is not None
        assert interval is not None
        assert interval[0] < size < interval[1]
        assert event.force_covariance is not None
        assert event.point_covariance is not None
        assert np.linalg.eigvalsh(np.reshape(event.force_covariance, (3, 3))).min() > 0.0
        assert np.linalg.eigvalsh(np.reshape(event.point_covariance, (3, 3))).min() > 0.0
        assert event.scale_known is False
        assert "scale unknown" in event.force_text
    # An end has the last force of the contact: the hand has left.
    before = [event for event in events if event.phase != "end"][-1]
    assert (events[-1].force, events[-1].point) == (before.force, before.point)
    held = [event for event in events if event.time < 2.4][-1]
    assert held.force is not None
    assert held.force_size is not None
    assert held.force_interval is not None
    true = float(np.linalg.norm(FORCE))
    assert held.force_interval[0] < true < held.force_interval[1]
    assert held.force_size == pytest.approx(true, rel=0.4)
    assert FORCE @ held.force / true / held.force_size > 0.8


def test_a_torque_that_no_force_explains_leaves_the_size_open() -> None:
    """The elbow alone: what touches the hand turns the shoulder too."""
    events = run(fusion_observer(), pushed())[1]
    held = [event for event in events if event.time < 2.4][-1]
    assert held.force_interval is not None
    assert held.force_interval[1] > 4.0 * held.force_interval[0]
    assert held.force_interval[1] > 15.0


def test_a_weight_makes_the_scale_of_all_joints_known() -> None:
    joints = {name: MeasuredJoint(torque_scale=1.25) for name in ROBOT.joint_names}
    facts = measured(**joints)
    ticks = pushed()
    known = ContactObserver(ROBOT, replace(fusion_set(), measured=facts), SETTINGS)
    events = run(known, ticks)[1]
    assert {event.scale_known for event in events} == {True}
    assert "unknown" not in events[0].force_text


def test_a_force_that_was_forgotten_with_a_reset_ends_no_later_contact() -> None:
    ticks = pushed()
    target = fusion_observer()
    first = run(target, ticks)[1]
    target.reset()
    assert run(target, ticks)[1] == first


@pytest.mark.parametrize("joint", ["HipPitch", "KneePitch"])
def test_contacts_on_the_trunk_have_no_force(joint: str) -> None:
    events = run(fusion_observer(), pushed(joint))[1]
    assert events
    for event in events:
        assert event.limb == "trunk"
        assert (event.force, event.force_interval, event.point) == (None, None, None)
        assert (event.scale_known, event.force_size, event.force_text) == (None, None, "")


def test_too_few_joints_with_models_have_no_force() -> None:
    ticks = pushed()
    target = ContactObserver(ROBOT, fusion_set({"LElbowRoll": MODEL}), SETTINGS)
    events = run(target, ticks)[1]
    assert events
    assert {event.force for event in events} == {None}


def test_other_modes_know_no_forces() -> None:
    errors = np.zeros(JOINTS)
    errors[ROBOT.joint_index("LElbowRoll")] = -0.1
    ticks = [tick(k, errors if k > 30 else 0.0) for k in range(90)]
    events = run(ContactObserver(ROBOT, models(), SETTINGS), ticks)[1]
    assert events
    assert {event.force for event in events} == {None}
    momentum = ContactObserver(ROBOT, fusion_set(), SETTINGS, momentum=True)
    assert {event.force for event in run(momentum, pushed_hand())[1]} == {None}


def test_the_force_takes_no_time_while_nothing_touches(monkeypatch: pytest.MonkeyPatch) -> None:
    """It is computed with events alone."""
    asked: list[str] = []
    estimate = ForceEstimator.estimate

    def counted(self: ForceEstimator, limb: str, *values: Any) -> ContactForce | None:
        asked.append(limb)
        return estimate(self, limb, *values)

    monkeypatch.setattr(ForceEstimator, "estimate", counted)
    target = fusion_observer()
    ticks = pushed()
    events = run(target, ticks)[1]
    assert len(asked) >= sum(event.phase != "end" for event in events)
    assert len(asked) < 2.0 / SETTINGS.update_period + 6
    assert round(1.0 / CYCLE) > 4 * len(asked)
