"""The robot in space, drawn off-screen by MuJoCo: floor, robot, ghost of its command, arrows at the contacts."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from typing import Self

import mujoco
import numpy as np
import pinocchio as pin

from pepper_driver.config import RobotConfig
from pepper_driver.config.arrays import BoolArray, FloatArray, PixelArray
from pepper_driver.config.visuals import load_visuals
from pepper_driver.controller.model import RobotModel
from pepper_driver.observer import Contact
from pepper_driver.rendering import View
from pepper_driver.rendering.gl import RenderError, make_context, nothing_draws
from pepper_driver.viewer.drawing import (
    FORCE_LENGTH,
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

AZIMUTHS: dict[View, float] = {"front": 200.0, "left": 270.0, "right": 90.0, "back": 20.0}
"""Direction of view [deg] about the vertical, counted from the robot's; front and back a little from its left."""

ELEVATION, FIELD_OF_VIEW, DISTANCE, EYE_HEIGHT = -9.0, 28.0, 3.15, 0.64
"""[deg], [deg], [m], [m]: the robot with an arm raised fills the height of the picture."""

GHOST_DISTANCE, GHOST_ANGLE = 0.01, 0.05
"""[m], [rad] A part of the ghost is drawn where it is as far from the part of the robot."""

SHAFT_RADIUS = 0.012
"""[m] of an arrow."""

MAX_ARROW = 0.4
"""[m] A longer arrow would leave the picture; it is shortened."""

ARROW_SCALE = 2.0
"""MuJoCo draws an arrow half as long as its connector is."""

_SHAPES = {
    "box": mujoco.mjtGeom.mjGEOM_BOX,
    "cylinder": mujoco.mjtGeom.mjGEOM_CYLINDER,
    "sphere": mujoco.mjtGeom.mjGEOM_SPHERE,
}

_FLOOR = """
<mujoco>
  <visual>
    <global offwidth="{width}" offheight="{height}" fovy="{fov}"/>
    <quality shadowsize="2048" offsamples="4" numslices="28" numstacks="8"/>
    <headlight ambient="0.35 0.35 0.35" diffuse="0.33 0.33 0.33" specular="0 0 0"/>
    <rgba haze="0.93 0.94 0.96 1"/>
    <map znear="0.1" zfar="40" haze="0.3" shadowscale="0.3" shadowclip="2"/>
  </visual>
  <statistic center="0 0 0.6" extent="1"/>
  <asset>
    <texture name="sky" type="skybox" builtin="flat" rgb1="0.93 0.94 0.96" rgb2="0.93 0.94 0.96" width="8" height="8"/>
    <texture name="grid" type="2d" builtin="checker" mark="edge" width="256" height="256"
      rgb1="0.9 0.92 0.95" rgb2="0.86 0.88 0.92" markrgb="0.76 0.78 0.83"/>
    <material name="floor" texture="grid" texrepeat="2 2" texuniform="true" specular="0" shininess="0"/>
  </asset>
  <worldbody>
    <body name="lamp" mocap="true">
      <light type="directional" pos="0 0 3" dir="-0.5 -0.3 -1.3" diffuse="0.55 0.55 0.55" specular="0.12 0.12 0.12"
        castshadow="true"/>
    </body>
    <geom type="plane" size="0 0 0.05" material="floor"/>
  </worldbody>
</mujoco>
"""
"""[m] A square of the floor is half a metre wide."""


class SceneRenderer:
    """Draws moments of a robot from one side. It belongs to the thread that made it.

    Args:
        robot: Description of the robot.
        width: Of the picture, in pixels.
        height: The same.
        view: Side from which the robot is seen.
        heading: Yaw of the robot at first [rad], from which the sides are counted.

    Raises:
        RenderError: Nothing draws here without a display.
        ConfigError: The URDF has a shape that cannot be drawn.
    """

    def __init__(
        self,
        robot: RobotConfig,
        width: int,
        height: int,
        *,
        view: View = "front",
        heading: float = 0.0,
    ) -> None:
        self._robot, self._model = robot, RobotModel(robot)
        visuals = load_visuals(robot)
        tree = self._model.pin
        frames = [tree.frames[tree.getFrameId(visual.link)] for visual in visuals]
        self._types = [_SHAPES[visual.shape] for visual in visuals]
        self._sizes = [_geom_size(visual.shape, visual.size) for visual in visuals]
        self._colors = np.array([visual.rgba for visual in visuals])
        self._joints = [frame.parentJoint for frame in frames]
        self._in_joint = np.stack(
            [f.placement.homogeneous @ v.transform_visual_to_link for f, v in zip(frames, visuals, strict=True)]
        )  # fmt: skip
        links = [joint.child for joint in robot.joints]
        self._glowing = [
            (number, links.index(visual.link))
            for number, visual in enumerate(visuals)
            if visual.link in links
        ]
        self._centres = centres_of(visuals)
        self._context = make_context(width, height)
        try:
            self._floor = mujoco.MjModel.from_xml_string(
                _FLOOR.format(width=width, height=height, fov=FIELD_OF_VIEW)
            )
            self._data = mujoco.MjData(self._floor)
            self._scene = mujoco.MjvScene(self._floor, maxgeom=2 * len(visuals) + 200)
            self._target = mujoco.MjrContext(self._floor, mujoco.mjtFontScale.mjFONTSCALE_100.value)
            mujoco.mjr_setBuffer(mujoco.mjtFramebuffer.mjFB_OFFSCREEN.value, self._target)
        except mujoco.FatalError as error:  # the driver cannot do what MuJoCo needs
            self._context.free()
            raise RenderError(nothing_draws()) from error
        self._rectangle = mujoco.MjrRect(0, 0, width, height)
        self._options = mujoco.MjvOption()
        self._camera = mujoco.MjvCamera()
        self._camera.type = mujoco.mjtCamera.mjCAMERA_FREE
        self._camera.azimuth = AZIMUTHS[view] + np.degrees(heading)
        self._camera.elevation = ELEVATION
        # In a picture higher than wide the robot fills the width: its arms reach as far as it is high.
        self._camera.distance = DISTANCE * max(1.0, 0.8 * height / width)
        self._pixels = np.empty((height, width, 3), dtype=np.uint8)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Free what the driver holds."""
        self._target.free()
        self._context.free()

    def draw(self, picture: Picture, contacts: Iterable[Contact] = ()) -> PixelArray:
        """Return (height, width, 3) pixels of a moment.

        Args:
            picture: State of the robot.
            contacts: At this moment.
        """
        x, y, _ = np.nan_to_num(picture.base).tolist()
        self._camera.lookat[:] = x, y, EYE_HEIGHT
        self._data.mocap_pos[0] = x, y, 0.0
        mujoco.mj_forward(self._floor, self._data)
        mujoco.mjv_updateScene(
            self._floor,
            self._data,
            self._options,
            None,
            self._camera,
            mujoco.mjtCatBit.mjCAT_ALL.value,
            self._scene,
        )
        self._scene.geoms[0].castshadow = 0  # the floor would dim itself in stripes
        commanded = self._poses(picture.commanded, picture)
        poses = self._poses(picture.position, picture)
        self._add_robot(poses, picture)
        for force in picture.forces:
            longest = FORCE_LENGTH * float(np.linalg.norm(force.force))
            shorter = min(
                1.0, MAX_ARROW / max(longest, 1e-9)
            )  # at its tail: its tip is where it acts
            self._add_arrow(force_arrow(replace(force, force=shorter * force.force)))
        for contact in contacts:
            arrows = touch_arrows(contact, self._robot, self._link_pose, self._centres)
            self._add_arrow(next(arrows)[1])  # without that of its deviation
        self._add_ghost(commanded, _apart(commanded, poses))
        self._context.make_current()
        mujoco.mjr_render(self._rectangle, self._scene, self._target)
        mujoco.mjr_readPixels(self._pixels, None, self._rectangle, self._target)
        return np.flipud(self._pixels).copy()

    def _poses(self, position: FloatArray, picture: Picture) -> FloatArray:
        """(n, 4, 4) transforms of all visuals to the world."""
        data = self._model.data
        pin.forwardKinematics(
            self._model.pin, data, configuration(self._model, position, picture.base)
        )
        base = data.oMi[1].homogeneous
        turn = np.eye(4)
        turn[:3, :3] = rotation_of_tilt(np.nan_to_num(picture.tilt))
        self._to_tilted = base @ turn @ np.linalg.inv(base)
        joints = np.stack([data.oMi[joint].homogeneous for joint in self._joints])
        poses: FloatArray = self._to_tilted @ joints @ self._in_joint
        return poses

    def _link_pose(self, link: str) -> FloatArray:
        """(4, 4) transform of a link to the world, in the posture that was computed last."""
        tree = self._model.pin
        frame = tree.frames[tree.getFrameId(link)]
        joint = self._model.data.oMi[frame.parentJoint].homogeneous
        pose: FloatArray = self._to_tilted @ joint @ frame.placement.homogeneous
        return pose

    def _add_robot(self, poses: FloatArray, picture: Picture) -> None:
        colors = self._colors.copy()
        ratios = glow(picture.excess)
        for number, joint in self._glowing:
            if ratios[joint] > 0.0:
                colors[number, :3] = (
                    glowing(255.0 * colors[number, :3], float(ratios[joint])) / 255.0
                )
        for number, pose in enumerate(poses):
            self._add(self._types[number], self._sizes[number], pose, colors[number])

    def _add_ghost(self, poses: FloatArray, apart: BoolArray) -> None:
        color = np.array([*np.array(GHOST_COLOR) / 255.0, GHOST_OPACITY])
        for number in np.flatnonzero(apart).tolist():
            self._add(
                self._types[number], GHOST_SCALE * self._sizes[number], poses[number], color
            ).castshadow = 0

    def _add_arrow(self, arrow: Arrow) -> None:
        color = np.array([*np.array(arrow.color) / 255.0, 1.0])
        geom = self._add(mujoco.mjtGeom.mjGEOM_ARROW, np.zeros(3), np.eye(4), color)
        way = arrow.end - arrow.start
        length = ARROW_SCALE * min(1.0, MAX_ARROW / max(float(np.linalg.norm(way)), 1e-9))
        tip = arrow.start + length * way
        mujoco.mjv_connector(
            geom, mujoco.mjtGeom.mjGEOM_ARROW.value, SHAFT_RADIUS, arrow.start, tip
        )
        geom.emission, geom.castshadow = 0.4, 0

    def _add(
        self, shape: mujoco.mjtGeom, size: FloatArray, pose: FloatArray, color: FloatArray
    ) -> mujoco.MjvGeom:
        geom = self._scene.geoms[self._scene.ngeom]
        self._scene.ngeom += 1
        mujoco.mjv_initGeom(
            geom,
            shape.value,
            size,
            pose[:3, 3],
            np.ascontiguousarray(pose[:3, :3]).ravel(),
            color.astype(np.float32),
        )
        geom.castshadow = 1
        return geom


def _geom_size(shape: str, size: tuple[float, ...]) -> FloatArray:
    """(3,) size of a shape as MuJoCo needs it: half the lengths."""
    if shape == "box":
        return 0.5 * np.array(size)
    if shape == "cylinder":
        return np.array([size[0], 0.5 * size[1], 0.0])
    return np.array([size[0], 0.0, 0.0])


def _apart(poses: FloatArray, others: FloatArray) -> BoolArray:
    """(n,) which of two drawings of a part differ visibly."""
    distance = np.linalg.norm(poses[:, :3, 3] - others[:, :3, 3], axis=1)
    turn = np.einsum("nji,nji->n", poses[:, :3, :3], others[:, :3, :3])  # trace of the rotation
    angle = np.arccos(np.clip(0.5 * (turn - 1.0), -1.0, 1.0))
    result: BoolArray = (distance > GHOST_DISTANCE) | (angle > GHOST_ANGLE)
    return result
