"""The page's server answers the page alone: its origin, with its token."""

import socket
import urllib.error
import urllib.request
from collections.abc import Iterator
from typing import Any
from urllib.parse import urlsplit

import pytest

from models.errors import PoiseError

viser = pytest.importorskip("viser")
websockets = pytest.importorskip("websockets")
from websockets.sync.client import connect  # noqa: E402

PROTOCOL: Any = [f"viser-v{viser.__version__}"]


@pytest.fixture(scope="module")
def link() -> Iterator[str]:
    from bridge.view.server import serve

    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    server, link = serve("127.0.0.1", port, "g1")
    yield link
    server.stop()


def get(url: str, **headers: str) -> tuple[int, str, str]:
    """Status, cookie and text of a page."""
    try:
        with urllib.request.urlopen(urllib.request.Request(url, headers=headers)) as answer:
            return answer.status, answer.headers.get("Set-Cookie", ""), answer.read().decode()
    except urllib.error.HTTPError as error:
        return error.code, "", error.read().decode()


def websocket(url: str, origin: str | None, **headers: str) -> None:
    """Connect as viser's page does and receive a message; ``InvalidStatus`` when refused."""
    with connect(url, origin=origin, subprotocols=PROTOCOL, additional_headers=headers) as connection:  # type: ignore[arg-type]
        assert connection.recv(10.0)


def test_the_link_opens_the_page_and_its_cookie_opens_the_websocket(link: str) -> None:
    host, token = urlsplit(link).netloc, urlsplit(link).query.removeprefix("token=")
    assert len(token) >= 32
    status, cookie, text = get(link)
    assert status == 200 and "poise-drawing" in text and "HttpOnly; SameSite=Strict" in cookie
    pair = cookie.split(";")[0]
    for headers in ({"Cookie": pair}, {"Cookie": f"other=1; {pair}"}):
        websocket(f"ws://{host}", f"http://{host}", **headers)
        assert get(f"http://{host}/alive", **headers)[0] == 204
    websocket(f"ws://{host}/?token={token}", f"http://{host}")


def test_an_unknown_page_is_not_found(link: str) -> None:
    host, query = urlsplit(link).netloc, urlsplit(link).query
    assert get(f"http://{host}/absent.html?{query}")[0] == 404


@pytest.mark.parametrize("given", ["", "?token=", "?token=guess"])
def test_without_the_token_nothing_is_served_and_the_answer_names_the_remedy(link: str, given: str) -> None:
    host = urlsplit(link).netloc
    status, _, text = get(f"http://{host}/{given}")
    assert status == 403 and "token; open the newest link that 'poise view' printed" in text
    assert get(f"http://{host}/alive{given}", Cookie="poise_1=guess")[0] == 403
    with pytest.raises(websockets.exceptions.InvalidStatus, match="403"):
        websocket(f"ws://{host}/{given}", f"http://{host}")


@pytest.mark.parametrize(
    "origin", [None, "null", "http://evil.example", "http://127.0.0.1:1", "http://HOST.evil.example"]
)
def test_another_origin_is_refused_even_with_the_token(link: str, origin: str | None) -> None:
    host, query = urlsplit(link).netloc, urlsplit(link).query
    origin = origin and origin.replace("HOST", host)
    with pytest.raises(websockets.exceptions.InvalidStatus, match="403") as caught:
        websocket(f"ws://{host}/?{query}", origin)
    assert f"comes from {origin or 'no origin'}, not from this page" in caught.value.response.body.decode()
    if origin:
        assert get(link, Origin=origin)[0] == 403


def test_a_viser_that_leaves_out_the_checks_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    from bridge.view import server

    class Unchecked:
        stopped = False

        def __init__(self, **_: Any) -> None:
            pass

        def stop(self) -> None:
            Unchecked.stopped = True

    monkeypatch.setattr(viser, "ViserServer", Unchecked)
    with pytest.raises(PoiseError, match="does not support the check of requests"):
        server.serve("127.0.0.1", 0, "g1")
    assert Unchecked.stopped
