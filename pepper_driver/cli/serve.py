"""``pepper serve``: a stand-in NAOqi in front of a simulated robot."""

from __future__ import annotations

import signal
import sys
from types import FrameType
from typing import Annotated
from urllib.parse import urlencode

import typer

from pepper_driver.backends.naoqi_server.launch import StandIn
from pepper_driver.cli.console import make_console


def serve(
    port: Annotated[int, typer.Option(min=0, max=65535, help="Port; 0 for a free one.")] = 9559,
    host: Annotated[str, typer.Option(help="Address to listen at.")] = "127.0.0.1",
    plant: Annotated[
        str, typer.Option(metavar="NAME_OR_FILE", help="The simulated robot.")
    ] = "nominal",
    seed: Annotated[int, typer.Option(min=0, help="Of the noise of its sensors.")] = 0,
    world: Annotated[
        str, typer.Option(metavar="NAME_OR_FILE", help="What stands around it.")
    ] = "empty",
    posture: Annotated[str, typer.Option(metavar="NAME", help="How it stands.")] = "Stand",
    clock: Annotated[
        int | None,
        typer.Option(metavar="MS", help="The DCM's time at the start; by default the time of day."),
    ] = None,
) -> None:
    """Offer a simulated Pepper over NAOqi's protocol, in real time, until Ctrl-C.

    Programs written for the robot connect to it unchanged: tcp://127.0.0.1:9559.
    """
    console = make_console()
    uri = (
        f"mujoco://?{urlencode({'plant': plant, 'seed': seed, 'world': world, 'posture': posture})}"
    )
    signal.signal(signal.SIGTERM, _end)
    with StandIn(uri, host=host, port=port, clock=clock) as stand_in:
        if host not in ("127.0.0.1", "localhost", "::1"):
            print(
                f"pepper: {host} can be reached from other machines, and nobody is asked for a password",
                file=sys.stderr,
            )
        console.print(f"ready on {stand_in.url}")
        stand_in.wait()


def _end(number: int, frame: FrameType | None) -> None:
    raise SystemExit(128 + number)
