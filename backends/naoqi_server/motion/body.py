"""Names of joints and groups as ALMotion takes them, and the limits behind them.

NAOqi 2.8 pages "Chain & Effector definitions", "General tools API". The texts of a robot's own errors are not
documented: those here are ours, with service and method first.
"""

from __future__ import annotations

from collections.abc import Sequence
from numbers import Real

from pepper_driver.config import NaoqiServices, PepperError, RobotConfig, suggestion

ARMS = ("LArm", "RArm")


class CallError(PepperError, RuntimeError):
    """A service cannot do what it was called for.

    Args:
        where: Service and method, for example ``ALMotion::setAngles``.
        problem: What is wrong, and what is possible.
    """

    def __init__(self, where: str, problem: str) -> None:
        super().__init__(f"{where}: {problem}")


class Body:
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
        """Of a joint."""
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
        """Indices of joints from a name of a joint or group, or a list of such names.

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
        """An angle within the limits of its joint."""
        return min(max(angle, self.lower[index]), self.upper[index])


def number(value: object, where: str, what: str) -> float:
    """A finite number; NAOqi's values may come as whole numbers too.

    Raises:
        CallError: It is something else.
    """
    if isinstance(value, bool) or not isinstance(value, Real) or not abs(float(value)) < 1e9:
        raise CallError(where, f"{what} must be a number, got {value!r}")
    return float(value)


def numbers(values: object, count: int, where: str, what: str) -> list[float]:
    """``count`` numbers: a list of them, or one for all.

    Raises:
        CallError: Something else, or another count.
    """
    if not isinstance(values, list | tuple):
        return [number(values, where, what)] * count
    if len(values) != count:
        raise CallError(where, f"{count} joints are named, but {len(values)} {what} given")
    return [number(value, where, what) for value in values]


def lists(values: object, count: int, where: str, what: str) -> list[list[float]]:
    """A list of numbers for each of ``count`` joints.

    Takes what NAOqi takes: a number for one joint or all, a list of them for one joint, a number for each joint, or a
    list for each joint.

    Raises:
        CallError: Something else, or another count.
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
