"""The services that the stand-in offers, by name."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from pepper_driver.backends.naoqi_server.context import Context
from pepper_driver.backends.naoqi_server.dcm_service import DcmService
from pepper_driver.backends.naoqi_server.memory_service import MemoryService
from pepper_driver.backends.naoqi_server.modules.audio import AudioService, LogManagerService
from pepper_driver.backends.naoqi_server.modules.cameras import VideoService
from pepper_driver.backends.naoqi_server.modules.diagnosis import DiagnosisService
from pepper_driver.backends.naoqi_server.modules.leds import LedsService
from pepper_driver.backends.naoqi_server.modules.life import (
    AwarenessService,
    BackgroundMovementService,
    BlinkingService,
    LifeService,
    ListeningMovementService,
    SpeakingMovementService,
)
from pepper_driver.backends.naoqi_server.modules.motion import MotionService
from pepper_driver.backends.naoqi_server.modules.posture import PostureService
from pepper_driver.backends.naoqi_server.modules.speech import AnimatedSpeechService, SpeechService
from pepper_driver.backends.naoqi_server.modules.system import (
    BatteryService,
    BodyTemperatureService,
    LauncherService,
    RobotModelService,
    SonarService,
    SystemService,
)
from pepper_driver.backends.naoqi_server.modules.tablet import TabletService
from pepper_driver.backends.naoqi_server.modules.touch import TouchService
from pepper_driver.backends.naoqi_server.stand_in_service import StandInService

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
