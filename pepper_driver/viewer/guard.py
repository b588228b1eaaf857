"""Access to the page: only with the token in its address, and only from that page.

Without it, any program and any web page open on this computer could press the buttons.
"""

from __future__ import annotations

import secrets
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from http import HTTPStatus
from typing import Any
from urllib.parse import urlsplit

import websockets.asyncio.server as server
from websockets.asyncio.server import ServerConnection
from websockets.datastructures import Headers
from websockets.http11 import Request, Response

Handler = Callable[[ServerConnection, Request], Response | None]


def check_request(request: Request, token: str) -> Request | None:
    """Return a request without the token in its path; None where it may not pass.

    A page of another origin is refused too: it could know the address.
    """
    parts = request.path.partition("?")[0].split("/", 2)
    given = parts[1] if len(parts) > 1 else ""
    if not secrets.compare_digest(given.encode(), token.encode()):
        return None
    origin = request.headers.get("Origin")
    if origin is not None and urlsplit(origin).netloc != request.headers.get("Host"):
        return None
    return replace(request, path="/" + (parts[2] if len(parts) > 2 else ""))


def guarded(handler: Handler | None, token: str) -> Handler:
    """Return a handler that refuses requests without the token with 403."""

    def handle(connection: ServerConnection, request: Request) -> Response | None:
        passed = check_request(request, token)
        if passed is None:
            text = b"This page needs the whole address that the program printed.\n"
            headers = Headers({"Content-Type": "text/plain", "Content-Length": str(len(text))})
            return Response(HTTPStatus.FORBIDDEN, "Forbidden", headers, text)
        return handler(connection, passed) if handler is not None else None

    return handle


@contextmanager
def guarded_server(token: str) -> Iterator[None]:
    """Have all websocket servers that begin meanwhile ask for the token: viser has no place for it."""
    serve = server.serve

    def serve_guarded(*args: Any, **kwargs: Any) -> Any:  # noqa: ANN401 as the library's
        kwargs["process_request"] = guarded(kwargs.get("process_request"), token)
        return serve(*args, **kwargs)

    server.serve = serve_guarded  # type: ignore[assignment, misc]
    try:
        yield
    finally:
        server.serve = serve  # type: ignore[misc]
