"""Run of a log, as objects: its ticks, settings, observer, reflexes."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TypeVar

from pepper_driver.backends import Command
from pepper_driver.backends.fields import COMMAND_FIELDS, Column, objects
from pepper_driver.backends.log_file import read_log_file
from pepper_driver.backends.replay import ReplayBackend
from pepper_driver.config import (
    ControllerSettings,
    ObserverSettings,
    PepperError,
    RobotConfig,
    SafetySettings,
    load_observer_settings,
    load_robot,
)
from pepper_driver.config.arguments import as_path, checked_arguments
from pepper_driver.config.loading import parse
from pepper_driver.controller import Reference, SentCommand, Tick
from pepper_driver.log import RunLog
from pepper_driver.log.reader import usual_layout
from pepper_driver.observer import ContactObserver, ModelFileError, Observer
from pepper_driver.observers import contact_observer, make_observer
from pepper_driver.reflexes import Reflex
from pepper_driver.reflexes.declared import REFLEX_GROUP, make_reflex

T = TypeVar("T")


class ReplayError(PepperError, RuntimeError):
    """A recording does not hold what its replay needs; the message says what, and what to give instead."""


@dataclass(frozen=True, kw_only=True)
class LoggedRun:
    """A log, read for a replay.

    Attributes:
        path: Of the log.
        robot: Its description.
        log: The contents.
        backend: Steps through it.
    """

    path: Path
    robot: RobotConfig
    log: RunLog
    backend: ReplayBackend

    @cached_property
    def ticks(self) -> tuple[Tick, ...]:
        """All that an observer saw. Their arrays are those of the log."""
        return tuple(self._commands(Tick, self.log.fields, measurement=self.backend.measurements))

    @cached_property
    def unmatched(self) -> dict[int, SentCommand]:
        """Commands that no tick answers, by the step in which they were given."""
        table = self.log.unmatched
        return dict(zip(table["step"].tolist(), self._commands(SentCommand, table), strict=True))

    def _commands(
        self, make: Callable[..., T], table: Mapping[str, Column], **more: Iterable[object]
    ) -> Iterator[T]:
        """Commands of a table as they were sent, and more of each."""
        columns = {field: table[field.name] for field in COMMAND_FIELDS}
        reference = objects(Reference, "reference", columns)
        sent = objects(Command, "sent", columns)
        return objects(make, "", columns, reference=reference, sent=sent, **more)

    @property
    def references(self) -> list[Reference | None]:
        """References of the controller at the end of each tick, as far as the log has them."""
        made = {step: sent.reference for step, sent in self.unmatched.items()}
        for step, tick in zip(self.backend.answered.tolist(), self.ticks, strict=True):
            made.setdefault(step, tick.reference)
        return [made.get(step + 1) for step in self.backend.steps.tolist()]

    @cached_property
    def passed_over(self) -> list[list[tuple[int, SentCommand]]]:
        """For each tick older commands than it answers that no tick does, and how many ticks before they were given."""
        newest, found = -1, []
        for step, answered in zip(
            self.backend.steps.tolist(), self.backend.answered.tolist(), strict=True
        ):
            between = [k for k in range(newest + 1, answered) if k in self.unmatched]
            found.append([(step - k, self.unmatched[k]) for k in between])
            newest = max(newest, answered)
        return found

    @property
    def controller_settings(self) -> ControllerSettings:
        """Controller settings of the recorded run.

        Raises:
            PepperError: They are missing, or not to be understood.
        """
        return self._settings("controller_settings", ControllerSettings)

    @property
    def safety_settings(self) -> SafetySettings:
        """Safety settings of the recorded run.

        Raises:
            PepperError: They are missing, or not to be understood.
        """
        return self._settings("safety_settings", SafetySettings)

    @property
    def from_start(self) -> bool:
        """True if the log begins as a run does: at rest, with stiff motors."""
        first = self.ticks[0]
        moving = first.reference.velocity.any() or first.reference.base_twist.any()
        return not moving and bool((first.sent.stiffness == 1.0).all())

    @property
    def has_observer(self) -> bool:
        """True if there was an observer."""
        return self.log.metadata.get("observer", "none") != "none"

    def observer(
        self,
        name: str | None = None,
        models: Path | None = None,
        settings: Path | None = None,
    ) -> Observer | None:
        """Return an observer for these ticks: that of the recorded run, unless another one is given.

        Args:
            name: Another one, with the settings and models of today.
            models: Other models.
            settings: Other settings, as in ``observer.yaml``.

        Returns:
            None where there was none.

        Raises:
            PepperError: It cannot be made.
        """
        identities = self.backend.info.identities
        if name is not None and settings is None:
            return make_observer(name, self.robot, identities, models)
        if name is None and not self.has_observer:
            if models is not None or settings is not None:
                raise ReplayError(f"{self.path}: the run had no observer; name one with --observer")
            return None
        run = self.log.metadata
        mode = name or run.get("observer_mode")
        if mode is None or ("observer_models_sha256" not in run and name is None):
            return self._foreign_observer(models)
        chosen = (
            self._settings("observer_settings", ObserverSettings)
            if settings is None
            else load_observer_settings(settings)
        )
        try:
            observer = contact_observer(mode, self.robot, identities, models, chosen)
        except ModelFileError as error:
            if models is not None:
                raise
            raise ReplayError(f"{self.path}: {error}; or give their file with --models") from error
        if name is None and models is None:
            self._check_models(mode, observer)
        return observer

    def reflexes(self) -> Sequence[Reflex]:
        """Return new copies of the reflexes of the recorded run.

        Raises:
            PepperError: One cannot be made here.
        """
        entries = self._json("reflexes")
        if not (isinstance(entries, list) and all(isinstance(entry, dict) for entry in entries)):
            raise ReplayError(f"{self.path}: its metadata has no 'reflexes' that can be read")
        made = []
        for number, entry in enumerate(entries):
            if "class" in entry:
                raise ReplayError(
                    f"{self.path}: reflex '{entry.get('name')}' is of the class {entry['class']} of its program, "
                    f"not registered under '{REFLEX_GROUP}'; replay with --reflexes FILE, or --reflexes none"
                )
            try:
                made.append(make_reflex(entry, self.robot, str(self.path), f"reflexes.{number}"))
            except PepperError as error:
                raise ReplayError(
                    f"{error}; replay with --reflexes FILE, or --reflexes none"
                ) from error
        return made

    def _foreign_observer(self, models: Path | None) -> Observer:
        name = self.log.metadata.get("observer_name")
        if name is None:
            raise ReplayError(
                f"{self.path}: its observer was an object of its program "
                f"({self.log.metadata['observer']}); name one with --observer"
            )
        return make_observer(name, self.robot, self.backend.info.identities, models)

    def _check_models(self, mode: str, observer: ContactObserver) -> None:
        run = self.log.metadata
        then, now = run["observer_models_sha256"], observer.provenance()["models_sha256"]
        if then != now:
            raise ReplayError(
                f"{self.path}: detected with the models {then[:12]} ({run.get('observer_models')}), those shipped "
                f"here are {now[:12]}; give the recorded file with --models, or take "
                f"those of today with --observer {mode}"
            )

    def _settings(self, key: str, cls: type[T]) -> T:
        settings = self._json(key)
        if not isinstance(settings, dict):
            raise ReplayError(f"{self.path}: its metadata has no '{key}' that can be read")
        return parse(cls, settings, f"{self.path}: {key}")

    def _json(self, key: str) -> object:
        try:
            found: object = json.loads(self.log.metadata[key])
        except (KeyError, ValueError) as error:
            raise ReplayError(
                f"{self.path}: its metadata has no '{key}' that can be read"
            ) from error
        return found


@checked_arguments
def load_run(path: Path | str, robot: RobotConfig | None = None) -> LoggedRun:
    """Return a log, ready for a replay.

    Raises:
        LogError: The file is missing, damaged, no log of this package, without a tick, or of another robot.
    """
    robot, path = robot or load_robot(), as_path("path", path)
    file = read_log_file(path, usual_layout())
    log = RunLog.of(file)
    return LoggedRun(
        path=path, robot=robot, log=log, backend=ReplayBackend(robot, file, f"replay://{path}")
    )
