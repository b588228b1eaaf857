"""Performs the runs of the evaluation suites on simulated robots, and keeps what came of them."""

from __future__ import annotations

import hashlib
import json
from contextlib import suppress
from dataclasses import asdict, dataclass, replace
from importlib.metadata import version
from pathlib import Path
from typing import Any, Self

import numpy as np

from pepper_driver.backends import BackendError, with_query
from pepper_driver.config import (
    ConfigError,
    PepperError,
    RobotConfig,
    RobotIdentity,
    load_robot,
    load_safety_settings,
)
from pepper_driver.config.arrays import FloatArray
from pepper_driver.config.evaluation import SuiteRun
from pepper_driver.config.files import content_hash, make_folder, replacing, write_json
from pepper_driver.config.loading import package_file
from pepper_driver.controller import Tick
from pepper_driver.experiments.plan import plan_experiment
from pepper_driver.observer import KnownPush, Observation, Recording, RecordingBuilder
from pepper_driver.robot import Pepper
from pepper_driver.safety import FaultError

DEFAULT_CACHE = Path("runs/evaluation/episodes")

TIPPED = 0.1
"""[rad] of tilt: a robot that stands stays far below it, one that reaches it falls or nearly did."""

REDRAWS = 2
"""How often a run is drawn again in which the robot fell or was stopped."""

REDRAWN = 1000
"""Added to the number of a run that is drawn again."""

FORMAT = 2
"""Of the files in the cache; part of their key."""

_SETTINGS = (
    "pepper.urdf",
    "pepper.yaml",
    "limits.yaml",
    "wheels.yaml",
    "postures.yaml",
    "controller.yaml",
    "safety.yaml",
    "self_collision.yaml",
)

_RECORDING, _TRUTH, _LABELS = "recording.npz", "truth.npz", "episode.json"


class EpisodeError(PepperError, RuntimeError):
    """An episode that is worth nothing: the robot fell, was stopped, or could not be pushed as planned."""


class StoppedEpisodeError(EpisodeError):
    """The robot fell or was stopped before the end."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Episode:
    """One performed run: what an observer may see, and the truth to score it with. n samples, N joints.

    Attributes:
        suite, experiment: Where it belongs.
        plant: Name of the simulated robot.
        identity: Hash of the simulated robot.
        parents: Plants that the simulated robot of a recording is a variant of, nearest first.
        seed: Of its noise; unlike any other in the suites.
        task_stiffness: Of the posture task [1/s2].
        recording: What observers are stepped over.
        pushes: In the order of their onset. Torque and degrees are the largest that really acted on the joint.
        contact_torque: (n, N) true external torque, mean over each cycle [N m].
    """

    suite: str
    experiment: str
    plant: str
    identity: str = ""
    parents: tuple[RobotIdentity, ...] = ()
    seed: int
    task_stiffness: float
    recording: Recording
    pushes: tuple[KnownPush, ...]
    contact_torque: FloatArray

    def save(self, folder: Path) -> None:
        """Write it into a folder of its own; complete once ``episode.json`` is there.

        Raises:
            PepperError: The place cannot be written to.
        """
        make_folder(folder)
        self.recording.save(folder / _RECORDING)
        with replacing(folder / _TRUTH) as partial, partial.open("wb") as file:
            np.savez_compressed(file, allow_pickle=False, contact_torque=self.contact_torque)
        labels = {key: getattr(self, key) for key in _labels()}
        write_json(folder / _LABELS, {**labels, "pushes": [_as_json(push) for push in self.pushes]})

    @classmethod
    def load(cls, folder: Path, robot: RobotConfig) -> Self:
        """Read what ``save`` wrote.

        Raises:
            EpisodeError: It is not there, damaged, or of another robot.
        """
        try:
            labels: dict[str, Any] = json.loads((folder / _LABELS).read_text(encoding="utf-8"))
            recording = Recording.load(folder / _RECORDING, robot)
            with np.load(folder / _TRUTH, allow_pickle=False) as file:
                truth = {name: file[name] for name in file.files}
            pushes = tuple(KnownPush(**_from_json(push)) for push in labels.pop("pushes"))
            episode = cls(**labels, recording=recording, pushes=pushes, **truth)
            if episode.contact_torque.shape != recording.position.shape:
                raise EpisodeError("recording and truth are of different length")
        except Exception as error:  # decoders raise anything on damaged bytes
            reason = " ".join(str(error).split()) or type(error).__name__
            raise EpisodeError(f"{folder}: no episode ({reason}); delete the folder") from error
        return episode


def episode_uri(run: SuiteRun) -> str:
    """Return the simulated robot of a run, with its noise."""
    return with_query("mujoco", plant=run.plant, seed=_noise(run))


def perform(run: SuiteRun, cache: Path | None = None) -> Episode:
    """Perform a run, or load it where it was performed before.

    Chance may put two pushes such that the robot tips, or is stopped: as in a laboratory, the run is then drawn again.

    Args:
        run: Of a suite.
        cache: Folder of episodes; None to perform it anyway, and keep nothing.

    Raises:
        EpisodeError: The robot fell or was stopped, REDRAWS times again, or could not be pushed as planned.
        PepperError: Plant or cache are not usable.
    """
    robot = load_robot()
    drawn = [
        replace(run, seed=(*run.seed[:-1], run.seed[-1] + again * REDRAWN))
        for again in range(REDRAWS + 1)
    ]
    if cache is not None:
        # A run that was drawn again is kept under its new number only.
        for one in drawn:
            folder = _folder(one, _pepper(one, robot), cache)
            if (folder / _LABELS).is_file():
                # One that is damaged is performed again, and written again.
                with suppress(EpisodeError):
                    return Episode.load(folder, robot)
    reasons = []
    for one in drawn:
        pepper = _pepper(one, robot)
        try:
            episode = _performed(one, pepper)
        except StoppedEpisodeError as error:
            reasons.append(error)
            continue
        if cache is not None:
            episode.save(_folder(one, pepper, cache))
        return episode
    raise reasons[0]


def _pepper(run: SuiteRun, robot: RobotConfig) -> Pepper:
    # Pushes on the chest press its button, which must not end the episode.
    safety = replace(load_safety_settings(), chest_button=False)
    return Pepper(episode_uri(run), observer=None, robot=robot, safety=safety)


def _folder(run: SuiteRun, pepper: Pepper, cache: Path) -> Path:
    return cache / _key(run, pepper.backend.info.identity)


def _performed(run: SuiteRun, pepper: Pepper) -> Episode:
    robot, truth = pepper.config, pepper.backend.truth
    builder = RecordingBuilder(robot)
    torque: list[FloatArray] = []
    tilt = 0.0

    def on_tick(tick: Tick, _: Observation | None) -> None:
        nonlocal tilt
        builder.append(tick)
        torque.append(truth.contact_torque)
        tilt = max(tilt, float(np.abs(truth.tilt).max()))

    reason, stopped = "", False
    pushes: tuple[KnownPush, ...] = ()
    try:
        plan = plan_experiment(run.experiment, robot, pepper.backend, seed=run.seed)
        with pepper:
            pushes = pepper.play(plan, on_tick=on_tick, skip_settling=True).pushes
    except (FaultError, BackendError, ConfigError) as error:
        reason, stopped = str(error), isinstance(error, FaultError)
    if tilt > TIPPED:
        stopped = True
        fell = f"it tipped by {np.degrees(tilt):.0f} deg"
        reason = f"{fell}; {reason}" if reason else fell
    if reason:
        raise (StoppedEpisodeError if stopped else EpisodeError)(f"{run.label}: {reason}")
    recording = builder.finish()
    contact_torque = np.array(torque)
    return Episode(
        suite=run.suite,
        experiment=run.entry,
        plant=run.plant,
        identity=pepper.backend.info.identity,
        seed=_noise(run),
        task_stiffness=run.task_stiffness,
        recording=recording,
        pushes=tuple(
            as_it_was(push, recording.time, contact_torque, pepper.backend.plant.stiffness, robot)
            for push in sorted(pushes, key=lambda push: push.onset)
        ),
        contact_torque=contact_torque,
    )


def as_it_was(
    push: KnownPush, time: FloatArray, torque: FloatArray, stiffness: FloatArray, robot: RobotConfig
) -> KnownPush:
    """Return a push with the largest torques that really acted: no joint is quite where it was planned for."""
    during = torque[(time >= push.onset) & (time <= push.release + robot.cycle)]
    if push.joint is None or not len(during):
        return push
    peaks = np.take_along_axis(during, np.abs(during).argmax(axis=0)[None], axis=0)[0]
    index = robot.joint_index(push.joint)
    limb = robot.limbs[robot.limb_of(push.joint)]
    return replace(
        push,
        torque=abs(float(peaks[index])),
        torques={name: float(peaks[robot.joint_index(name)]) for name in limb},
        direction=int(np.sign(peaks[index])),
        degrees=float(np.degrees(abs(peaks[index]) / stiffness[index])),
    )


def _noise(run: SuiteRun) -> int:
    """Seed of a run's noise."""
    # The zero is part of the frozen noise: of a robot that is no draw of its plant.
    return int(np.random.SeedSequence((*run.seed, 0, *run.plant.encode())).generate_state(1)[0])


def _key(run: SuiteRun, identity: str) -> str:
    """Name of the folder of a run: it changes with all that makes the episode."""
    experiment = asdict(run.experiment)
    for key in ("source", "description"):
        del experiment[key]
    content = {
        "format": FORMAT,
        "version": version("pepper-driver"),
        "source": _source_hash(),
        "experiment": experiment,
        "labels": [run.suite, run.entry, run.plant],
        "identity": identity,
        "seed": run.seed,
    }
    return f"{run.suite}-{run.entry}-{run.plant}-{content_hash(content)}"


def _source_hash() -> str:
    """Hash the URDF and the settings by which a robot moves."""
    parts = [package_file(name).read_bytes() for name in _SETTINGS]
    return hashlib.sha256(b"".join(parts)).hexdigest()[:16]


def _labels() -> tuple[str, ...]:
    return ("suite", "experiment", "plant", "identity", "seed", "task_stiffness")


def _as_json(push: KnownPush) -> dict[str, Any]:
    """NaN has no place in JSON."""
    return {k: None if v != v else v for k, v in asdict(push).items()}


def _from_json(push: dict[str, Any]) -> dict[str, Any]:
    numbers = ("force", "torque", "degrees")
    return {k: float("nan") if v is None and k in numbers else v for k, v in push.items()}
