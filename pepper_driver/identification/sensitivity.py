"""Sensitivity to touch of identified models: their thresholds in degrees, newton metres and newtons; blind joints."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from pepper_driver.config import RobotConfig, load_observer_settings
from pepper_driver.config.arrays import FloatArray
from pepper_driver.config.robot import TRUNK
from pepper_driver.controller import RobotModel
from pepper_driver.identification.measurements.program import GRIP, HAND_LINKS
from pepper_driver.identification.quality import Finding, Kind
from pepper_driver.observer import FitScore, FusionModel, JointModel
from pepper_driver.observer.detection.threshold import SLIDING, identified_thresholds

MAX_THRESHOLD = np.radians(3.0)
"""[rad] Threshold in motion beyond which a joint of the upper arm is blind, if MAX_TORQUE is too."""

MAX_TORQUE = 2.0
"""[N m] The same as a torque: 6 to 8 N at the hand."""

MIN_FIT = 60.0
"""[%] NRMSE fit of the test run below which a model does not describe its joint."""

MIN_LEVER = 0.03
"""[m] A place that is nearer to the axis of a joint hardly turns it."""

POSTURE = "Stand"
"""In which forces are given."""

PLACES = {"hand": (HAND_LINKS["left"], GRIP), "forearm": ("LForeArm", (0.1, 0.0, 0.0))}
"""Link and point in its frame [m] at which forces are given, of the left arm; the right one is its mirror image."""

CAUSES: tuple[Kind, ...] = (
    "behind",
    "current",
    "bound",
    "excitation",
    "gaps",
    "stale",
    "wander",
    "contact",
)
"""Findings that may explain a blind joint, the likeliest first."""


@dataclass(frozen=True, kw_only=True)
class JointSensitivity:
    """Touch that a joint detects, as its model says.

    Attributes:
        threshold: Its threshold in motion, as identified [rad].
        torque: The same as an external torque [N m], by the stiffness that identification found.
        forces: By place, the force at right angles to the lever that reaches it in the posture POSTURE [N]; without
            the places that the joint does not carry.
    """

    threshold: float
    torque: float
    forces: Mapping[str, float]

    def as_json(self) -> dict[str, Any]:
        """``threshold_deg``, ``torque``, ``forces.<place>``."""
        return {
            "threshold_deg": float(np.degrees(self.threshold)),
            "torque": self.torque,
            "forces": dict(self.forces),
        }


def joint_sensitivities(
    models: Mapping[str, JointModel], robot: RobotConfig
) -> dict[str, JointSensitivity]:
    """Return the sensitivity of each joint that has a model of kind ``fusion``.

    Args:
        models: By joint.
        robot: Its description.
    """
    levers = _levers(robot)
    false_contacts = load_observer_settings().false_contacts
    found = {}
    for joint, model in models.items():
        if not isinstance(model, FusionModel):
            continue
        index = robot.joint_index(joint)
        load_gain = model.twin.load_gain
        trunk = robot.limb_of(joint) == TRUNK
        thresholds = identified_thresholds(model, false_contacts, trunk=trunk)
        threshold = float(thresholds[SLIDING])
        torque = threshold / load_gain
        found[joint] = JointSensitivity(
            threshold=threshold,
            torque=torque,
            forces={
                place: torque / float(lever[index])
                for place, lever in levers.items()
                if lever[index] > MIN_LEVER
            },
        )
    return found


def _levers(robot: RobotConfig) -> dict[str, FloatArray]:
    """Return by place the (17,) distance of the point from the axes of the joints that carry it [m]."""
    model, posture = RobotModel(robot), robot.posture(POSTURE)
    mirrored = [index for index, _ in robot.mirror]
    levers = {}
    for place, (link, point) in PLACES.items():
        jacobian = model.point_jacobian(link, np.array(point), posture)
        left = np.linalg.norm(jacobian, axis=0)
        # Of a joint in the middle both are the same.
        levers[place] = np.maximum(left, left[mirrored])
    return levers


def blind_joints(
    fits: Mapping[str, FitScore[float]],
    sensitivities: Mapping[str, JointSensitivity],
    findings: Sequence[Finding],
    robot: RobotConfig,
    left_out: Mapping[str, str],
) -> tuple[Finding, ...]:
    """Return the joints whose models notice hardly any touch, each with the likely cause.

    Args:
        fits: By joint.
        sensitivities: Of :func:`joint_sensitivities`.
        findings: About the recordings, which may explain it.
        robot: Its description.
        left_out: By joint without a model, why it has none.
    """
    blind = [
        Finding(kind="blind", joint=joint, run=None, text=f"is blind: it has no model. {reason}")
        for joint, reason in left_out.items()
    ]
    for joint, one in sensitivities.items():
        fit, reasons = fits[joint], []
        too_high = one.threshold > MAX_THRESHOLD and one.torque > MAX_TORQUE
        if too_high and _is_upper_arm(joint, robot):
            reasons.append(
                f"its threshold in free motion is {np.degrees(one.threshold):.1f} deg, {one.torque:.1f} N m"
            )
        if not fit.test >= MIN_FIT:
            reasons.append(f"its model explains the test run to {fit.test:.0f} % only")
        if reasons:
            text = f"is blind: {', and '.join(reasons)}. Likely cause: {_cause(joint, findings, robot)}"
            blind.append(Finding(kind="blind", joint=joint, run=None, text=text))
    return tuple(blind)


def _is_upper_arm(joint: str, robot: RobotConfig) -> bool:
    """Return true for shoulders and elbows."""
    return any(
        joint in chain and "Wrist" not in joint and joint not in robot.hands.joints
        for name, chain in robot.chains.items()
        if name.endswith("arm")
    )


def _cause(joint: str, findings: Sequence[Finding], robot: RobotConfig) -> str:
    index, _ = robot.mirror[robot.joint_index(joint)]
    names = (
        joint,
        robot.joint_names[index],
    )  # models of one side come from recordings of the other
    for kind in CAUSES:
        for finding in findings:
            if finding.kind == kind and finding.joint in names:
                return finding.text
    return "unknown, its recordings show none"
