"""A recorded run once more: what observer and reflexes make of it now, beside what they made of it then."""

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
