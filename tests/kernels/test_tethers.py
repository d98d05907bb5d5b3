"""Tethers: by hand numbers, and on a curtain that would stretch far without."""

from dataclasses import replace

import numpy as np
import pytest
import taichi as ti
import taichi.math as tm

from taichi_cloth.kernels.tethers import tether_shift
from taichi_cloth.mesh.tethers import tethers
from taichi_cloth.scene.model import Cloth, Fabric, Forces, Scene, Solver, Springs, Tethers
from taichi_cloth.simulation import Simulation


@ti.kernel
def shift(gap: tm.vec3, most: float) -> tm.vec3:
    return tether_shift(gap, most)


@pytest.mark.parametrize(
    ("gap", "most", "expected"),
    [
        ((3.0, 0.0, 4.0), 2.5, (-1.5, 0.0, -2.0)),  # 5 m away with 2.5 m of tether: half of the way back
        ((3.0, 0.0, 4.0), 5.5, (0.0, 0.0, 0.0)),  # slack
        ((0.0, 0.0, 0.0), 0.0, (0.0, 0.0, 0.0)),  # at its pin
    ],
)
def test_a_taut_tether_pulls_back_onto_its_sphere(gap: tuple, most: float, expected: tuple) -> None:
    assert list(shift(tm.vec3(*gap), most)) == pytest.approx(expected, abs=1e-6)


def curtain(tethers: Tethers | None, solver: str = "verlet") -> Scene:
    return Scene(
        cloth=Cloth(rows=24, columns=30, width=1.2, height=1.0, center=(0.0, 2.0, 0.0), pins=("top",)),
        springs=Springs(1.0, 1.0, 0.2),
        solver=Solver(name=solver, substeps=1, iterations=1, damping=1.0),
        tethers=tethers,
    )


def longest(scene: Scene, path: str, frames: int = 60) -> float:
    """The largest distance in all frames of a particle from the pin above it, in distances on the flat sheet."""
    most = 0.0
    with Simulation(scene, path) as simulation:
        start = simulation.positions().reshape(24, 30, 3)
        for _ in range(frames):
            simulation.advance_frame()
            x = simulation.positions().reshape(24, 30, 3)
            away = np.linalg.norm(x - x[0], axis=2)[1:] / np.linalg.norm(start - start[0], axis=2)[1:]
            most = max(most, float(away.max()))
    return most


@pytest.mark.parametrize("path", ["list", "lanes", "gather"])
@pytest.mark.parametrize("solver", ["verlet", "xpbd"])
def test_a_tethered_curtain_gets_no_longer_than_its_slack(solver: str, path: str) -> None:
    assert longest(curtain(None, solver), "list") > 1.2
    assert longest(curtain(Tethers(1.02), solver), path) < 1.02 + 1e-5


@pytest.mark.parametrize("path", ["list", "lanes"])
def test_lines_have_tethers_too(path: str) -> None:
    soft = Fabric(20.0, 20.0, 10.0, 1.0)
    assert longest(replace(curtain(None, "lines"), fabric=soft), "list") > 1.05
    assert longest(replace(curtain(Tethers(1.02), "lines"), fabric=soft), path) < 1.02 + 1e-5


def test_a_pin_that_a_hand_leads_takes_its_tethers_along() -> None:
    places = {}
    for path in ("list", "lanes", "gather"):
        with Simulation(curtain(Tethers()), path) as simulation:
            assert "tethers" in simulation.stages
            pin = simulation.positions()[7]
            for k in range(1, 20):
                simulation.grab(7, pin + [0.0, 0.03 * k, 0.0])
                simulation.advance_frame()
            places[path] = simulation.positions()
            below = np.linalg.norm(places[path][7 + 30 * 20] - places[path][7])
            assert below < 1.01 * 20 / 23 + 1e-5
    assert places["lanes"] == pytest.approx(places["list"], abs=1e-3)


LOOSE = Scene(
    cloth=Cloth(rows=5, columns=9, width=0.8, height=0.4, center=(0.0, 0.0, 0.0), pins=("top-left", "top-right")),
    fabric=Fabric(1e-9, 1e-9, 1e-9, 0.0),
    solver=Solver("xpbd", substeps=4, iterations=1, damping=0.0),
    tethers=Tethers(1.0),
    forces=Forces(gravity=0.0),
)


@pytest.mark.parametrize("path", ["list", "lanes", "gather"])
def test_tethers_follow_a_hand_within_the_frame(path: str) -> None:
    """A corner that is led 20 cm up in one frame takes what is tied to it and to no other pin all the way along."""
    one = replace(LOOSE, cloth=replace(LOOSE.cloth, pins=("top-left",)))
    with Simulation(one, path) as simulation:
        simulation.grab(0, simulation.positions()[0] + [0.0, 0.2, 0.0])
        simulation.advance_frame()
        x = simulation.positions()
        assert x[0] - simulation.topology.start[0] == pytest.approx([0.0, 0.2, 0.0], abs=1e-6)
        away = np.linalg.norm(x - x[0], axis=1)
        flat = np.linalg.norm(simulation.topology.flat - simulation.topology.flat[0], axis=1)
        assert (away <= flat + 1e-5).all()


@pytest.mark.parametrize("path", ["list", "lanes"])
def test_each_tether_sees_what_the_one_before_has_moved(path: str) -> None:
    """Two that are taut: onto the sphere of the nearer pin, and from there onto that of the other."""
    with Simulation(replace(LOOSE, solver=replace(LOOSE.solver, substeps=1)), path) as simulation:
        pins, reach = tethers(simulation.topology)
        assert len(pins) == 2
        free = ~simulation.topology.pinned
        x = simulation.topology.start + np.outer(free, [0.0, -0.5, 0.3])
        simulation.place(x)
        simulation.advance_frame()
        expected = x.copy()
        for pin, most in zip(pins, reach, strict=True):
            gap = expected - simulation.topology.start[pin]
            long = np.maximum(np.linalg.norm(gap, axis=1), 1e-12)
            expected += gap * (np.minimum(most / long, 1.0) - 1.0)[:, None] * free[:, None]
        assert simulation.positions() == pytest.approx(expected, abs=1e-6)
        from_both = np.linalg.norm(x - simulation.topology.start[pins], axis=2)
        assert ((from_both > reach + 0.01).all(axis=0) | ~free).all(), "every one was taut"


def test_slack_is_live() -> None:
    with Simulation(curtain(Tethers(1.0))) as simulation:
        simulation.set("tethers_slack", 1.1)
        for _ in range(60):
            simulation.advance_frame()
        assert simulation.positions()[-1, 1] < 1.49
