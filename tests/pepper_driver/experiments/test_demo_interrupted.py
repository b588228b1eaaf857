"""A demonstration that Ctrl-C ends leaves what was done, and says where."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from pepper_driver.config.signals import describe_interrupt
from pepper_driver.experiments.demo import CONTACTS_NAME, LOG_NAME, run_demo
from pepper_driver.log import read_log


def test_an_interrupted_demonstration_leaves_its_contacts(tmp_path: Path) -> None:
    def stop_on_the_way(fraction: float) -> None:
        if fraction > 0.35:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt) as caught:
        run_demo(tmp_path, seed=2, seconds=16.0, on_progress=stop_on_the_way)
    log, saved = read_log(tmp_path / LOG_NAME), json.loads((tmp_path / CONTACTS_NAME).read_text())
    contacts = {contact.id for contact in log.contacts}
    assert len(contacts) > 1
    assert describe_interrupt(caught.value) == (
        f"interrupted; log: {tmp_path / LOG_NAME}; {len(contacts)} contacts so far; "
        f"contacts: {tmp_path / CONTACTS_NAME}"
    )
    assert not saved["complete"]
    assert [event["time"] for event in saved["events"]] == [c.time for c in log.contacts]
    end = log["time"][-1]
    pushes = [entry["push"] for entry in saved["detected"]] + saved["missed"]
    assert len(pushes) == saved["summary"]["pushes"]
    assert saved["summary"]["detected"] > 0
    assert all(push["onset"] <= end for push in pushes)
    assert saved["summary"]["simulated_seconds"] == pytest.approx(end - log["time"][0], abs=0.05)
