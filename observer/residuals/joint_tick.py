"""One tick of mode ``fusion`` by joint, in records: its command, and all that follows from its sample.

A kernel with many arrays spends more time on its arguments than on its arithmetic. The stages of mode ``fusion``
therefore read and write records, one after the other. :class:`~pepper_driver.observer.interface.Residuals` has copies.
"""

from __future__ import annotations


class JointCommand:
    """Command of one joint.

    Attributes:
        target: Position sent [rad].
        load_torque: Desired, with that of the load in the hand [N m].
        velocity: Desired [rad/s].
        acceleration: Desired [rad/s2].
    """

    target: float
    load_torque: float
    velocity: float
    acceleration: float


class JointTick:
    """Sample of one joint, and the results of the stages.

    Attributes:
        measured: Position [rad].
        current: Absolute [A].
        limited: True if the safety gate altered the command.
        good: True if the sample can be judged.
        blind: True if the joint cannot be judged: this sample, or one that is still in the filter.
        change: Derivative of the tracking error [rad/s].
        motor: Torque of the motor / K, by its current [rad].
        output: Of the law of its board, for the measured error [rad].
        jumps: True if the target of its board jumps; never while its limb is touched.
        by_model: Residual by the stick-slip model, filtered [rad].
        by_current: Residual by the current, filtered [rad].
        raw: Residual on which both agree, before the filter [rad]; NaN if the sample cannot be judged.
        residual: The same, filtered; of a joint that is touched the one by the current; NaN if it is blind.
        own_threshold: Threshold by phase and load of the joint [rad].
        raised_threshold: The same, raised if the joint is in doubt.
        threshold: The same, lowered with those of its limb; NaN if it is blind.
        doubtful: True if it rests off its place, and its motor does not work against that.
        sliding: True if it slides without touch, so that it shows the load of its hand.
    """

    measured: float
    current: float
    limited: bool
    good: bool
    blind: bool
    change: float
    motor: float
    output: float
    jumps: bool
    by_model: float
    by_current: float
    raw: float
    residual: float
    own_threshold: float
    raised_threshold: float
    threshold: float
    doubtful: bool
    sliding: bool
