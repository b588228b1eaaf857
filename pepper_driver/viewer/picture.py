"""One moment of a robot, as the page shows it: from the stream of a running one, or from a log."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from pepper_driver.backends.log_file import CDR_HEADER, TICK_TOPIC, fields_of, row_type
from pepper_driver.config.arrays import FloatArray, IntArray

LOG_FIELDS = (
    "time",
    "position",
    "sent_position",
    "residual",
    "threshold",
    "torque",
    "torque_std",
    "state",
    "missed",
    "wheel_speed",
    "base",
    "tilt",
)
"""Fields of a log that are shown."""


@dataclass(frozen=True, kw_only=True)
class Force:
    """A force on a link that a simulation knows: (3,) ``point`` [m] and ``force`` [N] in the world."""

    link: str
    point: FloatArray
    force: FloatArray


@dataclass(frozen=True, kw_only=True)
class Picture:
    """State of a robot at one tick. Joint vectors are (17,).

    Attributes:
        time: Clock of the robot [s].
        position: Measured [rad].
        commanded: Command that the measurement answers [rad].
        residual: Residual of the observer [rad]; NaN where there is none.
        threshold: Its bound [rad].
        torque: External torque estimate [N m].
        torque_std: Its standard deviation [N m].
        state: Values of :class:`pepper_driver.observer.JointState`.
        base: (3,) x, y [m], yaw [rad] of the base.
        tilt: (2,) pitch, roll of the base [rad], applied after the yaw.
        forces: Of a simulation.
        missed: Ticks missed so far.
    """

    time: float
    position: FloatArray
    commanded: FloatArray
    residual: FloatArray
    threshold: FloatArray
    torque: FloatArray
    torque_std: FloatArray
    state: IntArray
    base: FloatArray
    tilt: FloatArray
    forces: tuple[Force, ...] = ()
    missed: int = 0

    @property
    def excess(self) -> FloatArray:
        """(17,) size of the residual over its threshold; 0 where a joint has none."""
        with np.errstate(invalid="ignore", divide="ignore"):
            ratio = np.abs(self.residual) / self.threshold
        return np.nan_to_num(ratio, posinf=0.0)


def picture_of(
    row: Any,  # noqa: ANN401 a record, or a mapping of columns' values
    base: FloatArray,
    tilt: FloatArray,
    forces: tuple[Force, ...] = (),
) -> Picture:
    """Return the picture of a row of ``/tick``."""
    return Picture(
        time=float(row["time"]),
        position=np.array(row["position"], dtype=np.float64),
        commanded=np.array(row["sent_position"], dtype=np.float64),
        residual=np.array(row["residual"], dtype=np.float64),
        threshold=np.array(row["threshold"], dtype=np.float64),
        torque=np.array(row["torque"], dtype=np.float64),
        torque_std=np.array(row["torque_std"], dtype=np.float64),
        state=np.array(row["state"], dtype=np.int64),
        base=base,
        tilt=tilt,
        forces=forces,
        missed=int(row["missed"]),
    )


class RowDecoder:
    """Decodes rows of ``/tick`` as telemetry sends them.

    Args:
        layout: Layout of a log, as the stream announces it.
    """

    def __init__(self, layout: Mapping[str, str]) -> None:
        self._type = row_type(fields_of(layout)[TICK_TOPIC])

    def decode(self, row: bytes, pose: Mapping[str, Any]) -> Picture:
        """Return the picture of a row, with the pose that follows it in the stream.

        Raises:
            ValueError: That is no row of this layout.
        """
        (record,) = np.frombuffer(row, self._type, offset=len(CDR_HEADER))
        base, tilt = pose.get("base"), pose.get("tilt")
        return picture_of(
            record,
            np.zeros(3) if base is None else np.array(base, dtype=np.float64),
            np.zeros(2) if tilt is None else np.array(tilt, dtype=np.float64),
            tuple(
                Force(link=f["link"], point=np.array(f["point"]), force=np.array(f["force"]))
                for f in pose.get("forces", ())
            ),
        )
