"""The torque limit: against inverse dynamics, at states and in motion; and that a robot may always hold itself."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from pepper_driver.config.arrays import FloatArray
from pepper_driver.controller import RobotModel
from pepper_driver.controller.constraints import BrakingLimits, LinearInequality, TorqueLimit
from support.controller import (
    ACCELERATION,
    BASE_ACCELERATION,
    BASE_VELOCITY,
    DT,
    JOINTS,
    MIDDLE,
    ROBOT,
    SETTINGS,
    VELOCITY,
    controller,
    random_posture,
)

LIMITS = np.concatenate([BASE_ACCELERATION, ACCELERATION])


def rows_at(
    limit: TorqueLimit, model: RobotModel, q: FloatArray, v: FloatArray
) -> LinearInequality | None:
    model.set_state(q, v)
    braking_limits = BrakingLimits(LIMITS, DT)
    return limit.compute_inequality(model, braking_limits)


def test_limits_are_a_fraction_of_the_motors_torque_at_the_joint() -> None:
    """By hand from the tables of the maker: motor types 5, 2 and 3 of knee, elbow and hand."""
    stall, nominal = TorqueLimit(ROBOT).limit, TorqueLimit(ROBOT, fraction=0.5, of="nominal").limit
    for name, at_stall, continuous, ratio in (
        ("KneePitch", 1.46, 0.128, 108.33),
        ("LElbowRoll", 0.0617, 0.0238, 118.1),
        ("RHand", 0.0094, 0.0049, 36.24),
    ):
        assert stall[ROBOT.joint_index(name)] == pytest.approx(0.8 * at_stall * ratio)
        assert nominal[ROBOT.joint_index(name)] == pytest.approx(0.5 * continuous * ratio)


def test_rows_forbid_what_inverse_dynamics_finds_too_much_and_nothing_else() -> None:
    random = np.random.default_rng(0)
    model, judge = RobotModel(ROBOT), RobotModel(ROBOT)
    seen = {True: 0, False: 0}
    for _ in range(150):
        limit = TorqueLimit(ROBOT, fraction=0.5)
        weak = random.random(JOINTS) < 0.3
        limit.limit[weak] *= random.uniform(0.05, 1.0, int(weak.sum()))
        q = model.configuration(random_posture(random))
        v = np.concatenate([BASE_VELOCITY, VELOCITY]) * random.uniform(-1, 1, 20)
        rows = rows_at(limit, model, q, v)
        stop = np.clip(-v / DT, -0.9 * LIMITS, 0.9 * LIMITS)
        granted = np.maximum(limit.limit, np.abs(judge.load_torque(q, v, stop)))
        for a in LIMITS * random.choice([-1, 1, 0.3], (30, 20)):
            torque = np.abs(judge.load_torque(q, v, a))
            allowed = rows is None or bool((rows.matrix @ a <= rows.bound + 1e-9).all())
            if (torque <= limit.limit).all():
                assert allowed
            if allowed:
                assert (torque <= granted + 1e-9).all()
            seen[allowed] += 1
    assert min(seen.values()) > 300


def test_what_braking_takes_is_allowed_to_the_side_that_it_takes_it_and_no_more() -> None:
    """Leaning far with weak motors: braking_limits is possible, pushing up harder is not, nor pushing down beyond."""
    model = RobotModel(ROBOT)
    limit = TorqueLimit(ROBOT, fraction=0.5, of="nominal")
    knee = ROBOT.joint_index("KneePitch")
    lean = MIDDLE.copy()
    lean[knee] = ROBOT.upper[knee]
    q, v = model.configuration(lean), np.zeros(20)
    weight = model.load_torque(q, v, v)
    assert abs(weight[knee]) > limit.limit[knee]
    rows = rows_at(limit, model, q, v)
    assert rows is not None
    assert "torque KneePitch" in rows.names
    assert (rows.bound >= -1e-12).all()
    column = model.joint_columns[knee]
    up = np.zeros(20)
    up[column] = 0.1 * np.sign(weight[knee])
    assert (rows.matrix @ up > rows.bound + 1e-9).any()
    own = [i for i, name in enumerate(rows.names) if name == "torque KneePitch"]
    down = -up
    assert (rows.matrix[own] @ down <= rows.bound[own]).all()


def test_a_robot_that_leans_beyond_its_nominal_torque_is_not_let_down() -> None:
    control = controller()
    control.add(TorqueLimit(ROBOT, fraction=0.5, of="nominal"))
    lean = MIDDLE.copy()
    lean[:3] = 0.9 * ROBOT.upper[:3]
    control.reset(lean)
    for _ in range(50):
        reference = control.step()
        assert control.status.solver == "solved"
    assert np.abs(reference.position - lean).max() < 1e-6


def test_flat_out_with_weak_motors_the_load_torque_stays_within_them() -> None:
    control = controller()
    limit = TorqueLimit(ROBOT)
    slow = controller()
    # Weak enough to matter, strong enough to hold and to brake.
    fraction = np.where(np.arange(JOINTS) < 3, 0.45, 1.0) * 0.55
    limit.limit[:] *= fraction
    control.add(limit)
    judge = RobotModel(ROBOT)
    random = np.random.default_rng(1)
    beyond, most, excess = 0.0, 0.0, 0.0
    for tick in range(1500):
        if tick % 40 == 0:
            target = random_posture(random)
        for c in (control, slow):
            c.posture.target = target
            c.posture.stiffness = 1000.0
            q, v = judge.configuration(c.position), c.model.v
            a = np.zeros(20)
            reference = c.step()
            a[judge.joint_columns] = reference.acceleration
            a[:3] = (reference.base_twist - v[:3]) / DT
            stop = np.clip(-v / DT, -0.9 * LIMITS, 0.9 * LIMITS)
            granted = np.maximum(limit.limit, np.abs(judge.load_torque(q, v, stop)))
            used = np.abs(judge.load_torque(q, v, a)) / granted
            if c is control:
                assert control.status.solver == "solved"
                excess = max(excess, float((used - 1).max()))
                most = max(most, float(used.max()))
            else:
                beyond = max(beyond, float(used.max()))
    assert excess < 1e-6
    assert most > 0.999
    assert beyond > 1.1


def test_it_leaves_the_models_results_alone_and_needs_none() -> None:
    model = RobotModel(ROBOT)
    random = np.random.default_rng(0)
    rows_at(TorqueLimit(ROBOT), model, model.configuration(MIDDLE), np.zeros(20))
    model.update_kinematics()
    frame = model.body_frame("l_wrist")
    before = model.jacobian(frame).copy(), model.com()[0].copy(), model.bias(frame).copy()
    limit = TorqueLimit(ROBOT, fraction=0.01)
    state = model.configuration(random_posture(random)), np.ones(20)
    rows = rows_at(limit, model, *state)
    assert rows is not None
    model.set_state(model.configuration(MIDDLE), np.zeros(20))
    after = model.jacobian(frame), model.com()[0], model.bias(frame)
    for x, y in zip(before, after, strict=True):
        assert np.array_equal(x, y)
    fresh = rows_at(TorqueLimit(ROBOT, fraction=0.01), RobotModel(ROBOT), *state)
    assert fresh is not None
    assert np.array_equal(fresh.matrix, rows.matrix)


@pytest.mark.parametrize("fraction", [0.8, 0.15])
def test_limits_follow_the_names_of_the_joints(fraction: float) -> None:
    turn = np.random.default_rng(0).permutation(JOINTS)
    robot = replace(ROBOT, joints=tuple(ROBOT.joints[i] for i in turn))
    control, other = controller(), type(controller())(robot, SETTINGS)
    names = set()
    for c, r in ((control, ROBOT), (other, robot)):
        c.add(TorqueLimit(r, fraction=fraction))
        c.posture.target = r.upper
        c.posture.stiffness = 100.0
    for _ in range(60):
        reference, turned = control.step(), other.step()
        names |= set(control.status.active)
        assert set(control.status.active) == set(other.status.active)
        assert np.abs(reference.position[turn] - turned.position).max() < 1e-9
    assert bool(names) == (fraction < 0.5)
