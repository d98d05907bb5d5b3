"""What the cases are run with: every method as it is usual, and the setting that is recommended for hard scenes."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

from ..scene.model import COLLIDERS, USUAL, Scene, Solver, Tear

CELLS = 32  # of a side of the usual sheet


@dataclass(frozen=True)
class Setting:
    """A method with its knobs. What it does not name is the scene's."""

    name: str
    solver: Solver  # its damping [1/s] is taken where a scene has less, but some
    limit_sweeps: int = 1  # of a limit of strain
    swept: bool = False  # every collider is
    compression: float = 1.0  # of a fabric that has more
    untangle: bool = False  # a cloth that keeps off itself does
    stick: bool = False  # and its friction
    cells: int = CELLS
    tear: float | None = None  # strain at which threads give way

    @property
    def cost(self) -> int:
        """How dear a frame is beside others, very roughly: sweeps times cells."""
        return self.solver.substeps * self.solver.iterations * self.cells**2

    def of(self, scene: Scene) -> Scene:
        """The same scene run with this setting."""
        damping = scene.solver.damping and max(scene.solver.damping, self.solver.damping)
        solver = replace(self.solver, damping=damping, stiffness=scene.solver.stiffness)
        limit = scene.limit and replace(scene.limit, sweeps=self.limit_sweeps)
        fabric = replace(scene.fabric, compression=min(scene.fabric.compression, self.compression))
        off_itself = scene.self_collision
        off_itself = off_itself and replace(
            off_itself, untangle=off_itself.untangle or self.untangle, stick=off_itself.stick or self.stick
        )
        scene = replace(scene, solver=solver, limit=limit, fabric=fabric, self_collision=off_itself)
        if self.tear is not None:  # what resists bending cannot be cut
            scene = replace(scene, tear=Tear(self.tear), fabric=replace(scene.fabric, bending=0.0))
        if not self.swept:
            return scene
        ground = scene.ground and replace(scene.ground, swept=True)
        bodies: dict[str, Any] = {
            name: tuple(replace(body, swept=True) for body in getattr(scene, name)) for name in COLLIDERS
        }
        return replace(scene, ground=ground, **bodies)

    def tearing(self, strain: float) -> Setting:
        """The same, with threads that give way at this strain."""
        return replace(self, name=f"{self.name} tear {strain:g}", tear=strain)


# A frame on 33 × 33 particles takes 2.3 ms and 60 ms with these: with all cases that would be hours.
FEWER = {"rk4": CELLS // 2, "projective": CELLS // 4}
USUAL_SETTINGS = {
    name: Setting(name, Solver(name, *usual, damping=0.0), cells=FEWER.get(name, CELLS))
    for name, usual in USUAL.items()
}
# Threads that do not push have an energy without other valleys than its least: no sheet can be knotted.
ROBUST = Setting(
    "robust",
    Solver("xpbd", 60, 8, damping=4.0),
    limit_sweeps=24,
    swept=True,
    compression=0.0,
    untangle=True,
    stick=True,
)
SETTINGS = USUAL_SETTINGS | {ROBUST.name: ROBUST}
