"""A window that shows the simulated robot: MuJoCo's own viewer."""

from __future__ import annotations

import os
import sys
import warnings

import mujoco

from pepper_driver.backends.interface import BackendError


def check_display() -> None:
    """Raise a BackendError where no window can open."""
    if sys.platform == "linux" and not (
        os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")
    ):
        raise BackendError("no window: this machine has no display (DISPLAY is not set)")
    if sys.platform == "darwin" and "mjpython" not in os.path.basename(sys.executable):
        raise BackendError("no window: on macOS run with 'mjpython' in place of 'python'")


class Window:
    """Shows the state of the simulation; closing it by hand does not stop the robot."""

    def __init__(self, model: mujoco.MjModel, data: mujoco.MjData) -> None:
        check_display()
        import glfw  # these need GL: only now
        from mujoco import viewer

        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # the failure is told below
            if not glfw.init():  # MuJoCo would end the process
                raise BackendError("no window: the display cannot be opened")
        try:
            self._viewer = viewer.launch_passive(
                model, data, show_left_ui=False, show_right_ui=False
            )
        except Exception as error:  # GLFW and GL raise errors of their own
            raise BackendError(f"no window: {error}") from error
        self._viewer.cam.distance, self._viewer.cam.azimuth = 3.0, 150.0
        self._viewer.cam.lookat[:] = 0.0, 0.0, 0.7

    def refresh(self) -> None:
        """Show the state as it is now."""
        if self._viewer.is_running():
            self._viewer.sync()

    def close(self) -> None:
        """Close the window."""
        self._viewer.close()
