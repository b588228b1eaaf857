"""What a user asks of the hands that touch a simulated robot, checked before anything is scheduled."""

from __future__ import annotations

from typing import Literal

import mujoco
import numpy as np
from numpy.typing import ArrayLike

from pepper_driver.backends.commands import finite_numbers
from pepper_driver.backends.interface import CommandError
from pepper_driver.backends.mujoco_.hands import Hand
from pepper_driver.backends.mujoco_.model import PlantModel
from pepper_driver.backends.mujoco_.pushes import Push
from pepper_driver.config import UnknownNameError
from pepper_driver.config.parts import FloatArray
from pepper_driver.config.scenario_contacts import FARTHEST_PULL, SOFTEST_HAND, STIFFEST_HAND

STRONGEST_PUSH = 10_000.0
"""[N] Far beyond anything a robot survives; more would only break the simulation."""


def planned_push(
    model: PlantModel,
    data: mujoco.MjData,
    link: str,
    force: ArrayLike,
    point: ArrayLike | None,
    duration: float,
    frame: Literal["world", "link"],
    delay: float,
    rise: float,
) -> Push:
    """The push that :meth:`Backend.push` was asked for; raises as it says."""
    body, pushed, where = _place("push", model, link, force, point, frame, [duration, delay, rise])
    if duration <= 0 or rise <= 0 or delay < 0:
        raise CommandError("push: duration and rise must be positive, delay not negative")
    if np.linalg.norm(pushed) > STRONGEST_PUSH:
        raise CommandError(f"push: the force may be {STRONGEST_PUSH:g} N at most")
    return Push(
        body=body,
        force=pushed,
        point=where,
        turns_with_link=frame == "link",
        start=data.time + delay,
        duration=float(duration),
        rise=min(float(rise), float(duration) / 3),
    )


def planned_hand(
    model: PlantModel,
    data: mujoco.MjData,
    link: str,
    pull: ArrayLike,
    point: ArrayLike | None,
    *,
    stiffness: float,
    rise: float,
    hold: float,
    release: float,
    largest_force: float,
    frame: Literal["world", "link"],
    delay: float,
) -> Hand:
    """The hand that :meth:`Backend.grab` was asked for; raises as it says."""
    numbers = [stiffness, rise, hold, release, largest_force, delay]
    body, pulled, where = _place("grab", model, link, pull, point, frame, numbers)
    if not SOFTEST_HAND <= stiffness <= STIFFEST_HAND:
        raise CommandError(
            f"grab: stiffness must be {SOFTEST_HAND:g} to {STIFFEST_HAND:g} N/m, got {stiffness:g}"
        )
    if rise <= 0 or release <= 0 or largest_force <= 0 or hold < 0 or delay < 0:
        raise CommandError(
            "grab: rise, release and largest_force must be positive, hold and delay not negative"
        )
    if np.linalg.norm(pulled) > FARTHEST_PULL:
        raise CommandError(f"grab: the pull may be {FARTHEST_PULL:g} m long at most")
    return Hand(
        body=body,
        link=link,
        pull=pulled,
        point=where,
        in_link_axes=frame == "link",
        stiffness=float(stiffness),
        start=data.time + delay,
        rise=float(rise),
        hold=float(hold),
        release=float(release),
        largest_force=float(largest_force),
    )


def _place(
    what: str,
    model: PlantModel,
    link: str,
    vector: ArrayLike,
    point: ArrayLike | None,
    frame: str,
    numbers: list[float],
) -> tuple[int, FloatArray, FloatArray]:
    """Body of a link, (3,) vector and (3,) point, refused when they are none."""
    if link not in model.bodies:
        raise UnknownNameError("link", link, model.bodies)
    body = model.bodies[link]
    where = model.mj.body_ipos[body] if point is None else point
    checked = finite_numbers(f"{what}: vector", vector, 3).copy()
    place = finite_numbers(f"{what}: point", where, 3).copy()
    finite_numbers(f"{what}: times and sizes", numbers, len(numbers))
    if frame not in ("world", "link"):
        raise UnknownNameError("frame", frame, ("world", "link"))
    return body, checked, place
