"""The web server: HTTP and WebSocket connections, in a thread of their own.

Every request is checked by host name, token and origin.

The server and the simulation never wait for each other. Commands go to the simulation through a queue. Of messages to a
page, only the newest of each kind is kept until the page can take it.
"""

from __future__ import annotations

import asyncio
import contextlib
import errno
import hmac
import logging
import os
import socket
import time
from dataclasses import dataclass
from http import HTTPStatus
from ipaddress import ip_address
from pathlib import Path
from queue import SimpleQueue
from threading import Event, Thread
from typing import Any
from urllib.parse import parse_qs, quote, urlsplit

from websockets.asyncio.server import Server, ServerConnection, serve
from websockets.datastructures import Headers
from websockets.exceptions import ConnectionClosed
from websockets.frames import CloseCode
from websockets.http11 import Request, Response

from ..system.errors import UsageError
from .protocol import COSTS, MAX_BYTES, Command, ProtocolError, parse_message

PAGE_FILE = Path(__file__).with_name("page.html")
PAGE, SOCKET, HEALTH = "/", "/live", "/healthz"

# The page may connect to its own WebSocket only, loads nothing else, and sends its address to no other site.
HEADERS = {
    "Content-Security-Policy": "default-src 'none'; script-src 'unsafe-inline'; style-src 'unsafe-inline'; "
    "connect-src 'self'; base-uri 'none'; form-action 'none'",
    "Cache-Control": "no-store",
    "Referrer-Policy": "no-referrer",
    "X-Content-Type-Options": "nosniff",
}


def is_loopback(host: str) -> bool:
    """Return whether only this machine can reach `host`: `localhost` or a loopback address."""
    try:
        return host == "localhost" or ip_address(host).is_loopback
    except ValueError:
        return False


@dataclass(frozen=True)
class AccessControl:
    """Decides how to answer each request, before anything is sent."""

    token: str
    """The token that an address needs; empty if it needs none."""
    only_loopback: bool
    """Whether the `Host` of a request must be a loopback name."""

    def answer(self, request: Request, page: bytes, *, healthy: bool) -> Response | None:
        """Return the page, an error, or None if the WebSocket may open.

        `healthy`: whether the simulation makes progress, which `/healthz` reports.
        """
        address = urlsplit(request.path)
        if address.path == HEALTH:
            if healthy:
                return text_response(HTTPStatus.OK, "ok")
            return text_response(HTTPStatus.SERVICE_UNAVAILABLE, "stalled")
        host = request.headers.get("Host", "")
        # DNS rebinding: a page of another site whose name was pointed at this machine sends that name as Host.
        if self.only_loopback and not is_loopback(_host_name(host)):
            return text_response(HTTPStatus.FORBIDDEN, "Host must be localhost or a loopback address")
        if not self._has_token(address.query):
            return text_response(
                HTTPStatus.UNAUTHORIZED, "missing or wrong token: add ?token=TOKEN as the server printed it"
            )
        if address.path == PAGE:
            return Response(200, "OK", Headers(**HEADERS, **_content_headers(page, "text/html; charset=utf-8")), page)
        if address.path != SOCKET:
            return text_response(HTTPStatus.NOT_FOUND, "not found")
        if "Origin" in request.headers and urlsplit(request.headers["Origin"]).netloc != host:
            return text_response(HTTPStatus.FORBIDDEN, "only the server's own page may connect")
        return None

    def _has_token(self, query: str) -> bool:
        token = parse_qs(query).get("token", [""])[0]
        return not self.token or hmac.compare_digest(token.encode(), self.token.encode())

    @property
    def query(self) -> str:
        """The query that an address needs, `?token=…`, or empty."""
        return f"?token={quote(self.token, safe='')}" if self.token else ""


def _host_name(host: str) -> str:
    """Return a `Host` header without its port, or empty if it is malformed."""
    try:
        return urlsplit(f"//{host}").hostname or ""
    except ValueError:
        return ""


def text_response(status: HTTPStatus, text: str) -> Response:
    """Return a response of one line of text."""
    body = f"{text}\n".encode()
    return Response(status.value, status.phrase, Headers(**_content_headers(body, "text/plain; charset=utf-8")), body)


def _content_headers(body: bytes, content_type: str) -> dict[str, str]:
    return {"Content-Type": content_type, "Content-Length": str(len(body)), "Connection": "close"}


ORDER = (
    "scene",
    "panel",
    "reply",
    "metrics",
    "frameError",
    "update",
)  # of sending: a scene before the messages about it
IN_FLIGHT = 4  # limit of updates that were sent and not displayed yet; more would only add latency
RATE, BURST = 150.0, 300.0  # rate limit [messages/s] and burst limit [messages]; a mouse sends 60 moves a second


class Connection:
    """The send queue and the rate limit of one page.

    The queue has the newest message of each kind only, so a slow page skips updates and needs no more memory.
    """

    def __init__(self, number: int, now: float) -> None:
        """`number`: of the client. `now`: the wall time [s]."""
        self.number = number
        self.wakeup = asyncio.Event()
        self._queue: dict[str, bytes] = {}
        self._sent = self._displayed = 0  # updates
        self._tokens, self._received_at = BURST, now

    def put(self, kind: str, data: bytes) -> None:
        """Queue a message in place of the last of its kind."""
        if kind == "scene":
            self._queue.clear()  # messages about the previous scene
        self._queue[kind] = data
        self.wakeup.set()

    def next(self) -> bytes | None:
        """Return the message to send now, and remove it from the queue; None if there is none."""
        for kind in ORDER:
            if kind in self._queue and (kind != "update" or self._sent - self._displayed < IN_FLIGHT):
                self._sent += kind == "update"
                return self._queue.pop(kind)
        return None

    def acknowledge(self, updates: int) -> None:
        """Record that the page has displayed this many updates since it connected."""
        self._displayed = min(updates, self._sent)
        self.wakeup.set()

    def allow(self, now: float, cost: int = 1) -> bool:
        """Count a message at `now` [s] that costs as much as `cost` plain ones. Return whether it is within the limits.

        The limits are those of a token bucket: `RATE` on average, `BURST` at once.
        """
        self._tokens = min(self._tokens + RATE * (now - self._received_at), BURST) - cost
        self._received_at = now
        return self._tokens >= 0


MAX_PAGES = 16
PING_TIMEOUT = 20.0  # [s] timeout of a ping, after which a page counts as disconnected
CLOSE_TIMEOUT = 2.0  # [s] timeout for closing connections
STALL_TIMEOUT = 60.0  # [s] without progress of the simulation until `/healthz` reports a stall; compiling takes 5

InboxItem = tuple[int, Command | None]  # client and command; None: the client disconnected


class WebServer:
    """Serves the page. `inbox` has the commands of all clients for the simulation thread."""

    def __init__(self, host: str, port: int, access: AccessControl, page: bytes) -> None:
        """Start listening. Port 0 picks a free port. Raises UsageError if the server cannot listen there."""
        self.inbox: SimpleQueue[InboxItem] = SimpleQueue()
        self.stepped_at = time.monotonic()
        """Time of the last loop of the simulation [s]."""
        self.clients = 0
        """Number of open pages."""
        self._access, self._page = access, page
        self._connections: dict[int, Connection] = {}
        self._sockets: dict[int, ServerConnection] = {}
        self._newest: dict[str, bytes] = {}  # message of each kind, for pages that connect later
        self._last_number = 0
        self._closing: set[asyncio.Future[None]] = set()
        self._runner = asyncio.Runner()
        self._loop = self._runner.get_loop()
        self._server: Server | None = None
        self._started = Event()
        self._failure = ""
        self._thread = Thread(target=self._run, args=(host, port), name="pages", daemon=True)
        self._thread.start()
        self._started.wait()
        if self._failure:
            self._thread.join()
            raise UsageError(f"cannot listen on {host}, port {port}: {self._failure}")

    @property
    def port(self) -> int:
        """The port that the server listens on."""
        assert self._server is not None
        return int(next(iter(self._server.sockets)).getsockname()[1])

    # -- called by the simulation thread -------------------------------------------------------------------------------

    def publish(self, kind: str, data: bytes) -> None:
        """Send a message to all pages, and to each that connects until a newer one of its kind is published."""
        self._call(self._publish, kind, data)

    def send(self, client: int, data: bytes) -> None:
        """Send a message to one page."""
        self._call(self._put, client, "reply", data)

    def disconnect(self, client: int, reason: str) -> None:
        """Close the connection of a page with a reason."""
        self._call(self._disconnect, client, reason)

    def close(self) -> None:
        """Close all connections and end the thread."""
        self._call(self._stop.set)
        self._thread.join()

    def _call(self, callback: Any, *arguments: Any) -> None:
        with contextlib.suppress(RuntimeError):  # the event loop has ended
            self._loop.call_soon_threadsafe(callback, *arguments)

    # -- in the server thread ------------------------------------------------------------------------------------------

    def _run(self, host: str, port: int) -> None:
        with self._runner:
            self._runner.run(self._serve(host, port))

    async def _serve(self, host: str, port: int) -> None:
        self._stop = asyncio.Event()
        logger = logging.getLogger(__name__)
        logger.addHandler(logging.NullHandler())
        logger.propagate = False  # invalid requests from the network are not logged
        try:
            server = await serve(
                self._handle,
                host,
                port,
                process_request=self._answer,
                compression=None,
                max_size=MAX_BYTES,
                open_timeout=10,
                close_timeout=1,
                ping_interval=PING_TIMEOUT,
                ping_timeout=PING_TIMEOUT,
                server_header=None,
                logger=logger,
            )
        except OSError as error:
            self._failure = listen_error(error)
            return
        except UnicodeError:
            self._failure = "invalid host name"
            return
        else:
            self._server = server
        finally:
            self._started.set()
        await self._stop.wait()
        server.close()
        with contextlib.suppress(TimeoutError):  # browsers open sockets on which they request nothing
            await asyncio.wait_for(server.wait_closed(), CLOSE_TIMEOUT)

    def _answer(self, connection: ServerConnection, request: Request) -> Response | None:
        healthy = time.monotonic() - self.stepped_at < STALL_TIMEOUT
        return self._access.answer(request, self._page, healthy=healthy)

    async def _handle(self, websocket: ServerConnection) -> None:
        """Serve one page until it disconnects."""
        if len(self._connections) >= MAX_PAGES:  # a script can read the reason of a close, but not an HTTP status
            await websocket.close(CloseCode.TRY_AGAIN_LATER, "too many pages are open")
            return
        self._last_number += 1
        number, connection = self._last_number, Connection(self._last_number, time.monotonic())
        self._connections[number], self._sockets[number] = connection, websocket
        self.clients = len(self._connections)
        for kind, data in self._newest.items():
            connection.put(kind, data)
        sending = asyncio.create_task(self._send(websocket, connection))
        try:
            await self._receive(websocket, connection)
        except ConnectionClosed:
            pass
        except ProtocolError as error:
            await websocket.close(CloseCode.POLICY_VIOLATION, close_reason(str(error)))
        finally:
            sending.cancel()
            del self._connections[number], self._sockets[number]
            self.clients = len(self._connections)
            self.inbox.put((number, None))

    async def _receive(self, websocket: ServerConnection, connection: Connection) -> None:
        async for message in websocket:
            command = parse_message(message)
            if not connection.allow(time.monotonic(), COSTS.get(command.name, 1)):
                raise ProtocolError("too many messages")
            if command.name == "displayed":
                connection.acknowledge(command.argument)
            else:
                self.inbox.put((connection.number, command))

    async def _send(self, websocket: ServerConnection, connection: Connection) -> None:
        with contextlib.suppress(ConnectionClosed):
            while True:
                await connection.wakeup.wait()
                connection.wakeup.clear()
                while (data := connection.next()) is not None:
                    await websocket.send(data)

    def _publish(self, kind: str, data: bytes) -> None:
        if kind == "scene":
            self._newest.clear()
        self._newest[kind] = data
        for connection in self._connections.values():
            connection.put(kind, data)

    def _put(self, client: int, kind: str, data: bytes) -> None:
        if client in self._connections:
            self._connections[client].put(kind, data)

    def _disconnect(self, client: int, reason: str) -> None:
        if client in self._sockets:
            socket = self._sockets[client]
            closing = asyncio.ensure_future(socket.close(CloseCode.POLICY_VIOLATION, close_reason(reason)))
            self._closing.add(closing)  # the event loop has only a weak reference to it
            closing.add_done_callback(self._closing.discard)


def listen_error(error: OSError) -> str:
    """Return why the server cannot listen, and the remedy if there is one."""
    if isinstance(error, socket.gaierror):
        return f"{error.strerror}".lower()
    reason = os.strerror(error.errno).lower() if error.errno else str(error)
    busy = error.errno in (errno.EADDRINUSE, errno.EACCES)
    return f"{reason}; --port 0 picks a free port" if busy else reason


def close_reason(text: str) -> str:
    """Return as much of a text as a WebSocket close frame has room for: 123 bytes."""
    return text.encode()[:120].decode(errors="ignore")
