"""Thresholds given as torque and as forces, and joints that notice hardly any touch."""

from dataclasses import replace

import numpy as np
import pytest

from pepper_driver.config import load_observer_settings
from pepper_driver.controller import RobotModel
from pepper_driver.identification import Finding
from pepper_driver.identification.sensitivity import (
    PLACES,
    POSTURE,
    JointSensitivity,
    blind_joints,
    joint_sensitivities,
)
from pepper_driver.observer import ContactObserver, FitScore
from pepper_driver.observer.constants import MIN_TORQUE
from pepper_driver.observer.contact_observer import ObserverParts
from pepper_driver.observer.residuals.fusion import FusionParts
from support.fusion import (
    STICK_SLIP,
    drive,
    fusion_model,
    fusion_set,
    spread_of,
    swing,
    ticks_of,
)
from support.identification import ROBOT

REST, MOTION = np.radians(4.0), np.radians(1.0)


def sensitivity(degrees: float, torque: float) -> JointSensitivity:
    return JointSensitivity(threshold=float(np.radians(degrees)), torque=torque, forces={})


def blind(joint: str, one: JointSensitivity, test_fit: float = 90.0, *findings: Finding) -> str:
    fit = FitScore(estimation=90.0, test=test_fit)
    found = blind_joints({joint: fit}, {joint: one}, findings, ROBOT, {})
    assert all(f.kind == "blind" and f.joint == joint and f.run is None for f in found)
    return "; ".join(f.text for f in found)


def test_threshold_is_that_of_motion() -> None:
    model = fusion_model(spread=(*spread_of(REST)[:2], spread_of(MOTION)[2]))
    one = joint_sensitivities({"LElbowRoll": model}, ROBOT)["LElbowRoll"]
    assert one.threshold == pytest.approx(MOTION)
    assert one.torque == pytest.approx(MOTION / STICK_SLIP.load_gain)


@pytest.mark.parametrize("load_gain", [0.01, 0.3])
def test_threshold_is_the_one_that_the_observer_uses(load_gain: float) -> None:
    """Also of a quiet joint, and of one whose board is soft: there the smallest torque counts."""
    model = fusion_model(replace(STICK_SLIP, load_gain=load_gain), spread=(1e-5,) * 3)
    one = joint_sensitivities({"LWristYaw": model}, ROBOT)["LWristYaw"]
    wrist = ROBOT.joint_index("LWristYaw")
    parts = FusionParts(loads=False, limbs=False)
    observer = ContactObserver(
        ROBOT, fusion_set(model), load_observer_settings(), parts=ObserverParts(residual=parts)
    )
    motion = swing(3.0)
    made = ticks_of(motion, drive(motion, model.twin), joint=wrist)
    # The lowest of all is that of a joint that slides.
    threshold = min(observer.step(one).threshold[wrist] for one in made)
    assert one.threshold == pytest.approx(threshold)
    assert (one.torque == pytest.approx(MIN_TORQUE)) == (load_gain > 0.1)


@pytest.mark.parametrize("joint", ["LShoulderPitch", "LElbowRoll", "RShoulderRoll", "LWristYaw"])
def test_forces_turn_the_joint_as_much_as_the_threshold(joint: str) -> None:
    """The work of a small turn: the torque times the angle is the force times the way of the point."""
    one = joint_sensitivities({joint: fusion_model(spread=spread_of(MOTION))}, ROBOT)[joint]
    model, posture, angle = RobotModel(ROBOT), ROBOT.posture(POSTURE), 1e-5
    turned = posture.copy()
    turned[ROBOT.joint_index(joint)] += angle
    for place, (link, point) in PLACES.items():
        if joint.startswith("R"):
            link = link.replace("l_", "r_").replace("LF", "RF")
        before, after = (
            model.link_pose(link, at) @ np.array([*point, 1.0]) for at in (posture, turned)
        )
        way = float(np.linalg.norm(after - before))
        if place in one.forces:
            assert one.forces[place] * way == pytest.approx(one.torque * angle, rel=1e-3)
        else:
            assert way < 0.04 * angle


def test_a_joint_behind_a_place_has_no_forces_there() -> None:
    models = {name: fusion_model() for name in ("LWristYaw", "HeadYaw", "LElbowYaw")}
    found = joint_sensitivities(models, ROBOT)
    assert "forearm" not in found["LWristYaw"].forces
    assert found["HeadYaw"].forces == {}


@pytest.mark.parametrize(
    ("joint", "degrees", "torque", "is_blind"),
    [
        ("LShoulderPitch", 3.5, 2.5, True),
        ("RElbowYaw", 14.0, 16.0, True),
        ("LShoulderPitch", 3.5, 1.5, False),
        ("LShoulderPitch", 2.5, 2.5, False),
        ("LWristYaw", 44.0, 5.0, False),
        ("HeadYaw", 10.0, 5.0, False),
        ("LHand", 10.0, 5.0, False),
    ],
)
def test_blind_are_shoulders_and_elbows_beyond_both_bounds(
    joint: str, degrees: float, torque: float, is_blind: bool
) -> None:
    text = blind(joint, sensitivity(degrees, torque))
    assert bool(text) == is_blind
    if is_blind:
        assert f"{degrees:.1f} deg, {torque:.1f} N m" in text


@pytest.mark.parametrize(("fit", "is_blind"), [(59.0, True), (61.0, False), (np.nan, True)])
def test_blind_are_joints_that_are_not_explained(fit: float, is_blind: bool) -> None:
    assert bool(blind("KneePitch", sensitivity(0.6, 1.0), fit)) == is_blind


def test_the_likeliest_cause_is_named_also_of_a_mirrored_joint() -> None:
    place = {"joint": "LElbowRoll", "run": "LElbowRoll-1"}
    findings = [
        Finding(kind="contact", text="was touched", **place),
        Finding(kind="behind", text="falls behind", **place),
    ]
    wander = Finding(kind="wander", joint="LElbowRoll", run=None, text="target wanders")
    assert "cause: target" in blind("RElbowRoll", sensitivity(1.0, 1.0), 50.0, findings[0], wander)
    other = Finding(kind="current", joint="LShoulderRoll", run=None, text="clipped")
    assert "cause: falls behind" in blind("RElbowRoll", sensitivity(5.0, 5.0), 90.0, *findings)
    assert "cause: unknown" in blind("RElbowRoll", sensitivity(5.0, 5.0), 90.0, other)
