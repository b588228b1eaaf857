"""Signals, ticks and models made by hand, with known answers."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np

from pepper_driver.backends.fields import Command, Imu, Measurement
from pepper_driver.config import ObserverSettings, load_robot
from pepper_driver.config.arrays import BoolArray, FloatArray
from pepper_driver.controller.tick import Reference, Tick
from pepper_driver.observer.interface import Contact, Observation, Observer
from pepper_driver.observer.models.measured_robot import MeasuredJoint, MeasuredRobot
from pepper_driver.observer.models.model_file import JointModel, ModelKind, ModelSet
from pepper_driver.observer.models.tree import AffineTree, CartTree
from pepper_driver.observer.recording import Recording

ROBOT = load_robot()
CYCLE = ROBOT.cycle
JOINTS = len(ROBOT.joint_names)
THRESHOLD = 0.04
SETTINGS = ObserverSettings(
    tree="affine",
    median_window=11,
    threshold=THRESHOLD,
    fusion_window=5,
    false_contacts=0.1,
    adapt=True,
    collision_factor=3.0,
    merge_gap=0.3,
    rebound_window=0.35,
    update_period=0.12,
)

NORMAL_QUANTILE = 2.5758
"""Quantile 0.99 of the size of standard normal numbers."""

MEDIAN_STD = 0.536
"""Standard deviation of the median of five standard normal numbers."""

SILENT = CartTree(feature=(-1,), threshold=(0.0,), left=(-1,), right=(-1,), value=(0.0,))
"""Expects no tracking error: the residual is the tracking error."""

AFFINE = AffineTree(
    feature=(0, -1, 2, -1, -1),
    threshold=(0.25, 0.0, -1.5, 0.0, 0.0),
    left=(1, -1, 3, -1, -1),
    right=(2, -1, 4, -1, -1),
    coefficients=(
        (0.0, 0.0, 0.0, 0.0),
        (0.1, 2.0, 0.0, 0.5),
        (0.0, 0.0, 0.0, 0.0),
        (-0.3, 1.0, 4.0, 0.0),
        (0.2, 0.0, -1.0, 3.0),
    ),
    lower=(-2.0, -10.0, -5.0),
    upper=(2.0, 10.0, 5.0),
)


def tick(
    index: int,
    error: float | FloatArray = 0.0,
    *,
    features: tuple[float, float, float] = (0.0, 0.0, 0.0),
    limited: Sequence[int] = (),
    age: float = 0.0,
    time: float | None = None,
) -> Tick:
    """A tick whose tracking error is ``error`` [rad], one number or one for each joint."""
    sent = np.linspace(-0.5, 0.5, JOINTS)
    mask = np.zeros(JOINTS, dtype=np.bool_)
    mask[list(limited)] = True
    return Tick(
        measurement=Measurement(
            time=index * CYCLE if time is None else time,
            tick=index,
            position=sent - error,
            current=np.full(JOINTS, 0.2),
            wheel_speed=np.zeros(3),
            imu=Imu(acceleration=np.zeros(3), angular_velocity=np.zeros(3), attitude=np.zeros(3)),
            touch=np.zeros(5),
            bumpers=np.zeros(3),
            buttons=np.zeros(1),
            temperature=np.full(JOINTS, 30.0),
            battery=1.0,
            age=age,
        ),
        reference=Reference(
            position=sent.copy(),
            velocity=np.full(JOINTS, features[0]),
            acceleration=np.full(JOINTS, features[1]),
            load_torque=np.full(JOINTS, features[2]),
            base_twist=np.zeros(3),
        ),
        sent=Command(position=sent, stiffness=np.ones(JOINTS), wheel_speed=np.zeros(3)),
        limited=mask,
    )


def imu(value: float) -> Imu:
    """An inertial unit that shows one value in all of its axes."""
    return Imu(
        acceleration=np.full(3, value),
        angular_velocity=np.full(3, value),
        attitude=np.full(3, value),
    )


def spoilt(one: Tick, part: str, name: str, value: float, joint: int) -> Tick:
    """The same tick with another value of one joint; the first one keeps its own."""
    array = getattr(getattr(one, part), name).copy()
    array[joint] = value
    changes: dict[str, Any] = {part: replace(getattr(one, part), **{name: array})}
    return replace(one, **changes)


def run(target: Observer, made: Sequence[Tick]) -> tuple[list[Observation], list[Contact]]:
    """Observations of all ticks, and their events."""
    observations = [target.step(one) for one in made]
    return observations, [event for one in observations for event in one.contacts]


def same(one: Observation, other: Observation) -> bool:
    """True if two observations have the same events and the same bits."""
    return one.contacts == other.contacts and all(
        np.array_equal(getattr(one, name), getattr(other, name), equal_nan=True)
        for name in ("expected", "residual", "threshold", "torque", "torque_std", "state")
    )


def measured(**joints: MeasuredJoint) -> MeasuredRobot:
    """Facts about a robot: these of its joints, and a link without errors."""
    return MeasuredRobot(
        reported_delay=3,
        delay_error=0,
        delay_spread=(0.0, 0.0),
        late=0.0,
        lost=0.0,
        weight=0.5,
        joints=joints,
    )


def random_ticks(count: int, seed: int) -> list[Tick]:
    """Ticks in which every number is another one."""
    rng = np.random.default_rng(seed)
    made = []
    for k in range(count):
        base = tick(k, age=float(rng.uniform(0.0, 0.05)))
        measurement = replace(
            base.measurement,
            position=rng.normal(size=JOINTS),
            current=rng.uniform(0.0, 2.0, JOINTS),
            wheel_speed=rng.normal(size=3),
            imu=Imu(
                acceleration=rng.normal(size=3),
                angular_velocity=rng.normal(size=3),
                attitude=rng.normal(size=3),
            ),
            touch=np.ones(5),
            battery=0.5,
        )
        reference = Reference(
            position=rng.normal(size=JOINTS),
            velocity=rng.normal(size=JOINTS),
            acceleration=rng.normal(size=JOINTS),
            load_torque=rng.normal(size=JOINTS),
            base_twist=rng.normal(size=3),
        )
        sent = Command(
            position=rng.normal(size=JOINTS),
            stiffness=rng.uniform(0.0, 1.0, JOINTS),
            wheel_speed=rng.normal(size=3),
        )
        limited = rng.uniform(size=JOINTS) < 0.5
        made.append(Tick(measurement=measurement, reference=reference, sent=sent, limited=limited))
    return made


def models(
    by_joint: Mapping[str, JointModel] | JointModel = SILENT,
    *,
    kind: ModelKind = "cart",
    robot: str = ROBOT.name,
    joint_names: tuple[str, ...] = ROBOT.joint_names,
) -> ModelSet:
    """A set of these models, or of one model for every joint."""
    if not isinstance(by_joint, Mapping):
        by_joint = dict.fromkeys(joint_names, by_joint)
    return ModelSet(
        robot=robot,
        joint_names=joint_names,
        identity="plant-0123",
        kind=kind,
        cycle=CYCLE,
        estimation_fit=dict.fromkeys(by_joint, 91.5),
        test_fit=dict.fromkeys(by_joint, 89.25),
        threshold=dict.fromkeys(by_joint, float(np.radians(2.5))),
        version="0.0.0",
        models=by_joint,
    )


def motion(stiffness: float, seed: int, seconds: float) -> FloatArray:
    """(n, 3) velocity, acceleration, load torque of a joint that a posture task sends to random set-points."""
    rng = np.random.default_rng(seed)
    rows = []
    position = velocity = target = 0.0
    change = 0.0
    for k in range(round(seconds / CYCLE)):
        if k * CYCLE >= change:
            target = rng.uniform(-1.2, 1.2)
            change += rng.uniform(1.0, 3.0)
        acceleration = stiffness * (target - position) - 2 * np.sqrt(stiffness) * velocity
        position += velocity * CYCLE + acceleration * CYCLE**2 / 2
        velocity += acceleration * CYCLE
        rows.append((velocity, acceleration, 0.05 * acceleration + 4.0 * np.sin(position)))
    return np.array(rows)


def free_error(features: FloatArray, seed: int, noise: float = 5e-4) -> FloatArray:
    """(n,) tracking error of such a joint: lag, friction of the sign of the velocity, load, noise."""
    velocity, acceleration, load = features.T
    clean = 0.05 * velocity + 0.01 * np.tanh(velocity / 0.02) + 0.002 * acceleration + load / 60.0
    noisy: FloatArray = clean + noise * np.random.default_rng(seed).standard_normal(len(clean))
    return noisy


def recording(
    features: FloatArray,
    error: FloatArray,
    *,
    limited: BoolArray | None = None,
    age: FloatArray | None = None,
) -> Recording:
    """A run in which every joint had these features and this tracking error."""
    n = len(error)

    def all_joints(values: FloatArray) -> FloatArray:
        return np.repeat(values[:, None], JOINTS, axis=1)

    mask = np.zeros(n, dtype=np.bool_) if limited is None else limited
    return Recording(
        joint_names=ROBOT.joint_names,
        time=np.arange(float(n)) * CYCLE,
        sent_position=all_joints(error),
        stiffness=np.ones((n, JOINTS)),
        position=np.zeros((n, JOINTS)),
        reference_position=all_joints(error),
        velocity=all_joints(features[:, 0]),
        acceleration=all_joints(features[:, 1]),
        load_torque=all_joints(features[:, 2]),
        limited=np.repeat(mask[:, None], JOINTS, axis=1),
        current=np.zeros((n, JOINTS)),
        age=np.zeros(n) if age is None else age,
        base_twist=np.zeros((n, 3)),
        sent_wheel_speed=np.zeros((n, 3)),
        wheel_speed=np.zeros((n, 3)),
        linear_acceleration=np.zeros((n, 3)),
        angular_velocity=np.zeros((n, 3)),
        attitude=np.zeros((n, 3)),
    )


def free_run(stiffness: float, seed: int, seconds: float = 20.0) -> Recording:
    """A run of free motion."""
    features = motion(stiffness, seed, seconds)
    return recording(features, free_error(features, seed + 1000))


def check_life(events: Sequence[Contact]) -> None:
    """Assert what holds for the events of any signal."""
    lives: dict[int, list[Contact]] = {}
    for event in events:
        lives.setdefault(event.id, []).append(event)
    for life in lives.values():
        begin, last = life[0], life[-1]
        phases = [event.phase for event in life]
        assert phases[0] == "begin"
        assert set(phases[1:-1]) <= {"update"}
        assert phases[-1] != "begin" or len(life) == 1
        times = [event.time for event in life]
        assert times == sorted(times)
        assert all(event.detection_time == begin.time for event in life)
        assert begin.onset_time <= begin.detection_time <= last.time
        for event in life:
            assert event.joint is not None
            joint = ROBOT.joints[ROBOT.joint_index(event.joint)]
            assert event.link == joint.child
            assert event.intensity_deg > 0
            assert event.torque is None
            assert event.torque_std is None
        for before, after in pairwise(life):
            if (before.joint, before.direction) == (after.joint, after.direction):
                assert after.intensity_deg >= before.intensity_deg
