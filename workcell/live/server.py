"""The server of the live page: this machine only, and only for who has the token.

A browser that asks for the address with the token gets a cookie, and with the cookie the page, its
two files, and two sockets: viser's for the scene, and one of our own (`PANEL`) for the instruments
and the keys. Everything without the cookie is refused with status 403 before viser sees it. viser has
no hook for that, so its call of `websockets.serve` is wrapped while it starts; whether the wrapping
holds is tried before anybody is told the address.
"""

from __future__ import annotations

import contextlib
import contextvars
import gzip
import hmac
import http
import http.client
import io
import json
import os
import secrets
import socket
from collections.abc import Callable, Iterator
from http.cookies import CookieError, SimpleCookie
from importlib import resources
from typing import Any, Protocol
from urllib.parse import parse_qs, urlsplit

import viser
import websockets.asyncio.server as sockets
from websockets import ConnectionClosed, Headers
from websockets.asyncio.server import ServerConnection
from websockets.http11 import Request, Response

from workcell.errors import InputError

HOST = "127.0.0.1"
PORT = 8080
"""viser's own default."""
PANEL = "/panel"
FILES = {"/panel.js": "text/javascript", "/panel.css": "text/css"}
"""What the page has beside viser's own client, from the folder `static`."""
_HOST_NAMES = ("127.0.0.1", "localhost", "[::1]")
"""What a browser may call this machine, also through an ssh tunnel; refuses names that a foreign page points here."""
_MESSAGE_BYTES = 65536
"""Longest message of a panel; chosen far above the longest that its own script sends."""
REFUSAL = "403: open the address that workcell printed, with its token\n"

_browser: contextvars.ContextVar[str] = contextvars.ContextVar("browser", default="")
"""Which browser a callback of viser comes from; set for each connection."""


def calling_browser() -> str:
    """The browser whose message is being handled, in a callback that viser awaits; empty elsewhere."""
    return _browser.get()


class Listener(Protocol):
    """What is told of the panels. All calls come from the server's own thread."""

    def came(self, browser: str) -> None:
        """A browser has opened the page."""

    def went(self, browser: str) -> None:
        """A browser has closed its last page."""

    def heard(self, browser: str, message: dict[str, Any]) -> None:
        """A panel has sent something."""


class PageServer:
    """A server that runs from its construction until `close`.

    Args:
        port: Where to listen; 0 takes any free one.
        title: Of the page.
        listener: Told of panels that come, go and speak.

    Raises:
        InputError: the port is taken, or the server cannot be guarded.
    """

    def __init__(self, port: int, *, title: str, listener: Listener):
        self.port = _free_port(port)
        self.token = secrets.token_urlsafe(18)
        self._cookie = f"workcell_{self.port}"
        self._listener = listener
        self._panels: dict[ServerConnection, str] = {}
        self._title = title
        with self._wrapped(), contextlib.redirect_stdout(io.StringIO()):
            self.viser = _LocalViser(host=HOST, port=self.port, verbose=False)
        self._loop = self.viser.get_event_loop()
        try:
            self._try_the_guard()
        except BaseException:
            self.close()
            raise

    @property
    def address(self) -> str:
        """The page, with the token."""
        return f"http://{HOST}:{self.port}/?token={self.token}"

    def send(self, message: dict[str, Any], *, browser: str | None = None) -> None:
        """Send to every panel, or to those of one browser; never waits."""
        text = json.dumps(message, allow_nan=False)

        def cast() -> None:
            sockets.broadcast(
                [c for c, who in self._panels.items() if browser is None or who == browser], text
            )

        with contextlib.suppress(RuntimeError):  # the loop has ended
            self._loop.call_soon_threadsafe(cast)

    def close(self) -> None:
        """End the server and every connection."""
        with contextlib.redirect_stdout(io.StringIO()):
            self.viser.stop()

    # ---------------------------------------------------------------- the guard

    @contextlib.contextmanager
    def _wrapped(self) -> Iterator[None]:
        """While viser starts, what it serves is served behind the guard."""
        serve = sockets.serve

        def guarded(handler, host, port, *, process_request, **options):
            def request(connection: ServerConnection, asked: Request) -> Response | None:
                return self._answer(connection, asked, process_request)

            async def handle(connection: ServerConnection) -> None:
                await self._handle(connection, handler)

            return serve(handle, host, port, process_request=request, **options)

        sockets.serve = guarded  # pyright: ignore[reportAttributeAccessIssue]
        try:
            yield
        finally:
            sockets.serve = serve

    def _answer(
        self,
        connection: ServerConnection,
        asked: Request,
        viser_answer: Callable[[ServerConnection, Request], Response | None],
    ) -> Response | None:
        """The answer to one request; None lets a socket be opened."""
        url = urlsplit(asked.path)
        if not _is_ours(asked):
            return _response(http.HTTPStatus.FORBIDDEN, REFUSAL)
        given = parse_qs(url.query).get("token", [""])[0]
        if hmac.compare_digest(given.encode(), self.token.encode()):
            # The token leaves the address bar at once, and with it pictures of the screen.
            browser = self._browser_of(asked) or secrets.token_urlsafe(9)
            return _response(
                http.HTTPStatus.FOUND,
                "",
                {
                    "Location": "/",
                    "Set-Cookie": f"{self._cookie}={self.token}.{browser}; Path=/; HttpOnly; SameSite=Strict",
                },
            )
        if self._browser_of(asked) is None:
            return _response(http.HTTPStatus.FORBIDDEN, REFUSAL)
        if asked.headers.get("Upgrade", "").lower() == "websocket":
            return None
        if url.path in FILES:
            text = (resources.files("workcell.live") / "static" / url.path[1:]).read_text("utf-8")
            return _response(http.HTTPStatus.OK, text, {"Content-Type": FILES[url.path]})
        answer = viser_answer(connection, asked)
        if answer is not None and url.path == "/":
            return self._page(answer)
        return answer

    def _page(self, answer: Response) -> Response:
        """viser's page with our two files in its head."""
        body = bytes(answer.body or b"")
        if answer.headers.get("Content-Encoding") == "gzip":
            body = gzip.decompress(body)
        page, head = body.decode("utf-8"), "<head>"
        page = page.replace("<title>Viser</title>", f"<title>{self._title}</title>")
        at = page.index(head) + len(head)
        ours = '<link rel="stylesheet" href="/panel.css"><script src="/panel.js"></script>'
        return _response(
            http.HTTPStatus.OK,
            page[:at] + ours + page[at:],
            {"Content-Type": "text/html; charset=utf-8", "Cache-Control": "no-store"},
        )

    def _browser_of(self, asked: Request) -> str | None:
        """Name of the browser if its cookie holds the token, None otherwise."""
        try:
            cookies = SimpleCookie(asked.headers.get("Cookie", ""))
        except CookieError:
            return None
        found = cookies.get(self._cookie)
        token, _, browser = ("" if found is None else found.value).partition(".")
        return browser if hmac.compare_digest(token.encode(), self.token.encode()) else None

    def _try_the_guard(self) -> None:
        """Ask as a stranger would: an update of viser must not open the door in silence."""
        if self.viser.get_port() != self.port:
            raise InputError(f"--port {self.port}: was taken while the page started")
        upgrade = {
            "Connection": "Upgrade",
            "Upgrade": "websocket",
            "Sec-WebSocket-Key": "c3RyYW5nZXIgYXQgdGhlIGRvb3I=",
            "Sec-WebSocket-Version": "13",
        }
        for path, headers in (("/", {}), ("/", upgrade), (PANEL, upgrade)):
            line = http.client.HTTPConnection(HOST, self.port, timeout=10)
            try:
                line.request("GET", path, headers=headers)
                status = line.getresponse().status
            finally:
                line.close()
            if status != http.HTTPStatus.FORBIDDEN:
                raise InputError(
                    f"the page cannot be guarded with viser {viser.__version__}: a request without the token was answered with status {status}, not 403; use --window"
                )

    # ---------------------------------------------------------------- the sockets

    async def _handle(self, connection: ServerConnection, viser_handler: Callable) -> None:
        asked = connection.request
        browser = None if asked is None else self._browser_of(asked)
        if asked is None or browser is None:  # refused before; here only if the guard is broken
            await connection.close(1008, "no token")
            return
        _browser.set(browser)
        if urlsplit(asked.path).path == PANEL:
            await self._listen(connection, browser)
        else:
            await viser_handler(connection)

    async def _listen(self, connection: ServerConnection, browser: str) -> None:
        is_new = browser not in self._panels.values()
        self._panels[connection] = browser
        if is_new:
            self._listener.came(browser)
        try:
            async for text in connection:
                message = _parsed(text)
                if message is None:
                    await connection.close(1007, "not a message of the panel")
                    return
                self._listener.heard(browser, message)
        except ConnectionClosed:
            pass
        finally:
            del self._panels[connection]
            if browser not in self._panels.values():
                self._listener.went(browser)


class _LocalViser(viser.ViserServer):
    """viser without its tunnel to a public server."""

    def request_share_url(self, verbose: bool = True) -> str | None:
        """Nobody outside gets in, whatever a client asks for."""
        return None


def ssh_command(port: int) -> str:
    """What to type on another machine, so that the same address opens there."""
    user = os.environ.get("USER") or os.environ.get("LOGNAME") or "USER"
    return f"ssh -N -L {port}:{HOST}:{port} {user}@{socket.gethostname()}"


def _free_port(port: int) -> int:
    """The port, seen to be free.

    Raises:
        InputError: it is taken or may not be used.
    """
    with socket.socket() as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind((HOST, port))
        except (OSError, OverflowError) as error:
            reason = getattr(error, "strerror", None) or str(error)
            raise InputError(
                f"--port {port}: {reason}; another program listens there, or it may not be used: choose another with --port N, 0 for any"
            ) from error
        return int(probe.getsockname()[1])


def _is_ours(asked: Request) -> bool:
    """Whether a request means this machine and comes from a page of its own."""
    host = asked.headers.get("Host", "")
    name = host.rsplit(":", 1)[0] if not host.endswith("]") else host
    if name not in _HOST_NAMES:
        return False
    origin = asked.headers.get("Origin")
    return origin is None or urlsplit(origin).netloc == host


def _response(
    status: http.HTTPStatus, text: str, headers: dict[str, str] | None = None
) -> Response:
    body = text.encode("utf-8")
    fields = {"Content-Type": "text/plain; charset=utf-8"} | (headers or {})
    fields |= {"Content-Length": str(len(body)), "X-Content-Type-Options": "nosniff"}
    return Response(status.value, status.phrase, Headers(fields), body)


def _parsed(text: str | bytes) -> dict[str, Any] | None:
    """A message of a panel; None if it is not one."""
    if not isinstance(text, str) or len(text) > _MESSAGE_BYTES:
        return None
    try:
        message = json.loads(text)
    except (ValueError, RecursionError):
        return None
    return message if isinstance(message, dict) and isinstance(message.get("kind"), str) else None


__all__ = ["HOST", "PORT", "Listener", "PageServer", "calling_browser", "ssh_command"]
