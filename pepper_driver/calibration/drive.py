"""Parameters of the drives of a plant, and how near a plant comes to the recordings."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from math import inf, log

import numpy as np

from pepper_driver.calibration.calibrate import BenchResult, residual, statistics
from pepper_driver.calibration.testbench import opposite
from pepper_driver.config import (
    Calibration,
    HoldStatistics,
    PlantConfig,
    RobotConfig,
    TrackingTable,
)
from pepper_driver.config.arrays import FloatArray
from pepper_driver.config.plant_parts import Actuator, FrictionParameters, Origin

OF_THE_SAME_MOTOR = {"HeadYaw": "RElbowYaw", "HeadPitch": "RElbowRoll"}
"""Joints without recordings, and the one with the same motor and reduction whose values they get."""

FITTED = ("kp", "ki", "dead_band", "friction.contact")
"""Values of :class:`~.config.plant_parts.Actuator` that calibration sets; ``kd`` keeps its ratio to ``kp`` without a
lead."""


@dataclass(frozen=True, kw_only=True)
class DriveValues:
    """A drive, seen at the joint.

    Attributes:
        stiffness: K = kp N Kt / R [N m/rad].
        friction: Coulomb friction of both sides together while the teeth touch [N m].
        dead_band: [rad] of the board.
        integral_time: kp / ki [s]; infinite without an integral part.
        lead: kd / kp [s]; None for what the plant has.
    """

    stiffness: float
    friction: float
    dead_band: float = 0.0
    integral_time: float = inf
    lead: float | None = None


def torque_constant(robot: RobotConfig, plant: PlantConfig, joint: str) -> float:
    """Return the torque that reaches a joint by the current of its motor, eta N Kt [N m/A]."""
    return plant.actuator(joint).efficiency * robot.motors.joint_torque_constant(joint)


def drag(robot: RobotConfig, plant: PlantConfig, joint: str) -> float:
    """Torque that grows with speed: back-EMF and viscous friction of both sides, teeth touching [N m s/rad]."""
    drive = plant.actuator(joint)
    contact, ratio = drive.friction.contact, robot.motors.joints[joint].ratio
    per_volt = torque_constant(robot, plant, joint) / robot.motors.of(joint).resistance
    back_emf = per_volt * robot.motors.joint_torque_constant(joint)
    viscous = contact.motor_viscous + contact.link_viscous + drive.motor_damping * ratio**2
    return back_emf + viscous


def values_of(robot: RobotConfig, plant: PlantConfig, joint: str) -> DriveValues:
    """Return the values that a joint has in a plant; no lead, so that a drive which takes them keeps its own."""
    drive = plant.actuator(joint)
    volts = robot.motors.of(joint).resistance / torque_constant(robot, plant, joint)
    contact = drive.friction.contact
    return DriveValues(
        stiffness=drive.kp / volts,
        friction=contact.motor + contact.link,
        dead_band=drive.dead_band,
        integral_time=drive.kp / drive.ki if drive.ki else inf,
    )


def values_with_lead(robot: RobotConfig, plant: PlantConfig, joint: str) -> DriveValues:
    """Return the values that a joint has in a plant together with its lead kd / kp."""
    drive = plant.actuator(joint)
    return replace(values_of(robot, plant, joint), lead=drive.kd / drive.kp)


def with_values(
    robot: RobotConfig,
    plant: PlantConfig,
    values: Mapping[str, DriveValues],
    delay: int | None = None,
) -> PlantConfig:
    """Return a plant whose drives have these values, and whose transport takes ``delay`` ticks in all.

    The other arm's drive is the same. Joints in :data:`OF_THE_SAME_MOTOR` follow, but get no integral part. Friction
    keeps the base plant's distribution over motor, link and gap. Of the delay one tick lies on the encoder's side,
    which is assumed.

    Args:
        robot: The robot.
        plant: Source of all other values.
        values: By joint of either arm.
        delay: Ticks; None leaves the transport alone.
    """
    required = dict(values)
    required |= {opposite(name): v for name, v in values.items()}
    for name, other in OF_THE_SAME_MOTOR.items():
        if other in required and required[other].integral_time == inf:
            required[name] = required[other]
    drives = []
    for drive in plant.actuators:
        for name in drive.joints:
            kind: Origin = "computed" if name in OF_THE_SAME_MOTOR else "calibrated"
            changed = drive
            if name in required:
                changed = changed_drive(robot, drive, name, required[name], kind)
            drives.append(replace(changed, joints=(name,)))
    transport = plant.transport
    if delay is not None:
        late = min(delay, 1)
        transport = replace(transport, sensor_delay=late, command_delay=delay - late)
    return replace(plant, actuators=tuple(drives), transport=transport)


def changed_drive(
    robot: RobotConfig, drive: Actuator, joint: str, values: DriveValues, origin: Origin
) -> Actuator:
    """Return the drive of a joint with other values; friction keeps its distribution over motor, link and gap.

    Args:
        robot: The robot.
        drive: Source of all other values.
        joint: Its name.
        values: That it is to have.
        origin: Of these values.
    """
    constant = drive.efficiency * robot.motors.joint_torque_constant(joint)
    kp = values.stiffness * robot.motors.of(joint).resistance / constant
    friction, contact = drive.friction, drive.friction.contact
    fraction = values.friction / (contact.motor + contact.link)
    return replace(
        drive,
        kp=_rounded(kp),
        kd=_rounded(kp * (drive.kd / drive.kp if values.lead is None else values.lead)),
        ki=_rounded(kp / values.integral_time),
        dead_band=_rounded(values.dead_band),
        friction=_scaled(friction, fraction),
        origin=with_origin(drive, origin, FITTED if values.lead is None else (*FITTED, "kd")),
    )


def _scaled(friction: FrictionParameters, fraction: float) -> FrictionParameters:
    """Coulomb friction of both sides times ``fraction``, in the gap and out of it."""
    contact, gap = friction.contact, friction.gap
    return replace(
        friction,
        contact=replace(
            contact,
            motor=_rounded(contact.motor * fraction),
            link=_rounded(contact.link * fraction),
        ),
        gap=replace(gap, motor=_rounded(gap.motor * fraction), link=_rounded(gap.link * fraction)),
    )


def _rounded(value: float) -> float:
    """To four digits, as it stands in a plant file."""
    return float(f"{value:.4g}")


def with_origin(
    drive: Actuator, kind: Origin, values: tuple[str, ...]
) -> dict[Origin, tuple[str, ...]]:
    """Return the origins of a drive's values, those named moved to where they belong."""
    kept = {k: tuple(key for key in keys if key not in values) for k, keys in drive.origin.items()}
    return kept | {kind: values + kept.get(kind, ())}


def plant_text(
    base: PlantConfig, plant: PlantConfig, *, name: str, extends: str, comment: str
) -> str:
    """Return a plant file that says only what calibration changed.

    Args:
        base: What ``plant`` was made from.
        plant: From :func:`with_values`.
        name: Of the plant in the file.
        extends: Name or absolute path of ``base``.
        comment: Lines for the head of the file.
    """
    board = plant.board
    lines = [f"# {line}".rstrip() for line in comment.splitlines()]
    lines += [
        f"name: {json.dumps(name)}",
        f"description: {json.dumps(f'{base.name}, calibrated')}",
        f"extends: {json.dumps(extends)}",
        f"board: {{integral_band: {board.integral_band!r}}}",
        *_section_lines(
            "transport",
            asdict(base.transport),
            asdict(plant.transport),
            "command_delay",
            "sensor_delay",
        ),
        *_section_lines("targets", asdict(base.targets), asdict(plant.targets)),
        *_section_lines("body", asdict(base.body), asdict(plant.body)),
        "joints:",
    ]
    for drive in plant.actuators:
        for joint in drive.joints:
            before = base.actuator(joint)
            if replace(drive, joints=before.joints) != before:
                lines += _drive_lines(joint, before, drive)
    return "\n".join(lines) + "\n"


def _section_lines(
    key: str, base: Mapping[str, object], section: Mapping[str, object], *always: str
) -> list[str]:
    """Return one line with the values of a section that differ from those of ``base``, and those named."""
    changed = {k: v for k, v in section.items() if k in always or v != base[k]}
    return [f"{key}: {json.dumps(changed)}"] if changed else []


def _drive_lines(joint: str, before: Actuator, drive: Actuator) -> list[str]:
    contact, gap = drive.friction.contact, drive.friction.gap
    origin = ", ".join(f"{kind}: [{', '.join(keys)}]" for kind, keys in drive.origin.items())
    keys = ["kp", "ki", "kd", "dead_band"]
    if drive.efficiency != before.efficiency:
        keys.append("efficiency")
    return [
        f"  {joint}:",
        *(f"    {key}: {getattr(drive, key)!r}" for key in keys),
        "    friction:",
        f"      contact: {{motor: {contact.motor!r}, link: {contact.link!r}}}",
        f"      gap: {{motor: {gap.motor!r}, link: {gap.link!r}}}",
        f"    origin: {{{origin}}}",
    ]


HOLD_SCATTER, RESIDUAL_SCATTER, CURRENT_SCATTER = 0.1, 0.02, 0.2
"""Relative standard deviations: of a quantile of 160 holds by its goals, of a table by what the fit leaves open
(assumed), of a current by the gear's unknown efficiency (assumed)."""

ENOUGH = 1.5
"""Room to each target, in standard deviations, beyond which the fit as a whole counts."""


@dataclass(frozen=True, kw_only=True)
class Target:
    """Reference of one drive: the table of a joint of either arm, or none, and statistics of holds."""

    joint: str
    table_joint: str | None
    table: TrackingTable | None
    holds: HoldStatistics
    max_residual: float
    max_factor: float


@dataclass(frozen=True, kw_only=True)
class CalibrationScore:
    """Scores of n sets of values: (n,) margin to the nearest target in standard deviations, sum of squares of all."""

    room: FloatArray
    squares: FloatArray


def targets(calibration: Calibration) -> tuple[Target, ...]:
    """One for each joint with holds; a table counts for the drive of both arms."""
    found, tables = [], calibration.recordings.tables
    for joint, holds in calibration.recordings.holds.items():
        name = next((n for n in (joint, opposite(joint)) if n in tables), None)
        limit = np.radians(calibration.settings.largest_residual_deg[name]) if name else inf
        found.append(
            Target(
                joint=joint,
                table_joint=name,
                table=tables[name] if name else None,
                holds=holds,
                max_residual=float(limit),
                max_factor=calibration.settings.largest_factor,
            )
        )
    return tuple(found)


def shown_of(target: Target, measured: BenchResult) -> tuple[float, HoldStatistics]:
    """Residual [rad] and statistics of holds that a measurement shows of one target."""
    shown = 0.0
    if target.table is not None and target.table_joint is not None:
        shown = residual(measured.tables[target.table_joint], target.table)
    return shown, statistics(measured.holds, target.joint)


def score(
    robot: RobotConfig, target: Target, shown: float, holds: HoldStatistics
) -> CalibrationScore:
    """Score of one measurement, arrays (1,).

    Args:
        robot: The robot.
        target: Statistics to match.
        shown: Residual to the table [rad].
        holds: What the holds show.
    """
    quantiles = np.radians([[holds.median_deg], [holds.p90_deg]])
    return scores(robot, target, np.array([shown]), quantiles, np.array(holds.current)[:, None])


def scores(
    robot: RobotConfig,
    target: Target,
    shown: FloatArray,
    quantiles: FloatArray,
    current: FloatArray,
) -> CalibrationScore:
    """Scores of n sets of values.

    Args:
        robot: The robot.
        target: Statistics to match.
        shown: (n,) residual to the table [rad].
        quantiles: (2, n) median and 90th percentile of the error in holds [rad].
        current: (2, n) the same of the current [A].
    """
    real = np.radians([[target.holds.median_deg], [target.holds.p90_deg]])
    factors = np.log(np.maximum(quantiles, 1e-9) / real)
    room = ((log(target.max_factor) - np.abs(factors)) / HOLD_SCATTER).min(axis=0)
    squares = np.square(factors / HOLD_SCATTER).sum(axis=0)
    if target.table is not None:
        relative = shown / target.max_residual
        room = np.minimum(room, (1.0 - relative) / RESIDUAL_SCATTER)
        squares = squares + np.square(relative)
    if min(target.holds.current) > 0.0:
        ratios = np.log(np.maximum(current, 1e-3) / np.array(target.holds.current)[:, None])
        squares = squares + np.square(ratios / CURRENT_SCATTER).sum(axis=0)
    else:
        squares = squares + np.square(current / robot.sensors.current.step).sum(axis=0)
    return CalibrationScore(room=room, squares=squares)


def pick(room: FloatArray, squares: FloatArray) -> int:
    """Choose the least sum of squares among sets with a margin of :data:`ENOUGH`, or with the largest margin."""
    enough = room >= min(ENOUGH, float(room.max()))
    return int(np.argmin(np.where(enough, squares, inf)))
