"""Return to earlier frames: to the last stable one after divergence, and to those of the last seconds."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

from ..kernels.integration import roll_back as restore_snapshot
from ..kernels.integration import snapshot
from ..scene import parameters_of
from ..scene.schema import FRAME_SECONDS
from ..state.solver_data import snapshots_of
from ..system.errors import Diverged, UsageError
from .checkpoint import Arrays, restore, state_arrays
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
        """Restore the last stable frame and release all grabs. Return a line for the user with the cause and advice.

        Listeners receive the event `roll_back`.
        """
        simulation, line = self._simulation, self.describe()
        for number in list(simulation.grabs):
            simulation.apply(Event("release", (number,)))
        simulation.set_torn(self._torn)
        restore_snapshot(simulation.cloth, self._snapshots[0])
        simulation.set_frame(self._frame)
        simulation.find_pairs()  # what it had verified are positions after the snapshot
        simulation.notify(Event("roll_back"))
        return line

    def describe(self) -> str:
        """Return a line for the user that the cloth has blown up, with the frame, the cause and advice."""
        return f"the cloth blew up in frame {self._simulation.frame}: {self._advice()}"

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


def guarded_frames(simulation: Simulation, frames: range, on_frame: Callable[[int], object]) -> Iterator[int]:
    """Yield the index of each frame before it is simulated, and call `on_frame` with it afterwards.

    Raises Diverged, and UsageError if `on_frame` steps, resets or changes the scene.
    """
    for k in frames:
        yield k
        guard = DivergenceGuard(simulation)  # of every frame: `on_frame` may have changed the cloth
        Simulation.step(simulation)  # without the checks of a subclass
        if not guard.check_and_snapshot():
            raise Diverged(guard.roll_back())
        before = simulation.frame, simulation.scene
        on_frame(k)
        if simulation.frame != before[0] or simulation.scene is not before[1]:
            raise UsageError("on_frame may move grabs and change parameters, but not step, reset or change the scene")


# -- the last seconds --------------------------------------------------------------------------------------------------

REWIND_SECONDS = 10.0  # [s] of simulated time
REWIND_EVERY = 6  # frames between two states
REWIND_BYTES = 1 << 26  # memory of all states: of a large cloth, or after hundreds of changes, the last ones only


@dataclass(frozen=True)
class RewindState:
    """A state of the simulation."""

    seconds: float
    """Simulated time since the first state [s]. It does not go back with the frame number."""
    arrays: Arrays
    can_undo: bool
    """Whether it is the state before a change that the user can undo."""

    @property
    def size(self) -> int:
        """Memory [bytes]."""
        return sum(array.nbytes for array in self.arrays.values())


class RewindBuffer:
    """States of the last seconds, and those before changes that can be undone.

    Going back releases all grabs; later states remain until the simulation moves on. Call `add` after every frame. A
    new scene, solver or fabric, and a feature that is switched, clear it: an earlier state may not fit.
    """

    def __init__(self, simulation: Simulation) -> None:
        self._simulation = simulation
        self._clear()

    def _clear(self) -> None:
        self._scene = self._simulation.scene
        self._states: list[RewindState] = []
        self._clock = 0.0  # [s]
        self._back = 0  # states between the present one and the newest
        self._requested = 0.0, 0.0  # how far back `go_back` was to go, and went [s]
        self.mark(can_undo=False)

    def _clear_if_changed(self) -> None:
        if self._simulation.scene is not self._scene:
            self._clear()

    @property
    def seconds(self) -> float:
        """How far back it can go from the newest state [s]."""
        ages = (self._states[-1].seconds - state.seconds for state in self._states)
        return next(age for age in ages if age <= REWIND_SECONDS)

    @property
    def back(self) -> float:
        """How far back the present state is [s]."""
        return self._states[-1].seconds - self._states[-1 - self._back].seconds

    def add(self) -> None:
        """Store the state after a frame if it is due."""
        self._clear_if_changed()
        self._drop_later()
        self._clock += FRAME_SECONDS
        if round(self._clock / FRAME_SECONDS) % REWIND_EVERY == 0:
            self.mark(can_undo=False)

    def mark(self, *, can_undo: bool = True) -> None:
        """Store the present state, before a change that the user can undo."""
        self._clear_if_changed()
        self._drop_later()
        state = RewindState(self._clock, state_arrays(self._simulation), can_undo)
        oldest = self._clock - REWIND_SECONDS
        self._states = [old for old in self._states if old.can_undo or old.seconds >= oldest] + [state]
        size = sum(one.size for one in self._states)
        while size > REWIND_BYTES and len(self._states) > 1:
            size -= self._states.pop(0).size

    def go_back(self, seconds: float) -> bool:
        """Restore the state that is nearest to `seconds` [s] before the newest. Return True."""
        self._clear_if_changed()
        time = self._states[-1].seconds - min(seconds, self.seconds)
        gaps = [abs(state.seconds - time) for state in self._states]
        self._restore(len(gaps) - 1 - gaps.index(min(gaps)))
        self._requested = seconds, self.back
        return True

    def further_back(self, seconds: float) -> float:
        """Return how far back to go [s], to go that much further than before.

        Stored states are farther apart than displayed frames: what does not reach the next state adds up.
        """
        requested, went = self._requested
        return min(max((requested if went == self.back else self.back) + seconds, 0.0), self.seconds)

    def undo(self) -> bool:
        """Restore the state before the last change that can be undone. Return False if there is none."""
        self._clear_if_changed()
        for back, state in enumerate(reversed(self._states)):
            if state.can_undo and back >= self._back:
                self._restore(back)
                self._drop_later()
                last = self._states.pop()
                self._states.append(RewindState(last.seconds, last.arrays, can_undo=False))
                return True
        return False

    def _restore(self, back: int) -> None:
        self._back = back
        restore(self._simulation, self._states[-1 - back].arrays)
        self._simulation.set_grabs({})

    def _drop_later(self) -> None:
        if self._back > 0:
            del self._states[-self._back :]
            self._back, self._clock = 0, self._states[-1].seconds
