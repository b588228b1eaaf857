"""Capsules' distances by brute force, rows by braking for real, and robots that are pulled into themselves."""

from __future__ import annotations

from dataclasses import replace
from importlib.util import module_from_spec, spec_from_file_location
from math import inf
from typing import Any

import coal
import numpy as np
import pinocchio as pin
import pytest
from scipy.optimize import minimize

from pepper_driver.config import Capsule
from pepper_driver.config.arrays import FloatArray
from pepper_driver.controller import PositionTask, RobotModel, WholeBodyController
from pepper_driver.controller.collision import CapsuleDistances
from pepper_driver.controller.constraints import BrakingLimits, SelfCollision
from pepper_driver.controller.constraints.braking import BrakingPath
from pepper_driver.controller.model import BodyFrame
from support import ROOT
from support.controller import DT, ROBOT, FixedRows, random_posture
from support.self_collision import SECURITY, SETTINGS, Ruler, braked, limits


def bare_controller() -> WholeBodyController:
    """One that has nothing but its box."""
    control = WholeBodyController(ROBOT)
    for part in control.constraints:
        control.remove(part)
    return control


def segment_distance(one: FloatArray, other: FloatArray) -> float:
    """Least distance of two lines between (2, 3) points each, searched for."""

    def squared(fraction: FloatArray) -> float:
        gap = (
            one[0]
            + fraction[0] * (one[1] - one[0])
            - other[0]
            - fraction[1] * (other[1] - other[0])
        )
        return float(gap @ gap)

    starts = [(a, b) for a in (0.1, 0.9) for b in (0.1, 0.9)]
    bounds = [(0, 1), (0, 1)]
    return min(float(np.sqrt(minimize(squared, s, bounds=bounds, tol=1e-14).fun)) for s in starts)


# -- geometry ---------------------------------------------------------------------------------------------------


def test_distances_and_normals_are_those_of_coal() -> None:
    """Also where axes are parallel and many pairs of points are nearest: at 0 of all joints, and mirrored."""
    random, ruler = np.random.default_rng(9), Ruler()
    model = ruler.model
    for number in range(60):
        position = np.zeros(17) if number == 0 else random_posture(random)
        position[random.integers(0, 17, number % 17)] = 0.0
        q = model.with_base_pose(model.configuration(position), random.uniform(-2, 2, 3))
        distances, wrenches = ruler(q), ruler.capsules.wrenches(range(len(ruler.capsules.names)))
        pin.forwardKinematics(model.pin, model.data, q)
        placed = {
            link: [
                (coal_capsule(capsule), model.pose(capsule_frame(model, link, capsule)))
                for capsule in capsules
            ]
            for link, capsules in SETTINGS.capsules.items()
        }
        pairs = [(a, b) for one, two in SETTINGS.pairs for a in placed[one] for b in placed[two]]
        request, result = coal.DistanceRequest(True, True), coal.DistanceResult()
        for n, ((first, here), (second, there)) in enumerate(pairs):
            result.clear()
            places = [coal.Transform3s(at.rotation, at.translation) for at in (here, there)]
            coal.distance(first, places[0], second, places[1], request, result)
            moment = np.cross(result.getNearestPoint1(), result.normal)
            np.testing.assert_allclose(distances[n], result.min_distance, atol=1e-12)
            expected = np.concatenate([result.normal, moment])
            np.testing.assert_allclose(wrenches[n], expected, atol=1e-9)
        for margin in (0.0, 0.01, 0.06):
            assert ruler.capsules.any_near(margin) == (distances.min() <= margin)


def coal_capsule(capsule: Capsule) -> Any:
    length = float(np.linalg.norm(np.subtract(capsule.end, capsule.start)))
    return coal.Capsule(capsule.radius, length)


def capsule_frame(model: RobotModel, link: str, capsule: Capsule) -> BodyFrame:
    """Frame in the middle of a capsule, with the third axis along it."""
    along = np.subtract(capsule.end, capsule.start)
    axis = along if along.any() else np.array([0.0, 0.0, 1.0])
    turn = pin.Quaternion.FromTwoVectors(np.array([0.0, 0.0, 1.0]), axis).matrix()
    return model.body_frame(link, np.add(capsule.start, capsule.end) / 2, turn)


def test_axes_that_meet_give_no_direction() -> None:
    """Two equal capsules on one link: nothing can be said, and nothing is not a number."""
    same = Capsule(start=(0.0, 0.0, 0.0), end=(0.1, 0.0, 0.0), radius=0.05)
    parts: dict[str, tuple[Capsule, ...]] = {
        "LForeArm": (same,),
        "l_wrist": (same,),
        "LBicep": (same,),
    }
    settings = replace(SETTINGS, capsules=parts, pairs=(("LForeArm", "LForeArm"),))
    capsules = CapsuleDistances(RobotModel(ROBOT), settings)
    capsules.place(RobotModel(ROBOT).configuration(np.zeros(17)))
    assert capsules.distances().tolist() == [-0.1]
    assert not capsules.wrenches([0]).any()


def test_distances_are_those_of_the_axes_minus_the_radii() -> None:
    random, ruler = np.random.default_rng(0), Ruler()
    overlapping = 0
    folded = ROBOT.posture("StandInit")
    folded[[6, 7, 8]] = 0.01, 0.3, -1.0  # a hand in the belly
    for position in (folded, *[random_posture(random) for _ in range(3)]):
        found = ruler(ruler.model.configuration(position))
        poses = {link: ruler.model.link_pose(link, position) for link in SETTINGS.capsules}
        expected = []
        for pair in SETTINGS.pairs:
            for one in SETTINGS.capsules[pair[0]]:
                for other in SETTINGS.capsules[pair[1]]:
                    lines = [
                        np.array([(poses[link] @ [*end, 1.0])[:3] for end in (c.start, c.end)])
                        for link, c in zip(pair, (one, other), strict=True)
                    ]
                    expected.append(segment_distance(*lines) - one.radius - other.radius)
        np.testing.assert_allclose(found, expected, atol=1e-6)
        overlapping += sum(value < 0 for value in expected)
    assert overlapping > 0


def test_wrenches_give_the_gradient_of_the_distances() -> None:
    random, ruler = np.random.default_rng(1), Ruler()
    nv = ruler.model.nv
    for _ in range(10):
        q = ruler.model.configuration(random_posture(random))
        change = random.normal(size=nv) * 1e-6
        numeric = (
            ruler(ruler.model.integrate(q, change)) - ruler(ruler.model.integrate(q, -change))
        ) / 2
        before = ruler(q)
        every = list(range(len(before)))
        gradient = ruler.capsules.wrenches(every) @ ruler.model.data.J * ruler.capsules.signs
        np.testing.assert_allclose(gradient @ change, numeric, atol=2e-11)
        assert (np.abs(gradient) <= ruler.capsules.levers + 1e-9).all()


@pytest.mark.parametrize("cycles", [1.0, 3.0, inf])
def test_points_of_the_path_to_rest_are_where_braking_leads(cycles: float) -> None:
    random, model = np.random.default_rng(2), RobotModel(ROBOT)
    brake = 0.9 * limits(model)
    path = BrakingPath(model.nv, cycles)
    for _ in range(20):
        v = random.uniform(-2, 2, model.nv)
        a = random.uniform(-1, 1, model.nv) * brake
        v[:3] = a[:3] = 0.0  # the base would brake for long
        path.update(v, brake, DT)
        q = model.configuration(np.zeros(17))
        after = braked(q, v, a, brake)[-1 if cycles == inf else int(cycles)]
        displacement = (after - q)[4:]
        # Off by the last, partial cycle of braking, and by the second order of the acceleration.
        allowed = 1.2 * brake * DT**2
        assert (np.abs(displacement - (path.distance + path.gain * a)[3:]) <= allowed[3:]).all()


def test_the_path_to_rest_is_that_of_single_joints() -> None:
    """s(v) = v dt up to b dt, v^2 / (2 b) + b dt^2 / 2 above, after one cycle at v (``braking.py``)."""
    random, model = np.random.default_rng(3), RobotModel(ROBOT)
    brake = 0.9 * limits(model)
    path = BrakingPath(model.nv, inf)
    for _ in range(20):
        v = random.uniform(-2, 2, model.nv) * random.choice([0.01, 1.0], model.nv)
        path.update(v, brake, DT)
        speed = np.abs(v)
        stop = np.where(speed > brake * DT, v**2 / (2 * brake) + brake * DT**2 / 2, speed * DT)
        np.testing.assert_allclose(path.distance, v * DT + np.sign(v) * stop, atol=1e-15)
        slope = np.maximum(speed / brake, DT)
        np.testing.assert_allclose(path.gain, DT**2 / 2 + slope * DT, atol=1e-15)


# -- rows -------------------------------------------------------------------------------------------------------


def test_accelerations_on_a_row_end_at_the_security_distance() -> None:
    """In both directions: a row that holds leads to it, and a pair without a row cannot come nearer."""
    random, ruler = np.random.default_rng(4), Ruler()
    constraint, model = SelfCollision(ROBOT), RobotModel(ROBOT)
    limit = limits(model)
    braking_limits = BrakingLimits(limit, DT)
    seen = 0
    for _ in range(12000):
        if seen == 25:
            break
        q = model.configuration(random_posture(random))
        if ruler(q).min() < 0.03:
            continue
        v = random.uniform(-1, 1, model.nv) * np.minimum(2.0, 0.15 * limit)
        model.set_state(q, v)
        model.update_kinematics()
        rows = constraint.compute_inequality(model, braking_limits)
        if rows is None:
            continue
        # The nearest acceleration that keeps all rows, one of them exactly.
        a = -v / np.abs(v).max()
        room = rows.bound - rows.matrix @ a
        k = int(room.argmin())
        a = a + rows.matrix[k] * room[k] / (rows.matrix[k] @ rows.matrix[k])
        if (np.abs(a) > limit).any() or (rows.matrix @ a > rows.bound + 1e-9).any():
            continue
        seen += 1
        postures = braked(q, v, a, braking_limits.brake)
        places = [ruler(postures[i]).min() for i in (1, 3, -1)]
        assert min(places) == pytest.approx(SECURITY, abs=2.5e-3)
    assert seen == 25


def test_nothing_near_gives_no_rows() -> None:
    model, braking_limits = RobotModel(ROBOT), BrakingLimits(limits(RobotModel(ROBOT)), DT)
    apart = np.zeros(17)
    apart[[5, 6, 8, 11, 12, 14]] = 0.8, 0.8, -0.3, 0.8, -0.8, 0.3
    model.set_state(model.configuration(apart), np.zeros(model.nv))
    model.update_kinematics()
    assert SelfCollision(ROBOT).compute_inequality(model, braking_limits) is None


# -- in the controller ------------------------------------------------------------------------------------------


def pulled(protected: bool, ticks: int = 400) -> tuple[float, list[str]]:
    """Least distance while both hands are pulled through the body and through each other, and outcomes."""
    control, ruler = bare_controller(), Ruler()
    if protected:
        control.add(SelfCollision(ROBOT))
    control.reset(ROBOT.posture("StandInit"))
    left = PositionTask("l_wrist", [0.05, 0.0, 0.0], stiffness=60.0)
    right = PositionTask("r_wrist", [0.05, 0.0, 0.0], stiffness=60.0)
    control.add(left)
    control.add(right)
    random = np.random.default_rng(5)
    least = inf
    outcomes: list[str] = []
    for tick in range(ticks):
        if tick % 80 == 0:
            inside = random.uniform([-0.1, -0.2, 0.5], [0.15, 0.2, 1.2])
            left.target, right.target = inside, inside
        control.step()
        outcomes.append(control.status.solver)
        least = min(least, float(ruler(control.model.q).min()))
    return least, outcomes


def test_hands_pulled_through_the_body_stay_out_of_it() -> None:
    assert pulled(False)[0] < -0.03
    least, outcomes = pulled(True)
    assert least > SECURITY - 1e-3
    assert outcomes.count("solved") > 0.98 * len(outcomes)
    assert set(outcomes) <= {"solved", "relaxed"}


def test_arms_thrown_at_the_body_with_all_the_robot_has_stop_in_time() -> None:
    """Random postures at the full speed and acceleration of the box."""
    control, ruler = bare_controller(), Ruler()
    control.add(SelfCollision(ROBOT))
    control.reset(ROBOT.posture("StandInit"))
    control.posture.stiffness = 400.0
    random = np.random.default_rng(6)
    distances = []
    for tick in range(1500):
        if tick % 60 == 0:
            target = random_posture(random)
            target[[5, 11]] = random.uniform(0.5, 1.9, 2)  # hands down, near the hips
            target[[6, 12]] = 0.01, -0.01
            control.posture.target = target
        control.step()
        distances.append(ruler(control.model.q).min())
    assert min(distances) > SECURITY - 1.5e-3
    assert np.mean(np.array(distances) < 2 * SECURITY) > 0.05  # it was tried


def test_hands_that_start_in_the_body_come_out_slowly() -> None:
    control, ruler = bare_controller(), Ruler()
    control.add(SelfCollision(ROBOT))
    start = ROBOT.posture("StandInit")
    start[[6, 8]] = 0.01, -1.0
    start[7] = 0.3
    control.reset(start)
    distances = [ruler(control.model.q).min()]
    assert distances[0] < -0.005
    for _ in range(250):
        control.step()
        distances.append(ruler(control.model.q).min())
    steps = np.diff(distances)
    assert distances[-1] > SECURITY - 1e-3
    assert steps.min() > -5e-4  # of another pair
    assert steps.max() <= SETTINGS.recovery_speed * DT


def test_rows_that_matter_less_than_others_never_stop_the_controller() -> None:
    """A row of a higher rank pushes the hand into the body: self-collision is relaxed, by name."""
    control = bare_controller()
    control.add(SelfCollision(ROBOT))
    control.reset(ROBOT.posture("StandInit"))
    inwards = np.zeros((1, 20))
    columns = control.model.joint_columns
    inwards[0, columns[ROBOT.joint_index("LElbowRoll")]] = 1.0
    push = FixedRows(inwards, np.array([-2.0]))
    push.priority = 4
    control.add(push)
    fold = PositionTask("l_wrist", [0.05, 0, 0], stiffness=60.0)
    fold.target = [0.0, 0.0, 0.8]
    control.add(fold)
    violated: set[str] = set()
    for _ in range(150):
        reference = control.step()
        assert np.isfinite(reference.position).all()
        violated.update(control.status.violated)
    assert (
        any(name.startswith("self-collision l_wrist-") for name in violated) or "row 0" in violated
    )


def test_random_targets_with_all_limits_break_none() -> None:
    """A short version of the benchmark: see there for what it judges by."""
    file = ROOT / "benchmarks" / "wander.py"
    spec = spec_from_file_location("wander", file)
    assert spec is not None
    assert spec.loader is not None
    benchmark = module_from_spec(spec)
    spec.loader.exec_module(benchmark)
    found: dict[str, Any] = benchmark.wander(ROBOT, 2500, seed=11)
    assert found["worst_penetration_mm"] == 0.0
    assert found["least_distance_mm"] > 8.5
    assert found["least_margin_mm"]["zero_moment_point"] > 5.0
    assert found["least_margin_mm"]["centre_of_mass"] > 24.0
    assert found["position_overshoot_mrad"] == 0.0
    outcomes = found["outcomes"]
    assert found["not_a_number"] == found["exceptions"] == 0
    assert outcomes["infeasible"] == outcomes["failed"] == 0
    assert outcomes["solved"] > 0.99 * found["ticks"]
