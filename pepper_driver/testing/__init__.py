"""Tools for tests of programs and plug-ins: a robot without physics, faulty measurements, ticks, a bench for reflexes.

:mod:`pepper_driver.testing.conformance` has the tests of backends; it alone needs pytest.
"""

from pepper_driver.backends.mock import Fault, MockBackend
from pepper_driver.testing.faults import aged, displaced, drained, heated, pressed
from pepper_driver.testing.reflex_bench import ReflexBench, make_contact
from pepper_driver.testing.ticks import (
    observe,
    recorded_ticks,
    standing_measurement,
    standing_ticks,
)

__all__ = [
    "Fault",
    "MockBackend",
    "ReflexBench",
    "aged",
    "displaced",
    "drained",
    "heated",
    "make_contact",
    "observe",
    "pressed",
    "recorded_ticks",
    "standing_measurement",
    "standing_ticks",
]
