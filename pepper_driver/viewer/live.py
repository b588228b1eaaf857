"""The page of a running robot."""

from __future__ import annotations

import time
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
import viser

from pepper_driver.config import load_robot
from pepper_driver.config.arrays import FloatArray
from pepper_driver.config.visuals import Visual
from pepper_driver.log.topics import CONTACTS, EVENTS
from pepper_driver.observer import Contact
from pepper_driver.telemetry import Kind, TelemetryClient, TelemetryError
from pepper_driver.telemetry.protocol import Message
from pepper_driver.viewer import NO_OBSERVER
from pepper_driver.viewer.page import Page
from pepper_driver.viewer.picture import Picture, RowDecoder
from pepper_driver.viewer.serving import ServedPage
from pepper_driver.viewer.signals import Happenings, stage_text

REFRESH = 0.1
"""[s] between two requests that keep a hand closed, or the base driving."""

RECEIVE = 0.05
"""[s] of waiting for the stream, at most."""

_RED = 'button[style*="color-red-filled"]'
STOP_STYLE = (
    f'<style>div[style*="overflow: hidden"]:has({_RED}) {{overflow: clip !important; min-width: 0}} '
    f"div:has(> {_RED}) {{position: sticky; top: 0; z-index: 10}}</style>"
)
"""The button that stops, the only red one, stays in sight as the panel is scrolled; what clips it must not scroll."""

TAP_DURATION = 0.15
"""[s] of a click."""

PRESS_DURATION = 0.3
"""[s] for which a click presses a sensor."""

DRIVE_SPEED, TURN_SPEED = 0.15, 0.5
"""[m/s], [rad/s] of the drive pad."""

DRIVING = 1.0
"""[s] after a request of the drive pad in which the base may still follow it: later, a program may drive it."""

DRIVE_KEYS: Mapping[
    str, tuple[Literal["W", "S", "A", "D", "Q", "E"], tuple[float, float, float]]
] = {
    "Forward": ("W", (1.0, 0.0, 0.0)),
    "Back": ("S", (-1.0, 0.0, 0.0)),
    "Left": ("A", (0.0, 1.0, 0.0)),
    "Right": ("D", (0.0, -1.0, 0.0)),
    "Turn left": ("Q", (0.0, 0.0, 1.0)),
    "Turn right": ("E", (0.0, 0.0, -1.0)),
}
"""By label: the key, and the direction vx, vy, wz."""

POSTURE_TIME = 2.0
"""[s] for the way to a posture."""


UNOBSERVED = "This run has no observer: residuals, torques and contacts are not known."
UNKNOWN = "Residuals, torques and contacts are not known here: no observer runs in the program that serves the robot."
"""What stands in place of the curves."""


@dataclass
class _Drag:
    """A hand that a mouse moves."""

    client: int
    link: str
    to: FloatArray
    sent: float = 0.0


class LivePage(Page):
    """Shows the stream of a robot, and sends it what is done on the page.

    Args:
        client: Connected.
        served: Where it is shown.
    """

    def __init__(self, client: TelemetryClient, served: ServedPage) -> None:
        super().__init__(load_robot(), served)
        self._client = client
        self._decoder: RowDecoder | None = None
        self._row: bytes | None = None
        self._contacts: dict[int, Contact] = {}
        self._drag: _Drag | None = None
        self._driver, self._driven = -1, -np.inf
        self._can: dict[str, Any] = {}
        self._run: dict[str, Any] = {}
        self._controls: list[Any] = []
        self._label: Any = None
        self._newest: Picture | None = None
        self._observed = True
        self._add_stop()
        tabs = self.server.gui.add_tab_group()
        with tabs.add_tab("Signals"):
            self._unobserved = self.server.gui.add_markdown("", visible=False)
            self.add_curves()
            self._list = Happenings(self.server, "Contacts and events")
            self._stages = self.server.gui.add_html("")
        self._touch_tab = tabs.add_tab("Touch and move")
        with tabs.add_tab("Show"):
            self.add_switches()
        self.scene.on_part(self._add_mouse)
        self.server.on_client_disconnect(self._leave)

    # -- the stream -----------------------------------------------------------------------------------------------

    def run(self) -> None:
        """Show the stream until it ends; then the page stays as it is."""
        try:
            while True:
                message = self._client.receive(RECEIVE)
                while message is not None:
                    self._take(message)
                    message = self._client.receive(0.0)
                now = time.monotonic()
                if self._newest is not None:
                    self._show(self._newest)
                    if self._observed:
                        self.draw_curves(self._newest, self._contacts.values(), now)
                    self._newest = None
                self._refresh_drag(now)
        except TelemetryError:
            self.status.content = "**The program of the robot has ended.**"
            wait_forever()

    def _take(self, message: Message) -> None:
        kind = message.kind
        if kind is Kind.TICK:
            self._row = message.data
        elif kind is Kind.POSE and self._decoder is not None and self._row is not None:
            picture = self._decoder.decode(self._row, message.json)
            self.remember(picture)
            self._newest = picture
        elif kind is Kind.CONTACT:
            contact = CONTACTS.decode(message.data)
            self._list.add(contact)
            if contact.phase == "end" or contact.kind == "rebound":  # which is no touch
                self._contacts.pop(contact.id, None)
            else:
                self._contacts[contact.id] = contact
        elif kind is Kind.EVENT:
            self._list.add(EVENTS.decode(message.data))
        elif kind is Kind.STATUS:
            self._show_status(message.json)
        elif kind is Kind.ABOUT:
            self._begin(message.json)
        elif kind is Kind.ANSWER and "error" in (answer := message.json):
            self._notify(answer["error"])

    def _begin(self, about: Mapping[str, Any]) -> None:
        """Show a new run."""
        self._decoder = RowDecoder(about["layout"])
        self._run, self._can = about["run"], about["can"]
        self._contacts.clear()
        self._list.clear()
        self._stages.content = ""
        self.pictures.clear()
        self.scene.clear()
        self._stop.disabled = not self._can["stop"]
        self._stop.visible = self._can["stop"]
        self._observed = self._run.get("observer", NO_OBSERVER) != NO_OBSERVER
        self._unobserved.content = UNOBSERVED if "observer" in self._run else UNKNOWN
        self._unobserved.visible = not self._observed
        self.curves.show(self._observed)
        self._list.show_list("observer" in self._run)
        for handle in self._controls:
            handle.remove()
        self._controls = []
        with self._touch_tab:
            self._add_controls()

    def _show(self, picture: Picture) -> None:
        self.scene.show(picture, tuple(self._contacts.values()))
        self._show_hand(picture)

    def _show_status(self, status: Mapping[str, Any]) -> None:
        state = str(status["state"])
        if status["fault"]:
            state = f"**stopped:** {status['fault']}"
        self._again.visible = bool(status["fault"]) and "current" in self._can
        time_text = f"{self.pictures[-1].time:.1f} s" if self.pictures else ""
        facts = []
        if self._observed:
            touched = ", ".join(sorted({c.limb for c in self._contacts.values()})) or "nothing"
            facts.append(f"touched: **{touched}**")
        if "reflexes" in status:  # a robot that is only served has none of this
            facts.append(f"reflex: {', '.join(status['reflexes']) or 'none'}")
            if status["attentive"]:
                withheld = ", ".join(status["withheld"])
                facts.append(f"attentive but for {withheld}" if withheld else "attentive")
            self._stages.content = (
                f'<div style="font-size:0.75em;padding:0 1em">{stage_text(status["stages"])}; '
                f"missed ticks: {status['missed']}</div>"
            )
        self.status.content = (
            f"**{self._run.get('backend', '')}** · {time_text} · {state}  \n" + " · ".join(facts)
        )

    def _notify(self, text: str) -> None:
        for client in self.server.get_clients().values():
            client.add_notification("The robot refuses", text, auto_close_seconds=6.0)

    def _request(self, do: str, **arguments: object) -> None:
        with suppress(TelemetryError):  # the loop says so
            self._client.request(do, **arguments)

    # -- stop, hand and taps --------------------------------------------------------------------------------------

    def _add_stop(self) -> None:
        gui = self.server.gui
        gui.add_html(STOP_STYLE)
        self._stop = gui.add_button("STOP  (key X)", color="red", disabled=True)
        self._stop.on_click(lambda _: self._request("stop"))
        self._again = gui.add_button("Start again", color="blue", visible=False)
        self._again.on_click(lambda _: self._request("restart", **self._can["current"]))
        key = gui.add_command("Stop the robot", hotkey="X")
        key.on_trigger(lambda _: self._request("stop") if self._can.get("stop") else None)

    def _add_mouse(self, visual: Visual, handle: Any) -> None:  # noqa: ANN401 of viser
        async def drag(event: viser.SceneNodeDragEvent[Any]) -> None:
            self._on_drag(visual.link, event)

        def click(event: viser.SceneNodePointerEvent[Any]) -> None:
            self._on_click(visual, event)

        handle.on_drag(drag)
        handle.on_click(click)

    def _on_drag(self, link: str, event: viser.SceneNodeDragEvent[Any]) -> None:
        if not self._can.get("touch"):
            return
        if event.phase == "start":
            self._let_go()
            point = self.scene.in_link(link, np.array(event.start_position))
            self._request("take", link=link, point=point.tolist(), stiffness=self._stiffness)
            self._drag = _Drag(event.client_id, link, np.array(event.end_position))
        elif event.phase == "end":
            self._let_go(event.client_id)
        elif self._drag is not None and self._drag.client == event.client_id:
            self._drag.to = np.array(event.end_position)
            self._drag.sent = 0.0

    def _refresh_drag(self, now: float) -> None:
        """Send where the hand is to go, also while the mouse rests: a hand without requests lets go of the robot."""
        drag = self._drag
        if drag is not None and now - drag.sent >= REFRESH:
            drag.sent = now
            self._request("move", link=drag.link, to=drag.to.tolist())

    def _leave(self, client: viser.ClientHandle) -> None:
        """End at once what a browser did that has left; for one that only hangs, the robot's timeout does."""
        self._let_go(client.client_id)
        if self._driver == client.client_id and time.monotonic() - self._driven < DRIVING:
            self._request("drive", vx=0.0, vy=0.0, wz=0.0)

    def _let_go(self, client: int | None = None) -> None:
        drag = self._drag
        if drag is not None and client in (None, drag.client):
            self._drag = None
            self._request("release", link=drag.link)

    def _show_hand(self, picture: Picture) -> None:
        """Show the size of the largest force on the robot next to it."""
        sizes = [float(np.linalg.norm(f.force)) for f in picture.forces]
        if not sizes or max(sizes) < 0.05:
            if self._label is not None:
                self._label.remove()
                self._label = None
            return
        force = picture.forces[int(np.argmax(sizes))]
        text = f"{max(sizes):.1f} N"
        if self._label is None:
            self._label = self.server.scene.add_label("/force_size", text, anchor="bottom-center")
        self._label.text = text
        self._label.position = force.point + np.array([0.0, 0.0, 0.06])

    def _on_click(self, visual: Visual, event: viser.SceneNodePointerEvent[Any]) -> None:
        if not self._can.get("touch"):
            return
        hit = self.scene.hit(visual, np.array(event.ray_origin), np.array(event.ray_direction))
        if hit is None:
            return
        point, inwards = hit
        force = self._tap_force * inwards
        self._request(
            "tap",
            link=visual.link,
            force=force.tolist(),
            point=point.tolist(),
            duration=TAP_DURATION,
        )

    # -- controls -------------------------------------------------------------------------------------------------

    _tap_force, _stiffness = 15.0, 1000.0

    def _add_controls(self) -> None:
        gui, can = self.server.gui, self._can
        if can.get("touch"):
            self._add_touch_controls()
        if not can.get("control"):
            self._controls.append(gui.add_markdown(can["note"]))
            return
        if can.get("motions"):
            self._add_choice("Motion or experiment", can["motions"], "Play", "play", "name")
        self._add_choice(
            "Posture", can["postures"], "Go there", "posture", "name", duration=POSTURE_TIME
        )
        attentive = gui.add_checkbox(
            "Attentive", initial_value=self._run.get("attentive") == "true"
        )
        attentive.on_update(lambda _: self._request("attentive", on=attentive.value))
        self._controls.append(attentive)
        self._add_drive_pad()
        if can.get("plants"):
            self._add_restart()

    def _add_touch_controls(self) -> None:
        gui = self.server.gui
        help_text = gui.add_markdown(
            "**Drag** a part of the robot to pull it with a springy hand; **click** to tap it."
        )
        tap = gui.add_slider("Tap [N]", 2.0, 40.0, 1.0, self._tap_force)
        stiffness = gui.add_slider("Hand [N/m]", 500.0, 3000.0, 100.0, self._stiffness)

        def choose(_: object) -> None:
            self._tap_force, self._stiffness = float(tap.value), float(stiffness.value)

        tap.on_update(choose)
        stiffness.on_update(choose)
        self._controls += [help_text, tap, stiffness]
        self._add_choice(
            "Sensor", self._can["sensors"], "Press", "press", "sensor", duration=PRESS_DURATION
        )

    def _add_choice(
        self,
        label: str,
        names: list[str],
        button_label: str,
        do: str,
        argument: str,
        **more: object,
    ) -> None:
        gui = self.server.gui
        choice = gui.add_dropdown(label, tuple(names))
        button = gui.add_button(button_label)
        button.on_click(lambda _: self._request(do, **{argument: choice.value}, **more))
        self._controls += [choice, button]

    def _add_drive_pad(self) -> None:
        gui = self.server.gui
        scale = np.array([DRIVE_SPEED, DRIVE_SPEED, TURN_SPEED])
        for label, (key, direction) in DRIVE_KEYS.items():
            vx, vy, wz = (scale * direction).tolist()

            def drive(event: Any, vx: float = vx, vy: float = vy, wz: float = wz) -> None:  # noqa: ANN401
                self._driver, self._driven = event.client_id, time.monotonic()
                self._request("drive", vx=vx, vy=vy, wz=wz)

            button = gui.add_button(f"{label}  (key {key})", hint="Drives while it is held.")
            button.on_hold(drive, callback_hz=1.0 / REFRESH)
            command = gui.add_command(f"Drive: {label}", hotkey=key)
            command.on_trigger(drive)
            self._controls += [button, command]

    def _add_restart(self) -> None:
        gui, can = self.server.gui, self._can
        current = can["current"]
        plant = gui.add_dropdown("Plant", tuple(can["plants"]), initial_value=current["plant"])
        observer = gui.add_dropdown(
            "Observer", tuple(can["observers"]), initial_value=current["observer"]
        )
        self._controls += [plant, observer]
        switches: dict[str, tuple[Any, dict[str, Any]]] = {}
        for kind, gains in can["reflexes"].items():
            declared = current["reflexes"].get(kind)
            switch = gui.add_checkbox(f"Reflex {kind}", initial_value=declared is not None)
            numbers = {
                name: gui.add_number(f"{kind}: {name}", float((declared or {}).get(name, value)))
                for name, value in gains.items()
            }
            for number in numbers.values():
                number.visible = declared is not None

            def toggle(_: object, switch: Any = switch, numbers: Any = numbers) -> None:  # noqa: ANN401
                for number in numbers.values():
                    number.visible = switch.value

            switch.on_update(toggle)
            switches[kind] = (switch, numbers)
            self._controls += [switch, *numbers.values()]
        button = gui.add_button("Restart with these", color="blue")

        def restart(_: object) -> None:
            reflexes = {
                kind: {name: number.value for name, number in numbers.items()}
                for kind, (switch, numbers) in switches.items()
                if switch.value
            }
            self._request("restart", plant=plant.value, observer=observer.value, reflexes=reflexes)

        button.on_click(restart)
        self._controls.append(button)


def wait_forever() -> None:
    """Wait until the process is ended from outside."""
    while True:
        time.sleep(3600.0)
