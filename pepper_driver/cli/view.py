"""``pepper view``: a robot or a log in the browser."""

from __future__ import annotations

import webbrowser
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.console import Console

from pepper_driver.cli.console import ModelsOption, make_console, show_line
from pepper_driver.config.errors import ArgumentError
from pepper_driver.viewer import NO_OBSERVER
from pepper_driver.viewer.view import DEFAULT_HOST, View, check_access, check_extra

if TYPE_CHECKING:
    from pepper_driver.observer import Contact
    from pepper_driver.replay.comparison import MatchedPair
    from pepper_driver.robot import Pepper

LOG_SUFFIX = ".mcap"

HostOption = Annotated[
    str,
    typer.Option(
        metavar="ADDRESS", help="Where the page is served; beyond this computer only with --token."
    ),
]
PortOption = Annotated[
    int | None,
    typer.Option(
        metavar="N",
        min=1,
        max=65535,
        help="Port of the page; by default the first free one from 8080.",
        show_default=False,
    ),
]
TokenOption = Annotated[
    str | None,
    typer.Option(
        metavar="TEXT",
        help="Part of the address that others must know; by default a new one.",
        show_default=False,
    ),
]
NoOpenOption = Annotated[
    bool, typer.Option("--no-open", help="Do not open the browser; only print the address.")
]
AllowControlOption = Annotated[
    bool,
    typer.Option(
        "--allow-control", help="Let the page move a real robot; without, it looks and stops."
    ),
]


def view(
    what: Annotated[
        str, typer.Argument(metavar="URI|LOG", help="A robot, or a log (.mcap).")
    ] = "mujoco",
    observer: Annotated[
        str, typer.Option(metavar="NAME", help=f"Observer of the robot, or '{NO_OBSERVER}'.")
    ] = "fusion",
    models: ModelsOption = None,
    reflex: Annotated[
        list[str] | None,
        typer.Option(
            metavar="KIND",
            help="Reflex of the robot; may be given again; 'none' for none. By default comply, and none on a real "
            "robot without --allow-control.",
        ),
    ] = None,
    log: Annotated[
        Path | None, typer.Option(metavar="FILE", help="MCAP log of the robot's run to write.")
    ] = None,
    host: HostOption = DEFAULT_HOST,
    port: PortOption = None,
    token: TokenOption = None,
    no_open: NoOpenOption = False,
    allow_control: AllowControlOption = False,
) -> None:
    """Show a robot or a log in the browser; a simulated robot can be pulled, tapped and driven there."""
    console = make_console()
    check_extra()
    if what.endswith(LOG_SUFFIX) or Path(what).is_file():
        if log is not None:
            raise ArgumentError("--log is for a robot, and this is a log")
        show_log(console, Path(what), host=host, port=port, token=token, open_browser=not no_open)
        return
    with View(host=host, port=port, token=token, allow_control=allow_control) as page:
        # Imported only now: meanwhile the page begins.
        from pepper_driver.backends.selection import parse_uri
        from pepper_driver.viewer.host import Host, HostedRun

        if reflex is None:
            moves = allow_control or parse_uri(what).scheme == "mujoco"
            reflex = ["comply"] if moves else []
        kinds = [kind for kind in reflex if kind != "none"]
        robot_host = Host(
            HostedRun(
                uri=what,
                observer=None if observer == NO_OBSERVER else observer,
                models=models,
                reflexes={kind: {} for kind in kinds},
                log=log,
            )
        )
        show_line(console, f"view: {page.address}  (Ctrl-C ends it)")
        if not no_open:
            page.open()

        def show(pepper: Pepper) -> None:
            page.show(pepper, perform=robot_host.perform, choices=lambda: robot_host.choices)

        robot_host.run(show)


def show_log(
    console: Console,
    path: Path,
    *,
    pairs: Sequence[MatchedPair[Contact]] | None = None,
    host: str = DEFAULT_HOST,
    port: int | None = None,
    token: str | None = None,
    open_browser: bool = True,
) -> None:
    """Show a log in the browser until Ctrl-C.

    Args:
        console: Where the address is printed.
        path: The log.
        pairs: Contacts of the log next to those of a replay; None before one.
        host: Where the page is served.
        port: Of the page; None for the first free one.
        token: Part of the address; None for a new one.
        open_browser: Open it in the browser of this computer.

    Raises:
        PepperError: The log cannot be read, or the page not be served.
    """
    check_extra()
    from pepper_driver.log.reader import begins_as_log
    from pepper_driver.viewer.recorded import RecordedPage
    from pepper_driver.viewer.serving import serve_page

    served = serve_page(host=host, port=port, token=check_access(host, token), title=path.name)

    def show() -> None:
        show_line(console, f"view: {served.address}  (Ctrl-C ends it)")
        if open_browser:
            webbrowser.open(served.address)

    early = begins_as_log(path)
    if early:  # the browser loads the page while the log is read
        show()
    page = RecordedPage(path, served, pairs=pairs)
    if not early:
        show()
    page.run()
