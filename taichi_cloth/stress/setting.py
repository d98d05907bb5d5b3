"""What the cases are run with: every method as it is usual, and the two settings recommended for hard scenes."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

from ..scene.model import COLLIDERS, USUAL, Scene, Solver, Tear

CELLS = 32  # along a side of the base sheet, with every setting
# Of a sweep beside one over all springs: a factor's solution, four stages, and substeps that the method itself adds.
SWEEP_COST = {"projective": 10, "rk4": 300, "spring": 60, "lines": 4}


@dataclass(frozen=True)
class Setting:
    """A method with its knobs. What it does not name is the scene's."""

    name: str
    solver: Solver  # its damping [1/s] is taken where a scene has less, but some
    limit_sweeps: int = 1  # of a limit of strain
    swept: bool = False  # every collider is
    compression: float = 1.0  # of a fabric that has more
    untangle: bool = False  # a cloth that keeps off itself does
    stick: bool = False  # and its friction, where particles keep off particles
    tear: float | None = None  # strain at which threads give way

    @property
    def cost(self) -> int:
        """How dear a frame is beside others, very roughly: sweeps, each as dear as its method's."""
        return self.solver.substeps * self.solver.iterations * SWEEP_COST.get(self.solver.name, 1)

    def of(self, scene: Scene) -> Scene:
        """The same scene run with this setting."""
        damping = scene.solver.damping and max(scene.solver.damping, self.solver.damping)
        solver = replace(self.solver, damping=damping, stiffness=scene.solver.stiffness)
        limit = scene.limit and replace(scene.limit, sweeps=self.limit_sweeps)
        fabric = replace(scene.fabric, compression=min(scene.fabric.compression, self.compression))
        off_itself = scene.self_collision
        off_itself = off_itself and replace(
            off_itself,
            untangle=off_itself.untangle or self.untangle,
            stick=off_itself.stick or (self.stick and off_itself.contacts == "particles"),
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


USUAL_SETTINGS = {name: Setting(name, Solver(name, *usual, damping=0.0)) for name, usual in USUAL.items()}
# The scene's own fabric and damping: the same cloth as with every other setting.
ROBUST = Setting("robust", Solver("xpbd", 60, 8, damping=0.0), limit_sweeps=24, swept=True, untangle=True, stick=True)
# Another material: threads that buckle instead of pushing. Their energy is convex: it has no other minima.
ROBUST_SLACK = replace(ROBUST, name="robust-slack", solver=replace(ROBUST.solver, damping=4.0), compression=0.0)
SETTINGS = USUAL_SETTINGS | {one.name: one for one in (ROBUST, ROBUST_SLACK)}
