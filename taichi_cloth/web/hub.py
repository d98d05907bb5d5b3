"""The server's own thread: lets pages in, sends them what there is, and hands on what they say.

Nothing here waits for the simulation, and the simulation waits for nothing here.
"""

from __future__ import annotations

import asyncio
import contextlib
import errno
import logging
import os
import socket
import time
from queue import SimpleQueue
from threading import Event, Thread
from typing import Any

from websockets.asyncio.server import Server, ServerConnection, serve
from websockets.exceptions import ConnectionClosed
from websockets.frames import CloseCode
from websockets.http11 import Request, Response

from ..errors import WrongUse
from .client import Client
from .doors import Doors
from .words import COSTS, MOST_BYTES, Malformed, Said, heard

MOST_CLIENTS = 16
SILENT = 20.0  # [s] a page that answers no ping for so long is gone
CLOSING = 2.0  # [s] to say good-bye to pages
STALLED = 60.0  # [s] a simulation that has not turned for so long is not well; compiling takes 5

Came = tuple[int, Said | None]  # from whom; None: it has gone


class Hub:
    """A server of one page. `inbox` holds what pages said, for the thread of the simulation."""

    def __init__(self, host: str, port: int, doors: Doors, page: bytes) -> None:
        """Listens when it comes back. Raises WrongUse where it cannot; port 0 is any that is free."""
        self.inbox: SimpleQueue[Came] = SimpleQueue()
        self.turned_at = time.monotonic()  # [s] when the simulation went on last
        self.visitors = 0
        self._doors, self._page = doors, page
        self._clients: dict[int, Client] = {}
        self._sockets: dict[int, ServerConnection] = {}
        self._kept: dict[str, bytes] = {}  # for those who come later
        self._numbers = 0
        self._closing: set[asyncio.Future[None]] = set()
        self._runner = asyncio.Runner()
        self._loop = self._runner.get_loop()
        self._server: Server | None = None
        self._listens = Event()
        self._refused = ""
        self._thread = Thread(target=self._run, args=(host, port), name="pages", daemon=True)
        self._thread.start()
        self._listens.wait()
        if self._refused:
            self._thread.join()
            raise WrongUse(f"cannot listen at {host}, port {port}: {self._refused}")

    @property
    def port(self) -> int:
        assert self._server is not None
        return int(next(iter(self._server.sockets)).getsockname()[1])

    # -- for the thread of the simulation --------------------------------------------------------------

    def publish(self, kind: str, data: bytes) -> None:
        """Sends it to everybody who is there, and keeps it for those who come."""
        self._call(self._publish, kind, data)

    def tell(self, visitor: int, data: bytes) -> None:
        """Sends it to one."""
        self._call(self._put, visitor, "told", data)

    def turn_out(self, visitor: int, why: str) -> None:
        """Ends a connection."""
        self._call(self._turn_out, visitor, why)

    def close(self) -> None:
        """Ends all connections, and the thread."""
        self._call(self._stop.set)
        self._thread.join()

    def _call(self, do: Any, *arguments: Any) -> None:
        with contextlib.suppress(RuntimeError):  # the loop has ended
            self._loop.call_soon_threadsafe(do, *arguments)

    # -- in the thread of its own ----------------------------------------------------------------------

    def _run(self, host: str, port: int) -> None:
        with self._runner:
            self._runner.run(self._serve(host, port))

    async def _serve(self, host: str, port: int) -> None:
        self._stop = asyncio.Event()
        quiet = logging.getLogger(__name__)
        quiet.addHandler(logging.NullHandler())
        quiet.propagate = False  # what strangers send wrongly is no news
        try:
            server = await serve(
                self._talk,
                host,
                port,
                process_request=self._answer,
                compression=None,
                max_size=MOST_BYTES,
                open_timeout=10,
                close_timeout=1,
                ping_interval=SILENT,
                ping_timeout=SILENT,
                server_header=None,
                logger=quiet,
            )
        except OSError as error:
            self._refused = refusal(error)
            return
        except UnicodeError:
            self._refused = "this is no name of a machine"
            return
        else:
            self._server = server
        finally:
            self._listens.set()
        await self._stop.wait()
        server.close()
        with contextlib.suppress(TimeoutError):  # whoever never said what it wants, as browsers do, is not waited for
            await asyncio.wait_for(server.wait_closed(), CLOSING)

    def _answer(self, connection: ServerConnection, request: Request) -> Response | None:
        well = time.monotonic() - self.turned_at < STALLED
        return self._doors.answer(request, self._page, well=well)

    async def _talk(self, page: ServerConnection) -> None:
        """One page, from when it comes until it goes."""
        if len(self._clients) >= MOST_CLIENTS:  # a page can tell its user what a socket says, but not an HTTP status
            await page.close(CloseCode.TRY_AGAIN_LATER, "there is no room for another page")
            return
        self._numbers += 1
        number, client = self._numbers, Client(self._numbers, time.monotonic())
        self._clients[number], self._sockets[number] = client, page
        self.visitors = len(self._clients)
        for kind, data in self._kept.items():
            client.put(kind, data)
        sending = asyncio.create_task(self._send(page, client))
        try:
            await self._listen(page, client)
        except ConnectionClosed:
            pass
        except Malformed as wrong:
            await page.close(CloseCode.POLICY_VIOLATION, short(str(wrong)))
        finally:
            sending.cancel()
            del self._clients[number], self._sockets[number]
            self.visitors = len(self._clients)
            self.inbox.put((number, None))

    async def _listen(self, page: ServerConnection, client: Client) -> None:
        async for message in page:
            said = heard(message)
            if not client.may_say(time.monotonic(), COSTS.get(said.what, 1)):
                raise Malformed("too many messages")
            if said.what == "seen":
                client.shown(said.value)
            else:
                self.inbox.put((client.number, said))

    async def _send(self, page: ServerConnection, client: Client) -> None:
        with contextlib.suppress(ConnectionClosed):
            while True:
                await client.something.wait()
                client.something.clear()
                while (data := client.next()) is not None:
                    await page.send(data)

    def _publish(self, kind: str, data: bytes) -> None:
        if kind == "scene":
            self._kept.clear()
        self._kept[kind] = data
        for client in self._clients.values():
            client.put(kind, data)

    def _put(self, visitor: int, kind: str, data: bytes) -> None:
        if visitor in self._clients:
            self._clients[visitor].put(kind, data)

    def _turn_out(self, visitor: int, why: str) -> None:
        if visitor in self._sockets:
            closing = asyncio.ensure_future(self._sockets[visitor].close(CloseCode.POLICY_VIOLATION, short(why)))
            self._closing.add(closing)  # the loop itself would forget it
            closing.add_done_callback(self._closing.discard)


def refusal(error: OSError) -> str:
    """Why nothing can listen there, and what helps."""
    if isinstance(error, socket.gaierror):
        return f"{error.strerror}".lower()
    why = os.strerror(error.errno).lower() if error.errno else str(error)
    busy = error.errno in (errno.EADDRINUSE, errno.EACCES)
    return f"{why}; --port 0 takes any port that is free" if busy else why


def short(text: str) -> str:
    """As much as fits into the frame that closes a socket: 123 bytes."""
    return text.encode()[:120].decode(errors="ignore")
