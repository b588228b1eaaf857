"""Hands on the robot of the stand-in that are moved from another process."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields
from itertools import count
from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike

from pepper_driver.backends.interface import Backend, BackendError, finite_numbers
from pepper_driver.backends.simulated import Hand, TrueContact
from pepper_driver.config.arrays import FloatArray

_VECTORS = ("point", "force", "torque")
"""Attributes of a contact that are arrays."""


@dataclass(frozen=True, kw_only=True)
class TrueScene:
    """Truth of the stand-in's robot at the end of one cycle, as a picture of it needs it.

    Attributes:
        position: (17,) link-side joint positions [rad].
        base: (3,) x, y [m], yaw [rad] of the base in the world.
        tilt: (2,) pitch, roll of the base [rad].
        contacts: Of the cycle.
    """

    position: FloatArray
    base: FloatArray
    tilt: FloatArray
    contacts: tuple[TrueContact, ...]

    @staticmethod
    def message(backend: Backend) -> dict[str, Any]:
        """Return the scene of a simulation as JSON has it."""
        truth = backend.truth
        return {
            "position": truth.position.tolist(),
            "base": truth.base.tolist(),
            "tilt": truth.tilt.tolist(),
            "contacts": [
                {
                    part.name: value.tolist() if isinstance(value, np.ndarray) else value
                    for part in fields(contact)
                    for value in (getattr(contact, part.name),)
                }
                for contact in truth.contacts
            ],
        }

    @classmethod
    def from_message(cls, message: Mapping[str, Any]) -> Self:
        """Return the scene of a message."""
        return cls(
            position=np.array(message["position"]),
            base=np.array(message["base"]),
            tilt=np.array(message["tilt"]),
            contacts=tuple(_contact(**values) for values in message["contacts"]),
        )


def _contact(**values: Any) -> TrueContact:  # noqa: ANN401 of JSON
    vectors: dict[str, Any] = {name: np.array(values.pop(name)) for name in _VECTORS}
    return TrueContact(**vectors, **values)


class HeldHands:
    """The hands in the robot's process, by number.

    Args:
        backend: The simulated robot.
    """

    def __init__(self, backend: Backend) -> None:
        self._backend = backend
        self._hands: dict[int, Hand] = {}
        self._numbers = count(1)

    def take(self, **arguments: Any) -> int:  # noqa: ANN401 checked by the backend
        """Take a link, see :meth:`Backend.take_hand`; return the number of the hand."""
        hand = self._backend.take_hand(**arguments)
        self._hands = {number: one for number, one in self._hands.items() if one.holds}
        number = next(self._numbers)
        self._hands[number] = hand
        return number

    def move(self, number: int, position: list[float], max_force: float | None) -> None:
        """Move a hand; one that has let go stays away."""
        if (hand := self._hands.get(number)) is not None:
            hand.move(position, max_force=max_force)

    def release(self, number: int) -> None:
        """Let go."""
        if (hand := self._hands.get(number)) is not None:
            hand.release()

    def look(self, number: int) -> dict[str, Any]:
        """Return where a hand is, and what it does.

        Raises:
            BackendError: It let go long ago.
        """
        hand = self._hands.get(number)
        if hand is None:
            raise BackendError(f"hand {number} has let go")
        return {
            "holds": hand.holds,
            "force": hand.force.tolist(),
            "point": hand.point.tolist(),
            "position": hand.position.tolist(),
        }


class RemoteHand(Hand):
    """A hand on the stand-in's robot, seen from another process.

    Args:
        ask: Asks the robot's process.
        number: Of the hand there.
    """

    def __init__(self, ask: Callable[..., Any], number: int) -> None:
        self._ask, self._number = ask, number

    def move(self, position: ArrayLike, *, max_force: float | None = None) -> None:
        """Set where the hand is to go, and what it can do."""
        goal = finite_numbers("hand: position", position, 3).tolist()
        self._ask("move_hand", number=self._number, position=goal, max_force=max_force)

    def release(self) -> None:
        """Let go."""
        self._ask("release_hand", number=self._number)

    @property
    def holds(self) -> bool:
        """True until it has let go."""
        return bool(self._look()["holds"])

    @property
    def force(self) -> FloatArray:
        """(3,) force on the robot in the last step of physics, in the world [N]."""
        return np.array(self._look()["force"])

    @property
    def point(self) -> FloatArray:
        """(3,) where it holds the link, in the world [m]."""
        return np.array(self._look()["point"])

    @property
    def position(self) -> FloatArray:
        """(3,) of the hand itself, in the world [m]."""
        return np.array(self._look()["position"])

    def _look(self) -> dict[str, Any]:
        state: dict[str, Any] = self._ask("look_at_hand", number=self._number)
        return state
