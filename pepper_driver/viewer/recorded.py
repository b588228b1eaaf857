"""The page of a log: the robot over a time line, with the recorded contacts and those of a replay."""

from __future__ import annotations

import threading
import time
from bisect import bisect_right
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import viser

from pepper_driver.config import PepperError, load_robot
from pepper_driver.log.reader import read_log
from pepper_driver.observer import Contact
from pepper_driver.observers import observer_names
from pepper_driver.viewer.moments import Moments
from pepper_driver.viewer.page import Page
from pepper_driver.viewer.picture import LOG_FIELDS, Picture
from pepper_driver.viewer.serving import ServedPage
from pepper_driver.viewer.signals import SHOWN_LINES, WINDOW, Happenings, pair_table, time_line

if TYPE_CHECKING:
    from pepper_driver.replay.comparison import MatchedPair

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
        pairs: Recorded contacts next to those of a replay; None before one.

    Raises:
        LogError: It cannot be read, or has no tick.
    """

    def __init__(
        self,
        path: Path,
        served: ServedPage,
        *,
        pairs: Sequence[MatchedPair[Contact]] | None = None,
    ) -> None:
        robot = load_robot()
        super().__init__(robot, served)
        self.status.content = f"reading {path.name}"
        self._path, log = path, read_log(path, names=LOG_FIELDS)
        if not len(log):
            raise PepperError(f"{path}: has no tick")
        if log.joint_names != robot.joint_names:
            raise PepperError(f"{path}: is of another robot ('{log.robot}')")
        self._moments = Moments(log)
        gui = self.server.gui
        begin, end = float(log["time"][0]), float(log["time"][-1])
        self._begin, self._end = begin, end
        self._moment, self._playing = begin, False
        self._line = gui.add_html("")
        self._play = gui.add_button("Play  (key P)", icon=None)
        self._slider = gui.add_slider("Time [s]", begin, max(end, begin + 0.012), 0.012, begin)
        self._speed = gui.add_dropdown("Speed", SPEEDS, initial_value="1")
        self._play.on_click(lambda _: self._toggle())
        gui.add_command("Play or pause", hotkey="P").on_trigger(lambda _: self._toggle())
        self._slider.on_update(self._on_slider)
        tabs = gui.add_tab_group()
        with tabs.add_tab("Signals"):
            self.add_curves()
        with tabs.add_tab("Contacts"):
            self._table = gui.add_html("")
            self._chosen = gui.add_dropdown("Observer", (RECOMPUTE, *observer_names()))
            self._recompute = gui.add_button("Recompute")
            self._recompute.on_click(lambda _: self._start_replay())
            self._events = Happenings(self.server, "Events")
        with tabs.add_tab("Show"):
            self.add_switches()
        self._event_times = [event.time for event in log.events]
        self._set_pairs(pairs)
        self._drawn: float | None = None
        self._shown: tuple[Picture, list[Contact]] | None = None  # its curves are to be drawn
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
                if self._moment >= self._end:
                    self._moment, self._playing = self._end, False
                    self._play.label = "Play  (key P)"
                self._slider.value = self._moment  # type: ignore[misc]  # the setter stands apart
            self._draw()
            if self._shown is not None and self.draw_curves(*self._shown, now):
                self._shown = None

    def _toggle(self) -> None:
        if not self._playing and self._moment >= self._end:
            self._moment = self._begin
        self._playing = not self._playing
        self._play.label = f"{'Pause' if self._playing else 'Play'}  (key P)"

    def seek(self, time: float) -> None:
        """Go to a time of the log [s]. Any thread may call."""
        self._moment = min(max(time, self._begin), self._end)

    def _on_slider(self, event: viser.GuiEvent[Any]) -> None:
        if event.client is not None:  # moved on the page, not by the playing
            self.seek(float(self._slider.value))

    def _set_pairs(self, pairs: Sequence[MatchedPair[Contact]] | None) -> None:
        """Show these contacts from now on; without a replay those of the log."""
        log = self._moments.log
        self._recomputed = pairs is not None
        self._pairs: list[tuple[Contact | None, Contact | None]] = (
            [(contact, None) for contact, _ in log.lasting_contacts()]
            if pairs is None
            else [(pair.recorded, pair.found) for pair in pairs]
        )
        self._pairs.sort(key=_onset)
        self._line.content = time_line(
            self._pairs, self._begin, self._end, recomputed=self._recomputed
        )
        self._drawn = None

    def _draw(self) -> None:
        if self._drawn == self._moment:
            return
        jumped = self._drawn is None or not 0.0 <= self._moment - self._drawn < 1.0
        self._drawn = self._moment
        if jumped:
            self.scene.clear()
        moments = self._moments
        row = moments.row(self._moment)
        picture, contacts = moments.picture(row), moments.contacts(self._moment)
        self.scene.show(picture, contacts)
        first, last = moments.row(self._moment - WINDOW), moments.row(self._moment + AHEAD)
        self.pictures.clear()
        self.pictures.extend(
            moments.picture(r) for r in range(first, last + 1, max(1, (last - first) // 300))
        )
        self._shown = picture, contacts
        count = bisect_right(self._event_times, self._moment)
        self._events.show(moments.log.events[max(0, count - SHOWN_LINES) : count])
        count = bisect_right(self._pairs, self._moment, key=_onset)
        self._table.content = pair_table(
            self._pairs[max(0, count - SHOWN_LINES) : count], recomputed=self._recomputed
        )
        touched = ", ".join(sorted({c.limb for c in contacts})) or "nothing"
        self.status.content = f"{self._about}  \n{picture.time:.2f} s · touched: **{touched}**"

    # -- again ----------------------------------------------------------------------------------------------------

    def _start_replay(self) -> None:
        self._recompute.disabled = True
        self._recompute.label = "computing"
        threading.Thread(target=self._replay, daemon=True).start()

    def _replay(self) -> None:
        # Only now: it brings observer and controller.
        from pepper_driver.replay import compare, load_run, replay

        try:
            run = load_run(self._path)
            name = None if self._chosen.value == RECOMPUTE else self._chosen.value
            self._set_pairs(compare(run, replay(run, run.observer(name))).contacts)
        except PepperError as error:
            for client in self.server.get_clients().values():
                client.add_notification("Cannot be recomputed", str(error), auto_close_seconds=8.0)
        finally:
            self._recompute.disabled = False
            self._recompute.label = "Recompute"


def _onset(pair: tuple[Contact | None, Contact | None]) -> float:
    return min(contact.onset_time for contact in pair if contact is not None)
