"""What a user asks of the hands that touch a simulated robot, checked before anything is scheduled."""

from __future__ import annotations

from typing import Literal

import mujoco
import numpy as np
from numpy.typing import ArrayLike

from pepper_driver.backends.commands import check_grab
from pepper_driver.backends.mujoco_.hands import Hand
from pepper_driver.backends.mujoco_.model import PlantModel
from pepper_driver.backends.pushes import ScheduledPush, schedule_push
from pepper_driver.config.arrays import FloatArray
from pepper_driver.config.errors import check_name


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
) -> ScheduledPush:
    """The push that :meth:`Backend.push` was asked for; raises as it says."""
    check_name("link", link, model.bodies)
    return schedule_push(
        link,
        force,
        model.mj.body_ipos[model.bodies[link]] if point is None else point,
        links=model.bodies,
        now=data.time,
        duration=duration,
        frame=frame,
        delay=delay,
        rise=rise,
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
    check_grab(
        model.bodies,
        link,
        pull=pull,
        point=point,
        stiffness=stiffness,
        rise=rise,
        hold=hold,
        release=release,
        largest_force=largest_force,
        frame=frame,
        delay=delay,
    )
    body = model.bodies[link]
    return Hand(
        body=body,
        link=link,
        pull=_vector(pull),
        point=_vector(model.mj.body_ipos[body] if point is None else point),
        in_link_axes=frame == "link",
        stiffness=float(stiffness),
        start=data.time + delay,
        rise=float(rise),
        hold=float(hold),
        release=float(release),
        largest_force=float(largest_force),
    )


def _vector(value: ArrayLike) -> FloatArray:
    return np.array(value, dtype=np.float64)
