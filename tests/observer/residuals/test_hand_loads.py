"""Loads of the hands, against Pinocchio with bodies put on the wrists."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest

from pepper_driver.config.arrays import FloatArray
from pepper_driver.controller.model import RobotModel
from pepper_driver.controller.tick import Tick
from pepper_driver.observer.constants import (
    CORRECTION_TIME,
    HELD_FACTOR,
    LOAD_MASS_STD,
    LOAD_PLACE_STD,
    PUSH_TICKS,
    QUIET_RATIO,
    UNSURE_FACTOR,
)
from pepper_driver.observer.interface import HandLoad
from pepper_driver.observer.residuals.fusion import FusionParts
from pepper_driver.observer.residuals.hand_loads import MAX_MASS, HandLoads
from support.fusion import (
    BOUND,
    MODEL,
    drive,
    fusion_model,
    fusion_observer,
    spread_of,
    standing,
    swing,
    ticks_of,
)
from support.observer import CYCLE, JOINTS, ROBOT

WRISTS = {"left_arm": "LWristYaw", "right_arm": "RWristYaw"}
ARM = [ROBOT.joint_index(name) for name in ROBOT.limbs["left_arm"][:5]]
MIDDLE = 0.5 * (
    np.array([j.lower for j in ROBOT.joints]) + np.array([j.upper for j in ROBOT.joints])
)
GAIN = np.full(JOINTS, MODEL.twin.load_gain)
THRESHOLD = np.full(JOINTS, BOUND)
MASS, PLACE = 0.4, np.array([0.07, -0.01, -0.025])
ALL = np.ones(JOINTS, dtype=np.bool_)
PLAIN = RobotModel(ROBOT)


def loaded(joint: str, inertia: pin.Inertia) -> RobotModel:
    """The robot with an inertia fixed to the link of a joint."""
    model = RobotModel(ROBOT)
    number = model.pin.getJointId(joint)
    model.pin.inertias[number] = model.pin.inertias[number] + inertia
    return model


def point(mass: float, place: FloatArray) -> pin.Inertia:
    """A mass at one point: about the origin of its link it has an inertia."""
    return pin.Inertia(mass, place, np.zeros((3, 3)))


def about_origin(mass: float, place: FloatArray) -> pin.Inertia:
    """Nothing but the inertia that such a point has about the origin of its link."""
    cross = pin.skew(place)
    return pin.Inertia(0.0, np.zeros(3), -mass * cross @ cross)


def torque(
    model: RobotModel, position: FloatArray, velocity: FloatArray, acceleration: FloatArray
) -> FloatArray:
    return model.load_torque(
        model.configuration(position), model.of_joints(velocity), model.of_joints(acceleration)
    )


def waving(seconds: float) -> list[tuple[FloatArray, FloatArray, FloatArray]]:
    """Position, velocity and acceleration (17,) by tick of a left arm that waves, each joint at its own rate."""
    size, rate = np.zeros(JOINTS), np.zeros(JOINTS)
    size[ARM], rate[ARM] = 0.5, np.linspace(1.1, 2.9, len(ARM))
    angles = [rate * k * CYCLE + np.arange(JOINTS) for k in range(round(seconds / CYCLE))]
    return [
        (
            MIDDLE + size * np.sin(angle),
            size * rate * np.cos(angle),
            -size * rate**2 * np.sin(angle),
        )
        for angle in angles
    ]


def follow(
    target: HandLoads, seconds: float, mass: float, *, joints: list[int] = ARM, noise: float = 0.0
) -> list[float]:
    """Errors of the predicted torque [N m] of an arm whose residuals are those of a load; all others are 0."""
    rng, load, use, errors = (
        np.random.default_rng(0),
        loaded("LWristYaw", point(mass, PLACE)),
        ~ALL,
        [],
    )
    use[joints] = True
    for q, v, a in waving(seconds):
        target.step(q, v, a)
        missing = torque(load, q, v, a) - torque(PLAIN, q, v, a) - target.torque
        errors.append(float(np.abs(missing[ARM]).max()))
        residual = GAIN * missing + noise * rng.standard_normal(JOINTS)
        target.learn(residual, THRESHOLD, use)
    return errors


def unknown(load: HandLoad) -> bool:
    """As at the start."""
    return load.mass == 0.0 and load.mass_std == pytest.approx(LOAD_MASS_STD)


@pytest.mark.parametrize("joint", WRISTS.values())
def test_torques_of_a_body_lack_only_its_inertia_about_the_joint(joint: str) -> None:
    rng = np.random.default_rng(1)
    for _ in range(20):
        state = (*rng.uniform(-1.5, 1.5, (2, JOINTS)), rng.uniform(-9.0, 9.0, JOINTS))
        mass, place = float(rng.uniform(0.1, 2.0)), rng.uniform(-0.2, 0.2, 3)
        [by_quantity] = PLAIN.body_torques([joint], *state)
        whole, left_out = (loaded(joint, of(mass, place)) for of in (point, about_origin))
        expected = torque(whole, *state) - torque(left_out, *state)
        got = by_quantity @ np.array([mass, *(mass * place)])
        np.testing.assert_allclose(got, expected, rtol=1e-9, atol=1e-9)


def test_the_load_of_an_arm_that_moves_is_found_within_seconds() -> None:
    target = HandLoads(ROBOT, GAIN)
    assert {arm: unknown(load) for arm, load in target.by_limb.items()} == dict.fromkeys(
        WRISTS, True
    )
    errors = follow(target, 10.0, MASS, noise=0.2 * BOUND)
    held = target.by_limb["left_arm"]
    assert held.mass == pytest.approx(MASS, abs=0.05)
    assert held.mass_std < 0.4 * LOAD_MASS_STD
    # Of 1.7 N m that the load takes at the shoulder.
    assert max(errors[:100]) > 0.8
    assert max(errors[-200:]) < 0.2
    # The other hand has not shown anything.
    assert unknown(target.by_limb["right_arm"])


def test_its_first_update_is_that_of_ridge_regression() -> None:
    """Least squares with the prior as penalty, each residual with the noise of its threshold."""
    target = HandLoads(ROBOT, GAIN)
    q, v, a = waving(2 * CYCLE)[1]
    hand = PLAIN.joint_origin("LHand")
    around = np.diag([0.0, *(3 * [LOAD_PLACE_STD**2])])
    prior = LOAD_MASS_STD**2 * (np.outer([1.0, *hand], [1.0, *hand]) + around)
    residual = GAIN * (
        torque(loaded("LWristYaw", point(0.1, PLACE)), q, v, a) - torque(PLAIN, q, v, a)
    )
    while target.by_limb["left_arm"].mass == 0.0:
        target.step(q, v, a)
        target.learn(residual, THRESHOLD, ALL)
    effect = GAIN[ARM, None] * PLAIN.body_torques(["LWristYaw"], q, v, a)[0][ARM]
    precision = np.linalg.inv(prior) + effect.T @ effect / BOUND**2
    expected = np.linalg.solve(precision, effect.T @ residual[ARM] / BOUND**2)
    assert target.by_limb["left_arm"].mass == pytest.approx(expected[0], rel=1e-6)
    # The torques have all four numbers, at once.
    np.testing.assert_allclose(target.torque[ARM], effect @ expected / GAIN[ARM], rtol=1e-6)


def test_an_object_that_is_put_down_is_forgotten() -> None:
    target = HandLoads(ROBOT, GAIN)
    follow(target, 60.0, MASS)
    follow(target, 60.0, 0.0)
    assert target.by_limb["left_arm"].mass < 0.1


def test_a_hand_holds_no_less_than_nothing_and_is_never_less_certain_than_at_the_start() -> None:
    target = HandLoads(ROBOT, GAIN)
    for q, v, a in waving(10.0):
        target.step(q, v, a)
        lifted = torque(loaded("LWristYaw", point(MASS, PLACE)), q, v, a) - torque(PLAIN, q, v, a)
        target.learn(-GAIN * lifted, THRESHOLD, ALL)
        held = target.by_limb["left_arm"]
        assert held.mass >= -1e-9
        assert held.mass_std <= LOAD_MASS_STD * (1.0 + 1e-9)


def test_no_hand_holds_more_than_a_kilogram() -> None:
    target = HandLoads(ROBOT, GAIN)
    follow(target, 60.0, 4.0)
    assert target.by_limb["left_arm"].mass == pytest.approx(MAX_MASS)


def test_joints_that_do_not_slide_teach_nothing() -> None:
    target = HandLoads(ROBOT, GAIN)
    follow(target, 5.0, MASS, joints=[])
    assert unknown(target.by_limb["left_arm"])


def test_what_is_not_known_of_a_load_is_a_doubt_of_each_joint_and_shrinks() -> None:
    target = HandLoads(ROBOT, GAIN)
    first = waving(1.0)
    for q, v, a in first:
        target.step(q, v, a)
    shoulder = ROBOT.joint_index("LShoulderPitch")
    # At rest in the middle of its ranges, one standard deviation at the hand.
    hand = torque(
        loaded("LWristYaw", point(LOAD_MASS_STD, PLAIN.joint_origin("LHand"))), *first[-1]
    )
    expected = GAIN[shoulder] * abs(hand - torque(PLAIN, *first[-1]))[shoulder]
    before = target.doubt[shoulder]
    assert before == pytest.approx(expected, rel=0.15)
    follow(target, 10.0, 0.0)
    assert target.doubt[shoulder] < 0.3 * before
    assert not target.doubt[ROBOT.joint_index("HeadYaw")]


def test_reset_returns_to_hands_that_are_not_known() -> None:
    target = HandLoads(ROBOT, GAIN)
    follow(target, 5.0, MASS)
    target.reset()
    assert unknown(target.by_limb["left_arm"])
    assert not target.torque.any()


# -- in the observer ------------------------------------------------------------------------------------------------


def test_a_limp_joint_is_where_it_is_measured_and_not_where_it_is_sent(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    asked: list[tuple[FloatArray, FloatArray]] = []

    def step(self: HandLoads, position: FloatArray, velocity: FloatArray, _: FloatArray) -> None:
        asked.append((position.copy(), velocity.copy()))

    monkeypatch.setattr(HandLoads, "step", step)
    target, elbow = fusion_observer(adapt=True), ROBOT.joint_index("LElbowRoll")
    [one] = resting_ticks(CYCLE)
    one.reference.velocity[:] = 0.5
    one.measurement.position[elbow] = one.sent.position[elbow] + 0.4
    for stiffness in (1.0, 0.0):
        one.sent.stiffness[elbow] = stiffness
        target.step(one)
    (followed, fast), (limp, still) = asked
    assert followed[elbow] == one.sent.position[elbow]
    assert limp[elbow] == one.measurement.position[elbow]
    assert (fast[elbow], still[elbow]) == (0.5, 0.0)
    pitch = ROBOT.joint_index("LShoulderPitch")
    assert (limp[pitch], still[pitch]) == (one.sent.position[pitch], 0.5)


def with_load(mass: float, seconds: float, *, empty: float = 0.0) -> list[Tick]:
    """Ticks of a left shoulder that swings with a load that its reference does not have.

    The hand is empty at first for ``empty`` seconds, and takes the load within PUSH_TICKS.
    """
    shoulder = ROBOT.joint_index("LShoulderPitch")
    motion = swing(empty + seconds, size=0.4, rate=2.0)
    position, zero = np.zeros(JOINTS), np.zeros(JOINTS)
    begin = round(empty / CYCLE)
    taken = mass * np.interp(np.arange(len(motion)), [begin - 1, begin + PUSH_TICKS], [0.0, 1.0])
    if not empty:
        taken[:] = mass
    load = []
    for angle, now in zip(motion.position, taken, strict=True):
        position[shoulder] = angle
        [by_quantity] = PLAIN.body_torques(["LWristYaw"], position, zero, zero)
        load.append(by_quantity[shoulder] @ np.array([now, *(now * PLACE)]))
    moved = replace(motion, load=np.array(load))
    made = ticks_of(moved, drive(moved, MODEL.twin), joint=shoulder)
    for one in made:
        one.reference.load_torque[shoulder] = 0.0
    return made


def resting_ticks(seconds: float, begin: float = 0.0) -> list[Tick]:
    motion = standing(seconds)
    made = ticks_of(motion, drive(motion, MODEL.twin), joint=ROBOT.joint_index("LShoulderPitch"))
    return [
        replace(one, measurement=replace(one.measurement, time=begin + k * CYCLE))
        for k, one in enumerate(made)
    ]


# 0.5 kg: 2 N m at the shoulder, of which a board shows 0.02 rad. The other joints do not show it.
SENSITIVE = fusion_model(spread=spread_of(0.015))


def test_a_load_that_no_model_knows_is_no_contact_and_is_reported() -> None:
    made = with_load(0.5, 20.0)
    target = fusion_observer(SENSITIVE, adapt=True)
    fixed = fusion_observer(SENSITIVE, adapt=True, parts=FusionParts(loads=False))
    contacts, without = 0, 0
    for one in made:
        seen = target.step(one)
        contacts += len(seen.contacts)
        without += len(fixed.step(one).contacts)
    assert contacts == 0
    assert without > 0
    assert target.hand_loads["left_arm"].mass > 0.25
    assert abs(seen.residual[ROBOT.joint_index("LShoulderPitch")]) < QUIET_RATIO * BOUND
    assert fixed.hand_loads == {}


def test_a_light_load_that_is_taken_later_is_learned() -> None:
    target = fusion_observer(SENSITIVE, adapt=True)
    for one in with_load(0.25, 30.0, empty=30.0):
        assert not target.step(one).contacts
    assert target.hand_loads["left_arm"].mass > 0.1


def test_a_load_that_is_taken_later_is_a_touch_until_a_reset() -> None:
    """Weight is a lasting force, as of a hand."""
    made = with_load(0.5, 30.0, empty=30.0)
    target = fusion_observer(SENSITIVE, adapt=True)
    contacts = [c for one in made for c in target.step(one).contacts if c.phase != "update"]
    assert 30.0 < contacts[0].time < 30.5
    assert contacts[-1].time > 50.0
    # What it learned is from the moment in which the hand took it.
    assert target.hand_loads["left_arm"].mass < 0.25
    target.reset()
    assert not [c for one in made[round(30.0 / CYCLE) :] for c in target.step(one).contacts]
    assert target.hand_loads["left_arm"].mass > 0.25


def test_joints_that_slide_doubt_the_load_from_the_first_second() -> None:
    made = with_load(0.0, 1.0)
    shoulder = ROBOT.joint_index("LShoulderPitch")
    target, still = fusion_observer(adapt=True), fusion_observer(adapt=True)
    widest = max(target.step(one).threshold[shoulder] for one in made)
    position, zero = np.zeros(JOINTS), np.zeros(JOINTS)
    [by_quantity] = PLAIN.body_torques(["LWristYaw"], position, zero, zero)
    hand = LOAD_MASS_STD * np.array([1.0, *PLAIN.joint_origin("LHand")])
    doubt = GAIN[shoulder] * abs(by_quantity[shoulder] @ hand)
    # Its first motion has shown a part of it already.
    assert widest - BOUND > 0.6 * UNSURE_FACTOR * doubt
    assert widest - HELD_FACTOR * BOUND < UNSURE_FACTOR * doubt
    # At rest it does not: it rests where the load has taken it.
    rests = [still.step(one).threshold[shoulder] for one in resting_ticks(1.0)]
    np.testing.assert_allclose(rests, BOUND, rtol=5e-3)


def test_a_joint_that_stops_doubts_the_load_until_its_model_has_settled() -> None:
    shoulder = ROBOT.joint_index("LShoulderPitch")
    target = fusion_observer(adapt=True)
    for one in with_load(0.0, 2.0):
        target.step(one)
    seconds = CORRECTION_TIME + 1.0
    found = np.array([target.step(one).threshold[shoulder] for one in resting_ticks(seconds, 2.0)])
    doubts = found > 1.1 * BOUND
    assert doubts[: round(0.9 * CORRECTION_TIME / CYCLE)].all()
    assert not doubts[round((CORRECTION_TIME + 0.5) / CYCLE) :].any()


def test_a_joint_at_rest_doubts_the_load_while_its_arm_moves() -> None:
    """A wrist that is held is turned by its load when the forearm turns."""
    wrist, other = ROBOT.joint_index("LWristYaw"), ROBOT.joint_index("RWristYaw")
    target = fusion_observer(adapt=True)
    first = target.step(with_load(0.0, 0.1)[0]).threshold[wrist]
    seen = [target.step(one).threshold for one in with_load(0.0, 1.0)[1:]]
    assert max(threshold[wrist] for threshold in seen) > 1.05 * first
    # The load of the other hand pulls at nothing.
    np.testing.assert_allclose([threshold[other] for threshold in seen], first, rtol=5e-3)
    after = [target.step(one).threshold[wrist] for one in resting_ticks(CORRECTION_TIME + 1.0, 1.0)]
    assert after[-1] == pytest.approx(first, rel=0.01)
