"""Free motion in recordings of real Peppers, and the comparison with simulated ones."""

from __future__ import annotations

from dataclasses import dataclass as plain_dataclass
from pathlib import Path
from typing import Annotated

import numpy as np
from pydantic import Field
from pydantic.dataclasses import dataclass

from pepper_driver.config.arrays import FloatArray
from pepper_driver.config.errors import ConfigError
from pepper_driver.config.experiment import load_experiment
from pepper_driver.config.lines import with_lines
from pepper_driver.config.loading import STRICT, load, own_or_shipped, package_file
from pepper_driver.config.parts import NonNegative, Positive
from pepper_driver.config.robot import RobotConfig
from pepper_driver.config.steps import Holds

Count = Annotated[int, Field(ge=1)]


@dataclass(frozen=True, kw_only=True, config=STRICT)
class TrackingTable:
    """Tracking error of one joint in free motion.

    ``velocity`` (columns) [rad/s] and ``torque`` (rows) [N m] are the desired ones; ``expected_error_deg`` is command
    minus measurement.
    """

    velocity: tuple[float, ...]
    torque: tuple[float, ...]
    expected_error_deg: tuple[tuple[float, ...], ...]

    @property
    def moving(self) -> tuple[float, ...]:
        """The velocities other than 0 [rad/s], in order: at 0 the error depends on where the joint came from."""
        return tuple(v for v in self.velocity if v != 0.0)

    @property
    def error(self) -> FloatArray:
        """(torques, moving velocities) expected error [rad]."""
        # At rest friction holds the joint where it stopped: its error depends on the motion before.
        columns = np.array(self.velocity) != 0.0
        return np.asarray(np.radians(np.array(self.expected_error_deg)[:, columns]))


@dataclass(frozen=True, kw_only=True, config=STRICT)
class HoldStatistics:
    """Error and current of one joint at the end of holds.

    Median, 90th percentile and maximum of the absolute error, 5th, 50th and 95th percentile of the signed one [deg];
    median and 90th percentile of the ``current`` [A].
    """

    median_deg: Positive
    p90_deg: Positive
    max_deg: Positive
    signed_deg: tuple[float, float, float]
    current: tuple[NonNegative, NonNegative]


@dataclass(frozen=True, kw_only=True, config=STRICT)
class ChaseResults:
    """Results of one joint under the commands as recorded; None where a recording has none.

    At the ends of holds: median, 90th percentile and maximum of the absolute error [deg]; fractions of holds that end
    ``short`` of the goal and ``beyond`` it; R2 of the error by the side of approach, by gravity, and by the current
    with the sign of the error; ``droop_deg`` [deg/(N m)] of gravity as the URDF has it; ``gravity_torque``, the motor's
    torque by current and documented constant [N m/(N m)]; fraction of holds whose error is ``without_current`` that
    works against it; median and 90th percentile of the current [A]. From command to ``current_onset_ms`` and
    ``encoder_onset_ms``; fraction of still joints whose current is seen to ``creep`` (real: 10 to 17 holds of a joint,
    over 2 s; simulated: over the last 1.5 s); noise at rest [mdeg], [mA]. In motion: ``rms_deg`` of the error, not
    aligned in time; median and 90th percentile of the speed of a joint far behind, and the largest of any [rad/s].
    """

    median_deg: float | None
    p90_deg: float | None
    max_deg: float | None
    short: float | None
    beyond: float | None
    r2_side: float | None
    r2_gravity: float | None
    r2_current: float | None
    droop_deg: float | None
    gravity_torque: float | None
    without_current: float | None
    current_median: float | None
    current_p90: float | None
    current_onset_ms: float | None
    encoder_onset_ms: float | None
    creep: float | None
    encoder_noise_mdeg: float | None
    current_noise_ma: float | None
    rms_deg: float | None
    chase_speed: float | None
    chase_speed_p90: float | None
    max_speed: float | None


@dataclass(frozen=True, kw_only=True, config=STRICT)
class Chases:
    """Recordings of fast commands to random goals: ``figures`` by joint.

    ``stiffness`` [N m/rad] by joint is the one by which errors without current were counted.
    """

    stiffness: dict[str, Positive]
    figures: dict[str, ChaseResults]


@dataclass(frozen=True, kw_only=True, config=STRICT)
class ReferenceData:
    """Recorded values, by joint; see ``recordings.yaml`` for the sources. ``hold_time`` in [s]."""

    tables: dict[str, TrackingTable]
    hold_count: Count
    hold_time: Positive
    holds: dict[str, HoldStatistics]
    chases: Chases


@dataclass(frozen=True, kw_only=True, config=STRICT)
class RampProtocol:
    """Ramps of one joint under constant load; see ``calibration.yaml`` for the meaning of each key."""

    arrival: Positive
    arrival_time: Positive
    onwards: bool
    wait: NonNegative
    time: Positive
    travel: Positive
    skip: Annotated[float, Field(ge=0, lt=1)]


@dataclass(frozen=True, kw_only=True, config=STRICT)
class ChaseProtocol:
    """Commands as recorded; see ``calibration.yaml`` for the meaning of each key."""

    joints: tuple[str, ...]
    range: Annotated[float, Field(gt=0, le=1)]
    move: tuple[Positive, Positive]
    ease: Annotated[float, Field(gt=0, le=0.5)]
    hold: Positive
    count: Count


@dataclass(frozen=True, kw_only=True, config=STRICT)
class CalibrationSettings:
    """Measurement of the simulated robot, and limits of a match; see ``calibration.yaml`` for each key."""

    ramps: RampProtocol
    chases: ChaseProtocol
    fit_seed: Annotated[int, Field(ge=0)]
    fit_count: Count
    largest_residual_deg: dict[str, Positive]
    largest_factor: Annotated[float, Field(gt=1)]
    largest_r2_difference: Annotated[float, Field(gt=0, lt=1)]


@plain_dataclass(frozen=True, kw_only=True)
class Calibration:
    """Reference of a simulated robot, and the method of comparison.

    Attributes:
        recordings: Of real robots.
        settings: Ramps and targets.
        holds: Joints, goals and times of the holds.
        seed: Of the holds in a check.
    """

    recordings: ReferenceData
    settings: CalibrationSettings
    holds: Holds
    seed: int


@with_lines
def load_recordings(robot: RobotConfig, path: Path | str | None = None) -> ReferenceData:
    """Load the figures in ``path``, by default the shipped ``recordings.yaml``.

    Raises:
        ConfigError: The file is wrong: a key, a joint, or a table whose rows and columns do not fit.
    """
    path = own_or_shipped(path, "recordings.yaml")
    recordings = load(ReferenceData, path)
    for key, joints in (
        ("tables", recordings.tables),
        ("holds", recordings.holds),
        ("chases.figures", recordings.chases.figures),
        ("chases.stiffness", recordings.chases.stiffness),
    ):
        for name in joints:
            if name not in robot.joint_names:
                raise ConfigError(f"{path}: key '{key}': unknown joint '{name}'")
    for name, table in recordings.tables.items():
        shape = [len(row) for row in table.expected_error_deg]
        if shape != [len(table.velocity)] * len(table.torque):
            raise ConfigError(
                f"{path}: key 'tables.{name}.expected_error_deg': expected {len(table.torque)} rows of "
                f"{len(table.velocity)} numbers"
            )
    return recordings


@with_lines
def load_calibration(robot: RobotConfig) -> Calibration:
    """Return the shipped recordings, with ``calibration.yaml`` and ``experiments/calibrate.yaml``."""
    experiment = load_experiment("calibrate", robot)
    step = experiment.random_step
    if step is None or not isinstance(step.goals, Holds):
        raise experiment.error("steps", "calibration needs a step with holds")
    recordings = load_recordings(robot)
    settings = load(CalibrationSettings, package_file("calibration.yaml"))
    for where, given, expected in (
        ("experiments/calibrate.yaml", set(step.goals.joints), set(recordings.holds)),
        ("calibration.yaml", set(settings.largest_residual_deg), set(recordings.tables)),
        ("calibration.yaml", set(settings.chases.joints), set(recordings.chases.figures)),
        ("recordings.yaml", set(recordings.chases.stiffness), set(recordings.chases.figures)),
    ):
        if given != expected:
            raise ConfigError(f"{where}: its joints are not those of recordings.yaml")
    return Calibration(
        recordings=recordings,
        settings=settings,
        holds=step.goals,
        seed=experiment.seed,
    )
