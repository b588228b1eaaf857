"""What every backend asks of a command, and every simulated one of a push and a grabbing hand."""

from __future__ import annotations

from collections.abc import Iterable
from math import isfinite

import numpy as np
from numpy.typing import ArrayLike

from pepper_driver.backends.fields import Command
from pepper_driver.backends.interface import CommandError
from pepper_driver.config.arguments import is_number, real_array
from pepper_driver.config.arrays import FloatArray
from pepper_driver.config.contact_specs import FARTHEST_PULL, SOFTEST_HAND, STIFFEST_HAND
from pepper_driver.config.errors import check_name, shown

MAX_PUSH_FORCE = 10_000.0
"""[N] Far beyond anything a robot survives; more would only break the simulation."""

PUSH_FRAMES = ("world", "link")
"""Axes in which a push or a pull may be given."""

MAX_POINT_DISTANCE = 1.0
"""[m] From the origin of a link to a point on it: no link is as large."""


def checked_command(command: Command, joints: int) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Position, stiffness and wheel speed, as given.

    Raises:
        CommandError: They are not what a robot with so many joints could take.
    """
    if not isinstance(command, Command):
        raise CommandError(f"a command is expected, got {shown(command)}")
    parts = []
    for name, size in (("position", joints), ("stiffness", joints), ("wheel_speed", 3)):
        parts.append(finite_numbers(f"command.{name}", getattr(command, name), size))
    position, stiffness, wheel_speed = parts
    return position, stiffness, wheel_speed


def finite_numbers(name: str, values: object, size: int) -> FloatArray:
    """``values`` as an array (size,): a float64 array itself, others as a new one.

    Raises:
        CommandError: They are no such numbers.
    """
    array = values if isinstance(values, np.ndarray) else real_array(values)
    if array is not None and array.shape == (size,) and array.dtype.kind in "fiu":
        array = array.astype(np.float64, copy=False)
        if np.isfinite(array.sum()):
            return array
    raise CommandError(f"{name}: expected {size} finite numbers, got {shown(values)}")


def check_push(
    links: Iterable[str],
    link: str,
    *,
    force: ArrayLike,
    point: ArrayLike | None,
    duration: float,
    frame: str,
    delay: float,
    rise: float,
) -> None:
    """Refuse arguments of :meth:`Backend.push` that no simulated robot could take.

    Args:
        links: Names of the links that there are.
        link: As given, and so are the others.
        force: The same.
        point: The same.
        duration: The same.
        frame: The same.
        delay: The same.
        rise: The same.

    Raises:
        UnknownNameError: No such link or frame.
        CommandError: A number that is not finite or out of range.
    """
    _check_place("push", links, link, point, frame)
    _check_vector("push: force", force, MAX_PUSH_FORCE, "N")
    _check_number("push: duration", duration, above_zero=True)
    _check_number("push: rise", rise, above_zero=True)
    _check_number("push: delay", delay)


def check_grab(
    links: Iterable[str],
    link: str,
    *,
    pull: ArrayLike,
    point: ArrayLike | None,
    stiffness: float,
    rise: float,
    hold: float,
    release: float,
    largest_force: float,
    frame: str,
    delay: float,
) -> None:
    """Refuse arguments of :meth:`Backend.grab` that no simulated robot could take; otherwise as :func:`check_push`."""
    _check_place("grab", links, link, point, frame)
    _check_vector("grab: pull", pull, FARTHEST_PULL, "m")
    _check_number("grab: stiffness", stiffness)
    if not SOFTEST_HAND <= stiffness <= STIFFEST_HAND:
        raise CommandError(
            f"grab: stiffness must be {SOFTEST_HAND:g} to {STIFFEST_HAND:g} N/m, got {stiffness:g}"
        )
    _check_number("grab: rise", rise, above_zero=True)
    _check_number("grab: release", release, above_zero=True)
    _check_number("grab: largest_force", largest_force, above_zero=True)
    _check_number("grab: hold", hold)
    _check_number("grab: delay", delay)


def _check_place(
    what: str, links: Iterable[str], link: str, point: ArrayLike | None, frame: str
) -> None:
    check_name("link", link, links)
    check_name("frame", frame, PUSH_FRAMES)
    if point is not None:
        _check_vector(f"{what}: point", point, MAX_POINT_DISTANCE, "m")


def _check_vector(name: str, value: ArrayLike, most: float, unit: str) -> None:
    size = float(np.linalg.norm(finite_numbers(name, value, 3)))
    if size > most:
        raise CommandError(f"{name}: at most {most:g} {unit}, got {size:.4g} {unit}")


def _check_number(name: str, value: object, *, above_zero: bool = False) -> None:
    if is_number(value) and isfinite(value) and (value > 0 or (value == 0 and not above_zero)):
        return
    wanted = "above 0" if above_zero else "from 0 up"
    raise CommandError(f"{name} must be a finite number {wanted}, got {shown(value)}")
