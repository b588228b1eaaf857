"""Visual geometry of the robot: what programs draw of it, as the URDF has it."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Literal
from xml.etree import ElementTree

from pepper_driver.config.arrays import FloatArray
from pepper_driver.config.errors import ConfigError, reason
from pepper_driver.config.robot import RobotConfig
from pepper_driver.config.transforms import transform

_VISUAL_LINES = (b"<visual>", b"<material ")

Shape = Literal["box", "cylinder", "sphere"]


@dataclass(frozen=True, kw_only=True, eq=False)
class Visual:
    """One shape of a link; collisions and masses know nothing of it.

    Attributes:
        link: Name of the link.
        shape: Its kind.
        size: Of a box its lengths along x, y, z; of a cylinder radius and length along z; of a sphere its radius [m].
        transform_visual_to_link: (4, 4)
        rgba: Colour, each 0..1.
    """

    link: str
    shape: Shape
    size: tuple[float, ...]
    transform_visual_to_link: FloatArray
    rgba: tuple[float, float, float, float]


def load_visuals(robot: RobotConfig) -> tuple[Visual, ...]:
    """Return the visual geometry of all links.

    Raises:
        ConfigError: The URDF has a shape or a colour that this does not know.
    """
    return _load(robot.urdf)


def without_visuals(urdf: bytes) -> bytes:
    """Return the text of a URDF without the lines of its visual geometry: physics knows nothing of them."""
    lines = urdf.splitlines(keepends=True)
    return b"".join(line for line in lines if not line.lstrip().startswith(_VISUAL_LINES))


@lru_cache(maxsize=8)
def _load(urdf: Path) -> tuple[Visual, ...]:
    try:
        root = ElementTree.parse(urdf).getroot()
        colours = {m.attrib["name"]: _rgba(m) for m in root.findall("material")}
        return tuple(_visuals(root, colours))
    except (OSError, ElementTree.ParseError, KeyError, ValueError, AttributeError) as error:
        raise ConfigError(
            f"{urdf}: its visual geometry cannot be used ({reason(error)})"
        ) from error


def _visuals(
    root: ElementTree.Element, colours: dict[str, tuple[float, float, float, float]]
) -> Iterator[Visual]:
    for link in root.findall("link"):
        for element in link.findall("visual"):
            shape, size = _geometry(_child(element, "geometry"))
            origin = element.find("origin")
            places = {} if origin is None else origin.attrib
            yield Visual(
                link=link.attrib["name"],
                shape=shape,
                size=size,
                transform_visual_to_link=transform(
                    _numbers(places.get("xyz", "0 0 0")), _numbers(places.get("rpy", "0 0 0"))
                ),
                rgba=colours[_child(element, "material").attrib["name"]],
            )


def _geometry(geometry: ElementTree.Element) -> tuple[Shape, tuple[float, ...]]:
    (element,) = geometry
    if element.tag == "box":
        return "box", _numbers(element.attrib["size"])
    if element.tag == "cylinder":
        return "cylinder", (float(element.attrib["radius"]), float(element.attrib["length"]))
    if element.tag == "sphere":
        return "sphere", (float(element.attrib["radius"]),)
    raise ValueError(f"a shape is a box, cylinder or sphere, not '{element.tag}'")


def _rgba(material: ElementTree.Element) -> tuple[float, float, float, float]:
    red, green, blue, alpha = _numbers(_child(material, "color").attrib["rgba"])
    return red, green, blue, alpha


def _child(element: ElementTree.Element, tag: str) -> ElementTree.Element:
    found = element.find(tag)
    if found is None:
        raise KeyError(f"<{element.tag}> lacks <{tag}>")
    return found


def _numbers(text: str) -> tuple[float, ...]:
    return tuple(map(float, text.split()))
