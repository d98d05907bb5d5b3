"""Blow at a hanging sheet with wind of increasing speed; measure how far it swings out and how it pulls at its pins.

Writes `wind_sweep.csv`, and with matplotlib `wind_sweep.png`: in slow wind the pull grows with the square of the speed.
It falls again when the sheet turns out of the wind. In fast wind the sheet flutters.
"""

import csv
from math import atan2, degrees

import numpy as np

import taichi_cloth as tc

scene = tc.Scene(
    cloth={"rows": 16, "columns": 16, "width": 1.0, "height": 1.0, "center": (0.0, 2.0, 0.0), "pins": "top"},
    solver={"name": "explicit", "damping": 2.0},
    wind={"turbulence": 0.0},
)
rows = []
with tc.Simulation(scene) as simulation:  # one simulation for all speeds: nothing is compiled again
    pinned = simulation.topology.pinned
    for speed in np.arange(0.5, 6.5, 0.5):  # [m/s]
        simulation.reset()
        simulation.params["wind_z"] = speed
        simulation.step(180)  # 3 s
        samples = []
        for _ in range(60):  # the mean over a second: in fast wind the sheet flutters
            simulation.step()
            positions, forces = simulation.positions(), simulation.reaction_forces()
            _, down, out = positions[pinned].mean(axis=0) - positions[~pinned].mean(axis=0)
            samples.append((degrees(atan2(-out, down)), -forces[pinned].sum(axis=0)[2]))
        rows.append((speed, *np.mean(samples, axis=0)))
        print("{:4.1f} m/s {:6.1f}° {:7.3f} N".format(*rows[-1]))

with open("wind_sweep.csv", "w", newline="", encoding="utf-8") as file:
    csv.writer(file).writerows([("wind [m/s]", "angle [degrees]", "pull [N]"), *rows])

try:
    from matplotlib.figure import Figure
except ImportError:
    print("no matplotlib, no plot")
else:
    speeds, angles, pulls = zip(*rows, strict=True)
    figure = Figure(figsize=(8, 3.2), layout="constrained")
    for axes, values, label in zip(figure.subplots(1, 2), (angles, pulls), ("angle [°]", "pull [N]"), strict=True):
        axes.plot(speeds, values, "o-")
        axes.set(xlabel="wind [m/s]", ylabel=label, ylim=0)
    figure.savefig("wind_sweep.png")
