"""One cycle as observers see it: a measurement, and the command and reference that it answers."""

from __future__ import annotations

from dataclasses import dataclass

from pepper_driver.backends.interface import Command, Measurement
from pepper_driver.config.arrays import BoolArray
from pepper_driver.controller.reference import Reference


@dataclass(frozen=True, kw_only=True, slots=True)
class Sent:
    """A command as it was sent.

    Attributes:
        command: What the robot was told.
        reference: What the controller wanted when the command was made.
        changed: (17,) where the safety gate altered the position, so that ``command`` differs from ``reference``.
    """

    command: Command
    reference: Reference
    changed: BoolArray


@dataclass(frozen=True, kw_only=True, slots=True)
class Tick:
    """One cycle. Nothing reachable from here leads to the ground truth of a simulation, nor is ever changed.

    Attributes:
        measurement: What the robot measured.
        reference: What the controller wanted when it made the command this measurement answers.
        sent: That command, as it was really sent.
        changed: (17,) where the safety gate altered the position, so that ``sent`` differs from ``reference``.
    """

    measurement: Measurement
    reference: Reference
    sent: Command
    changed: BoolArray
