"""Takes: runs of simulated robots in one state, touched by people or left alone, and what really touched them."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal
from urllib.parse import urlencode
from zlib import crc32

import numpy as np

from pepper_driver.backends.simulated import TrueContact
from pepper_driver.config import PepperError, RobotConfig, load_robot, load_safety_settings
from pepper_driver.config.arrays import FloatArray
from pepper_driver.config.errors import check_name
from pepper_driver.config.population import HeldOutDrawError
from pepper_driver.config.settings import AttentiveSettings
from pepper_driver.config.touch_suites import PlannedAct, TouchSuites, load_touch_suites
from pepper_driver.controller import Tick
from pepper_driver.evaluation.episodes import REDRAWN, REDRAWS, TIPPED
from pepper_driver.evaluation.quiet import quiet
from pepper_driver.evaluation.touch.people import MadeTouch, Person
from pepper_driver.evaluation.touch.records import Take, Touched
from pepper_driver.evaluation.touch.states import STATES, Deaf, State
from pepper_driver.identification.quality import AT_REST
from pepper_driver.log.touches import PUSHED, touches
from pepper_driver.observer import Observation, Observer, Recording, RecordingBuilder
from pepper_driver.robot import Pepper

OTHER_DAY = 1
"""Day of every second take: the robot is then another than when it was identified."""

HELD_BEFORE = 1.0
"""[s] A touch since before the start acts so long before the first tick of an observer."""

MAX_FOLLOWING_ERROR = 2.0 * math.pi
"""[rad] at which the safety gate stops the robot: people turn a wrist further than a user's gate lets them."""

TABLE, OBJECT = "table met in motion", "object"
"""Row and place of a touch by an object of the world."""


@dataclass(frozen=True, kw_only=True)
class TakeSpec:
    """A take that is to be performed.

    Attributes:
        suite: ``touch`` or ``free``.
        population: Plant of the robot.
        draw: Number of the robot.
        day: Another day than that of its identification; None for that one.
        state: Name of its state.
        number: Among the takes of this suite and state.
        seed: Of all that is drawn.
        acts: Touches, in their order; none in ``free``.
        seconds: Length without touches [s].
    """

    suite: Literal["touch", "free"]
    population: str
    draw: int
    day: int | None
    state: str
    number: int
    seed: tuple[int, ...]
    acts: tuple[PlannedAct, ...] = ()
    seconds: float = 0.0

    @property
    def name(self) -> str:
        """Unique for a robot; part of a file name."""
        return f"{self.suite}-{self.state}-{self.number}"

    @property
    def noise(self) -> int:
        """Seed of the noise of sensors and transport."""
        return int(np.random.SeedSequence(self.seed).generate_state(1)[0])

    @property
    def uri(self) -> str:
        """The simulated robot."""
        query: dict[str, str | int] = {
            "plant": self.population,
            "draw": self.draw,
            "seed": self.noise,
        }
        if self.day is not None:
            query["day"] = self.day
        world = STATES[self.state].world
        if world != State.world:
            query["world"] = world
        return f"mujoco://?{urlencode(query)}"


def plan_takes(suites: TouchSuites, draw: int, free: float) -> tuple[TakeSpec, ...]:
    """Return all takes of a robot.

    Touches of a state are shuffled and dealt to as few takes as the suites allow; every second take is on another day.

    Args:
        suites: Frozen.
        draw: The robot.
        free: Time in which no one touches it [s]; 0 for none.

    Raises:
        UnknownNameError: The suites name a state that does not exist.
    """
    for state in (*suites.all_states, *suites.free.standing, *suites.free.moving):
        check_name("state", state, STATES)
    takes: list[TakeSpec] = []
    for state in suites.all_states:
        for number, acts in enumerate(_dealt(suites, draw, state)):
            takes.append(_spec(suites, "touch", draw, state, number, acts=acts))
    halves = (suites.free.standing, suites.free.moving) if free > 0.0 else ()
    for states in halves:
        for state in states:
            # Two takes of each state: one for each day.
            seconds = free / len(halves) / len(states) / 2
            takes += [
                _spec(suites, "free", draw, state, number, seconds=seconds) for number in (0, 1)
            ]
    return tuple(takes)


def _dealt(suites: TouchSuites, draw: int, state: str) -> list[tuple[PlannedAct, ...]]:
    """Return the touches of each take of a state."""
    acts = suites.acts(state, draw)
    first = [act for act in acts if act.row.act == "before"]
    others = [act for act in acts if act.row.act != "before"]
    generator = np.random.default_rng((suites.root, draw, crc32(state.encode())))
    order = generator.permutation(len(others))
    count = max(1, len(first), math.ceil(len(acts) / suites.touches_per_take))
    # Two at least, one for each day.
    count = max(count, min(2, len(others)))
    return [
        (*first[number::count], *(others[i] for i in order[number::count]))
        for number in range(count)
    ]


def _spec(
    suites: TouchSuites,
    suite: Literal["touch", "free"],
    draw: int,
    state: str,
    number: int,
    *,
    acts: tuple[PlannedAct, ...] = (),
    seconds: float = 0.0,
) -> TakeSpec:
    return TakeSpec(
        suite=suite,
        population=suites.population,
        draw=draw,
        day=OTHER_DAY if number % 2 else None,
        state=state,
        number=number,
        seed=(suites.root, draw, crc32(suite.encode()), crc32(state.encode()), number),
        acts=acts,
        seconds=seconds,
    )


@dataclass(frozen=True, kw_only=True, eq=False)
class Performance:
    """A take with all that observers may see of it, and the true torques.

    Attributes:
        take: Its record, without those of observers.
        recording: Ticks; None of a take that failed.
        true_torque: (n, 17) external torque on each joint [N m].
    """

    take: Take
    recording: Recording | None
    true_torque: FloatArray


class _TakeError(Exception):
    """The robot tipped, was stopped, or a touch could not be made."""


def perform(
    spec: TakeSpec, models: Path | None, *, attentive: AttentiveSettings | None = None
) -> Performance:
    """Perform a take. One in which the robot tips or is stopped is drawn again, up to REDRAWS times.

    Args:
        spec: The take.
        models: The robot's own, of the observer in the loop and of the friction of its joints; None for none.
        attentive: Oscillation of an attentive robot; None for the shipped one.

    Raises:
        HeldOutDrawError: The robot is one for tests, and these are not allowed here.
    """
    reasons: list[str] = []
    for again in range(REDRAWS + 1):
        drawn = replace(spec, seed=(*spec.seed[:-1], spec.seed[-1] + again * REDRAWN))
        try:
            with quiet("pepper_driver"):  # people press a bumper on purpose
                done = _Stage(drawn, models, attentive).perform()
        except HeldOutDrawError:
            raise
        except Exception as error:  # one take that fails must not cost the others
            text = " ".join(str(error).split())
            known = isinstance(error, PepperError | _TakeError)
            reasons.append(text if known else f"{type(error).__name__}: {text}")
            continue
        take = replace(done.take, redrawn=again, reasons=tuple(reasons))
        return replace(done, take=take)
    planned = tuple((act.row.name, act.place, act.force) for act in spec.acts)
    take = replace(
        _record(spec, 0.0, 0.0, ()),
        redrawn=REDRAWS,
        reasons=tuple(reasons),
        failure=reasons[-1],
        planned=planned,
    )
    return Performance(take=take, recording=None, true_torque=np.empty((0, 0)))


def _record(spec: TakeSpec, start: float, end: float, touched: Sequence[Touched]) -> Take:
    return Take(
        suite=spec.suite,
        state=spec.state,
        number=spec.number,
        day=spec.day,
        seed=spec.noise,
        start=start,
        end=end,
        touches=tuple(sorted(touched, key=lambda touch: (touch.onset, touch.limb, touch.link))),
    )


class _Stage:
    """One performance of a take."""

    def __init__(
        self, spec: TakeSpec, models: Path | None, attentive: AttentiveSettings | None
    ) -> None:
        self._spec, self._robot = spec, load_robot()
        self._suites = load_touch_suites(self._robot)
        motion, touch = np.random.SeedSequence(spec.seed).spawn(2)
        self._state = STATES[spec.state](self._robot, np.random.default_rng(motion))
        self._draw = np.random.default_rng(touch)
        reflexes = self._state.reflexes()
        own = models if self._state.reacts else None
        observer: Observer | str | None = None
        if reflexes:
            observer = "fusion" if own is not None else Deaf(len(self._robot.joint_names))
        # Pushes on the chest press its button, and strong ones turn a wrist far: neither must end the take.
        safety = replace(
            load_safety_settings(), chest_button=False, following_error=MAX_FOLLOWING_ERROR
        )
        self._pepper = Pepper(
            spec.uri,
            observer=observer,
            models=own,
            reflexes=reflexes,
            robot=self._robot,
            controller=self._state.controller(models, attentive),
            safety=safety,
        )
        self._builder = RecordingBuilder(self._robot)
        self._torque: list[FloatArray] = []
        self._contacts: list[tuple[int, TrueContact]] = []
        self._tilt = 0.0
        self._ticks, self._next_state = 0, 0

    def perform(self) -> Performance:
        """Play it to its end."""
        spec, suites = self._spec, self._suites
        with self._pepper as pepper:
            person = Person(pepper, suites, self._draw, lambda: len(self._builder))
            acts = list(spec.acts)
            self._state.begin(pepper)
            first = acts.pop(0) if acts and acts[0].row.act == "before" else None
            before = None if first is None else person.perform(first)
            if before is not None:
                next(before)
                pepper.run(HELD_BEFORE)
            if first is not None:
                self._run(first.row.duration - HELD_BEFORE)
            self._run(max(suites.lead, self._state.lead))
            for act in acts:
                for wait in person.perform(act):
                    self._run(wait)
                self._run(float(self._draw.uniform(*suites.pause)))
            self._run(spec.seconds)
        recording = self._builder.finish()
        torque = np.array(self._torque)
        made = _as_they_acted(
            person.touches,
            self._contacts,
            recording,
            torque,
            pepper.backend.plant.friction,
            self._robot,
        )
        start, end = float(recording.time[0]), float(recording.time[-1])
        return Performance(
            take=_record(spec, start, end, made), recording=recording, true_torque=torque
        )

    def _run(self, seconds: float) -> None:
        """Let time pass, in which the state goes on."""
        cycle = self._robot.cycle
        left = round(seconds / cycle)
        while left > 0:
            if self._ticks >= self._next_state:
                self._state.advance(self._pepper, self._ticks * cycle)
                period = self._state.next_period()
                self._next_state = (
                    self._ticks + max(1, round(period / cycle))
                    if math.isfinite(period)
                    else 1 << 62
                )
            ticks = min(left, self._next_state - self._ticks)
            self._pepper.run(ticks * cycle, on_tick=self._on_tick)
            left -= ticks
            self._ticks += ticks
            if self._tilt > TIPPED:
                raise _TakeError(f"it tipped by {math.degrees(self._tilt):.0f} deg")

    def _on_tick(self, tick: Tick, _: Observation | None) -> None:
        truth = self._pepper.backend.truth
        if self._spec.suite == "touch":
            row = len(self._builder)
            self._contacts += [(row, contact) for contact in truth.contacts]
            self._torque.append(truth.contact_torque)
        self._builder.append(tick)
        self._tilt = max(self._tilt, float(np.abs(truth.tilt).max()))


def _as_they_acted(
    made: Sequence[MadeTouch],
    contacts: Sequence[tuple[int, TrueContact]],
    recording: Recording,
    torque: FloatArray,
    friction: FloatArray,
    robot: RobotConfig,
) -> list[Touched]:
    """Return the touches of a take as they really acted, those by objects of the world too."""
    by_link: dict[str, list[tuple[int, TrueContact]]] = {}
    by_limb: dict[str, list[tuple[int, TrueContact]]] = {}
    for row, contact in contacts:
        if contact.peak <= PUSHED:
            continue
        if contact.kind == "object":
            by_limb.setdefault(robot.limb_of_link(contact.link), []).append((row, contact))
        else:
            by_link.setdefault(contact.link, []).append((row, contact))
    result = []
    for number, touch in enumerate(made):
        link = touch.point.link
        later = [m.row for m in made[number + 1 :] if m.point.link == link]
        until = later[0] if later else len(recording)
        own = [(row, c) for row, c in by_link.get(link, ()) if touch.row <= row < until]
        if own:
            acted = _touched(touch, own, recording, torque, friction, robot)
            result.append(replace(acted, standing_start=touch.act.row.act == "before"))
        elif touch.rise is not None:
            raise _TakeError(f"a touch of {link} did not act")
    for own in by_limb.values():
        rows = np.array(sorted({row for row, _ in own}))
        touched = np.zeros(len(recording), dtype=np.bool_)
        touched[rows] = True
        for first, last in touches(recording.time, touched):
            part = [(row, c) for row, c in own if first <= row <= last]
            result.append(_touched(None, part, recording, torque, friction, robot))
    return result


def _touched(
    made: MadeTouch | None,
    own: Sequence[tuple[int, TrueContact]],
    recording: Recording,
    torque: FloatArray,
    friction: FloatArray,
    robot: RobotConfig,
) -> Touched:
    first, last = own[0][0], own[-1][0]
    strongest = max(own, key=lambda entry: entry[1].peak)[1]
    limb = robot.limb_of_link(strongest.link)
    joints = [robot.joint_index(name) for name in robot.limbs[limb]]
    during = torque[first : last + 1, joints]
    peak = during[np.abs(during).argmax(axis=0), np.arange(len(joints))]
    force = float(np.linalg.norm(strongest.force))
    lever = np.abs(strongest.torque[joints]) / max(force, PUSHED)
    with np.errstate(divide="ignore"):
        bound = float((2.0 * friction[joints] / lever).min())
    speed = np.abs(recording.velocity[first, joints])
    return Touched(
        row=TABLE if made is None else made.act.row.name,
        place=OBJECT if made is None else made.place,
        limb=limb,
        link=strongest.link,
        asked=None if made is None else made.act.force,
        force=strongest.peak,
        rise=None if made is None else made.rise,
        onset=float(recording.time[first]) - robot.cycle,
        release=float(recording.time[last]),
        torque={robot.joint_names[i]: float(value) for i, value in zip(joints, peak, strict=True)},
        friction_bound=bound if math.isfinite(bound) else None,
        moving=bool(speed.max() > AT_REST),
    )
