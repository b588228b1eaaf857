"""The truth of contacts: what acted, where, how hard, and what it did to the joints; saved and resumed to the bit."""

from collections.abc import Callable

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from pepper_driver.backends.fields import Measurement
from pepper_driver.backends.mujoco_ import MujocoBackend
from pepper_driver.backends.simulated import TrueContact
from pepper_driver.config import UnknownNameError, load_plant, load_world
from pepper_driver.config.arrays import FloatArray
from support.contacts import CYCLE, FIXED, ROBOT, ROLLING, STEP, Robot, world
from support.pinocchio_robot import PinocchioRobot


def only(robot: MujocoBackend) -> TrueContact:
    (contact,) = robot.truth.contacts
    return contact


def expected_torque(
    robot: MujocoBackend, link: str, point: FloatArray, force: FloatArray
) -> FloatArray:
    """(17,) J^T f by Pinocchio; the base stands at the origin."""
    jacobian = PinocchioRobot().point_jacobian(link, point, robot.truth.position)
    return np.asarray(jacobian.T @ force)


def test_a_push_is_reported_with_place_force_and_torque() -> None:
    robot = Robot()
    force, point = np.array([3.0, 5.0, -2.0]), np.array([0.02, 0.01, 0.03])
    robot.push("l_wrist", force, point, 2.0)
    robot.run(1.0)
    contact = only(robot)
    assert (contact.kind, contact.link, contact.object) == ("push", "l_wrist", None)
    np.testing.assert_allclose(contact.force, force, rtol=1e-12)
    assert contact.peak == pytest.approx(float(np.linalg.norm(force)))
    pose = PinocchioRobot().link_pose("l_wrist", robot.truth.position)
    np.testing.assert_allclose(contact.point, (pose @ [*point, 1.0])[:3], atol=1e-5)
    expected = expected_torque(robot, "l_wrist", point, force)
    np.testing.assert_allclose(contact.torque, expected, atol=1e-4)
    np.testing.assert_allclose(robot.truth.peak_torque, np.abs(expected), atol=1e-4)


def test_the_torque_of_several_contacts_is_their_sum() -> None:
    robot = Robot()
    robot.push("Head", np.array([5.0, 0.0, 0.0]), duration=2.0)
    robot.push("LForeArm", np.array([0.0, 4.0, 0.0]), duration=2.0)
    robot.grab("r_wrist", np.array([0.03, 0.0, 0.0]))
    robot.run(1.0)
    contacts = robot.truth.contacts
    assert [c.link for c in contacts] == ["Head", "LForeArm", "r_wrist"]
    total = contacts[0].torque + contacts[1].torque + contacts[2].torque
    np.testing.assert_array_equal(robot.truth.contact_torque, total)
    assert np.abs(total[[3, 4]]).max() > 0.1, "it acts on the head's joints"


def test_peak_and_mean_differ_in_the_cycle_in_which_a_push_rises() -> None:
    robot = Robot()
    robot.push("LBicep", np.array([0.0, 10.0, 0.0]), np.array([0.16, 0, 0]), 1.0)
    robot.run(CYCLE)
    roll = ROBOT.joint_index("LShoulderRoll")
    truth = robot.truth
    # Half a cosine over 0.1 s, at the states before each of the steps.
    fractions = 0.5 - 0.5 * np.cos(np.pi * np.arange(0.0, CYCLE - 1e-9, STEP) / 0.1)
    assert only(robot).peak == pytest.approx(10.0 * fractions[-1], rel=1e-6)
    ratio = abs(truth.peak_torque[roll] / truth.contact_torque[roll])
    assert ratio == pytest.approx(fractions[-1] / fractions.mean(), rel=1e-3)


@pytest.mark.parametrize(("rise", "expected"), [(0.04, 0.04), (0.2, 0.2), (0.5, 1 / 3)])
def test_a_push_rises_and_falls_as_requested(rise: float, expected: float) -> None:
    robot = Robot()
    robot.push("LBicep", np.array([0.0, 10.0, 0.0]), np.array([0.16, 0, 0]), 1.0, rise=rise)
    sizes = []
    for _ in range(84):
        robot.run(CYCLE)
        contacts = robot.truth.contacts
        sizes.append(contacts[0].peak if contacts else 0.0)
    # The peak of a cycle is that of its last step while the push rises.
    time = np.arange(1, 84) * CYCLE - STEP
    rising = time < expected
    fractions = 0.5 - 0.5 * np.cos(np.pi * time[rising] / expected)
    np.testing.assert_allclose(np.array(sizes)[:83][rising], 10.0 * fractions, atol=1e-6)
    full = (time > expected) & (time < 1.0 - expected)
    np.testing.assert_allclose(np.array(sizes)[:83][full], 10.0)
    assert sizes[82] < 10.0 * (0.5 - 0.5 * np.cos(np.pi * 0.02 / expected)) + 1e-6


@pytest.mark.parametrize("release", [0.1, 0.0999])
def test_after_the_last_contact_the_truth_is_empty(release: float) -> None:
    """Also where the last force is that of the last step of a cycle: 0.3 s are 25 cycles."""
    robot = Robot()
    robot.push("Head", np.array([5.0, 0.0, 0.0]), duration=0.2 + release)
    robot.grab("l_wrist", np.array([0.05, 0.0, 0.0]), rise=0.1, hold=0.1, release=release)
    robot.run(0.2)
    assert robot.truth.contacts
    robot.run(0.2)
    assert robot.truth.contacts == ()
    assert not robot.truth.contact_torque.any()
    assert not robot.truth.peak_torque.any()
    assert not robot.mujoco[1].qfrc_applied.any()


def test_a_push_to_come_does_not_change_a_bit_before_it_begins() -> None:
    free, waiting = Robot(), Robot()
    waiting.push("Head", np.array([5.0, 0.0, 0.0]), delay=0.5)
    assert [m.position.tobytes() for m in free.run(0.48)] == [
        m.position.tobytes() for m in waiting.run(0.48)
    ]


def pushed() -> Robot:
    robot = Robot(ROLLING)
    robot.push("LForeArm", np.array([0.0, 8.0, 0.0]), duration=0.6, frame="link")
    robot.push("Head", np.array([8.0, 0.0, 0.0]), duration=0.4, delay=0.35)
    robot.run(0.3)
    return robot


def grabbed() -> Robot:
    robot = Robot(ROLLING)
    robot.grab("l_wrist", np.array([0.05, 0.02, 0.0]), frame="link", rise=0.3, hold=0.3)
    robot.grab("Head", np.array([0.05, 0.0, 0.0]), delay=0.4)
    robot.run(0.2)
    return robot


def before_the_throw() -> Robot:
    robot = Robot(ROLLING, load_world("ball"))
    robot.run(0.9)
    return robot


def in_flight() -> Robot:
    robot = Robot(ROLLING, load_world("ball"))
    robot.run(1.15)
    return robot


def in_touch() -> Robot:
    robot = Robot(
        ROLLING,
        world(
            ball={
                "shape": "sphere",
                "size": [0.1],
                "mass": 2.0,
                "position": [0.1, 0.0, 1.32],
            }
        ),
    )
    return robot


def bits(robot: Robot, m: Measurement | None = None) -> bytes:
    """All that is measured and true now."""
    t = robot.truth
    parts = [t.contact_torque, t.peak_torque, t.base, t.tilt, t.wheel_load, t.position]
    parts += [v for c in t.contacts for v in (c.point, c.force, c.torque)]
    parts += [robot.mujoco[1].qpos, robot.mujoco[1].qvel]
    if m is not None:
        parts += [m.position, m.current, m.touch, m.bumpers, m.buttons, m.imu.acceleration]
    return b"".join(part.tobytes() for part in parts)


@pytest.mark.parametrize("start", [pushed, grabbed, before_the_throw, in_flight, in_touch])
def test_a_saved_state_goes_on_to_the_bit(start: Callable[[], Robot]) -> None:
    robot = start()
    saved, seen = robot.snapshot(), bits(robot)
    first = [bits(robot, m) for m in robot.run_slowly(30)]
    robot.run(0.1)
    fresh = Robot(ROLLING, robot.world)
    for other in (robot, fresh):
        other.restore(saved)
        assert bits(other) == seen
        assert [bits(other, m) for m in other.run_slowly(30)] == first


def test_a_snapshot_of_another_world_is_refused() -> None:
    saved = Robot(FIXED).snapshot()
    with pytest.raises(Exception, match="world"):
        Robot(FIXED, load_world("ball")).restore(saved)


def test_a_fixed_base_neither_moves_nor_falls() -> None:
    robot = Robot(FIXED)
    truth = robot.truth
    for value, size in ((truth.base, 3), (truth.tilt, 2), (truth.wheel_load, 3)):
        np.testing.assert_array_equal(value, np.zeros(size))
    assert not truth.fallen


def test_the_truth_has_the_place_of_the_base_and_its_fall() -> None:
    robot = Robot(ROLLING)
    weight = 9.81 * 28.68
    assert robot.truth.wheel_load.sum() == pytest.approx(weight, rel=0.01)
    robot.push("torso", np.array([150.0, 0.0, 0.0]), duration=1.5)
    robot.run(0.24)
    assert robot.truth.tilt[0] > 0.1, "pushed forward at the chest it tips forward: pitch grows"
    assert not robot.truth.fallen
    robot.run(1.0)
    assert robot.truth.fallen
    assert robot.truth.base[0] > 0.1


def test_the_truth_has_the_places_of_links_on_a_base_that_rolls_and_tilts() -> None:
    robot = Robot(ROLLING)
    robot.push("torso", np.array([40.0, 20.0, 0.0]), duration=0.5)
    robot.run(0.4)
    truth = robot.truth
    (x, y, yaw), (pitch, roll) = truth.base, truth.tilt
    assert abs(pitch) > 1e-3
    base = np.eye(4)
    base[:2, 3] = x, y
    base[:3, :3] = (
        Rotation.from_euler("z", yaw)
        * Rotation.from_euler("y", pitch)
        * Rotation.from_euler("x", roll)
    ).as_matrix()
    model = PinocchioRobot()
    for link in ("Head", "l_wrist"):
        expected = base @ model.link_pose(link, truth.position)
        np.testing.assert_allclose(truth.link_pose(link)[:3, :3], expected[:3, :3], atol=2e-3)
        np.testing.assert_allclose(truth.link_pose(link)[:2, 3], expected[:2, 3], atol=1e-3)
        # It tips over its wheels, which lifts base_link.
        assert abs(truth.link_pose(link)[2, 3] - expected[2, 3]) < 0.02
    with pytest.raises(UnknownNameError, match="l_wrist"):
        truth.link_pose("l_wirst")


def test_asking_where_a_link_is_changes_nothing() -> None:
    asked, other = Robot(ROLLING), Robot(ROLLING)
    for robot in (asked, other):
        robot.push("torso", np.array([10.0, 5.0, 0.0]), duration=0.5)
    for _ in range(10):
        asked.run(0.024)
        other.run(0.024)
        asked.truth.link_pose("Head")
        np.testing.assert_array_equal(asked.truth.position, other.truth.position)
        np.testing.assert_array_equal(asked.truth.base, other.truth.base)


def test_the_identity_is_that_of_the_plant_alone() -> None:
    plant = load_plant("nominal", ROBOT)
    identities = {
        MujocoBackend(ROBOT, plant, world=load_world(name)).info.identity
        for name in ("empty", "table", "ball")
    }
    assert len(identities) == 1
