"""Who else moves the joints of a robot, and how each of them is switched off: methods of ALMotion by settings.

NAOqi 2.5 and 2.8 pages "ALMotion" (deactivation of safety reflexes), "Idle", "Self-collision avoidance API",
"External-collision avoidance API", "Fall manager API", "Push recovery API", "Smart Stiffness API" and "Diagnosis effect
API".
"""

from __future__ import annotations

from dataclasses import dataclass

from pepper_driver.config.naoqi import TakeOverSettings

CHAINS = ("Head", "LArm", "RArm", "Legs")
"""Of ALMotion, each with an idle movement of its own."""

ARMS = ("LArm", "RArm")
"""Asked for one by one: of both together ALMotion cannot say whether they are protected."""


CRITICAL = ("base_obstacles", "fall_manager", "push_recovery")
"""Settings of what NAOqi calls critical: only the owner of the robot can allow that it is switched off."""


@dataclass(frozen=True, kw_only=True)
class Switch:
    """One of ALMotion's, with ``getXEnabled`` and ``setXEnabled``.

    Attributes:
        setting: Key of ``naoqi_settings.yaml`` that says what is done about it.
        name: What stands for X.
        chain: What both methods take first, if anything.
        text: What it is, for people.
    """

    setting: str
    name: str
    chain: str | None
    text: str

    @property
    def arguments(self) -> tuple[str, ...]:
        """What both methods take first."""
        return () if self.chain is None else (self.chain,)

    @property
    def consent(self) -> bool:
        """Whether the robot's owner must have allowed that it is switched off."""
        return self.setting in CRITICAL


SWITCHES = (
    *(
        Switch(setting="idle", name=name, chain=chain, text=f"{text} of {chain}")
        for name, text in (("Breath", "breathing"), ("IdlePosture", "idle posture"))
        for chain in CHAINS
    ),
    Switch(setting="smart_stiffness", name="SmartStiffness", chain=None, text="smart stiffness"),
    Switch(setting="diagnosis_effect", name="DiagnosisEffect", chain=None, text="diagnosis effect"),
    *(
        Switch(
            setting="self_collision",
            name="CollisionProtection",
            chain=arm,
            text=f"self-collision avoidance of {arm}",
        )
        for arm in ARMS
    ),
    *(
        Switch(
            setting=setting,
            name="ExternalCollisionProtection",
            chain=chain,
            text=f"external-collision avoidance of {chain}",
        )
        for setting, chain in (
            *(("arm_obstacles", arm) for arm in ARMS),
            ("base_obstacles", "Move"),
        )
    ),
    Switch(setting="fall_manager", name="FallManager", chain=None, text="fall manager"),
    Switch(setting="push_recovery", name="PushRecovery", chain=None, text="push recovery"),
)
"""In the order in which they are switched off."""


def chosen(settings: TakeOverSettings) -> list[tuple[Switch, bool]]:
    """Those to be switched off, and whether each must be."""
    policies = {switch: getattr(settings, switch.setting) for switch in SWITCHES}
    return [(switch, policy == "off") for switch, policy in policies.items() if policy != "keep"]
