"""OpenGL without a display: the library that draws here, or the packages to install."""

from __future__ import annotations

import os
import subprocess
import sys
from functools import lru_cache
from importlib import import_module
from typing import Any
from warnings import catch_warnings, simplefilter

from pepper_driver.config import ConfigError, PepperError

VARIABLE = "MUJOCO_GL"
"""Environment variable that selects what MuJoCo draws with."""

OFF_SCREEN = ("egl", "osmesa")
"""Tried in this order where the variable is not set: the first uses a graphics processor where there is one."""

KNOWN = ("cgl", "egl", "enable", "enabled", "glfw", "glx", "on", "osmesa", "true", "wgl", "1")
"""Values of the variable with which MuJoCo draws."""

PROBE_TIME = 60.0
"""[s] within which a library must have said whether it draws."""

_PROBE = "from mujoco.{} import GLContext; GLContext(8, 8).make_current()"


class RenderError(PepperError, RuntimeError):
    """A picture or film cannot be drawn."""


def make_context(width: int, height: int) -> Any:  # noqa: ANN401 MuJoCo has no types
    """Return an OpenGL context without a window, current on this thread; its owner frees it.

    Args:
        width: Of its pictures, in pixels.
        height: The same.

    Raises:
        ConfigError: The variable names nothing that draws.
        RenderError: Nothing draws here.
    """
    chosen = check_gl()
    try:
        # MuJoCo read the variable when it was imported; where it is not set, the library is asked for by name.
        module = "mujoco" if chosen or sys.platform != "linux" else f"mujoco.{_off_screen()}"
        with catch_warnings():
            simplefilter("ignore")  # GLFW warns of what the error says
            context = import_module(module).GLContext(width, height)
            context.make_current()
    except RenderError:
        raise
    except Exception as error:  # of PyOpenGL and of drivers: anything
        raise RenderError(nothing_draws()) from error
    return context


def check_gl() -> str:
    """Return the value of the variable, empty where it is not set; MuJoCo is imported, which fails where it is wrong.

    Raises:
        ConfigError: It names nothing that draws.
        RenderError: What it names cannot be loaded.
    """
    chosen = os.environ.get(VARIABLE, "").strip().lower()
    if chosen and chosen not in KNOWN:
        raise ConfigError(
            f"environment variable {VARIABLE}: '{chosen}' does not draw; use {' or '.join(OFF_SCREEN)}, or unset it"
        )
    try:
        import_module("mujoco")
    except Exception as error:  # of PyOpenGL: anything
        raise RenderError(nothing_draws()) from error
    return chosen


def nothing_draws() -> str:
    """Return the message that nothing draws here: what was tried, and what to install."""
    chosen = os.environ.get(VARIABLE)
    tried = f"{VARIABLE} is {chosen}" if chosen else f"tried {', '.join(OFF_SCREEN)}"
    return (
        f"nothing draws without a display here ({tried}); on Debian or Ubuntu install libegl1 and libgl1-mesa-dri, "
        f"or libosmesa6, and leave {VARIABLE} unset"
    )


@lru_cache(maxsize=1)
def _off_screen() -> str:
    """Return the first of ``OFF_SCREEN`` that draws.

    In processes of their own: one that has loaded a library in vain cannot load another.
    """
    for name in OFF_SCREEN:
        try:
            done = subprocess.run(
                [sys.executable, "-c", _PROBE.format(name)],
                stdin=subprocess.DEVNULL,
                capture_output=True,
                timeout=PROBE_TIME,
                check=False,
            )
        except (OSError, subprocess.TimeoutExpired):
            continue
        if done.returncode == 0:
            return name
    raise RenderError(nothing_draws())
