"""What the cases are run with: every method as it is usual, and the setting that is recommended for hard scenes."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

from ..scene.model import COLLIDERS, USUAL, Limit, Scene, Solver

CELLS = 32  # of a side of the usual sheet


@dataclass(frozen=True)
class Setting:
    """A method with its knobs. What it does not name is the scene's."""

    name: str
    solver: Solver
    limit: Limit | None = None
    swept: bool = False  # every collider is
    damping_time: float = 0.0  # [s] of the springs' dashpots, where the scene has none
    cells: int = CELLS

    def of(self, scene: Scene) -> Scene:
        """The same scene run with this setting; its damping is kept."""
        solver = replace(self.solver, damping=scene.solver.damping, stiffness=scene.solver.stiffness)
        fabric = replace(scene.fabric, damping_time=scene.fabric.damping_time or self.damping_time)
        scene = replace(scene, solver=solver, limit=scene.limit or self.limit, fabric=fabric)
        if not self.swept:
            return scene
        ground = scene.ground and replace(scene.ground, swept=True)
        bodies: dict[str, Any] = {
            name: tuple(replace(body, swept=True) for body in getattr(scene, name)) for name in COLLIDERS
        }
        return replace(scene, ground=ground, **bodies)


# A frame on 33 × 33 particles takes 2.3 ms and 60 ms with these: with all cases that would be hours.
FEWER = {"rk4": CELLS // 2, "projective": CELLS // 4}
USUAL_SETTINGS = {
    name: Setting(name, Solver(name, *usual), cells=FEWER.get(name, CELLS)) for name, usual in USUAL.items()
}
ROBUST = Setting("robust", Solver("xpbd", 60, 1), swept=True)
SETTINGS = USUAL_SETTINGS | {ROBUST.name: ROBUST}
