"""Delays of the connection between a program and the stand-in: ``networks/*.yaml``, or a file of the user's own."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field
from pydantic.dataclasses import dataclass

from pepper_driver.config.lines import with_lines
from pepper_driver.config.loading import STRICT, named_file, parse, read_yaml, shipped_names

Seconds = Annotated[float, Field(ge=0, le=60)]


@dataclass(frozen=True, kw_only=True, config=STRICT)
class Network:
    """Delay of each packet in each direction, drawn again. No packet overtakes another: all behind a stalled one wait.

    Attributes:
        delay: What every packet takes at least [s].
        jitter: Mean of the exponentially distributed rest [s].
        stall_probability: Of the packets that wait for ``stall`` [s] on top.
    """

    name: str
    description: str = ""
    delay: Seconds
    jitter: Seconds
    stall_probability: Annotated[float, Field(ge=0, le=1)]
    stall: Seconds


def network_names() -> tuple[str, ...]:
    """Names of the shipped networks."""
    return shipped_names("networks")


@with_lines
def load_network(name: str) -> Network:
    """Return the network that ``name`` stands for: a shipped one, or a path that ends in ``.yaml``.

    Raises:
        UnknownNameError: No shipped network of this name.
        ConfigError: The file is wrong.
    """
    path = named_file("network", name, "networks")
    return parse(Network, read_yaml(path), str(path))
