"""Lift a sheet from the floor by a corner, and measure the force of the gripper.

Writes `gripper_force.csv`, `gripper.png`, and with matplotlib `gripper_force.png`: the force grows as more of the sheet
leaves the floor, and is its weight once it hangs free.
"""

import csv
from math import cos, pi

import taichi_cloth as tc

HEIGHT, LIFTING, FRAMES = 1.9, 300, 420  # [m], 5 s, 7 s

scene = tc.Scene(
    cloth=tc.Cloth(rows=16, columns=16, width=1.0, height=1.0, center=(0.0, 0.02, 0.0), rotation=(-90, 0, 0), pins=()),
    fabric=tc.Fabric(damping_time=1e-3),  # [s]
    solver=tc.Solver(name="explicit", damping=1.0),  # it has no iterations that have to converge
    ground=tc.Ground(friction=0.3),
    camera=tc.Camera(eye=(1.6, 1.4, 2.6), target=(0.0, 1.0, 0.0)),
)
rows = []
with tc.Simulation(scene) as simulation:
    weight = simulation.topology.mass.sum() * scene.forces.gravity  # [N]
    x, y, z = simulation.positions()[0]
    gripper = simulation.grab(0, radius=0.1)  # a corner, and all particles within 0.1 m
    for frame in range(1, FRAMES + 1):
        lifted = HEIGHT * (1 - cos(pi * min(frame / LIFTING, 1.0))) / 2
        gripper.move_to((x, y + lifted, z))
        simulation.step()
        rows.append((frame / 60, lifted, *gripper.force))
    tc.render_image(simulation).save("gripper.png")

with open("gripper_force.csv", "w", newline="", encoding="utf-8") as file:
    csv.writer(file).writerows([("time [s]", "height [m]", "x [N]", "y [N]", "z [N]"), *rows])
print(f"force at the end {rows[-1][3]:.3f} N, weight of the sheet {weight:.3f} N")

try:
    from matplotlib.figure import Figure
except ImportError:
    print("no matplotlib, no plot")
else:
    seconds, _, _, up, _ = zip(*rows, strict=True)
    axes = (figure := Figure(figsize=(6, 3.2), layout="constrained")).subplots()
    axes.plot(seconds, up, label="gripper, upward")
    axes.axhline(weight, color="gray", linestyle=":", label="weight of the sheet")
    axes.set(xlabel="time [s]", ylabel="force [N]", ylim=0)
    axes.legend()
    figure.savefig("gripper_force.png")
