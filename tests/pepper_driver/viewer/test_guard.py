"""Access to the page: with its whole address, and from that page alone."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

pytest.importorskip("viser")
from websockets.datastructures import Headers
from websockets.http11 import Request

from pepper_driver.viewer.guard import check_request

TOKEN = "k3J_x-9qLw"


def request(path: str, origin: str | None = None, host: str = "127.0.0.1:8080") -> Request:
    headers = Headers({"Host": host})
    if origin is not None:
        headers["Origin"] = origin
    return Request(path, headers)


@pytest.mark.parametrize(
    ("path", "rest"),
    [
        (f"/{TOKEN}/", "/"),
        (f"/{TOKEN}", "/"),
        (f"/{TOKEN}?websocket=ws://127.0.0.1", "/"),
        (f"/{TOKEN}/assets/a.js", "/assets/a.js"),
    ],
)
def test_with_the_token_the_rest_of_the_path_is_asked_for(path: str, rest: str) -> None:
    passed = check_request(request(path), TOKEN)
    assert passed is not None
    assert passed.path == rest


@pytest.mark.parametrize("path", ["/", "", f"/{TOKEN[:-1]}/", f"/{TOKEN}x/", f"/x/{TOKEN}/"])
def test_without_it_nothing_is(path: str) -> None:
    assert check_request(request(path), TOKEN) is None


@given(st.text(max_size=30))
def test_no_other_text_is_the_token(text: str) -> None:
    if text.split("/")[0].partition("?")[0] != TOKEN:
        assert check_request(request("/" + text), TOKEN) is None


@pytest.mark.parametrize(
    ("origin", "passes"),
    [
        (None, True),
        ("http://127.0.0.1:8080", True),
        ("http://127.0.0.1:8888", False),
        ("https://elsewhere.example", False),
        ("null", False),
    ],
)
def test_a_page_of_another_origin_may_not_connect(origin: str | None, passes: bool) -> None:
    assert (check_request(request(f"/{TOKEN}", origin), TOKEN) is not None) == passes
