"""The services of the stand-in over the real qi: what a program for Pepper, or a driver, asks for and sees."""

import os
import signal
import time
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest

from pepper_driver.backends.naoqi_server.launch import StandIn
from pepper_driver.config import load_robot
from support.stand_in_session import PREFIX, connected
from support.stand_ins import let_cycles_pass, stays
from support.waiting import wait_until

pytestmark = pytest.mark.usefixtures("qi")

CONFIG = load_robot()


def index(name: str) -> int:
    return CONFIG.joint_index(name)


@pytest.fixture(scope="module")
def stand_in() -> Iterator[StandIn]:
    """A robot whose owner consents, awake."""
    with StandIn("mujoco", consent=True, version="2.5.5.5") as made:
        with connected(made.url) as session:
            session.service("ALMotion").wakeUp()
        yield made


@pytest.fixture(scope="module")
def session(stand_in: StandIn) -> Iterator[Any]:
    with connected(stand_in.url) as made:
        yield made


@pytest.fixture(scope="module")
def service(session: Any) -> Callable[[str], Any]:
    found: dict[str, Any] = {}

    def get(name: str) -> Any:
        if name not in found:
            found[name] = session.service(name)
        return found[name]

    return get


@pytest.fixture(scope="module")
def motion(service: Callable[[str], Any]) -> Any:
    return service("ALMotion")


@pytest.fixture
def outside(service: Callable[[str], Any]) -> Iterator[Any]:
    made = service("StandIn")
    yield made
    made.clearFaults()


def record_events(service: Callable[[str], Any], *events: str) -> list[tuple[str, Any]]:
    """A list that grows with the events as they are raised."""
    log: list[tuple[str, Any]] = []
    for event in events:
        subscriber = service("ALMemory").subscriber(event)
        subscriber.signal.connect(lambda value, event=event: log.append((event, value)))
        log_keeps.append(subscriber)
    return log


log_keeps: list[Any] = []


def values_of(log: list[tuple[str, Any]], event: str) -> list[Any]:
    """The values of one event."""
    return [value for name, value in log if name == event]


def test_a_joint_gets_where_set_angles_sends_it(stand_in: StandIn, motion: Any) -> None:
    motion.setAngles(["HeadYaw", "LShoulderPitch"], [0.5, 1.0], [0.2, 0.2])
    goals = {"HeadYaw": 0.5, "LShoulderPitch": 1.0}
    places = [index(name) for name in goals]

    def there() -> bool:
        return bool(
            np.abs(stand_in.black_box(1).position[0, places] - list(goals.values())).max() < 0.05
        )

    assert wait_until(there)  # as it really is, friction and backlash included
    assert wait_until(lambda: motion.getAngles(list(goals), False) == list(goals.values()))
    motion.angleInterpolation(list(goals), [0.0, 1.58], 1.0, True)


FAR = 100.0  # [m] a way that no test waits for


def test_a_move_ends_at_its_goal(stand_in: StandIn, motion: Any) -> None:
    start = stand_in.black_box(1).base[0]
    assert motion.moveTo(0.3, 0.0, 0.0) is True
    end = stand_in.black_box(1).base[0]
    assert np.hypot(*(end - start)[:2]) == pytest.approx(0.3, abs=0.02)


def test_a_blocking_move_holds_up_no_other_call(motion: Any) -> None:
    moving = motion.moveTo(FAR, 0.0, 0.0, _async=True)
    waits = [motion.waitUntilMoveIsFinished(_async=True) for _ in range(10)]
    assert wait_until(motion.moveIsActive)
    questions = [motion.getAngles("Body", True, _async=True) for _ in range(40)]
    assert all(len(question.value()) == 17 for question in questions)
    assert moving.isRunning()  # so none of them had to wait for it
    motion.stopMove()
    assert moving.value() is False
    assert all(wait.value() is None for wait in waits)


def test_blocking_motions_can_be_killed(motion: Any) -> None:
    slow = motion.angleInterpolation("HeadYaw", 1.0, 30.0, True, _async=True)
    assert wait_until(motion.getTaskList)
    after = motion.angleInterpolation("HeadYaw", 0.0, 0.5, True, _async=True)
    assert wait_until(lambda: len(motion.getTaskList()) == 2)
    name, number = motion.getTaskList()[0]
    assert name == "angleInterpolation"
    assert motion.areResourcesAvailable(["HeadPitch"])
    assert not motion.areResourcesAvailable(["Head"])
    assert motion.killTask(number) is True
    assert slow.value() is None  # and the next one had waited for it
    assert after.value() is None
    again = motion.angleInterpolation("LArm", [0.5] * 6, 30.0, True, _async=True)
    assert wait_until(motion.getTaskList)
    motion.killTasksUsingResources(["LShoulderPitch"])
    again.value()
    assert motion.killTask(number) is False


@pytest.mark.parametrize(
    ("method", "arguments", "words"),
    [
        ("setAngles", ("HeadYow", 0.1, 0.1), "HeadYaw"),
        ("setAngles", ("HeadYaw", 0.1, 0.0), "fraction"),
        ("setAngles", ("HeadYaw", "0.1", 0.1), "must be a number"),
        ("setAngles", ("Head", [0.1], 0.1), "2 joints are named"),
        ("angleInterpolation", ("HeadYaw", [0.1, 0.2], [1.0], True), "2 angles and 1 times"),
        ("angleInterpolation", ("HeadYaw", 0.1, -1.0, True), "rise"),
        ("setStiffnesses", ("Leg", 0.5), "wakeUp or rest"),
        ("setStiffnesses", ("Head", 1.5), "0 to 1"),
        ("getLimits", ("Nose",), "Nose"),
        ("moveTo", (0.1, "left", 0.0), "y must be"),
        ("moveToward", (0.1, 0.0, 0.0, [["MaxStepX", 0.1]]), "MaxVelXY"),
        ("getPosition", ("CameraTop", 9, True), "frame|unknown name"),
        ("setBreathEnabled", ("Nose", True), "Body"),
        ("setFallManagerEnabled", ("no",), "true or false"),
    ],
)
def test_mistakes_are_reported_in_a_line(
    motion: Any, method: str, arguments: tuple[Any, ...], words: str
) -> None:
    with pytest.raises(RuntimeError, match=words) as caught:
        getattr(motion, method)(*arguments)
    text = str(caught.value)
    assert text.startswith(f"ALMotion::{method}: ")
    assert len(text.splitlines()) == 1


def test_the_leg_is_left_out_of_stiffness_of_the_body(motion: Any) -> None:
    motion.setStiffnesses("Body", 0.5)
    assert set(motion.getStiffnesses("Leg")) == {1.0}
    assert set(motion.getStiffnesses(["Head", "LArm", "RArm"])) == {0.5}
    motion.stiffnessInterpolation(["Head", "LArm", "RArm"], 1.0, 0.3)
    assert set(motion.getStiffnesses("Body")) == {1.0}


def test_breath_and_idle_posture_exclude_each_other(motion: Any) -> None:
    motion.setBreathEnabled("Arms", True)
    assert (motion.getBreathEnabled("LArm"), motion.getBreathEnabled("Body")) == (
        True,
        False,
    )
    motion.setIdlePostureEnabled("RArm", True)
    assert (motion.getBreathEnabled("RArm"), motion.getIdlePostureEnabled("RArm")) == (False, True)
    motion.setBreathEnabled("Body", False)
    motion.setIdlePostureEnabled("Body", False)
    assert not motion.getIdlePostureEnabled("RArm")


def quiet(motion: Any) -> None:
    """Switch off what drivers for the DCM do."""
    motion.setCollisionProtectionEnabled("Arms", False)
    motion.setExternalCollisionProtectionEnabled("All", False)
    motion.setDiagnosisEffectEnabled(False)
    motion.setSmartStiffnessEnabled(False)
    motion.setFallManagerEnabled(False)
    motion.setPushRecoveryEnabled(False)


def orders(stand_in: StandIn) -> int:
    """Number of orders that the DCM has taken."""
    return int(stand_in.black_box(1).orders[0])


def is_left_alone(stand_in: StandIn) -> bool:
    """Return True if the DCM takes no order for a while."""
    return stays(stand_in, lambda: orders(stand_in))


def is_written_to(stand_in: StandIn) -> bool:
    """Return True if a program gives the DCM one order after the other."""
    before = orders(stand_in)
    return wait_until(lambda: orders(stand_in) > before + 10)


def test_almotion_fights_a_user_of_the_dcm_until_all_is_off(
    stand_in: StandIn, motion: Any, service: Callable[[str], Any]
) -> None:
    dcm, name = service("DCM"), "HeadYaw"
    dcm.createAlias(["yaw", [f"{name}/Position/Actuator/Value"]])
    motion.angleInterpolation(name, 0.0, 0.5, True)

    def swing(value: float) -> None:
        dcm.setAlias(["yaw", "ClearAfter", "time-separate", 0, [dcm.getTime(36)], [[value]]])
        time.sleep(0.012)

    def jumps() -> bool:
        """Return True if the DCM sent two values in a row that are far apart: one is ours, one is not."""
        swing(0.3)
        sent = stand_in.black_box(80).position_command[:, index(name)]
        return bool(np.abs(np.diff(sent)).max() > 0.1)

    motion.setDiagnosisEffectEnabled(True)
    for step in range(25):
        swing(0.012 * step)
    assert wait_until(jumps)
    quiet(motion)
    assert wait_until(lambda: is_left_alone(stand_in))
    before = orders(stand_in)
    for step in range(25):
        swing(0.3 - 0.012 * step)
    let_cycles_pass(stand_in)
    assert orders(stand_in) == before + 25  # none but ours
    motion.wakeUp()
    assert motion.getFallManagerEnabled()
    assert not motion.getDiagnosisEffectEnabled()
    assert is_written_to(stand_in)


def test_a_living_robot_writes_by_itself(
    stand_in: StandIn, motion: Any, service: Callable[[str], Any]
) -> None:
    life = service("ALAutonomousLife")
    states = record_events(service, "AutonomousLife/State")
    quiet(motion)
    life.setState("solitary")
    quiet(motion)
    assert life.getState() == "solitary"
    assert wait_until(lambda: [value for _, value in states] == ["solitary"])
    assert service("ALBackgroundMovement").isRunning()
    assert is_written_to(stand_in)
    service("ALBasicAwareness").setEnabled(False)
    service("ALBackgroundMovement").setEnabled(False)
    assert wait_until(lambda: is_left_alone(stand_in))
    life.setState("disabled")
    assert wait_until(lambda: [value for _, value in states] == ["solitary", "disabled"])
    with pytest.raises(RuntimeError, match="possible: solitary"):
        life.setState("asleep")


def test_bumpers_stop_a_move(motion: Any, outside: Any, service: Callable[[str], Any]) -> None:
    failed = record_events(service, "ALMotion/MoveFailed")
    motion.wakeUp()  # its protection on again
    moving = motion.moveTo(FAR, 0.0, 0.0, _async=True)
    assert wait_until(motion.moveIsActive)
    outside.setFault("press", {"sensors": "FrontLeft"})
    assert moving.value() is False
    assert motion.moveTo(0.1, 0.0, 0.0) is False
    assert wait_until(lambda: len(failed) >= 2)
    assert failed[0][1][:2] == ["Safety", 1]
    outside.clearFaults()
    assert wait_until(lambda: motion.moveTo(0.0, 0.0, 0.05))


def test_postures(motion: Any, service: Callable[[str], Any]) -> None:
    posture = service("ALRobotPosture")
    assert posture.goToPosture("Crouch", 1.0) is True
    assert (posture.getPosture(), posture.getPostureFamily()) == ("Crouch", "Crouching")
    going = posture.goToPosture("StandInit", 0.1, _async=True)  # in 17 s
    assert wait_until(lambda: posture.getPosture() == "Unknown")  # it has left the other one
    posture.stopMove()
    assert going.value() is False
    assert posture.goToPosture("Stand", 1.0) is True
    with pytest.raises(RuntimeError, match="Crouch, Stand, StandInit, StandZero"):
        posture.goToPosture("Sit", 0.5)


def test_speech_takes_its_time_and_raises_its_events(service: Callable[[str], Any]) -> None:
    tts = service("ALTextToSpeech")
    started, done, status = (
        f"ALTextToSpeech/{event}" for event in ("TextStarted", "TextDone", "Status")
    )
    events = record_events(service, started, done, status)
    begin = time.monotonic()
    tts.say("I stand in for others")
    assert time.monotonic() - begin > 1.2
    ends = [(started, 0), (done, 1)]  # qi reports each on a thread of its own, in any order
    assert wait_until(lambda: all(event in events for event in ends))
    long = [tts.say("word " * 2000, _async=True) for _ in range(2)]
    assert wait_until(
        lambda: [state for _, state in values_of(events, status)].count("enqueued") == 3
    )
    tts.stopAll()
    assert wait_until(lambda: not any(future.isRunning() for future in long))
    with pytest.raises(RuntimeError, match="English"):
        tts.setLanguage("Englisch")


def test_lights_fade_in_memory(service: Callable[[str], Any]) -> None:
    leds, memory = service("ALLeds"), service("ALMemory")
    key = PREFIX + "Face/Led/Red/Left/0Deg/Actuator/Value"
    leds.off("FaceLeds")
    assert wait_until(lambda: memory.getData(key) == 0.0)
    slow = leds.fadeRGB("FaceLeds", 1.0, 0.5, 0.0, 100.0, _async=True)
    assert wait_until(lambda: 0.0 < memory.getData(key) < 1.0)
    assert slow.isRunning()
    begin = time.monotonic()
    leds.fadeRGB("FaceLeds", 1.0, 0.5, 0.0, 0.3)
    assert time.monotonic() - begin > 0.3
    assert wait_until(lambda: memory.getData(key) == 1.0)
    assert memory.getData(key.replace("Red", "Green")) == pytest.approx(0.5)
    assert memory.getData(key.replace("Red", "Blue")) == 0.0
    assert len(leds.listGroup("FaceLeds")) == 48
    assert leds.listGroup("FaceLedRight0") == leds.listLED("RightFaceLed8")
    assert set(leds.listGroup("AllLeds")) <= {key.removeprefix(PREFIX) for key in all_leds(memory)}
    with pytest.raises(RuntimeError, match="FaceLeds"):
        leds.on("FaceLed")


def all_leds(memory: Any) -> list[str]:
    return [key for key in memory.getDataList("/Led/") if key.endswith("/Actuator/Value")]


def test_touch_can_be_ended(stand_in: StandIn, outside: Any, service: Callable[[str], Any]) -> None:
    touch = service("ALTouch")
    names = {name for name, _ in touch.getStatus()}
    assert names == set(touch.getSensorList())
    assert "Head/Touch/Front" in names
    outside.setFault("press", {"sensors": "Head/Touch/Front"})
    assert wait_until(
        lambda: ["Head/Touch/Front", True] in [list(pair) for pair in touch.getStatus()]
    )
    outside.clearFaults()
    assert wait_until(lambda: not any(down for _, down in touch.getStatus()))
    events, memory = record_events(service, "TouchChanged", "My/Other"), service("ALMemory")
    touch.exit()
    outside.setFault("press", {"sensors": "Head/Touch/Front"})
    assert wait_until(lambda: memory.getData(PREFIX + "Head/Touch/Front/Sensor/Value") == 1.0)
    let_cycles_pass(stand_in)
    memory.raiseEvent("My/Other", 1)
    assert wait_until(lambda: values_of(events, "My/Other") == [1])
    assert values_of(events, "TouchChanged") == []


def test_what_a_ros_driver_asks_for_at_its_start(
    motion: Any, service: Callable[[str], Any]
) -> None:
    memory = service("ALMemory")
    assert memory.getData("RobotConfig/Body/Type").lower() == "juliette"
    assert isinstance(memory.getData("RobotConfig/Body/BaseVersion"), str)
    assert service("ALSystem").systemVersion() == "2.5.5.5"
    names, values = motion.getRobotConfig()
    assert values[names.index("Number of Arms")] == 2
    assert "CameraTop" in motion.getSensorNames()
    assert len(motion.getBodyNames("JointActuators")) == 17
    for name in motion.getBodyNames("JointActuators"):
        lower, upper, speed, torque = motion.getLimits(name)[0]
        assert lower < upper
        assert min(speed, torque) > 0
    keys = [PREFIX + f"{joint}/Temperature/Sensor/Value" for joint in motion.getBodyNames("Body")]
    keys += ["BatteryChargeChanged", "BatteryPowerPluggedChanged", "BatteryFullChargedFlagChanged"]
    assert None not in memory.getListData(keys)
    for quantity in ("Velocity", "Torque"):
        assert isinstance(memory.getData(f"Motion/{quantity}/Sensor/HeadYaw"), float)
    assert len(motion.getPosition("Torso", 1, True)) == 6
    assert len(motion.getRobotVelocity()) == 3
    service("ALBodyTemperature").setEnableNotifications(True)
    assert service("ALBodyTemperature").getTemperatureDiagnosis() == []
    service("ALSonar").subscribe("ROS")
    service("ALAudioDevice").setClientPreferences("ROS", 48000, 0, 0)
    service("ALAudioDevice").subscribe("ROS")
    assert service("ALRobotModel")._getMicrophoneConfig() == 0
    assert "RobotConfig/Head/Device/Micro/Version" in service("ALRobotModel")._getConfigMap()
    assert "RobotConfig/Body/Version" in service("ALRobotModel").getConfig()
    assert service("LogManager").getListener().onLogMessage is not None
    assert service("ALLauncher").isModulePresent("ALMotion") is True
    assert service("ALLauncher").isModulePresent("ALNose") is False
    assert service("ALTextToSpeech").getLanguage() == "English"


def test_pictures_come_as_bytes(service: Callable[[str], Any]) -> None:
    video = service("ALVideoDevice")
    handle = video.subscribeCamera("ROS", 0, 1, 11, 10)
    other = video.subscribeCamera("ROS", 2, 1, 17, 10)
    assert handle != other
    image = video.getImageRemote(handle)
    width, height, layers = image[:3]
    assert (width, height, layers, image[3]) == (320, 240, 3, 11)
    assert isinstance(image[6], bytes | bytearray)
    assert len(image[6]) == width * height * layers
    assert len(set(image[6])) > 50
    assert len(video.getImageRemote(other)[6]) == 320 * 240 * 2
    assert video.unsubscribe(handle) is True
    with pytest.raises(RuntimeError, match=handle):
        video.getImageRemote(handle)
    with pytest.raises(RuntimeError, match="resolution"):
        video.subscribeCamera("ROS", 0, 99, 11, 10)


def test_positions_and_transforms_agree(motion: Any) -> None:
    x, y, z, *_ = motion.getPosition("LArm", 2, False)
    matrix = np.array(motion.getTransform("LArm", 2, False)).reshape(4, 4)
    assert matrix[:3, 3] == pytest.approx([x, y, z])
    assert matrix[3] == pytest.approx([0, 0, 0, 1])
    assert 0.3 < z < 1.0


def test_a_naoqi_that_was_killed_finds_the_robot_awake(stand_in: StandIn) -> None:
    os.kill(stand_in.naoqi_process.pid, signal.SIGKILL)
    stand_in.naoqi_process.wait()
    stand_in.start_naoqi()
    with connected(stand_in.url) as session:
        motion = session.service("ALMotion")
        assert motion.robotIsWakeUp() is True
        assert set(motion.getStiffnesses("Leg")) == {1.0}
        assert motion.moveTo(0.0, 0.0, 0.1) is True


def test_without_the_owners_consent_safety_stays_on() -> None:
    with StandIn("mujoco") as stand_in, connected(stand_in.url) as session:
        motion = session.service("ALMotion")
        for method, *arguments in (
            ("setExternalCollisionProtectionEnabled", "All", False),
            ("setExternalCollisionProtectionEnabled", "Move", False),
            ("setFallManagerEnabled", False),
            ("setPushRecoveryEnabled", False),
        ):
            with pytest.raises(RuntimeError, match="/advanced/#/settings"):
                getattr(motion, method)(*arguments)
        motion.setExternalCollisionProtectionEnabled("Arms", False)
        motion.setCollisionProtectionEnabled("Arms", False)
        assert motion.getFallManagerEnabled()
        assert motion.getExternalCollisionProtectionEnabled("Move")
        assert not motion.getExternalCollisionProtectionEnabled("All")
        # Asleep it moves nothing: no motors.
        assert motion.moveTo(0.1, 0.0, 0.0) is False
