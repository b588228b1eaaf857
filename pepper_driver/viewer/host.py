"""A robot that runs for its page: it plays what the page asks for, and starts again with other settings."""

from __future__ import annotations

import queue
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from pepper_driver.backends import with_query
from pepper_driver.backends.selection import parse_uri
from pepper_driver.config import (
    ConfigError,
    PepperError,
    RobotConfig,
    load_experiment,
    load_plant,
    load_robot,
)
from pepper_driver.config.errors import check_name
from pepper_driver.config.loading import shipped_names
from pepper_driver.observers import observer_names
from pepper_driver.reflexes import Reflex
from pepper_driver.reflexes.declared import declare, make_reflex, make_reflexes, reflex_kinds
from pepper_driver.robot import Pepper
from pepper_driver.safety import FaultError
from pepper_driver.viewer import NO_OBSERVER

LOOK_PERIOD = 0.2
"""[s] between two looks at what the page asks for."""

_SOURCE = "the view"


@dataclass(frozen=True, kw_only=True)
class HostedRun:
    """Settings of a run.

    Attributes:
        uri: Which robot.
        observer: Name; None for none.
        models: Model file of the observer, None for the shipped one.
        reflexes: Gains by kind.
        log: File; later runs get a number.
        number: Of the run, from 1.
    """

    uri: str
    observer: str | None = "fusion"
    models: Path | None = None
    reflexes: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    log: Path | None = None
    number: int = 1

    def make_pepper(self) -> Pepper:
        """Return the robot, not started.

        Raises:
            PepperError: The settings are wrong.
        """
        log = self.log
        if log is not None and self.number > 1:
            log = log.with_stem(f"{log.stem}_{self.number}")
        return Pepper(
            self.uri,
            observer=self.observer,
            models=self.models,
            log=log,
            reflexes=make_gained_reflexes(self.reflexes, load_robot()),
            real_time=True,
        )


def make_gained_reflexes(
    gains: Mapping[str, Mapping[str, float]], robot: RobotConfig
) -> tuple[Reflex, ...]:
    """Return reflexes of these kinds with their gains.

    Raises:
        ConfigError: An unknown kind or gain, one out of range, or two reflexes that claim the same joints.
    """
    declared = {kind: {"do": kind, **numbers} for kind, numbers in gains.items()}
    return make_reflexes(declared, robot, _SOURCE)


def default_gains(robot: RobotConfig) -> dict[str, dict[str, float]]:
    """Return the kinds of reflex that need no arguments, each with its numbers."""
    gains = {}
    for kind in reflex_kinds():
        with suppress(PepperError):
            entry = declare(make_reflex({"do": kind}, robot, _SOURCE, kind))
            gains[kind] = {name: v for name, v in entry.items() if isinstance(v, float)}
    return gains


class Host:
    """Runs a robot until it is interrupted, and does what its page asks for.

    Args:
        run: Settings of the first run.

    Raises:
        PepperError: A name in the settings is wrong. What else is wrong is found as the robot is made, by :meth:`run`.
    """

    def __init__(self, run: HostedRun) -> None:
        self._robot, self._run = load_robot(), run
        self._asked: queue.SimpleQueue[HostedRun | str] = queue.SimpleQueue()
        self._simulated = parse_uri(run.uri).scheme == "mujoco"
        self._check(run)

    @property
    def choices(self) -> dict[str, object]:
        """Choices that the page can offer."""
        choices: dict[str, object] = {
            "motions": [*shipped_names("motions"), *shipped_names("experiments")]
        }
        if self._simulated:
            choices |= {
                "plants": shipped_names("plants"),
                "observers": [*observer_names(), NO_OBSERVER],
                "reflexes": default_gains(self._robot),
                "current": {
                    "plant": parse_uri(self._run.uri).query.get("plant", "nominal"),
                    "observer": self._run.observer or NO_OBSERVER,
                    "reflexes": {kind: dict(g) for kind, g in self._run.reflexes.items()},
                },
            }
        return choices

    def perform(self, do: str, arguments: Mapping[str, Any]) -> None:
        """Take a request of the page; it is done by :meth:`run`.

        Raises:
            PepperError: It cannot be done.
        """
        if do == "play":
            self._asked.put(load_experiment(arguments["name"], self._robot).name)
        elif self._simulated:
            self._asked.put(self._changed(**arguments))
        else:
            raise ConfigError("a real robot is started by its program alone")

    def _changed(
        self, *, plant: str, observer: str, reflexes: Mapping[str, Mapping[str, float]]
    ) -> HostedRun:
        """Return the settings of the next run, checked."""
        check_name("plant", plant, shipped_names("plants"))  # no file of this computer
        uri = with_query(self._run.uri, plant=plant)
        if parse_uri(self._run.uri).query.get("plant", "nominal") != plant:
            uri = with_query(uri, draw=None, day=None)  # those of the plant before
        run = replace(
            self._run,
            uri=uri,
            observer=None if observer == NO_OBSERVER else observer,
            models=None,
            reflexes=reflexes,
            number=self._run.number + 1,
        )
        self._check(run)
        return run

    def _check(self, run: HostedRun) -> None:
        """Refuse unknown names, in a moment: to make a robot takes a second."""
        if self._simulated:
            load_plant(parse_uri(run.uri).query.get("plant", "nominal"), self._robot)
        if run.observer is not None:
            check_name("observer", run.observer, observer_names())
        make_gained_reflexes(run.reflexes, self._robot)

    def run(self, on_run: Callable[[Pepper], None]) -> None:
        """Run until Ctrl-C, or until a real robot is stopped.

        Args:
            on_run: Called with each robot before it starts.

        Raises:
            PepperError: The robot cannot be started, or is lost.
        """
        while True:
            pepper = self._run.make_pepper()
            on_run(pepper)
            try:
                with pepper:
                    self._run = self._serve(pepper)
            except FaultError:
                if not self._simulated:
                    raise
                self._run = self._next_run()

    def _serve(self, pepper: Pepper) -> HostedRun:
        """Play what is asked for, until another run is."""
        while True:
            try:
                asked = self._asked.get(timeout=LOOK_PERIOD)
            except queue.Empty:
                pepper.run(0.0)  # raises what ended the ticks
                continue
            if isinstance(asked, HostedRun):
                return asked
            pepper.play(asked)

    def _next_run(self) -> HostedRun:
        """Wait until another run is asked for."""
        while not isinstance(asked := self._asked.get(), HostedRun):
            pass
        return asked
