"""A robot without physics."""

from typing import Any

from pepper_driver import Pepper


def make_pepper(**arguments: Any) -> Pepper:
    """A Pepper whose joints are where they are sent, and that feels nothing unless told otherwise."""
    return Pepper("mock", **{"observer": None, **arguments})
