"""A log to draw, and whether anything draws here."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import pytest

from pepper_driver import Pepper
from pepper_driver.config import PepperError
from pepper_driver.rendering.gl import make_context
from support.once import made_once


def require_gl() -> None:
    """Skip where nothing draws without a display."""
    if reason := _missing():
        pytest.skip(reason)


@cache
def _missing() -> str:
    try:
        make_context(8, 8).free()
    except PepperError as error:
        return str(error)
    return ""


def pushed_robot(request: pytest.FixtureRequest) -> Path:
    """Return the log of a simulated robot whose left arm is pushed, at 4 s of its clock."""
    return made_once(request, "pushed_robot", _push) / "run.mcap"


def _push(folder: Path) -> None:
    folder.mkdir()
    with Pepper("mujoco", log=folder / "run.mcap") as pepper:
        pepper.set_posture({"LShoulderRoll": 0.6})
        pepper.run(3.0)
        pepper.push("LBicep", [0, 20, 0], point=[0.16, 0, 0], duration=0.6)
        pepper.run(1.5)
        assert {contact.joint for contact in pepper.contact_history} == {"LShoulderRoll"}
