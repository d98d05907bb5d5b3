"""The window of `compare`, with a real mouse."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest


def test_a_drag_acts_on_both_sides(open_window: Callable[..., Any]) -> None:
    app = open_window(
        "curtain", "--a", "iterations=2", "--b", "solver=explicit", "--set", "rows=12,columns=15", "--size", "1100x400",
        command="compare",
    )  # fmt: skip
    assert [line[:21] for line in app.output()] == ["a: curtain · verlet 5", "b: curtain · explicit"]
    image = app.screenshot()[:, 420:]  # right of the panel's column
    red = (image[:, :, 0] > 120) & (image[:, :, 0] > 2 * image[:, :, 1])
    half = red.shape[1] // 2
    assert min(red[:, :half].sum(), red[:, half:].sum()) > 2000  # [pixels] of cloth on each side
    row = int(np.quantile(np.nonzero(red[:, :half])[0], 0.7))
    column = np.median(np.nonzero(red[row, :half])[0])  # far from both edges of the cloth, which moves meanwhile
    start = (420 + column) / app.width, 1 - row / app.height
    app.move_mouse(*start)
    assert app.press_mouse("left")["mouse"] == "cloth"
    app.move_mouse(start[0] - 0.03, start[1] + 0.1)
    grabbed_sides = app.latest_entry()["sides"]
    assert grabbed_sides[0]["grabbed"] == grabbed_sides[1]["grabbed"] is not None
    point = grabbed_sides[1]["particle"]
    seam = (1 - 412 / app.width) / 2  # from one half to the other, as a fraction of the window
    assert np.subtract(point, grabbed_sides[0]["particle"]) == pytest.approx((seam, 0), abs=0.01)
    app.release_mouse("left")
    app.wait_until(lambda line: all(side["grabbed"] is None for side in line["sides"]), "the release of both grabs")
    app.move_mouse(0.5, 0.5)  # on the left half
    before = [side["solver"] for side in app.latest_entry()["sides"]]
    on_the_right = str(app.left + round(0.9 * app.width)), str(app.top + app.height // 2)
    app.xdotool("mousemove", *on_the_right, "key", "t")  # in one displayed frame
    now = app.wait_until(lambda line: [side["solver"] for side in line["sides"]] != before, "another solver")
    assert now["sides"][0]["solver"] == before[0]
    app.press_key("h")
    for _ in range(20):  # displayed frames in which a busy machine may process the key
        app.wait_until(lambda line: True, "an image without the panel")
        corner = app.screenshot()[50:300, 20:200]
        if corner.mean() > 120:
            break
    assert corner.mean() > 120, "the panel's column is still visible"
    app.press_key("e")
    for _ in range(20):
        app.wait_until(lambda line: True, "an image with the message")
        message = app.screenshot()[34:54, 20:300]  # that a comparison writes no mesh
        if message.mean() < 120:
            break
    assert message.mean() < 120, "a message needs the panel"
    app.press_key("Escape")
    assert app.exit_code() == 0


def test_a_narrow_window_can_be_made_narrower(open_window: Callable[..., Any]) -> None:
    """Below 612 pixels the panel's column shrinks instead of the images."""
    app = open_window(
        "drape15", "--b", "iterations=20", "--size", "500x400", "--no-errors", command="compare",
    )  # fmt: skip
    app.xdotool("windowsize", "--sync", app.window_id, "420", "400")
    entry = app.latest_entry()
    app.wait_until(lambda line: line["displayed"] > entry["displayed"] + 10, "frames of the narrower window")
    app.press_key("Escape")
    assert app.exit_code() == 0
