"""Groups of joints by name, and the places of effectors.

NAOqi 2.8 pages "Chain & Effector definitions", "General tools API". The texts of a robot's own errors are not
documented: those here are ours, with service and method first.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import atan2, cos, hypot, sin
from numbers import Real

import numpy as np

from pepper_driver.config import NaoqiServices, PepperError, RobotConfig, suggestion
from pepper_driver.config.arrays import FloatArray
from pepper_driver.config.transforms import transform

ARMS = ("LArm", "RArm")


class CallError(PepperError, RuntimeError):
    """A service cannot do what it was called for.

    Args:
        where: Service and method, for example ``ALMotion::setAngles``.
        problem: What is wrong, and what is possible.
    """

    def __init__(self, where: str, problem: str) -> None:
        super().__init__(f"{where}: {problem}")


class JointGroups:
    """The joints of the robot by NAOqi's names. Indices are places in ``RobotConfig.joint_names``.

    Attributes:
        chains: Indices of the joints of each chain.
        groups: The same of chains and of "Body", "Joints", "Actuators", "JointActuators".
        lower: (17,) limits [rad].
        upper: (17,) limits [rad].
        speed: (17,) largest speeds [rad/s].
        torque: (17,) largest torques [N m].
    """

    def __init__(self, config: RobotConfig, settings: NaoqiServices) -> None:
        self._names = config.joint_names
        self.chains = {
            chain: tuple(config.joint_index(joint) for joint in joints)
            for chain, joints in settings.chains.items()
        }
        body = tuple(index for chain in self.chains.values() for index in chain)
        hands = frozenset(config.joint_index(joint) for joint in config.hands.joints)
        self.hands = hands
        self.groups = {
            **self.chains,
            "Body": body,
            "JointActuators": body,
            "Joints": tuple(index for index in body if index not in hands),
            "Actuators": tuple(index for index in body if index in hands),
        }
        self.legs = frozenset(self.chains["Leg"])
        self.lower = [joint.lower for joint in config.joints]
        self.upper = [joint.upper for joint in config.joints]
        self.speed = [joint.velocity for joint in config.joints]
        self.torque = [joint.effort for joint in config.joints]

    def name(self, index: int) -> str:
        """Return the name of a joint."""
        return self._names[index]

    def names(self, group: object, where: str) -> list[str]:
        """Names of the joints in a group, or of the chains.

        Raises:
            CallError: No such group.
        """
        if group == "Chains":
            return list(self.chains)
        return [self._names[index] for index in self.joints(group, where)]

    def joints(self, names: object, where: str) -> list[int]:
        """Return the indices of joints from a name of a joint or group, or a list of such names.

        Raises:
            CallError: An unknown name, or the same joint twice.
        """
        given = names if isinstance(names, list | tuple) else [names]
        found: list[int] = []
        for name in given:
            if isinstance(name, str) and name in self.groups:
                found.extend(self.groups[name])
            elif isinstance(name, str) and name in self._names:
                found.append(self._names.index(name))
            else:
                known = suggestion(str(name), (*self.groups, *self._names))
                raise CallError(where, f"unknown joint or chain name: {name}{known}")
        if not found:
            raise CallError(where, "no joint is named")
        if len(set(found)) != len(found):
            raise CallError(where, f"a joint is named twice in {given}")
        return found

    def clipped(self, index: int, angle: float) -> float:
        """Return an angle within the limits of its joint."""
        return min(max(angle, self.lower[index]), self.upper[index])


def number(value: object, where: str, what: str) -> float:
    """Return a finite number; NAOqi's values may come as whole numbers too.

    Raises:
        CallError: It is of another type.
    """
    # `not <` refuses NaN too.
    if isinstance(value, bool) or not isinstance(value, Real) or not abs(float(value)) < 1e9:
        raise CallError(where, f"{what} must be a number, got {value!r}")
    return float(value)


def numbers(values: object, count: int, where: str, what: str) -> list[float]:
    """``count`` numbers: a list of them, or one for all.

    Raises:
        CallError: Another type, or another count.
    """
    if not isinstance(values, list | tuple):
        return [number(values, where, what)] * count
    if len(values) != count:
        raise CallError(where, f"{count} joints are named, but {len(values)} {what} given")
    return [number(value, where, what) for value in values]


def lists(values: object, count: int, where: str, what: str) -> list[list[float]]:
    """Return a list of numbers for each of ``count`` joints.

    Takes what NAOqi takes: a number for one joint or all, a list of them for one joint, a number for each joint, or a
    list for each joint.

    Raises:
        CallError: Another type, or another count.
    """
    if not isinstance(values, list | tuple):
        return [[number(values, where, what)] for _ in range(count)]
    nested = [isinstance(value, list | tuple) for value in values]
    if any(nested) != all(nested):
        raise CallError(where, f"{what} mixes numbers and lists")
    if not any(nested) and count == 1:
        values = [values]
    if len(values) != count:
        raise CallError(where, f"{count} joints are named, but {len(values)} {what} given")
    rows: Sequence[Sequence[object]] = [
        value if isinstance(value, list | tuple) else [value] for value in values
    ]
    return [[number(value, where, what) for value in row] for row in rows]


TORSO, WORLD, ROBOT = 0, 1, 2
"""FRAME_TORSO, FRAME_WORLD, FRAME_ROBOT."""


@dataclass(frozen=True, kw_only=True)
class _Link:
    """Place of a link on its parent: fixed transform, then a rotation of ``joint`` about ``axis``."""

    parent: str
    origin: FloatArray
    joint: int | None
    axis: FloatArray


class Kinematics:
    """Frames by NAOqi's names: joints, chains (their effectors), "Torso", sensors.

    NAOqi 2.8 page "Chain & Effector definitions". The robot's frame is base_link, on the floor.
    """

    def __init__(self, config: RobotConfig, settings: NaoqiServices) -> None:
        self._links = _read_links(config)
        hand = (settings.hand[0], settings.hand[1], -settings.hand[2])
        wheels = np.mean([position[:2] for position in config.wheels.positions], axis=0)
        none = (0.0, 0.0, 0.0)
        frames = {joint.name: (joint.child, none, none) for joint in config.joints}
        frames["Torso"] = ("torso", settings.torso, none)
        for chain, joints in settings.chains.items():
            last = [name for name in joints if name not in config.hands.joints][-1]
            frames[chain] = (frames[last][0], hand if chain.endswith("Arm") else none, none)
        frames["Leg"] = ("base_link", (float(wheels[0]), float(wheels[1]), 0.0), none)
        sensors = config.sensors
        for name, sensor in (*sensors.touch.items(), *sensors.buttons.items()):
            frames[name] = (sensor.parent, sensor.xyz, sensor.rpy)
        for name, sensor in sensors.bumpers.items():
            frames[f"Bumper/{name}"] = (sensor.parent, sensor.xyz, sensor.rpy)
        self._frames = {
            name: (link, transform(xyz, rpy)) for name, (link, xyz, rpy) in frames.items()
        }

    def pose(
        self, name: object, frame: object, angles: Sequence[float], base: FloatArray, where: str
    ) -> FloatArray:
        """(4, 4) transform of a part in a frame, at (17,) joint angles, with the base at (x, y, heading) in the world.

        Raises:
            CallError: No such part or frame.
        """
        if name not in self._frames:
            raise CallError(where, f"unknown name: {name}{suggestion(str(name), self._frames)}")
        if isinstance(frame, bool) or frame not in (TORSO, WORLD, ROBOT):
            raise CallError(where, f"unknown frame: {frame} (possible: 0 torso, 1 world, 2 robot)")
        in_robot = self._in_robot(str(name), angles)
        if frame == WORLD:
            x, y, heading = base.tolist()
            return transform((x, y, 0.0), (0.0, 0.0, heading)) @ in_robot
        if frame == TORSO:
            relative: FloatArray = np.linalg.inv(self._in_robot("Torso", angles)) @ in_robot
            return relative
        return in_robot

    def _in_robot(self, name: str, angles: Sequence[float]) -> FloatArray:
        link, pose = self._frames[name]
        while link in self._links:
            step = self._links[link]
            if step.joint is not None:
                # In a URDF the joint turns in the child's frame, behind the fixed origin.
                pose = _turned(step.axis, angles[step.joint]) @ pose
            pose = step.origin @ pose
            link = step.parent
        return pose


def position6(pose: FloatArray) -> list[float]:
    """x, y, z [m], wx, wy, wz [rad] of a (4, 4) transform; it turns by Rz(wz) Ry(wy) Rx(wx)."""
    turn = pose[:3, :3]
    # asin would lose digits near 90 deg, and fail where rounding takes its argument beyond 1.
    wy = atan2(-turn[2, 0], hypot(turn[0, 0], turn[1, 0]))
    wx = atan2(turn[2, 1], turn[2, 2])
    wz = atan2(turn[1, 0], turn[0, 0])
    return [*pose[:3, 3].tolist(), wx, wy, wz]


def _turned(axis: FloatArray, angle: float) -> FloatArray:
    """(4, 4) turn about an axis of length 1 (Rodrigues)."""
    x, y, z = axis.tolist()
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    pose = np.eye(4)
    pose[:3, :3] += sin(angle) * cross + (1 - cos(angle)) * (cross @ cross)
    return pose


def _read_links(config: RobotConfig) -> dict[str, _Link]:
    """Return the place of each link on its parent, but of the root."""
    # The opening of a hand turns nothing that has a name here.
    turning = {j.child: j for j in config.joints if j.name not in config.hands.joints}
    links = {}
    for child, frame in config.link_frames.items():
        joint = turning.get(child)
        links[child] = _Link(
            parent=frame.parent,
            origin=transform(frame.xyz, frame.rpy),
            joint=None if joint is None else config.joint_index(joint.name),
            axis=np.array((1.0, 0.0, 0.0) if joint is None else joint.axis),
        )
    return links
