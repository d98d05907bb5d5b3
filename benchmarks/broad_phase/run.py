"""Time the search for pairs of near particles: spatial hash, brute force, octree and k-d tree (`make neighbours`).

The particles are in layers, each with about 20 others within reach. All methods run on one thread. SciPy's k-d tree is
written in C++; Taichi compiles the others. The exit code is 1 if the methods do not find the same pairs.
"""

import argparse
import json
import sys
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import taichi as ti
from octree import Octree
from rich.console import Console
from rich.table import Table

from taichi_cloth.collision.self_broadphase import SKIN, update_candidates
from taichi_cloth.kernels.step_params import THICKNESS, StepContext, collider_array, param_array
from taichi_cloth.scene.fabric_schema import VerletSprings
from taichi_cloth.scene.schema import Cloth, Scene, SelfCollision
from taichi_cloth.simulation.simulation import Simulation
from taichi_cloth.system import taichi_runtime as runtime

SIZES = (1024, 4096, 16384, 65536)
SPACING, LAYER = 0.02, 0.01  # [m] distance of particles in a layer, and of layers
THICKNESS_M = 0.018  # [m]
REACH = (1 + SKIN) * THICKNESS_M  # [m]
LAYERS = 8


@ti.kernel
def by_hash(cloth: ti.template(), features: ti.template(), params: param_array, colliders: collider_array) -> int:
    ti.loop_config(serialize=True)
    for _ in range(1):
        cloth.self_contact.list_thickness[None] = 0.0
        update_candidates(cloth, features, ti.static(StepContext(0, 1, 1.0, -1, params, colliders)))
    return cloth.self_contact.vertex_vertex.count[None]


@ti.kernel
def by_brute_force(x: ti.template(), count: int, reach: float) -> int:
    found = 0
    ti.loop_config(serialize=True)
    for i in range(count):
        for j in range(i + 1, count):
            offset = x[j] - x[i]
            found += int(offset.dot(offset) < reach * reach)
    return found


def layers(count: int) -> np.ndarray:
    """Return positions in layers, with noise and in random order [m], (count, 3)."""
    side = int(np.ceil(np.sqrt(count / LAYERS)))
    index = np.arange(count)
    layer, rest = index // side**2, index % side**2
    x = np.stack([rest % side * SPACING, layer * LAYER, rest // side * SPACING], axis=1)
    random = np.random.default_rng(2)
    return random.permutation(x + random.uniform(-0.3, 0.3, x.shape) * LAYER).astype(np.float32)


def best(search: Callable[[], int], seconds: float = 1.0) -> tuple[int, float]:
    """Return the number of pairs, and the shortest time [ms] of all runs within `seconds` but the first."""
    found = search()
    times: list[float] = []
    while not times or sum(times) < seconds:
        start = time.perf_counter()
        search()
        times.append(time.perf_counter() - start)
    return found, 1e3 * min(times)


def measure(count: int) -> dict[str, tuple[int, float]]:
    """Return the number of pairs and the time [ms] of each method."""
    from scipy.spatial import cKDTree

    x = layers(count)
    side = int(np.sqrt(count))
    cloth = Cloth(rows=side, columns=side, width=0.01 * side, height=0.01 * side, pins=())
    scene = Scene(cloth=cloth, verlet=VerletSprings(0.0, 0.0, 0.0), self_collision=SelfCollision(thickness=THICKNESS_M))
    with Simulation(scene, "serial") as simulation:
        simulation.set_state(x)
        frame = simulation._frame_input()
        params = frame.params
        assert params[THICKNESS] == np.float32(THICKNESS_M)
        x_field, features = simulation.cloth.x, simulation.solver.features
        tree = Octree(count)
        corner, side_length = x.min(axis=0), float(np.ptp(x, axis=0).max()) * 1.001 + 1e-6
        low = ti.Vector(list(map(float, corner)))
        searches: dict[str, Callable[[], int]] = {
            "brute force": lambda: by_brute_force(x_field, count, REACH),
            "hash": lambda: by_hash(simulation.cloth, features, params, frame.colliders),
            "octree": lambda: tree.pairs(x_field, count, low, side_length, REACH),
            "k-d tree": lambda: len(cKDTree(x).query_pairs(REACH, output_type="ndarray")),
        }
        return {name: best(search) for name, search in searches.items()}


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--json", type=Path, metavar="FILE", help="write the measurements")
    arguments = parser.parse_args()
    runtime.start("cpu")
    table = Table("particles", "pairs", "method", "ms", "ns per particle", "÷ hash")
    rows, agree = [], True
    for count in SIZES:
        found = measure(count)
        pairs, ours = found["hash"]
        for name, (number, ms) in found.items():
            agree &= abs(number - pairs) <= 1e-4 * pairs  # pairs at the limit depend on rounding
            table.add_row(str(count), str(number), name, f"{ms:.3g}", f"{1e6 * ms / count:.0f}", f"{ms / ours:.2f}")
            rows.append({"particles": count, "pairs": number, "method": name, "ms": ms})
    Console().print(table)
    if arguments.json:
        arguments.json.write_text(json.dumps(rows, indent=1))
    if not agree:
        print("the methods do not find the same pairs", file=sys.stderr)
    return 0 if agree else 1


if __name__ == "__main__":
    sys.exit(main())
