"""The simulated Pepper as a backend, with MuJoCo's window."""

from __future__ import annotations

import copy
import os
import sys
import warnings
from dataclasses import dataclass, replace
from typing import Any, Literal

import mujoco
import numpy as np
from numpy.typing import ArrayLike

from pepper_driver.backends.fields import Command, Measurement
from pepper_driver.backends.interface import (
    DEAD_MAN_CYCLES,
    Backend,
    BackendError,
    BackendInfo,
    NotConnectedError,
    Serial,
    checked_command,
    serial,
)
from pepper_driver.backends.mujoco_.pushes import LIVE_RELEASE
from pepper_driver.backends.mujoco_.sensors import CommandDelayLine
from pepper_driver.backends.mujoco_.simulation import MujocoTruth, Readings, Simulation
from pepper_driver.backends.selection import BackendUri
from pepper_driver.backends.simulated import (
    HAND_TIMEOUT,
    Grab,
    Hand,
    Push,
    Resumable,
    SimulatedPlant,
    Truth,
)
from pepper_driver.config import (
    ConfigError,
    PlantConfig,
    RobotConfig,
    RobotIdentity,
    World,
    load_plant,
    load_world,
    parent_plants,
    plant_hash,
)
from pepper_driver.config.arrays import FloatArray
from pepper_driver.config.kernels import Matrix, Out, kernel


def check_display() -> None:
    """Raise a BackendError where no window can open."""
    if sys.platform == "linux" and not (
        os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")
    ):
        raise BackendError("no window: this machine has no display (DISPLAY is not set)")
    if sys.platform == "darwin" and "mjpython" not in os.path.basename(sys.executable):
        raise BackendError("no window: on macOS run with 'mjpython' in place of 'python'")


class MujocoWindow:
    """Shows the state of the simulation; closing it by hand does not stop the robot."""

    def __init__(self, model: mujoco.MjModel, data: mujoco.MjData) -> None:
        check_display()
        import glfw  # these need GL: only now
        from mujoco import viewer

        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # the failure is reported below
            if not glfw.init():  # MuJoCo would end the process
                raise BackendError("no window: the display cannot be opened")
        try:
            self._viewer = viewer.launch_passive(
                model, data, show_left_ui=False, show_right_ui=False
            )
        except Exception as error:  # GLFW and GL raise errors of their own
            raise BackendError(f"no window: {error}") from error
        self._viewer.cam.distance, self._viewer.cam.azimuth = 3.0, 150.0
        self._viewer.cam.lookat[:] = 0.0, 0.0, 0.7

    def refresh(self) -> None:
        """Show the state as it is now."""
        if self._viewer.is_running():
            self._viewer.sync()

    def close(self) -> None:
        """Close the window."""
        self._viewer.close()


@kernel
def bound_command(
    position: FloatArray,
    stiffness: FloatArray,
    lower: FloatArray,
    upper: FloatArray,
    taken: Out[Matrix[FloatArray]],
) -> None:
    """Write (n,) positions within their limits [rad] and stiffnesses within 0..1 to the rows of ``taken``."""
    for j in range(len(position)):
        taken[0, j] = min(max(position[j], lower[j]), upper[j])
        taken[1, j] = min(max(stiffness[j], 0.0), 1.0)


RAMP_TIME = 1.0
"""[s] in which activation raises the stiffness from 0 to 1, and deactivation lowers it."""

_OWN_STATE = ("_seed", "_state", "_written", "_repeats", "wheel_stiffness")


@dataclass(frozen=True, kw_only=True)
class Snapshot:
    """The whole state of a simulated robot at the end of a cycle.

    Attributes:
        identity: Of the plant it belongs to.
        state: What each part of the simulation saved.
    """

    identity: str
    state: dict[str, Any]


class MujocoBackend(Serial, Backend):
    """A simulated Pepper, with the physics of its motors, gears, boards, wheels and battery.

    Same seed, same commands, same bits (on one kind of processor and one version of MuJoCo). Not simulated: contact
    of the robot with itself, sonar and laser.

    Attributes:
        wheel_stiffness: (3,) 0..1, fraction of its torque that each wheel's drive may use while the robot is active.
    """

    def __init__(
        self,
        robot: RobotConfig,
        plant: PlantConfig,
        *,
        world: World | None = None,
        seed: int = 0,
        posture: str = "Stand",
        window: bool = False,
        uri: str = "mujoco",
        parents: tuple[RobotIdentity, ...] = (),
    ) -> None:
        super().__init__()
        if window:
            check_display()
        self._robot = robot
        self._plant = plant
        self._seed = seed
        self._start = robot.posture(posture)
        self._world = world or load_world("empty")
        self._simulation = Simulation(robot, plant, self._world)
        self._simulation.reset(self._start)  # reports an object that collides now, not at ``open``
        self._model, self._data = self._simulation.model, self._simulation.data
        self._readings = Readings(robot, plant, self._simulation)
        self._commands = CommandDelayLine(plant)
        self._bound = bound_command.load()
        self._no_stiffness, self._no_speed = np.zeros(len(self._start)), np.zeros(3)
        self._state: Literal["closed", "open", "active"] = "closed"
        self.wheel_stiffness = np.ones(3)
        self._shown = window
        self._window: MujocoWindow | None = None
        self._truth = MujocoTruth(self._simulation)
        self._uri = uri
        self._info = BackendInfo(
            joint_names=robot.joint_names,
            cycle=robot.cycle,
            response_delay=plant.response_delay,
            capabilities=frozenset({"push", "grab", "seed", "truth"}),
            identity=plant_hash(plant, robot),
            name=plant.name,
            parents=parents,
        )

    @property
    def uri(self) -> str:
        """The URI it was asked for."""
        return self._uri

    @property
    def info(self) -> BackendInfo:
        """Facts about the simulated robot."""
        return self._info

    @property
    def plant(self) -> SimulatedPlant:
        """Identity of the simulated robot."""
        boards, plant = self._simulation.boards, self._plant
        friction = [plant.actuator(name).friction.contact for name in self._robot.joint_names]
        return SimulatedPlant(
            stiffness=boards.stiffness.copy(),
            torque_limit=boards.torque_limit.copy(),
            friction=np.array([part.motor + part.link for part in friction]),
            rolling=plant.base == "rolling",
            config=plant,
        )

    @property
    def truth(self) -> Truth:
        """Ground truth of the simulation."""
        return self._truth

    @serial
    def open(self) -> Measurement:
        """Put the robot into its starting posture, motors off, brakes on."""
        if self._state != "closed":
            raise BackendError(f"'{self.uri}' is already open")
        measurement = self._begin()
        if self._shown:
            self._window = MujocoWindow(self._model.mj, self._data)
        self._state = "open"
        return measurement

    @serial
    def reset(self, seed: int | None = None) -> Measurement:
        """Start again as ``open`` did, with another seed of the noise if one is given; not active afterwards."""
        self._check_open()
        if seed is not None:
            self._seed = seed
        self._state = "open"
        return self._begin()

    @serial
    def snapshot(self) -> Snapshot:
        """Return the state of simulation, sensors and noise, for :meth:`restore`."""
        self._check_open()
        own = {name: copy.deepcopy(getattr(self, name)) for name in _OWN_STATE}
        parts = {name: part.save() for name, part in self._parts().items()}
        return Snapshot(
            identity=self._info.identity, state={"self": own, "world": self._world, **parts}
        )

    @serial
    def restore(self, snapshot: Snapshot) -> None:
        """Return to a snapshot; from there on every bit is as before, given the same commands.

        Args:
            snapshot: Of this backend, or of another one with the same plant and world.

        Raises:
            BackendError: The snapshot is of another plant or world.
        """
        self._check_open()
        if snapshot.identity != self._info.identity:
            raise BackendError(
                f"the snapshot is of plant {snapshot.identity}, this one is {self._info.identity}"
            )
        if replace(snapshot.state["world"], source="") != replace(self._world, source=""):
            raise BackendError(
                f"the snapshot is of world '{snapshot.state['world'].name}', this one is '{self._world.name}'"
            )
        for name, part in self._parts().items():
            part.restore(snapshot.state[name])
        for name, value in snapshot.state["self"].items():
            setattr(self, name, copy.deepcopy(value))

    def _parts(self) -> dict[str, Resumable]:
        return {
            "simulation": self._simulation,
            "readings": self._readings,
            "commands": self._commands,
        }

    def _begin(self) -> Measurement:
        """Start simulation, sensors and noise."""
        self._simulation.reset(self._start, self._seed)
        self._commands.reset(self._start)
        self._write(self._start, np.zeros(len(self._start)), np.zeros(3))
        return self._readings.begin(self._seed)

    def _write(self, position: FloatArray, stiffness: FloatArray, wheel_speed: FloatArray) -> None:
        self._written = Command(position=position, stiffness=stiffness, wheel_speed=wheel_speed)
        self._repeats = 0

    @serial
    def activate(self) -> Measurement:
        """Ramp the stiffness to 1 in a second of simulated time, holding the posture last measured."""
        self._check_open()
        if self._state == "active":
            raise BackendError(f"'{self.uri}' is already active")
        hold = np.clip(self._readings.position, self._robot.lower, self._robot.upper)
        self._commands.reset(hold)
        self._state = "active"
        ticks = round(RAMP_TIME / self._robot.cycle)
        for tick in range(ticks):
            self._write(hold, np.full(len(hold), (tick + 1) / ticks), np.zeros(3))
            measurement = self.read()
        return measurement

    @serial
    def switch_on(self) -> None:
        """Be active without the ramp of :meth:`activate`: for a device manager, whose users raise the stiffness."""
        if self._state != "open":
            raise BackendError(f"'{self.uri}' cannot be switched on: it is {self._state}")
        # A command from before moves nothing.
        self._write(self._written.position, np.zeros(len(self._start)), np.zeros(3))
        self._state = "active"

    @serial
    def write(self, command: Command) -> None:
        """Take the command for the cycle that the next ``read`` simulates."""
        self._check_open()
        position, stiffness, wheel_speed = checked_command(command, len(self._start))
        taken = np.empty((2, len(position)))
        self._bound(position, stiffness, self._robot.lower, self._robot.upper, taken)  # as the DCM
        self._write(taken[0], taken[1], wheel_speed.copy())

    @serial
    def read(self) -> Measurement:
        """Simulate one cycle of 12 ms."""
        self._check_open()
        written, active = self._written, self._state == "active"
        rolls = active and self._repeats < DEAD_MAN_CYCLES
        self._repeats += 1
        self._simulation.cycle(
            self._commands.send(written.position),
            written.stiffness if active else self._no_stiffness,
            written.wheel_speed if rolls else self._no_speed,
            self.wheel_stiffness if active else self._no_speed,
        )
        if self._model.diverged(self._data):
            self._close()
            raise BackendError(
                f"the simulation diverged at {self._data.time:.3f} s and was closed: "
                "a force or a speed beyond all measure"
            )
        if self._window is not None:
            self._window.refresh()
        return self._readings.read()

    @serial
    def deactivate(self) -> None:
        """Wheels to zero, stiffness to 0 in a second of simulated time; the brakes then hold the legs."""
        if self._state != "active":
            return
        hold = self._written.position
        ticks = round(RAMP_TIME / self._robot.cycle)
        for tick in range(ticks):
            self._write(hold, np.full(len(hold), 1.0 - (tick + 1) / ticks), np.zeros(3))
            self.read()
        self._state = "open"

    @serial
    def close(self) -> None:
        """Deactivate and release the simulation."""
        self.deactivate()
        self._close()

    def _close(self) -> None:
        if self._window is not None:
            self._window.close()
            self._window = None
        self._state = "closed"

    @serial
    def schedule_push(self, push: Push) -> None:
        """Have a link pushed."""
        self._check_open()
        self._simulation.contacts.pushes.add(push)

    @serial
    def schedule_grab(self, grab: Grab) -> None:
        """Grab a link by a hand that acts as a spring."""
        self._check_open()
        self._simulation.contacts.grabs.add(grab)

    @serial
    def take_hand(
        self,
        link: str,
        point: ArrayLike | None = None,
        *,
        stiffness: float = Grab.stiffness,
        max_force: float = Grab.max_force,
        timeout: float = HAND_TIMEOUT,
    ) -> Hand:
        """Take a link in a hand that is moved later."""
        self._check_open()
        grab = Grab(
            link=link,
            pull=np.zeros(3),
            point=point,
            stiffness=stiffness,
            max_force=max_force,
            release=LIVE_RELEASE,
        )
        return self._simulation.contacts.grabs.take(grab, timeout, self._lock)

    def _check_open(self) -> None:
        if self._state == "closed":
            raise NotConnectedError(f"'{self.uri}' is not open")


def from_uri(uri: BackendUri, robot: RobotConfig) -> MujocoBackend:
    """``mujoco://?plant=NAME_OR_FILE&draw=N&day=N&world=NAME_OR_FILE&seed=N&posture=NAME&window=1``; all optional."""
    uri.check_keys({"plant", "draw", "day", "world", "seed", "posture", "window"}, host=False)
    if uri.query.get("window", "0") not in ("0", "1"):
        raise ConfigError(f"backend '{uri.text}': window takes 0 or 1")
    draw = uri.integer("draw", 0) if "draw" in uri.query else None
    day = uri.integer("day", 0) if "day" in uri.query else None
    plant = uri.query.get("plant", "nominal")
    return MujocoBackend(
        robot,
        load_plant(plant, robot, draw=draw, day=day),
        world=load_world(uri.query.get("world", "empty")),
        seed=uri.integer("seed", 0),
        posture=uri.query.get("posture", "Stand"),
        window=uri.integer("window", 0) == 1,
        uri=uri.text,
        parents=parent_plants(plant, robot, draw=draw, day=day),
    )
