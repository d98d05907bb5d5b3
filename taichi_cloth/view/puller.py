"""A user's hand on the cloth: it takes what is under the cursor, goes where that goes, and lets go."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray

from ..contact.bodies import first_hit
from ..interact.camera import OrbitCamera
from ..interact.picking import Handle, pick
from ..simulation import Simulation

Cursor = tuple[float, float]  # a screen point
Size = tuple[int, int]  # [pixels] of the picture


@dataclass
class Grip:
    """The held particle and the handle it hangs on."""

    index: int
    handle: Handle
    led_to: NDArray[np.float64]  # [m] where the hand was at the last simulated frame


class Puller:
    """One of the hands of a simulation, that of one user."""

    def __init__(self, simulation: Simulation, number: int = 0) -> None:
        """`number` is that of the hand (`Simulation.grab`)."""
        self.simulation = simulation
        self.number = number
        self.grip: Grip | None = None

    def take(self, camera: OrbitCamera, cursor: Cursor, size: Size, radius: float) -> bool:
        """Takes the cloth at a screen point with a patch of this `radius` [m]; whether there was any that is free."""
        index = under(self.simulation, camera, cursor, size)
        if index is None or (index in self.simulation.held and index != self.simulation.grabbed_by(self.number)):
            return False
        place = self.simulation.positions()[index]
        self.grip = Grip(index, Handle(camera, cursor, size[0] / size[1], place), place)
        self.simulation.grab(index, place, radius, self.number)
        return True

    def follow(self, camera: OrbitCamera, cursor: Cursor, size: Size) -> None:
        """Leads what is held to the cursor, if anything is."""
        if self.grip is not None:
            self._lead_to(self.grip.handle.move(camera, cursor, size[0] / size[1]))

    def lead(self, share: float) -> None:
        """Goes this share of the way that the cursor went since the last picture.

        On a slow display several frames pass between two pictures: the hand must not jump in one of them.
        """
        if self.grip is not None:
            start, end = self.grip.led_to, self.grip.handle.target
            self._lead_to(start + share * (end - start))

    def arrive(self) -> None:
        """The frames of a picture are over: the hand is where the cursor is."""
        if self.grip is not None:
            self.grip.led_to = self.grip.handle.target

    def join(self, other: Puller, partner: NDArray[np.int64], radius: float) -> None:
        """Holds what another one holds, by the same handle: here it is the `partner` of each particle there, (N,)."""
        if other.grip is None:
            if self.grip is not None:
                self.let_go()
        elif self.grip is None or self.grip.handle is not other.grip.handle:
            index = int(partner[other.grip.index])
            place = self.simulation.positions()[index]
            self.grip = Grip(index, other.grip.handle, place)
            self.simulation.grab(index, place, radius, self.number)

    def let_go(self) -> None:
        """Throws what is held, if anything is."""
        self.simulation.release(self.number)
        self.grip = None

    def _lead_to(self, target: NDArray[np.float64]) -> None:
        if self.grip is not None:
            self.simulation.grab(self.grip.index, target, hand=self.number)


def under(simulation: Simulation, camera: OrbitCamera, cursor: Cursor, size: Size) -> int | None:
    """The particle at a screen point; a collider in front of it hides it."""
    solid = partial(first_hit, simulation.bodies())
    picked = pick(camera, cursor, size, simulation.positions(), simulation.topology.triangles, solid)
    return None if picked is None else picked.index
