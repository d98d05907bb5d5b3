"""Detection of divergence after each frame, and a rollback to the last stable frame with advice for the user."""

from __future__ import annotations

from ..kernels.integration import roll_back as restore_snapshot
from ..kernels.integration import snapshot
from ..scene import parameters_of
from ..scene.schema import FRAME_SECONDS
from ..state.solver_data import snapshots_of
from .events import Event
from .simulation import Simulation

# [m/s] A faster particle means divergence. It is ten times the speed of a grab that moves 15 m in one frame. Divergence
# grows exponentially with the substeps, and exceeds this speed a few frames before the numbers overflow.
MAX_SPEED = 1e4


class DivergenceGuard:
    """Detects divergence of a simulation. Call `check_and_snapshot` after every frame (60 µs for 720 particles)."""

    def __init__(self, simulation: Simulation) -> None:
        cloth = simulation.cloth
        self._simulation = simulation
        self._snapshots = list(snapshots_of(cloth))
        self._frame, self._torn = simulation.frame, simulation.torn
        self.check_and_snapshot()

    def check_and_snapshot(self) -> bool:
        """Return whether the cloth is stable. If so, the snapshot to roll back to becomes this frame.

        Stable means that all positions are finite and no speed exceeds `MAX_SPEED`.
        """
        simulation = self._simulation
        solver, h = simulation.solver, FRAME_SECONDS / simulation.substeps
        last_stable, spare = self._snapshots
        stable = bool(snapshot(solver.cloth, solver.features, spare, solver.layout.is_parallel, h, MAX_SPEED))
        if stable:
            self._snapshots, self._frame, self._torn = [spare, last_stable], simulation.frame, simulation.torn
        return stable

    def roll_back(self) -> str:
        """Restore the last stable frame and release all grabs. Return a line for the user with the cause and advice."""
        simulation = self._simulation
        line = f"the cloth blew up in frame {simulation.frame}: {self._advice()}"
        for number in list(simulation.grabs):
            simulation.apply(Event("release", (number,)))
        simulation.untear(self._torn)
        restore_snapshot(simulation.cloth, self._snapshots[0])
        simulation.frame = self._frame
        return line

    def _advice(self) -> str:
        """Return what to change: a runtime parameter that differs from the scene, else the substeps."""
        simulation = self._simulation
        for name, key in parameters_of(simulation.scene).items():
            value = simulation.params[name]
            if value != key.value and name not in ("substeps", "iterations"):
                unit = f" {key.unit}" if key.unit else ""
                return f"{name.replace('_', ' ')} is {value:g}{unit}, the scene's value is {key.value:g}"
        used, minimum = simulation.substeps, simulation.min_stable_substeps
        limit = f" (small motions need at least {minimum})" if minimum > 1 else ""
        return f"try {2 * used} substeps instead of {used}{limit}, or less wind, gravity or stiffness"
