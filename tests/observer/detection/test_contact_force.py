"""Forces of contacts against closed forms, and their intervals against forces that are drawn."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from pepper_driver.config import load_robot
from pepper_driver.config.arrays import BoolArray, FloatArray
from pepper_driver.config.self_collision import load_self_collision
from pepper_driver.controller import RobotModel
from pepper_driver.observer.detection.contact_force import (
    COVERAGE,
    MIN_JOINTS,
    SIZES,
    ForceEstimator,
    fit_forces,
    lever_variance,
)
from pepper_driver.observer.residuals.torque_scale import TorqueScale
from pepper_driver.observer.scoring import JOINT_FRACTION

ROBOT = load_robot()
CAPSULES = load_self_collision(ROBOT)
MODEL = RobotModel(ROBOT)
N = len(ROBOT.joint_names)
ALL = np.ones(N, dtype=np.bool_)
BENT = ROBOT.posture("Stand").copy()
for _side, _sign in (("L", 1.0), ("R", -1.0)):
    for _joint, _angle in (
        ("ShoulderPitch", 0.9),
        ("ShoulderRoll", 0.3 * _sign),
        ("ElbowYaw", -0.8 * _sign),
        ("ElbowRoll", -0.9 * _sign),
        ("WristYaw", 0.0),
    ):
        BENT[ROBOT.joint_index(_side + _joint)] = _angle
DRAWS = 150
POINTS = {"LBicep": (0.12, 0.013, 0.0), "LForeArm": (0.08, 0.0, 0.0), "l_wrist": (0.07, 0.0, -0.01)}


def scale(std: float = 0.01, *, known: bool = True, blind: tuple[str, ...] = ()) -> TorqueScale:
    by_current = np.array([name not in blind for name in ROBOT.joint_names])
    return TorqueScale(
        stiffness=np.full(N, 80.0),
        std=np.full(N, std),
        known=np.full(N, known),
        by_current=by_current,
    )


def estimator(std: float = 0.01, **options: object) -> ForceEstimator:
    return ForceEstimator(ROBOT, CAPSULES, scale(std, **options))  # type: ignore[arg-type]


def torque_of(
    link: str, force: FloatArray, posture: FloatArray, point: FloatArray | None = None
) -> FloatArray:
    where = np.array(POINTS[link]) if point is None else point
    torque: FloatArray = MODEL.point_jacobian(link, where, posture).T @ force
    return torque


# -- closed forms -----------------------------------------------------------------------------------------------------


def planar(reaches: FloatArray) -> FloatArray:
    """(m, 2, 3) levers of two joints about z, at 0 and 0.3 m along x, for points on the x axis."""
    levers = np.zeros((len(reaches), 2, 3))
    levers[:, 0, 1] = reaches
    levers[:, 1, 1] = np.maximum(reaches - 0.3, 0.0)
    return levers


def test_two_joints_of_a_planar_arm_show_point_and_force_across_it() -> None:
    reaches = np.array([0.35, 0.4, 0.45, 0.5, 0.55])
    # 10 N across, 0.5 m from the first joint and 0.2 m from the second one.
    fits = fit_forces(
        planar(reaches), np.array([5.0, 2.0]), np.full(2, 1e-4), np.zeros((5, 2)), sizes=(10.0,)
    )
    assert int(fits.weight.argmax()) == 3
    assert fits.weight[3] > 0.99
    # Of a force along the arm, or along the axes, nothing is known but its size: 10 N / sqrt(3) in each direction.
    assert fits.mean[3] == pytest.approx([0.0, 10.0, 0.0], abs=0.02)
    expected = [100.0 / 3.0, 1e-4 / (0.5**2 + 0.2**2), 100.0 / 3.0]
    assert fits.covariance[3].diagonal() == pytest.approx(expected, rel=1e-3)


def test_the_evidence_of_a_size_is_that_of_a_normal_distribution() -> None:
    levers, torque = planar(np.array([0.4])), np.array([3.0, 0.9])
    variance, sizes = np.array([0.04, 0.01]), (4.0, 16.0)
    fits = fit_forces(levers, torque, variance, np.zeros((1, 2)), sizes=sizes)
    likelihood = []
    for size in sizes:
        covariance = levers[0] @ levers[0].T * size**2 / 3.0 + np.diag(variance)
        exponent = -0.5 * torque @ np.linalg.solve(covariance, torque)
        likelihood.append(np.exp(exponent) / np.sqrt(np.linalg.det(covariance)))
    assert fits.weight == pytest.approx(np.array(likelihood) / sum(likelihood), rel=1e-9)


def test_the_surface_of_a_link_makes_its_joints_less_sure() -> None:
    levers, torque = planar(np.array([0.4])), np.array([4.0, 1.0])
    on_axis, around = (
        fit_forces(levers, torque, np.full(2, 1e-4), np.full((1, 2), lever**2), sizes=(10.0,))
        for lever in (0.0, 0.02)
    )
    assert around.covariance[0, 1, 1] > 10.0 * on_axis.covariance[0, 1, 1]


def test_levers_to_a_surface_vary_as_those_of_drawn_forces() -> None:
    """About the axis of a cylinder a force on its surface has more lever than about one across it."""
    random = np.random.default_rng(8)
    draws, radius = 200_000, 0.045
    along = np.array([1.0, 0.0, 0.0])
    force = random.standard_normal((draws, 3)) / np.sqrt(3.0)  # rms of its size: 1 N
    angle = random.uniform(0.0, 2.0 * np.pi, draws)
    cylinder = radius * np.stack([np.zeros(draws), np.cos(angle), np.sin(angle)], axis=1)
    ball = random.standard_normal((draws, 3))
    ball *= radius / np.linalg.norm(ball, axis=1)[:, None]
    axes = np.stack([along, [0.0, 0.0, 1.0], [0.6, 0.8, 0.0], np.zeros(3)], axis=1)
    shapes = np.array([0.5 * (np.eye(3) - np.outer(along, along)), np.eye(3) / 3.0])
    variance = lever_variance(radius**2 * shapes, axes)
    for found, places in zip(variance, (cylinder, ball), strict=True):
        torque = np.cross(places, force) @ axes
        assert found[:3] == pytest.approx(torque.var(axis=0)[:3], rel=0.02)
        assert found[3] == 0.0
    assert variance[0, 0] == pytest.approx(2.0 * variance[0, 1])


# -- the robot --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("link", ["LForeArm", "l_wrist"])
@pytest.mark.parametrize("size", [6.0, 20.0])
def test_a_force_that_all_joints_show_is_found(link: str, size: float) -> None:
    # Across the link, not along it: no joint shows a force through its axis.
    across = MODEL.link_pose(link, BENT)[:3, :3] @ np.array([0.1, 0.8, -0.6])
    force = size * across / np.linalg.norm(across)
    found = estimator().estimate(
        "left_arm", torque_of(link, force, BENT), np.full(N, 0.03), ALL, BENT
    )
    assert found is not None
    assert found.interval[0] < size < found.interval[1]
    assert np.linalg.norm(found.vector) == pytest.approx(size, rel=0.25)
    cosine = found.vector @ force / np.linalg.norm(found.vector) / size
    assert cosine > 0.9
    pose = MODEL.link_pose(link, BENT)
    place = pose[:3, :3] @ np.array(POINTS[link]) + pose[:3, 3]
    assert np.linalg.norm(found.point - place) < 0.06
    assert found.scale_known


def test_two_joints_do_not_show_where_the_upper_arm_is_touched() -> None:
    """The elbow has no torque: a small force far from the shoulder turns it as a large one near it."""
    across = MODEL.link_pose("LBicep", BENT)[:3, :3] @ np.array([0.0, 0.0, -20.0])
    torque = torque_of("LBicep", across, BENT)
    found = estimator().estimate("left_arm", torque, np.full(N, 0.03), ALL, BENT)
    assert found is not None
    low, high = found.interval
    assert low < 20.0 < high
    assert high > 2.0 * low


def test_the_other_arm_shows_the_mirror_image() -> None:
    force, mirror = np.array([8.0, 3.0, -6.0]), np.array([1.0, -1.0, 1.0])
    left = torque_of("l_wrist", force, BENT)
    right = torque_of(
        "r_wrist", mirror * force, BENT, np.array(POINTS["l_wrist"]) * (1.0, -1.0, 1.0)
    )
    one, other = (
        estimator().estimate(limb, torque, np.full(N, 0.1), ALL, BENT)
        for limb, torque in (("left_arm", left), ("right_arm", right))
    )
    assert one is not None
    assert other is not None
    assert other.vector * mirror == pytest.approx(one.vector, rel=0.05, abs=0.3)
    assert other.point * mirror == pytest.approx(one.point, abs=0.01)
    assert other.interval == pytest.approx(one.interval, rel=0.05)


def test_the_head_has_a_force_too_and_its_size_is_less_certain() -> None:
    force = np.array([-15.0, 0.0, 0.0])
    torque = torque_of("Head", force, BENT, np.array([0.005, 0.0, 0.118]))
    head = estimator().estimate("head", torque, np.full(N, 0.1), ALL, BENT)
    arm = estimator().estimate(
        "left_arm", torque_of("l_wrist", force, BENT), np.full(N, 0.1), ALL, BENT
    )
    assert head is not None
    assert arm is not None
    assert head.interval[0] < 15.0 < head.interval[1]
    assert head.interval[1] / head.interval[0] > arm.interval[1] / arm.interval[0]


# -- honesty ----------------------------------------------------------------------------------------------------------


def drawn(
    random: np.random.Generator, torque_std: FloatArray, scale_std: float
) -> tuple[FloatArray, FloatArray, FloatArray, float, FloatArray]:
    """Return posture, torque, true force, its size and its place of one touch, as the estimator assumes it."""
    middle, half = 0.5 * (ROBOT.lower + ROBOT.upper), 0.35 * (ROBOT.upper - ROBOT.lower)
    posture = middle + half * random.uniform(-1.0, 1.0, N)
    link = str(random.choice(list(POINTS)))
    (capsule,) = CAPSULES.capsules[link]
    start, end = np.array(capsule.start), np.array(capsule.end)
    point = start + random.uniform() * (end - start)
    force = random.choice(SIZES) / np.sqrt(3.0) * random.standard_normal(3)
    pose = MODEL.link_pose(link, posture)
    place = pose[:3, :3] @ point + pose[:3, 3]
    # On the surface, on any side.
    outward = np.cross(end - start, random.standard_normal(3))
    outward *= capsule.radius / np.linalg.norm(outward)
    torque = torque_of(link, force, posture, point + outward)
    factors = np.exp(scale_std * random.standard_normal(N))
    torque = torque * factors + torque_std * random.standard_normal(N)
    return posture, torque, force, float(np.linalg.norm(force)), place


@pytest.mark.parametrize("scale_std", [0.02, 0.15])
def test_interval_and_point_hold_the_truth_as_often_as_they_say(scale_std: float) -> None:
    random = np.random.default_rng(5)
    target, std = estimator(scale_std), np.full(N, 0.3)
    held, placed, ratios = [], [], []
    for _ in range(DRAWS):
        posture, torque, _, size, place = drawn(random, std, scale_std)
        found = target.estimate("left_arm", torque, std, ALL, posture)
        assert found is not None
        low, high = found.interval
        held.append(low <= size <= high)
        off = found.point - place
        placed.append(off @ np.linalg.solve(found.point_covariance, off) < 6.25)
        ratios.append(high / low)
    # Three standard deviations of a fraction of DRAWS.
    assert np.mean(held) == pytest.approx(COVERAGE, abs=0.073)
    assert np.mean(placed) > 0.83  # 6.25: 0.9 of a normal distribution in space
    assert np.median(ratios) < 25.0  # SIZES alone are from 0.8 to 45 N


def test_an_unknown_scale_widens_the_interval_and_is_said() -> None:
    torque = torque_of("l_wrist", np.array([0.0, 14.0, -14.0]), BENT)
    known, unknown = (
        target.estimate("left_arm", torque, np.full(N, 0.05), ALL, BENT)
        for target in (estimator(0.02), estimator(0.3, known=False))
    )
    assert known is not None
    assert unknown is not None
    assert not unknown.scale_known
    assert unknown.interval[1] / unknown.interval[0] > known.interval[1] / known.interval[0]
    assert np.trace(unknown.covariance) > np.trace(known.covariance)


@pytest.mark.parametrize(
    ("joint", "is_known"), [("LShoulderRoll", False), ("LElbowYaw", False), ("LWristYaw", True)]
)
def test_one_joint_without_a_weight_makes_the_scale_unknown_but_not_the_wrist(
    joint: str, is_known: bool
) -> None:
    known = np.full(N, True)
    known[ROBOT.joint_index(joint)] = False
    target = ForceEstimator(ROBOT, CAPSULES, replace(scale(), known=known))
    torque = torque_of("l_wrist", np.array([0.0, 10.0, 0.0]), BENT)
    found = target.estimate("left_arm", torque, np.full(N, 0.1), ALL, BENT)
    assert found is not None
    assert found.scale_known is is_known


def test_a_wrist_shows_whether_hand_or_forearm_is_touched_whatever_shows_its_torque() -> None:
    """A hand pushed 3 cm beside its axis turns the wrist; the same torques without that are of a forearm."""
    target = estimator(blind=("LWristYaw",))
    axes = MODEL.link_pose("l_wrist", BENT)[:3, :3]
    torque = torque_of(
        "l_wrist", axes @ np.array([0.0, 0.0, -15.0]), BENT, np.array([0.03, 0.03, 0.0])
    )
    wrist = ROBOT.joint_index("LWristYaw")
    assert abs(torque[wrist]) > 0.3
    none = torque.copy()
    none[wrist] = 0.0
    std = np.full(N, 0.3)
    std[wrist] = 0.03
    hand, forearm = (target.estimate("left_arm", one, std, ALL, BENT) for one in (torque, none))
    assert hand is not None
    assert forearm is not None
    start = MODEL.link_pose("LForeArm", BENT)[:3, 3]
    assert np.linalg.norm(hand.point - start) > np.linalg.norm(forearm.point - start) + 0.03
    assert np.linalg.norm(forearm.vector) > np.linalg.norm(hand.vector)


# -- what is not there ------------------------------------------------------------------------------------------------


def without(*names: str) -> BoolArray:
    usable = ALL.copy()
    usable[[ROBOT.joint_index(name) for name in names]] = False
    return usable


ARM = ("LShoulderPitch", "LShoulderRoll", "LElbowYaw", "LElbowRoll", "LWristYaw")


def test_a_joint_that_cannot_be_judged_does_not_count() -> None:
    force = np.array([0.0, 12.0, -9.0])
    torque = torque_of("l_wrist", force, BENT)
    std = np.full(N, 0.1)
    wrong = torque.copy()
    wrong[ROBOT.joint_index("LElbowYaw")] = 40.0
    blind = torque.copy()
    blind[ROBOT.joint_index("LElbowYaw")] = np.nan
    found = [
        estimator().estimate("left_arm", wrong, std, without("LElbowYaw"), BENT),
        estimator().estimate("left_arm", blind, std, ALL, BENT),
        estimator(blind=("LElbowYaw",)).estimate("left_arm", wrong, std, ALL, BENT),
    ]
    for one in found:
        assert one is not None
        assert one.interval[0] < 15.0 < one.interval[1]
    assert len({one.interval for one in found if one is not None}) == 1


def test_too_few_joints_have_no_force() -> None:
    torque, std = torque_of("l_wrist", np.array([0.0, 12.0, 0.0]), BENT), np.full(N, 0.1)
    enough, few = without(*ARM[MIN_JOINTS:]), without(*ARM[MIN_JOINTS - 1 :])
    assert estimator().estimate("left_arm", torque, std, enough, BENT) is not None
    assert estimator().estimate("left_arm", torque, std, few, BENT) is None


def test_a_wrist_alone_makes_no_force_and_other_joints_need_a_current() -> None:
    torque, std = torque_of("l_wrist", np.array([0.0, 12.0, 0.0]), BENT), np.full(N, 0.1)
    elbow = without(*ARM[:3])
    assert estimator().estimate("left_arm", torque, std, elbow, BENT) is not None
    assert estimator(blind=("LWristYaw",)).estimate("left_arm", torque, std, elbow, BENT) is None
    push = torque_of("Head", np.array([-15.0, 0.0, 0.0]), BENT, np.array([0.005, 0.0, 0.118]))
    assert estimator(blind=("HeadPitch",)).estimate("head", push, std, ALL, BENT) is None


def test_an_unknown_wrist_leaves_the_other_joints_their_force() -> None:
    torque, std = torque_of("l_wrist", np.array([0.0, 12.0, -9.0]), BENT), np.full(N, 0.1)
    unknown = torque.copy()
    unknown[ROBOT.joint_index("LWristYaw")] = np.nan
    found = estimator().estimate("left_arm", unknown, std, ALL, BENT)
    expected = estimator().estimate("left_arm", torque, std, without("LWristYaw"), BENT)
    assert found is not None
    assert expected is not None
    assert found.vector == pytest.approx(expected.vector)


def test_an_unknown_posture_has_no_force() -> None:
    posture = BENT.copy()
    posture[0] = np.nan
    torque = torque_of("l_wrist", np.array([0.0, 12.0, 0.0]), BENT)
    assert estimator().estimate("left_arm", torque, np.full(N, 0.1), ALL, posture) is None


@pytest.mark.parametrize("std", [0.0, 1e-300, 1e-6, 1e3, 1e100])
@pytest.mark.parametrize("size", [0.0, 1e-12, 5.0, 1e6, 1e12])
def test_torques_of_any_size_give_finite_numbers(size: float, std: float) -> None:
    random = np.random.default_rng(3)
    for limb in ("left_arm", "right_arm", "head"):
        torque = size * random.standard_normal(N)
        found = estimator(0.15).estimate(limb, torque, np.full(N, std), ALL, BENT)
        assert found is not None
        values = (found.vector, found.covariance, found.point, found.point_covariance)
        assert all(np.isfinite(value).all() for value in values)
        assert 0.0 <= found.interval[0] <= found.interval[1] < np.inf


def test_no_torque_is_a_small_force_with_a_finite_interval() -> None:
    found = estimator().estimate("left_arm", np.zeros(N), np.full(N, 0.2), ALL, BENT)
    assert found is not None
    assert 0.0 <= found.interval[0] <= np.linalg.norm(found.vector) + 1e-9 or not found.vector.any()
    assert np.isfinite(found.interval).all()
    assert found.interval[1] < 40.0


@pytest.mark.parametrize("way", [(0.1, 0.8, -0.6), (0.0, -1.0, 0.1), (0.3, 0.2, 1.0)])
def test_the_joint_with_the_largest_torque_is_named_where_friction_hides_it(
    way: tuple[float, float, float],
) -> None:
    force = 15.0 * np.array(way) / np.linalg.norm(way)
    torque = torque_of("l_wrist", force, BENT)
    arm = [ROBOT.joint_index(name) for name in ROBOT.limbs["left_arm"]]
    largest = max(arm, key=lambda joint: abs(torque[joint]))
    # The joint itself shows nothing: its torque is hidden. The others show theirs.
    shown, std = torque.copy(), np.full(N, 0.05)
    shown[largest], std[largest] = 0.0, 3.0
    found = estimator().estimate("left_arm", shown, std, ALL, BENT)
    assert found is not None
    joint = found.largest()
    assert joint is not None
    assert abs(torque[joint]) >= JOINT_FRACTION * abs(torque[largest])
    fitted, fitted_std = found.torques[joint]
    assert fitted * torque[joint] > 0.0
    assert abs(fitted - torque[joint]) < 2.0 * fitted_std


@pytest.mark.parametrize("joint", ["LShoulderRoll", "LElbowYaw"])
def test_torques_that_no_force_explains_are_less_certain_than_they_seem(joint: str) -> None:
    """One of them has the wrong sign: the size of the force is then known less well than without it."""
    torque = torque_of("l_wrist", np.array([0.0, -60.0, 6.0]), BENT)
    wrong = torque.copy()
    wrong[ROBOT.joint_index(joint)] *= -1.0
    spread = []
    for given, usable in ((torque, without(joint)), (wrong, ALL)):
        found = estimator().estimate("left_arm", given, np.full(N, 0.03), usable, BENT)
        assert found is not None
        spread.append(found.interval[1] / found.interval[0])
    assert spread[1] > spread[0]


def test_of_torques_that_no_force_explains_the_largest_names_the_joint() -> None:
    elbow = ROBOT.joint_index("LElbowRoll")
    torque = np.zeros(N)
    torque[elbow] = -5.0
    found = estimator().estimate("left_arm", torque, np.full(N, 0.03), ALL, BENT)
    assert found is not None
    assert found.largest() == elbow
    assert found.torques[elbow] == (-5.0, 0.03)
