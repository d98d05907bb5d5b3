"""The page in a real browser, served by a real server."""

from __future__ import annotations

import time
from collections.abc import Iterator

import numpy as np
import pytest
from chromium import Browser, chromium
from server import Server

SIZE = 1100, 620  # [pixels] space for the panel and the cloth beside it
POSITIONS = "Array.from(cloth.positions)"
# The screen point of a position [pixels].
ON_SCREEN = """(([x, y, z], m, w, h) => {
  const clip = [0, 1, 3].map((r) => m[r] * x + m[4 + r] * y + m[8 + r] * z + m[12 + r]);
  return [(1 + clip[0] / clip[2]) * w / 2, (1 - clip[1] / clip[2]) * h / 2];
})(%s, camera.viewProjection(canvas.width / canvas.height)[1], canvas.clientWidth, canvas.clientHeight)"""


@pytest.fixture(scope="module")
def server(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Server]:
    server = Server(tmp_path_factory.mktemp("server"), "curtain", "--set", "wind_z=0.5")
    yield server
    server.stop()


@pytest.fixture(scope="module")
def first(server: Server, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Browser]:
    pipe = chromium(tmp_path_factory.mktemp("browser"))
    page = Browser(pipe, SIZE)
    open_page(page, server)
    yield page
    pipe.close()


def open_page(page: Browser, server: Server, query: str = "") -> None:
    page.open(server.address, query, ready="typeof update !== 'undefined' && update && sliders.gravity")


@pytest.fixture
def page(first: Browser) -> Iterator[Browser]:
    """The first page, with the cloth reset and running."""
    first.value("send('action', 'restore_defaults'); send('action', 'reset'); location.hash = ''")
    if first.value("document.querySelector('[data-action=freeze]').ariaPressed") == "true":
        first.value("send('action', 'freeze')")
    yield first
    assert first.errors == []


@pytest.fixture
def second(page: Browser, server: Server) -> Iterator[Browser]:
    other = page.another()
    open_page(other, server)
    yield other
    other.kill()


def middle_of(page: Browser, selector: str) -> tuple[float, float]:
    x, y = page.value(
        f"(box => [box.x + box.width / 2, box.y + box.height / 2])(find('{selector}').getBoundingClientRect())"
    )
    return x, y


def particle(page: Browser, index: int) -> tuple[float, float]:
    """Return the screen point of a particle [pixels]."""
    x, y = page.value(ON_SCREEN % f"cloth.positions.slice({3 * index}, {3 * index} + 3)")
    return x, y


def press(page: Browser, index: int) -> tuple[float, float]:
    """Press on a particle, and wait until it is grabbed. Return its screen point."""
    x, y = particle(page, index)
    page.mouse("Pressed", x, y, button="left", clickCount=1)
    page.until("drag?.state === 'grabbing' && update.dragged > 0")
    return x, y


def same_cloth(page: Browser, other: Browser) -> bool:
    """Wait until both pages show the same frozen cloth. Return whether they do."""
    shown = f"[update.frame, ...{POSITIONS}]"
    for _ in range(300):  # a slow machine needs them
        if page.value(shown) == other.value(shown):
            return True
        time.sleep(0.05)
    return False


def release(page: Browser, x: float, y: float) -> None:
    """Release the left button."""
    page.mouse("Released", x, y, button="left", clickCount=1)


def test_the_page_loads_nothing_else_and_the_cloth_moves(page: Browser, server: Server) -> None:
    assert page.requests == [server.address]
    assert page.value("document.title === scene.title + ' · taichi_cloth'")
    # The frame number falls once, when the reset of the fixture arrives: only positions show that the cloth moves.
    page.until("update.frame > 20")
    before = page.value(POSITIONS)
    page.until(f"{POSITIONS}.some((x, i) => Math.abs(x - {before}[i]) > 1e-3)")
    image = page.picture().astype(int)
    r, g, b = np.moveaxis(image, -1, 0)
    assert ((r > 90) & (g < 0.45 * r) & (b < 0.5 * r)).mean() > 0.03, "the curtain is red"


def test_a_drag_moves_the_particle_to_the_cursor(page: Browser) -> None:
    x, y = press(page, 6 * 30 + 15)
    for k in range(1, 11):
        page.mouse("Moved", x + 6 * k, y - 3 * k, button="left", buttons=1)
    cursor = x + 60, y - 30
    frame = page.value("update.frame")
    page.until(f"update.frame > {frame} + 15")
    marker = page.value(ON_SCREEN % "update.markerPositions.slice(0, 3)")
    assert np.hypot(*np.subtract(marker, cursor)) < 0.05 * SIZE[1]
    release(page, *cursor)
    page.until("update.dragged === 0")


def test_a_drag_beside_the_cloth_orbits_and_the_wheel_zooms(page: Browser) -> None:
    azimuth, distance = page.value("[camera.azimuth, camera.orbitDistance]")
    page.mouse("Pressed", 700, 600, button="left", clickCount=1)
    page.until("drag?.state === 'orbiting'")
    page.mouse("Moved", 600, 600, button="left", buttons=1)
    release(page, 600, 600)
    assert page.value("camera.azimuth") > azimuth
    page.mouse("Wheel", 500, 200, deltaX=0, deltaY=-240)
    page.until(f"camera.orbitDistance < 0.9 * {distance}")
    page.key("KeyF", "f")
    page.until(f"camera.orbitDistance === {distance} && camera.azimuth === {azimuth}")


def test_the_right_button_orbits_over_the_cloth_too(page: Browser) -> None:
    azimuth = page.value("camera.azimuth")
    x, y = particle(page, 6 * 30 + 15)
    page.mouse("Pressed", x, y, button="right", clickCount=1)
    page.mouse("Moved", x + 50, y, button="right", buttons=2)
    page.mouse("Released", x + 50, y, button="right", clickCount=1)
    assert page.value("camera.azimuth") < azimuth
    assert page.value("update.dragged") == 0
    page.value("camera.reset()")


def test_a_slider_changes_gravity_on_every_page(page: Browser, second: Browser) -> None:
    second.value("find('input[name=gravity]').scrollIntoView()")
    x, y = middle_of(second, "input[name=gravity]")
    second.mouse("Pressed", x + 40, y, button="left", clickCount=1)
    second.mouse("Moved", x + 80, y, button="left", buttons=1)
    release(second, x + 80, y)
    moved = float(second.value("find('input[name=gravity]').value"))
    assert moved > 12.0
    page.until(f"Math.abs(parameters.gravity - {moved}) < 1e-6 && +find('input[name=gravity]').value === {moved}")


def test_two_pages_show_the_same_cloth(page: Browser, second: Browser) -> None:
    x, y = press(second, 7 * 30 + 5)
    second.mouse("Moved", x + 40, y - 20, button="left", buttons=1)
    page.until("update.dragged === 1")
    page.key("Space", " ")
    for one in (page, second):
        one.until("find('[data-action=freeze]').ariaPressed === 'true'")
    assert same_cloth(page, second)
    page.key("KeyN", "n")
    assert same_cloth(page, second)
    release(second, x + 40, y - 20)
    page.key("Space", " ")


def test_two_pages_can_drag_at_once(page: Browser, second: Browser) -> None:
    first = press(page, 7 * 30 + 3)
    other = press(second, 7 * 30 + 26)
    page.until("update.dragged === 2")
    release(page, *first)
    page.until("update.dragged === 1")
    release(second, *other)
    page.until("update.dragged === 0")


def test_a_page_that_is_killed_releases_its_grab(page: Browser, server: Server) -> None:
    other = page.another()
    open_page(other, server)
    press(other, 7 * 30 + 10)
    page.until("update.dragged === 1")
    other.kill()
    page.until("update.dragged === 0")


def test_keys_act_after_a_click_on_a_button_and_space_activates_the_button(page: Browser) -> None:
    x, y = middle_of(page, "[data-action=freeze]")
    page.mouse("Pressed", x, y, button="left", clickCount=1)
    release(page, x, y)
    page.until("find('[data-action=freeze]').ariaPressed === 'true'")
    frame = page.value("update.frame")
    page.value(
        "sent = []; original = send;"
        "send = (...words) => { if (words[0] === 'action') sent.push(words); original(...words); }"
    )
    page.key("KeyN", "n")
    assert page.value("sent") == [["action", "step"]]
    page.value("send = original")
    stroke = {"code": "Space", "key": " ", "windowsVirtualKeyCode": 32}
    page.call("Input.dispatchKeyEvent", type="keyDown", text=" ", **stroke)
    page.call("Input.dispatchKeyEvent", type="keyUp", **stroke)
    page.until("find('[data-action=freeze]').ariaPressed === 'false'")
    page.until(f"update.frame > {frame} + 9")
    page.value("document.activeElement.blur()")


def test_moves_are_sent_at_most_sixty_times_a_second(page: Browser) -> None:
    page.value("sent = []; original = send; send = (...words) => { sent.push(words); original(...words); }")
    page.value("""new Promise((done) => {
      let k = 0;
      const timer = setInterval(() => {
        sendSoon('gravity', ((k) => () => send('set', ['gravity', 5 + k / 100]))(k));
        if (++k === 100) { clearInterval(timer); setTimeout(done, 50); }
      }, 2);
    })""")
    sent = page.value("sent.filter(([what]) => what === 'set').map(([, [, value]]) => value)")
    page.value("send = original")
    assert len(sent) <= 50
    assert sent[-1] == 5.99


def test_the_strain_view_has_colors_and_a_scale(page: Browser) -> None:
    before = page.picture()
    page.key("KeyV", "v")
    page.until("update && isStrainView && !find('.scale').hidden")
    page.value("new Promise(done => requestAnimationFrame(() => requestAnimationFrame(() => done(1))))")
    after = page.picture()
    assert np.abs(after.astype(int) - before).mean() > 5
    page.key("KeyV", "v")
    page.until("!isStrainView && find('.scale').hidden")


def test_statistics_and_charts_are_drawn(page: Browser) -> None:
    page.until("chartRows.length > 20 && find('.statistics').textContent.includes('curtain')")
    ink = "(c => c.getContext('2d').getImageData(0, 0, c.width, c.height).data.some(v => v))"
    assert page.value(f"[...document.querySelectorAll('.charts canvas')].every({ink})")


def test_a_lost_connection_is_restored(page: Browser) -> None:
    page.value("socket.close()")
    page.until("socket.readyState === WebSocket.OPEN && note.textContent === ''")
    frame = page.value("update.frame")
    page.until(f"update.frame > {frame}")


def test_plain_shows_only_the_cloth(page: Browser, server: Server) -> None:
    other = page.another()
    open_page(other, server, "?plain")
    assert other.value("find('aside').offsetWidth") == 0
    other.kill()


def test_another_solver_and_another_scene_can_be_chosen(page: Browser) -> None:
    for name, value, condition in (
        ("solver", "explicit", "find('.statistics').textContent.includes('explicit ')"),
        ("scene", "drape15", "scene.name === 'drape15' && update?.sceneId === scene.sceneId"),
        ("scene", "curtain", "scene.name === 'curtain' && update?.sceneId === scene.sceneId"),
    ):
        select = f"find('select[name={name}]')"
        page.value(f"{select}.value = '{value}'; {select}.dispatchEvent(new Event('change'))")
        page.until(condition)
    assert page.value("find('select[name=scene]').value") == "curtain"


def test_the_page_reports_that_the_server_has_ended(page: Browser, tmp_path_factory: pytest.TempPathFactory) -> None:
    short = Server(tmp_path_factory.mktemp("short"), "drape15")
    other = page.another()
    open_page(other, short)
    assert short.stop() == (0, "stopped\n")
    other.until("note.textContent.includes('cannot reach the server')")
    other.kill()
