"""The map of limbs, joints and links in docs/robot.md is that of the robot's description."""

from runpy import run_path
from xml.etree import ElementTree

import numpy as np

from pepper_driver.config import RobotConfig, load_robot
from pepper_driver.config.robot import TRUNK
from pepper_driver.controller.model import RobotModel
from support import ROOT

PAGE = ROOT / "docs" / "robot.md"
ROBOT = load_robot()


def chains(robot: RobotConfig) -> str:
    """Return one line for each limb: links, and the joints between them in brackets."""
    width = max(map(len, robot.limbs))
    lines = []
    for limb, names in robot.limbs.items():
        joints = [robot.joints[robot.joint_index(name)] for name in names]
        links = " ".join(f"[{joint.name}] {joint.child}" for joint in joints)
        first = "base_link Tibia" if limb == TRUNK else joints[0].parent
        lines.append(f"{limb:{width}}  {first} {links}")
    return "\n".join(lines)


def table(robot: RobotConfig) -> str:
    """Return the table of links that a joint carries."""
    origins = {
        (element.attrib["name"]): [float(x) for x in origin.attrib["xyz"].split()]
        for element in ElementTree.parse(robot.urdf).getroot().iter("joint")
        if (origin := element.find("origin")) is not None
    }
    rows = [
        "| limb | link | carried by | which turns about | range, rad | next joints, at xyz in this link, m |",
        "| --- | --- | --- | --- | --- | --- |",
    ]
    for limb, names in robot.limbs.items():
        for name in names:
            joint = robot.joints[robot.joint_index(name)]
            axis = next(
                ("-" if value < 0 else "") + letter
                for letter, value in zip("xyz", joint.axis, strict=True)
                if value
            )
            following = (
                f"{other.name} {' '.join(f'{x:.3f}' for x in origins[other.name])}"
                for other in robot.joints
                if other.parent == joint.child
            )
            limits = f"{joint.lower:.2f} to {joint.upper:.2f}"
            cells = (limb, joint.child, name, axis, limits, "; ".join(following))
            rows.append("| " + " | ".join(cells).rstrip() + " |")
    return "\n".join(rows)


def test_the_page_has_the_map_of_the_description() -> None:
    page = PAGE.read_text()
    for part in (chains(ROBOT), table(ROBOT)):
        assert part in page, f"docs/robot.md needs:\n{part}"


def test_links_point_where_the_page_says() -> None:
    """With all joints at 0, x is forward, y left, z up; from the elbows on, x is 9 degrees up."""
    model = RobotModel(ROBOT)
    raised = np.radians(9.0)
    for link in ROBOT.links:
        if link.startswith("Wheel"):
            continue
        rotation = model.link_pose(link, np.zeros(17))[:3, :3]
        beyond_elbow = any(part in link for part in ("Elbow", "ForeArm", "wrist", "gripper"))
        x = [np.cos(raised), 0.0, np.sin(raised)] if beyond_elbow else [1.0, 0.0, 0.0]
        np.testing.assert_allclose(rotation[:, 0], x, atol=1e-4)
        np.testing.assert_allclose(rotation[:, 1], [0.0, 1.0, 0.0], atol=1e-4)
    hands = [model.link_pose(f"{side}_wrist", np.zeros(17))[:3, 3] for side in "lr"]
    shoulders = [model.link_pose(f"{side}Shoulder", np.zeros(17))[:3, 3] for side in "LR"]
    for hand, shoulder in zip(hands, shoulders, strict=True):
        assert hand[0] - shoulder[0] > 0.3  # the arm is stretched forward, along x


def test_the_picture_is_that_of_the_description() -> None:
    drawn = run_path(str(ROOT / "docs" / "robot_map.py"))["RobotMap"](ROBOT).svg()
    picture = (ROOT / "docs" / "robot_map.svg").read_text()
    assert picture == drawn, "run: python docs/robot_map.py"
    words = [
        element.text or "" for element in ElementTree.fromstring(picture).iter() if element.text
    ]
    names = {*ROBOT.joint_names, *ROBOT.links, *ROBOT.limbs}
    assert names <= {word.split(" (")[0] for word in words}
