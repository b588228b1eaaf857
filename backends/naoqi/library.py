"""The library ``qi``, imported when a robot is asked for and not before: it exists for one kind of computer only."""

from __future__ import annotations

import importlib
import os
import platform
import sys
from typing import Any

from pepper_driver.config import MissingExtraError, PepperError

PLATFORMS = "Linux on x86-64 with Python 3.11 or 3.12"
"""For which there is a package ``qi``."""


class NoQiError(MissingExtraError):
    """The library ``qi`` is not there; the message says whether it can be had for this computer."""

    def __init__(self, here: str, *, possible: bool) -> None:
        super().__init__("a robot over NAOqi", "naoqi")
        if not possible:  # then the extra would install nothing
            ImportError.__init__(
                self,
                f"a robot over NAOqi needs the library qi (extra 'naoqi'), which exists for {PLATFORMS}; this is "
                f"{here}: run pepper_driver on such a computer, or in a container of that kind",
            )


class ImportOrderError(PepperError, ImportError):
    """The library ``qi`` would crash this process; the message says how to avoid it."""


def load_qi() -> Any:  # noqa: ANN401
    """The module ``qi``, quiet, and set to notice a link that was cut within about ten seconds.

    Raises:
        NoQiError: It is not installed.
        ImportOrderError: Pinocchio is there before it; see :mod:`pepper_driver.backends.naoqi.before_pinocchio`.
    """
    if "pinocchio" in sys.modules and "qi" not in sys.modules:
        raise ImportOrderError(
            "pinocchio was imported before NAOqi's library qi, and in this order they crash the process; in your "
            "program import pepper_driver, or qi, before pinocchio"
        )
    # Read when it is loaded: else it writes into the standard output of every program, and takes 30 s, not 10.
    os.environ.setdefault("QI_LOG_LEVEL", "0")
    os.environ.setdefault("QI_TCP_PING_TIMEOUT", "10")
    try:
        return importlib.import_module("qi")
    except ImportError as error:
        system, machine = platform.system(), platform.machine()
        here = f"{system} on {machine} with Python {platform.python_version()}"
        fits = (system, machine) == ("Linux", "x86_64") and sys.version_info < (3, 13)
        raise NoQiError(here, possible=fits) from error
