"""The page in a real browser, from a real server."""

from __future__ import annotations

import time
from collections.abc import Iterator

import numpy as np
import pytest
from chromium import Browser, chromium
from server import Server

SIZE = 1100, 620  # [pixels] room for the panel and the cloth beside it
PLACES = "Array.from(places.x)"
# Where a point is on the screen, in pixels.
ON_SCREEN = """(([x, y, z], m, w, h) => {
  const clip = [0, 1, 3].map((r) => m[r] * x + m[4 + r] * y + m[8 + r] * z + m[12 + r]);
  return [(1 + clip[0] / clip[2]) * w / 2, (1 - clip[1] / clip[2]) * h / 2];
})(%s, camera.seen(canvas.width / canvas.height)[1], canvas.clientWidth, canvas.clientHeight)"""


@pytest.fixture(scope="module")
def server(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Server]:
    server = Server(tmp_path_factory.mktemp("server"), "curtain", "--set", "wind_z=0.5")
    yield server
    server.stop()


@pytest.fixture(scope="module")
def first(server: Server, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Browser]:
    pipe = chromium(tmp_path_factory.mktemp("browser"))
    page = Browser(pipe, SIZE)
    look_at(page, server)
    yield page
    pipe.close()


def look_at(page: Browser, server: Server, tail: str = "") -> None:
    page.open(server.address, tail, ready="typeof moment !== 'undefined' && moment && sliders.gravity")


@pytest.fixture
def page(first: Browser) -> Iterator[Browser]:
    """The first page, with the cloth as it was at the start, moving."""
    first.value("say('do', 'own_values'); say('do', 'reset'); location.hash = ''")
    if first.value("document.querySelector('[data-do=freeze]').ariaPressed") == "true":
        first.value("say('do', 'freeze')")
    yield first
    assert first.errors == []


@pytest.fixture
def second(page: Browser, server: Server) -> Iterator[Browser]:
    other = page.another()
    look_at(other, server)
    yield other
    other.kill()


def middle_of(page: Browser, selector: str) -> tuple[float, float]:
    x, y = page.value(
        f"(box => [box.x + box.width / 2, box.y + box.height / 2])(find('{selector}').getBoundingClientRect())"
    )
    return x, y


def particle(page: Browser, index: int) -> tuple[float, float]:
    """Where it is to be seen [pixels]."""
    x, y = page.value(ON_SCREEN % f"places.x.slice({3 * index}, {3 * index} + 3)")
    return x, y


def press(page: Browser, index: int) -> tuple[float, float]:
    """Takes the cloth there, and goes on when it holds."""
    x, y = particle(page, index)
    page.mouse("Pressed", x, y, button="left", clickCount=1)
    page.until("pull?.state === 'holds' && moment.held > 0")
    return x, y


def same_cloth(page: Browser, other: Browser) -> bool:
    """Whether a cloth that stands still comes to be the same in both."""
    shown = f"[moment.frame, ...{PLACES}]"
    return any(page.value(shown) == other.value(shown) or time.sleep(0.05) for _ in range(300))  # a slow one needs it


def let_go(page: Browser, x: float, y: float) -> None:
    page.mouse("Released", x, y, button="left", clickCount=1)


def test_it_loads_asks_for_nothing_else_and_moves(page: Browser, server: Server) -> None:
    assert page.requests == [server.address]
    assert page.value("document.title === head.title + ' · taichi_cloth'")
    # Frames go back once, when the reset of the fixture arrives: only the cloth itself tells whether it moves.
    page.until("moment.frame > 20")
    before = page.value(PLACES)
    page.until(f"{PLACES}.some((x, i) => Math.abs(x - {before}[i]) > 1e-3)")
    picture = page.picture().astype(int)
    r, g, b = np.moveaxis(picture, -1, 0)
    assert ((r > 90) & (g < 0.45 * r) & (b < 0.5 * r)).mean() > 0.03, "the red of the curtain"


def test_a_drag_leads_the_particle_to_the_cursor(page: Browser) -> None:
    x, y = press(page, 6 * 30 + 15)
    for k in range(1, 11):
        page.mouse("Moved", x + 6 * k, y - 3 * k, button="left", buttons=1)
    here = x + 60, y - 30
    frame = page.value("moment.frame")
    page.until(f"moment.frame > {frame} + 15")
    bead = page.value(ON_SCREEN % "moment.bead.slice(0, 3)")
    assert np.hypot(*np.subtract(bead, here)) < 0.05 * SIZE[1]
    let_go(page, *here)
    page.until("moment.held === 0")


def test_beside_the_cloth_the_view_turns_and_the_wheel_zooms(page: Browser) -> None:
    azimuth, far = page.value("[camera.azimuth, camera.far]")
    page.mouse("Pressed", 700, 600, button="left", clickCount=1)
    page.until("pull?.state === 'turns'")
    page.mouse("Moved", 600, 600, button="left", buttons=1)
    let_go(page, 600, 600)
    assert page.value("camera.azimuth") > azimuth
    page.mouse("Wheel", 500, 200, deltaX=0, deltaY=-240)
    page.until(f"camera.far < 0.9 * {far}")
    page.key("KeyF", "f")
    page.until(f"camera.far === {far} && camera.azimuth === {azimuth}")


def test_the_right_button_turns_the_view_on_the_cloth_too(page: Browser) -> None:
    azimuth = page.value("camera.azimuth")
    x, y = particle(page, 6 * 30 + 15)
    page.mouse("Pressed", x, y, button="right", clickCount=1)
    page.mouse("Moved", x + 50, y, button="right", buttons=2)
    page.mouse("Released", x + 50, y, button="right", clickCount=1)
    assert page.value("camera.azimuth") < azimuth
    assert page.value("moment.held") == 0
    page.value("camera.reset()")


def test_a_slider_changes_gravity_and_every_page_sees_it(page: Browser, second: Browser) -> None:
    second.value("find('input[name=gravity]').scrollIntoView()")
    x, y = middle_of(second, "input[name=gravity]")
    second.mouse("Pressed", x + 40, y, button="left", clickCount=1)
    second.mouse("Moved", x + 80, y, button="left", buttons=1)
    let_go(second, x + 80, y)
    moved = float(second.value("find('input[name=gravity]').value"))
    assert moved > 12.0
    page.until(f"Math.abs(values.gravity - {moved}) < 1e-6 && +find('input[name=gravity]').value === {moved}")


def test_two_pages_show_the_same_cloth(page: Browser, second: Browser) -> None:
    x, y = press(second, 7 * 30 + 5)
    second.mouse("Moved", x + 40, y - 20, button="left", buttons=1)
    page.until("moment.held === 1")
    page.key("Space", " ")
    for one in (page, second):
        one.until("find('[data-do=freeze]').ariaPressed === 'true'")
    assert same_cloth(page, second)
    page.key("KeyN", "n")
    assert same_cloth(page, second)
    let_go(second, x + 40, y - 20)
    page.key("Space", " ")


def test_two_pages_pull_at_once(page: Browser, second: Browser) -> None:
    here = press(page, 7 * 30 + 3)
    there = press(second, 7 * 30 + 26)
    page.until("moment.held === 2")
    let_go(page, *here)
    page.until("moment.held === 1")
    let_go(second, *there)
    page.until("moment.held === 0")


def test_a_page_that_is_killed_lets_go(page: Browser, server: Server) -> None:
    other = page.another()
    look_at(other, server)
    press(other, 7 * 30 + 10)
    page.until("moment.held === 1")
    other.kill()
    page.until("moment.held === 0")


def test_keys_act_after_a_button_was_clicked_and_space_is_the_buttons_own(page: Browser) -> None:
    x, y = middle_of(page, "[data-do=freeze]")
    page.mouse("Pressed", x, y, button="left", clickCount=1)
    let_go(page, x, y)
    page.until("find('[data-do=freeze]').ariaPressed === 'true'")
    frame = page.value("moment.frame")
    page.value(
        "said = []; spoken = say; say = (...words) => { if (words[0] === 'do') said.push(words); spoken(...words); }"
    )
    page.key("KeyN", "n")
    assert page.value("said") == [["do", "step"]]
    page.value("say = spoken")
    stroke = {"code": "Space", "key": " ", "windowsVirtualKeyCode": 32}
    page.say("Input.dispatchKeyEvent", type="keyDown", text=" ", **stroke)
    page.say("Input.dispatchKeyEvent", type="keyUp", **stroke)
    page.until("find('[data-do=freeze]').ariaPressed === 'false'")
    page.until(f"moment.frame > {frame} + 9")
    page.value("document.activeElement.blur()")


def test_however_fast_a_screen_is_moves_are_said_sixty_times_a_second(page: Browser) -> None:
    page.value("said = []; spoken = say; say = (...words) => { said.push(words); spoken(...words); }")
    page.value("""new Promise((done) => {
      let k = 0;
      const timer = setInterval(() => {
        say_soon('gravity', ((k) => () => say('set', ['gravity', 5 + k / 100]))(k));
        if (++k === 100) { clearInterval(timer); setTimeout(done, 50); }
      }, 2);
    })""")
    said = page.value("said.filter(([what]) => what === 'set').map(([, [, value]]) => value)")
    page.value("say = spoken")
    assert len(said) <= 50
    assert said[-1] == 5.99


def test_strain_has_its_colours_and_its_scale(page: Browser) -> None:
    before = page.picture()
    page.key("KeyV", "v")
    page.until("moment && strained && !find('.scale').hidden")
    page.value("new Promise(done => requestAnimationFrame(() => requestAnimationFrame(() => done(1))))")
    after = page.picture()
    assert np.abs(after.astype(int) - before).mean() > 5
    page.key("KeyV", "v")
    page.until("!strained && find('.scale').hidden")


def test_figures_and_curves_are_drawn(page: Browser) -> None:
    page.until("rows.length > 20 && find('.figures').textContent.includes('curtain')")
    ink = "(c => c.getContext('2d').getImageData(0, 0, c.width, c.height).data.some(v => v))"
    assert page.value(f"[...document.querySelectorAll('.curves canvas')].every({ink})")


def test_a_connection_that_is_lost_comes_back(page: Browser) -> None:
    page.value("socket.close()")
    page.until("socket.readyState === WebSocket.OPEN && note.textContent === ''")
    frame = page.value("moment.frame")
    page.until(f"moment.frame > {frame}")


def test_plain_is_the_cloth_alone(page: Browser, server: Server) -> None:
    other = page.another()
    look_at(other, server, "?plain")
    assert other.value("find('aside').offsetWidth") == 0
    other.kill()


def test_another_method_and_another_scene_are_chosen(page: Browser) -> None:
    for name, value, seen in (
        ("solver", "spring", "find('.figures').textContent.includes('spring ')"),
        ("scene", "drape15", "head.name === 'drape15' && moment?.of === head.of"),
        ("scene", "curtain", "head.name === 'curtain' && moment?.of === head.of"),
    ):
        select = f"find('select[name={name}]')"
        page.value(f"{select}.value = '{value}'; {select}.dispatchEvent(new Event('change'))")
        page.until(seen)
    assert page.value("find('select[name=scene]').value") == "curtain"


def test_the_server_ends_and_the_page_says_so(page: Browser, tmp_path_factory: pytest.TempPathFactory) -> None:
    short = Server(tmp_path_factory.mktemp("short"), "drape15")
    other = page.another()
    look_at(other, short)
    assert short.stop() == (0, "ended\n")
    other.until("note.textContent.includes('out of reach')")
    other.kill()
