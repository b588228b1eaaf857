"""The objects of a world: bodies of the MuJoCo model, and those that hang still until they are thrown."""

from __future__ import annotations

from dataclasses import dataclass
from math import ceil

import mujoco
import numpy as np

from pepper_driver.config import ConfigError, PlantConfig, World
from pepper_driver.config.arrays import FloatArray
from pepper_driver.config.world import WorldObject

DEPTH = 0.001
"""[m] Objects that are deeper than this in the robot, in each other or in the floor at the start are refused."""

_COLOUR = (0.85, 0.55, 0.2, 1.0)


def body_name(thing: str) -> str:
    """Name of the MuJoCo body, geometry and joint of an object."""
    return f"object_{thing}"


def add_objects(
    spec: mujoco.MjSpec,
    world: World,
    plant: PlantConfig,
    *,
    object_bit: int,
    robot_bit: int,
    floor_bit: int,
) -> None:
    """Put the objects of a world around the robot, and a floor under those that can fall."""
    for name, thing in world.objects.items():
        quaternion = np.empty(4)
        mujoco.mju_euler2Quat(quaternion, np.array(thing.orientation), "XYZ")  # fixed axes
        body = spec.worldbody.add_body(name=body_name(name), pos=thing.position, quat=quaternion)
        if thing.mass is not None:
            body.add_freejoint(name=body_name(name))
        geom = body.add_geom(
            name=body_name(name),
            rgba=_COLOUR,
            contype=object_bit,
            conaffinity=robot_bit | object_bit | floor_bit,
            priority=1,  # its friction and softness hold in all contacts
            friction=[thing.friction, 0.005, 0.0001],
            solref=[thing.softness, 1.0],
        )
        _shape(geom, thing)
        if thing.mass is not None:
            geom.mass = thing.mass
    if plant.base == "fixed" and any(t.mass is not None for t in world.objects.values()):
        spec.worldbody.add_geom(
            name="floor",
            type=mujoco.mjtGeom.mjGEOM_PLANE,
            size=[10, 10, 0.1],
            rgba=[0.8, 0.8, 0.8, 1],
            contype=floor_bit,
            conaffinity=0,
        )


def _shape(geom: mujoco.MjsGeom, thing: WorldObject) -> None:
    """Shape and size; MuJoCo uses half lengths."""
    if thing.shape == "box":
        geom.type, geom.size = mujoco.mjtGeom.mjGEOM_BOX, [0.5 * length for length in thing.size]
    elif thing.shape == "sphere":
        geom.type, geom.size = mujoco.mjtGeom.mjGEOM_SPHERE, [thing.size[0], 0.0, 0.0]
    else:
        radius, length = thing.size
        geom.type, geom.size = mujoco.mjtGeom.mjGEOM_CAPSULE, [radius, 0.5 * length, 0.0]


def check_clearance(mj: mujoco.MjModel, data: mujoco.MjData, world: World) -> None:
    """Refuse a start at which an object is inside the robot, another object or the floor.

    Two fixed objects may overlap: that builds one object of two.

    Raises:
        ConfigError: Names the object, what it overlaps, and how far.
    """
    names = {mj.geom(body_name(name)).id: name for name in world.objects}
    for number in range(data.ncon):
        contact = data.contact[number]
        pair = [int(contact.geom1), int(contact.geom2)]
        pair.sort(key=lambda geom: geom not in names)
        if pair[0] not in names or contact.dist > -DEPTH:
            continue
        name = names[pair[0]]
        other = mj.geom(pair[1]).name
        if pair[1] in names:
            other = f"'{names[pair[1]]}'"
        elif other != "floor":
            other = mj.body(mj.geom_bodyid[pair[1]]).name
        raise ConfigError(
            f"{world.source or world.name}: key 'objects.{name}.position': '{name}' overlaps {other} by "
            f"{-1000 * contact.dist:.0f} mm at the start: move it away, or start in another posture"
        )


@dataclass(frozen=True, kw_only=True)
class _Throw:
    """An object that hangs still up to step ``start``; ``pose`` (7,) and ``velocity`` (6,) as MuJoCo has them."""

    start: int
    position: slice
    speed: slice
    pose: FloatArray
    velocity: FloatArray


class Throws:
    """Holds objects still until their start, and throws them.

    What is held follows from the time alone, so that there is no state to save.
    """

    def __init__(self, mj: mujoco.MjModel, data: mujoco.MjData, world: World) -> None:
        self._data, self._step = data, float(mj.opt.timestep)
        self._throws = []
        for name, thing in world.objects.items():
            if thing.mass is None or not (thing.start or any(thing.velocity)):
                continue
            joint = mj.joint(body_name(name))
            qpos, dof = int(joint.qposadr[0]), int(joint.dofadr[0])
            self._throws.append(
                _Throw(
                    start=ceil(thing.start / self._step - 1e-9),
                    position=slice(qpos, qpos + 7),
                    speed=slice(dof, dof + 6),
                    pose=np.array(mj.qpos0[qpos : qpos + 7]),
                    velocity=np.array([*thing.velocity, 0.0, 0.0, 0.0]),
                )
            )
        self._last = max((throw.start for throw in self._throws), default=-1)

    @property
    def waiting(self) -> bool:
        """True while an object is still to be thrown."""
        return self._last >= 0 and round(self._data.time / self._step) <= self._last

    def hold(self) -> None:
        """Put all that wait where they were, and throw those whose time is the step to come."""
        data, now = self._data, round(self._data.time / self._step)
        for throw in self._throws:
            if now <= throw.start:
                data.qpos[throw.position] = throw.pose
                data.qvel[throw.speed] = throw.velocity if now == throw.start else 0.0
