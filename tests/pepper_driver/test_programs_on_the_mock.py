"""A program on the robot without physics."""

from __future__ import annotations

import numpy as np

from pepper_driver import Pepper
from pepper_driver.config.arrays import FloatArray


def test_a_program_runs_on_it() -> None:
    """The same program as on any robot; what it measures is what it was sent ``delay`` ticks before."""
    errors: list[FloatArray] = []
    with Pepper("mock://?delay=2", observer=None) as pepper:
        pepper.set_posture({"LShoulderRoll": 0.6})
        pepper.run(
            1.2, on_tick=lambda t, _: errors.append(t.sent.position - t.measurement.position)
        )
        assert pepper.position["LShoulderRoll"] > 0.4
    assert len(errors) == 100
    assert not np.array(errors).any()
