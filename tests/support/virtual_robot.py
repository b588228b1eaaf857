"""A robot whose DCM, clock and network are reckoned, not waited for: minutes of a link in a second, always the same.

The DCM is the stand-in's, after the documented algorithm; its joints are at their command at once.
"""

from __future__ import annotations

import heapq
from collections import Counter
from collections.abc import Callable, Sequence
from itertools import count
from types import SimpleNamespace
from typing import Any, cast

import numpy as np

from pepper_driver.backends.fields import Measurement
from pepper_driver.backends.naoqi.connection import Connection
from pepper_driver.backends.naoqi.dcm_channel import DcmChannel
from pepper_driver.backends.naoqi.memory_keys import Alias, SensorKeys, actuator_keys
from pepper_driver.backends.naoqi.timing import shown
from pepper_driver.backends.naoqi_server.dcm import Dcm, UpdateType
from pepper_driver.config import NaoqiSettings, load_naoqi_settings, load_robot
from pepper_driver.config.arrays import FloatArray
from pepper_driver.config.clock import Clock
from pepper_driver.realtime import RealTimePacer

ROBOT = load_robot()
SETTINGS = load_naoqi_settings()
CYCLE = 12
HERE = 1_000_000.0
"""[ms] what the computer's clock shows at the start."""

Network = Callable[[float], float]
"""How long a message sent at a time [ms] takes one way [ms]."""


def wire(seed: int = 0, jitter: float = 0.3) -> Network:
    """A cable, and two computers that have something else to do now and then."""
    rng = np.random.default_rng(seed)
    return lambda _: 0.2 + float(rng.exponential(jitter))


def wifi(seed: int = 0, *, stalls: bool = True) -> Network:
    """As the stand-in's network of this name."""
    rng = np.random.default_rng(seed)
    fraction = 0.003 if stalls else 0.0
    return lambda _: 1.5 + float(rng.exponential(1.0)) + 60.0 * (rng.random() < fraction)


class Future:
    """As those of qi."""

    def __init__(self) -> None:
        self.done = False
        self._value: Any = None
        self._error: str | None = None
        self._callbacks: list[Callable[[Future], None]] = []

    def isRunning(self) -> bool:
        return not self.done

    def hasError(self) -> bool:
        return self._error is not None

    def value(self) -> Any:
        if self._error is not None:
            raise RuntimeError(self._error)
        return self._value

    def addCallback(self, callback: Callable[[Future], None]) -> None:
        if self.done:
            callback(self)
        else:
            self._callbacks.append(callback)

    def finish(self, answer: Callable[[], Any]) -> None:
        try:
            self._value = answer()
        except RuntimeError as error:
            self._error = str(error)

    def arrive(self) -> None:
        self.done = True
        for callback in self._callbacks:
            callback(self)


class VirtualRobot:
    """Connection, network and robot in one; as far as ``Link`` looks at them.

    Args:
        network: Time a message takes.
        date: DCM time at the start [ms].
        drift: By which fraction the DCM's clock is faster.
        phase: When after the start the first cycle begins [ms].
        delay: Cycles from the date of a command to the sample that shows it.
        publication: Time from a cycle until its values can be asked for [ms].

    Attributes:
        time: Of the computer [ms].
        commanded: What the DCM had at its cycles, by date: joints, wheels.
        taken: How many commands it has taken.
        asked: (time [ms], method) of all that it was asked.
        unanswered: Questions and commands on their way now, by method.
        almotion_target: (17,) target angles of ALMotion; of a joint in ``limp`` where it is measured.
        drives: Whether ALMotion drives.
        refuses: Why it refuses a command for an alias; empty when it takes it.
        spoil: Changes what the robot answers to a question for its values.
    """

    def __init__(
        self,
        network: Network = lambda _: 0.2,
        *,
        date: int = 5_000_000,
        drift: float = 0.0,
        phase: float = 3.0,
        delay: int = 3,
        publication: float = 1.5,
    ) -> None:
        self.address = self
        self.uri = "naoqi://virtual"
        self.connected = True
        self._network, self._rate, self._delay = network, 1.0 + drift, delay
        self._publication = publication
        self.asked: list[tuple[float, str]] = []
        self.unanswered: Counter[str] = Counter()
        self.almotion_target, self.limp, self.drives = ROBOT.posture("Stand"), set[int](), False
        self.time, self._origin = HERE, date
        self._keys = actuator_keys(ROBOT)
        everything = [key for keys in self._keys.values() for key in keys]
        start = dict.fromkeys(everything, 0.0)
        start.update(zip(self._keys[Alias.POSITION], ROBOT.posture("Stand").tolist(), strict=True))
        self.first_cycle = date + round(phase)
        self._dcm = Dcm(start, self.first_cycle - CYCLE)
        self._start, self._zeros = start, dict.fromkeys(SensorKeys(ROBOT).names, 0.0)
        self._sent: dict[int, dict[str, float]] = {}
        self.commanded: dict[int, tuple[FloatArray, FloatArray]] = {}
        self._dates: list[int] = []
        self._agenda: list[tuple[float, int, Callable[[], None]]] = []
        self._numbers = count()
        self._last_arrival = {"there": 0.0, "back": 0.0}
        self._hung_until: float | None = None
        self.taken = 0
        self.refuses: Callable[[str], str] = lambda _: ""
        self.spoil: Callable[[list[Any]], Any] = lambda values: values
        self._plan(self._at(self.first_cycle), self._cycle)

    # -- time ---------------------------------------------------------------------------------------------------

    def now(self) -> int:
        """The computer's clock [ns]."""
        return round(self.time * 1e6)

    @property
    def clock(self) -> Clock:
        """Clock of the computer, whose time passes when a program sleeps."""
        return Clock(self.now, self.sleep)

    def dcm_time(self, here: float) -> float:
        return self._origin + (here - HERE) * self._rate

    def _at(self, date: float) -> float:
        """Time of the computer at which the DCM's clock shows a date [ms]."""
        return HERE + (date - self._origin) / self._rate

    def pass_time(self, until: float) -> None:
        """Let everything happen up to a time of the computer [ms]."""
        while self._agenda and self._agenda[0][0] <= until:
            when, _, action = heapq.heappop(self._agenda)
            self.time = max(self.time, when)
            action()
        self.time = until

    def sleep(self, seconds: float) -> None:
        """Let time pass, as a pacer waits."""
        self.pass_time(self.time + 1e3 * seconds)

    def _plan(self, when: float, action: Callable[[], None]) -> None:
        heapq.heappush(self._agenda, (when, next(self._numbers), action))

    # -- the robot ----------------------------------------------------------------------------------------------

    def _cycle(self) -> None:
        date = self._dates[-1] + CYCLE if self._dates else self.first_cycle
        self._dcm.advance(date)
        self._dates.append(date)
        sent = {key: actuator.sent for key, actuator in self._dcm.actuators.items()}
        self._sent[date] = sent
        self._sent.pop(date - 5 * CYCLE, None)
        self.commanded[date] = (
            np.array([sent[key] for key in self._keys[Alias.POSITION]]),
            np.array([sent[key] for key in self._keys[Alias.WHEEL_SPEED]]),
        )
        self._plan(self._at(date + CYCLE), self._cycle)

    def hang(self, until: float) -> None:
        """QpResult nothing until a time [ms], then all that has come meanwhile. The DCM goes on."""
        self._hung_until = until

    def order(
        self, keys: Sequence[str], values: Sequence[float], after: float, update: UpdateType
    ) -> None:
        """Take an order of another program, to be reached ``after`` [ms] from now."""
        now = round(self.dcm_time(self.time))
        self._dcm.order(keys, update, [[(value, now + round(after))] for value in values], now)

    def every(self, period: float, action: Callable[[], None]) -> None:
        """Do something again and again, beginning a period [ms] from now."""

        def again() -> None:
            action()
            self._plan(self.time + period, again)

        self._plan(self.time + period, again)

    def _position(self, before: int = 0) -> FloatArray:
        """Positions of the newest cycle, or some before."""
        answered = self._newest() - CYCLE * (self._delay + before)
        return self.commanded.get(answered, (ROBOT.posture("Stand"), None))[0]

    def _newest(self) -> int:
        """Date of the newest cycle whose values can be asked for."""
        published = self.dcm_time(self.time - self._publication)
        dates = [date for date in self._dates[-3:] if date <= published]
        return dates[-1] if dates else self.first_cycle - CYCLE

    def _values(self, names: Sequence[str]) -> list[Any]:
        date = self._newest()
        values: dict[str, Any] = self._zeros.copy()
        values.update(self._sent.get(date, self._start))
        for name, value in zip(ROBOT.joint_names, self._position().tolist(), strict=True):
            values[ROBOT.naoqi.prefix + ROBOT.naoqi.position.format(joint=name)] = value
        values[ROBOT.naoqi.time] = shown(date)
        return [values[name] for name in names]

    def _take(self, request: list[Any]) -> None:
        alias, update, kind, _, dates, values = request
        if reason := self.refuses(alias):
            raise RuntimeError(reason)
        assert kind == "time-separate"
        commands = [list(zip(its, dates, strict=True)) for its in values]
        now = round(self.dcm_time(self.time))
        self._dcm.order(self._keys[Alias(alias)], update, commands, now)
        self.taken += 1

    # -- what Link uses -----------------------------------------------------------------------------------------

    def service(self, name: str) -> VirtualRobot:
        assert name in ("DCM", "ALMemory", "ALMotion")
        return self

    def call(self, service: str, method: str, *arguments: Any, timeout: float | None = None) -> Any:
        if method == "createAlias":
            return arguments[0]
        future = getattr(self, method)(*arguments, _async=True)
        while not future.done:
            self.pass_time(self._agenda[0][0])
        return future.value()

    def _ask(self, method: str, answer: Callable[[], Any]) -> Future:
        """Messages of either direction arrive in their order, as over TCP."""
        future = Future()
        self.asked.append((self.time, method))
        self.unanswered[method] += 1
        future.addCallback(lambda _: self.unanswered.subtract([method]))

        def arrive(way: str, action: Callable[[], None]) -> None:
            when = max(self.time + self._network(self.time), self._last_arrival[way])
            self._last_arrival[way] = when
            self._plan(when, action)

        def there() -> None:
            if self._hung_until is not None and self.time < self._hung_until:
                self._plan(self._hung_until, there)
                return
            future.finish(answer)
            arrive("back", future.arrive)

        arrive("there", there)
        return future

    def getTime(self, offset: int, *, _async: bool) -> Future:
        return self._ask("getTime", lambda: shown(int(self.dcm_time(self.time)) + offset))

    def getListData(self, names: list[str], *, _async: bool) -> Future:
        return self._ask("getListData", lambda: self.spoil(self._values(names)))

    def setAlias(self, request: list[Any], *, _async: bool) -> Future:
        return self._ask("setAlias", lambda: self._take(request))

    def getAngles(self, names: list[str], sensors: bool, *, _async: bool) -> Future:
        assert names == list(ROBOT.joint_names)
        assert not sensors

        def almotion_target() -> list[float]:
            measured = self._position(before=2)  # it looks 50 times a second
            return [
                float((measured if joint in self.limp else self.almotion_target)[joint])
                for joint in range(17)
            ]

        return self._ask("getAngles", almotion_target)

    def moveIsActive(self, *, _async: bool) -> Future:
        return self._ask("moveIsActive", lambda: self.drives)


def link_with(robot: VirtualRobot, settings: NaoqiSettings = SETTINGS) -> DcmChannel:
    """The client's end of it."""
    return DcmChannel(cast(Connection, robot), ROBOT, settings, 3, clock=robot.clock)


class VirtualLoop:
    """Ticks of a link in virtual time, paced as those of the robot.

    Args:
        robot: Virtual.
        follow: Whether ticks follow the robot's cycles.
        request: Whether samples are requested before the ticks.
        compute: Time from a sample to its command [ms].

    Attributes:
        began: When each tick began [ms].
    """

    def __init__(
        self,
        robot: VirtualRobot,
        *,
        settings: NaoqiSettings = SETTINGS,
        follow: bool = True,
        request: bool = True,
        compute: float = 1.5,
    ) -> None:
        self.robot, self._compute = robot, compute
        self.link = link_with(robot, settings)
        link = self.link
        self.followed = SimpleNamespace(  # in place of a backend
            phase_error=link.phase_error if follow else lambda _: 0.0,
            request=link.request,
            request_lead=link.request_lead if request else 0.0,
        )
        self.pacer = RealTimePacer(ROBOT.cycle, cast("Any", self.followed), clock=robot.clock)
        self.began: list[float] = []

    def wait(self, late: float = 0.0) -> None:
        """Wait for the next tick, which begins ``late`` [ms]."""
        self.pacer.wait()
        self.robot.pass_time(self.robot.time + late)
        self.began.append(self.robot.time)

    def read(self) -> Measurement:
        """Read, as a tick does at its beginning."""
        return self.link.read()

    def write(
        self, position: FloatArray | None, stiffness: FloatArray, wheel_speed: FloatArray
    ) -> None:
        """Write, as a tick does once it has computed."""
        self.robot.pass_time(self.robot.time + self._compute)
        self.link.write(position, stiffness, wheel_speed)
