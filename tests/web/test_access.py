"""Access control: host names, tokens and origins."""

from __future__ import annotations

import pytest
from websockets.datastructures import Headers
from websockets.http11 import Request

from taichi_cloth.web.server import AccessControl, is_loopback

LOOPBACK = AccessControl("", only_loopback=True)
PUBLIC = AccessControl("the word/+ä", only_loopback=False)


def status(access: AccessControl, path: str, host: str = "localhost:8080", *, origin: str = "") -> int | None:
    headers = Headers(Host=host) if not origin else Headers(Host=host, Origin=origin)
    answer = access.answer(Request(path, headers), b"<html>", healthy=True)
    return None if answer is None else answer.status_code


def test_requests_to_loopback_names_are_served() -> None:
    for host in ("localhost:8080", "127.0.0.1:1", "[::1]:8080", "localhost", "LOCALHOST", "127.0.0.2:8080"):
        assert status(LOOPBACK, "/", host) == 200
        assert status(LOOPBACK, "/live", host) is None
    assert status(LOOPBACK, "/?plain") == 200
    assert status(LOOPBACK, "/page.html") == status(LOOPBACK, "/../../etc/passwd") == 404


@pytest.mark.parametrize(
    "host",
    ["evil.example:8080", "localhost.evil.example", "127.0.0.1.evil.example:8080", "", "[::", "192.168.1.5:8080"],
)
def test_other_host_names_are_rejected(host: str) -> None:
    assert status(LOOPBACK, "/", host) == status(LOOPBACK, "/live", host) == 403


def test_only_the_own_page_of_the_server_may_connect() -> None:
    assert status(LOOPBACK, "/live", origin="http://localhost:8080") is None
    for origin in ("http://evil.example", "http://localhost:9999", "null", "http://localhost:8080.evil.example"):
        assert status(LOOPBACK, "/live", origin=origin) == 403


def test_requests_without_the_token_are_rejected() -> None:
    for path in ("/", "/live", "/elsewhere"):
        for query in ("", "?token=", "?token=the", "?token=the+word", "?word=the%20word%2F%2B%C3%A4", "?token=%ff"):
            assert status(PUBLIC, path + query, "remote.example:8080") == 401
    assert status(PUBLIC, "/" + PUBLIC.query, "remote.example:8080") == 200
    assert status(PUBLIC, "/live" + PUBLIC.query, "remote.example:8080") is None


def test_healthz_answers_everyone() -> None:
    for healthy, expected in ((True, (200, b"ok\n")), (False, (503, b"stalled\n"))):
        answer = PUBLIC.answer(Request("/healthz", Headers()), b"<html>", healthy=healthy)
        assert answer is not None
        assert (answer.status_code, answer.body) == expected


def test_loopback_addresses_are_recognized() -> None:
    assert all(map(is_loopback, ("localhost", "127.0.0.1", "127.8.8.8", "::1")))
    assert not any(map(is_loopback, ("0.0.0.0", "::", "192.168.1.5", "example.org", "")))
