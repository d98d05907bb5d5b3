"""A server among strangers: wrong words, floods, those who do not listen, and wrong addresses."""

from __future__ import annotations

import importlib.util
import json
import random
import signal
import socket
import sys
from collections import Counter
from collections.abc import Iterator
from contextlib import ExitStack
from uuid import UUID

import pytest
from server import Server
from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.sync.client import ClientConnection, connect

from taichi_cloth.cli import main
from taichi_cloth.cli_web import embedding
from taichi_cloth.web.words import MOST_BYTES

TOKEN = "open sesame"
SEEN: Counter[UUID] = Counter()  # moments that came through each socket


@pytest.fixture(scope="module")
def server(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Server]:
    folder = tmp_path_factory.mktemp("server")
    server = Server(folder, "drape15", "--host", "0.0.0.0", "--token", TOKEN, "--embed", "--path", "list")
    yield server
    server.stop()


def live(server: Server, tail: str = "?token=open%20sesame") -> ClientConnection:
    return connect(f"ws://127.0.0.1:{server.port}/live{tail}", compression=None, max_size=None)


def frames(socket: ClientConnection, count: int) -> list[int]:
    """Numbers of the next moments, each of them shown."""
    found: list[int] = []
    while len(found) < count:
        message = socket.recv(timeout=20)
        assert isinstance(message, bytes)
        head = json.loads(message[4 : 4 + int.from_bytes(message[:4], "little")])
        if head["kind"] == "moment":
            found.append(head["frame"])
            SEEN[socket.id] += 1
            socket.send(json.dumps({"seen": SEEN[socket.id], "of": head["of"]}))
    return found


def drain(socket: ClientConnection) -> None:
    """Reads until the connection ends."""
    while True:
        socket.recv(timeout=20)


def reason(socket: ClientConnection) -> str:
    """Why the server ends the connection."""
    with pytest.raises(ConnectionClosed) as closed:
        drain(socket)
    assert closed.value.rcvd is not None
    assert closed.value.rcvd.code in (1008, 1009)
    return closed.value.rcvd.reason


def test_it_warns_and_says_where_it_is(server: Server) -> None:
    assert "anybody who knows this address can steer the cloth" in server.said
    assert server.address.endswith("?token=open%20sesame")


def test_a_wrong_token_is_told_nothing(server: Server) -> None:
    for tail in ("", "?token=", "?token=open+sesame!"):
        status, text = server.get(f"/{tail}")
        assert (status, text.count("\n")) == (401, 1)
        with pytest.raises(InvalidStatus) as refused, live(server, tail):
            pass
        assert refused.value.response.status_code == 401
    assert server.get("/?token=open%20sesame")[0] == 200
    assert server.get("/healthz") == (200, "ok\n")


def test_the_newest_moments_come_in_order(server: Server) -> None:
    with live(server) as page:
        found = frames(page, 20)
    assert found == sorted(set(found))


def test_a_thousand_wrong_messages_cost_their_senders_their_connection(server: Server) -> None:
    noise = random.Random(0)
    wrong = ["", "{", "[]", '{"of":0,"do":"quit"}', "\U0001f9f5" * 50, '{"of":0}', "[" * 2000]
    with live(server) as friend:
        frames(friend, 3)
        before = server.memory
        for k in range(1000):
            with live(server) as stranger:
                text = wrong[k % len(wrong)] if k % 3 else noise.randbytes(noise.randrange(1, 200))
                stranger.send(text)
                assert reason(stranger)
            if k % 100 == 0:
                frames(friend, 2)
        frames(friend, 5)
        assert server.memory < before + 40
    assert server.get("/healthz") == (200, "ok\n")


def test_what_this_scene_does_not_have_costs_it_too(server: Server) -> None:
    for said in ({"set": ["gravitas", 1]}, {"choose": ["scene", "/etc/passwd"]}, {"switch": {"cloth": True}}):
        with live(server) as stranger:
            frames(stranger, 1)
            stranger.send(json.dumps({**said, "of": 0}))
            assert reason(stranger)


def test_what_is_said_of_an_earlier_scene_does_nothing(server: Server) -> None:
    with live(server) as page:
        page.send(json.dumps({"set": ["gravitas", 1], "of": -1}))
        assert len(frames(page, 5)) == 5


def test_a_flood_ends_one_connection_and_no_other(server: Server) -> None:
    with live(server) as friend, live(server) as flood:
        for _ in range(2000):
            try:
                flood.send('{"of":0,"lift":null}')
            except ConnectionClosed:
                break
        assert reason(flood) == "too many messages"
        frames(friend, 10)


def test_a_message_that_is_too_long_ends_its_connection(server: Server) -> None:
    with live(server) as stranger:
        stranger.send('{"of":0,"lift":null' + " " * MOST_BYTES + "}")
        reason(stranger)


def test_one_who_does_not_listen_keeps_nobody_waiting(server: Server) -> None:
    """A socket that is never read from: what it is not sent is forgotten."""
    vague = socket.create_connection(("127.0.0.1", server.port))
    with vague, live(server), live(server) as friend:
        vague.sendall(b"GET / HTTP/1.1\r\n")  # and one that never says what it wants
        frames(friend, 10)
        before = server.memory
        found = frames(friend, 60)
        assert found[-1] - found[0] < 60 * 6
        assert server.memory < before + 20


def test_sixteen_pages_may_be_open_and_no_more(server: Server) -> None:
    """The number is that of docs/web.md. A page that is refused is told so by its socket: each must get a moment."""
    with ExitStack() as stack:
        pages = [stack.enter_context(live(server)) for _ in range(16)]
        for page in pages:
            assert frames(page, 1)
        with live(server) as late, pytest.raises(ConnectionClosed) as refused:
            drain(late)
    assert refused.value.rcvd is not None
    assert (refused.value.rcvd.code, refused.value.rcvd.reason) == (1013, "there is no room for another page")


def test_nobody_else_listens_at_its_port(server: Server, capfd: pytest.CaptureFixture[str]) -> None:
    assert main(["web", "drape15", "--host", "0.0.0.0", "--port", str(server.port)]) == 2
    line = capfd.readouterr().err
    assert line.count("\n") == 1
    assert f"cannot listen at 0.0.0.0, port {server.port}: address already in use; --port 0" in line


@pytest.mark.parametrize(
    ("words", "line"),
    [
        (["web", "--host", "no.such.host.invalid"], "cannot listen at no.such.host.invalid, port 8080: "),
        (["web", "--host", "a..b"], "cannot listen at a..b, port 8080: this is no name of a machine"),
        (["web", "--port", "70000"], "'70000' is not a port from 0 to 65535"),
        (["web", "--token", "abc"], "a token has 8 letters or more"),
        (["web", "curtian"], "did you mean 'curtain'"),
    ],
)
def test_wrong_use_is_one_line(words: list[str], line: str, capfd: pytest.CaptureFixture[str]) -> None:
    try:
        code = main(words)
    except SystemExit as end:
        code = int(end.code or 0)
    told = capfd.readouterr().err
    assert code == 2
    assert line in told
    assert told.count("\n") == 1


def test_without_websockets_it_says_what_to_install(
    monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    assert main(["web"]) == 2
    assert "pip install 'taichi-cloth[web]'" in capfd.readouterr().err


def test_the_line_for_another_page_is_html(server: Server) -> None:
    assert embedding("http://a:1/?token=x").startswith('<iframe src="http://a:1/?token=x&amp;plain" width="960"')
    assert embedding("http://a:1/").startswith('<iframe src="http://a:1/?plain"')


@pytest.mark.skipif(sys.platform == "win32", reason="sends Ctrl-C as a signal")
def test_ctrl_c_ends_it_at_once_with_pages_open(tmp_path_factory: pytest.TempPathFactory) -> None:
    short = Server(tmp_path_factory.mktemp("short"), "drape15", "--path", "list")
    with live(short, "") as page, socket.create_connection(("127.0.0.1", short.port)):  # which says nothing
        frames(page, 3)
        assert short.stop(signal.SIGINT) == (0, "ended\n")
        with pytest.raises(ConnectionClosed):
            drain(page)
