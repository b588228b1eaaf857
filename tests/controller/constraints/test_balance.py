"""Balance against inverse dynamics of a robot with a free base, and robots that throw themselves about."""

from __future__ import annotations

from itertools import product

import numpy as np
import pinocchio as pin
import pytest
from scipy.optimize import linprog

from pepper_driver.config.arrays import FloatArray
from pepper_driver.controller import BasePoseTask, RobotModel, WholeBodyController
from pepper_driver.controller.constraints import Balance, BrakingLimits, Constraint
from support.controller import ACCELERATION, DT, ROBOT, SETTINGS, FixedRows, random_posture

MARGIN, MOVING = 0.03, 0.01
WHEELS = np.array(
    [[0.09, 0.155], [0.09, -0.155], [-0.17, 0.0]]
)  # in base_link, NAOqi's drawing of the wheels


class FreeRobot:
    """Pinocchio's model with a free base: its inverse dynamics gives the whole push of the floor."""

    def __init__(self) -> None:
        full = pin.buildModelFromUrdf(str(ROBOT.urdf), pin.JointModelFreeFlyer())
        wheels = [full.getJointId(name) for name in ROBOT.wheels.names]
        self.model = pin.buildReducedModel(full, wheels, pin.neutral(full))
        self.data = self.model.createData()

    def zero_moment_point(self, q: FloatArray, v: FloatArray, a: FloatArray) -> FloatArray:
        """(2,) in base_link [m]."""
        posture = np.r_[np.zeros(6), 1.0, q[4:]]
        velocity, acceleration = (np.r_[x[:2], 0.0, 0.0, 0.0, x[2:]] for x in (v, a))
        push = pin.rnea(self.model, self.data, posture, velocity, acceleration)[:6]
        point: FloatArray = np.array([-push[4], push[3]]) / push[2]
        return point

    def centre_of_mass(self, q: FloatArray) -> FloatArray:
        """(2,) in base_link [m]."""
        com: FloatArray = pin.centerOfMass(self.model, self.data, np.r_[np.zeros(6), 1.0, q[4:]])
        return com[:2].copy()


def inside(point: FloatArray) -> FloatArray:
    """(3,) distance inside of the lines FL-FR, FR-B, B-FL [m]."""
    found = []
    for a, b in zip(WHEELS, np.roll(WHEELS, -1, axis=0), strict=True):
        along = (b - a) / np.linalg.norm(b - a)
        found.append(along[1] * (point - a)[0] - along[0] * (point - a)[1])
    return np.array(found)


FREE = FreeRobot()
LINES = {"FL-WheelB": 2, "B-WheelFR": 1, "FR-WheelFL": 0}


def random_state(random: np.random.Generator, model: RobotModel) -> None:
    """Put the model, which takes longer to make than to use, into a random state."""
    q = model.with_base_pose(model.configuration(random_posture(random)), random.uniform(-3, 3, 3))
    v = random.normal(size=model.nv) * np.r_[0.2, 0.2, 0.5, np.full(17, 0.6)]
    model.set_state(q, v)
    model.update_kinematics()


def braking_limits_of(model: RobotModel) -> BrakingLimits:
    limit = np.r_[0.3, 0.3, 0.75, np.zeros(17)]
    limit[model.joint_columns] = ACCELERATION
    braking_limits = BrakingLimits(limit, DT)
    return braking_limits


def bare(*constraints: Constraint) -> WholeBodyController:
    control = WholeBodyController(ROBOT)
    for part in control.constraints:
        control.remove(part)
    for part in constraints:
        control.add(part)
    control.reset(ROBOT.posture("StandInit"))
    return control


# -- rows -------------------------------------------------------------------------------------------------------


def test_corners_are_below_the_wheels() -> None:
    corners = Balance(ROBOT).corners
    for wheel in WHEELS:
        assert np.abs(corners - wheel).sum(axis=1).min() < 1e-12
    for point in (np.zeros(2), np.array([0.05, 0.05])):
        ours = Balance(ROBOT).inwards @ point - (Balance(ROBOT).inwards * corners).sum(axis=1)
        np.testing.assert_allclose(sorted(ours), sorted(inside(point)), atol=1e-12)


def test_rows_of_the_motion_are_exact() -> None:
    """On a row the zero moment point is at its margin, by an inverse dynamics without momentum."""
    random, model, seen = np.random.default_rng(0), RobotModel(ROBOT), 0
    for _ in range(60):
        random_state(random, model)
        rows = Balance(ROBOT).compute_inequality(model, braking_limits_of(model))
        for row, bound, name in (
            zip(rows.matrix, rows.bound, rows.names, strict=True) if rows else ()
        ):
            if not name.startswith("balance moving"):
                continue
            line = next(number for end, number in LINES.items() if name.endswith(end))
            if inside(FREE.centre_of_mass(model.q))[line] < 0.03:
                continue  # there the robot returns, whatever the zero moment point is
            a = random.normal(size=model.nv)
            a += row * (bound - row @ a) / (row @ row)
            point = FREE.zero_moment_point(model.q, model.v, a)
            distance = inside(point)[line]
            if distance < MOVING - 1e-9:
                # In a turn no more than half of the base's acceleration is asked for.
                assert abs(model.v[2]) > 0.1
                continue
            assert distance == pytest.approx(MOVING, abs=1e-9)
            seen += 1
    assert seen > 30


def test_at_rest_the_centre_of_mass_may_come_to_its_margin_and_no_further() -> None:
    """At rest, a slow lean that satisfies the row may continue in front of the margin, but not beyond it."""
    model, balance = RobotModel(ROBOT), Balance(ROBOT)
    lean = ROBOT.posture("StandInit")
    rooms = []
    for knee in np.linspace(0.0, 0.5, 60):
        lean[0] = -knee
        model.set_state(model.configuration(lean), np.zeros(model.nv))
        model.update_kinematics()
        rows = balance.compute_inequality(model, braking_limits_of(model))
        room = inside(FREE.centre_of_mass(model.q)).min() - MARGIN
        names = rows.names if rows is not None else ()
        resting = [i for i, name in enumerate(names) if name.startswith("balance at rest")]
        rooms.append(room)
        if room < -1e-4:
            assert rows is not None
            assert min(rows.bound[i] for i in resting) <= 0.0
        elif room > 1e-4 and rows is not None:
            assert all(rows.bound[i] > 0.0 for i in resting)
    assert min(rooms) < -0.01 < 0.01 < max(rooms)


def test_in_a_turn_the_zero_moment_point_counts_at_rest_too() -> None:
    """A base that turns while it drives pushes the zero moment point out for as long as it does."""
    model, balance = RobotModel(ROBOT), Balance(ROBOT)
    lean = ROBOT.posture("StandInit")
    v = np.zeros(model.nv)
    v[0], v[2] = -0.35, 1.0  # towards the left wheel's line
    seen = 0
    for knee, roll in product(np.linspace(-0.5, 0.5, 41), (-0.5, 0.5)):
        lean[[0, 2]] = knee, roll
        model.set_state(model.configuration(lean), v)
        model.update_kinematics()
        point = FREE.zero_moment_point(model.q, v, np.zeros(model.nv))
        still, turning = inside(FREE.centre_of_mass(model.q))[2], inside(point)[2]
        if turning < MARGIN - 0.003 and still > MARGIN + 0.003:
            rows = balance.compute_inequality(model, braking_limits_of(model))
            assert rows is not None
            named = dict(zip(rows.names, rows.bound, strict=True))
            assert named["balance at rest, WheelFL-WheelB"] <= 0.0
            seen += 1
    assert seen > 2


def test_rest_and_motion_never_exclude_each_other() -> None:
    """Accelerations along each line, with those that the base can have; joints may be as quick as they like."""
    random, model, seen = np.random.default_rng(8), RobotModel(ROBOT), 0
    for _ in range(200):
        random_state(random, model)
        braking_limits = braking_limits_of(model)
        rows = Balance(ROBOT).compute_inequality(model, braking_limits)
        if rows is None:
            continue
        for line in LINES:
            pair = [i for i, name in enumerate(rows.names) if name.endswith(line)]
            if len(pair) < 2:
                continue
            seen += 1
            matrix, bound = rows.matrix[pair], rows.bound[pair]
            box = [(-b, b) for b in braking_limits.acceleration[:3]] + [(-1e4, 1e4)] * 17
            assert linprog(np.zeros(20), A_ub=matrix, b_ub=bound, bounds=box).status == 0
    assert seen > 30


def test_a_zero_moment_point_already_outside_leaves_rest_and_motion_something_to_do() -> None:
    """A fast turn pushes it further out than half the base's acceleration can bring back; the base alone must do."""
    model, balance = RobotModel(ROBOT), Balance(ROBOT)
    lean = ROBOT.posture("StandInit")
    v = np.zeros(model.nv)
    v[0], v[2] = -0.5, 2.0
    seen = 0
    for knee in np.linspace(-0.5, 0.5, 101):
        lean[[0, 2]] = knee, 0.5
        model.set_state(model.configuration(lean), v)
        model.update_kinematics()
        braking_limits = braking_limits_of(model)
        com = inside(FREE.centre_of_mass(model.q))[2]
        point = inside(FREE.zero_moment_point(model.q, v, np.zeros(model.nv)))[2]
        rows = balance.compute_inequality(model, braking_limits)
        if com < MOVING + 1e-4 or point > MOVING - 0.02:
            continue
        assert rows is not None
        pair = [i for i, name in enumerate(rows.names) if name.endswith("FL-WheelB")]
        assert len(pair) == 2
        base = [(-b - 1e-9, b + 1e-9) for b in 0.5 * braking_limits.acceleration[:3]]
        box = [*base, *[(0.0, 0.0)] * 17]
        matrix, bound = rows.matrix[pair], rows.bound[pair]
        assert linprog(np.zeros(20), A_ub=matrix, b_ub=bound, bounds=box).status == 0
        seen += 1
    assert seen > 3


def test_a_centre_of_mass_outside_is_not_kept_by_standing_still() -> None:
    model, balance = RobotModel(ROBOT), Balance(ROBOT)
    lean = ROBOT.posture("StandInit")
    lean[[0, 1, 5, 11]] = -0.5, -0.9, 0.0, 0.0
    for posture, answer in ((ROBOT.posture("StandInit"), True), (lean, False)):
        model.set_state(model.configuration(posture), np.zeros(model.nv))
        model.update_kinematics()
        assert (inside(FREE.centre_of_mass(model.q)).min() > 0) == answer
        assert balance.is_satisfied(model, braking_limits_of(model), np.zeros(model.nv)) == answer


def test_what_is_kept_with_the_centre_of_mass_outside_breaks_no_row() -> None:
    """It moves inwards fast enough, and a turn holds the zero moment point inside meanwhile."""
    random, model, seen = np.random.default_rng(3), RobotModel(ROBOT), 0
    balance = Balance(ROBOT)
    for _ in range(4000):
        random_state(random, model)
        if inside(FREE.centre_of_mass(model.q)).min() > 0.5 * MOVING:
            continue
        v = model.v * 3
        model.set_state(model.q, v)
        model.update_kinematics()
        braking_limits = braking_limits_of(model)
        a = random.uniform(-1, 1, 20) * braking_limits.acceleration
        if not balance.is_satisfied(model, braking_limits, a):
            continue
        seen += 1
        rows = balance.compute_inequality(model, braking_limits)
        assert rows is None or (rows.matrix @ a <= rows.bound + 1e-9).all()
    assert seen > 3


@pytest.mark.parametrize(
    ("margin", "moving"),
    [(-0.01, None), (0.1, None), (float("nan"), None), (0.03, 0.04), (0.03, -0.01)],
)
def test_margins_without_a_triangle_are_refused(margin: float, moving: float | None) -> None:
    with pytest.raises(ValueError, match="margin"):
        Balance(ROBOT, margin, moving)


# -- in the controller ------------------------------------------------------------------------------------------


def thrown(
    control: WholeBodyController, ticks: int, seed: int
) -> tuple[FloatArray, FloatArray, list[str]]:
    """Least distances inside of the zero moment point and the centre of mass, and outcomes, at full acceleration."""
    random = np.random.default_rng(seed)
    base = BasePoseTask(stiffness=30.0)
    control.remove(control.base_velocity)
    control.add(base)
    control.posture.stiffness = 200.0
    points, coms = [], []
    outcomes: list[str] = []
    for tick in range(ticks):
        if tick % 90 == 0:
            target = random_posture(random)
            target[:3] = np.where(random.random(3) < 0.5, ROBOT.lower[:3], ROBOT.upper[:3])
            control.posture.target = target
            base.target = control.base_pose + random.uniform(-1, 1, 3) * [1, 1, 3]
        q, v = control.model.q, control.model.v
        control.step()
        a = (control.model.v - v) / DT
        points.append(inside(FREE.zero_moment_point(q, v, a)).min())
        coms.append(inside(FREE.centre_of_mass(control.model.q)).min())
        outcomes.append(control.status.solver)
    return np.array(points), np.array(coms), outcomes


def test_without_balance_the_robot_would_tip() -> None:
    points, coms, _ = thrown(bare(), 700, seed=1)
    assert points.min() < -0.05
    assert coms.min() < 0.0


@pytest.mark.parametrize("seed", [1, 2])
def test_flat_out_motions_keep_the_robot_on_its_wheels(seed: int) -> None:
    points, coms, outcomes = thrown(bare(Balance(ROBOT)), 1500, seed)
    assert points.min() > MOVING - 1e-3
    assert coms.min() > MARGIN - 0.006
    assert outcomes.count("solved") > 0.99 * len(outcomes)


def test_a_higher_margin_keeps_the_centre_of_mass_further_in() -> None:
    _, coms, _ = thrown(bare(Balance(ROBOT, margin=0.05)), 700, seed=1)
    assert coms.min() > 0.05 - 0.006


def test_what_matters_less_is_relaxed() -> None:
    """Rows of rank 0 that demand a lean forward are broken, by name; nothing raises."""
    push = np.zeros((1, 20))
    push[0, bare().model.joint_columns[0]] = 1.0
    control = bare(Balance(ROBOT), FixedRows(push, np.array([-1.0])))
    violated: set[str] = set()
    for _ in range(120):
        q, v = control.model.q, control.model.v
        control.step()
        a = (control.model.v - v) / DT
        assert inside(FREE.zero_moment_point(q, v, a)).min() > MOVING - 1e-3
        violated.update(control.status.violated)
    assert violated == {"row 0"}


def test_a_robot_that_starts_beyond_its_wheels_comes_back() -> None:
    control = bare(Balance(ROBOT))
    lean = ROBOT.posture("StandInit")
    lean[[0, 1, 5, 11]] = -0.5, -0.9, 0.0, 0.0
    control.reset(lean)
    start = inside(FREE.centre_of_mass(control.model.q)).min()
    assert start < 0.0
    control.posture.target = ROBOT.posture("StandInit")
    for _ in range(400):
        reference = control.step()
        assert np.isfinite(reference.position).all()
    assert inside(FREE.centre_of_mass(control.model.q)).min() > MARGIN


def test_what_is_said_to_be_kept_breaks_no_row_and_keeps_the_zero_moment_point_inside() -> None:
    random, model = np.random.default_rng(11), RobotModel(ROBOT)
    balance = Balance(ROBOT, MARGIN, MOVING)
    limit = np.concatenate([np.array([0.3, 0.3, 0.75]), ACCELERATION])
    braking_limits = BrakingLimits(limit, DT)
    answers = []
    for _ in range(400):
        random_state(random, model)
        a = random.uniform(-1, 1, 20) * limit * random.choice([0.05, 0.3, 1.0])
        rows = balance.compute_inequality(model, braking_limits)
        broken = rows is not None and bool((rows.matrix @ a > rows.bound + 1e-9).any())
        answers.append(balance.is_satisfied(model, braking_limits, a))
        if answers[-1]:
            assert not broken
            assert inside(FREE.zero_moment_point(model.q, model.v, a)).min() > MOVING - 1e-9
    assert 40 < sum(answers) < 360


def test_rows_made_when_needed_move_the_robot_as_rows_that_are_always_there(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def trail() -> FloatArray:
        random = np.random.default_rng(5)
        control = WholeBodyController(ROBOT, SETTINGS)
        control.add(Balance(ROBOT, MARGIN, MOVING))
        control.posture.stiffness = 60.0
        places = []
        for tick in range(600):
            if tick % 60 == 0:
                control.posture.target = random_posture(random)
                control.base_velocity.target = random.uniform(-0.3, 0.3, 3)
            places.append(control.step().position)
        return np.array(places)

    when_needed = trail()
    monkeypatch.setattr(Balance, "is_satisfied", lambda *_: False)
    np.testing.assert_allclose(when_needed, trail(), atol=1e-7)
    monkeypatch.setattr(Balance, "compute_inequality", lambda *_: None)
    assert np.abs(when_needed - trail()).max() > 1e-3  # they did something
