"""What waits for a page: the newest of each kind, a scene before what is said of it, and little in flight."""

from __future__ import annotations

import asyncio

from taichi_cloth.web.client import BURST, IN_FLIGHT, RATE, Client
from taichi_cloth.web.words import COSTS


def everything(client: Client) -> list[bytes]:
    return list(iter(client.next, None))


def client() -> Client:
    return asyncio.run(_made())


async def _made() -> Client:
    return Client(1, 0.0)


def test_the_newest_is_sent_and_what_it_replaces_never_is() -> None:
    page = client()
    for k in range(5):
        page.put("moment", b"%d" % k)
        page.put("figures", b"f%d" % k)
    assert everything(page) == [b"f4", b"4"]


def test_another_scene_takes_the_place_of_all_that_was_said_of_the_last() -> None:
    page = client()
    for kind in ("moment", "panel", "figures", "scene"):
        page.put(kind, b"old")
    page.put("scene", b"new scene")
    page.put("moment", b"new moment")
    assert everything(page) == [b"new scene", b"new moment"]


def test_a_page_that_shows_nothing_is_sent_no_more_moments_but_all_else() -> None:
    page = client()
    sent = []
    for k in range(10):
        page.put("moment", b"%d" % k)
        sent += everything(page)
    assert sent == [b"%d" % k for k in range(IN_FLIGHT)]
    page.put("figures", b"f")
    assert everything(page) == [b"f"]
    page.shown(1)
    assert everything(page) == [b"9"]
    page.shown(999)  # more than there were
    for k in range(10, 20):
        page.put("moment", b"%d" % k)
        everything(page)
    assert page.next() is None


def test_it_may_say_so_much_at_once_and_so_much_for_long() -> None:
    page = client()
    assert sum(page.may_say(0.0) for _ in range(1000)) == BURST
    page = client()
    assert all(page.may_say(k / 70) for k in range(10_000)), "a mouse"
    page = client()
    said = sum(page.may_say(k / 1000) for k in range(1, 10_001))
    assert said <= BURST + 10 * RATE


def test_what_is_worked_for_costs_more() -> None:
    page = client()
    assert all(page.may_say(k / 5, COSTS["press"]) for k in range(1000)), "somebody who presses five times a second"
    page = client()
    assert sum(page.may_say(0.0, COSTS["do"]) for _ in range(1000)) == BURST / COSTS["do"]
