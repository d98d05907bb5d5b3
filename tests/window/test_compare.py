"""The window of `compare`, under a real mouse."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest


def test_one_hand_pulls_both_sides(desk: Callable[..., Any]) -> None:
    desk = desk(
        "curtain", "--a", "iterations=2", "--b", "solver=spring", "--set", "rows=12,columns=15", "--size", "1100x400",
        command="compare",
    )  # fmt: skip
    picture = desk.picture()[:, 420:]  # right of the panel's band
    red = (picture[:, :, 0] > 120) & (picture[:, :, 0] > 2 * picture[:, :, 1])
    half = red.shape[1] // 2
    assert min(red[:, :half].sum(), red[:, half:].sum()) > 2000  # pixels of cloth on each side
    rows, columns = np.nonzero(red[:, :half])
    k = int(0.7 * len(rows))
    start = (420 + columns[k]) / desk.width, 1 - rows[k] / desk.height
    desk.move(*start)
    assert desk.press("left")["mouse"] == "cloth"
    desk.move(start[0] - 0.03, start[1] + 0.1)
    held = desk.now()["sides"]
    assert held[0]["grabbed"] == held[1]["grabbed"] is not None
    seen = held[1]["particle"]
    seam = (1 - 412 / desk.width) / 2  # from one half to the other
    assert np.subtract(seen, held[0]["particle"]) == pytest.approx((seam, 0), abs=0.01)
    desk.release("left")
    desk.until(lambda line: all(side["grabbed"] is None for side in line["sides"]), "both hands empty")
    desk.key("h")
    desk.until(lambda line: True, "a picture without the panel")
    corner = desk.picture()[50:300, 20:200]
    assert corner.mean() > 120, "the panel's band is still to be seen"
    desk.key("Escape")
    assert desk.exit_code() == 0
