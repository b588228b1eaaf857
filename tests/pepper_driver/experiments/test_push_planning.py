"""Planned pushes put on a joint what was asked for, and nothing into saturation unless that is requested."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from pepper_driver.config.arrays import FloatArray
from pepper_driver.controller import RobotModel
from pepper_driver.experiments.push_planning import (
    PlannedPush,
    PushLimits,
    PushTooStrongError,
    evaluate_push,
    plan_push,
)
from pepper_driver.robot import Pepper
from support.pushes import ROBOT, limit_degrees, make_pepper

BOUNDS = PushLimits(load=0.85, tipping=0.8)
INDEX = ROBOT.joint_index("LShoulderRoll")
POINT = np.array([0.16, 0.015, 0.0])


def plan(pepper: Pepper, **changes: Any) -> PlannedPush:
    arguments: dict[str, Any] = {
        "joint": "LShoulderRoll",
        "link": "LBicep",
        "point": POINT,
        "degrees": 0.4 * limit_degrees(pepper, "LShoulderRoll"),
        "direction": 1,
        "posture": ROBOT.posture("Stand"),
        "bounds": BOUNDS,
    }
    return plan_push(RobotModel(ROBOT), ROBOT, pepper.backend.plant, **(arguments | changes))


def weigh(pepper: Pepper, **changes: Any) -> PlannedPush:
    arguments: dict[str, Any] = {
        "joint": "LShoulderRoll",
        "link": "LBicep",
        "point": POINT,
        "force": np.array([0.0, 10.0, 0.0]),
        "frame": "link",
        "posture": ROBOT.posture("Stand"),
        "bounds": BOUNDS,
    }
    return evaluate_push(RobotModel(ROBOT), ROBOT, pepper.backend.plant, **(arguments | changes))


@pytest.mark.parametrize("direction", [-1, 1])
def test_the_joint_gets_the_torque_that_was_requested(direction: int) -> None:
    with make_pepper() as pepper:
        push = plan(pepper, direction=direction)
        requested = direction * 0.4 * pepper.backend.plant.torque_limit[INDEX]
        assert push.torque == pytest.approx(requested)
        assert push.degrees == pytest.approx(0.4 * limit_degrees(pepper, "LShoulderRoll"))
        pepper.push(push.link, push.force, push.point, 1.0, frame=push.frame)
        pepper.run(0.5)
        assert pepper.backend.truth.contact_torque[INDEX] == pytest.approx(requested, rel=1e-3)


def test_no_smaller_force_would_do() -> None:
    """The force points along the joint's own motion of the point: any other direction wastes some of it."""
    push = plan(make_pepper())
    assert push.newtons == pytest.approx(push.torque / np.hypot(0.16, 0.015), rel=1e-6)
    assert push.newtons == pytest.approx(np.linalg.norm(push.force))


@pytest.mark.parametrize("frame", ["world", "link"])
def test_a_force_is_given_in_degrees_of_the_joint(frame: str) -> None:
    with make_pepper() as pepper:
        posture = ROBOT.posture("Stand")
        push = weigh(pepper, force=np.array([3.0, 8.0, -2.0]), frame=frame, posture=posture)
        assert push.newtons == pytest.approx(np.sqrt(77.0))
        pepper.set_posture(posture)
        pepper.push(push.link, push.force, push.point, 1.0, frame=push.frame)
        pepper.run(0.3)
        truth = pepper.backend.truth
        assert truth.contact_torque[INDEX] == pytest.approx(push.torque, rel=0.05)
        degrees = np.degrees(abs(push.torque) / pepper.backend.plant.stiffness[INDEX])
        assert push.degrees == pytest.approx(degrees)


def test_a_push_that_would_saturate_a_board_is_refused() -> None:
    pepper = make_pepper()
    limit = limit_degrees(pepper, "LShoulderRoll")
    with pytest.raises(PushTooStrongError, match=r"would load LShoulderRoll to \d+% of its limit"):
        plan(pepper, degrees=0.9 * limit)
    with pytest.raises(PushTooStrongError):
        plan(pepper, bounds=PushLimits(load=0.1, tipping=0.8))


def test_a_push_that_is_meant_to_saturate_is_not() -> None:
    pepper = make_pepper()
    limit = limit_degrees(pepper, "LShoulderRoll")
    push = plan(
        pepper, degrees=1.2 * limit, bounds=PushLimits(load=0.85, tipping=0.8, saturating=True)
    )
    assert push.load > 1.2
    assert push.degrees == pytest.approx(1.2 * limit)


def test_gravity_counts() -> None:
    """An arm stretched forward is heavier to hold than one that hangs."""
    pepper = make_pepper()
    hanging, forward = ROBOT.posture("Stand"), ROBOT.posture("StandZero")
    arguments = {"joint": "LShoulderPitch", "force": np.array([0.0, 0.0, -1.0]), "frame": "world"}
    index = ROBOT.joint_index("LShoulderPitch")
    gravity = RobotModel(ROBOT).gravity_torque(forward)[index]
    push = weigh(pepper, posture=forward, **arguments)
    limit = pepper.backend.plant.torque_limit[index]
    assert push.load * limit >= abs(push.torque) + abs(gravity) - 1e-9
    assert push.load > weigh(pepper, posture=hanging, **arguments).load


def test_a_force_without_torque_on_the_joint_is_refused() -> None:
    pepper = make_pepper()
    with pytest.raises(PushTooStrongError, match="does not turn"):
        plan(pepper, point=np.zeros(3))
    with pytest.raises(PushTooStrongError, match="does not turn RShoulderRoll"):
        weigh(pepper, joint="RShoulderRoll")


def test_no_hand_is_stronger_than_a_hand() -> None:
    with pytest.raises(PushTooStrongError, match="than any hand"):
        plan(
            make_pepper(),
            point=np.array([0.002, 0.0, 0.0]),
            degrees=80.0,
            bounds=PushLimits(load=1.0, tipping=1.0, saturating=True),
        )


def test_on_wheels_a_push_must_not_tip_the_robot() -> None:
    fixed = make_pepper()
    rolling = make_pepper("rolling")
    wide = PushLimits(load=np.inf, tipping=np.inf)
    # Forwards, at the shoulder: the hip and the wheels have to hold it.
    push = {"joint": "HipPitch", "link": "torso", "frame": "world", "point": np.zeros(3)}
    light, heavy = np.array([1.0, 0.0, 0.0]), np.array([40.0, 0.0, 0.0])
    per_newton = weigh(rolling, **push, force=light, bounds=wide).tipping
    assert weigh(rolling, **push, force=heavy, bounds=wide).tipping == pytest.approx(
        40 * per_newton
    )
    assert weigh(fixed, **push, force=heavy, bounds=wide).tipping == 0.0
    enough = np.array([0.81 / per_newton, 0.0, 0.0])
    for saturating in (False, True):
        bounds = PushLimits(load=np.inf, tipping=0.8, saturating=saturating)
        weigh(rolling, **push, force=enough * 0.98, bounds=bounds)
        with pytest.raises(PushTooStrongError, match="81% of what tips the robot over"):
            weigh(rolling, **push, force=enough, bounds=bounds)


OUT = np.array([0.12, 0.0, 0.0])


def bent() -> FloatArray:
    """Arm to the side, elbow bent: a push on the forearm turns shoulder and elbow."""
    posture = ROBOT.posture("Stand")
    for name, angle in (("LShoulderRoll", 0.6), ("LElbowYaw", -0.6), ("LElbowRoll", -0.9)):
        posture[ROBOT.joint_index(name)] = angle
    return posture


@pytest.mark.parametrize("joint", ["LShoulderRoll", "LElbowYaw", "LElbowRoll"])
@pytest.mark.parametrize("direction", [-1, 1])
def test_joints_further_out_get_little_torque_if_that_is_requested(
    joint: str, direction: int
) -> None:
    pepper = make_pepper()
    plant, index = pepper.backend.plant, ROBOT.joint_index(joint)
    arguments = {
        "joint": joint,
        "link": "LForeArm",
        "point": OUT,
        "degrees": 1.0,
        "direction": direction,
        "posture": bent(),
    }
    wide = PushLimits(load=np.inf, tipping=np.inf)
    plain = plan(pepper, **arguments, bounds=wide)
    chosen = plan(pepper, **arguments, bounds=replace(wide, max_distal_ratio=0.25))
    outer = [ROBOT.joint_index(n) for n in ROBOT.chain_of(joint)]
    outer = [k for k in outer if k > index]

    def ratios(push: PlannedPush) -> FloatArray:
        degrees = np.degrees(np.abs(push.torques[outer]) / plant.stiffness[outer])
        assert plant.config is not None
        friction = [plant.config.actuator(ROBOT.joint_names[k]).friction.contact for k in outer]
        held = np.array([0.5 * (f.motor + f.link) for f in friction])
        result: FloatArray = np.where(np.abs(push.torques[outer]) > held, degrees, 0.0)
        return result

    assert plain.torque == pytest.approx(chosen.torque)
    assert chosen.degrees == pytest.approx(1.0)
    assert ratios(chosen).max() <= 0.25 + 1e-9
    if joint == "LShoulderRoll":
        assert ratios(plain).max() > 0.25, "else this test says nothing"
        assert chosen.newtons > plain.newtons


class InexactModel(RobotModel):
    """Model of another processor: rounding errors of its own in each Jacobian."""

    random = np.random.default_rng(0)

    def point_jacobian(
        self, link: str, point: FloatArray, joint_position: FloatArray
    ) -> FloatArray:
        exact = super().point_jacobian(link, point, joint_position)
        inexact: FloatArray = exact + 1e-16 * self.random.normal(size=exact.shape)
        return inexact


def elbow_force(
    model: RobotModel, pepper: Pepper, posture: FloatArray, direction: int
) -> FloatArray | None:
    """Return the force (3,) [N] of a push on the right elbow, on the axis of the wrist; None if none is possible."""
    try:
        return plan_push(
            model,
            ROBOT,
            pepper.backend.plant,
            joint="RElbowRoll",
            link="RForeArm",
            point=np.array([0.14, 0.0, 0.0]),
            degrees=2.5,
            direction=direction,
            posture=posture,
            bounds=PushLimits(load=0.8, tipping=0.6, max_distal_ratio=0.25),
        ).force
    except PushTooStrongError:
        return None


def test_on_the_axis_of_an_outer_joint_rounding_errors_choose_no_force() -> None:
    pepper, random = make_pepper("rolling"), np.random.default_rng(1)
    exact, inexact = RobotModel(ROBOT), InexactModel(ROBOT)
    arm = [ROBOT.joint_index(name) for name in ROBOT.limbs["right_arm"]]
    planned = 0
    for direction in [-1, 1] * 20:
        posture = ROBOT.posture("Stand")
        posture[arm] += random.uniform(-0.5, 0.5, len(arm))
        chosen = elbow_force(exact, pepper, posture, direction)
        elsewhere = elbow_force(inexact, pepper, posture, direction)
        assert (chosen is None) == (elsewhere is None)
        if chosen is not None and elsewhere is not None:
            np.testing.assert_allclose(elsewhere, chosen, atol=1e-9)
            planned += 1
    assert planned > 5, "else this test says nothing"


def test_a_place_where_joints_further_out_must_get_torque_is_refused() -> None:
    pepper = make_pepper()
    bounds = PushLimits(load=np.inf, tipping=np.inf, max_distal_ratio=0.25)
    arguments = {"link": "LForeArm", "point": OUT, "posture": bent(), "bounds": bounds}
    with pytest.raises(PushTooStrongError, match=r"of the degrees of LShoulderPitch on \w+ too"):
        plan(pepper, joint="LShoulderPitch", degrees=1.0, **arguments)
    bounds = replace(bounds, max_distal_ratio=0.0)
    with pytest.raises(PushTooStrongError, match=r"of the degrees of LShoulderRoll on \w+ too"):
        weigh(pepper, link="LForeArm", point=OUT, posture=bent(), bounds=bounds)


def test_no_hand_is_stronger_than_it_may_be() -> None:
    pepper = make_pepper()
    force = plan(pepper).newtons
    plan(pepper, bounds=replace(BOUNDS, force=force * 1.01))
    with pytest.raises(PushTooStrongError, match="more than the hand may do"):
        plan(pepper, bounds=replace(BOUNDS, force=force * 0.99))


def test_pushes_at_the_same_time_share_what_the_robot_can_take() -> None:
    pepper = make_pepper("rolling")
    side = {"joint": "LShoulderRoll", "force": np.array([0.0, 12.0, 0.0]), "frame": "world"}
    posture = ROBOT.posture("Stand")
    first = weigh(pepper, **side)
    other = {**side, "joint": "RShoulderRoll", "link": "RBicep", "point": POINT * [1, -1, 1]}
    alone = weigh(pepper, **other)
    enough = PushLimits(load=0.85, tipping=first.tipping + alone.tipping + 1e-6)
    both = weigh(pepper, **other, bounds=enough, concurrent=[first])
    assert both.load >= alone.load
    hip = ROBOT.joint_index("HipRoll")
    gravity = abs(RobotModel(ROBOT).gravity_torque(posture)[hip])
    together = abs(first.torques[hip]) + abs(alone.torques[hip]) + gravity
    assert both.load >= together / pepper.backend.plant.torque_limit[hip] - 1e-9
    with pytest.raises(PushTooStrongError, match="tips the robot over"):
        weigh(
            pepper,
            **other,
            bounds=replace(enough, tipping=enough.tipping - 1e-3),
            concurrent=[first],
        )
    same = {**side, "force": np.array([0.0, 25.0, 0.0])}
    wide = PushLimits(load=0.85, tipping=np.inf)
    weigh(pepper, **same, bounds=wide)
    with pytest.raises(PushTooStrongError, match="would load LShoulderRoll"):
        weigh(pepper, **same, bounds=wide, concurrent=[weigh(pepper, **same, bounds=wide)])


def test_a_push_on_the_trunk_is_given_in_degrees_of_the_leg_joint_with_most() -> None:
    pepper = make_pepper()
    push = weigh(
        pepper,
        joint=None,
        link="torso",
        point=np.array([0.0, 0.0, 0.2]),
        force=np.array([0.0, 10.0, 0.0]),
        frame="world",
    )
    hip = ROBOT.joint_index("HipRoll")
    assert push.joint is None
    assert push.torque == pytest.approx(push.torques[hip])
    assert abs(push.torque) == pytest.approx(10.0 * 0.2, rel=0.02)
    assert push.degrees == pytest.approx(
        np.degrees(abs(push.torque) / pepper.backend.plant.stiffness[hip])
    )


def test_a_push_that_would_tip_the_robot_may_press_it_down_as_well() -> None:
    """The shoulder pitch of an arm that hangs: the smallest force is horizontal, at the height of the hand."""
    rolling = make_pepper("rolling")
    arguments = {"joint": "LShoulderRoll", "degrees": 1.5, "posture": bent()}
    wide = PushLimits(load=np.inf, tipping=np.inf, max_distal_ratio=0.25)
    plain = plan(rolling, **arguments, bounds=wide)
    less = replace(wide, tipping=plain.tipping * 0.9)
    for direction in (-1, 1):
        plain = plan(rolling, **arguments, direction=direction, bounds=wide)
        try:
            pressed = plan(
                rolling,
                **arguments,
                direction=direction,
                bounds=replace(less, tipping=plain.tipping * 0.9),
            )
        except PushTooStrongError:
            continue
        assert pressed.torque == pytest.approx(plain.torque)
        assert pressed.tipping <= plain.tipping * 0.9
        break
    else:
        pytest.fail("no other direction was found")
