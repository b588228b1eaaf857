"""Push that would tip the robot, computed by another method."""

import mujoco
import numpy as np
import pytest

from pepper_driver.config import load_robot
from pepper_driver.config.arrays import FloatArray
from pepper_driver.controller.support_polygon import SupportPolygon

ROBOT = load_robot()
SUPPORT_POLYGON = SupportPolygon.from_robot(ROBOT)


def mass_centre(posture: FloatArray) -> tuple[FloatArray, float]:
    """(3,) centre of mass in base_link [m], and weight [N], as MuJoCo has them."""
    spec = mujoco.MjSpec.from_file(str(ROBOT.urdf))
    spec.compiler.fusestatic = False
    model = spec.compile()
    data = mujoco.MjData(model)
    for name, angle in zip(ROBOT.joint_names, posture, strict=True):
        data.qpos[model.joint(name).qposadr[0]] = angle
    mujoco.mj_forward(model, data)
    return np.array(data.subtree_com[0]), float(model.body_subtreemass[0] * 9.81)


@pytest.mark.parametrize("name", ["Stand", "Crouch", "StandZero"])
def test_a_push_forwards_works_against_the_weight_over_the_front_wheels(name: str) -> None:
    posture = ROBOT.posture(name)
    centre, weight = mass_centre(posture)
    front = ROBOT.wheels.positions[0][0]
    expected = 20.0 * 0.8 / (weight * (front - centre[0]))
    ratio = SUPPORT_POLYGON.tipping_ratio(
        posture, np.array([0.1, 0.0, 0.8]), np.array([20.0, 0.0, 0.0])
    )
    assert ratio == pytest.approx(expected, rel=1e-3)


@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_a_push_sideways_tips_over_the_edge_to_the_rear_wheel(side: float) -> None:
    posture = ROBOT.posture("Stand")
    centre, weight = mass_centre(posture)
    wheels = np.array(ROBOT.wheels.positions)
    corner, rear = wheels[np.argmax(side * wheels[:, 1])][:2], wheels[np.argmin(wheels[:, 0])][:2]
    along = (rear - corner) / np.linalg.norm(rear - corner)
    outwards = side * np.array([-along[1], along[0]])
    outwards *= np.sign(outwards @ [0.0, side])
    distance = float((corner - centre[:2]) @ outwards)
    expected = 20.0 * 0.8 * abs(outwards[1]) / (weight * distance)
    force = np.array([0.0, side * 20.0, 0.0])
    ratio = SUPPORT_POLYGON.tipping_ratio(posture, np.array([0.0, side * 0.2, 0.8]), force)
    assert ratio == pytest.approx(expected, rel=1e-3)


def test_a_push_at_the_floor_or_down_between_the_wheels_does_not_tip() -> None:
    posture = ROBOT.posture("Stand")
    assert SUPPORT_POLYGON.tipping_ratio(
        posture, np.zeros(3), np.array([50.0, 20.0, 0.0])
    ) == pytest.approx(0.0)
    assert (
        SUPPORT_POLYGON.tipping_ratio(
            posture, np.array([0.0, 0.0, 1.0]), np.array([0.0, 0.0, -100.0])
        )
        == 0.0
    )


def test_lifting_by_the_whole_weight_is_beyond_standing() -> None:
    posture = ROBOT.posture("Stand")
    centre, weight = mass_centre(posture)
    ratio = SUPPORT_POLYGON.tipping_ratio(posture, centre, np.array([0.0, 0.0, weight]))
    assert ratio == pytest.approx(1.0, rel=1e-3)


def test_a_robot_that_leans_out_over_its_wheels_falls_without_a_push() -> None:
    posture = ROBOT.posture("Stand")
    for name in ("HipPitch", "KneePitch"):
        posture[ROBOT.joint_index(name)] = ROBOT.lower[ROBOT.joint_index(name)]
    assert mass_centre(posture)[0][0] > ROBOT.wheels.positions[0][0]
    assert (
        SUPPORT_POLYGON.tipping_ratio(
            posture, np.array([0.0, 0.0, 0.8]), np.array([-1.0, 0.0, 0.0])
        )
        == np.inf
    )
