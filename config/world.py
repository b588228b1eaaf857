"""Objects around a simulated robot: ``worlds/*.yaml``, or a file of the user's own."""

from __future__ import annotations

from typing import Annotated, Literal, Self

from pydantic import Field, model_validator
from pydantic.dataclasses import dataclass

from pepper_driver.config.lines import with_lines
from pepper_driver.config.loading import STRICT, named_file, parse, read_yaml, shipped_names
from pepper_driver.config.parts import NonNegative, Positive, Vector3

SIZES = {
    "box": "three whole lengths along x, y, z",
    "sphere": "one number, the radius",
    "capsule": "two numbers, radius and length of the straight part along z",
}
"""What ``size`` takes for each shape [m]."""


@dataclass(frozen=True, kw_only=True, config=STRICT)
class WorldObject:
    """One object in the world. Poses and velocities are in the world, x forward of where the robot starts, z up.

    Attributes:
        shape: Its geometry; ``SIZES`` defines its ``size`` [m].
        mass: [kg]; None for a fixed object.
        position: Of its centre [m].
        orientation: Roll, pitch, yaw about fixed axes [rad].
        velocity: With which it starts [m/s]; it does not spin.
        start: Until then it hangs still [s]; then it flies, falls or stands.
        friction: Coulomb coefficient of its contacts.
        softness: Time in which a dent springs back [s].
    """

    shape: Literal["box", "sphere", "capsule"]
    size: Annotated[tuple[Positive, ...], Field(min_length=1, max_length=3)]
    mass: Positive | None
    position: Vector3
    orientation: Vector3 = (0.0, 0.0, 0.0)
    velocity: Vector3 = (0.0, 0.0, 0.0)
    start: NonNegative = 0.0
    friction: NonNegative = 0.6
    # MuJoCo: the time constant of solref must be at least two steps, of 2 ms each on the shipped plants.
    softness: Annotated[float, Field(ge=0.004)] = 0.02

    @model_validator(mode="after")
    def _check(self) -> Self:
        sizes = SIZES[self.shape]
        if len(self.size) != {"box": 3, "sphere": 1, "capsule": 2}[self.shape]:
            raise ValueError(f"size of a {self.shape} is {sizes}; {len(self.size)} are given")
        if self.mass is None and (any(self.velocity) or self.start):
            raise ValueError("velocity and start are for objects with a mass; this one is fixed")
        return self


@dataclass(frozen=True, kw_only=True, config=STRICT)
class World:
    """Objects by name. ``source`` is the file they came from, for messages."""

    name: str
    description: str
    objects: dict[str, WorldObject]
    source: str = ""


def world_names() -> tuple[str, ...]:
    """Names of the worlds shipped with the package."""
    return shipped_names("worlds")


@with_lines
def load_world(name: str) -> World:
    """Load a world by name, or from a path that ends in ``.yaml``.

    Raises:
        UnknownNameError: No shipped world has this name.
        ConfigError: The file is wrong; the message names file and key.
    """
    path = named_file("world", name, "worlds")
    return parse(World, {**read_yaml(path), "source": str(path)}, str(path))
