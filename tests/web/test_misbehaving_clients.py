"""A server with misbehaving clients: malformed messages, floods, clients that do not read, and invalid addresses."""

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

from taichi_cloth.__main__ import main
from taichi_cloth.cli.run import iframe
from taichi_cloth.system.errors import install_command
from taichi_cloth.web.protocol import MAX_BYTES

TOKEN = "open sesame"
RECEIVED: Counter[UUID] = Counter()  # updates received on each socket


@pytest.fixture(scope="module")
def server(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Server]:
    folder = tmp_path_factory.mktemp("server")
    server = Server(folder, "drape15", "--host", "0.0.0.0", "--token", TOKEN, "--print-iframe", "--layout", "serial")
    yield server
    server.stop()


def connect_to(server: Server, query: str = "?token=open%20sesame") -> ClientConnection:
    return connect(f"ws://127.0.0.1:{server.port}/live{query}", compression=None, max_size=None)


def frames(socket: ClientConnection, count: int) -> list[int]:
    """Return the frame numbers of the next updates, and acknowledge each."""
    found: list[int] = []
    while len(found) < count:
        message = socket.recv(timeout=20)
        assert isinstance(message, bytes)
        head = json.loads(message[4 : 4 + int.from_bytes(message[:4], "little")])
        if head["kind"] == "update":
            found.append(head["frame"])
            RECEIVED[socket.id] += 1
            socket.send(json.dumps({"displayed": RECEIVED[socket.id], "sceneId": head["sceneId"]}))
    return found


def drain(socket: ClientConnection) -> None:
    """Read until the connection ends."""
    while True:
        socket.recv(timeout=20)


def reason(socket: ClientConnection) -> str:
    """Return the reason with which the server closes the connection."""
    with pytest.raises(ConnectionClosed) as closed:
        drain(socket)
    assert closed.value.rcvd is not None
    assert closed.value.rcvd.code in (1008, 1009)
    return closed.value.rcvd.reason


def test_the_server_prints_a_warning_and_its_address(server: Server) -> None:
    assert "anyone with this address can control the scene" in server.output
    assert server.address.endswith("?token=open%20sesame")


def test_a_wrong_token_gets_only_an_error(server: Server) -> None:
    for query in ("", "?token=", "?token=open+sesame!"):
        status, text = server.get(f"/{query}")
        assert (status, text.count("\n")) == (401, 1)
        with pytest.raises(InvalidStatus) as refused, connect_to(server, query):
            pass
        assert refused.value.response.status_code == 401
    assert server.get("/?token=open%20sesame")[0] == 200
    assert server.get("/healthz") == (200, "ok\n")


def test_updates_arrive_in_order(server: Server) -> None:
    with connect_to(server) as page:
        found = frames(page, 20)
    assert found == sorted(set(found))


def test_a_thousand_malformed_messages_close_the_connections_of_their_senders(server: Server) -> None:
    noise = random.Random(0)
    malformed = ["", "{", "[]", '{"sceneId":0,"action":"quit"}', "\U0001f9f5" * 50, '{"sceneId":0}', "[" * 2000]
    with connect_to(server) as other:
        frames(other, 3)
        before = server.memory
        for k in range(1000):
            with connect_to(server) as sender:
                text = malformed[k % len(malformed)] if k % 3 else noise.randbytes(noise.randrange(1, 200))
                sender.send(text)
                assert reason(sender)
            if k % 100 == 0:
                frames(other, 2)
        frames(other, 5)
        assert server.memory < before + 40
    assert server.get("/healthz") == (200, "ok\n")


def test_commands_with_unknown_names_close_the_connection(server: Server) -> None:
    for command in ({"set": ["gravitas", 1]}, {"choose": ["scene", "/etc/passwd"]}, {"switch": {"cloth": True}}):
        with connect_to(server) as sender:
            frames(sender, 1)
            sender.send(json.dumps({**command, "sceneId": 0}))
            assert reason(sender)


def test_commands_for_an_earlier_scene_are_ignored(server: Server) -> None:
    with connect_to(server) as page:
        page.send(json.dumps({"set": ["gravitas", 1], "sceneId": -1}))
        assert len(frames(page, 5)) == 5


def test_a_flood_closes_only_its_own_connection(server: Server) -> None:
    with connect_to(server) as other, connect_to(server) as flood:
        for _ in range(2000):
            try:
                flood.send('{"sceneId":0,"release":null}')
            except ConnectionClosed:
                break
        assert reason(flood) == "too many messages"
        frames(other, 10)


def test_a_message_that_is_too_long_closes_its_connection(server: Server) -> None:
    with connect_to(server) as sender:
        sender.send('{"sceneId":0,"release":null' + " " * MAX_BYTES + "}")
        reason(sender)


def test_a_client_that_does_not_read_delays_no_other(server: Server) -> None:
    """Updates that a client does not read are dropped."""
    incomplete = socket.create_connection(("127.0.0.1", server.port))
    with incomplete, connect_to(server), connect_to(server) as other:
        incomplete.sendall(b"GET / HTTP/1.1\r\n")  # and an incomplete request
        frames(other, 10)
        before = server.memory
        found = frames(other, 60)
        assert found[-1] - found[0] < 60 * 6
        assert server.memory < before + 20


def test_at_most_sixteen_pages_can_be_open(server: Server) -> None:
    """docs/web.md states the number. A page is rejected only after it has connected, so each must get a frame."""
    with ExitStack() as stack:
        pages = [stack.enter_context(connect_to(server)) for _ in range(16)]
        for page in pages:
            assert frames(page, 1)
        with connect_to(server) as rejected, pytest.raises(ConnectionClosed) as refused:
            drain(rejected)
    assert refused.value.rcvd is not None
    assert (refused.value.rcvd.code, refused.value.rcvd.reason) == (1013, "too many pages are open")


def test_a_port_in_use_is_reported(server: Server, capfd: pytest.CaptureFixture[str]) -> None:
    assert main(["web", "drape15", "--host", "0.0.0.0", "--port", str(server.port)]) == 2
    line = capfd.readouterr().err
    assert line.count("\n") == 1
    assert f"cannot listen on 0.0.0.0, port {server.port}: address already in use; --port 0" in line


@pytest.mark.parametrize(
    ("arguments", "line"),
    [
        (["web", "--host", "no.such.host.invalid"], "cannot listen on no.such.host.invalid, port 8080: "),
        (["web", "--host", "a..b"], "cannot listen on a..b, port 8080: invalid host name"),
        (["web", "--port", "70000"], "'70000' is not a port from 0 to 65535"),
        (["web", "--token", "abc"], "a token needs 8 or more printable characters"),
        (["web", "curtian"], "did you mean 'curtain'"),
    ],
)
def test_usage_errors_are_one_line(arguments: list[str], line: str, capfd: pytest.CaptureFixture[str]) -> None:
    try:
        code = main(arguments)
    except SystemExit as end:
        code = int(end.code or 0)
    printed = capfd.readouterr().err
    assert code == 2
    assert line in printed
    assert printed.count("\n") == 1


def test_without_websockets_the_error_has_the_pip_command(
    monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    assert main(["web"]) == 2
    assert f"the browser view needs websockets: {install_command('web')}\n" in capfd.readouterr().err


def test_the_iframe_element_is_escaped_html(server: Server) -> None:
    assert iframe("http://a:1/?token=x").startswith('<iframe src="http://a:1/?token=x&amp;plain" width="960"')
    assert iframe("http://a:1/").startswith('<iframe src="http://a:1/?plain"')


@pytest.mark.skipif(sys.platform == "win32", reason="sends Ctrl-C as a signal")
def test_ctrl_c_ends_the_server_at_once_with_open_pages(tmp_path_factory: pytest.TempPathFactory) -> None:
    short = Server(tmp_path_factory.mktemp("short"), "drape15", "--layout", "serial")
    with connect_to(short, "") as page, socket.create_connection(("127.0.0.1", short.port)):  # which sends nothing
        frames(page, 3)
        assert short.stop(signal.SIGINT) == (0, "stopped\n")
        with pytest.raises(ConnectionClosed):
            drain(page)
