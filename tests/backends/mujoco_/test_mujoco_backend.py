"""The simulated Pepper as a whole: sensing, determinism, pushes and their truth."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pinocchio
import pytest

from pepper_driver.backends import (
    BackendError,
    CapabilityError,
    Command,
    NotConnectedError,
    make_backend,
)
from pepper_driver.backends.interface import DEAD_MAN_CYCLES, Backend
from pepper_driver.backends.mujoco_ import MujocoBackend
from pepper_driver.config import UnknownNameError, load_plant, load_robot
from pepper_driver.config.arrays import FloatArray

ROBOT = load_robot()
ROLL = ROBOT.joint_index("LShoulderRoll")


def command(position: FloatArray, stiffness: float = 1.0) -> Command:
    return Command(position=position, stiffness=np.full(17, stiffness), wheel_speed=np.zeros(3))


def active(seed: int = 0) -> tuple[MujocoBackend, FloatArray]:
    backend = MujocoBackend(ROBOT, load_plant("nominal", ROBOT), seed=seed)
    hold = np.clip(backend.open().position, ROBOT.lower, ROBOT.upper)
    backend.activate()
    return backend, hold


def wave(hold: FloatArray, time: float) -> FloatArray:
    position = hold.copy()
    position[ROLL] += 0.3 * (1 - np.cos(2 * np.pi * 0.4 * time))
    return position


def run(seed: int, ticks: int = 150) -> list[bytes]:
    backend, hold = active(seed)
    backend.push("LForeArm", np.array([0.0, 8.0, 0.0]), duration=0.6, delay=0.3)
    samples = []
    for tick in range(ticks):
        m = backend.exchange(command(wave(hold, tick * ROBOT.cycle)))
        samples.append(m.position.tobytes() + m.current.tobytes())
    return samples


def test_the_same_seed_gives_the_same_bits() -> None:
    assert run(3) == run(3)


def test_another_seed_gives_other_noise() -> None:
    assert run(3) != run(4)


def test_two_plants_in_one_process_do_not_meet() -> None:
    alone = run(3)
    first, hold = active(3)
    second, _ = active(3)
    first.push("LForeArm", np.array([0.0, 8.0, 0.0]), duration=0.6, delay=0.3)
    for tick in range(150):
        m = first.exchange(command(wave(hold, tick * ROBOT.cycle)))
        second.exchange(command(hold))
        assert m.position.tobytes() + m.current.tobytes() == alone[tick]


def test_encoders_count_in_4096ths_of_a_turn_one_cycle_late() -> None:
    backend, hold = active()
    true, measured = [], []
    for tick in range(200):
        m = backend.exchange(command(wave(hold, tick * ROBOT.cycle)))
        true.append(backend.truth.position)
        measured.append(m.position)
    counts = np.array(measured) / (2 * np.pi / 4096)
    np.testing.assert_allclose(counts, np.rint(counts), atol=1e-6)
    error = [
        np.abs(np.array(measured)[delay:, ROLL] - np.array(true)[: 200 - delay, ROLL]).max()
        for delay in (0, 1, 2)
    ]
    noise = 5 * load_plant("nominal", ROBOT).transport.encoder_noise
    assert error[1] < 2 * np.pi / 4096 / 2 + noise
    assert error[0] > 2 * error[1]
    assert error[2] > 2 * error[1]


def test_the_truth_is_the_jacobian_times_the_force() -> None:
    backend, hold = active()
    force, point = np.array([3.0, 5.0, -2.0]), np.array([0.02, 0.01, 0.03])
    backend.push("l_wrist", force, point, duration=2.0)
    for _ in range(100):
        backend.exchange(command(hold))

    model = pinocchio.buildModelFromUrdf(str(ROBOT.urdf))
    data = model.createData()
    q = pinocchio.neutral(model)
    for name, angle in zip(ROBOT.joint_names, backend.truth.position, strict=True):
        q[model.joints[model.getJointId(name)].idx_q] = angle
    pinocchio.computeJointJacobians(model, data, q)
    pinocchio.updateFramePlacements(model, data)
    frame = model.getFrameId("l_wrist")
    jacobian = pinocchio.getFrameJacobian(
        model, data, frame, pinocchio.ReferenceFrame.LOCAL_WORLD_ALIGNED
    )
    moment = np.cross(data.oMf[frame].rotation @ point, force)
    torque = jacobian.T @ np.concatenate([force, moment])
    expected = [torque[model.joints[model.getJointId(n)].idx_v] for n in ROBOT.joint_names]
    np.testing.assert_allclose(backend.truth.contact_torque, expected, atol=2e-3)


def test_a_push_in_link_axes_keeps_its_torque_as_the_arm_turns() -> None:
    backend, hold = active()
    lever, force = 0.16, 10.0
    backend.push(
        "LBicep", np.array([0.0, force, 0.0]), np.array([lever, 0.0, 0.0]), 3.0, frame="link"
    )
    torques = []
    for tick in range(240):
        backend.exchange(command(wave(hold, tick * ROBOT.cycle)))
        torques.append(backend.truth.contact_torque[ROLL])
    np.testing.assert_allclose(torques[20:], lever * force, rtol=1e-3)


def test_a_push_rises_holds_and_ends() -> None:
    backend, hold = active()
    backend.push("LBicep", np.array([0.0, 10.0, 0.0]), np.array([0.16, 0, 0]), 0.6, delay=0.24)
    torques = []
    for _ in range(100):
        backend.exchange(command(hold))
        torques.append(backend.truth.contact_torque[ROLL])
    times = np.arange(100) * ROBOT.cycle
    torques_array = np.abs(np.array(torques))
    assert (torques_array[times + ROBOT.cycle <= 0.24] == 0).all()
    assert (torques_array[times > 0.24 + 0.6] == 0).all()
    assert torques_array[(times > 0.35) & (times < 0.7)].min() > 1.0


def test_stiffness_scales_what_the_joint_can_hold() -> None:
    """A push that full stiffness holds moves a soft joint to its stop."""
    deflections = []
    for stiffness in (1.0, 0.2):
        backend, hold = active()
        for _ in range(40):
            backend.exchange(command(hold, stiffness))
        backend.push(
            "LBicep", np.array([0.0, 25.0, 0.0]), np.array([0.16, 0, 0]), 1.5, frame="link"
        )
        for _ in range(100):
            backend.exchange(command(hold, stiffness))
        deflections.append(backend.truth.position[ROLL] - hold[ROLL])
        assert backend.truth.saturated[ROLL] == (stiffness < 1.0)
    assert deflections[1] > 3 * deflections[0]


def test_brakes_hold_the_legs_without_stiffness() -> None:
    backend = make_backend("mujoco://?posture=Crouch")
    with backend:
        first = backend.open()
        for _ in range(120):
            last = backend.exchange(command(np.clip(first.position, ROBOT.lower, ROBOT.upper), 0.0))
        legs = [ROBOT.joint_index(name) for name in ROBOT.chains["legs"]]
        assert np.abs(last.position[legs] - first.position[legs]).max() < np.radians(1.0)


def test_wheels_follow_their_command() -> None:
    backend = MujocoBackend(ROBOT, replace(load_plant("nominal", ROBOT), base="fixed"))
    hold = np.clip(backend.open().position, ROBOT.lower, ROBOT.upper)
    backend.activate()
    speeds = np.array([1.0, -2.0, 20.0])
    for _ in range(120):
        m = backend.exchange(Command(position=hold, stiffness=np.ones(17), wheel_speed=speeds))
    np.testing.assert_allclose(m.wheel_speed, [1.0, -2.0, ROBOT.wheels.speed_limit], rtol=1e-3)


def step_often(backend: MujocoBackend, hold: FloatArray) -> None:
    for _ in range(20):
        backend.exchange(command(hold))


def test_a_simulation_that_blows_up_says_so(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)  # MuJoCo leaves a note of its own there
    backend, hold = active()
    backend._data.qvel[backend._model.link_dof[ROLL]] = 1e12
    with pytest.raises(BackendError, match="diverged"):
        step_often(backend, hold)
    with pytest.raises(NotConnectedError):
        backend.exchange(command(hold))
    backend.close()
    assert np.isfinite(backend.open().position).all()


@pytest.mark.parametrize(
    ("arguments", "error"),
    [
        ({"link": "LForearm", "force": [0, 1, 0]}, UnknownNameError),
        ({"link": "LForeArm", "force": [0, np.nan, 0]}, ValueError),
        ({"link": "LForeArm", "force": [0, 1]}, ValueError),
        ({"link": "LForeArm", "force": [0, 1e5, 0]}, ValueError),
        ({"link": "LForeArm", "force": [0, 1, 0], "point": [0, 0]}, ValueError),
        ({"link": "LForeArm", "force": [0, 1, 0], "duration": 0.0}, ValueError),
        ({"link": "LForeArm", "force": [0, 1, 0], "duration": np.inf}, ValueError),
        ({"link": "LForeArm", "force": [0, 1, 0], "delay": -1.0}, ValueError),
        ({"link": "LForeArm", "force": [0, 1, 0], "rise": 0.0}, ValueError),
        ({"link": "LForeArm", "force": [0, 1, 0], "rise": np.nan}, ValueError),
        ({"link": "LForeArm", "force": [0, 1, 0], "frame": "torso"}, UnknownNameError),
    ],
)
def test_a_wrong_push_is_refused(arguments: dict[str, object], error: type[Exception]) -> None:
    backend, _ = active()
    with pytest.raises(error):
        backend.push(**arguments)  # type: ignore[arg-type]


def test_a_robot_without_simulation_has_neither_truth_nor_pushes() -> None:
    class Real(MujocoBackend):
        schedule_push = Backend.schedule_push
        truth = Backend.truth

    backend = Real(ROBOT, load_plant("nominal", ROBOT))
    with pytest.raises(CapabilityError, match="ground truth"):
        _ = backend.truth
    with pytest.raises(CapabilityError, match="push"):
        backend.push("LForeArm", np.zeros(3))


def test_the_truth_after_going_back_is_that_of_then() -> None:
    backend, hold = active()

    def truth() -> tuple[float, bytes, bytes]:
        now = backend.truth
        return now.kinetic_energy, now.position.tobytes(), now.in_gap.tobytes()

    for tick in range(40):
        backend.exchange(command(wave(hold, tick * 0.012)))
    before, snapshot = truth(), backend.snapshot()
    for _ in range(20):
        backend.exchange(command(hold))
    backend.restore(snapshot)
    after = truth()
    assert before[0] > 1e-4
    assert after[0] == pytest.approx(before[0], rel=0.05)  # MuJoCo's masses lag a step behind
    assert after[1:] == before[1:]


def test_switched_on_it_obeys_without_a_ramp() -> None:
    """For a device manager, whose users raise the stiffness themselves."""
    backend = MujocoBackend(ROBOT, load_plant("nominal", ROBOT))
    with pytest.raises(BackendError, match="closed"):
        backend.switch_on()
    start = np.clip(backend.open().position, ROBOT.lower, ROBOT.upper)
    backend.switch_on()
    with pytest.raises(BackendError, match="active"):
        backend.switch_on()
    target = start.copy()
    target[ROLL] += 0.1
    assert backend.exchange(command(target)).tick == 1
    for _ in range(60):
        measurement = backend.exchange(command(target))
    assert measurement.position[ROLL] == pytest.approx(target[ROLL], abs=0.03)


def test_wheels_without_stiffness_do_not_turn_and_a_snapshot_has_it() -> None:
    backend, hold = active()
    turning = Command(position=hold, stiffness=np.ones(17), wheel_speed=np.full(3, 1.0))
    backend.wheel_stiffness = np.zeros(3)
    snapshot = backend.snapshot()
    for _ in range(30):
        measurement = backend.exchange(turning)
    assert np.abs(measurement.wheel_speed).max() < 0.05
    backend.wheel_stiffness = np.ones(3)
    for _ in range(80):
        measurement = backend.exchange(turning)
    np.testing.assert_allclose(measurement.wheel_speed, 1.0, atol=0.1)
    backend.restore(snapshot)
    np.testing.assert_array_equal(backend.wheel_stiffness, np.zeros(3))


def turning(hold: FloatArray, speed: float = 1.0) -> Command:
    return replace(command(wave(hold, 0.6)), wheel_speed=np.full(3, speed))


def test_a_command_goes_on_but_wheels_stand_after_the_dead_mans_cycles() -> None:
    """To the last bit as if the command had been written again, and then with wheels that stand."""
    silent, hold = active()
    commanded, _ = active()
    silent.write(turning(hold))
    for cycle in range(40):
        ours = silent.read()
        theirs = commanded.exchange(turning(hold, 1.0 if cycle < DEAD_MAN_CYCLES else 0.0))
        assert ours.position.tobytes() == theirs.position.tobytes()
        assert ours.wheel_speed.tobytes() == theirs.wheel_speed.tobytes()
    assert np.abs(ours.wheel_speed).max() < 0.05
    assert ours.position[ROLL] == pytest.approx(wave(hold, 0.6)[ROLL], abs=0.03)


@pytest.mark.parametrize("read_before", [0, DEAD_MAN_CYCLES - 1, DEAD_MAN_CYCLES + 1])
def test_a_snapshot_carries_the_last_command(read_before: int) -> None:
    """And since when no other was written: wheels stand when they would have stood."""
    backend, hold = active()
    rolling = turning(hold)
    for _ in range(20):
        backend.exchange(rolling)
    for _ in range(read_before):
        backend.read()
    snapshot = backend.snapshot()

    def go_on(robot: MujocoBackend) -> list[bytes]:
        samples = [robot.read() for _ in range(12)]
        return [m.position.tobytes() + m.wheel_speed.tobytes() for m in samples]

    then = go_on(backend)
    other, _ = active(seed=1)
    for robot in (backend, other):
        robot.write(command(hold))
        robot.read()
        robot.restore(snapshot)
        assert go_on(robot) == then


def test_what_was_written_before_it_was_switched_on_moves_nothing() -> None:
    backend = MujocoBackend(ROBOT, load_plant("nominal", ROBOT))
    start = np.clip(backend.open().position, ROBOT.lower, ROBOT.upper)
    legs = [ROBOT.joint_index(name) for name in ROBOT.chains["legs"]]
    backend.write(turning(start + 0.2))
    backend.switch_on()
    for _ in range(40):
        measurement = backend.read()
    np.testing.assert_allclose(measurement.wheel_speed, 0.0, atol=0.05)
    np.testing.assert_allclose(measurement.position[legs], start[legs], atol=0.02)


def test_a_stiffness_beyond_its_range_is_the_nearest_within() -> None:
    shown = []
    for stiffness in (np.tile([1.0, 0.0], 9)[:17], np.tile([2.0, -1.0], 9)[:17]):
        with make_backend("mujoco://?seed=1") as backend:
            backend.open()
            position = backend.activate().position + 0.1
            command = Command(position=position, stiffness=stiffness, wheel_speed=np.zeros(3))
            shown.append([backend.exchange(command).position for _ in range(30)])
    np.testing.assert_array_equal(shown[0], shown[1])
