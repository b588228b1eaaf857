"""The services that the stand-in offers, by name."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from pepper_driver.backends.naoqi_server.context import Context
from pepper_driver.backends.naoqi_server.dcm_service import DcmService
from pepper_driver.backends.naoqi_server.memory_service import MemoryService
from pepper_driver.backends.naoqi_server.stand_in_service import StandInService

SERVICES: dict[str, Callable[[Context], Any]] = {
    "DCM": DcmService,
    "ALMemory": MemoryService,
    "StandIn": StandInService,
}
"""One line each. All public methods of the class can be called by clients."""
