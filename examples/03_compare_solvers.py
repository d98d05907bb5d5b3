"""The same scene under several solvers: milliseconds a frame beside the error they come with.

The truth is `spring` with eight times the substeps that it needs. The error is the root mean square of how far the
particles are from there after half a second, in % of the cloth's longer side.
"""

import time

import numpy as np

import taichi_cloth as tc

FRAMES = 30
SETTINGS = [
    {"solver": "verlet", "substeps": 5, "iterations": 12},
    {"solver": "xpbd", "substeps": 30, "iterations": 1},
    {"solver": "lines", "substeps": 5, "iterations": 1},
    {"solver": "spring"},
]


def run(**setting: object) -> tuple[np.ndarray, float, str]:
    """Places after `FRAMES` frames, milliseconds of a frame and the method's name."""
    with tc.Simulation(tc.load_scene("drape15", **setting)) as simulation:
        simulation.advance_frame()  # compiles
        simulation.reset()
        start = time.perf_counter()
        for _ in range(FRAMES):
            simulation.advance_frame()
        places = simulation.positions()
        return places, 1000 * (time.perf_counter() - start) / FRAMES, simulation.method


def substeps_needed() -> int:
    with tc.Simulation(tc.load_scene("drape15", solver="spring")) as simulation:
        return simulation.least_substeps


scene = tc.load_scene("drape15")
side = max(scene.cloth.width, scene.cloth.height)
truth, _, method = run(solver="spring", substeps=8 * substeps_needed())
print(f"{'method':24}{'ms a frame':>12}{'error %':>10}   (truth: {method})")
for setting in SETTINGS:
    places, milliseconds, method = run(**setting)
    error = np.sqrt(((places - truth) ** 2).sum(axis=1).mean()) / side
    print(f"{method:24}{milliseconds:12.2f}{100 * error:10.4f}")
