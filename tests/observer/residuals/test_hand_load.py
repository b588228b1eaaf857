"""What the hands hold, against Pinocchio with the load put on the wrist."""

from __future__ import annotations

from copy import copy
from dataclasses import replace
from typing import Any

import numpy as np
import pinocchio as pin
import pytest

from pepper_driver.config.arrays import BoolArray, FloatArray
from pepper_driver.controller.model import RobotModel
from pepper_driver.controller.tick import Reference, Tick
from pepper_driver.observer.models.fusion_model import FusionModel
from pepper_driver.observer.models.payload import PayloadRegressor
from pepper_driver.observer.residuals.adaptation import (
    FRICTION_UNCERTAINTY,
    LEARN_PERIOD,
    LOAD_PRIOR_STD,
    LOAD_PROCESS_NOISE,
    MIN_NOISE,
    HandLoads,
)
from pepper_driver.observer.residuals.fusion import FusionGenerator
from support.fusion import (
    MODEL,
    STICK_SLIP,
    Motion,
    drive,
    fusion_model,
    fusion_observer,
    play,
    quantised,
    swing,
)
from support.observer import CYCLE, JOINTS, ROBOT, SETTINGS, tick

WRISTS = {"left_arm": "LWristYaw", "right_arm": "RWristYaw"}
ARM = [ROBOT.joint_index(name) for name in ROBOT.chains["left_arm"][:5]]
OTHER_ARM = [ROBOT.joint_index(name) for name in ROBOT.chains["right_arm"]]
MIDDLE = 0.5 * (
    np.array([j.lower for j in ROBOT.joints]) + np.array([j.upper for j in ROBOT.joints])
)
GAIN = STICK_SLIP.load_gain
MASS, PLACE = 0.4, np.array([0.07, -0.01, -0.025])
EVERYTHING = np.ones(JOINTS, dtype=np.bool_)
NOISE_FACTOR = np.full(JOINTS, MIN_NOISE)


def loaded(loads: dict[str, Any]) -> RobotModel:
    """The robot with these inertias fixed to the links that the joints move."""
    model = RobotModel(ROBOT)
    for joint, inertia in loads.items():
        number = model.joint_id(joint)
        model.pin.inertias[number] = model.pin.inertias[number] + inertia
    return model


def point(mass: float, place: FloatArray) -> Any:
    """A mass at one point: about the origin of its link it has an inertia."""
    return pin.Inertia(mass, place, np.zeros((3, 3)))


def about_origin(mass: float, place: FloatArray) -> Any:
    """Nothing but the inertia that such a point has about the origin of its link."""
    cross = pin.skew(place)
    return pin.Inertia(0.0, np.zeros(3), -mass * cross @ cross)


def torque_of(
    model: RobotModel, position: FloatArray, velocity: FloatArray, acceleration: FloatArray
) -> FloatArray:
    v, a = np.zeros(model.nv), np.zeros(model.nv)
    v[model.joint_columns], a[model.joint_columns] = velocity, acceleration
    return model.load_torque(model.configuration(position), v, a)


PLAIN = RobotModel(ROBOT)
PAYLOADS = PayloadRegressor(PLAIN, list(WRISTS.values()))


def added(
    load: RobotModel,
    position: FloatArray,
    velocity: FloatArray | None = None,
    acceleration: FloatArray | None = None,
) -> FloatArray:
    """(17,) torque that the load adds; at rest by default."""
    nothing = np.zeros(JOINTS)
    state = (
        position,
        nothing if velocity is None else velocity,
        nothing if acceleration is None else acceleration,
    )
    return torque_of(load, *state) - torque_of(PLAIN, *state)


def vector(mass: float, place: FloatArray) -> FloatArray:
    return np.array([mass, *(mass * place)])


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(0)


# -- regressor ------------------------------------------------------------------------------------------------------


def test_regressor_at_rest_is_the_weight_of_both_loads(rng: np.random.Generator) -> None:
    for _ in range(20):
        position = rng.uniform(-1.5, 1.5, JOINTS)
        masses, places = rng.uniform(0.1, 2.0, 2), rng.uniform(-0.2, 0.2, (2, 3))
        load = loaded(dict(zip(WRISTS.values(), map(point, masses, places), strict=True)))
        nothing = np.zeros(JOINTS)
        regressor = PAYLOADS.compute(position, nothing, nothing)
        assert regressor.shape == (JOINTS, 8)
        quantities = np.concatenate([vector(*pair) for pair in zip(masses, places, strict=True)])
        np.testing.assert_allclose(
            regressor @ quantities, added(load, position), rtol=1e-9, atol=1e-9
        )


def test_regressor_in_motion_leaves_out_only_the_inertia_about_the_link(
    rng: np.random.Generator,
) -> None:
    for wrist in WRISTS.values():
        payload = PayloadRegressor(PLAIN, [wrist])
        for _ in range(20):
            state = [rng.uniform(-1.5, 1.5, JOINTS) for _ in range(2)]
            state.append(rng.uniform(-9.0, 9.0, JOINTS))
            mass, place = float(rng.uniform(0.1, 2.0)), rng.uniform(-0.2, 0.2, 3)
            regressor = payload.compute(*state)
            load, left_out = (loaded({wrist: of(mass, place)}) for of in (point, about_origin))
            expected = added(load, *state) - added(left_out, *state)
            np.testing.assert_allclose(
                regressor @ vector(mass, place), expected, rtol=1e-9, atol=1e-9
            )


# -- estimate -------------------------------------------------------------------------------------------------------


def arm_motion(seconds: float, joints: list[int] = ARM) -> tuple[FloatArray, ...]:
    """Position, velocity and acceleration (n, 17) of an arm that waves, each joint at its own rate."""
    time = np.arange(round(seconds / CYCLE))[:, None] * CYCLE
    size, rate = np.zeros(JOINTS), np.zeros(JOINTS)
    size[joints] = 0.5
    rate[joints] = np.linspace(1.1, 2.9, len(joints))
    angle = rate * time + np.arange(JOINTS)
    return (
        MIDDLE + size * np.sin(angle),
        size * rate * np.cos(angle),
        -size * rate**2 * np.sin(angle),
    )


def reference(velocity: FloatArray, acceleration: FloatArray) -> Reference:
    nothing = np.zeros(JOINTS)
    return Reference(
        position=np.full(JOINTS, 99.0),  # where it should be is nothing to the load
        velocity=velocity,
        acceleration=acceleration,
        load_torque=nothing,
        base_twist=np.zeros(3),
    )


ZERO = np.zeros(JOINTS)


def follow(
    target: HandLoads,
    load: RobotModel,
    seconds: float,
    seed: int = 0,
) -> None:
    """The residual is the load of the arm that the models do not have yet: they follow the estimate."""
    rng = np.random.default_rng(seed)
    for k, (q, v, a) in enumerate(zip(*arm_motion(seconds), strict=True)):
        known = target.step(q, v, a)
        if k % LEARN_PERIOD == 0:
            residual = GAIN * (added(load, q, v, a) - known)
            residual += 0.5 * np.sqrt(NOISE_FACTOR) * rng.standard_normal(JOINTS)
            target.update(residual, NOISE_FACTOR, EVERYTHING)


def hands() -> HandLoads:
    return HandLoads(ROBOT, [MODEL] * JOINTS)


@pytest.mark.parametrize(("arm", "joint"), WRISTS.items())
def test_finds_the_load_of_an_arm_that_moves(arm: str, joint: str) -> None:
    target = hands()
    assert target.by_arm().keys() == WRISTS.keys()
    assert target.by_arm()[arm].mass == 0.0
    assert target.by_arm()[arm].mass_std == pytest.approx(LOAD_PRIOR_STD[0])
    load = loaded({joint: point(MASS, PLACE)})
    moving = ARM if arm == "left_arm" else OTHER_ARM[:5]
    rng = np.random.default_rng(1)
    deviations = []
    for k, (q, v, a) in enumerate(zip(*arm_motion(40.0, moving), strict=True)):
        known = target.step(q, v, a)
        if k % LEARN_PERIOD == 0:
            deviations.append(target.by_arm()[arm].mass_std)
            residual = GAIN * (added(load, q, v, a) - known)
            residual += 0.5 * np.sqrt(NOISE_FACTOR) * rng.standard_normal(JOINTS)
            target.update(residual, NOISE_FACTOR, EVERYTHING)
    held = target.by_arm()
    assert held[arm].mass == pytest.approx(MASS, abs=0.03)
    np.testing.assert_allclose(held[arm].first_moment, MASS * PLACE, atol=0.004)
    # Its standard deviation is right, and falls at first.
    assert abs(held[arm].mass - MASS) < 3.0 * held[arm].mass_std
    assert (np.diff(deviations[:30]) < 0.0).all()
    assert held[arm].mass_std < 0.2 * LOAD_PRIOR_STD[0]
    # The other hand is as empty as it is.
    [other] = held.keys() - {arm}
    assert abs(held[other].mass) < 0.05


def test_without_wandering_it_is_ridge_regression() -> None:
    """All samples at once, each with its noise, and the prior as penalty."""
    gains = np.linspace(0.005, 0.02, JOINTS)
    gains[3] = 0.0
    of_joint: list[FusionModel | None] = [
        fusion_model(replace(STICK_SLIP, load_gain=float(gain))) if gain else None for gain in gains
    ]
    target = HandLoads(ROBOT, of_joint, process_noise=np.zeros(4), uncertainty=0.0)
    floor = MIN_NOISE + (FRICTION_UNCERTAINTY * STICK_SLIP.friction) ** 2
    rng = np.random.default_rng(2)
    precision, pull = np.diag(np.tile(LOAD_PRIOR_STD, 2) ** -2.0), np.zeros(8)
    variance = np.zeros(JOINTS)
    for _ in range(40):
        q, v, a = rng.uniform(-1.0, 1.0, (3, JOINTS))
        for _ in range(2):  # it computes every other tick
            known = target.step(q, v, a)
        use = rng.uniform(size=JOINTS) < 0.7
        use[3] = False
        noise = MIN_NOISE * rng.uniform(0.2, 20.0, JOINTS)
        residual = 0.02 * rng.standard_normal(JOINTS)
        effect = gains[:, None] * PAYLOADS.compute(q, v, a)
        weight = np.where(use, 1.0 / (floor + noise), 0.0)
        precision += (effect.T * weight) @ effect
        pull += (effect.T * weight) @ residual
        noise[~use], spoilt = np.nan, np.where(use, residual - gains * known, np.nan)
        target.update(spoilt, noise, use)
        covariance = np.linalg.inv(precision)
        variance = np.einsum("ij,jk,ik->i", effect, covariance, effect)
        np.testing.assert_allclose(target.variance(), variance, rtol=1e-6)
    batch = (covariance @ pull).reshape(2, 4)
    for k, arm in enumerate(WRISTS):
        held = target.by_arm()[arm]
        np.testing.assert_allclose([held.mass, *held.first_moment], batch[k], rtol=1e-6, atol=1e-9)
        assert held.mass_std == pytest.approx(np.sqrt(covariance[4 * k, 4 * k]), rel=1e-6)


def test_it_becomes_less_certain_with_time_but_never_less_than_at_the_start(
    rng: np.random.Generator,
) -> None:
    """By LOAD_PROCESS_NOISE in a minute, from which nothing has been learned."""
    target = hands()
    no_joint = np.zeros(JOINTS, dtype=np.bool_)
    target.step(MIDDLE, ZERO, ZERO)
    target.update(rng.normal(size=JOINTS), NOISE_FACTOR, no_joint)
    assert target.by_arm()["left_arm"].mass_std == pytest.approx(LOAD_PRIOR_STD[0], rel=1e-9)
    for _ in range(100):
        target.update(np.zeros(JOINTS), NOISE_FACTOR, EVERYTHING)
    before = target.by_arm()["left_arm"].mass_std
    assert before < 0.9 * LOAD_PRIOR_STD[0]
    for _ in range(round(60.0 / CYCLE / LEARN_PERIOD)):
        target.update(rng.normal(size=JOINTS), NOISE_FACTOR, no_joint)
    expected = np.hypot(before, LOAD_PROCESS_NOISE[0])
    assert target.by_arm()["left_arm"].mass_std == pytest.approx(expected, rel=1e-2)


def test_a_fraction_of_the_effect_of_a_load_stays_uncertain() -> None:
    """Gears have more friction under load: a large load causes larger residuals, even if it is known well."""
    target = hands()
    follow(target, loaded({"LWristYaw": point(MASS, PLACE)}), 10.0)
    torque = target.step(MIDDLE, ZERO, ZERO)
    certain = copy(target)
    certain._uncertainty = 0.0
    unforeseen = target.variance() - certain.variance()
    np.testing.assert_allclose(unforeseen, (0.15 * GAIN * torque) ** 2, rtol=1e-6, atol=1e-15)
    assert unforeseen.max() > 1e-7


def test_joints_that_are_not_used_teach_nothing() -> None:
    q, v, a = (rows[100] for rows in arm_motion(2.0))
    use = EVERYTHING.copy()
    use[ARM[1:3]] = False
    residual = GAIN * added(loaded({"LWristYaw": point(MASS, PLACE)}), q, v, a)
    spoilt = residual.copy()
    spoilt[ARM[1:3]] = 9.0
    learned, spared = hands(), hands()
    for target, seen in ((learned, residual), (spared, spoilt)):
        target.step(q, v, a)
        explained = target.update(seen, NOISE_FACTOR, use)
        np.testing.assert_array_equal(explained[~use], 0.0)
    assert learned.by_arm() == spared.by_arm()
    assert learned.by_arm()["left_arm"].mass > 0.1
    # And none at all teach nothing at all.
    idle = hands()
    idle.step(q, v, a)
    explained = idle.update(residual, NOISE_FACTOR, np.zeros(JOINTS, dtype=np.bool_))
    np.testing.assert_array_equal(explained, 0.0)
    assert idle.by_arm()["left_arm"].mass == 0.0
    assert (idle.step(q, v, a) == 0.0).all()


def test_what_an_update_explains_is_added_to_the_load_of_the_models() -> None:
    target = hands()
    q, v, a = (rows[100] for rows in arm_motion(2.0))
    follow(target, loaded({"LWristYaw": point(MASS, PLACE)}), 1.0)
    for _ in range(2):
        before = target.step(q, v, a)
    explained = target.update(np.full(JOINTS, 0.01), NOISE_FACTOR, EVERYTHING)
    for _ in range(2):
        after = target.step(q, v, a)
    np.testing.assert_allclose(explained, GAIN * (after - before), rtol=1e-9, atol=1e-12)
    assert np.abs(explained).max() > 1e-4


def test_torque_is_that_of_the_load_where_the_arm_is() -> None:
    target = hands()
    load = loaded({"LWristYaw": point(MASS, PLACE)})
    follow(target, load, 30.0)
    for q, v, a in zip(*(rows[::50] for rows in arm_motion(30.0)), strict=True):
        for _ in range(2):
            torque = target.step(q, v, a)
        np.testing.assert_allclose(torque, added(load, q, v, a), atol=0.12)


@pytest.mark.parametrize("value", [np.nan, np.inf])
@pytest.mark.parametrize("part", ["position", "velocity", "acceleration"])
def test_what_is_not_finite_leaves_the_load_as_it_was(part: str, value: float) -> None:
    target = hands()
    q, v, a = (rows[-1] for rows in arm_motion(2.0))
    follow(target, loaded({"LWristYaw": point(MASS, PLACE)}), 2.0)
    for _ in range(2):
        before = target.step(q, v, a)
    bad = {"position": 0.5 * q, "velocity": v, "acceleration": a}
    bad[part] = bad[part].copy()
    bad[part][ARM[0]] = value
    for _ in range(3):
        seen = target.step(bad["position"], bad["velocity"], bad["acceleration"])
        np.testing.assert_array_equal(seen, before)
        assert np.isfinite(target.variance()).all()
    # Then it continues.
    for _ in range(2):
        after = target.step(0.5 * q, v, a)
    assert np.abs(after - before).max() > 0.1


def test_before_anything_is_finite_the_hands_have_no_load() -> None:
    target = hands()
    np.testing.assert_array_equal(target.step(np.full(JOINTS, np.nan), ZERO, ZERO), 0.0)
    np.testing.assert_array_equal(target.variance(), 0.0)


# -- joints at rest -------------------------------------------------------------------------------------------------

WRIST = ROBOT.joint_index("LWristYaw")
WEAK = fusion_model(
    replace(STICK_SLIP, load_gain=1.6, friction=0.01, load_friction=0.0, breakaway=1.1)
)
HELD = 1.1 * 0.01  # [rad] by the friction of the weak wrist
TAUGHT = loaded({"LWristYaw": point(0.2, np.array([0.02, 0.01, 0.03]))})


def weak_wrist() -> HandLoads:
    """Hands of a robot whose shoulder has been taught a load that is not there."""
    target = HandLoads(ROBOT, [WEAK if j == WRIST else MODEL for j in range(JOINTS)])
    use = np.isin(np.arange(JOINTS), ARM[:3])
    for _ in range(200):
        known = target.step(MIDDLE, ZERO, ZERO)
        target.update(GAIN * (added(TAUGHT, MIDDLE) - known), NOISE_FACTOR, use)
    return target


def droop(target: HandLoads) -> float:
    """By the wrist, as the hands are estimated [rad]."""
    for _ in range(2):
        torque = target.step(MIDDLE, ZERO, ZERO)
    return float(1.6 * torque[WRIST])


def contradiction(angle: float) -> FloatArray:
    """What friction cannot hold of the wrist, which stands at its target."""
    beyond = np.zeros(JOINTS)
    beyond[WRIST] = -angle + np.clip(angle, -HELD, HELD)
    return beyond


def at(joint: int) -> BoolArray:
    return np.isin(np.arange(JOINTS), [joint])


def test_a_wrist_at_rest_takes_back_what_its_friction_could_not_hold() -> None:
    target = weak_wrist()
    before, others = droop(target), target.by_arm()
    known = target.step(MIDDLE, ZERO, ZERO)
    assert abs(before) > 2.0 * HELD
    beyond = contradiction(before)
    explained = target.reconcile(beyond, at(WRIST))
    assert explained is not None
    np.testing.assert_allclose(explained, beyond, rtol=1e-9)
    assert droop(target) == pytest.approx(np.copysign(HELD, before), rel=1e-6)
    # Nothing is more certain than before, and the other hand is as it was.
    assert target.by_arm()["left_arm"].mass_std == others["left_arm"].mass_std
    assert target.by_arm()["right_arm"] == others["right_arm"]
    # What the shoulder has learned is still right for the shoulder, within its uncertainty.
    shoulder = ARM[0]
    limited = (target.step(MIDDLE, ZERO, ZERO) - known)[shoulder]
    assert abs(GAIN * limited) < 0.2 * abs(beyond[WRIST])


def test_what_says_nothing_against_the_load_changes_nothing() -> None:
    target = weak_wrist()
    angle, before = droop(target), target.by_arm()
    beyond = contradiction(angle)
    no_joint = np.zeros(JOINTS, dtype=np.bool_)
    assert target.reconcile(beyond, no_joint) is None
    assert target.reconcile(np.zeros(JOINTS), at(WRIST)) is None
    # A wrist that is further from its target than the load explains: at its stop, or touched.
    assert target.reconcile(-beyond, at(WRIST)) is None
    # A joint whose friction hides more than the load leaves open: worn, perhaps.
    strong = np.zeros(JOINTS)
    for joint in ARM[:4]:
        strong[joint] = -np.sign(target.step(MIDDLE, ZERO, ZERO)[joint]) * 0.05
    rough = HandLoads(
        ROBOT,
        [
            fusion_model(replace(STICK_SLIP, friction=0.5)) if j != WRIST else WEAK
            for j in range(JOINTS)
        ],
    )
    rough.step(MIDDLE, ZERO, ZERO)
    rough.update(np.full(JOINTS, 0.05), NOISE_FACTOR, np.isin(np.arange(JOINTS), ARM[:3]))
    there = rough.by_arm()
    assert rough.reconcile(strong, ~at(WRIST)) is None
    assert rough.by_arm() == there
    assert target.by_arm() == before


def test_no_more_is_taken_back_than_the_load_is_thought_to_do() -> None:
    target = weak_wrist()
    angle = droop(target)
    explained = target.reconcile(100.0 * contradiction(angle), at(WRIST))
    assert explained is not None
    assert explained[WRIST] == pytest.approx(-angle, rel=1e-9)
    assert droop(target) == pytest.approx(0.0, abs=1e-9)


def test_reset_empties_the_hands() -> None:
    target = hands()
    load = loaded({"LWristYaw": point(MASS, PLACE)})
    follow(target, load, 2.03)  # an odd number of ticks
    target.reset()
    assert target.by_arm() == hands().by_arm()
    np.testing.assert_array_equal(target.variance(), hands().variance())
    fresh = hands()
    for one in (target, fresh):
        follow(one, load, 1.0, seed=3)
    assert target.by_arm() == fresh.by_arm()


# -- in the residual ------------------------------------------------------------------------------------------------

MOVED = [ROBOT.joint_index(name) for name in ("LShoulderPitch", "LShoulderRoll", "LElbowRoll")]


def waved(mass: float, seconds: float = 32.0, size: float = 0.5) -> list[Tick]:
    """Ticks of a robot whose left arm waves with a load in its hand that its reference does not contain."""
    motions = [swing(seconds, size, rate, gravity=0.0) for rate in (1.3, 1.7, 2.3)]
    n = len(motions[0])
    state = []
    for name in ("position", "velocity", "acceleration"):
        rows = np.zeros((n, JOINTS))
        rows[:, MOVED] = np.column_stack([getattr(motion, name) for motion in motions])
        state.append(rows)
    state[0] += np.where(np.isin(np.arange(JOINTS), MOVED), -0.2, 0.0)
    load = loaded({"LWristYaw": point(mass, PLACE)})
    own = np.array([torque_of(PLAIN, *row) for row in zip(*state, strict=True)])
    load_torque = np.array([torque_of(load, *row) for row in zip(*state, strict=True)])
    position = state[0].copy()
    for joint in MOVED:
        column = Motion(
            position=state[0][:, joint],
            velocity=state[1][:, joint],
            acceleration=state[2][:, joint],
            load=load_torque[:, joint],
        )
        position[:, joint] = quantised(drive(column, steps=30).position)
    made = []
    for k in range(n):
        one = tick(k)
        one.sent.position[:] = state[0][k]
        one.reference.position[:], one.reference.velocity[:] = state[0][k], state[1][k]
        one.reference.acceleration[:], one.reference.load_torque[:] = state[2][k], own[k]
        one.measurement.position[:] = position[k]
        made.append(one)
    return made


def last_residuals(made: list[Tick], target: HandLoads | None) -> FloatArray:
    """(n, 3) of the joints that move, from the 20th second to the 30th."""
    of_joint = [fusion_model(weight=(1.0, 1.0)) if j in MOVED else None for j in range(JOINTS)]
    signal = FusionGenerator(
        of_joint, CYCLE, window=SETTINGS.fusion_window, adapt=True, hands=target
    )
    rows = np.array([one.residual[MOVED] for one in play(signal, made)])
    return rows[round(20.0 / CYCLE) : round(30.0 / CYCLE)]


def test_an_unknown_load_in_the_hand_leaves_the_residual_within_half_a_minute() -> None:
    made = waved(0.6)
    of_joint = [MODEL if j in MOVED else None for j in range(JOINTS)]
    target = HandLoads(ROBOT, of_joint, process_noise=np.zeros(4), uncertainty=0.0)
    without, followed = last_residuals(made, None), last_residuals(made, target)
    bound = MODEL.max_bound
    assert np.abs(without).max() > 0.5 * bound
    assert np.abs(followed).max() < 0.3 * bound
    assert np.sqrt((followed**2).mean()) < 0.4 * np.sqrt((without**2).mean())
    held = target.by_arm()["left_arm"]
    # The constants of the joints' own models take the rest.
    assert 0.5 * 0.6 < held.mass < 1.2 * 0.6
    assert held.mass > 5.0 * held.mass_std
    assert abs(target.by_arm()["right_arm"].mass) < 0.05


class Jolted(HandLoads):
    """Says in its tenth update that it explains an error, and that from all joints it may use."""

    explains = 0.004
    updates = 0
    used = np.zeros(JOINTS, dtype=np.bool_)

    def update(self, residual: FloatArray, noise: FloatArray, use: BoolArray) -> FloatArray:
        self.updates += 1
        if self.updates == 10:
            self.used = use
            return np.where(use, self.explains, 0.0)
        return np.zeros(JOINTS)


def test_what_the_load_explains_is_removed_from_the_residual_at_once() -> None:
    """Stick-slip models need several ticks to where a new load takes them, in which it would be learned again."""
    made = waved(0.0, 5.0)
    of_joint = [fusion_model(weight=(1.0, 1.0)) if j in MOVED else None for j in range(JOINTS)]
    rows = []
    jolted, quiet_bound = Jolted(ROBOT, of_joint), Jolted(ROBOT, of_joint)
    quiet_bound.explains = 0.0
    for target in (jolted, quiet_bound):
        signal = FusionGenerator(of_joint, CYCLE, window=1, adapt=True, hands=target)
        rows.append(np.array([one.raw for one in play(signal, made)]))
    change = rows[0] - rows[1]
    [used] = np.flatnonzero(jolted.used)[None]
    assert set(used) <= set(MOVED)
    assert len(used) > 0
    first = 9 * LEARN_PERIOD + LEARN_PERIOD // 2
    assert (np.nan_to_num(change[:first]) == 0.0).all()
    # The PD law of the model pulls back within the tick.
    assert (change[first, used] < -0.6 * Jolted.explains).all()
    assert (change[first, used] > -1.0 * Jolted.explains).all()


def test_the_wrist_of_an_arm_that_swings_in_one_place_does_not_pay_for_the_shoulder(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """An error of the shoulder's model looks like a load in the hand; the wrist at rest contradicts it."""
    made = waved(0.0, 40.0, size=0.05)
    for one in made:
        one.measurement.position[MOVED[0]] -= 0.004
        one.measurement.position[MOVED[1]] -= 0.004
    of_joint: list[FusionModel | None] = [
        fusion_model(weight=(1.0, 1.0)) if j in MOVED else None for j in range(JOINTS)
    ]
    of_joint[WRIST] = replace(WEAK, weight=(1.0, 1.0))
    largest = []
    for asked in (False, True):
        with monkeypatch.context() as patch:
            if not asked:
                patch.setattr(HandLoads, "reconcile", lambda *_: None)
            target = HandLoads(ROBOT, of_joint, process_noise=np.zeros(4), uncertainty=0.0)
            signal = FusionGenerator(of_joint, CYCLE, window=1, adapt=True, hands=target)
            rows = np.array([one.residual[WRIST] for one in play(signal, made)])
        largest.append(float(np.abs(rows[len(rows) // 2 :]).max()))
    assert largest[0] > 2.0 * HELD
    assert largest[1] < 0.25 * largest[0]


def test_an_empty_hand_is_found_empty() -> None:
    of_joint = [MODEL if j in MOVED else None for j in range(JOINTS)]
    target = HandLoads(ROBOT, of_joint, process_noise=np.zeros(4), uncertainty=0.0)
    followed = last_residuals(waved(0.0, 24.0), target)
    assert np.abs(followed).max() < 0.3 * MODEL.max_bound
    assert abs(target.by_arm()["left_arm"].mass) < 0.06


def test_the_observer_reports_the_loads_of_the_hands() -> None:
    made = waved(0.6, 20.0)
    observer = fusion_observer(fusion_model(weight=(1.0, 1.0)), adapt=True)
    empty = observer.hand_loads
    assert empty.keys() == WRISTS.keys()
    for one in made:
        observer.step(one)
    assert observer.hand_loads["left_arm"].mass > 0.2
    observer.reset()
    assert observer.hand_loads == empty
    # Nothing is followed if nothing is to be.
    assert fusion_observer(adapt=False).hand_loads == {}


def test_what_touches_one_joint_of_an_arm_is_no_load_to_the_others() -> None:
    """The elbow is held for long; residuals of the shoulder stay below its thresholds, as those of a load would."""
    bound = MODEL.max_bound
    held = []
    for touched in (False, True):
        made = waved(0.0, 24.0)
        observer = fusion_observer(fusion_model(weight=(1.0, 1.0)), adapt=True)
        for k, one in enumerate(made):
            if touched and 16.0 <= k * CYCLE < 22.0:
                one.measurement.position[MOVED] -= np.array([0.3, 0.3, 3.0]) * bound
            observer.step(one)
        held.append(observer.hand_loads["left_arm"])
    free, after = held
    assert after.mass == pytest.approx(free.mass, abs=0.01)
    assert after.first_moment == pytest.approx(free.first_moment, abs=0.002)
