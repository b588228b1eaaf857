"""Speech, lights, tablet and the robot's own motions, over the real library."""

import logging
from collections.abc import Callable, Iterator

import pytest

from pepper_driver.backends import BackendError, NotConnectedError
from pepper_driver.backends.naoqi.connection import Connection
from pepper_driver.backends.naoqi.services import NaoqiRobotServices, abilities
from pepper_driver.config import load_naoqi_settings
from support.naoqi_fakes import FakeRobot
from support.waiting import wait_until

pytestmark = pytest.mark.usefixtures("qi")


class Bench:
    """Services, the robot that has them, and whether it is moved meanwhile."""

    def __init__(self, fake: FakeRobot) -> None:
        self.fake = fake
        self.active = False
        self.link: Connection = fake.connect()
        self.services = NaoqiRobotServices(
            fake.uri, lambda: self.link, lambda: self.active, load_naoqi_settings()
        )

    def logged(self, entry: tuple[object, ...]) -> bool:
        """Wait until the robot has done something."""
        return wait_until(lambda: entry in self.fake.log)


@pytest.fixture
def bench() -> Iterator[Bench]:
    with FakeRobot() as fake:
        bench = Bench(fake)
        yield bench
        bench.link.close()


def test_a_pepper_can_do_all(bench: Bench) -> None:
    names = bench.link.service_names
    assert abilities(names) == {"speech", "leds", "tablet", "postures", "wake"}
    assert abilities(names - {"ALLeds", "ALTabletService"}) == {"speech", "postures", "wake"}


def test_speaking_does_not_block_the_caller(bench: Bench) -> None:
    bench.fake.speech.may_end.clear()
    bench.services.say("hello")
    assert not bench.fake.log, "it still speaks"
    bench.fake.speech.may_end.set()
    assert bench.logged(("say", "hello"))


def test_lights(bench: Bench) -> None:
    bench.services.leds("FaceLeds", (1.0, 0.5, 0.0), 0.2)
    assert bench.logged(("fadeRGB", "FaceLeds", 1.0, 0.5, 0.0, 0.2))
    bench.services.leds("ChestLeds", (0.0, 0.0, 1.0), 0.5)
    assert bench.logged(("fadeRGB", "ChestLeds", 0.0, 0.0, 1.0, 0.5))
    bench.services.leds("EarLeds", (0.0, 0.25, 0.75), 0.5)
    assert bench.logged(("fade", "EarLeds", 0.75, 0.5)), "ears have no colours"


def test_what_fails_later_is_logged(bench: Bench, caplog: pytest.LogCaptureFixture) -> None:
    bench.fake.speech.mute = True
    bench.services.say("hello")
    assert wait_until(lambda: caplog.records)
    (reported,) = [record.getMessage() for record in caplog.records]
    assert "ALTextToSpeech.say failed: " in reported
    assert reported.endswith("ALTextToSpeech::say no voice")
    assert caplog.records[0].levelno == logging.WARNING


def test_the_tablet(bench: Bench) -> None:
    bench.services.show_image("http://198.18.0.1/img/help_charger.png")
    bench.services.hide_image()
    assert bench.fake.log == [
        ("showImage", "http://198.18.0.1/img/help_charger.png"),
        ("hideImage",),
    ]
    with pytest.raises(BackendError, match="an address that the tablet itself can reach"):
        bench.services.show_image("file:///images/a.png")


def test_postures(bench: Bench) -> None:
    bench.services.go_to_posture("Stand", 0.5)
    assert ("goToPosture", "Stand", 0.5) in bench.fake.log
    with pytest.raises(BackendError, match="did not reach posture 'Lotus'"):
        bench.services.go_to_posture("Lotus", 0.5)


def test_waking_up_and_resting(bench: Bench) -> None:
    bench.services.rest()
    assert not bench.fake.motion.is_awake
    bench.services.wake_up()
    assert bench.fake.motion.is_awake
    bench.fake.motion.stuck |= {"wakeUp", "rest"}
    with pytest.raises(BackendError, match="does not rest; press the chest button"):
        bench.services.rest()
    bench.fake.motion.is_awake = False
    with pytest.raises(BackendError, match="does not wake up"):
        bench.services.wake_up()


MOTIONS: dict[str, Callable[[NaoqiRobotServices], None]] = {
    "posture": lambda services: services.go_to_posture("Stand", 0.5),
    "wake up": lambda services: services.wake_up(),
    "rest": lambda services: services.rest(),
}


@pytest.mark.parametrize("motion", MOTIONS)
def test_two_programs_do_not_move_it(bench: Bench, motion: str) -> None:
    bench.active = True
    with pytest.raises(BackendError, match=f"{motion}.* by its own program"):
        MOTIONS[motion](bench.services)
    assert not bench.fake.log
    bench.services.say("hello")
    assert bench.logged(("say", "hello"))


def test_after_the_connection(bench: Bench) -> None:
    bench.link.close()
    with pytest.raises(NotConnectedError):
        bench.services.say("hello")


def test_a_robot_without_a_tablet(caplog: pytest.LogCaptureFixture) -> None:
    """As NAOqi 2.9, whose tablet belongs to Android."""
    with FakeRobot(
        without=("ALTabletService", "ALLeds", "ALTextToSpeech", "ALRobotPosture")
    ) as fake:
        bench = Bench(fake)
        for _ in range(2):
            bench.services.show_image("http://198.18.0.1/a.png")
            bench.services.hide_image()
            bench.services.leds("FaceLeds", (1.0, 1.0, 1.0), 0.1)
            bench.services.say("hello")
            bench.services.go_to_posture("Stand", 0.5)
        bench.link.close()
        assert not fake.log
    assert len(caplog.records) == 4, "said once for each ability"
