"""Tethers: against values computed by hand, and on a curtain that would stretch far without them."""

from dataclasses import replace

import numpy as np
import pytest
import taichi as ti
import taichi.math as tm

from taichi_cloth.geometry.tethers import tethers_of
from taichi_cloth.kernels.distance_limits import correction_to_distance
from taichi_cloth.scene.fabric_schema import Fabric, VerletSprings
from taichi_cloth.scene.schema import Cloth, Forces, Scene, Solver, Tethers
from taichi_cloth.simulation.simulation import Simulation

pytestmark = pytest.mark.bounds


@ti.kernel
def shift(gap: tm.vec3, max_distance: float) -> tm.vec3:
    return correction_to_distance(gap, max_distance)


@pytest.mark.parametrize(
    ("gap", "max_distance", "expected"),
    [
        ((3.0, 0.0, 4.0), 2.5, (-1.5, 0.0, -2.0)),  # 5 m away with a limit of 2.5 m: half the way back
        ((3.0, 0.0, 4.0), 5.5, (0.0, 0.0, 0.0)),  # slack
        ((0.0, 0.0, 0.0), 0.0, (0.0, 0.0, 0.0)),  # at its pin
    ],
)
def test_a_taut_tether_projects_onto_its_sphere(gap: tuple, max_distance: float, expected: tuple) -> None:
    assert list(shift(tm.vec3(*gap), max_distance)) == pytest.approx(expected, abs=1e-6)


def curtain(tethers: Tethers | None, solver: str = "verlet") -> Scene:
    return Scene(
        cloth=Cloth(rows=24, columns=30, width=1.2, height=1.0, center=(0.0, 2.0, 0.0), pins=("top",)),
        verlet=VerletSprings(1.0, 1.0, 0.2),
        solver=Solver(name=solver, substeps=1, iterations=1, damping=1.0),
        tethers=tethers,
    )


def longest(scene: Scene, layout: str, frames: int = 60) -> float:
    """Return the largest distance of a particle from the pin above it in any frame, relative to the flat sheet."""
    most = 0.0
    with Simulation(scene, layout) as simulation:
        start = simulation.positions().reshape(24, 30, 3)
        for _ in range(frames):
            simulation.step()
            x = simulation.positions().reshape(24, 30, 3)
            away = np.linalg.norm(x - x[0], axis=2)[1:] / np.linalg.norm(start - start[0], axis=2)[1:]
            most = max(most, float(away.max()))
    return most


@pytest.mark.parametrize("layout", ["serial", "simd", "parallel"])
@pytest.mark.parametrize("solver", ["verlet", "xpbd"])
def test_a_tethered_curtain_stretches_no_farther_than_its_slack(solver: str, layout: str) -> None:
    assert longest(curtain(None, solver), "serial") > 1.2
    assert longest(curtain(Tethers(1.02), solver), layout) < 1.02 + 1e-5


@pytest.mark.parametrize("layout", ["serial", "simd"])
def test_lines_supports_tethers(layout: str) -> None:
    soft = Fabric(20.0, 20.0, 10.0, 1.0)
    assert longest(replace(curtain(None, "lines"), fabric=soft), "serial") > 1.05
    assert longest(replace(curtain(Tethers(1.02), "lines"), fabric=soft), layout) < 1.02 + 1e-5


def test_the_tethers_of_a_grabbed_pin_follow_it() -> None:
    positions = {}
    for layout in ("serial", "simd", "parallel"):
        with Simulation(curtain(Tethers()), layout) as simulation:
            assert "tethers" in simulation.features
            pin = simulation.positions()[7]
            grab = simulation.grab(7)
            for k in range(1, 20):
                grab.move_to(pin + [0.0, 0.03 * k, 0.0])
                simulation.step()
            positions[layout] = simulation.positions()
            below = np.linalg.norm(positions[layout][7 + 30 * 20] - positions[layout][7])
            assert below < 1.01 * 20 / 23 + 1e-5
    assert positions["simd"] == pytest.approx(positions["serial"], abs=1e-3)


LOOSE = Scene(
    cloth=Cloth(rows=5, columns=9, width=0.8, height=0.4, center=(0.0, 0.0, 0.0), pins=("top-left", "top-right")),
    fabric=Fabric(1e-9, 1e-9, 1e-9, 0.0),
    solver=Solver("xpbd", substeps=4, iterations=1, damping=0.0),
    tethers=Tethers(1.0),
    forces=Forces(gravity=0.0),
)


@pytest.mark.parametrize("layout", ["serial", "simd", "parallel"])
def test_tethers_follow_a_grab_within_the_frame(layout: str) -> None:
    """A corner moved up by 20 cm in one frame takes all particles along that are tethered to it alone."""
    one = replace(LOOSE, cloth=replace(LOOSE.cloth, pins=("top-left",)))
    with Simulation(one, layout) as simulation:
        simulation.grab(0).move_to(simulation.positions()[0] + [0.0, 0.2, 0.0])
        simulation.step()
        x = simulation.positions()
        assert x[0] - simulation.topology.start[0] == pytest.approx([0.0, 0.2, 0.0], abs=1e-6)
        away = np.linalg.norm(x - x[0], axis=1)
        flat = np.linalg.norm(simulation.topology.flat - simulation.topology.flat[0], axis=1)
        assert (away <= flat + 1e-5).all()


@pytest.mark.parametrize("layout", ["serial", "simd"])
def test_tethers_are_projected_one_after_another(layout: str) -> None:
    """Two taut tethers project onto the sphere of the nearer pin, and from there onto that of the other."""
    with Simulation(replace(LOOSE, solver=replace(LOOSE.solver, substeps=1)), layout) as simulation:
        pins, reach = tethers_of(simulation.topology)
        assert len(pins) == 2
        free = ~simulation.topology.pinned
        x = simulation.topology.start + np.outer(free, [0.0, -0.5, 0.3])
        simulation.set_state(x)
        simulation.step()
        expected = x.copy()
        for pin, most in zip(pins, reach, strict=True):
            gap = expected - simulation.topology.start[pin]
            long = np.maximum(np.linalg.norm(gap, axis=1), 1e-12)
            expected += gap * (np.minimum(most / long, 1.0) - 1.0)[:, None] * free[:, None]
        assert simulation.positions() == pytest.approx(expected, abs=1e-6)
        from_both = np.linalg.norm(x - simulation.topology.start[pins], axis=2)
        assert ((from_both > reach + 0.01).all(axis=0) | ~free).all(), "every tether was taut"


def test_slack_is_a_runtime_parameter() -> None:
    with Simulation(curtain(Tethers(1.0))) as simulation:
        simulation.params["tethers_slack"] = 1.1
        for _ in range(60):
            simulation.step()
        assert simulation.positions()[-1, 1] < 1.49
