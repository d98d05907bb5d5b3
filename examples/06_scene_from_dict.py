"""Build a scene from a dict, as a program or a JSON file has it, and drop a silk cloth on a ring of balls.

Writes `ring.png`: the cloth lies on eight balls, and its corners hang down. A key that does not exist is refused by one
line with the nearest name.
"""

import json
from math import cos, sin, tau

import taichi_cloth as tc

BALLS = 8

tables = {
    "title": "a cloth on a ring of balls",
    "cloth": {"rows": 41, "columns": 41, "width": 1.4, "height": 1.4, "center": [0, 1.1, 0], "rotation": [-90, 0, 0]},
    "fabric": {"preset": "silk"},  # also sets mass, colors and pattern
    "solver": {"name": "xpbd", "substeps": 20},
    "ground": {},
    "camera": {"eye": [1.3, 1.6, 1.7], "target": [0.0, 0.55, 0.0]},
    "spheres": [
        {"center": [0.5 * cos(tau * k / BALLS), 0.7, 0.5 * sin(tau * k / BALLS)], "radius": 0.1, "friction": 0.8}
        for k in range(BALLS)
    ],
}
tables["cloth"]["pins"] = []  # a grid without this key is pinned at its top edge
tables = json.loads(json.dumps(tables))  # any JSON will do

with tc.Simulation(tables) as simulation:
    simulation.step(90)  # 1.5 s
    print(f"{simulation.method}: max strain {simulation.metrics().max_strain:.1%}")
    tc.render_image(simulation).save("ring.png")

try:
    tc.load_scene({**tables, "sphere": tables["spheres"]})
except tc.SceneError as error:
    print(error)
