"""The robot in the scene: its visual geometry, posture, ghost, path, contacts, forces and names."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterable
from functools import cached_property
from typing import Any

import numpy as np
import pinocchio as pin
import viser
import viser.transforms as vtf

from pepper_driver.config import RobotConfig
from pepper_driver.config.arrays import FloatArray
from pepper_driver.config.visuals import Visual, load_visuals
from pepper_driver.controller.model import RobotModel
from pepper_driver.observer import Contact
from pepper_driver.viewer.drawing import (
    GHOST_COLOR,
    GHOST_OPACITY,
    GHOST_SCALE,
    Arrow,
    centres_of,
    configuration,
    force_arrow,
    glow,
    glowing,
    rotation_of_tilt,
    touch_arrows,
)
from pepper_driver.viewer.picture import Picture

GHOST_DISTANCE = np.radians(2.0)
"""[rad] The ghost is drawn where a joint is farther than this from its command: drawing costs a slow browser time."""
GLOW_LEVELS = 8
PATH_STEP = 0.02
"""[m] between two points of the path of the base."""
PATH_POINTS = 1000
PATH_COLOR = (90, 90, 160)
RAY_STEPS, RAY_TOLERANCE = 200, 1e-4
"""Steps along a ray at most, and the distance [m] at which it has met a part."""

Handle = Any
"""A handle of viser's scene."""


def as_wxyz(rotation: FloatArray) -> FloatArray:
    """Return the quaternion of a rotation matrix."""
    return np.asarray(vtf.SO3.from_matrix(rotation).wxyz, dtype=np.float64)


def signed_distance(visual: Visual, point: FloatArray) -> float:
    """Return the distance of a point (3,) in the visual's frame from its surface [m], below 0 inside."""
    if visual.shape == "sphere":
        return float(np.linalg.norm(point) - visual.size[0])
    if visual.shape == "box":
        out = np.abs(point) - 0.5 * np.array(visual.size)
    else:
        radius, length = visual.size
        out = np.array([np.hypot(point[0], point[1]) - radius, abs(point[2]) - 0.5 * length])
    return float(np.linalg.norm(np.maximum(out, 0.0)) + min(float(out.max()), 0.0))


class RobotTree:
    """One drawing of the robot: a node for each joint, below its parent's, with the visuals of its link.

    Args:
        server: Of the page.
        model: Kinematics; shared, for its structure alone.
        visuals: Of all links.
        name: Of the root node.
        ghost: Draw it translucent, in one colour.
    """

    def __init__(
        self,
        server: viser.ViserServer,
        model: RobotModel,
        visuals: Iterable[Visual],
        name: str,
        *,
        ghost: bool = False,
    ) -> None:
        self._model = model
        self.root = server.scene.add_frame(name, show_axes=False)
        tree = model.pin
        paths = {1: name}  # the planar joint of the base
        self._joints: dict[int, Handle] = {}
        for joint in range(2, tree.njoints):
            paths[joint] = f"{paths[tree.parents[joint]]}/{tree.names[joint]}"
            self._joints[joint] = server.scene.add_frame(paths[joint], show_axes=False)
        self.parts: dict[str, list[tuple[Handle, FloatArray]]] = {}
        self.visuals: list[tuple[Visual, Handle]] = []
        for number, visual in enumerate(visuals):
            frame = tree.frames[tree.getFrameId(visual.link)]
            place = frame.placement.homogeneous @ visual.transform_visual_to_link
            handle = _add_shape(
                server,
                f"{paths[frame.parentJoint]}/{visual.link}_{number}",
                visual,
                place,
                ghost=ghost,
            )
            color = 255.0 * np.array(visual.rgba[:3])
            self.parts.setdefault(visual.link, []).append((handle, color))
            self.visuals.append((visual, handle))
        self._levels = dict.fromkeys(self.parts, 0)

    def update(self, q: FloatArray, tilt: FloatArray) -> None:
        """Show a configuration of the model, with pitch and roll of the base."""
        data = self._model.data
        pin.forwardKinematics(self._model.pin, data, q)
        base = data.oMi[1]
        self.root.position = base.translation
        self.root.wxyz = as_wxyz(base.rotation @ rotation_of_tilt(tilt))
        for joint, handle in self._joints.items():
            relative = data.liMi[joint]
            handle.wxyz = as_wxyz(relative.rotation)
            handle.position = relative.translation

    def glow(self, link: str, level: int) -> None:
        """Colour a link by how far its residual is above the threshold, 0 to ``GLOW_LEVELS``."""
        if self._levels.get(link, level) == level:
            return
        self._levels[link] = level
        fraction = level / GLOW_LEVELS
        for handle, color in self.parts[link]:
            handle.color = tuple(int(value) for value in glowing(color, fraction))


def _add_shape(
    server: viser.ViserServer, name: str, visual: Visual, place: FloatArray, *, ghost: bool
) -> Handle:
    color = GHOST_COLOR if ghost else tuple(int(255 * value) for value in visual.rgba[:3])
    opacity = GHOST_OPACITY if ghost else (visual.rgba[3] if visual.rgba[3] < 1.0 else None)
    common: dict[str, Any] = {
        "color": color,
        "opacity": opacity,
        "position": place[:3, 3],
        "wxyz": as_wxyz(place[:3, :3]),
        "cast_shadow": not ghost,
        "scale": GHOST_SCALE if ghost else 1.0,
    }
    scene = server.scene
    if visual.shape == "box":
        return scene.add_box(name, dimensions=np.array(visual.size), **common)
    if visual.shape == "cylinder":
        radius, length = visual.size
        return scene.add_cylinder(name, radius=radius, height=length, **common)
    return scene.add_icosphere(name, radius=visual.size[0], subdivisions=3, **common)


class RobotScene:
    """All that the page shows in space.

    Args:
        server: Of the page.
        robot: Description of the robot.

    Attributes:
        body: The robot as measured.
        show_ghost: False to hide the ghost.
        names: Labels of the links, hidden at first.
    """

    def __init__(self, server: viser.ViserServer, robot: RobotConfig) -> None:
        self._server, self._robot = server, robot
        self._model = RobotModel(robot)
        visuals = load_visuals(robot)
        server.scene.set_up_direction("+z")
        server.scene.add_grid(
            "/floor", width=20.0, height=20.0, cell_size=0.25, section_size=1.0, infinite_grid=True
        )
        self.body = RobotTree(server, self._model, visuals, "/robot")
        self._visuals = visuals
        self.show_ghost = True
        self.names: list[Handle] = []
        self._posing, self._tilt = threading.Lock(), np.zeros(2)
        self._centres = centres_of(visuals)
        self._path: list[FloatArray] = []
        self._path_handle: Handle | None = None
        self._arrows: dict[str, Handle] = {}

    @cached_property
    def ghost(self) -> RobotTree:
        """The robot as commanded."""
        return RobotTree(self._server, self._model, self._visuals, "/commanded", ghost=True)

    def on_part(self, attach: Callable[[Visual, Handle], None]) -> None:
        """Call a function with each part that can be taken with the mouse, and its handle."""
        for visual, handle in self.body.visuals:
            attach(visual, handle)

    def link_pose(self, link: str) -> FloatArray:
        """(4, 4) transform of a link to the world, as it is shown. Any thread may call."""
        tree, data = self._model.pin, self._model.data
        frame = tree.frames[tree.getFrameId(link)]
        with self._posing:
            base, joint = data.oMi[1].homogeneous, data.oMi[frame.parentJoint].homogeneous
            tilt = self._tilt
        turn = np.eye(4)
        turn[:3, :3] = rotation_of_tilt(tilt)
        pose: FloatArray = base @ turn @ np.linalg.inv(base) @ joint @ frame.placement.homogeneous
        return pose

    def in_link(self, link: str, point: FloatArray) -> FloatArray:
        """Return a point (3,) of the world in a link's frame [m]."""
        pose = self.link_pose(link)
        inside: FloatArray = pose[:3, :3].T @ (point - pose[:3, 3])
        return inside

    def hit(
        self, visual: Visual, origin: FloatArray, direction: FloatArray
    ) -> tuple[FloatArray, FloatArray] | None:
        """Return where a ray of the world meets a part, and its direction, both in the link's frame; None if it misses.

        Args:
            visual: The part.
            origin: (3,) of the ray [m].
            direction: (3,) unit vector.
        """
        pose = self.link_pose(visual.link)
        to_link = pose[:3, :3].T
        start, along = to_link @ (origin - pose[:3, 3]), to_link @ direction
        to_visual = np.linalg.inv(visual.transform_visual_to_link)
        way = 0.0
        for _ in range(RAY_STEPS):
            point = start + way * along
            distance = signed_distance(visual, to_visual[:3, :3] @ point + to_visual[:3, 3])
            if distance < RAY_TOLERANCE:
                return point, along
            way += distance
        return None

    def show(self, picture: Picture, contacts: Iterable[Contact], *, path: bool = True) -> None:
        """Show a moment.

        Args:
            picture: State of the robot.
            contacts: At this moment.
            path: Go on with the path of the base.
        """
        with self._server.atomic():
            away = np.abs(picture.commanded - picture.position)
            visible = self.show_ghost and bool(np.nan_to_num(away).max() > GHOST_DISTANCE)
            if visible or "ghost" in self.__dict__:  # a browser has enough to do at first
                self.ghost.root.visible = visible
            if visible:
                self.ghost.update(
                    configuration(self._model, picture.commanded, picture.base), picture.tilt
                )
            with self._posing:
                self._tilt = picture.tilt
                self.body.update(
                    configuration(self._model, picture.position, picture.base), picture.tilt
                )
            self._glow(picture)
            if path:
                self._draw_path(picture.base)
            arrows = {f"force {i}": force_arrow(f) for i, f in enumerate(picture.forces)}
            for contact in contacts:
                arrows |= touch_arrows(contact, self._robot, self.link_pose, self._centres)
            self._draw_arrows(arrows)

    def clear(self) -> None:
        """Forget the path."""
        self._path.clear()
        if self._path_handle is not None:
            self._path_handle.remove()
            self._path_handle = None

    def show_names(self, visible: bool) -> None:
        """Show or hide frames and names of links."""
        for handle in self.names:
            handle.remove()
        self.names = []
        if not visible:
            return
        tree = self._model.pin
        for link in self.body.parts:
            frame = tree.frames[tree.getFrameId(link)]
            path = self._joint_path(frame.parentJoint)
            placement = frame.placement
            axes = self._server.scene.add_frame(
                f"{path}/{link}_axes",
                axes_length=0.08,
                axes_radius=0.003,
                position=placement.translation,
                wxyz=as_wxyz(placement.rotation),
            )
            label = self._server.scene.add_label(f"{path}/{link}_axes/name", link)
            self.names += [label, axes]

    def _joint_path(self, joint: int) -> str:
        tree = self._model.pin
        if joint <= 1:
            return "/robot"
        return f"{self._joint_path(tree.parents[joint])}/{tree.names[joint]}"

    def _glow(self, picture: Picture) -> None:
        levels = GLOW_LEVELS * glow(picture.excess)
        for joint, level in zip(self._robot.joints, levels.tolist(), strict=True):
            self.body.glow(joint.child, round(level))

    def _draw_path(self, base: FloatArray) -> None:
        point = np.array([base[0], base[1], 0.003])
        if self._path and np.linalg.norm(point - self._path[-1]) < PATH_STEP:
            return
        self._path = [*self._path[-PATH_POINTS:], point]
        if len(self._path) > 1:
            points = np.stack([self._path[:-1], self._path[1:]], axis=1)
            self._path_handle = self._server.scene.add_line_segments(
                "/path", points=points, colors=PATH_COLOR, thickness=3.0, thickness_units="screen"
            )

    def _draw_arrows(self, arrows: dict[str, Arrow]) -> None:
        for name in self._arrows.keys() - arrows.keys():
            self._arrows.pop(name).remove()
        for name, arrow in arrows.items():
            points = np.array([[arrow.start, arrow.end]])
            handle = self._arrows.get(name)
            if handle is None:
                self._arrows[name] = self._server.scene.add_arrows(
                    f"/arrows/{name.replace(' ', '_')}",
                    points,
                    arrow.color,
                    shaft_radius=0.008,
                    head_radius=0.02,
                    head_length=0.04,
                )
            else:
                handle.points = points
