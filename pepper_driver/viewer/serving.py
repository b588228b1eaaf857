"""Serving of a page: host, port and token. Light: it begins before what the page shows is imported."""

from __future__ import annotations

import logging
import socket
from contextlib import redirect_stdout
from dataclasses import dataclass
from io import StringIO

import viser

from pepper_driver.config.errors import PepperError, reason
from pepper_driver.viewer.guard import guarded_server

FIRST_PORT, PORTS = 8080, 20
"""Ports that are tried where none is given."""


class PageError(PepperError, RuntimeError):
    """The page cannot be served; the message is one line."""


@dataclass(frozen=True, kw_only=True, eq=False)
class ServedPage:
    """An empty page that is served.

    Attributes:
        server: Of viser.
        address: Of the page, with its token.
    """

    server: viser.ViserServer
    address: str


def serve_page(*, host: str, port: int | None, token: str, title: str = "Pepper") -> ServedPage:
    """Serve an empty page.

    Args:
        host: Where it is served.
        port: None for the first free one.
        token: Part of its address.
        title: Of the page, for the browser.

    Raises:
        PageError: The port is taken, or the address is not one of this computer.
    """
    logging.getLogger("websockets").setLevel(logging.CRITICAL)
    port = free_port(host, port)
    with guarded_server(token), redirect_stdout(StringIO()):  # it prints addresses without a token
        server = viser.ViserServer(host=host, port=port, label=title, verbose=False)
    if server.get_port() != port:
        raise PageError(f"port {port} was taken meanwhile: choose another --port")
    shown_host = f"[{host}]" if ":" in host else host
    return ServedPage(server=server, address=f"http://{shown_host}:{port}/{token}/")


def free_port(host: str, port: int | None) -> int:
    """Return a port that can be served: the given one, or the first free one.

    Raises:
        PageError: It is taken, or the address is not one of this computer.
    """
    last: OSError | None = None
    for number in range(FIRST_PORT, FIRST_PORT + PORTS) if port is None else (port,):
        try:
            with socket.create_server((host, number)) as probe:
                return int(probe.getsockname()[1])
        except OSError as error:
            last = error
    where = f"{host}:{FIRST_PORT if port is None else port}"
    raise PageError(
        f"the page cannot be served at {where} ({reason(last) if last else 'no port'}): choose another --port"
    )
