"""What a robot measures while it stands without stiffness."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from operator import attrgetter

import numpy as np

from pepper_driver.backends import Backend, DeviceError, Measurement
from pepper_driver.config import RobotConfig
from pepper_driver.config.arrays import FloatArray
from pepper_driver.realtime import Pacer, RealTimePacer, realtime_process, realtime_thread


@dataclass(frozen=True, kw_only=True)
class Look:
    """Measurements in the order they came, the one of ``open`` first.

    Attributes:
        samples: Two at least; in real time the same one again where there was no newer one.
        missed: Ticks that this computer missed.
        wall: How long it took by this computer's clock [s]; None in simulated time.
        diagnosis: As the backend gave it.
    """

    samples: tuple[Measurement, ...]
    missed: int
    wall: float | None
    diagnosis: tuple[DeviceError, ...] | None

    def values(self, name: str) -> FloatArray:
        """(n, ...) one field of all measurements, with a dot for those of the IMU."""
        return np.array([attrgetter(name)(sample) for sample in self.samples], dtype=np.float64)

    @property
    def last(self) -> Measurement:
        """The newest."""
        return self.samples[-1]


def look(
    backend: Backend,
    robot: RobotConfig,
    seconds: float,
    on_progress: Callable[[float], None] | None = None,
) -> Look:
    """Open a robot and watch it; it is closed again, and was never active: nothing is sent to it.

    Args:
        backend: Closed.
        robot: Its description.
        seconds: How long [s].
        on_progress: Told the share of the time that is over, 0..1.

    Raises:
        PepperError: The robot refuses, or is lost.
    """
    pacer = Pacer()
    if backend.real_time:
        pacer = RealTimePacer(robot.cycle, backend)
    tell = on_progress or (lambda share: None)
    ticks = round(seconds / robot.cycle)
    missed = 0
    try:
        samples = [backend.open()]
        diagnosis = backend.diagnosis()  # before the clock runs: it may take long
        with realtime_process(), realtime_thread():
            samples.append(backend.read())
            began = time.perf_counter()
            for tick in range(ticks):
                missed += pacer.wait()
                samples.append(backend.read())
                tell((tick + 1) / ticks)
            wall = time.perf_counter() - began
    finally:
        backend.close()
    return Look(
        samples=tuple(samples[1:]),  # the first may be from long before
        missed=missed,
        wall=wall if backend.real_time else None,
        diagnosis=diagnosis,
    )
