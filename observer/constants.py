"""Run-time constants of mode ``fusion``, with those of its settings in ``observer.yaml``.

They decide if, when and on which limb a contact is reported. Each was chosen on simulated development robots;
docs/observer.md shows what half and twice its value change (`benchmarks/sensitivity.py`).
"""

from __future__ import annotations

import numpy as np

# -- spreads and thresholds -------------------------------------------------------------------------------------------

MIN_SPREAD = np.radians(0.1)
"""[rad] Smallest spread: a step of the encoder. A board whose target is farther behind its command follows another.
Torque of a current / K up to which it may have passed zero between two samples."""

MIN_TORQUE = 0.08
"""[N m] Smallest threshold as a torque: 100 g in a hand, unknown to the robot's description, turn a wrist."""

TAIL = 0.37
"""Growth of the largest residual per spread, as the time in which it is looked for grows by a factor of e."""

SLIDING_TAIL = 0.15
"""The same of joints of limbs in motion that lasts: their friction has its direction."""

EXCURSIONS = 5000.0
"""In an hour of free motion of the whole robot, residuals leave their spread about so many times."""

RISE = 0.002
"""Growth of the spread in a tick whose residual is beyond it: ten minutes take it down again by a factor of e.
Growth of the variance of a load in an update, which forgets it within a minute of motion."""

QUIET_RATIO = 0.5
"""Fraction of a threshold below which a residual is used for learning, and a touch is over; of the largest ratio of
residual and threshold in a limb, below which the contact only shakes a joint."""

UNSURE_FACTOR = 2.0
"""By which something may be off that was identified: the spread of today; a threshold while the safety gate alters the
command, and in doubt; the current of a board against the output of its law."""

HELD_FACTOR = 1.4
"""On the threshold of a joint that is to move, or was CORRECTION_TIME ago, and does not slide for SETTLING_TICKS; and
on that of the base while joints move. Friction lets go of a joint sooner or later than its model. On those of all
joints while the robot shakes itself, of parts that a touch on another part shakes, and of the base after a touch."""

CONFIRMING_RATIO = 0.55
"""On the thresholds of the limb that shows most, just after the base was pushed: one sign confirms the other."""

# -- times ------------------------------------------------------------------------------------------------------------

PUSH_TICKS = 12
"""In which a push that begins shows in all joints that it turns: friction holds it back for a moment."""

SETTLING_TICKS = 25
"""In which a joint, its current and the base settle: 0.3 s. A joint that swings may take longer."""

CORRECTION_TIME = 1.5
"""[s] Time constant of models that follow what they do not know: rest positions, integrals, level of the robot."""

BIAS_TIME = 15.0
"""[s] Time constant with which the bias of a free joint follows its residual: joints differ from those identified."""

SMOOTHING_TIME = 0.03
"""[s] Time constant of the derivatives: an encoder step of 0.09 deg in one tick is 0.13 rad/s."""

# -- load of a hand --------------------------------------------------------------------------------------------------

LOAD_MASS_STD = 0.4
"""[kg] Standard deviation of its mass before it has shown: twice it covers half a kilogram and a wrong stiffness."""

LOAD_PLACE_STD = 0.03
"""[m] Standard deviation of its centre around the origin of the hand."""

# -- motion -----------------------------------------------------------------------------------------------------------

REST_SPEED = 0.02
"""[rad/s] Up to it a joint or a wheel counts as at rest. Friction may hold it."""

ROCKING_SPEED = 0.2
"""[rad/s] Desired speed of joints below which they do not rock the base, unless it changes by as much within
REPORT_DELAY: a joint that starts is fast before a contact is reported."""

SHAKING_ACCELERATION = 8.0
"""[rad/s2] Desired acceleration of joints from which they shake the base more than its model predicts."""

# -- sign of the current ----------------------------------------------------------------------------------------------

MIN_DRIVE = np.radians(0.75)
"""[rad] Output of the law of a board up to which its sign is not known. By UNSURE_FACTOR smaller while the base shows a
push, and for a current that shows no sign."""

MAX_TARGET_DRIFT = np.radians(4.0)
"""[rad] Output of the law beyond which a board does not only follow another target: recorded ones are off by less."""

REVERSAL_RATIO = 0.3
"""Fraction of its recent size below which a current may have reversed: it passes zero then, and is smoothed."""

# -- friction ---------------------------------------------------------------------------------------------------------

FRICTION_RATIO = 0.7
"""Smallest threshold of a joint while it slides, over its friction: in slow motion friction lets go and holds again.
Fraction of its peak below which a constant residual within the friction band is not a hand: the hand has left, and
friction holds the joint away from its target. It is constant while it varies by less than the rest of itself, or of its
threshold if that is larger."""

# -- place ------------------------------------------------------------------------------------------------------------

REPORT_DELAY = 0.07
"""[s] The base often detects a push on a limb first, and the limb detects it within this time."""
