"""A robot of a few services over the real library, to be made sick: what the driver asks before and after it moves."""

from __future__ import annotations

import threading
from dataclasses import replace
from functools import lru_cache
from types import TracebackType
from typing import Any, Self

from pepper_driver.backends.naoqi.address import Address, naoqi_address
from pepper_driver.backends.naoqi.connection import Connection, connect
from pepper_driver.backends.naoqi.qi_library import load_qi
from pepper_driver.backends.selection import parse_uri
from pepper_driver.config import load_naoqi_settings, load_robot
from support.virtual_time import Flag
from support.waiting import PATIENCE

ROBOT = load_robot()
NAMES = ROBOT.naoqi
PATIENT = replace(
    load_naoqi_settings(),
    connect_time=PATIENCE,
    probe_time=PATIENCE,
    call_time=PATIENCE,
    alive_time=PATIENCE,
    switch_time=PATIENCE,
    take_over_time=PATIENCE,
)
"""Settings of a driver that gives a busy machine the time it takes."""
CONSENT = "ALMotion::set{}Enabled\n\tthe owner of this robot has not allowed it"


def address_of(uri: str) -> Address:
    return naoqi_address(parse_uri(uri), {"mode", "wake"})


def key(name: str) -> str:
    return NAMES.prefix + name


def well() -> dict[str, Any]:
    """The memory of a healthy robot that stands."""
    memory: dict[str, Any] = {
        "RobotConfig/Body/Type": "Juliette",
        "Device/DeviceList/ChestBoard/BodyId": "body-7",
        key(NAMES.battery_charge): 0.8,
        key(NAMES.charging_flap): 0.0,
    }
    for joint, angle in zip(ROBOT.joint_names, ROBOT.posture("Stand"), strict=True):
        memory[key(NAMES.position.format(joint=joint))] = float(angle)
        memory[key(NAMES.temperature_status.format(joint=joint))] = 0.0
        memory[f"Diagnosis/Passive/{joint}/Error"] = 0
    return memory


class Memory:
    def __init__(self, values: dict[str, Any]) -> None:
        self.values = values

    def getData(self, name: str) -> Any:
        if name not in self.values:
            raise RuntimeError(f"ALMemory::getData\n\tcan't find a value for {name}")
        return self.values[name]

    def getListData(self, names: list[str]) -> list[Any]:
        return [self.values.get(name) for name in names]

    def getDataList(self, part: str) -> list[str]:
        return [name for name in self.values if part in name]


class Motion:
    """Awake or not; has protections that come on when it wakes up, some of which its owner must allow to be off."""

    def __init__(self, log: list[tuple[Any, ...]]) -> None:
        self.log = log
        self.on: dict[tuple[str, str | None], bool] = {}
        self.is_awake = True
        self.allowed = True
        self.stuck: set[str] = set()
        self.refuses: set[str] = set()
        self.may_answer: threading.Event | Flag = threading.Event()
        self.may_answer.set()
        self.commanded: list[float] = ROBOT.posture("Stand").tolist()
        self.stiffnesses: object = [1.0] * 14
        self.may_soften: threading.Event | Flag = threading.Event()
        self.may_soften.set()
        self.come_on()

    def come_on(self) -> None:
        for arm in ("LArm", "RArm"):
            self.on["CollisionProtection", arm] = True
            self.on["ExternalCollisionProtection", arm] = True
        self.on["ExternalCollisionProtection", "Move"] = True
        for name in ("FallManager", "PushRecovery", "SmartStiffness", "DiagnosisEffect"):
            self.on[name, None] = True

    def _set(self, name: str, chain: str | None, enable: bool) -> None:
        self.log.append((name, chain, enable))
        critical = name in ("FallManager", "PushRecovery") or chain == "Move"
        if (critical and not self.allowed and not enable) or name in self.refuses:
            raise RuntimeError(CONSENT.format(name))
        if name not in self.stuck:
            self.on[name, chain] = enable

    def robotIsWakeUp(self) -> bool:
        return self.is_awake

    def wakeUp(self) -> None:
        self.log.append(("wakeUp",))
        self.is_awake = "wakeUp" not in self.stuck
        self.come_on()

    def rest(self) -> None:
        self.log.append(("rest",))
        self.is_awake = "rest" in self.stuck

    def killAll(self) -> None:
        self.log.append(("killAll",))

    def getAngles(self, names: list[str], sensors: bool) -> list[float]:
        assert names == list(ROBOT.joint_names)
        self.may_answer.wait(30.0)
        return self.commanded

    def setAngles(self, names: list[str], angles: list[float], fraction: float) -> None:
        self.may_answer.wait(30.0)
        self.log.append(("setAngles", angles[0], fraction))

    def setStiffnesses(self, names: list[str], stiffnesses: list[float]) -> None:
        self.log.append(("setStiffnesses", len(names), stiffnesses[0]))
        self.may_soften.wait(30.0)
        self.stiffnesses = stiffnesses

    def getStiffnesses(self, names: list[str]) -> object:
        return self.stiffnesses

    def getBreathEnabled(self, chain: str) -> bool:
        return self.on.get(("Breath", chain), False)

    def setBreathEnabled(self, chain: str, enable: bool) -> None:
        self._set("Breath", chain, enable)

    def getIdlePostureEnabled(self, chain: str) -> bool:
        return self.on.get(("IdlePosture", chain), False)

    def setIdlePostureEnabled(self, chain: str, enable: bool) -> None:
        self._set("IdlePosture", chain, enable)

    def getCollisionProtectionEnabled(self, chain: str) -> bool:
        return self.on["CollisionProtection", chain]

    def setCollisionProtectionEnabled(self, chain: str, enable: bool) -> bool:
        self._set("CollisionProtection", chain, enable)
        return True

    def getExternalCollisionProtectionEnabled(self, chain: str) -> bool:
        return self.on["ExternalCollisionProtection", chain]

    def setExternalCollisionProtectionEnabled(self, chain: str, enable: bool) -> None:
        self._set("ExternalCollisionProtection", chain, enable)

    def getFallManagerEnabled(self) -> bool:
        return self.on["FallManager", None]

    def setFallManagerEnabled(self, enable: bool) -> None:
        self._set("FallManager", None, enable)

    def getPushRecoveryEnabled(self) -> bool:
        return self.on["PushRecovery", None]

    def setPushRecoveryEnabled(self, enable: bool) -> None:
        self._set("PushRecovery", None, enable)

    def getSmartStiffnessEnabled(self) -> bool:
        return self.on["SmartStiffness", None]

    def setSmartStiffnessEnabled(self, enable: bool) -> None:
        self._set("SmartStiffness", None, enable)

    def getDiagnosisEffectEnabled(self) -> bool:
        return self.on["DiagnosisEffect", None]

    def setDiagnosisEffectEnabled(self, enable: bool) -> None:
        self._set("DiagnosisEffect", None, enable)


class Life:
    def __init__(self, log: list[tuple[Any, ...]], motion: Motion) -> None:
        self.log, self.motion = log, motion
        self.state = "solitary"
        self.stays = False
        self.lies_down = False

    def getState(self) -> str:
        return self.state

    def setState(self, state: str) -> None:
        self.log.append(("life", state))
        self.state = self.state if self.stays else state
        if state == "disabled" and self.lies_down:
            self.motion.is_awake = False


class Diagnosis:
    def __init__(self) -> None:
        self.passive: list[Any] = []
        self.active: list[Any] = []

    def getPassiveDiagnosis(self) -> list[Any]:
        return self.passive

    def getActiveDiagnosis(self) -> list[Any]:
        return self.active


class System:
    def systemVersion(self) -> str:
        return "2.5.10.7"


class Model:
    def __init__(self) -> None:
        self.kind = "Juliette"

    def getRobotType(self) -> str:
        return self.kind


class Touch:
    def __init__(self, log: list[tuple[Any, ...]]) -> None:
        self.log = log

    def exit(self) -> None:
        self.log.append(("touch", "exit"))


class Launcher:
    def __init__(self, log: list[tuple[Any, ...]]) -> None:
        self.log = log

    def launchLocal(self, name: str) -> list[str]:
        self.log.append(("launch", name))
        return [name]


class Speech:
    """Takes its time, as a voice does: speaks until ``may_end``."""

    def __init__(self, log: list[tuple[Any, ...]]) -> None:
        self.log = log
        self.may_end = threading.Event()
        self.may_end.set()
        self.mute = False

    def say(self, text: str) -> None:
        self.may_end.wait(30.0)
        if self.mute:
            raise RuntimeError("ALTextToSpeech::say\n\tno voice")
        self.log.append(("say", text))


class Leds:
    def __init__(self, log: list[tuple[Any, ...]]) -> None:
        self.log = log

    def fadeRGB(self, group: str, red: float, green: float, blue: float, seconds: float) -> None:
        self.log.append(("fadeRGB", group, red, green, blue, seconds))

    def fade(self, group: str, brightness: float, seconds: float) -> None:
        self.log.append(("fade", group, brightness, seconds))


class Tablet:
    def __init__(self, log: list[tuple[Any, ...]]) -> None:
        self.log = log

    def showImage(self, url: str) -> bool:
        self.log.append(("showImage", url))
        return url.startswith("http://198.18.0.1/")

    def hideImage(self) -> None:
        self.log.append(("hideImage",))


class Posture:
    def __init__(self, log: list[tuple[Any, ...]]) -> None:
        self.log = log

    def goToPosture(self, name: str, speed: float) -> bool:
        self.log.append(("goToPosture", name, speed))
        return name == "Stand"


class Dcm:
    def getTime(self, offset: int) -> int:
        return 0


@lru_cache(maxsize=1)
def _server() -> Any:
    """The one server of this process, kept to its end: libqi does not bear many that come and go."""
    session = load_qi().Session()
    session.listenStandalone("tcp://127.0.0.1:0")
    return session


class FakeRobot:
    """All of it, on a free port of this computer; one at a time."""

    def __init__(self, *, without: tuple[str, ...] = ()) -> None:
        self.log: list[tuple[Any, ...]] = []
        self.memory = well()
        self.motion = Motion(self.log)
        self.life = Life(self.log, self.motion)
        self.diagnosis = Diagnosis()
        self.model = Model()
        self.speech = Speech(self.log)
        services = {
            "ALMemory": Memory(self.memory),
            "ALMotion": self.motion,
            "ALAutonomousLife": self.life,
            "ALDiagnosis": self.diagnosis,
            "ALSystem": System(),
            "ALRobotModel": self.model,
            "ALTouch": Touch(self.log),
            "ALLauncher": Launcher(self.log),
            "DCM": Dcm(),
            "ALTextToSpeech": self.speech,
            "ALLeds": Leds(self.log),
            "ALTabletService": Tablet(self.log),
            "ALRobotPosture": Posture(self.log),
        }
        self._services = {name: services[name] for name in services if name not in without}
        self._numbers: list[int] = []
        self.port = int(_server().endpoints()[-1].rpartition(":")[2])

    @property
    def uri(self) -> str:
        return f"naoqi://127.0.0.1:{self.port}"

    @property
    def address(self) -> Address:
        return address_of(self.uri)

    def connect(self) -> Connection:
        """Connect with it, as patiently as a busy machine asks for."""
        return connect(self.address, settings=PATIENT)

    def __enter__(self) -> Self:
        self._numbers = [_server().registerService(*service) for service in self._services.items()]
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        for number in self._numbers:
            _server().unregisterService(number)
