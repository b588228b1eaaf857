"""A joint with stick-slip friction in small steps, independent of the stick-slip model, and models of it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from pepper_driver.config.arrays import FloatArray
from pepper_driver.controller.tick import Tick
from pepper_driver.observer.contact_observer import ContactObserver, ObserverParts
from pepper_driver.observer.detection.body_isolation import BASE_LINK, TRUNK_LINK
from pepper_driver.observer.detection.threshold import phase_factors
from pepper_driver.observer.interface import Contact, Observation, Residuals
from pepper_driver.observer.models.fusion_model import (
    OUTPUTS,
    TAPS,
    BaseModel,
    FusionModel,
    MomentumParameters,
    Six,
)
from pepper_driver.observer.models.model_file import ModelSet
from pepper_driver.observer.models.stick_slip import StickSlipParameters
from pepper_driver.observer.recording import Recording
from pepper_driver.observer.residuals.fusion import FusionGenerator, FusionParts
from support.observer import CYCLE, JOINTS, ROBOT, SETTINGS, models, tick

ELBOW = ROBOT.joint_index("LElbowRoll")
BOUND = 0.02
"""[rad] Threshold of :func:`fusion_model`."""
TORQUE_CONSTANT = (
    ROBOT.motors.of("LElbowRoll").torque_constant * ROBOT.motors.joints["LElbowRoll"].ratio
)
ENCODER = 2 * np.pi / 4096
MATRIX: FloatArray = np.asarray(ROBOT.wheels.matrix)
"""(3, 3) from the twist of the base to wheel speeds."""

STICK_SLIP = StickSlipParameters(
    inertia=4e-4,
    lag=0.02,
    friction=0.008,
    load_friction=0.02,
    breakaway=1.3,
    load_gain=0.01,
    offset=0.0,
    dead_band=0.0,
    integral_rate=0.0,
    transport=0.0,
)

PER_AMPERE = STICK_SLIP.load_gain * TORQUE_CONSTANT


def spread_of(bound: float) -> tuple[float, float, float]:
    """Spreads by phase of a model whose thresholds are all ``bound`` [rad]."""
    at_rest, breaking_away, sliding = (bound / phase_factors(SETTINGS.false_contacts)).tolist()
    return at_rest, breaking_away, sliding


def fusion_model(parameters: StickSlipParameters = STICK_SLIP, **changes: Any) -> FusionModel:
    """A model of the joint with exactly these constants."""
    values: dict[str, Any] = {
        "twin": parameters,
        "momentum": MomentumParameters(
            source="current",
            torque_per_ampere=PER_AMPERE,
            inertia=parameters.inertia,
            lag=0.0,  # back-EMF takes no current
            offset=parameters.offset,
        ),
        "spread": spread_of(BOUND),
        "momentum_bound": 0.04,
    }
    return FusionModel(**(values | changes))


MODEL = fusion_model()
VOLTAGE = MomentumParameters(
    source="voltage", torque_per_ampere=0.0, inertia=STICK_SLIP.inertia, lag=0.02, offset=0.0
)
"""Of a joint whose current does not show its torque."""

BY_MODEL, BY_CURRENT = FusionParts(current=False), FusionParts(model=False, law=False)
"""Residual of one channel alone."""

ALL_JOINTS, NO_JOINT = np.ones(JOINTS, dtype=np.bool_), np.zeros(JOINTS, dtype=np.bool_)


def six(values: object) -> Six:
    """One number, or six, for the outputs of the base."""
    a, b, c, d, e, f = np.broadcast_to(np.asarray(values, dtype=np.float64), len(OUTPUTS)).tolist()
    return a, b, c, d, e, f


def still_base(
    still: object, moving: object = None, shaking: object = None, driving: object = None
) -> BaseModel:
    """A model that expects a base that does not move, with these spreads; by default that of a base at rest."""
    phases = [still if spread is None else spread for spread in (still, moving, shaking, driving)]
    at_rest, in_motion, shaken, driven = map(six, phases)
    return BaseModel(
        coefficients=(six(0.0),) * (TAPS * 6),
        still=at_rest,
        moving=in_motion,
        shaking=shaken,
        driving=driven,
    )


def fusion_set(
    by_joint: Mapping[str, FusionModel] | FusionModel = MODEL, base: BaseModel | None = None
) -> ModelSet:
    return replace(models(by_joint, kind="fusion"), base=base)


def fusion_observer(
    model: FusionModel = MODEL,
    *,
    adapt: bool = False,
    base: BaseModel | None = None,
    parts: FusionParts | None = None,
) -> ContactObserver:
    """An observer with this model of every joint."""
    settings = replace(SETTINGS, adapt=adapt)
    return ContactObserver(
        ROBOT,
        fusion_set(model, base),
        settings,
        parts=ObserverParts(residual=parts or FusionParts()),
    )


def fusion_generator(
    model: FusionModel = MODEL, *, adapt: bool = False, **more: Any
) -> FusionGenerator:
    """A generator with this model of every joint; each joint is judged alone if ``limbs`` are not given."""
    return FusionGenerator(
        [model] * JOINTS,
        CYCLE,
        window=SETTINGS.fusion_window,
        false_contacts=SETTINGS.false_contacts,
        adapt=adapt,
        **more,
    )


@dataclass(frozen=True, kw_only=True)
class Motion:
    """Command of one joint; arrays (n,) by tick."""

    position: FloatArray
    velocity: FloatArray
    acceleration: FloatArray
    load: FloatArray

    def __len__(self) -> int:
        return len(self.position)


def swing(
    seconds: float,
    size: float = 0.3,
    rate: float = 2.0,
    *,
    rest: float = 0.0,
    gravity: float = 0.8,
    shape: float = 0.35,
) -> Motion:
    """A swing of two rates that comes back to where it began, and rests there for ``rest`` [s]."""
    time = np.arange(round(seconds / CYCLE)) * CYCLE
    swung = size * (1 - np.cos(rate * time) + shape * (1 - np.cos(2.7 * rate * time))) / 2
    home = min(1.2, seconds / 3)
    part = np.clip((seconds - time) / home, 0.0, 1.0)
    position = np.concatenate(
        (swung * part**3 * (10 - 15 * part + 6 * part**2), np.zeros(round(rest / CYCLE)))
    )
    velocity = np.gradient(position, CYCLE)
    acceleration = np.gradient(velocity, CYCLE)
    load = gravity * np.sin(position + 0.4) + 0.03 * acceleration
    return Motion(position=position, velocity=velocity, acceleration=acceleration, load=load)


def standing(seconds: float, load: float = 0.0) -> Motion:
    nothing = np.zeros(round(seconds / CYCLE))
    return Motion(
        position=nothing, velocity=nothing, acceleration=nothing, load=np.full(len(nothing), load)
    )


@dataclass(frozen=True, kw_only=True)
class Driven:
    """Answer of the joint; arrays (n,) by tick."""

    position: FloatArray
    motor: FloatArray
    """Torque / K, back-EMF taken off [rad]."""


def drive(
    motion: Motion,
    parameters: StickSlipParameters = STICK_SLIP,
    *,
    torque: FloatArray | float = 0.0,
    start: float | None = None,
    steps: int = 60,
    derivative: float = 0.0,
    limit: float = np.inf,
) -> Driven:
    """Coulomb friction with breakaway, explicit, in steps of 0.2 ms; commands and loads run straight between ticks.

    Args:
        motion: Its command.
        parameters: Its constants.
        torque: From outside, by tick [N m].
        start: Where it stands at first [rad], by default at its goal.
        steps: In a tick.
        derivative: Time of the derivative that the board adds to its error [s].
        limit: Largest torque / K that the board gives, back-EMF taken off [rad].
    """
    gain, h = parameters.load_gain, CYCLE / steps
    outside = np.broadcast_to(torque, len(motion))
    q = float(motion.position[0]) if start is None else start
    v = integral = 0.0
    sticks = True
    positions, motors = [], []
    goal_then, load_then, outside_then = motion.position[0], motion.load[0], outside[0]
    for goal_now, load_now, outside_now in zip(
        motion.position.tolist(), motion.load.tolist(), outside.tolist(), strict=True
    ):
        for step in range(1, steps + 1):
            part = step / steps
            error = goal_then + part * (goal_now - goal_then) - q
            pull = error - min(max(error, -parameters.dead_band), parameters.dead_band)
            load = gain * (load_then + part * (load_now - load_then)) + parameters.offset
            hand = gain * (outside_then + part * (outside_now - outside_then))
            size = parameters.friction + parameters.load_friction * abs(load)
            lead = derivative * ((goal_now - goal_then) / CYCLE - v)
            motor = min(max(pull + lead + integral - parameters.lag * v, -limit), limit)
            net = motor - load + hand
            integral += h * parameters.integral_rate * pull
            if sticks:
                if abs(net) <= parameters.breakaway * size:
                    continue
                sticks = False
                v = h * (net - np.sign(net) * size) / parameters.inertia
            else:
                new = v + h * (net - np.sign(v) * size) / parameters.inertia
                sticks = new * v <= 0.0
                v = 0.0 if sticks else new
            q += h * v
        positions.append(q)
        motors.append(motor)
        goal_then, load_then, outside_then = goal_now, load_now, outside_now
    return Driven(position=np.array(positions), motor=np.array(motors))


def followed(command: FloatArray, speed: float) -> FloatArray:
    """A target that runs after the command no faster than this [rad/s]."""
    target, reach = command.copy(), speed * CYCLE
    for k in range(1, len(command)):
        target[k] = target[k - 1] + np.clip(command[k] - target[k - 1], -reach, reach)
    return target


def guided(
    motion: Motion,
    *,
    side: float,
    speed: float,
    far: float,
    begin: float,
    seconds: float,
    limit: float,
) -> Driven:
    """A hand takes the joint along, stronger than its board, holds it there, and brings it back.

    Args:
        motion: Its command, at rest.
        side: Where to, 1 or -1.
        speed: Of the hand [rad/s].
        far: How far it goes [rad].
        begin: [s]
        seconds: From the begin until it comes back.
        limit: Largest torque / K that the board gives, back-EMF taken off [rad].
    """
    time = np.arange(len(motion)) * CYCLE - begin
    way = np.clip(time * speed, 0.0, far) - np.clip((time - seconds) * speed, 0.0, far)
    position = motion.position + side * way - STICK_SLIP.load_gain * motion.load
    velocity = np.gradient(position, CYCLE)
    motor = np.clip(motion.position - position - STICK_SLIP.lag * velocity, -limit, limit)
    return Driven(position=position, motor=motor)


def quantised(position: FloatArray) -> FloatArray:
    rounded: FloatArray = np.round(position / ENCODER) * ENCODER
    return rounded


def ticks_of(
    motion: Motion,
    driven: Driven,
    joint: int = ELBOW,
    *,
    limited: Sequence[int] = (),
    stiffness: FloatArray | None = None,
    late: Sequence[int] | None = None,
) -> list[Tick]:
    """Ticks of a robot whose other joints rest at their goals.

    Args:
        motion: What the joint shall do.
        driven: What it did.
        joint: Its index.
        limited: Ticks whose command the gate has altered.
        stiffness: (n,) of the joint.
        late: By tick, by how many ticks the sample is late.
    """
    made = []
    position, current = quantised(driven.position), np.abs(driven.motor) / PER_AMPERE
    for k in range(len(motion)):
        seen = k if late is None else max(k - late[k], 0)
        one = tick(
            k,
            limited=(joint,) if k in limited else (),
            age=0.0 if late is None else late[k] * CYCLE,
        )
        one.sent.position[joint] = motion.position[k]
        one.reference.position[joint] = motion.position[k]
        one.reference.velocity[joint] = motion.velocity[k]
        one.reference.acceleration[joint] = motion.acceleration[k]
        one.reference.load_torque[joint] = motion.load[k]
        one.measurement.position[joint] = position[seen]
        one.measurement.current[:] = 0.0
        one.measurement.current[joint] = current[seen]
        if stiffness is not None:
            one.sent.stiffness[joint] = stiffness[k]
        made.append(one)
    return made


def with_target_drift(motion: Motion, offset: FloatArray | float) -> list[Tick]:
    """Ticks of a joint whose board follows another target than the command, off by (n,) [rad]."""
    other = replace(motion, position=motion.position + offset)
    ticks = ticks_of(other, drive(other, start=float(other.position[0])))
    for one, position in zip(ticks, motion.position, strict=True):
        one.sent.position[ELBOW] = one.reference.position[ELBOW] = position
    return ticks


def recording_of(motion: Motion, driven: Driven, joint: int = ELBOW) -> Recording:
    """The same as a recording."""
    n = len(motion)

    def column(values: FloatArray) -> FloatArray:
        array = np.zeros((n, JOINTS))
        array[:, joint] = values
        return array

    triple = np.zeros((n, 3))
    return Recording(
        joint_names=ROBOT.joint_names,
        time=np.arange(float(n)) * CYCLE,
        age=np.zeros(n),
        sent_position=column(motion.position),
        stiffness=np.ones((n, JOINTS)),
        limited=np.zeros((n, JOINTS), dtype=np.bool_),
        position=column(quantised(driven.position)),
        current=column(np.abs(driven.motor) / PER_AMPERE),
        reference_position=column(motion.position),
        velocity=column(motion.velocity),
        acceleration=column(motion.acceleration),
        load_torque=column(motion.load),
        base_twist=triple,
        sent_wheel_speed=triple,
        wheel_speed=triple,
        linear_acceleration=triple,
        angular_velocity=triple,
        attitude=triple,
    )


def play(signal: FusionGenerator, ticks: Sequence[Tick]) -> list[Residuals]:
    """Signals of a robot that nothing touches."""
    signals = []
    for one in ticks:
        signals.append(signal.step(one))
        signal.learn(ALL_JOINTS, NO_JOINT, True)
    return signals


def touched(index: int, *, base: float = 0.0, **ratios: float) -> Tick:
    """A tick in which hands push joints off their commands, and their motors against that.

    Args:
        index: Of the tick.
        base: Speed that its wheels show [m/s].
        **ratios: By joint, its error over BOUND.
    """
    error = np.zeros(JOINTS)
    for name, ratio in ratios.items():
        error[ROBOT.joint_index(name)] = ratio * BOUND
    one = tick(index, error)
    one.measurement.current[:] = np.abs(error) / PER_AMPERE
    one.measurement.wheel_speed[:] = MATRIX @ np.array([base, 0.0, 0.0])
    return one


def of_elbow(observations: Sequence[Observation], name: str) -> FloatArray:
    """One value of all observations, of the elbow."""
    return np.array([getattr(one, name)[ELBOW] for one in observations])


def push_profile(
    n: int, begin: float, seconds: float, torque: float, rise: float = 0.1
) -> FloatArray:
    """(n,) torque that rises, stays and falls [N m]."""
    time = np.arange(n) * CYCLE
    up = np.clip((time - begin) / rise, 0.0, 1.0)
    down = np.clip((begin + seconds - time) / rise, 0.0, 1.0)
    profile: FloatArray = torque * np.minimum(up, down)
    return profile


LATER_KINDS = {
    "contact": ("contact", "collision", "push", "tap", "double tap"),
    "push": ("push", "hold"),
}
"""Kinds that a contact may have after this one; one of another kind keeps it."""


def check_lives(events: list[Contact]) -> None:
    """Assert what holds for the events of mode ``fusion`` in any run that ends quietly."""
    lives: dict[int, list[Contact]] = {}
    open_on: dict[str, int] = {}
    for event in events:
        life = lives.setdefault(event.id, [])
        limb = event.limb
        if event.phase == "begin":
            assert life == []
            assert limb not in open_on
            assert event.time == event.detection_time
        else:
            assert life
            assert life[-1].phase != "end"
            assert event.detection_time == life[0].detection_time
            assert event.time >= life[-1].time
            # It moves from the trunk to a limb, never back, nor to another limb.
            before = life[-1].limb
            assert open_on.pop(before) == event.id
            assert before in (limb, "trunk")
        if event.phase != "end":
            assert limb not in open_on
            open_on[limb] = event.id
        assert event.limb == ROBOT.limb_of(event.joint)
        assert event.onset_time <= event.detection_time
        assert event.intensity_deg >= 0
        if event.joint is None:
            assert event.link in (TRUNK_LINK, BASE_LINK)
        else:
            chain = [ROBOT.joints[ROBOT.joint_index(name)].child for name in ROBOT.limbs[limb]]
            assert event.link in chain
            assert event.intensity_deg > 0
        if life:
            assert event.kind in LATER_KINDS.get(life[-1].kind, (life[-1].kind,))
            assert event.phase == "end" or event.kind not in ("tap", "double tap")
        life.append(event)
    assert open_on == {}
    assert list(lives) == list(range(1, len(lives) + 1))
