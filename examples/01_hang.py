"""The smallest use: hang a sheet by its top edge, wait until it is still, and compare its sag with the one by hand."""

import taichi_cloth as tc

scene = tc.load_scene(
    "drape15",
    solver="spring",
    pins=["top"],
    rotation=[0.0, 0.0, 0.0],  # upright
    wind_z=0.0,
    wind_x=0.0,
    damping=4.0,
    fabric_shear=0.0,  # threads alone, so that the answer is known
    fabric_bend=0.0,
)

with tc.Simulation(scene) as simulation:
    flat = simulation.positions()  # [m] (N, 3), row by row from the top left
    for _ in range(300):  # 5 s
        simulation.advance_frame()
    hanging = simulation.positions()
    print(simulation.method, "·", len(hanging), "particles")

sag = (flat - hanging)[-1, 1]
by_hand = scene.cloth.area_density * scene.forces.gravity * scene.cloth.height**2 / (2 * scene.fabric.warp)
print(f"sag {1000 * sag:.3f} mm, by hand σ·g·L²/(2·k) = {1000 * by_hand:.3f} mm")
