"""MuJoCo: a 2D flex of linear triangles, with passive forces for stretching and bending."""

from __future__ import annotations

import mujoco
import numpy as np
from cloth import AREA_DENSITY, FRAME, GRAVITY, SIDE, STIFFNESS, Array, arguments, run

STEPS = {"8 steps": 8, "1 step": 1}  # per frame

THICKNESS = 1e-3  # [m] times Young's modulus, this is the stiffness in N/m

sheet, frames, setting = arguments(list(STEPS))

# The grid of MuJoCo starts at the lower left and runs up each column.
pins = " ".join(str(column * sheet.rows + sheet.rows - 1) for column in (0, sheet.columns - 1))
model = mujoco.MjModel.from_xml_string(f"""
<mujoco>
  <option timestep="{FRAME / STEPS[setting]}" gravity="0 0 {-GRAVITY}" integrator="discrete" solver="CG"/>
  <size memory="500M"/>
  <worldbody>
    <flexcomp name="sheet" type="grid" dim="2" count="{sheet.columns} {sheet.rows} 1" mass="{AREA_DENSITY * SIDE**2}"
              spacing="{SIDE / (sheet.columns - 1)} {SIDE / (sheet.rows - 1)} 1" pos="{SIDE / 2} {SIDE / 2} 0"
              radius="0.0005">
      <contact contype="0" conaffinity="0" selfcollide="none"/>
      <elasticity young="{STIFFNESS / THICKNESS}" poisson="0" thickness="{THICKNESS}" elastic2d="both" damping="0"/>
      <pin id="{pins}"/>
    </flexcomp>
  </worldbody>
</mujoco>""")
data = mujoco.MjData(model)
mujoco.mj_forward(model, data)
order = sheet.order_of(data.flexvert_xpos)


def advance() -> None:
    mujoco.mj_step(model, data, STEPS[setting])


def positions() -> Array:
    mujoco.mj_kinematics(model, data)
    mujoco.mj_flex(model, data)
    return np.array(data.flexvert_xpos[order])


run("MuJoCo", mujoco.__version__, setting, sheet, frames, advance, positions)
