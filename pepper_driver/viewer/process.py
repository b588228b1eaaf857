"""The process of the page of a running robot; :class:`pepper_driver.viewer.view.PageProcess` starts it.

It reads its settings as one line of JSON, prints one line with the address or an error, and ends when its input does.
"""

from __future__ import annotations

import json
import os
import sys
import threading

from pepper_driver.config import PepperError

NICENESS = 10
"""The page may come late, the robot's program not."""


def main() -> None:
    """Serve the page until the input ends."""
    answers = os.fdopen(os.dup(sys.stdout.fileno()), "w")
    with open(os.devnull, "w") as nowhere:
        os.dup2(nowhere.fileno(), sys.stdout.fileno())  # viser prints
    settings = json.loads(sys.stdin.readline())
    if hasattr(os, "nice"):
        os.nice(NICENESS)

    def end_with_parent() -> None:
        sys.stdin.read()
        os._exit(0)

    threading.Thread(target=end_with_parent, daemon=True).start()

    def answer(**contents: str) -> None:
        answers.write(json.dumps(contents) + "\n")
        answers.flush()

    # Imported only now: it takes half a second, in which the parent may have ended.
    from pepper_driver.telemetry import TelemetryClient
    from pepper_driver.viewer.live import LivePage

    try:
        host, port, token = settings.pop("telemetry")
        client = TelemetryClient((host, port), token)
        page = LivePage(client, **settings)
    except PepperError as error:
        answer(error=str(error))
        return
    answer(address=page.address)
    page.run()


if __name__ == "__main__":
    main()
