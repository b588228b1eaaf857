"""StopBase: the wheels stand still while somebody touches the robot."""

from __future__ import annotations

from dataclasses import dataclass

from pepper_driver.backends import Measurement
from pepper_driver.config.arguments import checked_arguments
from pepper_driver.observer import Observation
from pepper_driver.reflexes.reflex import Part, Reflex
from pepper_driver.reflexes.requests import ReflexRequests


@checked_arguments
@dataclass(kw_only=True, eq=False)
class StopBase(Reflex):
    """Brake the base as fast as its acceleration limits allow; arms and head go on."""

    priority: int = 50

    @property
    def takes(self) -> frozenset[Part]:
        """The base."""
        return frozenset({"base"})

    def act(
        self, observation: Observation, measurement: Measurement, requests: ReflexRequests
    ) -> None:
        """Stand still."""
        if requests.claim_base():
            requests.stop_base()
