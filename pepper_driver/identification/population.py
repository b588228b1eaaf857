"""Identification of many simulated robots, the draws of one plant: each whole, as a user would identify it."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Literal

from pepper_driver.backends import make_backend
from pepper_driver.backends.selection import parse_uri, with_query
from pepper_driver.config import ConfigError, Experiment, PepperError, load_experiment, load_robot
from pepper_driver.config.cluster import SOURCES, Cluster, environment, sources_hash
from pepper_driver.config.file_lock import lock_folder
from pepper_driver.config.files import content_hash, write_json
from pepper_driver.config.population import HeldOutDrawError, with_same_draws
from pepper_driver.config.workers import Workers, run_jobs
from pepper_driver.experiments.plan import experiment_uri
from pepper_driver.identification.dataset import experiment_hash
from pepper_driver.identification.identify import (
    Identification,
    chosen_joints,
    fit_folder,
    record_joints,
)
from pepper_driver.identification.measurements.friction import HeldWeight
from pepper_driver.identification.measurements.program import MEASUREMENTS
from pepper_driver.observer import ModelFileError, ModelKind, ModelSet

_APART = (
    *(f"{name}/*" for name in ("callbacks", "calibration", "cli", "doctor", "evaluation", "log")),
    *(f"{name}/*" for name in ("recording", "reflexes", "rendering", "replay", "viewer", "bench")),
    *(f"backends/{name}/*" for name in ("naoqi", "naoqi_server")),
    *(
        f"config/{name}/*"
        for name in ("evaluation_experiments", "experiments", "motions", "plants")
    ),
    "config/evaluation*",
    "config/touch_suites.*",
    "config/frozen.py",
    "observer/models/*.json",
)
"""Files that models do not depend on, or whose content counts in another way."""

_NOT_RECORDED = (
    *(f"observer/{name}/*" for name in ("detection", "fitting", "models", "residuals")),
    *(
        f"observer/{name}.py"
        for name in ("constants", "contact_observer", "running_filters", "scoring")
    ),
    *(f"identification/{name}.py" for name in ("fit", "population", "quality")),
    "config/observer.yaml",
    "observers.py",
)
"""More files that recordings do not depend on: no observer runs while they are made."""

State = Literal["identified", "kept", "failed"]


@dataclass(frozen=True, kw_only=True)
class IdentifiedRobot:
    """Outcome of the identification of one robot of a population.

    Attributes:
        draw: Its number.
        name: Human-readable.
        state: ``kept`` where a file of an earlier identification holds just these models.
        file: Of its models; None where they were not identified.
        other_files: Of the other kinds of models that were asked for, in their order.
        reason: Why not, in one line.
        report: As :meth:`Identification.as_json` gives it; empty where it was not identified.
    """

    draw: int
    name: str
    state: State
    file: Path | None = None
    other_files: tuple[Path, ...] = ()
    reason: str = ""
    report: dict[str, Any]

    @property
    def warnings(self) -> tuple[str, ...]:
        """Faults of its recordings, and joints of which its models know nothing."""
        found = [
            ", ".join(filter(None, (finding["joint"], finding["run"]))) + f": {finding['text']}"
            for finding in self.report.get("warnings", ())
        ]
        fits: dict[str, dict[str, float]] = next(iter(self.report.get("fit", {}).values()), {})
        found += [
            f"{joint}: its model predicts the test run no better than a constant ({fit['test']:.0f} %)"
            for joint, fit in fits.items()
            if fit["test"] <= 0.0
        ]
        return tuple(found)


RobotProgress = Callable[[IdentifiedRobot, int, int], None]
"""Called with a robot that is done, and with (robots done, robots in all)."""


@dataclass(frozen=True, kw_only=True)
class _Motion:
    """Motions and models by which each robot is identified; see :func:`record_joints` and :func:`fit_folder`."""

    experiment: Experiment
    calibration: Experiment | None
    weight: HeldWeight | None
    joints: tuple[str, ...]
    tested: tuple[str, ...]
    kind: ModelKind
    other_kinds: tuple[ModelKind, ...]
    seed: int
    mirror: bool
    share_types: bool


@dataclass(frozen=True, kw_only=True)
class _Robot:
    """A robot to be identified: where its models, reports and recordings are kept."""

    draw: int
    name: str
    uri: str
    file: Path
    recordings: Path

    @property
    def report(self) -> Path:
        return self.file.with_name(f"{self.file.stem}-report.json")

    def other_files(self, motion: _Motion) -> tuple[Path, ...]:
        return tuple(
            self.file.with_name(f"{self.file.stem}-{kind}.json") for kind in motion.other_kinds
        )


def identify_population(
    uri: str,
    draws: Sequence[int],
    experiment: Experiment,
    kind: ModelKind,
    folder: Path,
    *,
    other_kinds: Sequence[ModelKind] = (),
    joints: Sequence[str] | None = None,
    calibration: Experiment | None = None,
    weight: HeldWeight | None = None,
    seed: int = 0,
    mirror: bool = True,
    share_types: bool = False,
    keep_recordings: bool = False,
    workers: Workers = -1,
    progress: RobotProgress | None = None,
) -> tuple[IdentifiedRobot, ...]:
    """Identify draws of a plant, each by what identifies a single robot; models of an earlier call are taken.

    The name of a model file carries the draw, and a hash of all that the models depend on: robot, motion, settings,
    code and libraries. Robots run in parallel, each in one process. One that fails does not cost the others.

    Args:
        uri: The backend, without ``draw``. A seed in it makes other noise, not other motion.
        draws: Numbers of the robots. Those for tests are allowed only inside
            :func:`pepper_driver.config.population.allow_test_draws`.
        experiment: An experiment with sweeps.
        kind: Of the models.
        folder: For model files and recordings.
        other_kinds: Of models that are fitted to the same recordings too, each in a file of its own.
        joints: To identify; None for those of the experiment.
        calibration: Free motion of the whole body, for thresholds; None for none.
        weight: Known weight in a hand: each robot is measured first, also with it. None: no robot is measured.
        seed: Root of the random motion and noise.
        mirror: Also models of the other side, from the recordings seen in a mirror.
        share_types: One model per motor type.
        keep_recordings: True to keep them when their robot is identified, some 400 MB each: where nothing but the
            observer or its fit has changed, models are then fitted to them again. Older ones are not removed.
        workers: Processes, -1 for one per core; or a cluster, whose workers keep no recordings.
        progress: Called when a robot is done.

    Returns:
        The robots, in the order of ``draws``.

    Raises:
        HeldOutDrawError: A draw for tests.
        ConfigError: Wrong arguments, or a backend that is no robot with any of these draws.
        OutputError: The folder cannot be written to.
    """
    full, tested = chosen_joints(
        load_robot(), experiment, joints, mirror=mirror, share_types=share_types
    )
    motion = _Motion(
        experiment=experiment,
        calibration=calibration,
        weight=weight,
        joints=full,
        tested=tested,
        kind=kind,
        other_kinds=tuple(other_kinds),
        seed=seed,
        mirror=mirror,
        share_types=share_types,
    )
    made, failed = _make_robots(uri, draws, motion, folder)
    done: dict[int, IdentifiedRobot] = {}

    def take(one: IdentifiedRobot) -> None:
        done[one.draw] = one
        if progress is not None:
            progress(one, len(done), len(draws))

    with lock_folder(folder):
        for one in failed:
            take(one)
        kept = {robot.draw: _kept(robot, motion) for robot in made}
        for found in filter(None, kept.values()):
            take(found)
        keep = not isinstance(workers, Cluster)
        # A list: what is allowed here is not allowed in the thread that sends the later jobs.
        jobs = [
            with_same_draws(partial(_identify, robot, motion, keep))
            for robot in made
            if kept[robot.draw] is None
        ]
        for robot, result in run_jobs(jobs, workers=workers, ordered=False):
            take(_save(robot, motion, result, keep_recordings))
    return tuple(done[draw] for draw in draws)


def _make_robots(
    uri: str, draws: Sequence[int], motion: _Motion, folder: Path
) -> tuple[list[_Robot], list[IdentifiedRobot]]:
    """Return the robots, and those that cannot be built."""
    if "draw" in parse_uri(uri).query:
        raise ConfigError(f"backend '{uri}': its draw has no meaning next to a list of draws")
    uri = experiment_uri(uri, motion.experiment)
    code = {**environment(), SOURCES: sources_hash(_APART)}
    driven = {**environment(), SOURCES: sources_hash((*_APART, *_NOT_RECORDED))}
    made, failed, first = [], [], None
    # The largest first: where one is refused for all, it is.
    for draw in sorted(draws, reverse=True):
        drawn = with_query(uri, draw=draw)
        query = dict(parse_uri(drawn).query)
        name = f"{Path(query.pop('plant', 'nominal')).stem}-{draw}"
        try:
            info = make_backend(drawn).info
        except HeldOutDrawError:
            raise
        except PepperError as error:
            first = first or error
            failed.append(
                IdentifiedRobot(draw=draw, name=name, state="failed", reason=str(error), report={})
            )
            continue
        # What is left of the address is not in the robot's identity: noise, posture, world.
        apart = {key: value for key, value in query.items() if key not in ("draw", "day")}
        key = content_hash([info.identity, apart, _content(motion), code])
        recorded = content_hash([info.identity, apart, _recorded(motion), driven])
        made.append(
            _Robot(
                draw=draw,
                name=info.name or name,
                uri=drawn,
                file=folder / f"{name}-{key}.json",
                recordings=folder / f"{name}-{recorded}-recordings",
            )
        )
    if first is not None and not made:
        raise first
    return sorted(made, key=lambda one: one.draw), failed


def _recorded(motion: _Motion) -> dict[str, Any]:
    """Return what a robot does."""
    body, weight = motion.calibration, motion.weight
    measured = () if weight is None else MEASUREMENTS
    return {
        "measured": {
            name: experiment_hash(load_experiment(name, load_robot())) for name in measured
        },
        "weight": None if weight is None else asdict(weight),
        "experiment": experiment_hash(motion.experiment),
        "calibration": None if body is None else experiment_hash(body),
        "joints": motion.joints,
        "tested": motion.tested,
        "seed": motion.seed,
    }


def _content(motion: _Motion) -> dict[str, Any]:
    """Return what a robot does, and what is fitted to it."""
    return {
        **_recorded(motion),
        "kind": motion.kind,
        "other_kinds": motion.other_kinds,
        "mirror": motion.mirror,
        "share_types": motion.share_types,
    }


def _kept(one: _Robot, motion: _Motion) -> IdentifiedRobot | None:
    """Return a robot that was identified before; None where a file is missing or damaged."""
    try:
        for file in (one.file, *one.other_files(motion)):
            ModelSet.load(file, load_robot())
        report = json.loads(one.report.read_text(encoding="utf-8"))
    except (ModelFileError, OSError, ValueError, RecursionError):
        return None
    if not isinstance(report, dict) or not _is_whole(report, motion.kind):
        return None
    return IdentifiedRobot(
        draw=one.draw,
        name=one.name,
        state="kept",
        file=one.file,
        other_files=one.other_files(motion),
        report=report,
    )


def _is_whole(report: dict[str, Any], kind: ModelKind) -> bool:
    """Check a report for what is shown of it: the fit of each joint, and warnings."""
    fits = report.get("fit")
    fits = fits.get(kind) if isinstance(fits, dict) else None
    numbers = isinstance(fits, dict) and all(
        isinstance(fit, dict) and isinstance(fit.get("test"), int | float) for fit in fits.values()
    )
    warnings = report.get("warnings")
    texts = isinstance(warnings, list) and all(
        isinstance(w, dict) and {"joint", "run", "text"} <= w.keys() for w in warnings
    )
    return bool(fits) and numbers and texts


def _identify(
    one: _Robot, motion: _Motion, keep: bool
) -> tuple[_Robot, tuple[Identification, ...] | str]:
    """Identify a robot in this process; ``keep`` its recordings, so that it continues when it was interrupted."""
    try:
        with _folder(one, keep) as folder:
            record_joints(
                one.uri,
                motion.joints,
                motion.experiment,
                folder,
                tested=motion.tested,
                calibration=motion.calibration,
                measure=motion.weight is not None,
                weight=motion.weight,
                seed=motion.seed,
                workers=1,
            )
            results = tuple(
                fit_folder(
                    folder,
                    kind,
                    compare=False,
                    mirror=motion.mirror,
                    share_types=motion.share_types,
                    workers=1,
                )
                for kind in (motion.kind, *motion.other_kinds)
            )
    except PepperError as error:
        return one, str(error)
    except Exception as error:  # one robot that fails must not cost the others
        return one, f"{type(error).__name__}: {error}".splitlines()[0]
    return one, results


@contextmanager
def _folder(one: _Robot, keep: bool) -> Iterator[Path]:
    if keep:
        yield one.recordings
    else:
        with TemporaryDirectory() as name:
            yield Path(name)


def _save(
    one: _Robot, motion: _Motion, result: tuple[Identification, ...] | str, keep_recordings: bool
) -> IdentifiedRobot:
    """Write the models of a robot, and remove its recordings or keep them; those of one that failed stay."""
    if isinstance(result, str):
        return IdentifiedRobot(
            draw=one.draw, name=one.name, state="failed", reason=result, report={}
        )
    main, *others = result
    report, files = main.as_json(), one.other_files(motion)
    # The models last: with them the robot is done.
    write_json(one.report, report)
    for other, file in zip(others, files, strict=True):
        other.models.save(file)
    main.models.save(one.file)
    if not keep_recordings:
        shutil.rmtree(one.recordings, ignore_errors=True)
    return IdentifiedRobot(
        draw=one.draw,
        name=one.name,
        state="identified",
        file=one.file,
        other_files=files,
        report=report,
    )
