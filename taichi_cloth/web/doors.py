"""Who is let in: by the name the server is called by, by token, by the page that asks."""

from __future__ import annotations

import hmac
from dataclasses import dataclass
from http import HTTPStatus
from ipaddress import ip_address
from pathlib import Path
from urllib.parse import parse_qs, quote, urlsplit

from websockets.datastructures import Headers
from websockets.http11 import Request, Response

DOCUMENT = Path(__file__).with_name("page.html")
PAGE, LIVE, HEALTH = "/", "/live", "/healthz"

# The page fetches nothing but its own socket, and no address of it is told to others.
HEADERS = {
    "Content-Security-Policy": "default-src 'none'; script-src 'unsafe-inline'; style-src 'unsafe-inline'; "
    "connect-src 'self'; base-uri 'none'; form-action 'none'",
    "Cache-Control": "no-store",
    "Referrer-Policy": "no-referrer",
    "X-Content-Type-Options": "nosniff",
}


def is_loopback(host: str) -> bool:
    """Whether only this machine can reach it."""
    try:
        return host == "localhost" or ip_address(host).is_loopback
    except ValueError:
        return False


@dataclass(frozen=True)
class Doors:
    """Decides about every request before anything is sent."""

    token: str  # empty: whoever reaches the server may come in
    only_loopback: bool

    def answer(self, request: Request, page: bytes, *, well: bool) -> Response | None:
        """A page, an answer why not, or None where the socket may open.

        `well`: whether the simulation goes on.
        """
        address = urlsplit(request.path)
        if address.path == HEALTH:
            return plain(HTTPStatus.OK, "ok") if well else plain(HTTPStatus.SERVICE_UNAVAILABLE, "stalled")
        host = request.headers.get("Host", "")
        # A page of elsewhere whose name was pointed at this machine calls it by that name.
        if self.only_loopback and not is_loopback(_name(host)):
            return plain(HTTPStatus.FORBIDDEN, "this server is called localhost")
        if not self._knows(address.query):
            return plain(HTTPStatus.UNAUTHORIZED, "the address needs ?token= with the token that the server printed")
        if address.path == PAGE:
            return Response(200, "OK", Headers(**HEADERS, **_of(page, "text/html; charset=utf-8")), page)
        if address.path != LIVE:
            return plain(HTTPStatus.NOT_FOUND, "there is nothing here")
        if "Origin" in request.headers and urlsplit(request.headers["Origin"]).netloc != host:
            return plain(HTTPStatus.FORBIDDEN, "only the server's own page may connect")
        return None

    def _knows(self, query: str) -> bool:
        given = parse_qs(query).get("token", [""])[0]
        return not self.token or hmac.compare_digest(given.encode(), self.token.encode())

    @property
    def tail(self) -> str:
        """What an address needs behind it."""
        return f"?token={quote(self.token, safe='')}" if self.token else ""


def _name(host: str) -> str:
    """A host without its port; empty where it is none."""
    try:
        return urlsplit(f"//{host}").hostname or ""
    except ValueError:
        return ""


def plain(status: HTTPStatus, text: str) -> Response:
    """A line of text."""
    body = f"{text}\n".encode()
    return Response(status.value, status.phrase, Headers(**_of(body, "text/plain; charset=utf-8")), body)


def _of(body: bytes, kind: str) -> dict[str, str]:
    return {"Content-Type": kind, "Content-Length": str(len(body)), "Connection": "close"}
