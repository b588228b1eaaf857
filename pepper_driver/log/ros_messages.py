"""Topics of a log under ROS 2 names: joint states, transforms and the URDF, for programs that draw robots.

The bytes of a message are made once, with all names in it; a tick writes its stamp, angles and rotations into them.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence
from dataclasses import dataclass
from math import cos, isfinite, sin

import numpy as np

from pepper_driver.backends.log_file import CDR_HEADER
from pepper_driver.config import RobotConfig
from pepper_driver.config.arrays import FloatArray, ShortArray
from pepper_driver.config.kernels import Out, Records, kernel, make_records
from pepper_driver.config.parts import Frame, Vector3

EVERY = 5
"""Ticks from one message of ``/joint_states`` and ``/tf`` to the next: 17 a second are enough for the eye."""

ODOM = "odom"
"""Frame in which the base started, by its wheels."""

VERTICAL = (0.0, 0.0, 1.0)
"""Axis of the base; links that no joint moves are not turned about it."""

LAST_STAMP = 2**31 * 10**9 - 1
"""[ns] ROS 2 counts seconds in 32 bits: later times are stamped with this one."""

DEFINITIONS = {
    "builtin_interfaces/Time": "int32 sec\nuint32 nanosec\n",
    "std_msgs/Header": "builtin_interfaces/Time stamp\nstring frame_id\n",
    "std_msgs/String": "string data\n",
    "geometry_msgs/Vector3": "float64 x\nfloat64 y\nfloat64 z\n",
    "geometry_msgs/Quaternion": "float64 x 0\nfloat64 y 0\nfloat64 z 0\nfloat64 w 1\n",
    "geometry_msgs/Transform": "geometry_msgs/Vector3 translation\ngeometry_msgs/Quaternion rotation\n",
    "geometry_msgs/TransformStamped": (
        "std_msgs/Header header\nstring child_frame_id\ngeometry_msgs/Transform transform\n"
    ),
    "sensor_msgs/JointState": (
        "std_msgs/Header header\nstring[] name\nfloat64[] position\nfloat64[] velocity\nfloat64[] effort\n"
    ),
    "tf2_msgs/TFMessage": "geometry_msgs/TransformStamped[] transforms\n",
}
"""Fields of the messages of ROS 2, by package and name."""


@dataclass(frozen=True)
class RosTopic:
    """A topic with messages of ROS 2.

    Attributes:
        topic: Its name.
        package: That defines the message.
        message: Its name.
    """

    topic: str
    package: str
    message: str

    @property
    def type(self) -> str:
        """Name of the message as ROS 2 writes it: ``std_msgs/msg/String``."""
        return f"{self.package}/msg/{self.message}"

    @property
    def schema(self) -> str:
        """Definition of the message, and those of all messages in it, as MCAP requires them."""
        first, *others = _with_parts(f"{self.package}/{self.message}")
        parts = [f"{'=' * 80}\nMSG: {name}\n{DEFINITIONS[name]}" for name in others]
        return "".join([DEFINITIONS[first], *parts])


DESCRIPTION = RosTopic("/robot_description", "std_msgs", "String")
TF_STATIC = RosTopic("/tf_static", "tf2_msgs", "TFMessage")
TF = RosTopic("/tf", "tf2_msgs", "TFMessage")
JOINT_STATES = RosTopic("/joint_states", "sensor_msgs", "JointState")
ROS_TOPICS = (DESCRIPTION, TF_STATIC, TF, JOINT_STATES)

RosMessages = tuple[tuple[str, bytes], ...]
"""Messages, each with its topic."""


def _with_parts(name: str) -> list[str]:
    """Return the name of a message, then those of all messages in it, each once."""
    found = [name]
    for each in found:  # grows meanwhile
        kinds = (line.split()[0].removesuffix("[]") for line in DEFINITIONS[each].splitlines())
        found += [kind for kind in kinds if kind in DEFINITIONS and kind not in found]
    return found


class _Message:
    """The bytes of a message in plain CDR, with numbers that can be replaced.

    Args:
        data: All of it.

    Attributes:
        integers: A view of what stands behind the header, as numbers of 4 bytes.
        reals: The same, as numbers of 8 bytes.
    """

    def __init__(self, data: bytes) -> None:
        # Numbers of 8 bytes have their places in a message from the end of its header on; kernels need them in memory.
        lead = 8 - len(CDR_HEADER)
        memory = np.zeros(-(-(lead + len(data)) // 8)).view(np.uint8)
        memory[lead : lead + len(data)] = np.frombuffer(data, np.uint8)
        self.integers = memory[8:].view(np.int32)
        self.reals = memory[8:].view(np.float64)
        self._data = memory[lead : lead + len(data)]

    def __bytes__(self) -> bytes:
        return self._data.tobytes()


class _Cdr:
    """Builds a message, one value after the other. What it returns are their places in a :class:`_Message`."""

    def __init__(self) -> None:
        self._data = bytearray()

    def integers(self, *values: int) -> int:
        """Add numbers of 32 bits."""
        return self._add("I", 4, values)

    def reals(self, values: Sequence[float]) -> int:
        """Add numbers of 64 bits."""
        return self._add("d", 8, values)

    def text(self, text: str) -> None:
        """Add a text: its length with the zero at its end, and both."""
        encoded = text.encode() + b"\0"
        self.integers(len(encoded))
        self._data += encoded

    def header(self, frame: str) -> int:
        """Add a std_msgs/Header; returns the place of its stamp."""
        stamp = self.integers(0, 0)
        self.text(frame)
        return stamp

    def _add(self, code: str, size: int, values: Sequence[float]) -> int:
        self._data += bytes(-len(self._data) % size)
        place = len(self._data) // size
        self._data += struct.pack(f"<{len(values)}{code}", *values)
        return place

    def message(self) -> _Message:
        """Return the message."""
        return _Message(CDR_HEADER + self._data)


class _Turn:
    """A transform in a message: where stamp and rotation begin, and the quaternion of the rotation.

    It is (x, y, z, w) with the joint at 0, and (turned_x, ...) half a turn further. At an angle q it is cos(q/2) times
    the one plus sin(q/2) times the other.
    """

    stamp: int
    rotation: int
    x: float
    y: float
    z: float
    w: float
    turned_x: float
    turned_y: float
    turned_z: float
    turned_w: float


@kernel
def _turn(
    turns: Records[_Turn],
    angle: FloatArray,
    sec: int,
    nanosec: int,
    integers: Out[ShortArray],
    reals: Out[FloatArray],
) -> bool:
    """Write stamps and rotations into a message; return False, and write no more, where an angle is not finite."""
    for j in range(len(turns)):
        if not isfinite(angle[j]):
            return False
        turn = turns[j]
        integers[turn.stamp], integers[turn.stamp + 1] = sec, nanosec
        c, s = cos(angle[j] / 2), sin(angle[j] / 2)
        reals[turn.rotation] = c * turn.x + s * turn.turned_x
        reals[turn.rotation + 1] = c * turn.y + s * turn.turned_y
        reals[turn.rotation + 2] = c * turn.z + s * turn.turned_z
        reals[turn.rotation + 3] = c * turn.w + s * turn.turned_w
    return True


class _Transforms:
    """A TFMessage with the transforms of links from their parents.

    Args:
        links: By name, each with its place on its parent and the axis that it turns about.

    Attributes:
        message: The message.
        translations: Places of the translations in it.
    """

    def __init__(self, links: Sequence[tuple[str, Frame, Vector3]]) -> None:
        cdr = _Cdr()
        cdr.integers(len(links))
        self._turns = make_records(_Turn, len(links))
        self.translations = []
        for place, (link, frame, axis) in enumerate(links):
            stamp = cdr.header(frame.parent)
            cdr.text(link)
            self.translations.append(cdr.reals(frame.xyz))
            straight = _quaternion(frame.rpy)
            turned = _half_turned(straight, axis)
            self._turns[place] = (stamp, cdr.reals(straight), *straight, *turned)
        self.message = cdr.message()
        self._write = _turn.load()

    def write(self, time: int, angles: FloatArray) -> bool:
        """Write stamps [ns] and rotations [rad]; return False where an angle is not finite."""
        message = self.message
        sec, nanosec = divmod(time, 10**9)
        return self._write(self._turns, angles, sec, nanosec, message.integers, message.reals)


def _quaternion(rpy: Vector3) -> tuple[float, ...]:
    """Return x, y, z, w of angles as URDFs have them: Rz(yaw) Ry(pitch) Rx(roll)."""
    (cr, sr), (cp, sp), (cy, sy) = ((cos(a / 2), sin(a / 2)) for a in rpy)
    return (
        sr * cp * cy - cr * sp * sy,
        cr * sp * cy + sr * cp * sy,
        cr * cp * sy - sr * sp * cy,
        cr * cp * cy + sr * sp * sy,
    )


def _half_turned(q: Sequence[float], axis: Vector3) -> tuple[float, ...]:
    """Return a quaternion x, y, z, w, turned by half a turn about an axis of its own frame."""
    x, y, z, w = q
    a, b, c = (np.array(axis) / np.linalg.norm(axis)).tolist()
    return (
        w * a + y * c - z * b,
        w * b - x * c + z * a,
        w * c + x * b - y * a,
        -x * a - y * b - z * c,
    )


class RobotMessages:
    """Makes the messages of a robot. All methods belong to one thread.

    Transforms go from each link to the links that it carries, and from :data:`ODOM` to the root. Those of the 17 joints
    and of the base are in ``/tf``, the others in ``/tf_static``: fixed links, and wheels, whose angle nothing measures.

    A joint state has names and measured positions. Velocities and efforts are empty, since no sensor measures them: the
    torque in ``/tick`` is that of touches, not that of motors.

    Args:
        robot: Its description.
        urdf: The text of its URDF.
    """

    def __init__(self, robot: RobotConfig, urdf: str) -> None:
        self._urdf = urdf
        frames, names = robot.link_frames, robot.joint_names
        moved = {joint.child: joint.axis for joint in robot.joints}
        root = next(link for link in robot.links if link not in frames)
        base = (root, Frame(parent=ODOM, xyz=(0.0, 0.0, 0.0), rpy=(0.0, 0.0, 0.0)), VERTICAL)
        fixed = [(link, frame, VERTICAL) for link, frame in frames.items() if link not in moved]
        self._fixed, self._no_turn = _Transforms(fixed), np.zeros(len(fixed))
        self._moving = _Transforms([base, *((k, frames[k], axis) for k, axis in moved.items())])
        at = self._moving.translations[0]
        self._base = self._moving.message.reals[at : at + 2]
        self._angles: FloatArray = np.zeros(1 + len(names))
        cdr = _Cdr()
        stamp = cdr.header("")
        cdr.integers(len(names))
        for name in names:
            cdr.text(name)
        cdr.integers(len(names))
        first = cdr.reals(self._angles[1:].tolist())
        cdr.integers(0, 0)
        self._states = cdr.message()
        self._stamp = self._states.integers[stamp : stamp + 2]
        self._positions = self._states.reals[first : first + len(names)]

    def once(self, time: int) -> RosMessages:
        """Return the messages that a log has once, stamped ``time`` [ns]: URDF and fixed transforms."""
        cdr = _Cdr()
        cdr.text(self._urdf)
        self._fixed.write(min(time, LAST_STAMP), self._no_turn)
        return (
            (DESCRIPTION.topic, bytes(cdr.message())),
            (TF_STATIC.topic, bytes(self._fixed.message)),
        )

    def sample(self, time: int, position: FloatArray, base_pose: FloatArray) -> RosMessages:
        """Return transforms and joint state of a sample; none where a number in them is not finite.

        Args:
            time: Their stamp [ns].
            position: (17,) measured [rad].
            base_pose: (3,) x [m], y [m], heading [rad] of the base since the start.
        """
        angles, moving = self._angles, self._moving
        time = min(time, LAST_STAMP)
        angles[1:] = position
        x, y, angles[0] = base_pose.tolist()
        if not (isfinite(x + y) and moving.write(time, angles)):
            return ()
        self._base[:] = x, y
        self._positions[:] = position
        self._stamp[:] = divmod(time, 10**9)
        return ((TF.topic, bytes(moving.message)), (JOINT_STATES.topic, bytes(self._states)))
