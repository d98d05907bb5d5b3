"""Run one scene with several solvers, and print the frame time and the error of each.

The reference is `explicit` with eight times the substeps that stability requires. The error is the root mean square
distance of the particles from the reference after half a second, in % of the longer side of the cloth.

With `fabric.damping_time`, compare equal times: `explicit` reduces a long one (`simulation.warnings` names the time).
"""

import time

import numpy as np

import taichi_cloth as tc

FRAMES = 30
SETTINGS = [
    {"solver": "verlet", "substeps": 5, "iterations": 12},
    {"solver": "xpbd", "substeps": 30, "iterations": 1},
    {"solver": "lines", "substeps": 5, "iterations": 1},
    {"solver": "explicit"},
]


def run(**setting: object) -> tuple[np.ndarray, float, str]:
    """Return the positions after `FRAMES` frames [m], the time of a frame [ms], and the setting as text."""
    with tc.Simulation(tc.load_scene("drape15", **setting)) as simulation:
        simulation.step()  # compiles
        simulation.reset()
        start = time.perf_counter()
        simulation.step(FRAMES)
        positions = simulation.positions()
        return positions, 1000 * (time.perf_counter() - start) / FRAMES, simulation.method


def min_stable_substeps() -> int:
    with tc.Simulation(tc.load_scene("drape15", solver="explicit")) as simulation:
        return simulation.min_stable_substeps


scene = tc.load_scene("drape15")
side = max(scene.cloth.width, scene.cloth.height)
reference, _, method = run(solver="explicit", substeps=8 * min_stable_substeps())
print(f"{'solver':24}{'ms per frame':>14}{'error %':>10}   (reference: {method})")
for setting in SETTINGS:
    positions, milliseconds, method = run(**setting)
    error = np.sqrt(((positions - reference) ** 2).sum(axis=1).mean()) / side
    print(f"{method:24}{milliseconds:14.2f}{100 * error:10.4f}")
