"""The recordings of an identification: free motion of one joint at a time, and of the whole body."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from pepper_driver.config import RobotConfig
from pepper_driver.observer import Recording


def run_name(what: str, number: int | None) -> str:
    """Name of a run: the joint or ``calibration``, then its number from 1 on, or ``test``."""
    return f"{what}-{'test' if number is None else number}"


@dataclass(frozen=True, kw_only=True)
class JointRecordings:
    """Free motion of one joint: the estimation runs, in order of their stiffness, and the faster test run.

    Without estimation runs the joint has no model of its own: one that is shared is tried on the test run.
    """

    joint: str
    estimation: tuple[Recording, ...]
    test: Recording

    @property
    def runs(self) -> tuple[Recording, ...]:
        """All of them, the test run last."""
        return (*self.estimation, self.test)

    @property
    def names(self) -> tuple[str, ...]:
        """What the runs are called, in this order."""
        numbers = (*range(1, len(self.estimation) + 1), None)
        return tuple(run_name(self.joint, number) for number in numbers)

    @property
    def index(self) -> int:
        """Column of the joint."""
        return self.test.joint_names.index(self.joint)

    def mirrored(self, robot: RobotConfig) -> JointRecordings:
        """The same, seen in a mirror: of the joint of the other side."""
        return JointRecordings(
            joint=mirror_joint(self.joint, robot),
            estimation=tuple(run.mirrored(robot) for run in self.estimation),
            test=self.test.mirrored(robot),
        )


@dataclass(frozen=True, kw_only=True)
class IdentificationRecordings:
    """All that was recorded of one robot.

    Attributes:
        sweeps: By joint, in the order they were recorded; models are fitted to these.
        calibration: Free motion of the whole body, in order of its stiffness, on which thresholds and the weights of
            channels are chosen; no model is fitted to it. May be empty.
    """

    sweeps: tuple[JointRecordings, ...]
    calibration: tuple[Recording, ...]

    def entries(self, robot: RobotConfig, *, mirror: bool = True) -> Iterator[JointRecordings]:
        """The recordings of each joint that gets a model.

        With ``mirror``, what was recorded of one side follows mirrored, where the other side was not recorded. Mirrored
        recordings are made when they are asked for: they take as much memory as the others.
        """
        recorded = {entry.joint for entry in self.sweeps}
        for entry in self.sweeps:
            yield entry
            if mirror and mirror_joint(entry.joint, robot) not in recorded:
                yield entry.mirrored(robot)


def mirror_joint(joint: str, robot: RobotConfig) -> str:
    """The joint at the place of ``joint`` on the other side; joints of legs and head are their own."""
    return robot.joint_names[robot.mirror[robot.joint_index(joint)][0]]
