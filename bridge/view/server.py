"""Web server of the page: the server of viser, protected by a token and a check of the origin."""

import io
import secrets
import socket
from contextlib import redirect_stdout
from http import HTTPStatus
from importlib.resources import files
from typing import Any
from unittest.mock import patch
from urllib.parse import parse_qs, urlsplit

import viser
import websockets.asyncio.server

from models.errors import PoiseError

ALIVE = "/alive"  #: Path with an empty answer, by which a page finds out why it has no connection
CAMERA = ((2.2, -1.6, 1.4), (0.0, 0.0, 0.6))  #: Position and target of the initial view of a robot at the origin [m]


def refusal(request: Any, token: str, cookie: str) -> str:
    """Why a request is refused; empty for requests from the origin of the page with the token in query or cookie."""
    headers = request.headers
    host, origins = headers.get("Host", ""), headers.get_all("Origin")
    if (origins or "Upgrade" in headers) and [urlsplit(origin).netloc or "null" for origin in origins] != [host]:
        return f"refused: the request comes from {' '.join(origins) or 'no origin'}, not from this page at {host}"
    given = parse_qs(urlsplit(request.path).query).get("token", [])
    for pair in "; ".join(headers.get_all("Cookie")).split("; "):
        name, _, value = pair.partition("=")
        given += [value] if name == cookie else []
    if any(secrets.compare_digest(one.encode(), token.encode()) for one in given):
        return ""
    return f"refused: {'wrong' if given else 'no'} token; open the newest link that 'poise view' printed"


def serve(host: str, port: int, robot: str) -> tuple[Any, str]:
    """Start the server of viser; returns it and its link, which contains a random token.

    Raises ``PoiseError`` when the port is in use (viser would silently take the next one), or when this version of
    viser bypasses the checks.
    """
    with socket.socket() as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind((host, port))
        except OSError as error:
            raise PoiseError(f"{host}:{port} cannot be opened: {error.strerror}; choose another --port") from error
    token, cookie = secrets.token_urlsafe(), f"poise_{port}"  # cookies do not distinguish ports
    script = (files("bridge") / "view" / "page.js").read_bytes()
    checked: list[bool] = []
    start = websockets.asyncio.server.serve

    def start_checked(*args: Any, process_request: Any, **options: Any) -> Any:
        checked.append(True)

        def answer(connection: Any, request: Any) -> Any:
            if reason := refusal(request, token, cookie):
                return connection.respond(HTTPStatus.FORBIDDEN, f"{reason}\n")
            if request.path == ALIVE:
                return connection.respond(HTTPStatus.NO_CONTENT, "")
            if "Accept-Encoding" in request.headers:
                del request.headers["Accept-Encoding"]  # the script is inserted into uncompressed text
            response = process_request(connection, request)
            if response is not None and response.headers.get("Content-Type", "").startswith("text/html"):
                response.body = response.body.replace(b"<head>", b"<head><script>%b</script>" % script, 1)
                del response.headers["Content-Length"]
                response.headers["Content-Length"] = str(len(response.body))
                response.headers["Set-Cookie"] = f"{cookie}={token}; HttpOnly; SameSite=Strict; Path=/"
            return response

        return start(*args, process_request=answer, **options)

    # viser has no hook for requests, and its printed link lacks the token
    with patch.object(websockets.asyncio.server, "serve", start_checked), redirect_stdout(io.StringIO()):
        server = viser.ViserServer(host=host, port=port, label=f"poise: {robot}", verbose=False)
    if not checked:
        server.stop()
        raise PoiseError(f"viser {viser.__version__} does not support the check of requests; install viser 1.1.1")
    server.gui.configure_theme(show_share_button=False)
    server.scene.set_up_direction("+z")
    server.initial_camera.position, server.initial_camera.look_at = CAMERA
    return server, f"http://{'localhost' if host == '0.0.0.0' else host}:{server.get_port()}/?token={token}"
