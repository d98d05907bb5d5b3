"""Hang a sheet by its top edge, wait until it is at rest, and compare its sag with the formula."""

import taichi_cloth as tc

scene = tc.load_scene(
    "drape15",
    solver="explicit",
    pins=["top"],
    rotation=[0.0, 0.0, 0.0],  # upright
    wind_z=0.0,
    wind_x=0.0,
    damping=4.0,
    fabric_shear=0.0,  # the formula holds for structural springs only
    bend_spring=0.0,
)

with tc.Simulation(scene) as simulation:
    flat = simulation.positions()  # [m] (N, 3), row by row from the top left
    simulation.step(300)  # 5 s
    hanging = simulation.positions()
    print(simulation.method, "·", len(hanging), "particles")

sag = (flat - hanging)[-1, 1]
expected = scene.cloth.area_density * scene.forces.gravity * scene.cloth.height**2 / (2 * scene.fabric.warp)
print(f"sag {1000 * sag:.3f} mm, expected σ·g·L²/(2·k) = {1000 * expected:.3f} mm")
