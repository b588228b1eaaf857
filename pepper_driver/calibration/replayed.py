"""Replay of recorded commands on a simulated robot, row by row next to the measurements of a robot."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np

from pepper_driver.backends.mujoco_.backend import MujocoBackend
from pepper_driver.backends.selection import takes_delay
from pepper_driver.backends.simulated import drive_along
from pepper_driver.config import ConfigError, PlantConfig, RobotConfig
from pepper_driver.config.arrays import BoolArray, FloatArray
from pepper_driver.identification import RecordingFolderError
from pepper_driver.identification.dataset import Manifest, RunEntry, finished, recording_path
from pepper_driver.identification.measurements.program import measured_joints
from pepper_driver.observer import Recording
from pepper_driver.observer.fitting.samples import fit_samples

MIN_MOTION = 0.02
"""[rad] of a command over a run, without which a joint says nothing of itself."""


@dataclass(frozen=True, kw_only=True, eq=False)
class RecordedRun:
    """One run of a robot.

    Attributes:
        name: Of the run.
        held_out: True for a run that nothing is fitted to.
        recording: The run.
        pairing: Ticks from a command to the sample that stands in its row.
    """

    name: str
    held_out: bool
    recording: Recording
    pairing: int

    @cached_property
    def counts(self) -> BoolArray:
        """(n, N) True in the rows that say something of a joint; in none where it hardly moves."""
        moves = np.ptp(self.recording.sent_position, axis=0) >= MIN_MOTION
        rows = [fit_samples(self.recording, index) for index in range(len(moves))]
        counts: BoolArray = np.stack(rows, axis=1) & moves
        return counts


@dataclass(frozen=True, kw_only=True)
class ReplayedRun:
    """The same commands on a simulated robot, paired alike.

    Attributes:
        position: (n, N) measured [rad].
        current: (n, N) measured, unsigned [A].
    """

    position: FloatArray
    current: FloatArray


def load_runs(
    folder: Path, manifest: Manifest, measured_delay: int, robot: RobotConfig
) -> tuple[RecordedRun, ...]:
    """Return the fewest runs of an identification that say what its joints do.

    These are the runs by which the robot was measured, without the one with a weight in a hand; the fastest estimation
    run of each joint that they do not move; and the test runs.

    Args:
        folder: Of the recordings.
        manifest: Of the folder.
        measured_delay: Of the robot [ticks]: other runs than measurements are paired by it, if its URI takes a delay.
        robot: Its description.

    Raises:
        RecordingFolderError: They are of another robot, or a file is missing.
        RecordingError: A file is damaged.
    """
    if (manifest.robot, manifest.joint_names) != (robot.name, robot.joint_names):
        raise RecordingFolderError(
            f"{folder}: recordings of robot '{manifest.robot}', not of '{robot.name}' as it is described here"
        )
    fastest: dict[str | None, RunEntry] = {}
    for run in manifest.runs:
        if run.role == "estimation" and run.joint not in measured_joints(robot):
            fastest[run.joint] = max(fastest.get(run.joint, run), run, key=_stiffness)
    chosen = [
        run
        for run in manifest.runs
        if run.weight is None
        and (run.role in ("measurement", "test") or run is fastest.get(run.joint))
    ]
    there = finished(folder, [run.name for run in chosen])
    if missing := [run.name for run in chosen if run.name not in there]:
        raise RecordingFolderError(
            f"{folder}: {len(missing)} of {len(chosen)} runs are missing, the first is {missing[0]}"
        )
    reported = manifest.response_delay
    later = measured_delay if _takes_delay(manifest) else reported
    return tuple(
        RecordedRun(
            name=run.name,
            held_out=run.role == "test",
            recording=Recording.load(recording_path(folder, run.name), robot),
            pairing=reported if run.role == "measurement" else later,
        )
        for run in chosen
    )


def _takes_delay(manifest: Manifest) -> bool:
    """Return true where the runs after the measurements were paired by the measured delay."""
    try:
        return takes_delay(manifest.backend)
    except ConfigError:  # without its address, that of a bundle may be no URI
        return manifest.real_time


def _stiffness(run: RunEntry) -> float:
    return run.stiffness


def replay(robot: RobotConfig, plant: PlantConfig, run: RecordedRun) -> ReplayedRun:
    """Send the commands of a run to a simulated robot on a fixed base, without noise and lost samples.

    Args:
        robot: Its description.
        plant: The simulated robot.
        run: Ticks that it lacks are filled with commands between those before and after.

    Raises:
        PepperError: The simulation diverged.
    """
    transport = replace(plant.transport, encoder_noise=0.0, current_noise=0.0, late=0.0, lost=0.0)
    still = replace(plant, base="fixed", transport=transport)
    recording = run.recording
    rows = np.rint((recording.time - recording.time[0]) / robot.cycle).astype(np.int64)
    ticks = np.arange(rows[-1] + 1 + run.pairing)
    places = np.searchsorted(rows, np.minimum(ticks, rows[-1]), side="right") - 1
    sent = np.column_stack([np.interp(ticks, rows, c) for c in recording.sent_position.T])
    backend = MujocoBackend(robot, still, seed=0)
    with backend:
        measured = list(
            drive_along(
                backend,
                sent,
                recording.stiffness[places],
                np.zeros((len(ticks), 3)),
                robot,
            )
        )
    answers = [measured[row + run.pairing] for row in rows.tolist()]
    return ReplayedRun(
        position=np.array([m.position for m in answers]),
        current=np.array([m.current for m in answers]),
    )
