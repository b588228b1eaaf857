"""Picture of links, limbs, joints and frames, drawn from the robot's description: ``python docs/robot_map.py``.

Writes ``docs/robot_map.svg``. The shapes are the collision primitives of ``config/pepper.urdf``. The same description
gives the same file.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from xml.etree import ElementTree

import numpy as np

from pepper_driver.config import RobotConfig, load_robot
from pepper_driver.config.arrays import FloatArray
from pepper_driver.config.files import write_text
from pepper_driver.controller.model import RobotModel

FILE = Path(__file__).with_suffix(".svg")
WIDTH, HEIGHT = 1160, 1070
SCALE = 820.0
"""[px/m]"""
ORIGIN = np.array([565.0, 1010.0])
"""[px] Place of the origin of base_link."""
AZIMUTH, ELEVATION = np.radians([22.0, 10.0])
"""Direction of the viewer: from straight in front to the robot's left, and upwards."""
POSTURE = {
    "LShoulderPitch": 0.1,
    "RShoulderPitch": 0.1,
    "LShoulderRoll": 1.5,
    "RShoulderRoll": -1.5,
    "LElbowRoll": -0.01,
    "RElbowRoll": 0.01,
}
"""[rad] Arms to the sides, so that no link hides another."""
AXIS_LENGTH = 0.085
"""[m] Length of the axes of a frame."""
FRAMES = (
    "base_link",
    "torso",
    "Head",
    *("LBicep", "LForeArm", "l_wrist"),
    *("RBicep", "RForeArm", "r_wrist"),
)
COLOURS = {
    "trunk": "#dde3e7",
    "head": "#ffe3b8",
    "left_arm": "#c9e4fb",
    "right_arm": "#ecd2f1",
}
AXES = (("x", "#c62828"), ("y", "#2e7d32"), ("z", "#1565c0"))
EYES = np.array([[0.09, 0.036, 0.15], [0.09, -0.036, 0.15]])
"""[m] In the frame of Head."""


def project(points: FloatArray) -> FloatArray:
    """Return (n, 2) places in the picture [px] of (n, 3) points in base_link [m]."""
    sin, cos = np.sin(AZIMUTH), np.cos(AZIMUTH)
    across = points @ [-sin, cos, 0.0]
    up = points @ [-np.sin(ELEVATION) * cos, -np.sin(ELEVATION) * sin, np.cos(ELEVATION)]
    return ORIGIN + SCALE * np.column_stack([across, -up])


def depth(points: FloatArray) -> float:
    """Return the mean distance of (n, 3) points towards the viewer [m]."""
    level = [np.cos(AZIMUTH), np.sin(AZIMUTH), 0.0]
    towards = np.cos(ELEVATION) * np.array(level) + [0.0, 0.0, np.sin(ELEVATION)]
    return float((points @ towards).mean())


def hull(points: FloatArray) -> FloatArray:
    """Return the corners of the convex hull of (n, 2) points, in order."""
    corners = sorted({(float(x), float(y)) for x, y in points.round(2)})
    halves = []
    for side in (corners, corners[::-1]):
        chain: list[tuple[float, float]] = []
        for x, y in side:
            while len(chain) > 1:
                (ax, ay), (bx, by) = chain[-2:]
                if (bx - ax) * (y - ay) - (by - ay) * (x - ax) > 0.0:
                    break
                chain.pop()
            chain.append((x, y))
        halves += chain[:-1]
    return np.array(halves)


def surface(geometry: ElementTree.Element) -> FloatArray:
    """Return (n, 3) points on a primitive [m]."""
    angles = np.linspace(0.0, 2.0 * np.pi, 48, endpoint=False)
    ring = np.column_stack([np.cos(angles), np.sin(angles), np.zeros(48)])
    size = geometry.attrib
    if geometry.tag == "box":
        half = np.array([float(x) for x in size["size"].split()]) / 2.0
        return np.array(np.meshgrid(*([-1.0, 1.0] for _ in half))).reshape(3, -1).T * half
    radius = float(size["radius"])
    if geometry.tag == "cylinder":
        end = np.array([0.0, 0.0, float(size["length"]) / 2.0])
        return np.vstack([radius * ring - end, radius * ring + end])
    levels = np.linspace(-np.pi / 2.0, np.pi / 2.0, 25)
    return radius * np.vstack([np.cos(a) * ring + [0.0, 0.0, np.sin(a)] for a in levels])


def rotation(roll: float, pitch: float, yaw: float) -> FloatArray:
    """Return the (3, 3) rotation matrix of a URDF origin."""
    (sr, sp, sy), (cr, cp, cy) = np.sin([roll, pitch, yaw]), np.cos([roll, pitch, yaw])
    return np.array(
        [
            [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
            [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
            [-sp, cp * sr, cp * cr],
        ]
    )


def primitives(robot: RobotConfig) -> Iterator[tuple[str, FloatArray]]:
    """Yield link and surface (n, 3) in its frame [m] of each collision primitive."""
    for link in ElementTree.parse(robot.urdf).getroot().iter("link"):
        for collision in link.iter("collision"):
            origin, geometry = collision.find("origin"), collision.find("geometry")
            if origin is not None and geometry is not None:
                xyz, rpy = (
                    [float(x) for x in origin.attrib[key].split()] for key in ("xyz", "rpy")
                )
                yield link.attrib["name"], surface(geometry[0]) @ rotation(*rpy).T + xyz


def line(a: FloatArray, b: FloatArray, style: str) -> str:
    """Return a line between two places [px]."""
    return f'<line x1="{a[0]:.1f}" y1="{a[1]:.1f}" x2="{b[0]:.1f}" y2="{b[1]:.1f}" {style}/>'


def text(place: FloatArray, words: str, style: str, anchor: str = "start") -> str:
    """Return a line of text at a place [px]."""
    return (
        f'<text x="{place[0]:.1f}" y="{place[1]:.1f}" text-anchor="{anchor}" {style}>{words}</text>'
    )


class RobotMap:
    """Drawing of a robot in one posture.

    Args:
        robot: Its description.
    """

    def __init__(self, robot: RobotConfig) -> None:
        self._robot = robot
        model, position = RobotModel(robot), np.zeros(len(robot.joint_names))
        for name, angle in POSTURE.items():
            position[robot.joint_index(name)] = angle
        self._poses = {link: model.link_pose(link, position) for link in robot.links}
        self._axes = {
            joint.name: next(
                ("-" if value < 0 else "") + letter
                for letter, value in zip("xyz", joint.axis, strict=True)
                if value
            )
            for joint in robot.joints
        }

    def svg(self) -> str:
        """Return the picture."""
        parts = [
            f'<svg xmlns="http://www.w3.org/2000/svg" width="{WIDTH}" height="{HEIGHT}" '
            f'viewBox="0 0 {WIDTH} {HEIGHT}" font-family="sans-serif" font-size="15">',
            "<title>Links, limbs, joints and frames of Pepper</title>",
            f'<rect width="{WIDTH}" height="{HEIGHT}" fill="white"/>',
            *self._shapes(),
            *self._joints(),
            *self._frames(),
            *self._labels(),
            *self._legend(),
            "</svg>",
        ]
        return "\n".join(parts) + "\n"

    def _place(self, link: str, point: Sequence[float] = (0.0, 0.0, 0.0)) -> FloatArray:
        """Return the place of a point of a link [px]."""
        pose = self._poses[link]
        (place,) = project((pose[:3, :3] @ point + pose[:3, 3])[np.newaxis])
        return np.asarray(place)

    def _shapes(self) -> Iterator[str]:
        """Yield the links, the farthest first."""
        drawn = []
        for link, points in primitives(self._robot):
            pose = self._poses[link]
            world = points @ pose[:3, :3].T + pose[:3, 3]
            colour = COLOURS[self._robot.limb_of_link(link)]
            corners = " ".join(f"{x:.1f},{y:.1f}" for x, y in hull(project(world)))
            outline = (
                f'<polygon points="{corners}" fill="{colour}" stroke="#78909c" stroke-width="1"/>'
            )
            drawn.append((depth(world), outline))
        yield from (outline for _, outline in sorted(drawn))
        for eye in EYES:
            x, y = self._place("Head", tuple(eye))
            yield f'<circle cx="{x:.1f}" cy="{y:.1f}" r="9" fill="#37474f"/>'
            yield f'<circle cx="{x + 2.5:.1f}" cy="{y - 3:.1f}" r="2.5" fill="white"/>'

    def _joints(self) -> Iterator[str]:
        """Yield the bones, from the origin of a link to that of the next one, and a dot for each joint."""
        for joint in self._robot.joints:
            a, b = self._place(joint.parent), self._place(joint.child)
            yield line(a, b, 'stroke="#546e7a" stroke-width="2" stroke-dasharray="5 4"')
        for joint in self._robot.joints:
            x, y = self._place(joint.child)
            yield f'<circle cx="{x:.1f}" cy="{y:.1f}" r="4.5" fill="#263238"/>'

    def _frames(self) -> Iterator[str]:
        """Yield the axes of some links."""
        for link in FRAMES:
            for number, (name, colour) in enumerate(AXES):
                unit = np.zeros(3)
                unit[number] = AXIS_LENGTH
                a, b = self._place(link), self._place(link, tuple(unit))
                yield line(a, b, f'stroke="{colour}" stroke-width="3"')
                beyond = a + 1.25 * (b - a) + [-4.0, 5.0]
                yield text(beyond, name, f'fill="{colour}" font-size="13"')

    def _label(self, words: list[str], at: FloatArray, to: FloatArray, style: str) -> Iterator[str]:
        """Yield lines of text next to a place ``to``, with a line from there to ``at`` [px]."""
        yield line(at, to, 'stroke="#90a4ae" stroke-width="1"')
        outward, anchor = (6.0, "start") if to[0] >= ORIGIN[0] else (-6.0, "end")
        for number, word in enumerate(words):
            yield text(np.add(to, [outward, 5.0 + 18.0 * number]), word, style, anchor)

    def _joint_label(self, names: list[str], to: FloatArray) -> Iterator[str]:
        """Yield the names of joints at one place, with the axes that they turn about."""
        joint = self._robot.joints[self._robot.joint_index(names[0])]
        words = [
            name if name in self._robot.hands.joints else f"{name} ({self._axes[name]})"
            for name in names
        ]
        yield from self._label(words, self._place(joint.child), to, 'fill="#263238"')

    def _link_label(self, link: str, at: FloatArray, to: FloatArray) -> Iterator[str]:
        """Yield the name of a link."""
        style = 'fill="#6d4c41" font-weight="bold"'
        yield from self._label([link], at, to, style)

    def _labels(self) -> Iterator[str]:
        """Yield the names of all joints, above and left, and of all links, below and right."""
        for side in "LR":
            low = side.lower()
            groups = {
                "Bicep": [f"{side}ShoulderPitch", f"{side}ShoulderRoll"],
                "ForeArm": [f"{side}ElbowYaw", f"{side}ElbowRoll"],
            }
            for (link, names), height in zip(groups.items(), (190.0, 140.0), strict=True):
                yield from self._joint_label(names, self._place(side + link) - [0.0, height])
            yield from self._joint_label(
                [f"{side}WristYaw"], self._place(f"{low}_wrist") - [0.0, 78.0]
            )
            yield from self._joint_label(
                [f"{side}Hand"], self._place(f"{low}_gripper") - [0.0, 52.0]
            )
            places = {
                f"{side}Shoulder": self._place(f"{side}Shoulder"),
                f"{side}Bicep": self._place(f"{side}Bicep", (0.1, 0.0, 0.0)),
                f"{side}Elbow": self._place(f"{side}Elbow"),
                f"{side}ForeArm": self._place(f"{side}ForeArm", (0.08, 0.0, 0.0)),
                f"{low}_wrist": self._place(f"{low}_wrist"),
                f"{low}_gripper": self._place(f"{low}_gripper"),
            }
            for number, (link, at) in enumerate(places.items()):
                yield from self._link_label(link, at, np.add(at, [0.0, 190.0 - 25.0 * number]))
        left, right = ORIGIN[0] - 215.0, ORIGIN[0] + 215.0
        for name, rise in (("HipRoll", 450.0), ("HipPitch", 400.0), ("KneePitch", 270.0)):
            yield from self._joint_label([name], np.array([left, ORIGIN[1] - rise]))
        neck = self._place("Neck")
        yield from self._joint_label(["HeadYaw", "HeadPitch"], neck - [123.0, 34.0])
        for link, point, rise in (
            ("torso", (0.05, 0.08, 0.08), 480.0),
            ("Hip", (0.05, 0.06, 0.01), 430.0),
            ("Pelvis", (0.05, 0.06, 0.15), 350.0),
            ("Tibia", (0.1, 0.12, -0.2), 230.0),
            ("WheelFL_link", (0.0, 0.0, -0.03), 40.0),
        ):
            yield from self._link_label(
                link, self._place(link, point), np.array([right, ORIGIN[1] - rise])
            )
        yield from self._link_label(
            "Head", self._place("Head", (0.0, 0.07, 0.16)), np.add(neck, [100.0, -175.0])
        )
        yield from self._link_label("Neck", np.add(neck, [10.0, 3.0]), np.add(neck, [142.0, -25.0]))
        for link, rise in (("WheelFR_link", 70.0), ("WheelB_link", 40.0), ("base_link", 10.0)):
            to = np.array([left - 20.0, ORIGIN[1] - rise])
            yield from self._link_label(link, self._place(link), to)

    def _legend(self) -> Iterator[str]:
        """Yield the colours of the limbs, and what lines and letters stand for."""
        for number, (limb, colour) in enumerate(COLOURS.items()):
            y = HEIGHT - 190.0 + 26.0 * number
            yield f'<rect x="20" y="{y:.0f}" width="18" height="18" fill="{colour}" stroke="#78909c"/>'
            yield text(np.array([46.0, y + 14.0]), limb, 'fill="#263238"')
        lines = (
            ("joint (axis it turns about)", 'fill="#263238"'),
            ("link", 'fill="#6d4c41" font-weight="bold"'),
            ("axes of a link: x, y, z", 'fill="#263238"'),
        )
        for number, (words, style) in enumerate(lines):
            yield text(np.array([20.0, HEIGHT - 66.0 + 24.0 * number]), words, style)


def main() -> None:
    """Write the picture."""
    write_text(FILE, RobotMap(load_robot()).svg())


if __name__ == "__main__":
    main()
