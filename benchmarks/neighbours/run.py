"""How long a search for near particles takes: the hash of cubes against brute force, an octree and a k-d tree.

`make neighbours`. A heap of layers, each particle with about 20 others in reach. All on one thread; SciPy's k-d tree is
C++, the others are compiled by Taichi. All find the same pairs, or the program ends with exit 1.
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

from taichi_cloth import runtime
from taichi_cloth.contact.candidates import AIR, list_candidates
from taichi_cloth.kernels.controls import THICKNESS, Substep, row, table
from taichi_cloth.scene.model import Cloth, Scene, SelfCollision, Springs
from taichi_cloth.simulation import Simulation

SIZES = (1024, 4096, 16384, 65536)
SPACING, LAYER = 0.02, 0.01  # [m] of particles in a layer, and between layers
THICK = 0.018  # [m]
REACH = (1 + AIR) * THICK
LAYERS = 8


@ti.kernel
def by_hash(cloth: ti.template(), stages: ti.template(), controls: row, bodies: table) -> int:
    ti.loop_config(serialize=True)
    for _ in range(1):
        cloth.near.listed_for[None] = 0.0  # anew
        list_candidates(cloth, stages, ti.static(Substep(0, 1, 1.0, -1, controls, bodies)))
    return cloth.near.pairs.count[None]


@ti.kernel
def by_brute_force(x: ti.template(), count: int, reach: float) -> int:
    found = 0
    ti.loop_config(serialize=True)
    for i in range(count):
        for j in range(i + 1, count):
            away = x[j] - x[i]
            found += int(away.dot(away) < reach * reach)
    return found


def heap(count: int) -> np.ndarray:
    """Places in layers, jittered and out of order, (count, 3) [m]."""
    side = int(np.ceil(np.sqrt(count / LAYERS)))
    index = np.arange(count)
    layer, rest = index // side**2, index % side**2
    x = np.stack([rest % side * SPACING, layer * LAYER, rest // side * SPACING], axis=1)
    random = np.random.default_rng(2)
    return random.permutation(x + random.uniform(-0.3, 0.3, x.shape) * LAYER).astype(np.float32)


def best(search: Callable[[], int], seconds: float = 1.0) -> tuple[int, float]:
    """What it found, and the shortest time [ms] of those that fit into `seconds`, at least one after the first."""
    found = search()
    times: list[float] = []
    while not times or sum(times) < seconds:
        start = time.perf_counter()
        search()
        times.append(time.perf_counter() - start)
    return found, 1e3 * min(times)


def measure(count: int) -> dict[str, tuple[int, float]]:
    """Pairs and time [ms] by method."""
    from scipy.spatial import cKDTree

    x = heap(count)
    side = int(np.sqrt(count))
    cloth = Cloth(rows=side, columns=side, width=0.01 * side, height=0.01 * side, pins=())
    scene = Scene(cloth=cloth, springs=Springs(0.0, 0.0, 0.0), self_collision=SelfCollision(thickness=THICK))
    with Simulation(scene, "list") as simulation:
        simulation.place(x)
        controls = simulation._input().controls
        assert controls[THICKNESS] == np.float32(THICK)
        bodies = np.zeros((1, 24), np.float32)
        field, stages = simulation.cloth.x, simulation.solver.stages
        tree = Octree(count)
        corner, wide = x.min(axis=0), float(np.ptp(x, axis=0).max()) * 1.001 + 1e-6
        near = ti.Vector(list(map(float, corner)))
        searches: dict[str, Callable[[], int]] = {
            "brute force": lambda: by_brute_force(field, count, REACH),
            "hash": lambda: by_hash(simulation.cloth, stages, controls, bodies),
            "octree": lambda: tree.pairs(field, count, near, wide, REACH),
            "k-d tree": lambda: len(cKDTree(x).query_pairs(REACH, output_type="ndarray")),
        }
        return {name: best(search) for name, search in searches.items()}


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--json", type=Path, metavar="FILE", help="write the measurements")
    arguments = parser.parse_args()
    runtime.start("cpu")
    table = Table("particles", "pairs", "method", "ms", "ns a particle", "÷ hash")
    rows, agree = [], True
    for count in SIZES:
        found = measure(count)
        pairs, ours = found["hash"]
        for name, (number, ms) in found.items():
            agree &= abs(number - pairs) <= 1e-4 * pairs  # float32 decides those at the very edge
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
