"""The page of a log: the robot over a time line, with what was felt then and what is felt now."""

from __future__ import annotations

import threading
import time
from bisect import bisect_right
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import viser

from pepper_driver.config import PepperError, load_robot
from pepper_driver.log import LogEvent
from pepper_driver.log.base_path import base_path
from pepper_driver.log.reader import read_log
from pepper_driver.observer import Contact
from pepper_driver.observers import observer_names
from pepper_driver.viewer.page import Page
from pepper_driver.viewer.picture import Picture, picture_of
from pepper_driver.viewer.serving import ServedPage
from pepper_driver.viewer.signals import SHOWN_LINES, WINDOW, Happenings

SPEEDS = ("0.1", "0.25", "0.5", "1", "2", "5", "10")
"""Times real time."""

FRAME = 0.04
"""[s] between two pictures."""

AHEAD = 2.0
"""[s] that the curves show beyond the moment."""

RECOMPUTE = "of the run"
"""The observer of the run, in place of another one's name."""


class RecordedPage(Page):
    """Shows a log.

    Args:
        path: The log.
        served: Where it is shown.
        found: Contacts of a replay.

    Raises:
        LogError: It cannot be read, or has no tick.
    """

    def __init__(
        self,
        path: Path,
        served: ServedPage,
        *,
        found: Sequence[Contact] = (),
    ) -> None:
        self._path, self._log = path, read_log(path)
        log = self._log
        if not len(log):
            raise PepperError(f"{path}: has no tick")
        robot = load_robot()
        if log.joint_names != robot.joint_names:
            raise PepperError(f"{path}: is of another robot ('{log.robot}')")
        self._base, self._tilt = base_path(log)
        self._times = log["time"]
        super().__init__(robot, served)
        gui = self.server.gui
        begin, end = float(self._times[0]), float(self._times[-1])
        self._moment, self._playing = begin, False
        self._play = gui.add_button("Play  (key P)", icon=None)
        self._slider = gui.add_slider("Time [s]", begin, max(end, begin + 0.012), 0.012, begin)
        self._speed = gui.add_dropdown("Speed", SPEEDS, initial_value="1")
        self._play.on_click(lambda _: self._toggle())
        gui.add_command("Play or pause", hotkey="P").on_trigger(lambda _: self._toggle())
        self._slider.on_update(self._seek)
        tabs = gui.add_tab_group()
        with tabs.add_tab("Signals"):
            self.add_curves()
        with tabs.add_tab("Contacts"):
            self._recorded = Happenings(self.server, "Recorded")
            self._found = Happenings(self.server, "Recomputed")
            self._chosen = gui.add_dropdown("Observer", (RECOMPUTE, *observer_names()))
            self._recompute = gui.add_button("Recompute")
            self._recompute.on_click(lambda _: self._start_replay())
        with tabs.add_tab("Show"):
            self.add_switches()
        self._happened: list[Contact | LogEvent] = sorted(
            [*log.contacts, *log.events], key=lambda item: item.time
        )
        self._happened_times = [item.time for item in self._happened]
        self._again = list(found)
        self._drawn: float | None = None
        self._shown: Picture | None = None  # its curves are to be drawn
        about = log.metadata
        missing = f"  \n{log.missing}" if log.missing else ""
        self._about = f"**{about.get('backend', path.name)}**, {end - begin:.1f} s{missing}"
        self.status.content = self._about

    def run(self) -> None:
        """Show the log until the process is ended from outside."""
        last = time.monotonic()
        while True:
            time.sleep(FRAME)
            now = time.monotonic()
            passed, last = now - last, now
            if self._playing:
                self._moment += passed * float(self._speed.value)
                if self._moment >= self._times[-1]:
                    self._moment, self._playing = float(self._times[-1]), False
                    self._play.label = "Play  (key P)"
                self._slider.value = self._moment  # type: ignore[misc]  # the setter stands apart
            self._draw()
            if self._shown is not None and self.draw_curves(self._shown, now):
                self._shown = None

    def _toggle(self) -> None:
        if not self._playing and self._moment >= self._times[-1]:
            self._moment = float(self._times[0])
        self._playing = not self._playing
        self._play.label = f"{'Pause' if self._playing else 'Play'}  (key P)"

    def _seek(self, event: viser.GuiEvent[Any]) -> None:
        if event.client is not None:  # moved on the page, not by the playing
            self._moment = float(self._slider.value)

    def _row(self, moment: float) -> int:
        return max(0, bisect_right(self._times, moment) - 1)

    def _picture(self, row: int) -> Picture:
        return picture_of(
            {name: column[row] for name, column in self._log.fields.items()},
            self._base[row],
            self._tilt[row],
        )

    def _draw(self) -> None:
        if self._drawn == self._moment:
            return
        jumped = self._drawn is None or not 0.0 <= self._moment - self._drawn < 1.0
        self._drawn = self._moment
        if jumped:
            self.scene.clear()
        row = self._row(self._moment)
        picture = self._picture(row)
        felt = [
            c for c, end in self._log.lasting_contacts() if c.detection_time <= picture.time < end
        ]
        self.scene.show(picture, felt)
        first, last = self._row(self._moment - WINDOW), self._row(self._moment + AHEAD)
        self.pictures.clear()
        self.pictures.extend(
            self._picture(r) for r in range(first, last + 1, max(1, (last - first) // 300))
        )
        self._shown = picture
        count = bisect_right(self._happened_times, self._moment)
        self._recorded.show(self._happened[max(0, count - SHOWN_LINES) : count])
        again = [c for c in self._again if c.time <= self._moment]
        self._found.show(again[-SHOWN_LINES:])
        touched = ", ".join(sorted({c.limb for c in felt})) or "nothing"
        self.status.content = f"{self._about}  \n{picture.time:.2f} s · touched: **{touched}**"

    # -- again ----------------------------------------------------------------------------------------------------

    def _start_replay(self) -> None:
        self._recompute.disabled = True
        self._recompute.label = "computing"
        threading.Thread(target=self._replay, daemon=True).start()

    def _replay(self) -> None:
        # Only now: it brings observer and controller.
        from pepper_driver.replay import load_run, replay

        try:
            run = load_run(self._path)
            name = None if self._chosen.value == RECOMPUTE else self._chosen.value
            found = replay(run, run.observer(name))
            self._again = [c for _, c in found.contacts if c.phase != "update"]
            self._drawn = None
        except PepperError as error:
            for client in self.server.get_clients().values():
                client.add_notification("Cannot be recomputed", str(error), auto_close_seconds=8.0)
        finally:
            self._recompute.disabled = False
            self._recompute.label = "Recompute"
