"""What the services of this package share with each other, beside what all services are given."""

from __future__ import annotations

from pepper_driver.backends.naoqi_server.memory import Memory
from pepper_driver.backends.naoqi_server.modules.calls import Record
from pepper_driver.backends.naoqi_server.modules.voice import Voice
from pepper_driver.backends.naoqi_server.motion.abilities import Life
from pepper_driver.backends.naoqi_server.motion.engine import Motion
from pepper_driver.backends.naoqi_server.motion.postures import Postures
from pepper_driver.backends.naoqi_server.motion.waking import Waking
from pepper_driver.backends.naoqi_server.robot import Robot
from pepper_driver.config import RobotConfig, load_naoqi_services


class Shared:
    """Made once by the server. The writer of ALMotion begins with :meth:`start`.

    Args:
        robot: The robot.
        memory: What ALMemory holds.
        config: What the robot is.
        consent: Whether its owner lets safety reflexes be switched off.
        version: Of NAOqi, as ``ALSystem.systemVersion`` tells it; "" for that of the settings.

    Attributes:
        settings: Of the services.
        motion: What ALMotion commands.
        postures: Ways to postures.
        waking: Motors on and off.
        life: Its state and abilities.
        record: What was done that nobody can see.
        voice: That all services speak with.
        version: Of NAOqi.
    """

    def __init__(
        self,
        robot: Robot,
        memory: Memory,
        config: RobotConfig,
        *,
        consent: bool = False,
        version: str = "",
    ) -> None:
        self.settings = load_naoqi_services(config)
        self.motion = Motion(robot, config, self.settings, consent=consent)
        self.postures = Postures(self.motion, config, self.settings)
        self.waking = Waking(self.motion, self.postures, memory, self.settings)
        self.life = Life(self.motion)
        self.record = Record()
        self.voice = Voice(memory, self.record, self.settings.speech)
        self.version = version or self.settings.version

    def start(self) -> None:
        """Begin to move the robot."""
        self.motion.start()
