"""The same motion by the loop, by the plant alone and by bare physics: the same states, each at its own cost."""

import threading
from pathlib import Path
from time import thread_time
from typing import Any

import mujoco
import numpy as np
import pytest

from pepper_driver.backends import make_backend
from pepper_driver.backends.mujoco_ import MujocoBackend
from pepper_driver.bench import loop, physics
from pepper_driver.bench.loop import TURN, Speed, record_turns, run_loop_bench, time_observer
from pepper_driver.bench.physics import RecordedSteps, StepRecorder
from pepper_driver.controller import Tick
from pepper_driver.log import LogWriter
from pepper_driver.observer import ContactObserver, Observation, shipped


def energy(steps: RecordedSteps) -> float:
    """Kinetic, after a replay [J]."""
    momentum = np.empty(steps.model.nv)
    mujoco.mj_mulM(steps.model, steps.data, momentum, steps.data.qvel)
    return 0.5 * float(momentum @ steps.data.qvel)


@pytest.mark.parametrize("plant", ["nominal", "integral", "worn", "soft-hip", "jitter"])
def test_plant_and_bare_physics_go_where_the_loop_went(plant: str, tmp_path: Path) -> None:
    """Commands, controls and frictions are all there, and in their places: so each step costs what it did."""
    snapshot, turns = record_turns(plant, 2, tmp_path / "run.mcap")
    backend = make_backend(f"mujoco://?plant={plant}")
    assert isinstance(backend, MujocoBackend)
    with backend:
        backend.open()
        backend.restore(snapshot)
        start = backend.truth.position
        for turn in turns:
            assert len(turn.commands) == round(TURN / backend.info.cycle)
            assert len(turn.steps) == 6 * len(turn.commands), "six of 2 ms a tick"
            for command in turn.commands:
                backend.exchange(command)
            for _ in range(2):
                turn.steps.replay()
                joints = [turn.steps.model.joint(name) for name in backend.info.joint_names]
                position = turn.steps.data.qpos[[joint.qposadr[0] for joint in joints]]
                assert np.array_equal(position, backend.truth.position)
                assert energy(turn.steps) == backend.truth.kinetic_energy
        assert np.abs(backend.truth.position - start).max() > 0.1, "the arms move"


PENDULUM = """
<mujoco><worldbody><body><joint type="hinge" axis="0 1 0"/><geom size="0.1" pos="0 0 -1"/></body></worldbody></mujoco>
"""
STEP, CHANGE = 0.25, 4.0
"""[s] Of a step, and of what is set before it."""


class Slowly:
    """An array of which each change takes a time, ``clock`` holding what has passed [s]."""

    def __init__(self, array: Any, clock: list[float]) -> None:
        self.array, self.clock = array, clock

    def __setitem__(self, key: slice, values: Any) -> None:
        self.clock[0] += CHANGE
        self.array[key] = values


def test_the_time_is_that_of_the_steps_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    """Steps of a known time, next to changes that take longer than they do."""
    model = mujoco.MjModel.from_xml_string(PENDULUM)
    data = mujoco.MjData(model)
    with StepRecorder(50) as recorder:
        for step in range(100):
            model.dof_damping[:] = 0.01 * step
            mujoco.mj_step(model, data)
    assert [len(steps) for steps in recorder.recordings] == [50, 50]
    steps, clock, count = recorder.recordings[1], [0.0], 0
    changes = [[(Slowly(array, clock), v) for array, v in each] for each in steps._changes]

    def spin(model: mujoco.MjModel, data: mujoco.MjData) -> None:
        nonlocal count
        count += 1
        clock[0] += STEP

    monkeypatch.setattr(steps, "_changes", changes)
    monkeypatch.setattr(physics, "perf_counter", lambda: clock[0])
    monkeypatch.setattr(mujoco, "mj_step", spin)
    np.testing.assert_array_equal(steps.replay(), np.full(50, STEP))
    assert count == 50
    assert clock[0] >= 50 * (STEP + CHANGE), "each step has another damping"
    assert steps.model.dof_damping[0] == 0.99
    mujoco.mj_step(model, data)
    assert len(recorder.recordings) == 2, "nothing is recorded outside of the block"


def test_ratios_are_those_of_times() -> None:
    speed = Speed(
        loop=9.0, plant=25.0, loop_us=1250.0, log_us=100.0, plant_us=500.0, physics_us=250.0
    )
    assert (speed.loop_over_physics, speed.plant_over_physics) == (5.0, 2.0)


@pytest.mark.parametrize("plant", ["nominal", "soft-hip"])
def test_an_observer_that_dawdles_is_seen(
    plant: str, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """Each tick takes 4 ms in one of two runs, and 9 ms in the other."""
    step, now, count = ContactObserver.step, 0.0, 0

    def dawdle(observer: ContactObserver, tick: Tick) -> Observation:
        nonlocal now, count
        now, count = now + (0.009 if count % 2 else 0.004), count + 1
        return step(observer, tick)

    assert round(TURN / 0.012) % 2 == 1, "so that a tick is in another place of the second run"
    monkeypatch.setattr(loop, "RUNS", 2)
    monkeypatch.setattr(loop, "perf_counter", lambda: now)
    monkeypatch.setattr(ContactObserver, "step", dawdle)
    taken = time_observer(plant, 1, tmp_path / "run.mcap")
    if plant in shipped("fusion"):
        assert taken == pytest.approx(4000.0)
    else:
        assert taken is None


WRITING = 1.0
"""[s] of a processor, in a run of 250 ticks."""


def test_a_log_that_is_written_late_costs_as_much(monkeypatch: pytest.MonkeyPatch) -> None:
    """Its thread writes when it likes, also between the turns that are timed, and most of a short run at its end.

    Only processor time is compared with a figure: a machine that does other work lengthens all others.
    """
    monkeypatch.setattr(loop, "RUNS", 2)
    close = LogWriter.close

    def write() -> None:
        end = thread_time() + WRITING
        while thread_time() < end:
            pass

    def close_late(log: LogWriter) -> None:
        thread = threading.Thread(target=write)
        thread.start()
        thread.join()
        close(log)

    monkeypatch.setattr(LogWriter, "close", close_late)
    speed = run_loop_bench(2.0).speed["nominal"]
    cycle = 0.012
    assert speed.log_us > 0.5 * 1e6 * WRITING / 250
    assert speed.loop_us > speed.log_us
    assert speed.loop < 1e6 * cycle / speed.log_us, "the speed of the simulation counts it too"
