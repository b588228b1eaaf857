"""Postures, waking up and resting, autonomous abilities.

Waking up and going to rest; NAOqi 2.8 pages "Stiffness control" and "Wake up and Rest effect".
"""

from __future__ import annotations

from pepper_driver.backends.naoqi_server.almotion.curves import Bezier, Point, Spline
from pepper_driver.backends.naoqi_server.almotion.engine import MotionEngine
from pepper_driver.backends.naoqi_server.almotion.joints import AlmotionTask
from pepper_driver.backends.naoqi_server.memory import Memory
from pepper_driver.config import NaoqiServices, RobotConfig

NAMES = ("Crouch", "Stand", "StandInit", "StandZero")
"""Those of Pepper, NAOqi 2.8 page "Predefined postures"."""

MAX_POSTURE_ERROR = 0.15
"""[rad] A joint this near to a posture's has it. CHOSEN."""

MIN_POSTURE_TIME = 0.5
"""[s] of a motion to a posture."""


class Postures:
    """Motions to postures for ``motion``."""

    def __init__(self, motion: MotionEngine, config: RobotConfig, settings: NaoqiServices) -> None:
        self._motion = motion
        self._settings = settings
        self._angles = {name: config.posture(name).tolist() for name in {*NAMES, settings.rest}}

    def go(self, name: str, speed: float) -> AlmotionTask:
        """Begin the motion to a posture, ``speed`` in 0..1."""
        motion, angles = self._motion, self._angles[name]
        with motion.lock:
            command = motion.joints.command
            distance = max(abs(angle - now) for angle, now in zip(angles, command, strict=True))
            time = max(distance / (speed * self._settings.posture_speed), MIN_POSTURE_TIME)
            task = AlmotionTask(
                name="goToPosture",
                what="angle",
                joints=frozenset(range(len(angles))),
                make=lambda joint, start: Spline(start, [time], [angles[joint]]),
            )
            motion.joints.tasks.add(task)
        return task

    def reached(self, name: str) -> bool:
        """Return true if the robot has a posture, by its sensors."""
        with self._motion.lock:
            sensed = self._motion.joints.sensed
        hands = self._motion.body.hands
        return all(
            joint in hands or abs(angle - sensed[joint]) < MAX_POSTURE_ERROR
            for joint, angle in enumerate(self._angles[name])
        )

    @property
    def now(self) -> str:
        """The posture the robot has, or "Unknown"."""
        return next((name for name in NAMES if self.reached(name)), "Unknown")


STATES = ("solitary", "interactive", "safeguard", "disabled")

ALIVE = ("solitary", "interactive")
"""States in which the abilities are on."""

ABILITIES = (
    "AutonomousBlinking",
    "BackgroundMovement",
    "BasicAwareness",
    "ListeningMovement",
    "SpeakingMovement",
)


class Life:
    """State and abilities.

    Attributes:
        state: One of ``STATES``.
        enabled: By ability.
        paused: True while BasicAwareness is paused.
    """

    def __init__(self, motion: MotionEngine) -> None:
        self._motion = motion
        self.state = "disabled"
        self.enabled = dict.fromkeys(ABILITIES, False)
        self.paused = False

    def running(self, ability: str) -> bool:
        """Return true if an ability is at work."""
        return self.enabled[ability] and not (ability == "BasicAwareness" and self.paused)

    def enter(self, state: str) -> None:
        """Enter a state: it switches all abilities."""
        self.state = state
        self.enabled = dict.fromkeys(ABILITIES, state in ALIVE)
        self.apply()

    def apply(self) -> None:
        """Allow the abilities to move the robot, or not."""
        with self._motion.lock:
            self._motion.idle.alive = self.running("BackgroundMovement")
            self._motion.idle.looking = self.running("BasicAwareness")


SPEED = 0.6
"""Fraction of the speed with which it moves to the posture of standing or of rest. CHOSEN."""

PREFIX = "ALMotion/Stiffness/"


class Waking:
    """Turns the motors on and off, in order. Both methods wait until it is done."""

    def __init__(
        self, motion: MotionEngine, postures: Postures, memory: Memory, settings: NaoqiServices
    ) -> None:
        self._motion, self._postures, self._memory = motion, postures, memory
        self._settings = settings
        memory.insert("robotIsWakeUp", motion.awake)

    def wake_up(self) -> bool:
        """Motors on, then to the posture Stand; whether nothing interrupted it.

        Switches all reflexes on again but diagnosis effect and smart stiffness, also of a robot that is awake.
        """
        self._memory.raise_event(PREFIX + "wakeUpStarted", True)
        with self._motion.lock:
            # As drivers found on robots: what a client had switched off is on again afterwards.
            self._motion.reflexes.wake_up()
            awake = self._motion.awake
            if not awake:
                self._motion.joints.kill(self._motion.joints.tasks)
                self._motion.wheel_stiffness = 1.0
                ramp = self._ramp(1.0)
        if not awake:
            if not ramp.wait(self._motion.clock):
                return False
            self._set_awake(True)
            if not self._postures.reached("Stand"):
                self._postures.go("Stand", SPEED).wait(self._motion.clock)
        self._memory.raise_event(PREFIX + "wakeUpFinished", True)
        return True

    def rest(self) -> None:
        """Stop, move to the posture of rest, then motors off. Brakes hold the leg."""
        with self._motion.lock:
            self._motion.joints.kill(self._motion.joints.tasks)
            self._motion.base.stop()
            awake = self._motion.awake
        if awake and not self._postures.go(self._settings.rest, SPEED).wait(self._motion.clock):
            return
        with self._motion.lock:
            self._motion.awake = False  # reflexes end before the stiffness
            ramp = self._ramp(0.0)
        if ramp.wait(self._motion.clock):
            with self._motion.lock:
                self._motion.wheel_stiffness = 0.0
            self._set_awake(False)

    def _ramp(self, stiffness: float) -> AlmotionTask:
        """Return a straight line for all joints: that is what Bezier segments without handles are."""
        point = Point(time=self._settings.stiffness_ramp, value=stiffness)
        task = AlmotionTask(
            name="stiffness",
            what="stiffness",
            joints=frozenset(self._motion.body.groups["Body"]),
            make=lambda _, start: Bezier(start[0], [point]),
        )
        self._motion.joints.tasks.add(task)
        return task

    def _set_awake(self, awake: bool) -> None:
        with self._motion.lock:
            self._motion.awake = awake
        self._memory.raise_event("robotIsWakeUp", awake)
