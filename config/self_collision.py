"""Parts of the robot that must not touch one another: capsules of links, pairs of links, distances."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Annotated

from pydantic import Field
from pydantic.dataclasses import dataclass

from pepper_driver.config.errors import ConfigError, suggestion
from pepper_driver.config.lines import with_lines
from pepper_driver.config.loading import STRICT, load, own_or_shipped
from pepper_driver.config.parts import Positive, Vector3
from pepper_driver.config.robot import RobotConfig


@dataclass(frozen=True, kw_only=True, config=STRICT)
class Capsule:
    """All points nearer than ``radius`` to the line from ``start`` to ``end`` [m], in the frame of a link."""

    start: Vector3
    end: Vector3
    radius: Positive


@dataclass(frozen=True, kw_only=True, config=STRICT)
class SelfCollisionSettings:
    """Capsules by link, the pairs of links that are kept apart, and how far.

    A pair is watched below ``interaction_distance`` [m] and kept ``security_distance`` [m] apart; one that starts
    nearer is moved apart at no more than ``recovery_speed`` [m/s].
    """

    interaction_distance: Positive
    security_distance: Positive
    recovery_speed: Positive
    capsules: dict[str, Annotated[tuple[Capsule, ...], Field(min_length=1)]]
    pairs: tuple[tuple[str, str], ...]


@with_lines
def load_self_collision(
    robot: RobotConfig, path: Path | str | None = None
) -> SelfCollisionSettings:
    """Self-collision settings for ``robot`` from ``path``, by default the shipped ``self_collision.yaml``.

    Raises:
        ConfigError: A link that the robot has not, a pair without capsules, of one link or given twice, an interaction
            distance that is not above the security distance; beyond what :func:`load` refuses.
    """
    path = own_or_shipped(path, "self_collision.yaml")
    settings = load(SelfCollisionSettings, path)
    if settings.interaction_distance <= settings.security_distance:
        raise ConfigError(
            f"{path}: key 'interaction_distance': {settings.interaction_distance} m is not above"
            f" the security distance, {settings.security_distance} m"
        )
    _check_links(settings.capsules, robot.links, f"{path}: key 'capsules'", "unknown link")
    seen: set[frozenset[str]] = set()
    for number, pair in enumerate(settings.pairs):
        where = f"{path}: key 'pairs.{number}'"
        _check_links(pair, robot.links, where, "unknown link")
        _check_links(pair, settings.capsules, where, "no capsules for link")
        if pair[0] == pair[1]:
            raise ConfigError(f"{where}: '{pair[0]}' cannot be kept apart from itself")
        # Pairs have no order.
        if frozenset(pair) in seen:
            raise ConfigError(f"{where}: '{pair[0]}' and '{pair[1]}' are given twice")
        seen.add(frozenset(pair))
    return settings


def _check_links(given: Iterable[str], known: Iterable[str], where: str, problem: str) -> None:
    known = tuple(known)
    for link in given:
        if link not in known:
            raise ConfigError(f"{where}: {problem} '{link}'{suggestion(link, known)}")
