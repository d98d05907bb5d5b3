"""Notices within a frame that a cloth has blown up, keeps its last good frame, and says what to change."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from .kernels.guarding import bring_back, keep
from .scene import live_keys
from .scene.model import FRAME_SECONDS
from .simulation import Simulation
from .state.fields import like_places
from .state.pool import attached

# [m/s] What goes faster is no cloth any more: ten times what a hand reaches that moves 15 m between two frames. A
# blow-up grows by a factor in every substep and passes it a few frames before its numbers end.
RUNAWAY = 1e4


@dataclass(eq=False)
class Copy:
    """All that moves of a cloth, as it was."""

    x: Any
    x_prev: Any
    velocity: Any


class Guard:
    """Watches one simulation: ask `sound` after every frame (60 µs for 720 particles)."""

    def __init__(self, simulation: Simulation) -> None:
        cloth = simulation.cloth
        self._simulation = simulation
        names = ("copy", "other_copy")
        self._copies = [attached(cloth, n, lambda: Copy(*(like_places(cloth) for _ in range(3)))) for n in names]
        self._frame = 0
        self.sound()

    def sound(self) -> bool:
        """Whether all is well; then this frame is the last good one."""
        simulation = self._simulation
        solver, h = simulation.solver, FRAME_SECONDS / simulation.substeps
        good, new = self._copies  # the last sound frame, and room for another
        sound = bool(keep(solver.cloth, solver.stages, new, solver.work.gathers, h, RUNAWAY))
        if sound:
            self._copies, self._frame, self._torn = [new, good], simulation.frame, simulation.torn
        return sound

    def restore(self) -> str:
        """Back to the last good frame, with an open hand. Returns a line for the user: what happened, what helps."""
        simulation = self._simulation
        line = f"the cloth blew up in frame {simulation.frame}: {self._advice()}"
        simulation.release()
        simulation.mend(self._torn)
        bring_back(simulation.cloth, self._copies[0])
        simulation.frame = self._frame
        return line

    def _advice(self) -> str:
        """What to turn: a value that was moved away from the scene's, or else the substeps."""
        simulation = self._simulation
        for name, key in live_keys(simulation.scene).items():
            value = simulation.get(name)
            if value != key.value and name not in ("substeps", "iterations"):
                unit = f" {key.unit}" if key.unit else ""
                return f"{name.replace('_', ' ')} is {value:g}{unit}, the scene's own is {key.value:g}"
        taken, least = simulation.substeps, simulation.least_substeps
        limit = f" ({least} are the fewest that small motions bear)" if least > 1 else ""
        return f"try {2 * taken} substeps instead of {taken}{limit}, or less wind, gravity or stiffness"
