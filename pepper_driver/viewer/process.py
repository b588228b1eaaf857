"""The process of the page of a running robot; :class:`pepper_driver.viewer.view.PageProcess` starts it.

It reads lines of JSON: where the page is served, and then where the stream is. To the first it answers with a line, the
address or an error. It ends when its input does.
"""

from __future__ import annotations

import json
import os
import sys
import threading
from queue import SimpleQueue
from typing import Any

from pepper_driver.config.errors import PepperError

NICENESS = 10
"""The page may come late, the robot's program not."""


def main() -> None:
    """Serve the page until the input ends."""
    answers = os.fdopen(os.dup(sys.stdout.fileno()), "w")
    with open(os.devnull, "w") as nowhere:
        os.dup2(nowhere.fileno(), sys.stdout.fileno())  # viser prints
    if hasattr(os, "nice"):
        os.nice(NICENESS)
    lines: SimpleQueue[Any] = SimpleQueue()

    def read() -> None:
        for line in sys.stdin:
            lines.put(json.loads(line))
        os._exit(0)

    threading.Thread(target=read, daemon=True).start()

    def answer(**contents: str) -> None:
        answers.write(json.dumps(contents) + "\n")
        answers.flush()

    from pepper_driver.viewer.serving import serve_page

    try:
        served = serve_page(**lines.get())
    except PepperError as error:
        answer(error=str(error))
        return
    answer(address=served.address)

    # Imported only now: meanwhile the browser loads the page.
    from pepper_driver.telemetry import TelemetryClient, TelemetryError
    from pepper_driver.viewer.live import LivePage

    host, port, token = lines.get()
    try:
        client = TelemetryClient((host, port), token)
    except TelemetryError:  # the program is about to end
        return
    LivePage(client, served).run()


if __name__ == "__main__":
    main()
