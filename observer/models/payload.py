r"""Load torque of payloads that links carry, linear in their masses and first moments.

A payload of mass m with its centre at c, in the frame of the link, needs on its way the force f and the moment n about
the origin of the link:

    f = m a + dw x m c + w x (w x m c),      n = m c x a

with w and dw the angular velocity and acceleration of the link, and a the acceleration of its origin minus gravity. The
inertia about the origin is neglected. On a joint with the axis z at a distance r from the origin, its torque is
z . (n + r x f). The base stands.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from pepper_driver.config.arrays import FloatArray, IntArray
from pepper_driver.config.kernels import Block, Matrix, Out, kernel
from pepper_driver.controller.model import RobotModel

QUANTITIES = 4
"""Of a payload: m [kg], m c_x, m c_y, m c_z [kg m]."""


BASE_JOINT = 1
"""Number of the joint that moves the base in Pinocchio's model."""


@kernel
def add_cross(a: FloatArray, b: FloatArray, total: Out[FloatArray]) -> None:
    """Add a x b to a vector."""
    total[0] += a[1] * b[2] - a[2] * b[1]
    total[1] += a[2] * b[0] - a[0] * b[2]
    total[2] += a[0] * b[1] - a[1] * b[0]


@kernel
def add_centripetal(w: FloatArray, r: FloatArray, total: Out[FloatArray]) -> None:
    """Add w x (w x r) to a vector."""
    wr = w[0] * r[0] + w[1] * r[1] + w[2] * r[2]
    ww = w[0] * w[0] + w[1] * w[1] + w[2] * w[2]
    for i in range(3):
        total[i] += w[i] * wr - ww * r[i]


@kernel
def multiply(
    a: Matrix[FloatArray], b: Matrix[FloatArray], product: Out[Matrix[FloatArray]]
) -> None:
    """Compute the product of two (3, 3) matrices."""
    for i in range(3):
        for k in range(3):
            product[i, k] = a[i, 0] * b[0, k] + a[i, 1] * b[1, k] + a[i, 2] * b[2, k]


@kernel
def transform(matrix: Matrix[FloatArray], vector: FloatArray, product: Out[FloatArray]) -> None:
    """Compute the product of a (3, 3) matrix and a vector."""
    for i in range(3):
        row = matrix[i]
        product[i] = row[0] * vector[0] + row[1] * vector[1] + row[2] * vector[2]


@kernel
def turn(axis: FloatArray, angle: float, rotation: Out[Matrix[FloatArray]]) -> None:
    """Compute the (3, 3) rotation about a unit axis by an angle [rad] (Rodrigues)."""
    x, y, z = axis
    sine, cosine = math.sin(angle), math.cos(angle)
    for i in range(3):
        for k in range(3):
            rotation[i, k] = (1.0 - cosine) * axis[i] * axis[k]
        rotation[i, i] += cosine
    rotation[0, 1] -= sine * z
    rotation[0, 2] += sine * y
    rotation[1, 0] += sine * z
    rotation[1, 2] -= sine * x
    rotation[2, 0] -= sine * y
    rotation[2, 1] += sine * x


@kernel
def _compute(
    parents: IntArray,
    joints: IntArray,
    places: Matrix[FloatArray],
    frames: Block[FloatArray],
    axes: Matrix[FloatArray],
    carriers: IntArray,
    gravity: FloatArray,
    position: FloatArray,
    velocity: FloatArray,
    acceleration: FloatArray,
    regressor: Out[Matrix[FloatArray]],
) -> None:
    """Compute the regressor from the motion of the links, which comes from that of their parents.

    Args:
        parents: Of each link, the number of its parent. Link 0 is the base.
        joints: Of each link, the joint that turns it against its parent.
        places: (links, 3) origin in the frame of the parent [m].
        frames: (links, 3, 3) rotation to the parent at an angle of 0.
        axes: (links, 3) axis of the joint.
        carriers: Links with the payloads.
        gravity: (3,) [m/s2].
        position: (n,) of the joints [rad].
        velocity: (n,) [rad/s]
        acceleration: (n,) [rad/s2]
        regressor: (n, 4 carriers) torque on the joints per m and m c.
    """
    links = len(parents)
    rotation, product, turned = np.empty((links, 3, 3)), np.empty((3, 3)), np.empty((3, 3))
    origin, axis = np.zeros((links, 3)), np.zeros((links, 3))
    w, dw, a = np.zeros((links, 3)), np.zeros((links, 3)), np.zeros((links, 3))
    arm, swing = np.empty(3), np.empty(3)
    for i in range(3):
        a[0, i] = -gravity[i]
        for k in range(3):
            rotation[0, i, k] = 1.0 if i == k else 0.0
    for link in range(1, links):
        parent, j = parents[link], joints[link]
        multiply(rotation[parent], frames[link], product)
        turn(axes[link], position[j], turned)
        multiply(product, turned, rotation[link])
        transform(product, axes[link], axis[link])
        transform(rotation[parent], places[link], arm)
        for i in range(3):
            origin[link, i] = origin[parent, i] + arm[i]
            swing[i] = axis[link, i] * velocity[j]
            w[link, i] = w[parent, i] + swing[i]
            dw[link, i] = dw[parent, i] + axis[link, i] * acceleration[j]
            a[link, i] = a[parent, i]
        add_cross(w[parent], swing, dw[link])
        add_cross(dw[parent], arm, a[link])
        add_centripetal(w[parent], arm, a[link])

    regressor[:] = 0.0
    force, moment, torque, direction = np.empty(3), np.empty(3), np.empty(3), np.empty(3)
    for number in range(len(carriers)):
        carrier = carriers[number]
        for quantity in range(QUANTITIES):
            force[:], moment[:] = 0.0, 0.0
            if quantity == 0:
                force[:] = a[carrier]
            else:
                direction[:] = rotation[carrier, :, quantity - 1]
                add_cross(dw[carrier], direction, force)
                add_centripetal(w[carrier], direction, force)
                add_cross(direction, a[carrier], moment)
            link = carrier
            while link > 0:
                for i in range(3):
                    arm[i], torque[i] = origin[carrier, i] - origin[link, i], moment[i]
                add_cross(arm, force, torque)
                regressor[joints[link], QUANTITIES * number + quantity] = (
                    axis[link, 0] * torque[0]
                    + axis[link, 1] * torque[1]
                    + axis[link, 2] * torque[2]
                )
                link = parents[link]


class PayloadRegressor:
    """Load torque of payloads per mass m [kg] and first moment m c [kg m].

    Args:
        model: Of the robot.
        carriers: Joints that carry the links with the payloads.
    """

    def __init__(self, model: RobotModel, carriers: Sequence[str]) -> None:
        pin, names = model.pin, model.robot.joint_names
        found = set()
        for number in map(model.joint_id, carriers):
            while number > BASE_JOINT:
                found.add(number)
                number = pin.parents[number]
        self._width = len(names)
        links = sorted(found)  # children after their parents
        place = {BASE_JOINT: 0, **{number: link for link, number in enumerate(links, 1)}}
        self._carriers = np.array([place[model.joint_id(name)] for name in carriers])
        self._parents = np.array([0, *(place[pin.parents[number]] for number in links)])
        self._joints = np.array([-1, *(names.index(pin.names[number]) for number in links)])
        placements = [pin.jointPlacements[number] for number in links]
        self._places = np.array([np.zeros(3), *(p.translation for p in placements)])
        self._frames = np.array([np.eye(3), *(p.rotation for p in placements)])
        data = pin.createData()
        axes = (np.array(data.joints[number].S).reshape(6)[3:] for number in links)
        self._axes = np.array([np.zeros(3), *axes])
        self._gravity = np.array(pin.gravity.linear)
        self._compute = _compute.load()

    def compute(
        self, position: FloatArray, velocity: FloatArray, acceleration: FloatArray
    ) -> FloatArray:
        """Return the (n, 4 carriers) torques, a new array.

        Args:
            position: (n,) [rad]
            velocity: (n,) [rad/s]
            acceleration: (n,) [rad/s2]
        """
        regressor = np.empty((self._width, QUANTITIES * len(self._carriers)))
        self._compute(
            self._parents,
            self._joints,
            self._places,
            self._frames,
            self._axes,
            self._carriers,
            self._gravity,
            position,
            velocity,
            acceleration,
            regressor,
        )
        return regressor
