"""`verlet` compared with the loop of position-based dynamics in float64 NumPy."""

import numpy as np
import pytest

from taichi_cloth.scene.collider_schema import Sphere
from taichi_cloth.scene.fabric_schema import VerletSprings
from taichi_cloth.scene.schema import Cloth, Scene, Solver
from taichi_cloth.simulation.simulation import Simulation

SCENE = Scene(
    cloth=Cloth(rows=5, columns=6, width=0.5, height=0.4, center=(0.0, 1.0, 0.0), rotation=(-70.0, 0.0, 0.0)),
    verlet=VerletSprings(structural=1.0, shear=0.7, bend=0.2),
    solver=Solver(substeps=3, iterations=4, stiffness=0.9, damping=2.0),
    spheres=(Sphere(center=(0.05, 0.75, 0.1), radius=0.15, margin=0.02, friction=0.0),),
)


def pbd(simulation: Simulation, frames: int) -> np.ndarray:
    """Müller et al. 2007, Algorithm 1, with the damping and the sphere of the scene."""
    scene, topology = simulation.scene, simulation.topology
    share = {"structural": 1.0, "shear": 0.7, "bend": 0.2}
    stiffness = np.concatenate([np.full(b.count, share[b.family]) for b in topology.batches]) * 0.9
    w = np.where(topology.pinned, 0.0, 1 / topology.mass)
    sphere = scene.spheres[0]
    h = 1 / 60 / scene.solver.substeps
    x, v = topology.start.copy(), np.zeros_like(topology.start)
    for _ in range(frames * scene.solver.substeps):
        v *= np.exp(-scene.solver.damping * h)  # (6) damp the velocities carried over
        v[w > 0] += h * np.array([0, -9.81, 0])  # (5) external forces
        p = x + h * v  # (7)
        for _ in range(scene.solver.iterations):  # (9)–(11)
            for (i, j), rest, k in zip(topology.ends, topology.rest, stiffness, strict=True):
                gap = p[j] - p[i]
                length = np.linalg.norm(gap)
                if w[i] + w[j] > 0:
                    correction = k * (length - rest) / (length * (w[i] + w[j])) * gap
                    p[i] += w[i] * correction
                    p[j] -= w[j] * correction
            away = p - sphere.center
            distance = np.linalg.norm(away, axis=1)
            inside = (distance < sphere.radius + sphere.margin) & (w > 0)
            p[inside] = sphere.center + away[inside] * ((sphere.radius + sphere.margin) / distance[inside])[:, None]
        v = (p - x) / h  # (13)
        x = p  # (14)
    return x


def test_verlet_matches_the_pbd_loop_to_rounding() -> None:
    with Simulation(SCENE) as simulation:
        for _ in range(12):
            simulation.step()
        moved = np.linalg.norm(simulation.positions() - simulation.topology.start, axis=1).max()
        assert moved > 0.1
        # The cloth reaches the sphere, so that contact is part of the comparison.
        nearest = np.linalg.norm(simulation.positions() - SCENE.spheres[0].center, axis=1).min()
        assert nearest == pytest.approx(0.17, abs=1e-5)
        assert simulation.positions() == pytest.approx(pbd(simulation, 12), abs=1e-4 * SCENE.cloth.width)
