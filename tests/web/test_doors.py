"""Who is let in."""

from __future__ import annotations

import pytest
from websockets.datastructures import Headers
from websockets.http11 import Request

from taichi_cloth.web.doors import Doors, is_loopback

HERE = Doors("", only_loopback=True)
OPEN = Doors("the word/+ä", only_loopback=False)


def status(doors: Doors, path: str, host: str = "localhost:8080", *, origin: str = "") -> int | None:
    headers = Headers(Host=host) if not origin else Headers(Host=host, Origin=origin)
    answer = doors.answer(Request(path, headers), b"<html>", well=True)
    return None if answer is None else answer.status_code


def test_on_this_machine_everybody_comes_in() -> None:
    for host in ("localhost:8080", "127.0.0.1:1", "[::1]:8080", "localhost", "LOCALHOST", "127.0.0.2:8080"):
        assert status(HERE, "/", host) == 200
        assert status(HERE, "/live", host) is None
    assert status(HERE, "/?plain") == 200
    assert status(HERE, "/page.html") == status(HERE, "/../../etc/passwd") == 404


@pytest.mark.parametrize(
    "host",
    ["evil.example:8080", "localhost.evil.example", "127.0.0.1.evil.example:8080", "", "[::", "192.168.1.5:8080"],
)
def test_a_name_that_was_pointed_here_is_refused(host: str) -> None:
    assert status(HERE, "/", host) == status(HERE, "/live", host) == 403


def test_only_its_own_page_may_connect() -> None:
    assert status(HERE, "/live", origin="http://localhost:8080") is None
    for origin in ("http://evil.example", "http://localhost:9999", "null", "http://localhost:8080.evil.example"):
        assert status(HERE, "/live", origin=origin) == 403


def test_with_a_token_nothing_is_sent_without_it() -> None:
    for path in ("/", "/live", "/elsewhere"):
        for query in ("", "?token=", "?token=the", "?token=the+word", "?word=the%20word%2F%2B%C3%A4", "?token=%ff"):
            assert status(OPEN, path + query, "remote.example:8080") == 401
    assert status(OPEN, "/" + OPEN.tail, "remote.example:8080") == 200
    assert status(OPEN, "/live" + OPEN.tail, "remote.example:8080") is None


def test_its_health_is_told_to_everybody_and_nothing_else() -> None:
    for well, expected in ((True, (200, b"ok\n")), (False, (503, b"stalled\n"))):
        answer = OPEN.answer(Request("/healthz", Headers()), b"<html>", well=well)
        assert answer is not None
        assert (answer.status_code, answer.body) == expected


def test_which_addresses_only_this_machine_reaches() -> None:
    assert all(map(is_loopback, ("localhost", "127.0.0.1", "127.8.8.8", "::1")))
    assert not any(map(is_loopback, ("0.0.0.0", "::", "192.168.1.5", "example.org", "")))
