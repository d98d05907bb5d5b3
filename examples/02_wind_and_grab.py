"""Grab a corner, move it along a circle while the wind becomes stronger, release it, and write an image."""

import sys
from math import cos, sin, tau

import taichi_cloth as tc

FRAMES = 120  # 2 s

out = sys.argv[1] if len(sys.argv) > 1 else "wind_and_grab.png"
scene = tc.load_scene("drape15", rows=25, columns=25, substeps=5, iterations=12)

with tc.Simulation(scene) as simulation:
    corner = simulation.topology.particle_count - 1  # bottom right
    x, y, z = simulation.positions()[corner]
    grab = simulation.grab(corner)
    for frame in range(FRAMES):
        share = frame / FRAMES
        simulation.params["wind_z"] = 8.0 * share  # [m/s]
        angle = tau * share
        grab.move_to((x - 0.4 * sin(angle), y + 0.4 * (1 - cos(angle)), z))
        simulation.step()
    grab.release()  # the corner keeps its velocity

    speed = (simulation.velocities() ** 2).sum(axis=1).max() ** 0.5
    print(f"after {simulation.seconds:.1f} s the fastest particle moves at {speed:.2f} m/s")
    tc.render_image(simulation).save(out)
    print(f"wrote {out}")
