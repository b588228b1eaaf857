"""Performance of experiments: one file, the same steps on every backend."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from pathlib import Path

from pepper_driver.callbacks.events import CueEvent, PushEvent, ReflexEvent
from pepper_driver.callbacks.filters import ContactPredicate, contact_filter
from pepper_driver.config import Experiment, Motion, RobotConfig, load_experiment, load_robot
from pepper_driver.config.experiment_steps import (
    ContactWait,
    LedsStep,
    PlayedStep,
    SayStep,
    WaitStep,
)
from pepper_driver.controller import Tick
from pepper_driver.experiment_plan import (
    PlannedPushes,
    check_postures,
    plan_pushes,
    push_text,
)
from pepper_driver.experiment_report import ExperimentReport, WaitReport
from pepper_driver.motion import Conductor
from pepper_driver.observer import Observation
from pepper_driver.reflexes.declared import make_reflexes
from pepper_driver.robot import Pepper
from pepper_driver.scene import PlannedTouch, order_touch


class ExperimentRun:
    """An experiment on one robot, checked and planned to the last push when it is made; nothing has moved then.

    >>> run = ExperimentRun("touch.yaml", "mujoco", log="run.mcap")
    >>> report = run.perform()

    Args:
        experiment: An experiment, or a path of a file.
        uri: Which robot, as for :class:`Pepper`.
        log: Where to write the MCAP log; None for no log.
        real_time: Pace a simulation to the wall clock.
        robot: Description of the robot, by default the shipped Pepper.

    Attributes:
        experiment: What is performed.
        pepper: With the observer and the reflexes of the experiment, not active yet: register callbacks here.

    Raises:
        PepperError: The experiment, or what it asks of the robot, is wrong; the message names file, line and key.
    """

    def __init__(
        self,
        experiment: Experiment | str | Path,
        uri: str = "mujoco",
        *,
        log: Path | str | None = None,
        real_time: bool = False,
        robot: RobotConfig | None = None,
    ) -> None:
        robot = robot or load_robot()
        if not isinstance(experiment, Experiment):
            experiment = load_experiment(experiment, robot)
        self.experiment = experiment
        check_postures(experiment, robot)
        name = experiment.source or experiment.name
        reflexes = make_reflexes(experiment.reflexes, robot, name)
        observer = experiment.observer
        models = None if observer is None or observer.models is None else observer.models
        self.pepper = Pepper(
            uri,
            observer=None if observer is None else observer.mode,
            models=None if models is None else Path(experiment.source).parent / models,
            log=log,
            reflexes=reflexes,
            real_time=real_time,
            robot=robot,
            about=_about(experiment),
        )
        self.pepper.on_cue()(self.pepper.extras.perform)
        self._pushes: PlannedPushes | None = None
        if not self.pepper.backend.real_time:
            self.plan()

    def plan(self) -> PlannedPushes:
        """Return what the robot is pushed by, which depends on what kind it is: a real robot is asked for that.

        Raises:
            ConfigError: A push that the robot could not take.
            NotConnectedError: The robot does not answer.
        """
        if self._pushes is None:
            robot = self.pepper.config
            self._pushes = plan_pushes(self.experiment, robot, self.pepper.backend)
        return self._pushes

    def perform(
        self, *, on_tick: Callable[[Tick, Observation | None], None] | None = None
    ) -> ExperimentReport:
        """Start the robot, play all steps, and stop it again, whatever happens.

        Args:
            on_tick: Called inside every tick: must be quick.

        Raises:
            PepperError: The robot cannot be opened, or stands so that a step would lead it into itself: nothing moves.
            FaultError: The safety gate stopped the robot.
        """
        pepper, experiment = self.pepper, self.experiment
        begun: list[ReflexEvent] = []
        pepper.on_reflex()(begun.append)
        pushes = self.plan()
        director = _Director(self, pushes)

        def listener(tick: Tick, observation: Observation | None) -> None:
            director.listen(observation)
            if on_tick is not None:
                on_tick(tick, observation)

        with pepper:
            check_postures(experiment, pepper.config, pepper.target)
            start = pepper.time
            motion = pepper.play(experiment.motion, on_tick=listener, conductor=director)
            seconds = pepper.time - start
        return ExperimentReport(
            name=experiment.name,
            seconds=seconds,
            stopped_by=director.stopped_by,
            motion=motion,
            waits=tuple(director.waits),
            contacts=pepper.contact_history,
            reflexes=tuple(begun),
            pushes=director.pushed,
            skipped=pushes.skipped,
        )


class _Director(Conductor):
    """Goes along with the steps of one run: cues, pushes, waits for contacts."""

    def __init__(self, run: ExperimentRun, pushes: PlannedPushes) -> None:
        self._pepper, self._experiment, self._pushes = run.pepper, run.experiment, pushes
        self._steps: tuple[PlayedStep, ...] = tuple(run.experiment.written.values())
        self._wanted: dict[int, ContactPredicate] = {
            number: contact_filter(
                run.pepper.config,
                link=wait.link,
                joint=wait.joint,
                kind=wait.kind,
                phase=None,
                min_intensity=wait.min_intensity,
            )
            for number, step in enumerate(self._steps)
            if isinstance(step, WaitStep) and isinstance(wait := step.wait, ContactWait)
        }
        self._listening: ContactPredicate | None = None
        self._heard = self._begun = False
        self._since: set[int] = set()
        self.waits: list[WaitReport] = []
        self.stopped_by = ""
        self.pushed = 0

    def order(self, motion: Motion) -> Iterable[int]:
        """Return the steps as the experiment has them."""
        return self._experiment.order

    def begin(self, number: int) -> None:
        """Cues, pushes, and what is waited for."""
        step, time = self._steps[number], self._pepper.time
        self._listening, self._heard = self._wanted.get(number), False
        self._since.clear()
        if isinstance(step, SayStep):
            self._pepper.publish(CueEvent(kind="say", text=step.say, time=time))
        elif isinstance(step, LedsStep):
            self._pepper.publish(
                CueEvent(
                    kind="leds",
                    group=step.leds.group,
                    colour=step.leds.colour,
                    duration=step.leds.duration,
                    time=time,
                )
            )
        if not self._begun:
            self._begun = True
            for touch in self._pushes.at_begin:
                self._push(touch)
        for touch in self._pushes.in_step.get(number, ()):
            self._push(touch)

    def listen(self, observation: Observation | None) -> None:
        """Take in the contacts of a tick; those that began before the wait do not count."""
        if self._listening is None or observation is None:
            return
        for contact in observation.contacts:
            if contact.phase == "begin":
                self._since.add(contact.id)
            if contact.phase != "end" and contact.id in self._since and self._listening(contact):
                self._heard = True

    def ends_early(self, number: int) -> bool:
        """Return True once the contact that is waited for has come."""
        return self._heard

    def goes_on(self, number: int) -> bool:
        """Return False where no contact came and the experiment stops then."""
        step = self._steps[number]
        if number not in self._wanted or not isinstance(step, WaitStep):
            return True
        self.waits.append(WaitReport(step=step.motion.name or "", heard=self._heard))
        assert isinstance(step.wait, ContactWait)
        if self._heard or step.wait.otherwise == "continue":
            return True
        self.stopped_by = step.motion.name or ""
        return False

    def _push(self, touch: PlannedTouch) -> None:
        text, link = push_text(touch), touch.planned.link
        try:
            order_touch(self._pepper.backend, touch)
            self.pushed += 1
        except ValueError as error:  # a hand of an earlier step still holds the link
            text = f"left out: {text}: {error}"
        self._pepper.publish(PushEvent(link=link, text=text, time=self._pepper.time))


def _about(experiment: Experiment) -> dict[str, str]:
    """Return what the log says of it: its name, and the file as it is."""
    about = {"experiment": experiment.name}
    if experiment.source:
        about["experiment_file"] = Path(experiment.source).read_text(encoding="utf-8")
    return about
