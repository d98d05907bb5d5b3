"""A9.8: the typed curves, hand-made cloth that falls short of them, and one strip that is really bent."""

from collections.abc import Callable

import numpy as np
import pytest

from taichi_cloth.evaluation.validate import woven
from taichi_cloth.evaluation.validate.check import EXCELLENT, FAIL, Check
from taichi_cloth.simulation.simulation import Simulation

FACTORS = [(1.0, EXCELLENT), (1.02, FAIL)]


def test_a_typed_curve_is_linear_between_its_points_and_after_them() -> None:
    assert woven.typed("warp", 0.0) == 0.0
    assert woven.typed("warp", 0.005) == pytest.approx(5.0)
    assert woven.typed("warp", 0.02) == pytest.approx(35.0)
    assert woven.typed("warp", 0.07) == pytest.approx(300.0 + 0.01 * 240.0 / 0.03)
    assert woven.typed("shear", 45.0) == pytest.approx(4.0 + 5.0 * 3.0 / 20.0)


def measured(
    monkeypatch: pytest.MonkeyPatch,
    measure: Callable[..., object],
    reactions: Callable[[Simulation, int], np.ndarray],
    count: int,
    *arguments: str,
) -> list[Check]:
    """Rows of a sheet that stays where it was put, with reactions of the k-th state by `reactions(simulation, k)`."""
    states = []

    def mean_reactions(simulation: Simulation) -> np.ndarray:
        states.append(simulation)
        return reactions(simulation, len(states) - 1)

    monkeypatch.setattr(woven, "at_rest", lambda simulation, start, *_: simulation.set_state(start))
    monkeypatch.setattr(woven, "mean_reactions", mean_reactions)
    return list(measure([""] * count, "explicit", *arguments))  # type: ignore[call-overload]


@pytest.mark.parametrize(("factor", "verdict"), FACTORS)
@pytest.mark.parametrize(("thread", "axis"), [("warp", 1), ("weft", 0)])
def test_a_tension_that_is_too_large_falls_short(
    monkeypatch: pytest.MonkeyPatch, thread: str, axis: int, factor: float, verdict: str
) -> None:
    def reactions(simulation: Simulation, k: int) -> np.ndarray:
        side = np.sign(simulation.topology.start[:, axis]) * (np.abs(simulation.topology.start[:, axis]) > 0.499)
        forces = np.zeros((len(side), 3))
        forces[:, axis] = factor * woven.typed(thread, woven.STRAINS[k]) * side / (woven.CELLS + 1)
        return forces

    rows = measured(monkeypatch, woven.tensions, reactions, len(woven.STRAINS), thread)
    assert [row.verdict for row in rows] == [verdict] * len(woven.STRAINS)


@pytest.mark.parametrize(("factor", "verdict"), FACTORS)
def test_a_moment_of_shear_that_is_too_large_falls_short(
    monkeypatch: pytest.MonkeyPatch, factor: float, verdict: str
) -> None:
    """All of the force is at one corner, across the diagonal that gets longer."""

    def reactions(simulation: Simulation, k: int) -> np.ndarray:
        half = np.radians(woven.ANGLES[k]) / 2
        growth = np.array([[-np.sin(half), np.cos(half)], [np.cos(half), -np.sin(half)]]) / 2
        forces = np.zeros_like(simulation.topology.start)
        corner = growth @ simulation.topology.start[0, :2]
        forces[0, :2] = factor * woven.typed("shear", woven.ANGLES[k]) * corner / (corner @ corner)
        return forces

    rows = measured(monkeypatch, woven.moments, reactions, len(woven.ANGLES))
    assert [row.verdict for row in rows] == [verdict] * len(woven.ANGLES)


@pytest.mark.parametrize(("factor", "verdict"), FACTORS)
@pytest.mark.parametrize("thread", woven.THREADS)
def test_a_moment_of_bending_that_is_too_large_falls_short(
    monkeypatch: pytest.MonkeyPatch, thread: str, factor: float, verdict: str
) -> None:
    """A force along the first link, of a tense thread, does not count."""

    def reactions(simulation: Simulation, k: int) -> np.ndarray:
        x = simulation.positions()
        first = [0, 3] if thread == "warp" else [0, 1]
        link = x[first[1]] - x[first[0]]
        link /= np.linalg.norm(link)
        turn = 2 * np.arcsin(woven.CURVATURES[k] * woven.LINK / 2)
        across = np.array([0.0, 0.0, 1.0]) - link[2] * link
        moment = woven.typed(f"bending_{thread}", woven.CURVATURES[k])
        forces = np.zeros_like(x)
        forces[0] = factor * moment * 2 * np.cos(turn / 2) * across / np.linalg.norm(across) + 7.0 * link
        return forces

    rows = measured(monkeypatch, woven.couples, reactions, len(woven.CURVATURES), thread)
    assert [row.verdict for row in rows] == [verdict] * len(woven.CURVATURES)


@pytest.mark.parametrize("thread", woven.THREADS)
def test_links_on_a_circle_keep_their_length(thread: str) -> None:
    flat = np.zeros((5, 3, 3))
    flat[..., 1 if thread == "warp" else 0] = np.arange(5)[:, None] * -woven.LINK
    turn = 2 * np.arcsin(4.0 * woven.LINK / 2)
    x = woven.on_circle(flat, turn, 4.0)
    links = np.diff(x, axis=0)
    lengths = np.linalg.norm(links, axis=2)
    assert lengths == pytest.approx(np.full((4, 3), woven.LINK))
    turned = np.linalg.norm(np.diff(links / lengths[..., None], axis=0), axis=2)
    assert turned == pytest.approx(np.full((3, 3), 4.0 * woven.LINK))


@pytest.mark.parametrize("thread", woven.THREADS)
def test_a_bent_strip_has_the_typed_moment(thread: str) -> None:
    rows = woven.couples(["", ""], "explicit", thread)
    assert all(row.verdict == EXCELLENT for row in rows)
