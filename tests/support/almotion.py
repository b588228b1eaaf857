"""A robot without physics and without processes, for tests of ALMotion's writer: it is where the DCM commands it."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from pepper_driver.backends.naoqi_server.almotion.engine import MotionEngine
from pepper_driver.backends.naoqi_server.almotion.joints import AlmotionTask
from pepper_driver.backends.naoqi_server.dcm import Dcm, TimedCommand, UpdateType, wrapped
from pepper_driver.backends.naoqi_server.shared_values import BlackBox, table_keys
from pepper_driver.config import load_naoqi_services, load_robot
from pepper_driver.config.clock import Clock
from pepper_driver.config.naoqi_devices import load_naoqi_devices

CONFIG = load_robot()
SETTINGS = load_naoqi_services(CONFIG)
DEVICES = load_naoqi_devices(CONFIG)
PREFIX = CONFIG.naoqi.prefix


def joint(name: str) -> int:
    return CONFIG.joint_index(name)


def angle_key(name: str) -> str:
    return PREFIX + CONFIG.naoqi.position_command.format(joint=name)


def hardness_key(name: str) -> str:
    return PREFIX + CONFIG.naoqi.stiffness_command.format(joint=name)


def wheel_key(name: str) -> str:
    return PREFIX + CONFIG.naoqi.wheel_speed_command.format(wheel=name)


@dataclass(frozen=True)
class Given:
    """An order, as the robot got it."""

    date: int
    keys: tuple[str, ...]
    update: UpdateType
    commands: Sequence[Sequence[TimedCommand]]


class IdealRobot:
    """Joints with stiffness are where the DCM sends them, wheels turn as it says. Time passes in :meth:`tick`.

    ``sent`` keeps what the DCM sent to each actuator, a value a cycle; ``orders`` all orders.
    """

    def __init__(self, posture: str = "Stand", clock: int = 5_000) -> None:
        self.now = clock
        self.keys: Mapping[str, int] = table_keys(CONFIG, DEVICES)
        self.actuators = frozenset(DEVICES.actuators)
        self.info: Mapping[str, Any] = {}
        self._values = {key: DEVICES.values.get(key, 0.0) for key in self.keys}
        angles = dict(zip(CONFIG.joint_names, CONFIG.posture(posture).tolist(), strict=True))
        for name, angle in angles.items():
            self._values[angle_key(name)] = angle
            self._values[PREFIX + CONFIG.naoqi.position.format(joint=name)] = angle
        self._dcm = Dcm({key: self._values[key] for key in DEVICES.actuators}, clock)
        self.orders: list[Given] = []
        self.sent: dict[str, list[float]] = {key: [] for key in DEVICES.actuators}

    def values(self) -> list[float]:
        return list(self._values.values())

    def value(self, key: str) -> float:
        return self._values[key]

    def show(self, key: str, value: float) -> None:
        """Let a sensor show a value."""
        self._values[key] = value

    def time(self) -> int:
        return wrapped(self.now)

    def order(
        self,
        actuators: Sequence[str],
        update: UpdateType,
        commands: Sequence[Sequence[TimedCommand]],
    ) -> None:
        self._dcm.order(actuators, update, commands, self.now)
        self.orders.append(Given(self.now, tuple(actuators), update, commands))

    def push(self, **arguments: Any) -> None: ...

    def grab(self, **arguments: Any) -> None: ...

    def set_fault(self, name: str, **arguments: Any) -> None: ...

    def clear_faults(self) -> None: ...

    def black_box(self, last: int | None = None) -> BlackBox:
        raise NotImplementedError

    def tick(self) -> None:
        """A cycle of the DCM."""
        for key, value in zip(DEVICES.actuators, self._dcm.advance(self.now), strict=True):
            self._values[key] = value
            self.sent[key].append(value)
        for name in CONFIG.joint_names:
            if self._values[hardness_key(name)] > 0:
                sensor = PREFIX + CONFIG.naoqi.position.format(joint=name)
                self._values[sensor] = self._values[angle_key(name)]
        for name in CONFIG.wheels.names:
            sensor = PREFIX + CONFIG.naoqi.wheel_speed.format(wheel=name)
            self._values[sensor] = self._values[wheel_key(name)]

    def written(self, since: int = 0) -> set[str]:
        """Actuators that orders were given to from a date on."""
        return {key for given in self.orders if given.date >= since for key in given.keys}


class Stage:
    """ALMotion's writer with such a robot, and time that passes on request, or while a caller waits."""

    def __init__(
        self, *, posture: str = "Stand", clock: int = 5_000, consent: bool = False
    ) -> None:
        self.robot = IdealRobot(posture, clock)
        time = Clock(now=lambda: 1_000_000 * self.robot.now, sleep=self._sleep)
        self.motion = MotionEngine(self.robot, CONFIG, SETTINGS, consent=consent, clock=time)
        self._passed = 0

    def run(self, seconds: float, each: Callable[[], object] = lambda: None) -> None:
        """Let time pass: the DCM every 12 ms, ALMotion every 20 ms, and ``each`` after every 4 ms."""
        for _ in range(round(seconds * 250)):
            self.robot.now += 4
            self._passed += 4
            if self._passed % 12 == 0:
                self.robot.tick()
            if self._passed % 20 == 0:
                self.motion.cycle()
            each()

    def _sleep(self, seconds: float) -> None:
        self.run(max(seconds, 0.004))

    def stiffen(self, *, awake: bool = False) -> None:
        """Give all joints stiffness at once."""
        self.motion.joints.stiffness = [1.0] * len(CONFIG.joint_names)
        self.motion.awake = awake
        self.motion.wheel_stiffness = 1.0
        self.run(0.1)

    def quiet(self) -> None:
        """Switch all reflexes off."""
        reflexes = self.motion.reflexes
        reflexes.self_collision = dict.fromkeys(reflexes.self_collision, False)
        reflexes.external = dict.fromkeys(reflexes.external, False)
        reflexes.diagnosis = reflexes.smart_stiffness = False
        reflexes.fall_manager = reflexes.push_recovery = False

    def add(self, task: AlmotionTask) -> AlmotionTask:
        self.motion.joints.tasks.add(task)
        return task

    def command(self, name: str) -> float:
        """Angle that ALMotion commands."""
        return self.motion.joints.command[joint(name)]

    def sent(self, name: str) -> list[float]:
        """Angles that the DCM sent to a joint, cycle by cycle."""
        return self.robot.sent[angle_key(name)]
