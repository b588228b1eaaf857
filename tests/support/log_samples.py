"""Ticks to log, made up: random bits, special values included."""

from __future__ import annotations

from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np

from pepper_driver.backends.fields import Command, Imu, Measurement
from pepper_driver.backends.simulated import TrueContact, TruthSample
from pepper_driver.config import load_robot
from pepper_driver.config.arrays import BoolArray, FloatArray
from pepper_driver.controller.tick import Reference, SentCommand, Tick
from pepper_driver.log import LogWriter, RunLog
from pepper_driver.log.topics import TrueForce
from pepper_driver.loop import TickRecord
from pepper_driver.observer.interface import Contact, Observation

ROBOT = load_robot()
TRUTH_FIELDS = tuple(field.name for field in fields(TruthSample) if field.name != "contacts")
N = len(ROBOT.joint_names)
SPECIAL = (np.nan, np.inf, -np.inf, -0.0, 5e-324, 1.7976931348623157e308)


class Samples:
    """A stream of ticks that differ in every bit."""

    def __init__(self, seed: int = 0) -> None:
        self.random = np.random.default_rng(seed)

    def vector(self, size: int) -> FloatArray:
        """(size,) floats of random bits, some of them special."""
        bits = self.random.integers(0, 2**64, size, dtype=np.uint64, endpoint=False)
        values = bits.view(np.float64)
        values[self.random.random(size) < 0.1] = self.random.choice(SPECIAL)
        return values

    def flags(self, size: int) -> BoolArray:
        """(size,) random truth values."""
        return self.random.random(size) < 0.5

    def tick(self, number: int) -> Tick:
        """Tick ``number``, 12 ms after the one before."""
        return Tick(
            measurement=Measurement(
                time=number * 0.012,
                tick=number,
                position=self.vector(N),
                current=self.vector(N),
                wheel_speed=self.vector(3),
                imu=Imu(
                    acceleration=self.vector(3),
                    angular_velocity=self.vector(3),
                    attitude=self.vector(3),
                ),
                touch=self.vector(len(ROBOT.sensors.touch)),
                bumpers=self.vector(len(ROBOT.sensors.bumpers)),
                buttons=self.vector(len(ROBOT.sensors.buttons)),
                temperature=self.vector(N),
                battery=float(self.random.random()),
                age=float(self.random.random()),
                charging_flap=float(self.random.random()),
                response_delay=int(self.random.integers(5)),
                dropped_commands=int(self.random.integers(1000)),
                stiffness=self.vector(N),
            ),
            reference=Reference(
                position=self.vector(N),
                velocity=self.vector(N),
                acceleration=self.vector(N),
                load_torque=self.vector(N),
                base_twist=self.vector(3),
            ),
            sent=self.command(),
            limited=self.flags(N),
        )

    def sent(self) -> SentCommand:
        """A command that no tick answers."""
        reference = self.tick(0).reference
        return SentCommand(sent=self.command(), reference=reference, limited=self.flags(N))

    def command(self) -> Command:
        """A command that a robot might get."""
        return Command(
            position=self.vector(N), stiffness=self.vector(N), wheel_speed=self.vector(3)
        )

    def observation(self, *contacts: Contact) -> Observation:
        """An observation that an observer might make, with these contacts."""
        return Observation(
            contacts=contacts,
            expected=self.vector(N),
            residual=self.vector(N),
            threshold=self.vector(N),
            torque=self.vector(N),
            torque_std=self.vector(N),
            state=self.random.integers(0, 6, N).astype(np.int8),
        )

    def truth(self) -> TruthSample:
        """A truth that a simulation might know."""
        return TruthSample(
            contact_torque=self.vector(N),
            peak_torque=self.vector(N),
            position=self.vector(N),
            base=self.vector(3),
            tilt=self.vector(2),
            wheel_load=self.vector(3),
            in_gap=self.flags(N),
            saturated=self.flags(N),
            contacts=tuple(self.true_contact() for _ in range(self.random.integers(3))),
        )

    def true_contact(self) -> TrueContact:
        """A contact that a robot might have in a simulation."""
        random = self.random
        thing = "ball" if random.random() < 0.5 else None
        return TrueContact(
            kind="hand" if thing is None else "object",
            link=ROBOT.links[random.integers(len(ROBOT.links))],
            object=thing,
            point=random.normal(size=3),
            force=random.normal(size=3),
            peak=float(random.random()),
            torque=self.vector(N),
        )

    def numbers(self, count: int) -> Any:
        """A tuple of numbers."""
        return tuple(self.random.normal(size=count).tolist())

    def contact(self, number: int) -> Contact:
        """Contact ``number``, detected by a random joint or by none."""
        random = self.random
        joint = None if number % 3 == 0 else ROBOT.joint_names[random.integers(N)]
        known = number % 2 == 0
        return Contact(
            id=number,
            phase=("begin", "update", "end")[number % 3],
            kind=("contact", "collision", "rebound")[number % 3],
            limb=ROBOT.limb_of(joint),
            joint=joint,
            shown_by=joint,
            link=ROBOT.links[0],
            direction=1 if known else -1,
            intensity_deg=float(random.random()),
            torque=float(random.normal()) if known else None,
            torque_std=float(random.random()) if known else None,
            force=self.numbers(3) if known else None,
            force_covariance=self.numbers(9) if known else None,
            force_interval=self.numbers(2) if known else None,
            point=self.numbers(3) if known else None,
            point_covariance=self.numbers(9) if known else None,
            scale_known=number % 4 == 0 if known else None,
            onset_time=float(random.random()),
            detection_time=float(random.random()),
            time=float(random.random()),
        )


def flatten(tick: Tick, observation: Observation, step: int = 0) -> dict[str, object]:
    """The values of one tick, in no real time, under the names they have in the log."""
    m = tick.measurement
    values: dict[str, object] = {
        f.name: getattr(m, f.name)
        for f in fields(Measurement)
        if f.name not in ("imu", "stale_reason", "commanded_by_others")
    }
    values |= {f"imu_{f.name}": getattr(m.imu, f.name) for f in fields(Imu)}
    values |= {f"sent_{f.name}": getattr(tick.sent, f.name) for f in fields(Command)}
    values |= {f"reference_{f.name}": getattr(tick.reference, f.name) for f in fields(Reference)}
    values |= {
        f.name: getattr(observation, f.name) for f in fields(Observation) if f.name != "contacts"
    }
    counters = {"tick_end": np.nan, "missed": 0, "step": step}
    return {**values, **counters, "limited": tick.limited}


def flatten_sent(sent: SentCommand, time: float, step: int) -> dict[str, object]:
    """The values of a command that no tick answers, under the names they have in the log."""
    values = {f"sent_{f.name}": getattr(sent.sent, f.name) for f in fields(Command)}
    values |= {f"reference_{f.name}": getattr(sent.reference, f.name) for f in fields(Reference)}
    return {**values, "limited": sent.limited, "time": time, "step": step}


def same_bits(read: object, given: object) -> bool:
    """Return True if two arrays or numbers have the same type, shape and bits."""
    a, b = np.asarray(read), np.asarray(given)
    return (a.dtype, a.shape) == (b.dtype, b.shape) and a.tobytes() == b.tobytes()


class Written:
    """A log of some ticks, and what went into it."""

    def __init__(self, path: Path, count: int, seed: int = 0) -> None:
        samples = Samples(seed)
        self.path = path
        self.rows: list[dict[str, object]] = []
        self.truths: list[dict[str, object]] = []
        self.unmatched: list[dict[str, object]] = []
        self.contacts: list[Contact] = []
        self.forces: list[TrueForce] = []
        with LogWriter(path, ROBOT, {"seed": str(seed)}, lossless=True) as log:
            for number in range(count):
                tick = samples.tick(number)
                contacts = [samples.contact(100 * number + i) for i in range(number % 3)]
                observation = samples.observation(*contacts)
                truth = samples.truth()
                passed_over = [(k, samples.sent()) for k in range(number % 4, 1, -1)]
                log.append(
                    TickRecord(
                        tick=tick, observation=observation, truth=truth, unmatched=passed_over
                    )
                )
                self.rows.append(flatten(tick, observation, number))
                for ago, sent in passed_over:
                    step = number - ago
                    self.unmatched.append(flatten_sent(sent, tick.measurement.time, step))
                self.truths.append({name: getattr(truth, name) for name in TRUTH_FIELDS})
                self.contacts += contacts
                time = tick.measurement.time
                self.forces += [TrueForce.of(contact, time) for contact in truth.contacts]

    def check(self, read: RunLog) -> None:
        """The log read holds the first of these ticks, bit for bit."""
        n = len(read)
        for name, column in read.fields.items():
            for row in range(n):
                assert same_bits(column[row], self.rows[row][name]), (name, row)
        assert read.truth is not None or n == 0
        if read.truth is not None:
            for name in TRUTH_FIELDS:
                for row in range(len(read.truth["time"])):
                    assert same_bits(read.truth[name][row], self.truths[row][name]), (name, row)
        for name, column in read.unmatched.items():
            for row, value in enumerate(column):
                assert same_bits(value, self.unmatched[row][name]), (name, row)
        lost = sum(row["time"] not in read["time"] for row in self.unmatched)
        missing = len(self.unmatched) - lost - len(read.unmatched["step"])
        assert 0 <= missing <= 2, "those of the last tick may be cut off"
        assert (read.forces is None) == (read.truth is None)
        assert (forces := read.forces or []) == self.forces[: len(forces)]
        assert read.contacts == self.contacts[: len(read.contacts)]
