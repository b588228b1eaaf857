"""The shipped experiment of a moving arm: which pushes on its hand it speaks of, follows and moves away from.

Each run plays examples/experiments/touch_the_arm.yaml with one seed: untouched; with pushes on the hand; and the first
runs of each plant also with the same pushes, but without reactions. A push lasts 1 s and comes at a random moment of
the motion, with one of FORCES along one of WAYS, in random order. Pushes are at least 4 s apart. Each waits until no
contact lasts, no reflex acts, and the joints that the steps name follow the same path again as in the untouched run.
Others, such as the yaw of the elbow, stay where the hand has led them. A push that would tip the robot is left out.

A push is announced, followed or retracted from when the sentence is said, or the reflex begins, from its onset to
0.15 s after its end. The hand is where the measured joint angles put it. It moved when it went at least 1 cm further
along the push, from onset to release, than the untouched motion would have led it from there; without reactions it
gives way as far as springs and gears do. A push is still detected when contacts were reported 3 s after its release.

What is chosen is chosen on the development seeds; the results in the documentation are of the test seeds. Each run that
is over is in the JSON file: the same command goes on after Ctrl-C.
Run: python benchmarks/touch_the_arm.py --seeds test --json touch_the_arm.json
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import product
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table
from seeded_runs import FILE_WIDTH, Parser, Result, fraction_text, perform, rate_bound, seeds

from pepper_driver import Contact, CueEvent, ExperimentRun, Observation, Pepper, PepperError
from pepper_driver.config import Experiment, load_experiment, load_robot
from pepper_driver.config.arrays import FloatArray
from pepper_driver.config.contact_selector import MAX_FORCE, TouchTrigger
from pepper_driver.config.experiment import Reaction
from pepper_driver.controller import RobotModel, Tick
from pepper_driver.controller.support_polygon import SupportPolygon
from pepper_driver.observer import RELEASE_GRACE

ROOTS = {"development": 20261201, "test": 20261202}
FILE = Path(__file__).parents[1] / "examples" / "experiments" / "touch_the_arm.yaml"
PLANTS = ("nominal", "integral")
HAND, POINT = "l_wrist", np.array([0.07, 0.0, 0.0])  # [m] in the link
LIMB = "left_arm"
FORCES = (8.0, 10.0, 12.0, 15.0, 20.0, 25.0)  # [N]
WAYS = {
    "outwards": (0.0, 1.0, 0.0),
    "inwards": (0.0, -1.0, 0.0),
    "forward": (1.0, 0.0, 0.0),
    "back": (-1.0, 0.0, 0.0),
    "up": (0.0, 0.0, 1.0),
    "down": (0.0, 0.0, -1.0),
}
DURATION = 1.0  # [s]
BEGIN, END = 3.0, 2.0  # [s] at rest at the beginning, and of the last step, without pushes
APART = 4.0  # [s] between the onsets of two pushes, at least; a step takes as long
MOVED_JOINTS = ("LShoulderPitch", "LShoulderRoll", "LElbowRoll")  # by the steps
ON_PATH = 0.005  # [rad] from what the untouched run commands: the push before is over
MOVED = 0.01  # [m]
STILL_DETECTED = 3.0  # [s] after the release: a contact is reported that is no longer there
WITHOUT_REACTIONS = 2  # runs of each plant

TIMES = ("told", "follow_hand", "retract")  # keys of the results: announced, followed, retracted


@dataclass
class Story:
    """Record of a run, tick by tick; times since its first tick [s]."""

    time: list[float] = field(default_factory=list)
    commanded: list[FloatArray] = field(default_factory=list)  # (17,) [rad]
    measured: list[FloatArray] = field(default_factory=list)  # (17,) [rad]
    saturated: list[bool] = field(default_factory=list)  # the motor board of a joint of the arm
    contacts: list[Contact] = field(default_factory=list)
    announced: list[float] = field(default_factory=list)
    reflexes: list[tuple[str, float]] = field(default_factory=list)  # kind and when it began
    tilt: float = 0.0  # [rad] largest


@dataclass(frozen=True)
class Pushed:
    """A push, and the tick of its onset."""

    tick: int
    force: float
    way: str


Pusher = Callable[[Pepper, Story], Pushed | None]


class RandomHand:
    """Pushes at random moments, when the push before is over."""

    def __init__(self, untouched: Story, experiment: Experiment, seed: int) -> None:
        robot = load_robot()
        self._untouched, self._max_tipping = untouched, experiment.max_tipping
        self._rng = np.random.default_rng(seed)
        self._model, self._footing = RobotModel(robot), SupportPolygon.from_robot(robot)
        self._named = np.isin(robot.joint_names, MOVED_JOINTS)
        self._kinds: list[tuple[float, str]] = []
        self._open: set[int] = set()
        self._received = 0
        self._last, self._last_end = -np.inf, untouched.time[-1] - END - DURATION - RELEASE_GRACE
        self._due: float | None = None
        self.left_out: list[tuple[float, str]] = []

    def __call__(self, pepper: Pepper, story: Story) -> Pushed | None:
        now, number = story.time[-1], len(story.time) - 1
        if now < BEGIN or now > self._last_end or not self._is_over(pepper, story):
            self._due = None
            return None
        if self._due is None:
            self._due = max(now, self._last + APART) + self._rng.uniform(0.0, APART)
        if now < self._due:
            return None
        self._due, self._last = None, now
        posture = story.measured[-1]
        point = hand_position(self._model, posture)
        while True:
            force, way = self._next()
            tipping = self._footing.tipping_ratio(posture, point, force * np.array(WAYS[way]))
            if tipping <= self._max_tipping:
                return Pushed(number, force, way)
            self.left_out.append((force, way))

    def _is_over(self, pepper: Pepper, story: Story) -> bool:
        for contact in story.contacts[self._received :]:
            (self._open.discard if contact.phase == "end" else self._open.add)(contact.id)
        self._received = len(story.contacts)
        if self._open or any(reflex.active for reflex in pepper.reflexes):
            return False
        off = story.commanded[-1] - self._untouched.commanded[len(story.time) - 1]
        return float(np.abs(off[self._named]).max()) < ON_PATH

    def _next(self) -> tuple[float, str]:
        if not self._kinds:
            kinds = list(product(FORCES, WAYS))
            self._kinds = [kinds[place] for place in self._rng.permutation(len(kinds))]
        return self._kinds.pop()


def again(pushes: Iterable[Pushed]) -> Pusher:
    """Repeat the pushes in another run."""
    by_tick = {push.tick: push for push in pushes}
    return lambda pepper, story: by_tick.get(len(story.time) - 1)


def play(
    experiment: Experiment, plant: str, seed: int, pusher: Pusher | None = None
) -> tuple[Story, list[Pushed]]:
    """Play an experiment, and push as a pusher says."""
    run = ExperimentRun(experiment, f"mujoco://?plant={plant}&seed={seed % 2**31}")
    pepper, story = run.pepper, Story()
    arm = np.isin(pepper.config.joint_names, pepper.config.limbs[LIMB])
    pushes: list[Pushed] = []
    cues: list[CueEvent] = []
    pepper.on_cue(kind="say")(cues.append)
    start: list[float] = []

    def on_tick(tick: Tick, observation: Observation | None) -> None:
        start.append(tick.measurement.time)
        story.time.append(start[-1] - start[0])
        story.commanded.append(pepper.controller.position)
        story.measured.append(tick.measurement.position)
        truth = pepper.backend.truth
        story.saturated.append(bool(truth.saturated[arm].any()))
        story.tilt = max(story.tilt, float(np.abs(truth.tilt).max()))
        if observation is not None:
            story.contacts.extend(observation.contacts)
        push = pusher(pepper, story) if pusher is not None else None
        if push is not None:
            pushes.append(push)
            pepper.backend.push(HAND, push.force * np.array(WAYS[push.way]), POINT, DURATION)

    report = run.perform(on_tick=on_tick)
    story.announced = [cue.time - start[0] for cue in cues]
    story.reflexes = [(e.kind, e.time - start[0]) for e in report.reflexes if e.phase == "begin"]
    story.contacts = [replace(c, time=c.time - start[0]) for c in story.contacts]
    return story, pushes


def hand_position(model: RobotModel, posture: FloatArray) -> FloatArray:
    """(3,) where the pushed point is, in base_link [m]."""
    pose = model.link_pose(HAND, posture)
    position: FloatArray = pose[:3, :3] @ POINT + pose[:3, 3]
    return position


def moved(model: RobotModel, story: Story, untouched: Story, push: Pushed, end: int) -> float:
    """Return the motion of the hand along a push beyond that of the untouched motion [m]."""
    begin = story.measured[push.tick]
    free = begin + untouched.measured[end] - untouched.measured[push.tick]
    way = hand_position(model, story.measured[end]) - hand_position(model, free)
    return float(way @ np.array(WAYS[push.way]))


def measure(plant: str, min_force: float, seed: int, *, without_reactions: bool) -> Result:
    """Play one seed: each push with delays [s], ways [m] and reported force [N]; what came without a push."""
    experiment = with_min_force(load_experiment(FILE, load_robot()), min_force)
    untouched, _ = play(experiment, plant, seed)
    hand = RandomHand(untouched, experiment, seed)
    story, pushes = play(experiment, plant, seed, hand)
    passive = None
    if without_reactions:
        passive, _ = play(replace(experiment, reactions=()), plant, seed, again(pushes))
    model, results, explained = RobotModel(load_robot()), [], 0
    onsets = [story.time[push.tick] for push in pushes]
    for push, onset, following in zip(pushes, onsets, [*onsets[1:], np.inf], strict=True):
        end = int(np.searchsorted(story.time, onset + DURATION))
        latest = onset + DURATION + RELEASE_GRACE
        announced = [time for time in story.announced if onset < time <= latest]
        explained += len(announced)
        result: Result = {"force": push.force, "way": push.way, "onset": onset}
        result["told"] = announced[0] - onset if announced else None
        for kind in TIMES[1:]:
            begun = [time for k, time in story.reflexes if k == kind and onset < time <= latest]
            result[kind] = begun[0] - onset if begun else None
        forces = [
            contact.force_size
            for contact in story.contacts
            if contact.limb == LIMB and contact.force_size is not None
            if onset < contact.time <= latest
        ]
        result["reported"] = max(forces, default=None)
        still_detected = [c.time for c in story.contacts if onset < c.time < following]
        result["felt_on"] = max(still_detected, default=onset) - onset - DURATION
        result["moved"] = moved(model, story, untouched, push, end)
        result["gave_way"] = passive and moved(model, passive, untouched, push, end)
        result["saturated"] = any(story.saturated[push.tick : end])
        results.append(result)
    return {
        "pushes": results,
        "left_out": hand.left_out,
        "other_sentences": len(story.announced) - explained,
        "tilt": story.tilt,
        "untouched": {
            "seconds": untouched.time[-1],
            "sentences": len(untouched.announced),
            "reflexes": len(untouched.reflexes),
            "contacts": sum(contact.phase == "begin" for contact in untouched.contacts),
        },
    }


def retracts(reaction: Reaction) -> bool:
    """Return True for the reaction to a strong push."""
    return reaction.reflex.get("do") == "retract"


def shipped_min_force() -> float:
    """Force from which the shipped experiment retracts [N]."""
    [retract] = filter(retracts, load_experiment(FILE, load_robot()).reactions)
    return retract.on.min_force


def with_min_force(experiment: Experiment, min_force: float) -> Experiment:
    """Return an experiment that retracts from another force on [N]."""
    reactions = tuple(
        replace(r, on=TouchTrigger(limb=r.on.limb, min_force=min_force)) if retracts(r) else r
        for r in experiment.reactions
    )
    return replace(experiment, reactions=reactions)


def median(values: Iterable[float | None]) -> str:
    """Return a human-readable median of those that are there: a thousandth is 1."""
    there = [value for value in values if value is not None]
    return f"{1e3 * np.median(there):.0f}" if there else "-"


def force_table(pushes: dict[str, list[Result]]) -> Table:
    """Return a row for each plant and force."""
    table = Table(
        "plant", "force", "announced", "followed", "moved by 1 cm", "retracted", "delay, ms", "way, mm",
        "without reactions", "motor at its limit", "still detected",
        title="Simulated: pushes on the hand of the moving arm, all directions",
    )  # fmt: skip
    for plant, force in product(pushes, FORCES):
        rows = [push for push in pushes[plant] if push["force"] == force]
        announced, followed, retracted = (sum(r[key] is not None for r in rows) for key in TIMES)
        moved = sum(r["moved"] >= MOVED for r in rows)
        table.add_row(
            plant,
            f"{force:g} N",
            *(fraction_text(count, len(rows)) for count in (announced, followed, moved, retracted)),
            median(r["told"] for r in rows),
            median(r["moved"] for r in rows),
            median(r["gave_way"] for r in rows),
            str(sum(r["saturated"] for r in rows)),
            str(sum(r["felt_on"] > STILL_DETECTED for r in rows)),
        )
    return table


def way_table(pushes: dict[str, list[Result]]) -> Table:
    """Return a row for each plant and direction."""
    table = Table(
        "plant",
        "direction",
        *(f"{force:g} N" for force in FORCES),
        title="Announced / retracted of all; median (5-95 %) of the largest force reported, N",
    )
    for plant, way in product(pushes, WAYS):
        cells = []
        for force in FORCES:
            rows = [r for r in pushes[plant] if r["force"] == force and r["way"] == way]
            announced, _, retracted = (sum(r[key] is not None for r in rows) for key in TIMES)
            forces = [r["reported"] for r in rows if r["reported"] is not None]
            spread = ""
            if forces:
                low, middle, high = np.percentile(forces, (5, 50, 95))
                spread = f"; {middle:.0f} ({low:.0f}-{high:.0f})"
            cells.append(f"{announced} / {retracted} of {len(rows)}{spread}")
        table.add_row(plant, way, *cells)
    return table


def untouched_table(results: dict[str, list[Result]]) -> Table:
    """Return a row for each plant: what came without touch, and what else there is to know."""
    table = Table(
        "plant", "untouched, min", "sentences", "reflexes", "contacts", "sentences an hour, below",
        "sentences without pushes", "left out, would tip", "largest tilt, deg",
        title="Simulated: the same runs without a touch; and of those with pushes",
    )  # fmt: skip
    for plant, runs in results.items():
        seconds, sentences, reflexes, contacts = (
            sum(run["untouched"][key] for run in runs)
            for key in ("seconds", "sentences", "reflexes", "contacts")
        )
        table.add_row(
            plant,
            f"{seconds / 60.0:.1f}",
            str(sentences),
            str(reflexes),
            str(contacts),
            f"{rate_bound(sentences, seconds / 3600.0):.1f}",
            str(sum(run["other_sentences"] for run in runs)),
            str(sum(len(run["left_out"]) for run in runs)),
            f"{np.degrees(max(run['tilt'] for run in runs)):.1f}",
        )
    return table


def arguments() -> argparse.Namespace:
    """Return the options, checked."""
    parser = Parser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_run_options(roots=ROOTS, runs=10, runs_help="of each plant, two minutes long")
    parser.add_argument("--plants", nargs="+", default=PLANTS, choices=PLANTS)
    parser.add_argument(
        "--min-force", type=float, help="from which it retracts, in place of the file's [N]"
    )
    given = parser.parse_args()
    if given.min_force is None:
        given.min_force = shipped_min_force()
    if not 0.0 <= given.min_force <= MAX_FORCE:
        parser.error(f"--min-force must be 0 to {MAX_FORCE:g} N, got {given.min_force:g}")
    parser.check_run_options(given)
    return given


def main() -> int:
    """Measure, print tables, and return the exit code."""
    given = arguments()
    jobs = {
        f"{given.seeds} {plant} {given.min_force:g} N {number}": partial(
            measure,
            plant,
            given.min_force,
            seed,
            without_reactions=number < WITHOUT_REACTIONS,
        )
        for plant in given.plants
        for number, seed in enumerate(seeds(ROOTS[given.seeds], given.runs, *plant.encode()))
    }
    try:
        done = perform(jobs, given.json, given.jobs, Console(stderr=True))
    except PepperError as error:
        print(f"touch_the_arm.py: {error}", file=sys.stderr)
        return 2
    results = {
        plant: [run for name, run in done.items() if name.split()[1] == plant]
        for plant in given.plants
    }
    pushes = {
        plant: [push for run in runs for push in run["pushes"]] for plant, runs in results.items()
    }
    # A file has no width that cells would have to be folded for.
    console = Console(highlight=False, width=None if sys.stdout.isatty() else FILE_WIDTH)
    for table in (force_table(pushes), way_table(pushes), untouched_table(results)):
        console.print(table)
    return 0


if __name__ == "__main__":
    sys.exit(main())
