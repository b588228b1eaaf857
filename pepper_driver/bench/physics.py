"""Bare physics: the steps that MuJoCo made in a run of a simulated robot, recorded, and made again alone."""

from __future__ import annotations

from time import perf_counter
from types import TracebackType
from typing import Any, Self

import mujoco
import numpy as np

from pepper_driver.config.arrays import FloatArray

FIELDS = (
    "dof_frictionloss",
    "dof_damping",
    "tendon_damping",
    "tendon_frictionloss",
    "wrap_prm",
    "actuator_gainprm",
    "actuator_biasprm",
)
"""Fields of the model that the plant sets while it runs: friction, grip of the wheels, warmth of the motors."""

_STATE = mujoco.mjtState.mjSTATE_INTEGRATION


class RecordedSteps:
    """Steps of physics that follow one another, each with what was set before it.

    Replayed, they go through the same states, bit for bit: they cost what they cost in the run. Nothing may have pushed
    or held the robot meanwhile.

    Args:
        model: The plant's model, of which a copy is made.
        data: The state before the first step.

    Attributes:
        model: The copy.
        data: State after the last replay.
    """

    def __init__(self, model: mujoco.MjModel, data: mujoco.MjData) -> None:
        self.model = model.__copy__()
        self.data = mujoco.MjData(self.model)
        self._start = np.empty(mujoco.mj_stateSize(model, _STATE))
        mujoco.mj_getState(model, data, self._start, _STATE)
        self._targets = [self.data.ctrl, *(getattr(self.model, name) for name in FIELDS)]
        self._newest: list[Any] = [None] * len(self._targets)
        self._changes: list[list[tuple[FloatArray, FloatArray]]] = []

    def __len__(self) -> int:
        return len(self._changes)

    def append(self, model: mujoco.MjModel, data: mujoco.MjData) -> None:
        """Take in what has changed since the step before: the next one is made with it."""
        changes = []
        values = [data.ctrl, *(getattr(model, name) for name in FIELDS)]
        for number, (target, value) in enumerate(zip(self._targets, values, strict=True)):
            if not np.array_equal(value, self._newest[number]):
                self._newest[number] = value.copy()
                changes.append((target, self._newest[number]))
        self._changes.append(changes)

    def replay(self) -> FloatArray:
        """Make the steps again; returns (n,) times that MuJoCo took for each, without what is set before it [s]."""
        model, data, step = self.model, self.data, mujoco.mj_step
        times = np.empty(len(self._changes))
        mujoco.mj_resetData(model, data)
        mujoco.mj_setState(model, data, self._start, _STATE)
        for number, changes in enumerate(self._changes):
            for target, values in changes:
                target[:] = values
            begin = perf_counter()
            step(model, data)
            times[number] = perf_counter() - begin
        return times


class StepRecorder:
    """Records all steps that MuJoCo makes in this process inside a ``with`` block, which must be of one plant.

    MuJoCo itself calls it in each step, before the forces act: the plant needs nothing for that.

    Args:
        length: Steps of one recording; a new one begins after so many.

    Attributes:
        recordings: In the order of time; the last one may be shorter.
    """

    def __init__(self, length: int) -> None:
        self._length = length
        self.recordings: list[RecordedSteps] = []

    def __enter__(self) -> Self:
        mujoco.set_mjcb_control(self._record)
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        mujoco.set_mjcb_control(None)

    def _record(self, model: mujoco.MjModel, data: mujoco.MjData) -> None:
        if not self.recordings or len(self.recordings[-1]) == self._length:
            self.recordings.append(RecordedSteps(model, data))
        self.recordings[-1].append(model, data)
