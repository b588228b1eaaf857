"""Common parts of both pages: server, scene, curves, switches."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable

from pepper_driver.config import RobotConfig
from pepper_driver.observer import Contact
from pepper_driver.viewer.picture import Picture
from pepper_driver.viewer.scene import RobotScene
from pepper_driver.viewer.serving import ServedPage
from pepper_driver.viewer.signals import AUTOMATIC, WINDOW, Curves

CAMERA, LOOK_AT, FIELD_OF_VIEW = (2.6, -0.8, 1.25), (0.1, 0.15, 0.62), 0.6
"""[m], [m], [rad] The robot from its front, as a person sees it, next to the panel."""

CURVE_PERIOD = 0.12
"""[s] between two drawings of the curves."""


class Page:
    """A page with the robot in space, curves, and switches for what is shown.

    Args:
        robot: Description of the robot.
        served: Where it is shown.

    Attributes:
        server: Of viser.
        address: Of the page.
        scene: The robot in space.
        status: Text at the top.
    """

    def __init__(self, robot: RobotConfig, served: ServedPage) -> None:
        self.server, self.address = served.server, served.address
        self.robot = robot
        gui = self.server.gui
        gui.configure_theme(control_width="large", show_share_button=False, show_logo=False)
        self.status = gui.add_markdown("waiting for the robot")
        self.scene = RobotScene(self.server, robot)
        self.server.initial_camera.position = CAMERA
        self.server.initial_camera.look_at = LOOK_AT
        self.server.initial_camera.fov = FIELD_OF_VIEW
        self.pictures: deque[Picture] = deque(maxlen=4096)
        self._next_curves = 0.0

    def add_switches(self) -> None:
        """Add the switches for what is shown."""
        gui, scene = self.server.gui, self.scene
        ghost = gui.add_checkbox("Commanded posture (ghost)", initial_value=True)
        names = gui.add_checkbox("Frames and names", initial_value=False)

        @ghost.on_update
        def _(_: object) -> None:
            scene.show_ghost = ghost.value

        @names.on_update
        def _(_: object) -> None:
            scene.show_names(names.value)

    def add_curves(self) -> None:
        """Add the curves."""
        self.curves = Curves(self.server, self.robot, AUTOMATIC)

    def remember(self, picture: Picture) -> None:
        """Keep a picture for the curves; one that is earlier than the last clears them."""
        if self.pictures and picture.time < self.pictures[-1].time:
            self.pictures.clear()
            self.scene.clear()
        self.pictures.append(picture)
        while self.pictures[0].time < picture.time - WINDOW:
            self.pictures.popleft()

    def draw_curves(self, moment: Picture, contacts: Iterable[Contact], now: float) -> bool:
        """Draw the curves at a moment with its contacts; return False where the last time was only just before."""
        if now < self._next_curves:
            return False
        self._next_curves = now + CURVE_PERIOD
        self.curves.update(list(self.pictures), moment, contacts)
        return True
