"""The simulated robot as a network shows it: samples come late, twice or not at all."""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from pepper_driver.backends import (
    Backend,
    BackendInfo,
    Command,
    Measurement,
    SimulatedPlant,
    Truth,
    make_backend,
)


class Jittery(Backend):
    """Each read shows the newest sample that has come, and says which command it answers.

    Args:
        uri: Of the simulation behind it.
        late: By tick, how many cycles old the newest sample is then; 0 from its end on.
    """

    def __init__(self, uri: str, late: NDArray[np.int_]) -> None:
        self._backend = make_backend(uri)
        self._late = late
        self._samples: list[Measurement] = []
        self._newest = 0

    @property
    def uri(self) -> str:
        return self._backend.uri

    @property
    def info(self) -> BackendInfo:
        return self._backend.info

    @property
    def plant(self) -> SimulatedPlant:
        return self._backend.plant

    @property
    def truth(self) -> Truth:
        return self._backend.truth

    def open(self) -> Measurement:
        self._samples, self._newest = [], 0
        return self._backend.open()

    def activate(self) -> Measurement:
        return self._backend.activate()

    def write(self, command: Command) -> None:
        self._backend.write(command)

    def read(self) -> Measurement:
        tick = len(self._samples)
        self._samples.append(self._backend.read())
        late = int(self._late[tick]) if tick < len(self._late) else 0
        self._newest = max(self._newest, tick - late)  # what has come has come
        late = tick - self._newest
        return _seen(self._samples[self._newest], late, self.info)

    def push(self, *arguments: object, **more: object) -> None:
        self._backend.push(*arguments, **more)  # type: ignore[arg-type]

    def deactivate(self) -> None:
        self._backend.deactivate()

    def close(self) -> None:
        self._backend.close()


def _seen(sample: Measurement, late: int, info: BackendInfo) -> Measurement:
    return replace(
        sample,
        response_delay=info.response_delay + late,
        age=late * info.cycle,
        dropped_commands=sample.tick // 7,
    )
