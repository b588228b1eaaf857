"""A drive on the test bench, in closed form: its error in ramps and, from holds made with other values, in holds."""

from __future__ import annotations

from collections.abc import Sequence
from math import inf

import numpy as np
from scipy.optimize import lsq_linear

from pepper_driver.config import TrackingTable
from pepper_driver.config.arrays import FloatArray
from pepper_driver.drive_values import DriveValues

STIFFNESSES = np.geomspace(40.0, 250.0, 49)
"""[N m/rad] that are tried; stiffer than these would ask for three times the currents seen in holds."""


def ramp_error(values: DriveValues, drag: float, delay: float, table: TrackingTable) -> FloatArray:
    """Closed form of the error in a steady ramp under load, (torques, moving velocities) [rad].

    Eq. 11 of the paper at constant velocity v and load tau, with transport: delay v + (drag v + tau + F sign(v)) / K.

    Args:
        values: K and F; a dead band adds to the error, an integral part is not in the closed form.
        drag: Torque by speed [N m s/rad].
        delay: [s].
        table: Velocities and torques.
    """
    v, tau = np.array(table.moving), np.array(table.torque)[:, None]
    pull = drag * v + tau + values.friction * np.sign(v)
    return np.asarray(delay * v + pull / values.stiffness + values.dead_band * np.sign(pull))


def closed_form_fit(table: TrackingTable, drag: float, delay: float) -> DriveValues:
    """K and F of the closed form by least squares over a table, K within :data:`STIFFNESSES`, F not negative."""
    v, tau = np.array(table.moving), np.array(table.torque)[:, None]
    shape = table.error.shape
    columns = [np.broadcast_to(c, shape).ravel() for c in (drag * v + tau, np.sign(v))]
    bounds = ([1 / STIFFNESSES[-1], 0.0], [1 / STIFFNESSES[0], inf])
    by_k, by_f = lsq_linear(
        np.stack(columns, axis=1), (table.error - delay * v).ravel(), bounds=bounds
    ).x
    return DriveValues(stiffness=float(1 / by_k), friction=float(by_f / by_k))


def predict_holds(
    before: DriveValues,
    candidates: Sequence[DriveValues],
    error: FloatArray,
    load: FloatArray,
    constant: float,
) -> tuple[FloatArray, FloatArray]:
    """What joints with other values would show in the same holds.

    The motor gives K (|e| - dead band); what that differs from the load is taken up by friction. A joint with other
    values is taken to stick at the same share of its friction, and to rest at the same share of its dead band.

    Args:
        before: The values with which the holds were made.
        candidates: m other sets of values.
        error: (n,) [rad].
        load: (n,) what gravity asks of the joint [N m].
        constant: N Kt [N m/A].

    Returns:
        (m, n) errors [rad] and currents [A], without sign.
    """
    beyond = np.maximum(np.abs(error) - before.dead_band, 0.0)
    share = (before.stiffness * np.sign(error) * beyond - load) / before.friction
    k, f, band = (
        np.array([[getattr(c, key)] for c in candidates])
        for key in ("stiffness", "friction", "dead_band")
    )
    inside = beyond == 0.0
    motor = np.where(inside, 0.0, load + f * share)
    rest = np.where(inside, error / max(before.dead_band, 1e-9) * band, np.sign(motor) * band)
    return np.asarray(rest + motor / k), np.abs(motor) / constant
