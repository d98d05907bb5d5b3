"""Wind and a hand that Python drives: a corner is led round a circle while the wind grows. Writes a picture."""

import sys
from math import cos, sin, tau

import taichi_cloth as tc

FRAMES = 120  # 2 s

out = sys.argv[1] if len(sys.argv) > 1 else "wind_and_grab.png"
scene = tc.load_scene("drape15", rows=25, columns=25, substeps=5, iterations=12)

with tc.Simulation(scene) as simulation:
    corner = simulation.topology.particle_count - 1  # the last of the last row: bottom right
    x, y, z = simulation.positions()[corner]
    for frame in range(FRAMES):
        share = frame / FRAMES
        simulation.set("wind_z", 8.0 * share)  # [m/s]; any key that has a slider
        turn = tau * share
        simulation.grab(corner, (x - 0.4 * sin(turn), y + 0.4 * (1 - cos(turn)), z))
        simulation.advance_frame()
    simulation.release()  # it keeps the hand's velocity

    speed = (simulation.velocities() ** 2).sum(axis=1).max() ** 0.5
    print(f"after {simulation.seconds:.1f} s the fastest particle moves at {speed:.2f} m/s")
    tc.picture(simulation, 640, 360).save(out)
    print(f"wrote {out}")
