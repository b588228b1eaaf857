"""Steps an observer over a recording and keeps all that it says."""

from __future__ import annotations

from dataclasses import dataclass
from time import perf_counter_ns

import numpy as np
from numpy.typing import NDArray

from pepper_driver.config.arrays import FloatArray
from pepper_driver.observer import Contact, ContactObserver, Observer, Recording


@dataclass(frozen=True, kw_only=True, eq=False)
class Watched:
    """What an observer made of a recording of n ticks and N joints; NaN where a joint was blind.

    Attributes:
        contacts: Its events, in their order.
        expected: (n, N) expected tracking error [rad].
        predicted: (n,) the same of the joint that was asked for, without a look at what was measured; None for none.
        residual: (n, N) contact observer signal r [rad].
        threshold: (n, N) [rad].
        torque: (n, N) external torque estimate [N m].
        state: (n, N) values of :class:`~pepper_driver.observer.JointState`.
        step_us: (n,) wall time of each step [us].
    """

    contacts: tuple[Contact, ...]
    expected: FloatArray
    predicted: FloatArray | None
    residual: FloatArray
    threshold: FloatArray
    torque: FloatArray
    state: NDArray[np.int8]
    step_us: FloatArray


def watch(observer: Observer, recording: Recording, joint: str | None = None) -> Watched:
    """Reset the observer and show it every tick of the recording; ``joint`` is the one to predict."""
    shape = recording.position.shape
    expected, residual, threshold, torque = (np.empty(shape) for _ in range(4))
    state = np.empty(shape, dtype=np.int8)
    step_us = np.empty(len(recording))
    contacts: list[Contact] = []
    observer.reset()
    for row, tick in enumerate(recording.ticks()):
        before = perf_counter_ns()
        observation = observer.step(tick)
        step_us[row] = (perf_counter_ns() - before) * 1e-3
        contacts.extend(observation.contacts)
        expected[row] = observation.expected
        residual[row] = observation.residual
        threshold[row] = observation.threshold
        torque[row] = observation.torque
        state[row] = observation.state
    return Watched(
        contacts=tuple(contacts),
        expected=expected,
        predicted=None if joint is None else _predicted(observer, recording, joint, expected),
        residual=residual,
        threshold=threshold,
        torque=torque,
        state=state,
        step_us=step_us,
    )


def _predicted(
    observer: Observer, recording: Recording, joint: str, expected: FloatArray
) -> FloatArray:
    if isinstance(observer, ContactObserver):
        return observer.predict(joint, recording)
    return expected[:, recording.joint_names.index(joint)]
