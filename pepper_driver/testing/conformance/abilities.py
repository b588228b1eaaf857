"""Abilities beyond the interface, and refusals where a backend lacks them."""

from __future__ import annotations

import logging
from collections.abc import Callable
from contextlib import suppress

import numpy as np
import pytest

from pepper_driver.backends import (
    Backend,
    BackendError,
    Capability,
    CapabilityError,
    DeviceError,
    NotConnectedError,
    RobotServices,
    Truth,
    make_backend,
    with_query,
)
from pepper_driver.backends.fields import TRUTH_FIELDS
from pepper_driver.config import PepperError, UnknownNameError
from pepper_driver.controller import RobotModel
from pepper_driver.testing.conformance.driving import ROBOT, BackendSuite, bits, hold, run

FORCE = np.array([0.0, 8.0, 0.0])
Pushes = dict[str, Callable[[Backend, str], None]]
PUSHES: Pushes = {
    "push": lambda backend, link: backend.push(link, FORCE, duration=0.3),
    "grab": lambda backend, link: backend.grab(link, np.array([0.0, 0.01, 0.0])),
}


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


SERVICES: dict[Capability, Callable[[RobotServices], None]] = {
    "speech": lambda services: services.say("hello"),
    "leds": lambda services: services.leds("FaceLeds", (0.0, 0.5, 1.0), 0.1),
    "tablet": lambda services: services.show_image("http://198.18.0.1/a.png"),
    "postures": lambda services: services.go_to_posture("Stand", 0.9),
    "wake": lambda services: services.wake_up(),
}


def sensed(uri: str) -> list[list[object]]:
    """All that a new robot measures at rest, bit by bit."""
    with make_backend(uri) as backend:
        first = backend.open()
        return [bits(sample) for sample in run(backend, hold(first), 0.3)]


class AbilityTests(BackendSuite):
    """Abilities beyond the interface, and refusals where a backend lacks them."""

    @pytest.mark.parametrize("name", ["push", "grab"])
    def test_it_is_pushed_where_it_says_so(
        self, backend: Backend, caplog: pytest.LogCaptureFixture, name: Capability
    ) -> None:
        call = PUSHES[name]
        with pytest.raises((CapabilityError, NotConnectedError)):
            call(backend, "LForeArm")
        first = backend.open()
        if name not in backend.info.capabilities:
            with pytest.raises(CapabilityError, match=name):
                call(backend, "LForeArm")
            return
        call(backend, "LForeArm")
        with pytest.raises(UnknownNameError, match="LForeArm"):
            call(backend, "LForearm")
        run(backend, hold(first), 0.1)
        backend.close()
        with pytest.raises(NotConnectedError):
            call(backend, "LForeArm")

    def test_a_wrong_push_is_refused(self, backend: Backend) -> None:
        first = backend.open()
        for arguments in WRONG:
            with pytest.raises(PepperError):
                backend.push("LForeArm", **arguments)  # type: ignore[arg-type]
        run(backend, hold(first), 0.05)

    def test_a_push_moves_joint_and_current(self, backend: Backend) -> None:
        backend.open()
        if "push" not in backend.info.capabilities or not self.follows:
            pytest.skip("it cannot be pushed")
        held = hold(backend.activate())
        still = run(backend, held, 0.3)[-1]
        backend.push("l_wrist", np.array([0.0, 0.0, -25.0]), duration=0.6)
        samples = run(backend, held, 0.6)
        moved = np.max([np.abs(m.position - still.position) for m in samples], axis=0)
        arm = [backend.info.joint_names.index(name) for name in ("LShoulderPitch", "LElbowRoll")]
        assert moved[arm].max() > 0.005

    def test_the_truth_is_there_where_it_says_so(self, backend: Backend) -> None:
        first = backend.open()
        if "truth" not in backend.info.capabilities:
            with pytest.raises(CapabilityError, match="truth"):
                _ = backend.truth
            return
        truth = backend.truth
        assert isinstance(truth, Truth)
        run(backend, hold(first), 0.1)
        sample = truth.sample()
        for field in TRUTH_FIELDS[1:]:
            array, elements = getattr(sample, field.attribute), field.elements(ROBOT) or ()
            assert (array.shape, array.dtype) == ((len(elements),), field.type), field.source
            assert np.isfinite(array).all(), field.source
        assert truth.kinetic_energy >= 0.0
        assert not truth.fallen
        assert truth.contacts == ()
        np.testing.assert_allclose(sample.contact_torque, 0.0, atol=1e-9)
        assert np.abs(sample.position - first.position).max() < 0.1
        hand = RobotModel(ROBOT).link_pose("l_wrist", sample.position)
        assert np.linalg.norm(truth.link_pose("l_wrist")[:3, 3] - hand[:3, 3]) < 0.01
        with pytest.raises(UnknownNameError, match="l_wrist"):
            truth.link_pose("l_wrst")
        kept = sample.position.copy()
        backend.activate()
        np.testing.assert_array_equal(sample.position, kept)

    def test_the_truth_of_a_push_is_the_torque_of_its_force(self, backend: Backend) -> None:
        """J^T f, by a model of its own, while a push is at its strongest."""
        first = backend.open()
        if not {"push", "truth"} <= backend.info.capabilities:
            pytest.skip("it cannot be pushed, or does not know by what")
        held = hold(backend.activate() if self.follows else first)
        point, model = np.array([0.05, 0.0, 0.02]), RobotModel(ROBOT)
        backend.push("LForeArm", FORCE, point, duration=0.6)
        run(backend, held, 0.3)
        truth = backend.truth
        (contact,) = truth.contacts
        assert (contact.kind, contact.link, contact.object) == ("push", "LForeArm", None)
        np.testing.assert_allclose(contact.force, FORCE, atol=1e-6)
        assert contact.peak == pytest.approx(np.linalg.norm(FORCE), rel=1e-6)
        place = truth.link_pose("LForeArm") @ [*point, 1.0]
        assert np.linalg.norm(contact.point - place[:3]) < 2e-3
        torque = model.point_jacobian("LForeArm", point, truth.position).T @ FORCE
        np.testing.assert_allclose(truth.contact_torque, torque, atol=0.05)
        np.testing.assert_allclose(contact.torque, truth.contact_torque, atol=1e-9)
        assert (truth.peak_torque >= np.abs(truth.contact_torque) - 1e-9).all()
        run(backend, held, 0.4)
        assert truth.contacts == ()

    def test_its_noise_is_that_of_its_seed(self, backend: Backend) -> None:
        if "seed" not in backend.info.capabilities:
            pytest.skip("its URI takes no seed")
        one, again, other = (sensed(with_query(backend.uri, seed=seed)) for seed in (1, 1, 2))
        assert one == again
        assert one != other

    def test_what_is_pushed_is_known(self, backend: Backend) -> None:
        backend.open()
        if not {"push", "grab"} & backend.info.capabilities:
            with pytest.raises(CapabilityError, match="no simulation"):
                _ = backend.plant
            return
        plant = backend.plant
        for array in (plant.stiffness, plant.torque_limit, plant.friction):
            assert array.shape == (17,)
            assert (array >= 0).all()
        assert (plant.stiffness > 0).all()
        assert (plant.torque_limit > 0).all()
        assert isinstance(plant.rolling, bool)

    def test_its_own_diagnosis_is_none_or_a_list(self, backend: Backend) -> None:
        with suppress(NotConnectedError):
            assert not backend.diagnosis(), "of a robot that is not there"
        backend.open()
        found = backend.diagnosis()
        assert found is None or all(isinstance(device, DeviceError) for device in found)

    def test_services_are_done_or_said_to_be_lacking(
        self, backend: Backend, caplog: pytest.LogCaptureFixture
    ) -> None:
        services = backend.services
        backend.open()
        has = [name for name in SERVICES if name in backend.info.capabilities]
        backend.close()
        for name in has:
            with pytest.raises(NotConnectedError):
                SERVICES[name](services)
        backend.open()
        for name in has:
            SERVICES[name](services)
        lacking = [name for name in SERVICES if name not in has]
        with caplog.at_level(logging.WARNING, logger="pepper_driver"):
            for name in 2 * lacking:
                SERVICES[name](services)
            backend.close()
            for name in lacking:
                SERVICES[name](services)
        messages = [r.getMessage() for r in caplog.records if "nothing happens" in r.getMessage()]
        assert len(messages) == len(lacking), "once each"
        assert all(backend.uri in text for text in messages)
        assert backend.services is services

    def test_only_one_program_moves_the_robot(self, backend: Backend) -> None:
        backend.open()
        held = hold(backend.activate())
        for name in ("postures", "wake"):
            if name in backend.info.capabilities:
                with pytest.raises(BackendError):
                    SERVICES[name](backend.services)
        run(backend, held, 0.1)
