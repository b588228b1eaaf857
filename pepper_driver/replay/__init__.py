"""Replay of a recorded run: output of observer and reflexes now, compared with that of the recording."""

from pepper_driver.replay.comparison import Comparison, compare
from pepper_driver.replay.logged_run import LoggedRun, ReplayError, load_run
from pepper_driver.replay.run import Replayed, replay

__all__ = [
    "Comparison",
    "LoggedRun",
    "ReplayError",
    "Replayed",
    "compare",
    "load_run",
    "replay",
]
