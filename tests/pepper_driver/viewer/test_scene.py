"""Places of the mouse on the robot, and of the robot: closed forms, and the truth of the simulation."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

pytest.importorskip("viser")
import viser

from pepper_driver import Pepper
from pepper_driver.config import load_robot
from pepper_driver.config.visuals import Visual, load_visuals
from pepper_driver.observer import Contact
from pepper_driver.viewer.drawing import FORCE_LENGTH, centres_of, touch_arrows
from pepper_driver.viewer.picture import Picture
from pepper_driver.viewer.scene import RobotScene, signed_distance

NOTHING = np.full(17, np.nan)


def picture(position: np.ndarray, base: np.ndarray, tilt: np.ndarray) -> Picture:
    return Picture(
        time=0.0,
        position=position,
        commanded=position,
        residual=NOTHING,
        threshold=NOTHING,
        torque=NOTHING,
        torque_std=NOTHING,
        state=np.zeros(17, dtype=np.int64),
        base=base,
        tilt=tilt,
    )


@pytest.fixture(scope="module")
def scene() -> Iterator[RobotScene]:
    server = viser.ViserServer(host="127.0.0.1", port=0, verbose=False)
    yield RobotScene(server, load_robot())
    server.stop()


def shape(kind: str, *size: float) -> Visual:
    return Visual(
        link="torso",
        shape=kind,  # type: ignore[arg-type]
        size=size,
        transform_visual_to_link=np.eye(4),
        rgba=(1.0, 1.0, 1.0, 1.0),
    )


@given(st.tuples(*(st.floats(-2.0, 2.0) for _ in range(3))))
def test_distances_are_those_of_the_shapes(point: tuple[float, float, float]) -> None:
    """By other ways: the nearest of the surface's points."""
    p = np.array(point)
    assert signed_distance(shape("sphere", 0.5), p) == pytest.approx(np.linalg.norm(p) - 0.5)
    half = np.array([0.3, 0.2, 0.1])
    clipped = np.clip(p, -half, half)
    inside = np.all(np.abs(p) < half)
    expected = -np.min(half - np.abs(p)) if inside else np.linalg.norm(p - clipped)
    assert signed_distance(shape("box", *(2 * half)), p) == pytest.approx(expected)
    radius, length = 0.4, 0.6
    around, along = np.hypot(p[0], p[1]), abs(p[2])
    if around < radius and along < length / 2:
        expected = -min(radius - around, length / 2 - along)
    else:
        expected = np.hypot(max(around - radius, 0.0), max(along - length / 2, 0.0))
    assert signed_distance(shape("cylinder", radius, length), p) == pytest.approx(expected)


def test_links_are_drawn_where_they_are(scene: RobotScene) -> None:
    """In a posture, on a base that has moved and leans: as the simulation has it."""
    with Pepper("mujoco", observer=None) as pepper:
        pepper.set_posture({"LShoulderPitch": 0.3, "HeadYaw": 0.5, "HipRoll": 0.1}, duration=1.0)
        pepper.drive(0.2, 0.1, 0.3, hold=True)
        pepper.push("torso", [15.0, 0.0, 0.0], delay=1.4, duration=1.0)
        pepper.run(2.0)
        truth = pepper.backend.truth
        scene.show(picture(truth.position, truth.base, truth.tilt), ())
        for link in ("torso", "Head", "LForeArm", "r_wrist", "Tibia"):
            assert np.allclose(scene.link_pose(link), truth.link_pose(link), atol=2e-3), link


def test_a_ray_meets_the_surface_that_is_seen(scene: RobotScene) -> None:
    scene.show(picture(np.zeros(17), np.array([1.0, 2.0, 0.5]), np.zeros(2)), ())
    head = next(v for v, _ in scene.body.visuals if v.link == "Head" and v.shape == "sphere")
    pose = scene.link_pose("Head") @ head.transform_visual_to_link
    centre, direction = pose[:3, 3], np.array([0.6, 0.0, -0.8])
    hit = scene.hit(head, centre - 3.0 * direction, direction)
    assert hit is not None
    point, inwards = hit
    expected = centre - head.size[0] * direction
    assert point == pytest.approx(scene.in_link("Head", expected), abs=1e-3)
    assert inwards == pytest.approx(scene.link_pose("Head")[:3, :3].T @ direction)
    assert scene.hit(head, centre - 3.0 * direction + [0.0, 1.0, 0.0], direction) is None


def test_the_arrow_of_a_touch_has_the_detected_torque(scene: RobotScene) -> None:
    """Its force, acting at its root, gives the contact's torque on the joint."""
    robot = load_robot()
    q = robot.posture("Stand")
    scene.show(picture(q, np.zeros(3), np.zeros(2)), ())
    contact = Contact(
        id=3,
        phase="begin",
        kind="contact",
        limb="left_arm",
        joint="LShoulderRoll",
        shown_by="LShoulderRoll",
        link="LBicep",
        direction=1,
        intensity_deg=2.0,
        torque=2.5,
        torque_std=0.5,
        onset_time=0.0,
        detection_time=0.0,
        time=0.0,
    )
    centres = centres_of(load_visuals(robot))
    arrows = dict(touch_arrows(contact, robot, scene.link_pose, centres))
    start, tip = arrows["touch 3"].start, arrows["touch 3"].end
    force = (tip - start) / FORCE_LENGTH
    joint = robot.joints[robot.joint_index("LShoulderRoll")]
    pose = scene.link_pose(joint.child)
    moment = np.cross(start - pose[:3, 3], force) @ (pose[:3, :3] @ np.array(joint.axis))
    assert moment == pytest.approx(2.5, rel=1e-6)
    begin, end = arrows["touch 3 std"].start, arrows["touch 3 std"].end
    assert begin == pytest.approx(tip)
    assert np.linalg.norm(end - begin) / np.linalg.norm(tip - start) == pytest.approx(0.5 / 2.5)


def test_the_arrow_of_a_fitted_force_is_where_it_acts_however_the_base_stands(
    scene: RobotScene,
) -> None:
    robot = load_robot()
    base = np.array([0.5, -0.2, 0.5 * np.pi])
    scene.show(picture(robot.posture("Stand"), base, np.zeros(2)), ())
    contact = Contact(
        id=3,
        phase="update",
        kind="push",
        limb="left_arm",
        joint="LShoulderRoll",
        shown_by="LShoulderRoll",
        link="LBicep",
        direction=1,
        intensity_deg=2.0,
        torque=2.5,
        torque_std=0.5,
        force=(12.0, 0.0, -5.0),
        force_interval=(9.0, 19.5),
        point=(0.2, 0.1, 0.8),
        onset_time=0.0,
        detection_time=0.0,
        time=0.0,
    )
    arrows = dict(touch_arrows(contact, robot, scene.link_pose, centres_of(load_visuals(robot))))
    arrow, longer = arrows["touch 3"], arrows["touch 3 std"]
    # The base has turned to the left: its x axis is the y axis of the world.
    assert arrow.start == pytest.approx([0.5 - 0.1, -0.2 + 0.2, 0.8], abs=1e-9)
    assert (arrow.end - arrow.start) / FORCE_LENGTH == pytest.approx([0.0, 12.0, -5.0], abs=1e-9)
    assert longer.start == pytest.approx(arrow.end)
    assert np.linalg.norm(longer.end - arrow.start) == pytest.approx(19.5 * FORCE_LENGTH)
