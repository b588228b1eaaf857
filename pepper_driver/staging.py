"""Performs scenarios: tells the robot its goals in time, pushes and grabs it, and keeps a record of that."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from urllib.parse import urlencode

import numpy as np

from pepper_driver.backends.selection import parse_uri
from pepper_driver.config import Scenario
from pepper_driver.controller import Tick
from pepper_driver.observer import Observation, Push
from pepper_driver.robot import Pepper
from pepper_driver.scene import PlannedTouch, Scene, order_touch
from pepper_driver.scenes import plan_scenes

OnTick = Callable[[Tick, Observation | None], None]

REPORT_TIME = 1.0
"""[s] of simulated time from one report of progress to the next."""


def scenario_uri(uri: str, scenario: Scenario) -> str:
    """The URI of a simulated Pepper with the scenario's plant and world, where it names none; any other as it is."""
    parsed = parse_uri(uri)
    wanted = {"plant": scenario.plant, "world": scenario.world}
    added = {k: v for k, v in wanted.items() if v is not None and k not in parsed.query}
    if parsed.scheme != "mujoco" or not added:
        return uri
    return f"{parsed.scheme}://?{urlencode({**parsed.query, **added})}"


class Stage:
    """A scenario on one robot, planned to the last push when it is made; nothing has moved then.

    Args:
        pepper: The robot.
        scenario: What to perform.
        seed: Of all that is random.
        count: How many goals, for motion of kind setpoints or holds, in place of the scenario's own number.

    Raises:
        ConfigError: The scenario does not fit the robot; see :func:`plan_scenes`.
    """

    def __init__(
        self,
        pepper: Pepper,
        scenario: Scenario,
        seed: int | Sequence[int],
        *,
        count: int | None = None,
    ) -> None:
        self._pepper = pepper
        rng = np.random.default_rng(seed)
        self._scenes = plan_scenes(scenario, pepper.config, pepper.backend, rng, count=count)
        self._pushes: list[Push] = []

    @property
    def pushes(self) -> tuple[Push, ...]:
        """The contacts of all scenes that have begun, in the robot's time."""
        return tuple(self._pushes)

    def perform(
        self,
        *,
        on_tick: OnTick | None = None,
        settling: bool = False,
        on_progress: Callable[[float], None] | None = None,
    ) -> None:
        """Move and touch the robot, which must be active, from the first scene to the last.

        Args:
            on_tick: Called inside every tick of the motion: must be quick.
            settling: Whether it is called while the robot settles, too.
            on_progress: Told the share of the time that is over, 0..1.

        Raises:
            FaultError: The safety gate stopped the robot.
        """
        self._pushes.clear()
        report = max(1, round(REPORT_TIME / self._pepper.config.cycle))
        total = sum(scene.leg.ticks for scene in self._scenes)
        done = 0
        for scene in self._scenes:
            listener = self._begin(scene, on_tick if settling or not scene.leg.settling else None)
            end = done + scene.leg.ticks
            while done < end:
                ticks = min(report, end - done)
                self._pepper.run(ticks * self._pepper.config.cycle, on_tick=listener)
                done += ticks
                if on_progress is not None:
                    on_progress(done / total)
        if any(scene.leg.twist is not None for scene in self._scenes):
            self._pepper.drive(0.0, 0.0, 0.0)

    def _begin(self, scene: Scene, on_tick: OnTick | None) -> OnTick:
        """Give the goal of a scene and order its contacts; what is left to do is done in every tick of it."""
        pepper, leg = self._pepper, scene.leg
        way = _minimum_jerk(leg.move)
        origin = pepper.target
        goals = {n: (float(origin[pepper.config.joint_index(n)]), a) for n, a in leg.joints.items()}
        tick_number = 0

        def advance() -> None:
            if tick_number < len(way):
                share = way[tick_number]
                pepper.set_posture(
                    {n: (1.0 - share) * a + share * b for n, (a, b) in goals.items()}
                )

        pepper.set_posture({}, stiffness=leg.stiffness)
        if leg.twist is not None:
            pepper.drive(*leg.twist, hold=True)
        advance()
        for touch in scene.touches:
            self._order(touch)

        def listener(tick: Tick, observation: Observation | None) -> None:
            nonlocal tick_number
            tick_number += 1
            advance()
            self._watch(tick)
            if on_tick is not None:
                on_tick(tick, observation)

        return listener

    def _order(self, touch: PlannedTouch) -> None:
        """Have the backend push or grab, and note it."""
        pepper, planned = self._pepper, touch.planned
        order_touch(pepper.backend, touch)
        onset = pepper.time + touch.delay
        self._pushes.append(
            Push(
                joint=planned.joint,
                link=planned.link,
                direction=int(np.sign(planned.torque)),
                force=planned.newtons,
                torque=abs(planned.torque),
                degrees=planned.degrees,
                onset=onset,
                release=onset + touch.duration,
                moving=touch.moving,
                saturating=planned.load > 1.0,
            )
        )

    def _watch(self, tick: Tick) -> None:
        """Mark the contacts under way whose joint's board is at its limit: planning looks at the rest state only."""
        if not self._pushes:
            return
        robot, now = self._pepper.config, tick.measurement.time
        saturated = self._pepper.backend.truth.saturated
        if not saturated.any():
            return
        for number, push in enumerate(self._pushes):
            if not push.onset <= now <= push.release:
                continue
            # Of a push on trunk or base no joint is meant: what the legs do counts.
            joints = robot.chains["legs"] if push.joint is None else (push.joint,)
            if any(saturated[robot.joint_index(name)] for name in joints):
                self._pushes[number] = replace(push, saturated=True)


def _minimum_jerk(ticks: int) -> list[float]:
    """Shares of a way to be at after each of so many cycles, without jerk at its ends; one 1 for a way of no time."""
    shares = [n / ticks for n in range(1, ticks + 1)] if ticks else [1.0]
    return [s**3 * (10.0 - 15.0 * s + 6.0 * s**2) for s in shares]
