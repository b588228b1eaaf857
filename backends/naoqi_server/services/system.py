"""ALSystem, battery, temperature, sonar, diagnosis, touch, and the service of the stand-in itself.

The service ``ALTouch``; NAOqi 2.8 page "ALTouch API".
"""

from __future__ import annotations

import socket
from dataclasses import asdict
from typing import Any
from xml.sax.saxutils import quoteattr

from pepper_driver.backends.naoqi_server.almotion.kinematics import CallError
from pepper_driver.backends.naoqi_server.services.calls import named
from pepper_driver.backends.naoqi_server.services.context import Context, switch

TEMPERATURE_LEVELS = ("NORMAL", "HIGH", "VERY HIGH", "CRITICAL")


class SystemService:
    """``ALSystem``; NAOqi 2.8 page "ALSystem API"."""

    def __init__(self, context: Context) -> None:
        self._memory = context.memory
        self._version = context.shared.version
        self._name = context.shared.settings.robot_name
        self._zone = "UTC"

    def systemVersion(self) -> str:
        """Return the version of NAOqi."""
        return self._version

    def robotName(self) -> str:
        """Name of the robot."""
        return self._name

    def setRobotName(self, name: object) -> bool:
        """Give it another."""
        self._name = str(name)
        self._memory.raise_event("ALSystem/RobotNameChanged", self._name)
        return True

    def timezone(self) -> str:
        """Its time zone."""
        return self._zone

    def setTimezone(self, zone: object) -> bool:
        """Another one; only kept."""
        self._zone = str(zone)
        return True

    def previousSystemVersion(self) -> str:
        """Empty: it was not updated."""
        return ""


class BatteryService:
    """``ALBattery``; NAOqi 2.8 page "ALBattery API". The robot is never plugged in."""

    def __init__(self, context: Context) -> None:
        self._robot = context.robot
        self._key = context.config.naoqi.prefix + context.config.naoqi.battery_charge
        self._hatch = context.config.naoqi.prefix + "Platform/ILS/Sensor/Value"
        self._memory = context.memory
        self._notified: dict[str, object] = {}
        self._monitored = True
        self._memory.insert("BatteryPowerPluggedChanged", False)
        self._memory.insert("BatteryChargingFlagChanged", False)
        self._memory.insert("BatteryFullChargedFlagChanged", False)
        context.shared.motion.on_cycle.append(self._notify)

    def getBatteryCharge(self) -> int:
        """Return the charge of the battery [%]."""
        return round(100 * self._robot.value(self._key))

    def enablePowerMonitoring(self, enable: object) -> None:
        """Set if it raises its events."""
        self._monitored = switch(enable, "ALBattery::enablePowerMonitoring")

    def _notify(self) -> None:
        now = {
            "BatteryChargeChanged": self.getBatteryCharge(),
            "BatteryTrapIsOpen": self._robot.value(self._hatch) > 0,
        }
        for event, value in now.items():
            if self._monitored and self._notified.get(event) != value:
                self._notified[event] = value
                self._memory.raise_event(event, value)


class BodyTemperatureService:
    """``ALBodyTemperature``; NAOqi 2.8 page "ALBodyTemperature API"."""

    def __init__(self, context: Context) -> None:
        names, config = context.config.naoqi, context.config
        self._robot = context.robot
        self._status = {
            joint: names.prefix + f"{joint}/Temperature/Sensor/Status"
            for joint in config.joint_names
        }
        self._notifies = True

    def setEnableNotifications(self, enable: object) -> None:
        """Set if it warns by itself. It never does; it is only kept."""
        self._notifies = switch(enable, "ALBodyTemperature::setEnableNotifications")

    def areNotificationsEnabled(self) -> bool:
        """Return the value that was set."""
        return self._notifies

    def getTemperatureDiagnosis(self) -> list[object]:
        """Return the worst level, 0 to 3, and the joints that have it; empty while all is well."""
        levels = {joint: int(self._robot.value(key)) for joint, key in self._status.items()}
        worst = max(levels.values())
        return [worst, [j for j, level in levels.items() if level == worst]] if worst else []


class LauncherService:
    """``ALLauncher``."""

    def __init__(self, context: Context) -> None:
        self._offered = context.services

    def isModulePresent(self, name: object) -> bool:
        """Return true if a module runs."""
        return name in self._offered()

    def getGlobalModuleList(self) -> list[str]:
        """Modules that run."""
        return sorted(self._offered())

    def launchLocal(self, name: object) -> list[str]:
        """Modules cannot be loaded here."""
        raise CallError("ALLauncher::launchLocal", f"{name}: the stand-in loads no modules")


class SonarService:
    """``ALSonar``: the values of its two sonars are always in ALMemory; nothing is ever near."""

    def __init__(self, context: Context) -> None:
        self._subscribers: set[str] = set()

    def subscribe(self, name: object, *options: object) -> None:
        """Begin to measure."""
        self._subscribers.add(str(name))

    def unsubscribe(self, name: object) -> None:
        """End it."""
        self._subscribers.discard(str(name))

    def getSubscribersInfo(self) -> list[list[object]]:
        """Name, period [ms] and precision of each who measures."""
        return [[name, 12, 0.0] for name in sorted(self._subscribers)]


class RobotModelService:
    """``ALRobotModel``: what the robot has."""

    def __init__(self, context: Context) -> None:
        self._memory = context.memory
        self._kind = str(context.memory.get("RobotConfig/Body/Type"))
        self._head = str(context.memory.get("RobotConfig/Head/BaseVersion"))
        self._body = str(context.memory.get("RobotConfig/Body/BaseVersion"))

    def getRobotType(self) -> str:
        """Juliette is Pepper."""
        return self._kind

    def hasLegs(self) -> bool:
        """No."""
        return False

    def hasWheels(self) -> bool:
        """Yes."""
        return True

    def hasArms(self) -> bool:
        """Yes."""
        return True

    def hasHands(self) -> bool:
        """Yes."""
        return True

    def getConfig(self) -> str:
        """XML with the versions of its parts."""
        lines = [
            f'  <Preference memoryName={quoteattr(key)} value={quoteattr(value)} type="string"/>'
            for key, value in self._config().items()
        ]
        return "\n".join(["<ModulePreference>", *lines, "</ModulePreference>"])

    @named("_getMicrophoneConfig")
    def _getMicrophoneConfig(self) -> int:
        """Version of the microphones; naoqi_driver asks for it."""
        return 0

    @named("_getConfigMap")
    def _getConfigMap(self) -> dict[str, str]:
        """Versions by key; naoqi_driver asks for it on NAOqi 2.9."""
        return self._config()

    def _config(self) -> dict[str, str]:
        return {
            "RobotConfig/Body/Type": self._kind,
            "RobotConfig/Head/Version": self._head,
            "RobotConfig/Body/Version": self._body,
            "RobotConfig/Body/Device/LeftArm/Version": self._body,
            "RobotConfig/Head/Device/Micro/Version": "0",
            "RobotConfig/Head/HostName": socket.gethostname(),
        }


KINDS = ("Passive", "Active", "Temperature")

SERIOUS, CRITICAL = 1, 2
"""Levels of failure: what is broken stays soft, or the whole robot has to rest."""


class DiagnosisService:
    """``ALDiagnosis``; NAOqi 2.8 pages "ALDiagnosis API" and "Diagnosis effect", 2.0 page "Actuator & Sensor list".

    Its keys ``Diagnosis/KIND/DEVICE/Error`` are 0 until a client writes another value into ALMemory: the stand-in does
    not check itself.
    """

    def __init__(self, context: Context) -> None:
        self._memory = context.memory
        legs = (*context.config.chains["legs"], *context.config.wheels.names)
        self._levels = {
            device: CRITICAL if device in legs else SERIOUS
            for device in (*context.config.joint_names, *context.config.wheels.names)
        }
        for kind in KINDS:
            for device in self._levels:
                context.memory.insert(_key(kind, device), 0)

    def getPassiveDiagnosis(self) -> list[object]:
        """Return the highest level of failure, and the devices that have it; empty while all is well."""
        return self._summary("Passive")

    def getActiveDiagnosis(self) -> list[object]:
        """Return the same, of the test at waking up."""
        return self._summary("Active")

    def _summary(self, kind: str) -> list[object]:
        broken = {
            device: level
            for device, level in self._levels.items()
            if self._memory.get(_key(kind, device))
        }
        worst = max(broken.values(), default=0)
        # Only the gravest level, as on the page "ALDiagnosis API".
        return [worst, [device for device in broken if broken[device] == worst]] if broken else []


def _key(kind: str, device: str) -> str:
    return f"Diagnosis/{kind}/{device}/Error"


class TouchService:
    """Touch sensors and bumpers. Its events stop when it is ended; joints are not among its sensors here."""

    def __init__(self, context: Context) -> None:
        self._events = context.events

    def getSensorList(self) -> list[str]:
        """Names of the sensors, as events have them."""
        return list(self._events.touched)

    def getStatus(self) -> list[list[object]]:
        """``[name, whether it is touched]`` of each."""
        return [[name, touched] for name, touched in self._events.touched.items()]

    def exit(self) -> None:
        """End the module: no events of touch any more."""
        self._events.on = False


class StandInService:
    """Pushes, faults and truth of the simulated robot."""

    def __init__(self, context: Context) -> None:
        self._robot, self._faults = context.robot, context.faults
        self._record = context.shared.record

    def info(self) -> dict[str, Any]:
        """Return the description: ``identity``, ``plant``, ``parents``, ``uri``, ``response_delay``, ``pid``, ..."""
        return dict(self._robot.info)

    def push(self, arguments: dict[str, Any]) -> None:
        """Push a link; arguments of ``Backend.push`` by name."""
        self._robot.push(**arguments)

    def grab(self, arguments: dict[str, Any]) -> None:
        """Take a link in a springy hand; arguments of ``Backend.grab`` by name."""
        self._robot.grab(**arguments)

    def setFault(self, name: str, arguments: dict[str, Any]) -> None:
        """Inject a fault: a name of ``faults.FAULTS``, and its arguments by name."""
        self._faults.set(name, arguments)

    def clearFaults(self) -> None:
        """End all faults that can end."""
        self._faults.clear()

    def record(self) -> list[list[Any]]:
        """Return what was said and shown: ``[seconds since the start, service, method, [arguments]]``, oldest first."""
        return self._record.entries

    def blackBox(self, last: int) -> dict[str, Any]:
        """Return the truth of the ``last`` cycles: lists by name, see ``BlackBox``."""
        return {name: rows.tolist() for name, rows in asdict(self._robot.black_box(last)).items()}
