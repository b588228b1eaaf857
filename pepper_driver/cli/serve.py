"""``pepper serve``: a stand-in NAOqi in front of a simulated robot."""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, nullcontext
from typing import TYPE_CHECKING, Annotated
from urllib.parse import urlencode

import typer
from rich.console import Console
from rich.table import Table

from pepper_driver.backends.naoqi_server.faults import FAULTS, parse_fault
from pepper_driver.backends.naoqi_server.launch import StandIn
from pepper_driver.backends.naoqi_server.tls import Login
from pepper_driver.cli.console import make_console, show_line
from pepper_driver.config import load_robot, network_names
from pepper_driver.config.passwords import PASSWORD_VARIABLE

if TYPE_CHECKING:
    from pepper_driver.viewer.view import View

USER = "nao"
PASSWORD = "nao"
"""Of the stand-in where the environment says none: there is nothing to protect."""

RESTART_DELAY = 3
"""[s] after which a NAOqi that ended is started again. A robot does so too, and takes longer."""


def serve(
    port: Annotated[
        int | None,
        typer.Option(
            metavar="N",
            min=0,
            max=65535,
            help="Port; 0 for a free one. By default 9559, with --tls 9503.",
        ),
    ] = None,
    host: Annotated[str, typer.Option(metavar="ADDRESS", help="Where to listen.")] = "127.0.0.1",
    plant: Annotated[
        str, typer.Option(metavar="NAME_OR_FILE", help="Plant: the simulated robot.")
    ] = "nominal",
    seed: Annotated[
        int, typer.Option(metavar="N", min=0, help="Seed of the noise of its sensors.")
    ] = 0,
    world: Annotated[
        str, typer.Option(metavar="NAME_OR_FILE", help="World: what stands around it.")
    ] = "empty",
    posture: Annotated[
        str, typer.Option(metavar="NAME", help="Posture in which it stands.")
    ] = "Stand",
    consent: Annotated[
        bool,
        typer.Option(
            "--consent",
            help="Its owner lets safety reflexes be switched off, as on the page /advanced/#/settings.",
        ),
    ] = False,
    clock: Annotated[
        int | None,
        typer.Option(
            metavar="MILLISECONDS",
            help="The DCM's time at the start; by default the time of day.",
        ),
    ] = None,
    tls: Annotated[
        bool,
        typer.Option(
            "--tls", help=f"TLS and a login, as NAOqi 2.9; the password is in {PASSWORD_VARIABLE}."
        ),
    ] = False,
    network: Annotated[
        str | None,
        typer.Option(
            metavar="NAME_OR_FILE", help=f"A network in between: {', '.join(network_names())}."
        ),
    ] = None,
    fault: Annotated[
        list[str] | None,
        typer.Option(
            metavar="NAME[:ARGUMENT,...]",
            help="An injected fault, for example hang:seconds=2,after=10. Any number of times.",
        ),
    ] = None,
    view: Annotated[
        bool,
        typer.Option("--view", help="Show the robot in the browser, where it can be touched."),
    ] = False,
    list_faults: Annotated[
        bool, typer.Option("--faults", help="Print all faults and their arguments, and exit.")
    ] = False,
) -> None:
    """Offer a simulated Pepper over NAOqi's protocol, in real time, until Ctrl-C.

    Programs written for the robot connect to it unchanged: tcp://127.0.0.1:9559.
    """
    console = make_console()
    if list_faults:
        _print_faults(console)
        return
    faults = [parse_fault(text) for text in fault or ()]
    if network is None and any(one.kind.place == "link" for one in faults):
        network = "clear"
    login = Login(user=USER, token=os.environ.get(PASSWORD_VARIABLE) or PASSWORD) if tls else None
    if port is None:
        port = 9503 if tls else 9559
    uri = (
        f"mujoco://?{urlencode({'plant': plant, 'seed': seed, 'world': world, 'posture': posture})}"
    )
    with (
        _page() if view else nullcontext() as page,
        StandIn(
            uri,
            host=host,
            port=port,
            clock=clock,
            consent=consent,
            network=network,
            login=login,
            faults=faults,
        ) as stand_in,
        ExitStack() as shown,
    ):
        if login is None and host not in ("127.0.0.1", "localhost", "::1"):
            _warn(f"{host} can be reached from other machines without a password")
        console.print(f"ready on {stand_in.url}")
        if login is not None:
            known = f"that of {PASSWORD_VARIABLE}" if login.token != PASSWORD else f"'{PASSWORD}'"
            console.print(f"user '{USER}', password {known}")
        if page is not None:
            shown.enter_context(_shown(page, stand_in))
            show_line(console, f"view: {page.address}")
            page.open()
        while True:
            how = stand_in.wait()
            _warn(
                f"NAOqi ended {how}; the robot goes on, and NAOqi starts again in {RESTART_DELAY} s"
            )
            time.sleep(RESTART_DELAY)
            stand_in.start_naoqi()
            console.print(f"ready on {stand_in.url}")


def _page() -> View:
    """Return a page that begins while the robot starts."""
    from pepper_driver.viewer.view import View  # brings more than a server needs

    return View()


@contextmanager
def _shown(page: View, stand_in: StandIn) -> Iterator[None]:
    """Show the robot on a page as long as the block is open."""
    from pepper_driver.viewer.served import ServedRobot

    served = ServedRobot(stand_in.robot, load_robot(), stand_in.url)
    page.show_served(served)
    try:
        yield
    finally:
        served.close()


def _warn(text: str) -> None:
    print(f"pepper: {text}", file=sys.stderr)


def _print_faults(console: Console) -> None:
    """Print the values of ``--fault``."""
    table = Table("fault", "arguments", "what it does", show_lines=True)
    for name, kind in FAULTS.items():
        arguments = ", ".join(f"{key}={value}" for key, value in kind.arguments.items())
        table.add_row(name, arguments, kind.effect)
    console.print(table)
    console.print("all but rollover also take seconds=inf, how long it lasts, and after=0")
