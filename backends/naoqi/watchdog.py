"""How old what is known of the robot is: the figure by which the safety gate holds and stops it."""

from __future__ import annotations

PAUSE = 5.0
"""[cycles] without a tick that are more than some that were missed: nobody looked after the robot meanwhile."""

NORMAL_AGE = 0.072
"""[s] since the cycle of a sample, which takes 7 to 15 ms to its tick. Younger ones are late by whole cycles, as the
observer counts; older ones are as old as they are."""


def sample_age(late: int, since: float, silence: float, watched: float, cycle: float) -> float:
    """Return the age of the newest sample as :class:`~pepper_driver.backends.interface.Measurement` has it [s].

    The sample of the tick's cycle has none, whatever its way took. When samples stay away for long, nothing is
    deducted: the gate, which looks once a cycle, then stops the robot before the last good one came 100 ms ago. A robot
    that sends samples but takes no commands is no better than one that is silent.

    After a pause without ticks, between two runs, the robot is given the time to answer that it has when it is watched:
    what came before the pause tells nothing of it.

    Args:
        late: Cycles by which the newest sample is later than usual.
        since: Time since its cycle [s].
        silence: Time for which nothing that was sent has been acknowledged [s].
        watched: Time since ticks last began after a pause [s].
        cycle: Of the robot [s].
    """
    age = late * cycle if since <= NORMAL_AGE else since
    if silence > NORMAL_AGE:
        age = max(age, silence)
    return min(age, watched + cycle)
