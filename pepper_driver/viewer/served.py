"""A robot that is served by the stand-in NAOqi, for a page: what it does, and hands on it.

No controller and no observer run here. Measurements and commands are those that the connected programs read and send;
poses and forces are the truth of the simulation.
"""

from __future__ import annotations

import threading
from collections.abc import Mapping

import numpy as np
from numpy.typing import ArrayLike

from pepper_driver.backends import BackendError, Grab, Measurement
from pepper_driver.backends.fields import Command
from pepper_driver.backends.naoqi.memory_keys import VALUES, Alias, SensorKeys, actuator_keys
from pepper_driver.backends.naoqi_server.ipc import RobotClient
from pepper_driver.config import RobotConfig
from pepper_driver.config.arrays import FloatArray
from pepper_driver.config.contact_specs import Axes
from pepper_driver.controller import Reference
from pepper_driver.log.schema import TickRow, unobserved
from pepper_driver.steady_hand import SteadyHand
from pepper_driver.telemetry import TelemetryServer

PICTURE_PERIOD = 0.036
"""[s] between two looks at the robot: every third cycle, as of a robot that runs here."""


class ServedRobot:
    """Streams a served robot, and touches it.

    Args:
        client: The robot, past NAOqi.
        robot: Its description.
        url: Where it is served, for the page.

    Attributes:
        config: The description.
    """

    def __init__(self, client: RobotClient, robot: RobotConfig, url: str) -> None:
        self._client, self.config, self._url = client, robot, url
        self._scene = client.look()
        self._sensors = SensorKeys(robot)
        actuators = actuator_keys(robot)
        keys = client.keys
        self._measured = [keys[name] for name in self._sensors.names]
        self._commanded = {
            alias: [keys[name] for name in actuators[alias]]
            for alias in (Alias.POSITION, Alias.STIFFNESS, Alias.WHEEL_SPEED)
        }
        self._unobserved, nothing = unobserved(robot), np.full(len(robot.joints), np.nan)
        self._reference = Reference(
            position=nothing,
            velocity=nothing,
            acceleration=nothing,
            load_torque=nothing,
            base_twist=np.full(3, np.nan),
        )
        self._nowhere = np.zeros(len(robot.joints), dtype=np.bool_)
        self._problem = ""
        self._closing = threading.Event()
        self._thread: threading.Thread | None = None

    # -- the stream -----------------------------------------------------------------------------------------------

    def stream_to(self, telemetry: TelemetryServer) -> None:
        """Begin to stream to those who listen to ``telemetry``, on a thread of its own until it is closed."""
        info = self._client.info
        run = {
            "backend": self._url,
            "robot": self.config.name,
            "identity": str(info["identity"]),
            "simulation": str(info["uri"]),
        }
        telemetry.begin(None, self.config, run, self._status)
        self._thread = threading.Thread(
            target=self._stream, args=(telemetry,), name="pepper_driver.served", daemon=True
        )
        self._thread.start()

    def _stream(self, telemetry: TelemetryServer) -> None:
        while not self._closing.wait(PICTURE_PERIOD):
            try:
                self._scene = scene = self._client.look()
                row = self._row()
            except BackendError as error:  # it is held up, or has ended: then who serves it says so
                self._problem = str(error)
                continue
            self._problem = ""
            if row is not None:
                telemetry.show(row, base=scene.base, tilt=scene.tilt, forces=scene.contacts)

    def _row(self) -> TickRow | None:
        """Return the newest sample and command as a row of a log; None while the sample is none."""
        values = np.array(self._client.values())
        sample = self._sensors.values(values[self._measured].tolist())
        if isinstance(sample, str):
            self._problem = sample
            return None
        cycle = int(self._client.black_box(1).cycle[-1])
        measurement = Measurement(
            time=cycle * self.config.cycle,
            tick=cycle,
            age=0.0,
            **{name: getattr(sample, name) for name in VALUES},
        )
        sent = Command(
            position=values[self._commanded[Alias.POSITION]],
            stiffness=values[self._commanded[Alias.STIFFNESS]],
            wheel_speed=values[self._commanded[Alias.WHEEL_SPEED]],
        )
        return TickRow(
            measurement, self._reference, sent, self._nowhere, self._unobserved, 0, np.nan, 0
        )

    def _status(self) -> Mapping[str, object]:
        return {"state": self._problem or "served", "fault": ""}

    def close(self) -> None:
        """End the stream. Does nothing when closed."""
        self._closing.set()
        if self._thread is not None:
            self._thread.join()

    # -- hands ----------------------------------------------------------------------------------------------------

    @property
    def position(self) -> FloatArray:
        """(17,) true joint positions [rad], as last seen."""
        return self._scene.position

    @property
    def base(self) -> FloatArray:
        """(3,) true x, y [m], yaw [rad] of the base, as last seen."""
        return self._scene.base

    def push(
        self,
        link: str,
        force: ArrayLike,
        point: ArrayLike | None = None,
        *,
        duration: float,
        frame: Axes = "world",
        rise: float,
    ) -> None:
        """Push a link; see :meth:`pepper_driver.Pepper.push`."""
        self._client.push(
            link=link,
            force=np.asarray(force, dtype=np.float64).tolist(),
            point=None if point is None else np.asarray(point, dtype=np.float64).tolist(),
            duration=duration,
            frame=frame,
            rise=rise,
        )

    def take_hand(
        self, link: str, point: ArrayLike | None = None, *, stiffness: float = Grab.stiffness
    ) -> SteadyHand:
        """Take a link in a hand; see :meth:`pepper_driver.Pepper.take_hand`."""
        hand = self._client.take_hand(link, point, stiffness=stiffness, max_force=Grab.max_force)
        stance = self if self._client.info["rolling"] else None
        return SteadyHand(hand, stance, self.config, max_force=Grab.max_force)
