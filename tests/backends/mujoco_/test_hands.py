"""Hands that grab: a spring to a point that moves, against its closed form; stable on every link."""

import mujoco
import numpy as np
import pytest

from pepper_driver.backends import Backend, CapabilityError, NotConnectedError
from pepper_driver.backends.mujoco_ import MujocoBackend
from pepper_driver.backends.mujoco_.pushes import HAND_MASS, first_overlap
from pepper_driver.backends.simulated import TrueContact
from pepper_driver.config import UnknownNameError
from pepper_driver.config.arrays import FloatArray
from support.contacts import CYCLE, FIXED, ROBOT, ROLLING, STEP, Robot
from support.pinocchio_robot import PinocchioRobot


def the_contact(robot: Robot) -> TrueContact:
    (contact,) = robot.truth.contacts
    return contact


def place(robot: Robot, link: str, point: FloatArray) -> FloatArray:
    """(3,) where a point of a link is in the world [m]."""
    pose = PinocchioRobot().link_pose(link, robot.truth.position)
    return np.asarray((pose @ [*point, 1.0])[:3])


@pytest.mark.parametrize("pull", [[0.05, 0.0, 0.0], [-0.04, 0.02, 0.03]])
def test_at_rest_the_force_is_stiffness_times_lag(pull: list[float]) -> None:
    robot, point = Robot(), np.array([0.02, 0.01, 0.03])
    anchor = place(robot, "l_wrist", point)
    robot.grab("l_wrist", np.array(pull), point, stiffness=1500.0, rise=0.4, hold=3.0)
    robot.run(2.4)
    contact = the_contact(robot)
    lag = anchor + pull - place(robot, "l_wrist", point)
    assert np.linalg.norm(lag) > 0.003, "the arm must resist, or there is nothing to see"
    np.testing.assert_allclose(contact.force, 1500.0 * lag, atol=0.02)
    assert (contact.kind, contact.link, contact.object) == ("hand", "l_wrist", None)
    jacobian = PinocchioRobot().point_jacobian("l_wrist", point, robot.truth.position)
    np.testing.assert_allclose(contact.torque, jacobian.T @ contact.force, atol=1e-4)


def test_a_fixed_link_gets_the_whole_profile() -> None:
    """On a link that cannot move the force is the hand's way and speed: minimum jerk, then hold, then a half cosine."""
    robot = Robot(FIXED)
    stiffness, rise, hold, release, pull = 1000.0, 0.5, 0.3, 0.2, 0.06
    robot.grab(
        "Tibia",
        np.array([pull, 0.0, 0.0]),
        stiffness=stiffness,
        rise=rise,
        hold=hold,
        release=release,
    )
    forces = []
    for _ in range(100):
        robot.run(CYCLE)
        forces.append(sum(c.force[0] for c in robot.truth.contacts))
    times = np.arange(round(1.2 / STEP)) * STEP
    t = np.clip(times / rise, 0.0, 1.0)
    way = pull * (10 * t**3 - 15 * t**4 + 6 * t**5)
    speed = pull * 30 * t**2 * (1 - t) ** 2 / rise
    damping = 2 * np.sqrt(stiffness * HAND_MASS) * np.clip(times / 0.1, 0.0, 1.0)
    faded = np.clip((times - rise - hold) / release, 0.0, 1.0)
    expected = (stiffness * way + damping * speed) * (0.5 + 0.5 * np.cos(np.pi * faded))
    np.testing.assert_allclose(forces, expected.reshape(100, -1).mean(axis=1), atol=1e-6)


def test_the_force_begins_from_nothing_and_ends_in_nothing() -> None:
    robot = Robot()
    # The arm is on its way when the hand closes.
    robot.push("LForeArm", np.array([0.0, 10.0, 0.0]), duration=0.4)
    robot.grab("l_wrist", np.array([0.05, 0.0, 0.0]), rise=0.3, hold=0.2, release=0.1, delay=0.1)
    sizes = []
    for _ in range(100):
        robot.run(CYCLE)
        sizes.append(sum(c.peak for c in robot.truth.contacts if c.kind == "hand"))
    started = np.flatnonzero(sizes)[0]
    assert started == int(0.1 / CYCLE)
    assert sizes[started] < 0.5, "no jump of force as the hand closes"
    assert np.abs(np.diff(sizes)).max() < 6.0, "nor later"
    assert max(sizes) > 10.0
    assert not any(sizes[int(0.7 / CYCLE) + 1 :]), "it has let go"


def test_a_hand_is_no_stronger_than_said() -> None:
    robot = Robot(FIXED)
    robot.grab("Tibia", np.array([0.3, 0.1, 0.0]), stiffness=2000.0)
    robot.grab("torso", np.array([0.0, -0.3, 0.0]), stiffness=2000.0, max_force=25.0)
    peaks = {"Tibia": 0.0, "torso": 0.0}
    for _ in range(100):
        robot.run(CYCLE)
        for contact in robot.truth.contacts:
            peaks[contact.link] = max(peaks[contact.link], contact.peak)
    assert peaks["Tibia"] == pytest.approx(100.0, rel=1e-12)
    assert peaks["torso"] == pytest.approx(25.0, rel=1e-12)


def test_a_pull_in_link_axes_is_turned_into_the_world() -> None:
    robot = Robot(FIXED)
    rotation = PinocchioRobot().link_pose("l_wrist", robot.truth.position)[:3, :3]
    pull = np.array([0.0, 0.0, 0.04])
    robot.grab("l_wrist", pull, frame="link", rise=0.05)
    robot.run(0.036)
    force = the_contact(robot).force
    direction = force / np.linalg.norm(force)
    np.testing.assert_allclose(direction, rotation @ [0.0, 0.0, 1.0], atol=0.05)


@pytest.mark.parametrize("base", [FIXED, ROLLING], ids=["fixed", "rolling"])
@pytest.mark.parametrize("link", ROBOT.links)
def test_the_stiffest_hand_is_steady_on_every_link(link: str, base: object) -> None:
    """Damping and stiffness are explicit in the step: too much of them on a light link would ring and blow up."""
    robot = Robot(base)  # type: ignore[arg-type]
    mj, data = robot.mujoco
    offset = mj.body_ipos[mj.body(link).id] + [0.0, 0.03, 0.03]
    robot.grab(link, np.array([0.01, 0.01, 0.01]), offset, stiffness=3000.0, rise=0.2, hold=1.0)
    robot.run(0.7)
    forces, speeds, twist = [], [], np.empty(6)
    for _ in range(20):
        robot.run(CYCLE)
        contact = the_contact(robot)
        forces.append(contact.force)
        mujoco.mj_objectVelocity(mj, data, mujoco.mjtObj.mjOBJ_XBODY, mj.body(link).id, twist, 0)
        speeds.append(np.abs(twist).max())
        assert contact.peak - np.linalg.norm(contact.force) < 0.3, "no ringing within a cycle"
    assert np.ptp(forces, axis=0).max() < 1.0
    assert max(speeds) < 0.05


def test_a_link_too_light_for_a_stiff_hand_is_refused() -> None:
    robot = Robot()
    far = np.array([0.0, 0.3, 0.0])
    with pytest.raises(ValueError, match="too light"):
        robot.grab("l_gripper", np.array([0.01, 0.0, 0.0]), far, stiffness=3000.0)


def test_one_link_is_held_by_one_hand_at_a_time() -> None:
    robot, pull = Robot(), np.array([0.01, 0.0, 0.0])
    robot.grab("l_wrist", pull, rise=0.5, hold=1.0, release=0.1)
    with pytest.raises(ValueError, match=r"already holds l_wrist"):
        robot.grab("l_wrist", pull, delay=1.5)
    robot.grab("r_wrist", pull)
    robot.grab("l_wrist", pull, delay=1.61)
    robot.run(3.4)
    assert not robot.truth.contacts
    robot.grab("l_wrist", pull)


@pytest.mark.parametrize(
    ("holds", "clash"),
    [
        ([], None),
        ([("a", 0.0, 1.0), ("a", 1.0, 2.0)], None),
        ([("a", 0.0, 1.0), ("b", 0.5, 2.0)], None),
        ([("a", 0.5, 2.0), ("a", 0.0, 1.0)], ("a", 0.5)),
        ([("a", 0.0, 9.0), ("b", 0.0, 1.0), ("a", 1.0, 2.0), ("b", 3.0, 4.0)], ("a", 1.0)),
        ([("a", 0.0, 9.0), ("a", 9.0, 9.5), ("a", 9.2, 9.3)], ("a", 9.2)),
    ],
)
def test_overlaps_are_found(
    holds: list[tuple[str, float, float]], clash: tuple[str, float] | None
) -> None:
    assert first_overlap(holds) == clash


@pytest.mark.parametrize(
    ("arguments", "error"),
    [
        ({"link": "LForearm"}, UnknownNameError),
        ({"pull": [0.0, np.nan, 0.0]}, ValueError),
        ({"pull": [0.0, 1.0]}, ValueError),
        ({"pull": [0.0, 1.5, 0.0]}, ValueError),
        ({"point": [0.0, 0.0]}, ValueError),
        ({"stiffness": 299.0}, ValueError),
        ({"stiffness": 3001.0}, ValueError),
        ({"stiffness": np.nan}, ValueError),
        ({"rise": 0.0}, ValueError),
        ({"hold": -1.0}, ValueError),
        ({"hold": np.inf}, ValueError),
        ({"release": 0.0}, ValueError),
        ({"max_force": 0.0}, ValueError),
        ({"delay": -0.1}, ValueError),
        ({"frame": "torso"}, UnknownNameError),
    ],
)
def test_a_wrong_grab_is_refused(arguments: dict[str, object], error: type[Exception]) -> None:
    backend = MujocoBackend(ROBOT, FIXED)
    backend.open()
    given = {"link": "LForeArm", "pull": [0.01, 0.0, 0.0], **arguments}
    with pytest.raises(error):
        backend.grab(**given)  # type: ignore[arg-type]


def test_only_an_open_simulation_grabs() -> None:
    class Real(MujocoBackend):
        schedule_grab = Backend.schedule_grab

    with pytest.raises(CapabilityError, match="grab"):
        Real(ROBOT, FIXED).grab("LForeArm", np.zeros(3))
    with pytest.raises(NotConnectedError):
        MujocoBackend(ROBOT, FIXED).grab("LForeArm", np.zeros(3))
    assert "grab" in MujocoBackend(ROBOT, FIXED).info.capabilities
