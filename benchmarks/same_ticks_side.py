"""One side of same_ticks.py: plays, records or observes with the tree that comes first on PYTHONPATH.

The same file runs with the older commit and with the newer one. It therefore uses only what both have: the facade, and
dataclasses by the names of their fields. Its argument is the job as JSON. It writes arrays to an NPZ file, and one line
of JSON with remarks to stdout.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Iterable, Iterator
from dataclasses import MISSING, fields, is_dataclass
from functools import partial
from itertools import cycle
from pathlib import Path
from typing import Any, get_args, get_type_hints

import numpy as np
from numpy.typing import NDArray

import pepper_driver
from pepper_driver import Comply, Hold, Observation, Observer, Pepper, PepperError

Columns = dict[str, NDArray[Any]]
Row = Iterable[tuple[str, Any]]
Result = tuple[Columns, dict[str, Any]]

TOPIC, CONTACTS = "/tick", "/contact"
IS_NONE = ".is_none"
"""Suffix of the array that marks the rows in which a value is None."""

RANGES = {  # [rad], hands 0..1: well inside the limits of the joints, small for the legs
    "KneePitch": (-0.05, 0.05),
    "HipPitch": (-0.1, 0.1),
    "HipRoll": (-0.1, 0.1),
    "HeadYaw": (-1.2, 1.2),
    "HeadPitch": (-0.5, 0.3),
    "LShoulderPitch": (0.1, 1.8),
    "LShoulderRoll": (0.1, 1.0),
    "LElbowYaw": (-1.8, 0.5),
    "LElbowRoll": (-1.3, -0.1),
    "LWristYaw": (-1.2, 1.2),
    "LHand": (0.0, 1.0),
    "RShoulderPitch": (0.1, 1.8),
    "RShoulderRoll": (-1.0, -0.1),
    "RElbowYaw": (-0.5, 1.8),
    "RElbowRoll": (0.1, 1.3),
    "RWristYaw": (-1.2, 1.2),
    "RHand": (0.0, 1.0),
}
FORCES = {  # [N] of pushes, by link: one at a time, none tips the robot over
    "LForeArm": 25.0,
    "torso": 25.0,
    "RBicep": 25.0,
    "Head": 15.0,
    "r_wrist": 20.0,
    "Tibia": 50.0,
    "LBicep": 25.0,
    "RForeArm": 25.0,
    "l_gripper": 15.0,
}
MAX_TWIST = (0.15, 0.1, 0.5)  # [m/s], [m/s], [rad/s]
MOTIONS = ("wave", "reach", "stretch")
REFLEXES = {"Hold": Hold, "Comply": Comply}


class SideError(Exception):
    """This tree cannot do the job, for the reason given."""


# -- motion and pushes ------------------------------------------------------------------------------------------------


def play(pepper: Pepper, job: dict[str, Any]) -> str:
    """Move and push a robot; return why it ended early, or an empty text."""
    rng = np.random.default_rng(job["seed"])
    push = partial(push_link, pepper, rng, 1.0 + job["nudge"])
    try:
        if job["motions"]:
            play_motions(pepper, push)
        else:
            left = job["seconds"]
            for duration in play_steps(pepper, rng, push):
                pepper.run(min(duration, left))
                left -= duration
                if left <= 0.0:
                    break
    except PepperError as error:
        return str(error)
    return ""


def play_motions(pepper: Pepper, push: Callable[..., None]) -> None:
    """Play shipped motions, with a push in each."""
    for link, motion in zip(FORCES, MOTIONS, strict=False):
        push(link, 1.0)
        pepper.play(motion)


def play_steps(
    pepper: Pepper, rng: np.random.Generator, push: Callable[..., None]
) -> Iterator[float]:
    """Ask for one motion with pushes after the other; yield for how long each is to run [s]."""
    links = cycle(FORCES)
    while True:
        pepper.set_posture(draw_posture(rng, 17), duration=2.0)
        push(next(links), 0.3)
        push(next(links), 1.3)
        yield 2.5
        pepper.set_posture(draw_posture(rng, 6))
        yield 1.2
        push(next(links))  # at rest
        yield 1.6
        drive(pepper, rng.uniform(np.negative(MAX_TWIST), MAX_TWIST))
        pepper.set_posture(draw_posture(rng, 8), duration=1.5)
        push(next(links), 0.5)
        yield 1.8
        drive(pepper, np.zeros(3))
        pepper.set_posture(draw_posture(rng, 17), duration=3.0)  # replaced before its end
        push(next(links), 0.3)
        yield 1.2


def draw_posture(rng: np.random.Generator, count: int) -> dict[str, float]:
    """Draw angles of that many joints."""
    names = [str(name) for name in rng.permutation(list(RANGES))[:count]]
    return {name: float(rng.uniform(*RANGES[name])) for name in names}


def push_link(
    pepper: Pepper, rng: np.random.Generator, scale: float, link: str, delay: float = 0.0
) -> None:
    """Push a link in a random direction with ``scale`` times a random force, ``delay`` [s] from now."""
    direction = rng.normal(size=3)
    force = scale * FORCES[link] * rng.uniform(0.6, 1.0) * direction / np.linalg.norm(direction)
    pepper.push(link, force, duration=float(rng.uniform(0.5, 0.9)), delay=delay)


def drive(pepper: Pepper, twist: NDArray[np.float64]) -> None:
    """Drive the base with (3,) vx, vy [m/s], wz [rad/s] until the next call."""
    if hasattr(pepper, "drive"):
        pepper.drive(*twist.tolist(), hold=True)
    else:  # trees before there was `drive`
        pepper.controller.base_velocity.target = twist


# -- jobs -------------------------------------------------------------------------------------------------------------


def play_and_log(job: dict[str, Any], folder: Path) -> Result:
    """Play in simulation; the columns are those of the log."""
    log = folder / "run.mcap"
    reflexes = [REFLEXES[name]() for name in job["reflexes"]]
    models = copy_models(job, folder)
    with Pepper(
        job["uri"], observer=job["observer"], models=models, log=log, reflexes=reflexes
    ) as pepper:
        ended = play(pepper, job)
    columns = {**as_columns(log_rows(log)), **as_columns(contact_rows(log))}
    log.unlink()
    return columns, {"ended": ended}


def record(job: dict[str, Any], folder: Path) -> Result:
    """Play over the stand-in NAOqi, in real time; the columns are the inputs of the observer."""
    from pepper_driver.backends.naoqi_server.launch import StandIn

    recorder = Recorder(make_observer(job, folder))
    with StandIn(job["uri"], consent=True) as stand_in:
        uri = f"naoqi://127.0.0.1:{stand_in.port}?wake=1"
        with Pepper(uri, observer=recorder) as pepper:
            ended = play(pepper, job)
    return as_columns(recorder.rows), {"ended": ended}


def observe(job: dict[str, Any], folder: Path) -> Result:
    """Run an observer on recorded inputs; the columns are its observations and, as texts, its events."""
    observer = make_observer(job, folder)
    with np.load(job["inputs"], allow_pickle=False) as file:
        inputs = Inputs(dict(file), job["renamed"])
    make_tick = inputs.maker(get_type_hints(observer.step)["tick"])
    rows: list[Row] = []
    events: list[Row] = []
    for row in range(len(inputs)):
        values = dict(leaves(observer.step(make_tick(row))))
        for path in [path for path, value in values.items() if isinstance(value, tuple | list)]:
            for event in values.pop(path):
                texts = {at: exact_text(value) for at, value in leaves(event, path)}
                events.append({f"{path}.row": row, **texts}.items())
        rows.append(values.items())
    return {**as_columns(rows), **as_columns(events)}, {"unused inputs": inputs.unused}


JOBS = {"play": play_and_log, "record": record, "observe": observe}


# -- observers and their inputs ---------------------------------------------------------------------------------------


def copy_models(job: dict[str, Any], folder: Path) -> Path:
    """Copy shipped models, with the identity of the simulated robot of this job."""
    source = Path(job["models"])
    document = json.loads(source.read_text())
    if "identity" not in document:
        raise SideError(f"{source.name} has no 'identity'")
    document["identity"] = Pepper(job["uri"], observer=None).backend.info.identity
    copy = folder / source.name
    copy.write_text(json.dumps(document))
    return copy


def make_observer(job: dict[str, Any], folder: Path) -> Observer:
    """Make an observer by name, as the facade does."""
    models = copy_models(job, folder)
    observer = Pepper(job["uri"], observer=job["observer"], models=models).observer
    assert observer is not None
    return observer


class Recorder(Observer):
    """Another observer, with all inputs that it gets."""

    def __init__(self, observer: Observer) -> None:
        self._observer = observer
        self.rows: list[Row] = []

    def step(self, tick: Any) -> Observation:  # noqa: ANN401 -- its class moves between trees
        self.rows.append(list(leaves(tick)))
        return self._observer.step(tick)

    def reset(self) -> None:
        self._observer.reset()
        self.rows.clear()

    def describe(self) -> str:
        return self._observer.describe()


class Inputs:
    """Recorded ticks, rebuilt with the classes of this tree.

    Args:
        arrays: By path of the field.
        renamed: Paths that differ between trees, new to old.
    """

    def __init__(self, arrays: Columns, renamed: dict[str, str]) -> None:
        self._arrays = arrays
        self._other_names = {**{old: new for new, old in renamed.items()}, **renamed}
        self._used: set[str] = set()

    def __len__(self) -> int:
        return min((len(array) for array in self._arrays.values()), default=0)

    @property
    def unused(self) -> list[str]:
        """Paths that the makers do not use."""
        return sorted({path.removesuffix(IS_NONE) for path in self._arrays} - self._used)

    def maker(self, cls: type[Any], prefix: str = "") -> Callable[[int], Any]:
        """Make the function that builds a dataclass from a row.

        Raises:
            SideError: A field without default was not recorded.
        """
        parts: dict[str, Callable[[int], Any]] = {}
        hints = get_type_hints(cls)
        for field in fields(cls):
            path = f"{prefix}{field.name}"
            types = (hints[field.name], *get_args(hints[field.name]))  # of `X | None` also X
            nested: Any = next((kind for kind in types if is_dataclass(kind)), None)
            name = path if path in self._arrays else self._other_names.get(path, path)
            if nested is not None:
                parts[field.name] = self.maker(nested, f"{path}.")
            elif name in self._arrays:
                self._used.add(name)
                parts[field.name] = self._getter(name)
            elif field.default is MISSING and field.default_factory is MISSING:
                raise SideError(f"the recorded inputs have no '{path}': add it to RENAMED")
        return lambda row: cls(**{name: part(row) for name, part in parts.items()})

    def _getter(self, name: str) -> Callable[[int], Any]:
        array, is_none = self._arrays[name], self._arrays.get(name + IS_NONE)

        def get(row: int) -> object:
            if is_none is not None and is_none[row]:
                return None
            return array[row].item() if array.ndim == 1 else array[row].copy()

        return get


# -- arrays -----------------------------------------------------------------------------------------------------------


def leaves(value: object, path: str = "") -> Iterator[tuple[str, Any]]:
    """Yield the values of a dataclass, and of the dataclasses in it, by path."""
    if not is_dataclass(value):
        yield path, value
        return
    for field in fields(value):
        yield from leaves(
            getattr(value, field.name), f"{path}.{field.name}" if path else field.name
        )


def exact_text(value: object) -> str:
    """Write a value as text, numbers with all bits."""
    if isinstance(value, float):
        return float(value).hex()
    if isinstance(value, tuple | list | np.ndarray):
        return f"[{', '.join(exact_text(part) for part in value)}]"
    return str(value)


def log_rows(log: Path) -> Iterator[Row]:
    """Yield the ticks of a log, read by decoders that do not know this package."""
    from mcap.reader import make_reader
    from mcap_ros2.decoder import DecoderFactory

    with log.open("rb") as stream:
        reader = make_reader(stream, decoder_factories=[DecoderFactory()])
        for _, _, _, message in reader.iter_decoded_messages([TOPIC]):
            yield message_leaves(message)


def contact_rows(log: Path) -> Iterator[Row]:
    """Yield the contact events of a log; numbers with all bits."""
    from mcap.reader import make_reader

    with log.open("rb") as stream:
        for _, _, message in make_reader(stream).iter_messages([CONTACTS]):
            event = json.loads(message.data)
            yield [(f"{CONTACTS[1:]}.{key}", value) for key, value in event.items()]


def message_leaves(value: object, path: str = "") -> Iterator[tuple[str, Any]]:
    """Yield the values of a decoded message, and of the messages in it, by path."""
    if isinstance(value, list) and value and hasattr(value[0], "__slots__"):
        for place, part in enumerate(value):
            yield from message_leaves(part, f"{path}.{place}")
    elif hasattr(value, "__slots__"):
        for name in value.__slots__:
            yield from message_leaves(getattr(value, name), f"{path}.{name}" if path else name)
    else:
        yield path, np.frombuffer(value, dtype=np.uint8) if isinstance(value, bytes) else value


def as_columns(rows: Iterable[Row]) -> Columns:
    """Stack rows to arrays by path. A value that is None becomes zeros, marked in a second array.

    Raises:
        SideError: Values of a path have several sizes, or are neither numbers nor texts.
    """
    lists: dict[str, list[Any]] = {}
    for row in rows:
        for path, value in row:
            lists.setdefault(path, []).append(value)
    columns: Columns = {}
    for path, values in lists.items():
        is_none = np.array([value is None for value in values])
        if is_none.any():
            columns[path + IS_NONE] = is_none
            known = next((value for value in values if value is not None), 0.0)
            values = [np.zeros_like(known) if value is None else value for value in values]
        try:
            columns[path] = np.array(values)
        except ValueError as error:
            raise SideError(f"'{path}' has values of several sizes") from error
        if columns[path].dtype == object:
            raise SideError(f"'{path}' has values that are neither numbers nor texts")
    return columns


# -- one job ----------------------------------------------------------------------------------------------------------


def check_tree(tree: Path) -> None:
    """Refuse results of code from another tree, such as the installed package.

    Raises:
        SideError: A module comes from elsewhere.
    """
    for name, module in sorted(sys.modules.items()):
        file = getattr(module, "__file__", None)
        if name.partition(".")[0] != pepper_driver.__name__ or file is None:
            continue
        if not Path(file).resolve().is_relative_to(tree.resolve()):
            raise SideError(f"{name} comes from {file}, not from {tree}")


def main() -> int:
    """Do the job: 0, or 1 with the reason in the last line of stderr."""
    job = json.loads(sys.argv[1])
    out = Path(job["out"])
    try:
        columns, remarks = JOBS[job["do"]](job, out.parent)
        check_tree(Path(job["tree"]))
    except (SideError, PepperError) as error:
        print(error, file=sys.stderr)
        return 1
    save = np.savez_compressed if job["do"] == "record" else np.savez
    save(out, **columns)  # type: ignore[arg-type]
    print(json.dumps(remarks))
    return 0


if __name__ == "__main__":
    sys.exit(main())
