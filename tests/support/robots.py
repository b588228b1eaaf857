"""A robot without physics."""

from typing import Any

from pepper_driver import Pepper


def make_pepper(**arguments: Any) -> Pepper:
    """A Pepper whose joints are where they are sent; without an observer by default."""
    return Pepper("mock", **{"observer": None, **arguments})
