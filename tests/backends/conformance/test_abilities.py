"""What a backend can do beyond the interface, and what it says where it cannot."""

from __future__ import annotations

import logging
from collections.abc import Callable
from contextlib import suppress

import numpy as np
import pytest

from conformance.cases import Case, hold, run
from pepper_driver.backends import (
    Backend,
    BackendError,
    Capability,
    CapabilityError,
    DeviceError,
    Extras,
    NotConnectedError,
    Truth,
)
from pepper_driver.config import PepperError, UnknownNameError

FORCE = np.array([0.0, 8.0, 0.0])
Pushes = dict[str, Callable[[Backend, str], None]]
PUSHES: Pushes = {
    "push": lambda backend, link: backend.push(link, FORCE, duration=0.3),
    "grab": lambda backend, link: backend.grab(link, np.array([0.0, 0.01, 0.0])),
}


@pytest.mark.parametrize("name", ["push", "grab"])
def test_it_is_pushed_where_it_says_so(
    backend: Backend, caplog: pytest.LogCaptureFixture, name: Capability
) -> None:
    call = PUSHES[name]
    with pytest.raises((CapabilityError, NotConnectedError)):
        call(backend, "LForeArm")
    first = backend.open()
    if name not in backend.info.capabilities:
        with pytest.raises(CapabilityError, match=name):
            call(backend, "LForeArm")
        with pytest.raises(CapabilityError, match="no simulation"):
            _ = backend.plant
        return
    assert (backend.plant.torque_limit > 0.0).all()
    call(backend, "LForeArm")
    with pytest.raises(UnknownNameError, match="LForeArm"):
        call(backend, "LForearm")
    run(backend, hold(first), 0.1)
    backend.close()
    with pytest.raises(NotConnectedError):
        call(backend, "LForeArm")


WRONG: tuple[dict[str, object], ...] = (
    {"force": np.array([0.0, np.nan, 0.0])},
    {"force": np.zeros(2)},
    {"force": "sideways"},
    {"force": FORCE, "point": np.zeros(2)},
    {"force": FORCE, "duration": "long"},
    {"force": FORCE, "duration": 0.0},
    {"force": FORCE, "duration": np.inf},
    {"force": FORCE, "delay": -1.0},
    {"force": FORCE, "rise": np.nan},
    {"force": FORCE, "frame": "torso"},
)


def test_a_wrong_push_is_refused(backend: Backend) -> None:
    first = backend.open()
    for arguments in WRONG:
        with pytest.raises(PepperError):
            backend.push("LForeArm", **arguments)  # type: ignore[arg-type]
    run(backend, hold(first), 0.05)


def test_a_push_is_felt(backend: Backend, case: Case) -> None:
    backend.open()
    if "push" not in backend.info.capabilities or not case.follows:
        pytest.skip("it cannot be pushed")
    wanted = hold(backend.activate())
    still = run(backend, wanted, 0.3)[-1]
    backend.push("l_wrist", np.array([0.0, 0.0, -25.0]), duration=0.6)
    samples = run(backend, wanted, 0.6)
    moved = np.max([np.abs(m.position - still.position) for m in samples], axis=0)
    arm = [backend.info.joint_names.index(name) for name in ("LShoulderPitch", "LElbowRoll")]
    assert moved[arm].max() > 0.005


def test_the_truth_is_there_where_it_says_so(backend: Backend) -> None:
    first = backend.open()
    if "truth" not in backend.info.capabilities:
        with pytest.raises(CapabilityError, match="truth"):
            _ = backend.truth
        return
    truth = backend.truth
    assert isinstance(truth, Truth)
    run(backend, hold(first), 0.1)
    sample = truth.sample()
    assert np.abs(sample.position - first.position).max() < 0.1
    kept = sample.position.copy()
    backend.activate()
    np.testing.assert_array_equal(sample.position, kept)


def test_what_is_pushed_is_known(backend: Backend) -> None:
    backend.open()
    if "push" not in backend.info.capabilities:
        with pytest.raises(CapabilityError):
            _ = backend.plant
        return
    plant = backend.plant
    for array in (plant.stiffness, plant.torque_limit):
        assert array.shape == (17,)
        assert (array > 0).all()


def test_its_own_diagnosis_is_none_or_a_list(backend: Backend) -> None:
    with suppress(NotConnectedError):
        assert not backend.diagnosis(), "of a robot that is not there"
    backend.open()
    found = backend.diagnosis()
    assert found is None or all(isinstance(device, DeviceError) for device in found)


EXTRAS: dict[Capability, Callable[[Extras], None]] = {
    "speech": lambda extras: extras.say("hello"),
    "leds": lambda extras: extras.leds("FaceLeds", (0.0, 0.5, 1.0), 0.1),
    "tablet": lambda extras: extras.show_image("http://198.18.0.1/a.png"),
    "postures": lambda extras: extras.go_to_posture("Stand", 0.9),
    "wake": lambda extras: extras.wake_up(),
}


def test_extras_are_done_or_said_to_be_lacking(
    backend: Backend, caplog: pytest.LogCaptureFixture
) -> None:
    extras = backend.extras
    backend.open()
    has = [name for name in EXTRAS if name in backend.info.capabilities]
    backend.close()
    for name in has:
        with pytest.raises(NotConnectedError):
            EXTRAS[name](extras)
    backend.open()
    for name in has:
        EXTRAS[name](extras)
    lacking = [name for name in EXTRAS if name not in has]
    with caplog.at_level(logging.WARNING, logger="pepper_driver"):
        for name in 2 * lacking:
            EXTRAS[name](extras)
        backend.close()
        for name in lacking:
            EXTRAS[name](extras)
    told = [r.getMessage() for r in caplog.records if "nothing happens" in r.getMessage()]
    assert len(told) == len(lacking), "once each"
    assert all(backend.uri in text for text in told)
    assert backend.extras is extras


def test_only_one_program_moves_the_robot(backend: Backend) -> None:
    backend.open()
    wanted = hold(backend.activate())
    for name in ("postures", "wake"):
        if name in backend.info.capabilities:
            with pytest.raises(BackendError):
                EXTRAS[name](backend.extras)
    run(backend, wanted, 0.1)
