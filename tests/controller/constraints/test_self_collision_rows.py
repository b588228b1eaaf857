"""Rows of self-collision: all that accelerations could break, and those of arms that pass each other."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace
from math import inf

import numpy as np

from pepper_driver.config.arrays import FloatArray
from pepper_driver.controller import RobotModel
from pepper_driver.controller.constraints import BrakingLimits, SelfCollision
from pepper_driver.controller.constraints.braking import BrakingPath
from support.controller import DT, ROBOT, random_posture
from support.self_collision import SECURITY, SETTINGS, Ruler, braked, limits


def breakable(
    ruler: Ruler, q: FloatArray, v: FloatArray, braking_limits: BrakingLimits
) -> tuple[Counter[str], float]:
    """Names of all rows that an acceleration could break, found from all pairs, and the least distance at any place."""
    found: Counter[str] = Counter()
    least = inf
    for cycles in (inf, 1.0, 3.0):
        path = BrakingPath(len(v), cycles)
        path.update(v, braking_limits.brake, DT)
        if cycles < inf and np.abs(v / braking_limits.brake).max() <= cycles * DT:
            continue  # at rest by then
        distances = ruler(ruler.model.integrate(q, path.distance))
        every = list(range(len(distances)))
        gradient = ruler.capsules.wrenches(every) @ ruler.model.data.J * ruler.capsules.signs
        nearer = np.abs(gradient * path.gain) @ braking_limits.acceleration
        least = min(least, float(distances.min()))
        for pair in np.flatnonzero(distances - nearer < SECURITY):
            found[f"self-collision {ruler.capsules.names[pair]}"] += 1
    return found, least


def test_there_is_a_row_for_every_pair_that_an_acceleration_could_bring_too_near() -> None:
    random, ruler, model = np.random.default_rng(0), Ruler(), RobotModel(ROBOT)
    constraint, limit = SelfCollision(ROBOT), limits(model)
    braking_limits = BrakingLimits(limit, DT)
    rows_seen = states = 0
    for _ in range(4000):
        q = model.configuration(random_posture(random))
        if ruler(q).min() < SECURITY:
            continue
        v = random.uniform(-1, 1, model.nv) * np.minimum(2.0, 0.15 * limit)
        model.set_state(q, v)
        model.update_kinematics()
        expected, least = breakable(ruler, q, v, braking_limits)
        rows = constraint.compute_inequality(model, braking_limits)
        assert Counter(() if rows is None else rows.names) == expected
        rows_seen += sum(expected.values())
        states += least > SECURITY and bool(expected)
    assert rows_seen > 200
    assert states > 30  # with nothing too near yet


def test_arms_that_brake_past_each_other_are_seen_though_they_end_far_apart() -> None:
    """After a pair was near at the end of the path to rest, the whole path is checked."""
    settings = replace(SETTINGS, interaction_distance=0.03)
    constraint, ruler, model = SelfCollision(ROBOT, settings), Ruler(), RobotModel(ROBOT)
    braking_limits = BrakingLimits(limits(model), DT)
    meeting = np.zeros(17)
    meeting[:5] = -0.37, 0.26, -0.27, -0.62, -0.32
    meeting[5:11] = -0.5, 0.01, -0.34, -0.85, 1.37, 0.44
    meeting[11:] = -0.73, -0.26, 0.19, 0.85, 0.4, 0.24
    v, still = np.zeros((2, model.nv))
    v[model.joint_columns[5:9]] = -2.0, 2.0, -2.0, -2.0
    v[model.joint_columns[11:15]] = 2.0, -2.0, -2.0, -2.0
    path = BrakingPath(model.nv, 3.0)
    path.update(v, braking_limits.brake, DT)
    passing = model.configuration(meeting)
    q = model.integrate(passing, -path.distance)
    distances = [ruler(posture).min() for posture in braked(q, v, still, braking_limits.brake)]
    assert ruler(q).min() > SECURITY
    assert min(distances) < SECURITY
    assert distances[-1] > settings.interaction_distance

    model.set_state(passing, still)
    model.update_kinematics()
    assert not constraint.is_satisfied(model, braking_limits, still)
    model.set_state(q, v)
    model.update_kinematics()
    assert not constraint.is_satisfied(model, braking_limits, still)
