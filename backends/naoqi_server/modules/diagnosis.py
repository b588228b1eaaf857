"""What the stand-in robot itself finds broken."""

from __future__ import annotations

from pepper_driver.backends.naoqi_server.context import Context

KINDS = ("Passive", "Active", "Temperature")

SERIOUS, CRITICAL = 1, 2
"""Levels of failure: what is broken stays soft, or the whole robot has to rest."""


class DiagnosisService:
    """``ALDiagnosis``; NAOqi 2.8 pages "ALDiagnosis API" and "Diagnosis effect", 2.0 page "Actuator & Sensor list".

    Its keys ``Diagnosis/KIND/DEVICE/Error`` are 0 until somebody writes something else into ALMemory: the stand-in does
    not look at itself.
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
        """The highest level of failure, and the devices that have it; empty while all is well."""
        return self._summary("Passive")

    def getActiveDiagnosis(self) -> list[object]:
        """The same, of the test at waking up."""
        return self._summary("Active")

    def _summary(self, kind: str) -> list[object]:
        broken = {
            device: level
            for device, level in self._levels.items()
            if self._memory.get(_key(kind, device))
        }
        worst = max(broken.values(), default=0)
        return [worst, [device for device in broken if broken[device] == worst]] if broken else []


def _key(kind: str, device: str) -> str:
    return f"Diagnosis/{kind}/{device}/Error"
