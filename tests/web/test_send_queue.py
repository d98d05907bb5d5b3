"""The send queue of a page: the newest message of each kind, in order, few in flight; and its rate limit."""

from __future__ import annotations

import asyncio

from taichi_cloth.web.protocol import COSTS
from taichi_cloth.web.server import BURST, IN_FLIGHT, RATE, Connection


def send_all(connection: Connection) -> list[bytes]:
    """Remove and return all messages that may be sent now."""
    return list(iter(connection.next, None))


def connection() -> Connection:
    return asyncio.run(_connection())


async def _connection() -> Connection:
    return Connection(1, 0.0)


def test_only_the_newest_message_of_each_kind_is_sent() -> None:
    page = connection()
    for k in range(5):
        page.put("update", b"%d" % k)
        page.put("metrics", b"f%d" % k)
    assert send_all(page) == [b"f4", b"4"]


def test_a_new_scene_replaces_all_messages_about_the_last_one() -> None:
    page = connection()
    for kind in ("update", "panel", "metrics", "scene"):
        page.put(kind, b"old")
    page.put("scene", b"new scene")
    page.put("update", b"new update")
    assert send_all(page) == [b"new scene", b"new update"]


def test_a_page_that_acknowledges_nothing_gets_a_few_updates_and_all_other_messages() -> None:
    page = connection()
    sent = []
    for k in range(10):
        page.put("update", b"%d" % k)
        sent += send_all(page)
    assert sent == [b"%d" % k for k in range(IN_FLIGHT)]
    page.put("metrics", b"f")
    assert send_all(page) == [b"f"]
    page.acknowledge(1)
    assert send_all(page) == [b"9"]
    page.acknowledge(999)  # more than were sent
    for k in range(10, 20):
        page.put("update", b"%d" % k)
        send_all(page)
    assert page.next() is None


def test_the_rate_limit_has_a_burst_and_an_average() -> None:
    page = connection()
    assert sum(page.allow(0.0) for _ in range(1000)) == BURST
    page = connection()
    assert all(page.allow(k / 70) for k in range(10_000)), "the moves of a mouse"
    page = connection()
    allowed = sum(page.allow(k / 1000) for k in range(1, 10_001))
    assert allowed <= BURST + 10 * RATE


def test_expensive_commands_cost_more() -> None:
    page = connection()
    assert all(page.allow(k / 5, COSTS["press"]) for k in range(1000)), "five presses a second"
    page = connection()
    assert sum(page.allow(0.0, COSTS["action"]) for _ in range(1000)) == BURST / COSTS["action"]
