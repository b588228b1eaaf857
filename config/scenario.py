"""Scenarios: how the robot is moved and pushed, for identification, demonstration and evaluation."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from pydantic import Field
from pydantic.dataclasses import dataclass

from pepper_driver.config.errors import ConfigError, suggestion
from pepper_driver.config.loading import STRICT, load, package_file
from pepper_driver.config.parts import NotNegative, Positive, Vector3
from pepper_driver.config.robot import RobotConfig

Share = Annotated[float, Field(ge=0, le=1)]


@dataclass(frozen=True, kw_only=True, config=STRICT)
class IdentificationScenario:
    """Free motion of one joint; see ``scenarios/identify.yaml`` for the meaning of each key."""

    estimation_stiffness: tuple[Positive, ...]
    test_stiffness: Positive
    sweeps: Annotated[int, Field(ge=1)]
    largest_offset: Annotated[float, Field(ge=0, lt=0.5)]
    setpoints: Annotated[int, Field(ge=1)]
    dwell: tuple[Positive, Positive]
    neighbour_range: Share
    settle: NotNegative


@dataclass(frozen=True, kw_only=True, config=STRICT)
class PushPoint:
    """A point of a link, ``xyz`` [m] in the link's frame."""

    link: str
    xyz: Vector3


@dataclass(frozen=True, kw_only=True, config=STRICT)
class DemoScenario:
    """Random motion with pushes; see ``scenarios/demo.yaml`` for the meaning of each key."""

    joints: tuple[str, ...]
    also_move: tuple[str, ...]
    stiffness: Positive
    range: Share
    also_range: Share
    period: Positive
    push_times: tuple[NotNegative, ...]
    push_jitter: NotNegative
    degrees: tuple[Positive, Positive]
    duration: tuple[Positive, Positive]
    largest_load: Share
    push_points: dict[str, PushPoint]


def load_identification_scenario(path: Path | None = None) -> IdentificationScenario:
    """The scenario in ``path``, by default the shipped ``scenarios/identify.yaml``."""
    return load(IdentificationScenario, path or package_file("scenarios", "identify.yaml"))


def load_demo_scenario(robot: RobotConfig, path: Path | None = None) -> DemoScenario:
    """The scenario in ``path``, by default the shipped ``scenarios/demo.yaml``."""
    path = path or package_file("scenarios", "demo.yaml")
    scenario = load(DemoScenario, path)
    for key in ("joints", "also_move", "push_points"):
        for name in getattr(scenario, key):
            if name not in robot.joint_names:
                raise ConfigError(
                    f"{path}: key '{key}': unknown joint '{name}'"
                    f"{suggestion(name, robot.joint_names)}"
                )
    for joint in scenario.joints:
        point = scenario.push_points.get(joint)
        if point is None:
            raise ConfigError(f"{path}: key 'push_points': no entry for joint {joint}")
        if point.link not in robot.links:
            raise ConfigError(
                f"{path}: key 'push_points.{joint}.link': unknown link '{point.link}'"
                f"{suggestion(point.link, robot.links)}"
            )
    return scenario
