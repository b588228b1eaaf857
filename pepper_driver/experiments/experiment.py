"""Performance of experiments: one file, the same steps on every backend."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from pepper_driver.config import (
    Experiment,
    RobotConfig,
    UnknownNameError,
    load_experiment,
    load_robot,
)
from pepper_driver.config.arguments import checked_arguments
from pepper_driver.config.arrays import FloatArray
from pepper_driver.config.experiment import ObserverChoice, check_experiment
from pepper_driver.config.lines import with_lines
from pepper_driver.experiments.plan import Plan, experiment_uri, plan_experiment
from pepper_driver.experiments.player import OnStep
from pepper_driver.experiments.reports import ExperimentReport
from pepper_driver.observers import check_observer
from pepper_driver.reflexes.declared import make_reflexes
from pepper_driver.robot import Pepper
from pepper_driver.session import OnTick


@checked_arguments
class ExperimentRun:
    """An experiment on one robot, checked and planned to the last contact when it is made; nothing has moved then.

    >>> run = ExperimentRun("touch.yaml", "mujoco", log="run.mcap")
    >>> report = run.perform()

    Args:
        experiment: An experiment, the name of a shipped one, or a path of a file.
        uri: Which robot, as for :class:`Pepper`; a simulated one has the experiment's plant and world.
        log: Where to write the MCAP log; None for no log.
        real_time: Pace a simulation to the wall clock.
        seed: Of random goals and contacts; None for the experiment's.
        models: Model file of the observer, in place of the experiment's; it is made where it does not exist.
        contacts: False leaves the contacts for a simulated robot out.
        attentive: True to detect lighter touches, see :attr:`Pepper.attentive`; None for what the experiment says.
        robot: Description of the robot, by default the shipped Pepper.

    Attributes:
        experiment: The experiment.
        pepper: With the observer and the reflexes of the experiment, not active yet: register callbacks here.
        report: What came of it, once all steps were played or it stopped by itself; None before. It is there also when
            :meth:`perform` raises at the end of the run, as the log could not be written.

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
        seed: int | Sequence[int] | None = None,
        models: Path | str | None = None,
        contacts: bool = True,
        attentive: bool | None = None,
        robot: RobotConfig | None = None,
    ) -> None:
        robot = robot or load_robot()
        if not isinstance(experiment, Experiment):
            experiment = load_experiment(experiment, robot)
        else:
            check_experiment(experiment, robot)
        if not contacts:
            experiment = replace(experiment, contacts=())
        if attentive is not None:
            experiment = replace(experiment, attentive=attentive)
        self.experiment, self._seed = experiment, seed
        _check_observer(experiment)
        observer = experiment.observer
        if models is not None and observer is None:
            observer = ObserverChoice()
        if models is None and observer is not None and observer.models is not None:
            models = Path(experiment.source).parent / observer.models
        self.pepper = Pepper(
            experiment_uri(uri, experiment),
            observer=None if observer is None else observer.mode,
            models=models,
            log=log,
            reflexes=make_reflexes(
                {
                    f"reactions.{number}": entry
                    for number, reaction in enumerate(experiment.reactions)
                    if (entry := reaction.reflex_entry)
                },
                robot,
                experiment.source or experiment.name,
            ),
            real_time=real_time,
            robot=robot,
            about=_about(experiment),
        )
        self.pepper.on_cue()(self.pepper.services.perform)
        self.report: ExperimentReport | None = None
        self._plan: Plan | None = None
        if not self.pepper.backend.real_time:
            self.plan()

    def plan(self) -> Plan:
        """Return what will be played; contacts depend on what kind the robot is: a real one is asked for that.

        Raises:
            ConfigError: A contact that the robot could not take, or a posture that it cannot.
            NotConnectedError: The robot does not answer.
        """
        if self._plan is None:
            self._plan = self._make_plan()
        return self._plan

    @checked_arguments
    def perform(
        self, *, on_tick: OnTick | None = None, on_step: OnStep | None = None
    ) -> ExperimentReport:
        """Start the robot, play all steps, and stop it again in every case.

        Args:
            on_tick: Called inside every tick: must be quick.
            on_step: Called with each step's report as it ends, inside the tick: must be quick.

        Raises:
            PepperError: The robot cannot be opened, or stands so that a step would lead it into itself: nothing moves.
            FaultError: The safety gate stopped the robot.
            LogError: The log is cut short, for example by a full disk; :attr:`report` is there.
        """
        self.plan()
        with self.pepper as pepper:
            plan = self._make_plan(pepper.target)
            self.report = pepper.play(plan, on_tick=on_tick, on_step=on_step)
        return self.report

    def _make_plan(self, start: FloatArray | None = None) -> Plan:
        pepper = self.pepper
        return plan_experiment(
            self.experiment, pepper.config, pepper.backend, seed=self._seed, start=start
        )


@with_lines
def _check_observer(experiment: Experiment) -> None:
    """Refuse an observer that is not registered; the message names the line of the file."""
    if experiment.observer is not None:
        try:
            check_observer(experiment.observer.mode, None)
        except UnknownNameError as error:
            raise experiment.error("observer.mode", str(error)) from error


def _about(experiment: Experiment) -> dict[str, str]:
    """Return what the log says of it: its name, and the file as it is."""
    about = {"experiment": experiment.name}
    if experiment.source:
        about["experiment_file"] = Path(experiment.source).read_text(encoding="utf-8")
    return about
