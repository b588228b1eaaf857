"""Process of NAOqi: the services that clients see.

Started by ``launch.StandIn``. It ends on request, and when its parent process has ended.
"""

from __future__ import annotations

import argparse
import json
import os
import select
import signal
import socket
import sys
from collections.abc import Callable, Collection
from contextlib import suppress
from typing import Any

import qi

from pepper_driver.backends.interface import BackendError
from pepper_driver.backends.naoqi_server.faults import make_fault
from pepper_driver.backends.naoqi_server.ipc import Robot, RobotClient, send
from pepper_driver.backends.naoqi_server.memory import Memory, SensorEvents
from pepper_driver.backends.naoqi_server.service_faults import FaultRouter
from pepper_driver.backends.naoqi_server.services.calls import make_front
from pepper_driver.backends.naoqi_server.services.context import Context, Shared
from pepper_driver.backends.naoqi_server.services.dcm_memory import DcmService, MemoryService
from pepper_driver.backends.naoqi_server.services.leds import LedsService
from pepper_driver.backends.naoqi_server.services.life import (
    AwarenessService,
    BackgroundMovementService,
    BlinkingService,
    LifeService,
    ListeningMovementService,
    PostureService,
    SpeakingMovementService,
)
from pepper_driver.backends.naoqi_server.services.media import TabletService, VideoService
from pepper_driver.backends.naoqi_server.services.motion import MotionService
from pepper_driver.backends.naoqi_server.services.speech import (
    AnimatedSpeechService,
    AudioService,
    LogManagerService,
    SpeechService,
)
from pepper_driver.backends.naoqi_server.services.system import (
    BatteryService,
    BodyTemperatureService,
    DiagnosisService,
    LauncherService,
    RobotModelService,
    SonarService,
    StandInService,
    SystemService,
    TouchService,
)
from pepper_driver.backends.naoqi_server.shared_values import Table, table_keys
from pepper_driver.config import PepperError, UnknownNameError, load_robot
from pepper_driver.config.clock import MONOTONIC_CLOCK, Clock
from pepper_driver.config.naoqi_devices import load_naoqi_devices

SERVICES: dict[str, Callable[[Context], Any]] = {
    "DCM": DcmService,
    "ALMemory": MemoryService,
    "StandIn": StandInService,
    "ALMotion": MotionService,
    "ALRobotPosture": PostureService,
    "ALAutonomousLife": LifeService,
    "ALBasicAwareness": AwarenessService,
    "ALBackgroundMovement": BackgroundMovementService,
    "ALAutonomousBlinking": BlinkingService,
    "ALSpeakingMovement": SpeakingMovementService,
    "ALListeningMovement": ListeningMovementService,
    "ALDiagnosis": DiagnosisService,
    "ALTouch": TouchService,
    "ALLeds": LedsService,
    "ALTextToSpeech": SpeechService,
    "ALAnimatedSpeech": AnimatedSpeechService,
    "ALTabletService": TabletService,
    "ALSystem": SystemService,
    "ALBattery": BatteryService,
    "ALBodyTemperature": BodyTemperatureService,
    "ALLauncher": LauncherService,
    "ALSonar": SonarService,
    "ALRobotModel": RobotModelService,
    "ALVideoDevice": VideoService,
    "ALAudioDevice": AudioService,
    "LogManager": LogManagerService,
}
"""One line each. All public methods of the class can be called by clients."""


os.environ.setdefault("QI_LOG_LEVEL", "0")  # libqi logs to stdout


def make_context(
    robot: Robot,
    faults: FaultRouter,
    *,
    consent: bool,
    version: str,
    services: Callable[[], Collection[str]],
    call: Callable[..., Any],
    clock: Clock = MONOTONIC_CLOCK,
) -> Context:
    """Return the common objects of the services of a NAOqi.

    Args:
        robot: Its robot.
        faults: Receives the injected faults.
        consent: True if the owner of the robot allows safety reflexes to be switched off.
        version: Of NAOqi; "" for that of ``naoqi_services.yaml``.
        services: Names of the services that clients see.
        call: ``call(service, method, *arguments)`` calls a service without waiting for it.
        clock: Time of all that takes time.
    """
    config = load_robot()
    devices = load_naoqi_devices(config)
    data = {**devices.texts, devices.body_id: robot.info["identity"]}
    memory = Memory(robot, config.naoqi.time, data)
    return Context(
        robot=robot,
        memory=memory,
        config=config,
        events=SensorEvents(robot, memory, devices, clock),
        faults=faults,
        shared=Shared(robot, memory, config, consent=consent, version=version, clock=clock),
        services=services,
        call=call,
        clock=clock,
    )


def make_services(context: Context) -> dict[str, object]:
    """Return the services, as clients see them, by name."""
    return {
        name: make_front(name, service(context), context.faults.services)
        for name, service in SERVICES.items()
    }


class NaoqiServer:
    """The session and its services.

    Args:
        robot: Connection to the robot process.
        host: Address to listen at.
        port: And the port; 0 for a free one.
        owner: Connection to the parent process; this process ends with it.
        consent: True if the owner of the robot allows safety reflexes to be switched off.
        version: Of NAOqi; "" for that of ``naoqi_services.yaml``.

    Attributes:
        faults: Receives the injected faults.
    """

    def __init__(
        self,
        robot: RobotClient,
        host: str,
        port: int,
        owner: socket.socket,
        *,
        consent: bool,
        version: str,
    ) -> None:
        self._session = qi.Session()
        context = make_context(
            robot,
            FaultRouter(robot, owner, self._offer, _end),
            consent=consent,
            version=version,
            services=lambda: self._offered,
            call=self._call,
        )
        # Clients are admitted once everything is registered; a session that does not listen has no services.
        self._session.listenStandalone("tcp://127.0.0.1:0")
        self.faults = context.faults
        self._services = make_services(context)
        self._offered: dict[str, int] = {}  # number by name
        for name in self._services:
            self._offer(name, True)
        context.start()
        try:
            self._session.listen(f"tcp://{host}:{port}")
        except RuntimeError as error:
            reason = str(error).partition(" [")[0].rpartition(": ")[2]
            raise BackendError(
                f"cannot listen at tcp://{host}:{port}: {reason}; choose another port or host"
            ) from error

    @property
    def port(self) -> int:
        """The port."""
        return int(self._session.endpoints()[-1].rpartition(":")[2])

    def _offer(self, name: str, there: bool) -> None:
        """Register a service for clients, or unregister it."""
        if name not in self._services:
            raise UnknownNameError("service", name, self._services)
        if there and name not in self._offered:
            self._offered[name] = self._session.registerService(name, self._services[name])
        elif not there and name in self._offered:
            self._session.unregisterService(self._offered.pop(name))

    def _call(self, service: str, method: str, *arguments: object) -> None:
        """Call a service of any provider, without waiting for it; failures are ignored."""

        def made(future: qi.Future) -> None:
            if not future.hasError():
                future.value().call(method, *arguments, _async=True)

        self._session.service(service, _async=True).addCallback(made)


def main(arguments: list[str]) -> int:
    """Entry of the process; reports in one message to its parent at which port it listens, or why not."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--host", required=True)
    parser.add_argument("--port", type=int, required=True)
    parser.add_argument("--consent", type=int, choices=(0, 1), required=True)
    parser.add_argument("--version", required=True)
    for name in ("--table", "--owner", "--robot"):
        parser.add_argument(name, type=int, required=True, metavar="DESCRIPTOR")
    parser.add_argument("--faults", type=json.loads, default=[])
    given = parser.parse_args(arguments)
    signal.signal(
        signal.SIGINT, signal.SIG_IGN
    )  # handled by the parent process, which then ends us
    owner, robot = socket.socket(fileno=given.owner), socket.socket(fileno=given.robot)
    # A robot's computer has no other work. Before threads are made: they inherit the priority of their creator.
    with suppress(OSError, AttributeError):
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(20))
    config = load_robot()
    devices = load_naoqi_devices(config)
    keys = table_keys(config, devices)
    table = Table(given.table, len(keys), config)
    while not table.count:  # the robot starts at the same time
        if select.select([owner], [], [], 0.01)[0]:
            return 1
    try:
        link = RobotClient(table, robot, keys, frozenset(devices.actuators))
        server = NaoqiServer(
            link,
            given.host,
            given.port,
            owner,
            consent=bool(given.consent),
            version=given.version,
        )
        link.ask("know_naoqi", pid=os.getpid())
        for fault in given.faults:
            server.faults.set_service_fault(make_fault(**fault))
    except PepperError as error:
        send(owner, {"error": str(error)})
        return 1
    send(owner, {"ready": {"pid": os.getpid(), "port": server.port}})
    while True:
        signal.pause()  # ``_end`` ends it


def _end() -> None:
    os._exit(0)  # qi's own threads may be in the middle of a call


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
