"""The page in a real browser, served by a real server."""

from __future__ import annotations

import time
from collections.abc import Iterator

import numpy as np
import pytest
from chromium import Browser, chromium
from server import Server

from taichi_cloth.render.shading import FULL_STRAIN, strain_colors

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


BALL = "update.poseMatrices.slice(12, 15)"


def test_a_drag_moves_a_ball(page: Browser) -> None:
    page.value("send('action', 'freeze'); send('action', 'reset')")  # it starts in front of the curtain
    page.until(f"update.frame === 0 && {BALL}[2] > 1.6")
    x, y = page.value(ON_SCREEN % BALL)
    page.mouse("Pressed", x, y, button="left", clickCount=1)
    page.until("drag?.state === 'grabbing'")
    page.value("send('action', 'freeze')")
    for k in range(1, 11):
        page.mouse("Moved", x + 8 * k, y - 4 * k, button="left", buttons=1)
    page.until(f"Math.hypot(({ON_SCREEN % BALL})[0] - {x + 80}, ({ON_SCREEN % BALL})[1] - {y - 40}) < 20")
    assert page.value("update.dragged") == 0  # no cloth
    release(page, x + 80, y - 40)


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


def test_zoom_stops_in_front_of_the_cloth(page: Browser) -> None:
    page.until("update.frame > 5")
    line = "{ target: camera.target, distance: camera.distance(canvas.width / canvas.height), back: camera.axes()[2] }"
    began, share, closest, back = page.value(
        f"""(() => {{
          camera.target = [0, 2, -2]; // behind the cloth
          const began = camera.orbitDistance;
          const share = clothInFront({line}, cloth.vertices, cloth.corners, cloth.corners.length);
          const distances = [1e-3, 2].map((factor) => (renderer.zoom(camera, factor), camera.orbitDistance));
          camera.reset();
          return [began, share, ...distances];
        }})()"""
    )
    assert 0.5 < share * began < 4.0  # [m] the curtain swings about the plane z = 0
    assert closest == pytest.approx(1.03 * share * began, rel=1e-6)
    assert back == pytest.approx(2 * closest, rel=1e-6)


def test_the_right_button_orbits_over_the_cloth_too(page: Browser) -> None:
    azimuth = page.value("camera.azimuth")
    x, y = particle(page, 6 * 30 + 15)
    page.mouse("Pressed", x, y, button="right", clickCount=1)
    page.mouse("Moved", x + 50, y, button="right", buttons=2)
    page.mouse("Released", x + 50, y, button="right", clickCount=1)
    assert page.value("camera.azimuth") < azimuth
    assert page.value("update.dragged") == 0
    page.value("camera.reset()")


def test_the_middle_button_zooms(page: Browser) -> None:
    azimuth, distance = page.value("[camera.azimuth, camera.orbitDistance]")
    page.mouse("Pressed", 700, 300, button="middle", clickCount=1)
    page.mouse("Moved", 700, 100, button="middle", buttons=4)
    page.mouse("Released", 700, 100, button="middle", clickCount=1)
    page.until(f"camera.orbitDistance < 0.7 * {distance} && camera.azimuth === {azimuth}")
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


def test_a_slider_keeps_its_value_until_the_server_has_it(page: Browser) -> None:
    """A message that the server sent before it received the new value does not move the slider back."""
    gravity = "find('input[name=gravity]')"
    release_at = f"{gravity}.value = %s; {gravity}.oninput(); {gravity}.onchange()"
    assert page.value(f"{release_at % 15}; sliders.gravity.setValue(9.81); +{gravity}.value") == 15
    page.until("Math.abs(parameters.gravity - 15) < 1e-6")
    page.value("sliders.gravity.setValue(12)")  # of another page
    assert page.value(f"{release_at % 14}; {gravity}.dispatchEvent(new Event('dblclick', {{bubbles: true}}))")
    page.until(f"Math.abs(parameters.gravity - 9.81) < 1e-6 && Math.abs({gravity}.value - 9.81) < {gravity}.step")


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


def test_a_key_opens_the_help_and_a_button_undoes_a_pull(page: Browser) -> None:
    shown = "find('.keys-help').open && find('.keys').getBoundingClientRect().top < innerHeight"
    page.key("KeyA", "a")
    assert page.value(shown)
    assert page.value("find('.keys').textContent.includes('undo grab or pin')")
    assert page.value("find('.keys').textContent.includes('two fingerszoom')")
    page.key("KeyA", "a")
    assert not page.value("find('.keys-help').open")
    page.key("KeyH", "h")
    page.key("KeyA", "a")
    assert page.value(f"{shown} && !document.body.classList.contains('panel-hidden')")
    page.key("KeyA", "a")
    x, y = press(page, 7 * 30 + 5)
    frame = page.value("update.frame")
    page.mouse("Moved", x + 40, y - 20, button="left", buttons=1)
    page.until(f"update.frame > {frame} + 10")
    release(page, x + 40, y - 20)
    page.value("find('[data-action=undo]').click()")
    page.until(f"find('[data-action=freeze]').ariaPressed === 'true' && update.frame <= {frame}")
    page.key("Space", " ")
    page.until("find('[data-action=freeze]').ariaPressed === 'false'")


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
    page.until("update && shownView === 'strain' && !find('.scale').hidden")
    page.value("new Promise(done => requestAnimationFrame(() => requestAnimationFrame(() => done(1))))")
    after = page.picture()
    assert np.abs(after.astype(int) - before).mean() > 5
    page.value("setView('shaded')")
    page.until("shownView === 'shaded' && find('.scale').hidden")


def test_the_page_colors_a_strain_as_the_window_does(page: Browser) -> None:
    strains = np.array([-0.3, -0.1, -0.03, -0.001, 0.0, 0.0004, 0.002, 0.05, 0.1, 2.0], np.float32)
    expected = np.zeros((len(strains), 3), np.float32)
    strain_colors(strains, expected)
    found = page.value(f"""{(strains / FULL_STRAIN).tolist()}.map((fraction) => {{
      const colors = new Uint8Array(3);
      writeScaleColor(colors, 0, fraction);
      return [...colors];
    }})""")
    assert np.array(found) == pytest.approx(255 * expected, abs=1)
    assert found[5] != found[4], "0.04 % is visible"


def test_the_error_view_has_colors_and_a_scale_once_it_is_measured(page: Browser) -> None:
    page.value("setView('strain')")
    page.key("KeyV", "v")
    page.until("shownView === 'error' && find('.scale').hidden")
    page.until("find('.measuring').textContent.startsWith('error of a frame: ')")  # also where statistics are folded
    before = page.picture().astype(int)
    page.value(
        "HANDLERS.frameError({ frame: 73, labels: ['5mm', '2.5mm', '0'] },"
        " (type, count) => new Uint8Array(count).fill(220))"
    )
    page.until("!find('.scale').hidden && find('.scale').textContent === 'frame 735mm2.5mm0'")
    page.until("find('.measuring').textContent === ''")
    page.value("new Promise(done => requestAnimationFrame(() => requestAnimationFrame(() => done(1))))")
    redness = np.subtract(*np.moveaxis(page.picture().astype(int) - before, 2, 0)[[0, 2]])
    assert (redness > 60).mean() > 0.02
    page.key("KeyV", "v")
    page.until("shownView === 'shaded' && find('.scale').hidden")


def test_mesh_edges_are_drawn_over_the_cloth_also_after_a_tear(page: Browser) -> None:
    page.value("send('action', 'freeze'); find('.messages').hidden = true")
    page.until("find('[data-action=freeze]').ariaPressed === 'true'")

    def picture(code: str) -> np.ndarray:
        """Return the picture beside the panel after a change of the page."""
        page.value(f"{code}; setFrame(); requestDraw()")
        page.value("new Promise(done => requestAnimationFrame(() => requestAnimationFrame(() => done(1))))")
        return page.picture()[:, 280:].astype(int)

    def darker(image: np.ndarray, before: np.ndarray) -> np.ndarray:
        return (image - before).sum(axis=2) < -60

    click = "find('[name=edges]').click()"
    last_hundred = (
        "Uint8Array.from({ length: Math.ceil(scene.triangles / 8) }, (_, k) => k < scene.triangles / 8 - 13 ? 0 : 255)"
    )
    plain = picture("0")
    edges = picture(click)
    torn = picture(f"removeTornTriangles({last_hundred})")
    without_edges = picture(click)
    whole = picture("removeTornTriangles(new Uint8Array(0))")
    page.value("send('action', 'freeze'); find('.messages').hidden = false")
    height = len(plain)
    assert 0.02 < darker(edges, plain).mean() < 0.2
    assert darker(edges, plain)[: height // 2].mean() > 0.02
    assert 0.002 < darker(torn, without_edges).mean() < 0.05
    assert not darker(torn, without_edges)[: height // 2].any(), "edges of triangles that are torn"
    assert (whole == plain).all()


def test_the_speed_is_the_same_on_every_page_and_slows_the_cloth(page: Browser, second: Browser) -> None:
    speeds = "[...find('select[name=speed]').options].map((option) => option.value)"
    assert page.value(speeds) == ["1", "1/2", "1/4", "1/8"]
    choose = "select = find('select[name=speed]'); select.value = '%s'; select.dispatchEvent(new Event('change'))"
    page.value(choose % "1/8")
    second.until("find('select[name=speed]').value === '1/8'")
    # A page on a busy machine may be many updates behind when the speed changes.
    assert any(0 < frames_per_second(page) < 60 / 8 + 3 for _ in range(60))
    second.value(choose % "1")
    page.until("find('select[name=speed]').value === '1'")


def frames_per_second(page: Browser) -> float:
    """Return the number of frames that a page shows in a second [1/s]."""
    frame, start = page.value("[update.frame, performance.now()]")
    page.until(f"performance.now() > {start} + 1000")
    later, end = page.value("[update.frame, performance.now()]")
    return float(1000 * (later - frame) / (end - start))


# Sizes of pages [pixels], and whether a finger is the pointer: a phone upright and on its side, and two windows.
PAGE_SIZES = [((390, 844), True), ((844, 390), True), ((1000, 600), False), ((1280, 720), False)]
VISIBLE_BOXES = """((selector) => [...document.querySelectorAll(selector)].filter((e) => e.checkVisibility())
  .map((e) => { const { left, top, right, bottom } = e.getBoundingClientRect();
    return [e.className || e.nodeName, left, top, right, bottom]; }).filter(([, l, t, r, b]) => r > l && b > t))"""


def resized(page: Browser, size: tuple[int, int], touch: bool) -> None:
    """Change the size of a page and its pointer."""
    page.size = size
    page.call("Emulation.setDeviceMetricsOverride", width=size[0], height=size[1], deviceScaleFactor=1, mobile=False)
    page.call("Emulation.setTouchEmulationEnabled", enabled=touch)
    pointer = "coarse" if touch else "fine"
    page.call("Emulation.setEmulatedMedia", features=[{"name": "pointer", "value": pointer}])


@pytest.mark.parametrize(("size", "touch"), PAGE_SIZES)
@pytest.mark.parametrize("hidden", [False, True], ids=["panel", "no panel"])
def test_the_cloth_is_visible_and_nothing_overlaps(
    page: Browser, server: Server, size: tuple[int, int], touch: bool, hidden: bool
) -> None:
    """Also with the scale of the strain view, and with every message."""
    other = page.another()
    resized(other, size, touch)
    open_page(other, server)
    assert other.value("document.body.classList.contains('panel-hidden')") is touch, "a phone shows the cloth first"
    other.value(f"document.body.classList.toggle('panel-hidden', {str(hidden).lower()}); setView('strain')")
    other.value(
        "HANDLERS.metrics = () => {};"
        "find('.alert').textContent = 'too slow: a frame needs 250 ms of 16.7; try lines';"
        "showNote('nothing to pin: no cloth under the cursor', 'refusal')"
    )
    other.until("find('.statistics').children.length > 8 && find('.alert').checkVisibility()")
    other.value("new Promise(done => requestAnimationFrame(() => requestAnimationFrame(() => done(1))))")
    boxes = other.value(f"{VISIBLE_BOXES}('aside, .panel-toggle, .column > *, .messages > *')")
    names = {name for name, *_ in boxes}
    assert {"panel-toggle", "scale", "alert", "note refusal"} <= names
    assert ("ASIDE" in names) is not hidden
    for k, (name, *box) in enumerate(boxes):
        assert 0 <= box[0] < box[2] <= size[0], name
        assert 0 <= box[1] < box[3] <= size[1], name
        for other_name, *second_box in boxes[k + 1 :]:
            if {name, other_name} != {"panel-toggle", "ASIDE"}:
                assert not overlap(box, second_box), (name, other_name)
    covered = np.zeros((size[1], size[0]), bool)
    for _, left, top, right, bottom in boxes:
        covered[int(top) : round(bottom), int(left) : round(right)] = True
    width, height = other.value("[canvas.clientWidth, canvas.clientHeight]")
    assert (~covered[:height, :width]).sum() > 0.5 * size[0] * size[1]
    frame = "Array.from({length: scene.particles}, (_, k) => %s)" % (
        ON_SCREEN % "cloth.positions.slice(3 * k, 3 * k + 3)"
    )
    u, v = np.array(other.value(frame)).T.astype(int)
    inside = (u >= 0) & (u < width) & (v >= 0) & (v < height)
    assert (inside & ~covered[v.clip(0, height - 1), u.clip(0, width - 1)]).mean() > 0.9
    other.kill()


def overlap(a: list[float], b: list[float]) -> bool:
    """Return whether two boxes (left, top, right, bottom) overlap by more than rounding."""
    return min(a[2], b[2]) - max(a[0], b[0]) > 0.5 and min(a[3], b[3]) - max(a[1], b[1]) > 0.5


@pytest.mark.parametrize("size", [size for size, touch in PAGE_SIZES if touch])
def test_every_control_is_large_enough_for_a_finger(page: Browser, server: Server, size: tuple[int, int]) -> None:
    other = page.another()
    resized(other, size, touch=True)
    open_page(other, server)
    other.value("find('.panel-toggle').click(); document.querySelectorAll('details').forEach((d) => (d.open = true))")
    # A check box is as large as its label, which a touch of it presses too; a slider is not.
    sizes = other.value("""[...document.querySelectorAll("button, select, summary, input, a")].map((control) => {
      const label = control.type === "checkbox" ? control.closest("label") : null;
      const { width, height } = (label ?? control).getBoundingClientRect();
      return [control.outerHTML.slice(0, 60), width, height];
    })""")
    assert len(sizes) > 20
    assert [control for control, width, height in sizes if min(width, height) < 44] == []
    other.kill()


SWIPES = {"scroll": (0, -12), "along": (12, 0), "tap": (0, 0)}


@pytest.mark.parametrize("swipe", SWIPES)
def test_a_finger_that_scrolls_the_panel_moves_no_slider(page: Browser, server: Server, swipe: str) -> None:
    """One that moves along a slider, or taps it, does."""
    other = page.another()
    resized(other, (390, 844), touch=True)
    open_page(other, server)
    slider = "find('input[name=damping]')"
    other.value(f"find('.panel-toggle').click(); {slider}.scrollIntoView({{ block: 'center' }})")
    before = other.value("parameters.damping")
    left, top, width, height = other.value(
        f"(({{ left, top, width, height }}) => [left, top, width, height])({slider}.getBoundingClientRect())"
    )
    x, y = left + 0.6 * width, top + height / 2
    other.call("Input.dispatchTouchEvent", type="touchStart", touchPoints=[{"x": x, "y": y}])
    for k in range(1, 9):
        point = {"x": x + k * SWIPES[swipe][0], "y": y + k * SWIPES[swipe][1]}
        if swipe != "tap":
            other.call("Input.dispatchTouchEvent", type="touchMove", touchPoints=[point])
    other.call("Input.dispatchTouchEvent", type="touchEnd", touchPoints=[])
    if swipe == "scroll":
        other.value("new Promise((done) => setTimeout(done, 600))")
        assert other.value("parameters.damping") == before
        assert float(other.value(f"{slider}.value")) == pytest.approx(before, abs=0.06)
    else:
        other.until(f"Math.abs(parameters.damping - {before}) > 0.5")
    other.kill()


def test_a_cloth_at_rest_has_flat_curves(page: Browser) -> None:
    legends = "[...document.querySelectorAll('.legend')].map((legend) => legend.lastChild.textContent)"
    page.value("metrics = HANDLERS.metrics; HANDLERS.metrics = () => {}; chartRows.length = 0")
    page.value("for (let k = 0; k < 50; k++) addChartRow([k / 10, 1e-5 * (k % 2), 70 + 1e-5 * (k % 2), 1e-4, 1e-4])")
    energy = page.value("scene.chartLimits[0]")
    assert 1e-3 < energy < 0.1
    assert page.value(legends) == [f"full scale {energy:.3g} J", "full scale 0.1 %"]
    page.value("addChartRow([5, 3, 70, 2, 1])")
    assert page.value(legends) == ["full scale 3 J", "full scale 2 %"]
    page.value("HANDLERS.metrics = metrics")


def test_the_statistics_have_the_view_of_their_page(page: Browser, second: Browser) -> None:
    second.value("setView('strain')")
    second.until("find('.statistics').firstChild.textContent.endsWith(' · strain')")
    page.until("find('.statistics').firstChild.textContent.endsWith(' · own fabric · shaded')")


def test_a_slider_that_is_moved_shows_its_help(page: Browser) -> None:
    page.value("input = find('input[name=gravity]'); input.value = 9; input.dispatchEvent(new Event('input'))")
    assert page.value("find('.help').textContent") == (
        "Gravity: downward acceleration; 0 to 20 m/s², scene default 9.81"
    )
    page.value("input.dispatchEvent(new Event('change'))")


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


def test_a_scene_that_arrives_before_the_last_updates_are_drawn_is_shown(page: Browser) -> None:
    page.value("drawNow = requestAnimationFrame; held = []; requestAnimationFrame = (draw) => held.push(draw)")
    page.until("received - displayed === 4")  # the server sends no more before it knows that they are displayed
    page.value("send('choose', ['scene', 'drape15'])")
    page.until("scene.name === 'drape15'")
    page.value("requestAnimationFrame = drawNow; for (const draw of held) draw()")
    page.until("update?.sceneId === scene.sceneId")
    page.value("send('choose', ['scene', 'curtain'])")
    page.until("scene.name === 'curtain' && update?.sceneId === scene.sceneId")


def test_the_page_reports_that_the_server_has_ended(page: Browser, tmp_path_factory: pytest.TempPathFactory) -> None:
    short = Server(tmp_path_factory.mktemp("short"), "drape15")
    other = page.another()
    open_page(other, short)
    assert short.stop() == (0, "stopped\n")
    other.until("note.textContent.includes('cannot reach the server')")
    other.kill()
