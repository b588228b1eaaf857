"""Facts of the robot: joints, motors, sensors, limits, wheels, postures, names of the DCM."""

from __future__ import annotations

import xml.etree.ElementTree as ElementTree
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass as plain_dataclass
from functools import cached_property, lru_cache
from pathlib import Path
from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike
from pydantic.dataclasses import dataclass

from pepper_driver.config.arguments import checked_arguments
from pepper_driver.config.arrays import BoolArray, FloatArray
from pepper_driver.config.errors import (
    ArgumentError,
    ConfigError,
    PepperError,
    UnknownNameError,
    check_name,
    reason,
    shown,
    suggestion,
)
from pepper_driver.config.lines import with_lines
from pepper_driver.config.loading import STRICT, load, own_or_shipped, read_yaml
from pepper_driver.config.mistakes import as_written
from pepper_driver.config.parts import (
    Frame,
    HandGeometry,
    Limits,
    Motors,
    NaoqiNames,
    Positive,
    Sensors,
    Vector3,
    Wheels,
)

Posture = str | Mapping[str, float] | ArrayLike
"""A posture by name, joints by name with their angles [rad] (the others stay), or all 17 angles [rad]."""

LEGS = "legs"
"""Chain that carries the robot; its joints belong to the limb TRUNK."""

TRUNK = "trunk"
"""Limb of everything that carries the others: torso, legs and base."""

POSTURE_TOLERANCE = 2 * np.pi / 4096
"""[rad] Recorded postures touch the limits to one count of the encoder."""


class JointArray(np.ndarray[tuple[int], np.dtype[np.float64]]):
    """(17,) values of the joints, an array that also takes their names: ``position["HeadYaw"]``.

    Args:
        values: (17,) in the order of the robot's joints; copied.
        robot: Names the joints.
    """

    # NumPy makes views and results without __new__: they have no robot.
    _robot: RobotConfig | None = None

    def __new__(cls, values: FloatArray, robot: RobotConfig) -> Self:
        """Copy the values."""
        array = np.array(values, dtype=np.float64).view(cls)
        array._robot = robot
        return array

    def __getitem__(self, key: Any) -> Any:  # noqa: ANN401 as of NumPy's
        """Return what the key selects; of a name the joint's value, a float.

        Raises:
            UnknownNameError: No such joint.
        """
        if isinstance(key, str) and self._robot is not None:
            return float(self.view(np.ndarray)[self._robot.joint_index(key)])
        # A plain array: a part of the vector is no longer in the order of the joints.
        return self.view(np.ndarray)[key]


@plain_dataclass(frozen=True, kw_only=True)
class Joint:
    """A revolute joint as the URDF has it: limits in [rad], [rad/s], [N m]; ``axis`` in the frame of the child."""

    name: str
    parent: str
    child: str
    axis: Vector3
    lower: float
    upper: float
    velocity: float
    effort: float


@dataclass(frozen=True, kw_only=True, config=STRICT)
class _RobotFile:
    """The top file, ``pepper.yaml``; the other files are named in it."""

    name: str
    urdf: str
    cycle: Positive
    battery_voltage: Positive
    joint_names: tuple[str, ...]
    chains: dict[str, tuple[str, ...]]
    hands: HandGeometry
    postures: str
    motors: str
    sensors: str
    limits: str
    wheels: str
    naoqi: str


@plain_dataclass(frozen=True, kw_only=True)
class RobotConfig:
    """Description of the robot itself.

    Every 17-vector follows ``joint_names``. ``chains`` list joints from the trunk outwards. ``link_frames`` has the
    place of each link but the root on its parent, with the joint between them at 0.
    """

    name: str
    urdf: Path
    cycle: float
    battery_voltage: float
    joints: tuple[Joint, ...]
    links: tuple[str, ...]
    link_frames: dict[str, Frame]
    chains: dict[str, tuple[str, ...]]
    hands: HandGeometry
    motors: Motors
    sensors: Sensors
    limits: Limits
    wheels: Wheels
    naoqi: NaoqiNames
    postures: dict[str, FloatArray]

    @cached_property
    def joint_names(self) -> tuple[str, ...]:
        """Names of the 17 joints, in the order of every joint vector."""
        return tuple(joint.name for joint in self.joints)

    @cached_property
    def lower(self) -> FloatArray:
        """(17,) lower position limits [rad]."""
        return np.array([joint.lower for joint in self.joints])

    @cached_property
    def upper(self) -> FloatArray:
        """(17,) upper position limits [rad]."""
        return np.array([joint.upper for joint in self.joints])

    @cached_property
    def armature(self) -> FloatArray:
        """(17,) inertia on the joint coordinate that no link of the URDF carries [kg m2]: the fingers'."""
        inertia = self.hands.finger_inertia
        return np.array([inertia if n in self.hands.joints else 0.0 for n in self.joint_names])

    @cached_property
    def mirror(self) -> tuple[tuple[int, float], ...]:
        """By joint: the joint at its place in a mirror at the xz-plane, and the sign of that one's coordinate there.

        What a mirror shows moves by ``sign * q[index]``. Chains ``left_*`` and ``right_*`` change places, other joints
        keep theirs. An axis (x, y, z) is seen as (-x, y, -z); the aperture of a hand has no sign.
        """
        partner = {name: name for name in self.joint_names}
        for chain, names in self.chains.items():
            for side, other in (("left_", "right_"), ("right_", "left_")):
                if chain.startswith(side):
                    opposite = self.chains.get(other + chain.removeprefix(side), names)
                    partner.update(zip(names, opposite, strict=False))
        table = []
        for joint in self.joints:
            index = self.joint_index(partner[joint.name])
            x, y, z = self.joints[index].axis
            # An axis of rotation is a pseudovector: a mirror keeps its part normal to the plane, and reverses the rest.
            along = float(np.dot((-x, y, -z), joint.axis))
            aperture = joint.name in self.hands.joints
            table.append((index, 1.0 if aperture or along > 0 else -1.0))
        return tuple(table)

    @cached_property
    def limbs(self) -> dict[str, tuple[str, ...]]:
        """Joints of each limb, from the trunk outwards: the chains, with TRUNK in place of LEGS."""
        outer = {name: joints for name, joints in self.chains.items() if name != LEGS}
        return {TRUNK: self.chains.get(LEGS, ()), **outer}

    def limb_of(self, joint: str | None) -> str:
        """Limb that a joint belongs to; TRUNK for None, as contacts on trunk and base have it."""
        return next((name for name, joints in self.limbs.items() if joint in joints), TRUNK)

    def limb_of_link(self, link: str) -> str:
        """Limb that a link belongs to: that of the joint that carries it, or TRUNK."""
        return self.limb_of(
            next((joint.name for joint in self.joints if joint.child == link), None)
        )

    def joint_index(self, name: str) -> int:
        """Place of a joint in every joint vector.

        Raises:
            UnknownNameError: No such joint.
        """
        try:
            return self.joint_names.index(name)
        except ValueError:
            raise UnknownNameError("joint", name, self.joint_names) from None

    def chain_of(self, joint: str) -> tuple[str, ...]:
        """Return the chain that ``joint`` belongs to, from the trunk outwards."""
        return next(chain for chain in self.chains.values() if joint in chain)

    def resolve_posture(self, posture: Posture, current: FloatArray) -> ArrayLike:
        """Return the angles of a posture, not checked yet; joints that it does not name keep ``current`` (17,) [rad].

        Raises:
            UnknownNameError: No such posture or joint.
            ArgumentError: It is of another type.
        """
        if isinstance(posture, str):
            return self.posture(posture)
        if isinstance(posture, Mapping):
            angles: list[float] = current.tolist()
            for name, angle in posture.items():
                angles[self.joint_index(name)] = angle
            return angles
        if hasattr(posture, "__array__") or (
            isinstance(posture, Sequence) and not isinstance(posture, bytes)
        ):
            return posture
        raise ArgumentError(
            "a posture is its name, a mapping from joints to angles [rad], or all"
            f" {len(self.joint_names)} angles, got {shown(posture)}"
        )

    def posture(self, name: str) -> FloatArray:
        """(17,) a named posture [rad], a copy.

        Raises:
            UnknownNameError: No such posture.
        """
        check_name("posture", name, self.postures)
        # load_robot is cached: a change of its own array would be one for all callers.
        return self.postures[name].copy()


def _read_urdf(path: Path) -> tuple[dict[str, Joint], tuple[str, ...], dict[str, Frame]]:
    """Revolute joints by name, all link names, and the places of links on their parents, of a URDF."""
    try:
        root = ElementTree.parse(path).getroot()
        joints, frames = {}, {}
        for element in root.findall("joint"):
            name = element.get("name")
            parent, child = element.find("parent"), element.find("child")
            if parent is None or child is None:
                raise KeyError(f"joint {name} lacks parent or child")
            frames[child.attrib["link"]] = Frame(
                parent=parent.attrib["link"],
                xyz=_vector(element, "origin", "xyz", "0 0 0"),
                rpy=_vector(element, "origin", "rpy", "0 0 0"),
            )
            if element.get("type") != "revolute":
                continue
            limit = element.find("limit")
            if limit is None:
                raise KeyError(f"joint {name} lacks limit")
            name = element.attrib["name"]
            joints[name] = Joint(
                name=name,
                parent=parent.attrib["link"],
                child=child.attrib["link"],
                axis=_vector(element, "axis", "xyz", "1 0 0"),
                **{
                    key: float(limit.attrib[key])
                    for key in ("lower", "upper", "velocity", "effort")
                },
            )
        return joints, tuple(element.attrib["name"] for element in root.iter("link")), frames
    except (OSError, ElementTree.ParseError, KeyError, ValueError) as error:
        raise ConfigError(f"{path}: not a usable URDF ({reason(error)})") from error


def _vector(joint: ElementTree.Element, tag: str, key: str, default: str) -> Vector3:
    """Return three numbers of a part of a joint, or those that a URDF means where they are left out."""
    part = joint.find(tag)
    x, y, z = map(float, (default if part is None else part.get(key, default)).split())
    return x, y, z


def check_joint_keys(given: set[str], expected: set[str], where: str) -> None:
    """Raise a ConfigError unless ``given`` names exactly the joints ``expected``."""
    for name in sorted(given - expected):
        raise ConfigError(f"{where}: unknown joint '{name}'{suggestion(name, expected)}")
    missing = sorted(expected - given)
    if missing:
        raise ConfigError(f"{where}: no entry for joint {', '.join(missing)}")


def _load_postures(path: Path, joints: tuple[Joint, ...]) -> dict[str, FloatArray]:
    names = [joint.name for joint in joints]
    postures = {}
    for posture, values in read_yaml(path).items():
        where = f"{path}: key '{posture}'"
        if not isinstance(values, dict):
            raise ConfigError(f"{where}: expected joint names with angles [rad]")
        check_joint_keys(set(values), set(names), where)
        for joint in joints:
            value = values[joint.name]
            if not isinstance(value, int | float) or isinstance(value, bool):
                raise ConfigError(
                    f"{where}.{joint.name}: expected an angle [rad], got {as_written(value)}"
                )
            if not joint.lower - POSTURE_TOLERANCE <= value <= joint.upper + POSTURE_TOLERANCE:
                raise ConfigError(
                    f"{where}.{joint.name}: {value} rad lies outside {joint.lower} to {joint.upper} rad"
                )
        postures[str(posture)] = np.clip(
            np.array([float(values[name]) for name in names]),
            [joint.lower for joint in joints],
            [joint.upper for joint in joints],
        )
    return postures


@checked_arguments
@lru_cache(maxsize=8)
@with_lines
def load_robot(path: Path | str | None = None) -> RobotConfig:
    """Load a robot description.

    Args:
        path: A file in the form of the shipped ``pepper.yaml``, which is the default. The files it names are
            searched next to it.

    Raises:
        ConfigError: One line naming the file, the key and what is possible.
    """
    path = own_or_shipped(path, "pepper.yaml")
    top = load(_RobotFile, path)
    folder = path.parent
    in_urdf, links, link_frames = _read_urdf(folder / top.urdf)
    check_joint_keys(set(top.joint_names), set(in_urdf), f"{path}: key 'joint_names'")
    expected = set(top.joint_names)
    motors = load(Motors, folder / top.motors)
    check_joint_keys(set(motors.joints), expected, f"{folder / top.motors}: key 'joints'")
    for name, drive in motors.joints.items():
        if drive.type not in motors.types:
            raise ConfigError(
                f"{folder / top.motors}: key 'joints.{name}.type': unknown motor type '{drive.type}'"
                f"{suggestion(drive.type, motors.types)}"
            )
    chained = [name for chain in top.chains.values() for name in chain]
    check_joint_keys(set(chained), expected, f"{path}: key 'chains'")
    limits = load(Limits, folder / top.limits)
    for pair in limits.coupled:
        check_joint_keys({pair.driver, pair.driven} | expected, expected, f"{folder / top.limits}")
    joints = tuple(in_urdf[name] for name in top.joint_names)
    return RobotConfig(
        name=top.name,
        urdf=folder / top.urdf,
        cycle=top.cycle,
        battery_voltage=top.battery_voltage,
        joints=joints,
        links=links,
        link_frames=link_frames,
        chains=top.chains,
        hands=top.hands,
        motors=motors,
        sensors=load(Sensors, folder / top.sensors),
        limits=limits,
        wheels=load(Wheels, folder / top.wheels),
        naoqi=load(NaoqiNames, folder / top.naoqi),
        postures=_load_postures(folder / top.postures, joints),
    )


JointSelection = str | Sequence[str] | BoolArray
"""Joints: a name of a joint or a chain, some names, or a mask (17,) of bool."""


class JointSelectionError(PepperError, ValueError):
    """Neither names of joints nor a mask of them."""


def joint_mask(joints: JointSelection, robot: RobotConfig) -> BoolArray:
    """(17,) joints by name, as a mask; a mask as it is.

    Args:
        joints: ``"LElbowRoll"``, ``"left_arm"``, ``["head", "LHand"]`` or a mask (17,) of bool.
        robot: Its description.

    Raises:
        UnknownNameError: No such joint or chain.
        JointSelectionError: A mask of another shape or type, or neither names nor a mask.
    """
    count = len(robot.joint_names)
    if isinstance(joints, np.ndarray):
        if joints.shape == (count,) and joints.dtype == np.bool_:
            return joints
        raise JointSelectionError(
            f"a mask of joints is an array ({count},) of bool, got {joints.shape} of {joints.dtype}"
        )
    names = (joints,) if isinstance(joints, str) else joints
    if not isinstance(names, Iterable) or not all(isinstance(name, str) for name in names):
        raise JointSelectionError(
            f"joints are given by names, such as 'LElbowRoll' or ['left_arm', 'head'], or by a mask ({count},) of bool,"
            f" got {shown(joints)}"
        )
    mask = np.zeros(count, dtype=np.bool_)
    for name in names:
        members = robot.chains.get(name, (name,))
        for member in members:
            if member not in robot.joint_names:
                known = (*robot.chains, *robot.joint_names)
                raise UnknownNameError("joint or chain", name, known)
            mask[robot.joint_index(member)] = True
    return mask
