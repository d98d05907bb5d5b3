"""Watches a cloth, frame by frame, and says when it is not alive any more."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..contact.bodies import distance, is_still
from ..measure.cloth import energies
from ..mesh.from_scene import stiffness_of
from ..scene.model import FRAME_SECONDS, Ground, Plane
from ..simulation import Simulation
from ..solvers.base import ExplicitSolver

Floats = NDArray[np.float64]

ENERGY_SLACK = 0.01  # of all the energy that was at hand
REACH_SIDES = 2.0  # sides of the sheet that a particle may be away from all that holds or carries it
DEEP, OUT = 0.01, 1e-3  # [m] below the margin: from where on a collider that stands still pushes too, and until when
NEAR = 1e-3  # [m] off the margin: what a moving collider may touch within the frame
ROUNDING = 2.0**-23  # of float32


class Broken(Exception):
    """A bound that did not hold."""

    def __init__(self, what: str, value: float, bound: float) -> None:
        super().__init__(what)
        self.what, self.value, self.bound = what, value, bound


@dataclass
class Worst:
    """The largest of each, over all frames."""

    energy: float = -1.0  # above what there was and what was given, as a share of both
    strain: float = 0.0
    speed: float = 0.0  # [m/s]
    penetration: float = 0.0  # [m] below a collider's surface, of particles that can move


class Watch:
    """Call `begin` once the cloth is where it starts, and `look` after every frame.

    Energy is that of motion, height, springs and bending. It may not be more than it was at the start and than was
    given since, plus 1 % of what was at hand: all of that motion and stretch, and the weight along two sides. What is
    given is known exactly where something is done between two frames, such as moving pins or turning a parameter
    (`given`). While a hand or a collider moves within a frame its force is not known, and neither is that of a
    collider that the cloth is deep in: all growth in such a frame counts as given. So does the most that wind can do,
    its full pressure along the ways of the particles. What takes energy away is never set against it.

    A spring of constant k that is wrong by e has ½ke². An implicit substep of h makes no more of it than
    ½e²·k/(1 + kh²(w_a + w_b)), with k infinite where springs have no constant (`verlet`): what a method has left
    unsolved counts for so much when it is judged, and for ½ke² where it is given.
    """

    def __init__(self, simulation: Simulation, worst: Worst, far: float = 0.0) -> None:
        """Keeps the `worst` up to date. `far` [m]: how much farther than usual the load itself takes the cloth."""
        self._simulation = simulation
        self._far = far
        topology, scene = simulation.topology, simulation.scene
        self._side = max(scene.cloth.width, scene.cloth.height)
        self._total = float(topology.mass.sum())
        self._weight = np.where(topology.pinned, 0.0, 1 / topology.mass)
        self.springs_are_others()
        self._bodies = simulation.bodies()
        self._moving = any(not is_still(body.collider) for body in self._bodies)
        self.worst = worst

    def springs_are_others(self) -> None:
        """Reads the springs of the simulation's method."""
        simulation, topology = self._simulation, self._simulation.topology
        self._woven = topology
        self._ends = np.ascontiguousarray(topology.ends.T)
        self._bonds = np.ascontiguousarray(topology.bonds.ends.T)
        self._rest = topology.rest
        self._threads = topology.family("structural") if topology.spring_count else np.zeros(0, np.int64)
        self._stiffness = stiffness_of(simulation.scene, simulation.solver.springs, topology)
        fabric = simulation.solver.springs == "fabric"
        self._compression = simulation.scene.fabric.compression if fabric else 1.0  # of shortened springs
        self._constants_of: object = None

    def begin(self) -> None:
        """From here on. The places of the pins are those they must keep."""
        x, v = self._read()
        self._middle = x.mean(axis=0)
        self._pins = np.float32(x[self._simulation.topology.pinned])
        self._anchors = float(np.linalg.norm(x - self._middle, axis=1).max())
        self._seconds = 0.0
        self._allowed = self._last = self.energy(x, v)
        self._at_hand = self._motion + self._elastic
        self._x = x
        self._deep = False
        self._see_depth(self._touches(x))

    def given(self, joules: float) -> None:
        """Work that was done on the cloth, and since when its energy is another."""
        self._allowed += max(joules, 0.0)
        self._at_hand += max(joules, 0.0)
        self._last += joules

    def springs_act_anew(self) -> None:
        """The substeps are others: what was left unsolved may act in full now."""
        self._allowed = max(self._allowed, self._last)

    def pins_are_at(self, places: Floats) -> None:
        """Where the pins are from now on [m]."""
        self._pins = np.float32(places)
        self.reach(places)

    def reach(self, places: Floats) -> None:
        """Something that carries the cloth is there [m]."""
        self._anchors = max(self._anchors, float(np.linalg.norm(places - self._middle, axis=1).max()))

    def energy(self, x: Floats, v: Floats) -> float:
        """All of it [J]."""
        return self._energies(x, v)[0]

    def _energies(self, x: Floats, v: Floats) -> tuple[float, float]:
        """All of it, and what the method can make of it in a substep [J]."""
        simulation = self._simulation
        topology = simulation.topology
        if topology is not self._woven:
            self.springs_are_others()  # it tore
        if simulation.grabbed is not None:
            v = v.copy()
            v[simulation.grabbed] = 0.0  # a hand has no mass
        self._motion, height = energies(topology, x, v, float(simulation.get("gravity")))
        gap = np.take(x, self._ends[1], 0) - np.take(x, self._ends[0], 0)
        self._lengths = np.sqrt(np.einsum("ij,ij->i", gap, gap))
        bent = np.take(x, self._bonds[1], 0) - np.take(x, self._bonds[0], 0)
        bending = 0.5 * float(topology.bonds.constant @ np.einsum("ij,ij->i", bent, bent))
        errors = self._lengths - self._rest
        squares = errors**2 * np.where(errors < 0, self._compression, 1.0)
        full, acting = self._constants()
        self._elastic = 0.5 * float(full @ squares) + bending
        self._rounding = 2 * float(acting.sum()) * (ROUNDING * float(np.abs(x).max(initial=0.0))) ** 2
        rest = self._motion + height
        return rest + self._elastic, rest + 0.5 * float(acting @ squares) + bending

    def _constants(self) -> tuple[Floats, Floats]:
        """Of every spring [N/m]: its own, and what of it acts."""
        simulation = self._simulation
        key = simulation.substeps, simulation.get("stiffness")
        if key != self._constants_of:
            h, slider = FRAME_SECONDS / key[0], float(key[1])
            both = self._weight[self._ends[0]] + self._weight[self._ends[1]]
            h_w = h * h * np.where(both > 0, both, np.inf)
            full = self._stiffness * slider
            if simulation.solver.springs == "springs":
                full = acting = full / h_w
            else:
                acting = full if isinstance(simulation.solver, ExplicitSolver) else full / (1 + full * h_w)
            self._constants_of, self._both_constants = key, (full, acting)
        return self._both_constants

    def look(self, *, driven: bool = False) -> None:
        """Takes in the frame that was just run; `driven`: by a hand or by pins. Raises Broken."""
        simulation, topology, worst = self._simulation, self._simulation.topology, self.worst
        x, v = self._read()
        self._seconds += FRAME_SECONDS
        bad = int((~np.isfinite(x)).any(axis=1).sum() + (~np.isfinite(v)).any(axis=1).sum())
        if bad:
            raise Broken("particles that are nowhere", bad, 0)
        if not np.array_equal(np.float32(x[topology.pinned]), self._pins):
            raise Broken("a pin moved [m]", float(np.abs(x[topology.pinned] - self._pins).max()), 0)

        energy, acting = self._energies(x, v)
        touch = self._touches(x)
        if driven or self._deep or (self._moving and touch < self._travel() + NEAR):
            self.given(max(energy - self._last, 0.0))
        self.given_by_wind(x, v)
        self._last, self._x = energy, x
        self._see_depth(touch)

        gravity = abs(float(simulation.get("gravity")))
        scale = self._at_hand + self._total * gravity * REACH_SIDES * self._side
        over = acting - self._allowed - self._rounding
        worst.energy = max(worst.energy, over / scale if scale > 0 else 0.0)
        free = self._free()
        self.speed = float(np.sqrt(np.einsum("ij,ij->i", v, v)[free].max(initial=0.0)))
        worst.speed = max(worst.speed, self.speed)
        self.strain = float((self._lengths / self._rest - 1)[self._threads].max(initial=0.0))
        worst.strain = max(worst.strain, self.strain)
        if over > ENERGY_SLACK * scale:
            raise Broken("energy above all that was given [J]", over, ENERGY_SLACK * scale)
        flight = 0.0
        if not topology.pinned.any():
            flight = self._seconds * np.sqrt(2 * self._at_hand / self._total) + gravity * self._seconds**2 / 2
        most = self._anchors + REACH_SIDES * self._side + self._far + flight
        away = float(np.linalg.norm(x - self._middle, axis=1).max())
        if away > most:
            raise Broken("a particle is away from all that holds it [m]", away, most)

    def given_by_wind(self, x: Floats, v: Floats) -> None:
        """At most: full pressure on every particle's share of the sheet, along its way."""
        simulation, wind = self._simulation, self._simulation.scene.wind
        if wind is None or not simulation.get("wind"):
            return
        air = float(np.hypot(simulation.get("wind_x"), simulation.get("wind_z"))) * (1 + wind.turbulence)
        if air > 0:
            area = simulation.topology.mass / simulation.scene.cloth.area_density
            speeds = air + np.sqrt(np.einsum("ij,ij->i", v, v))
            force = wind.air_density / 2 * max(wind.drag, wind.lift) * area * speeds**2
            self.given(float(force @ np.linalg.norm(x - self._x, axis=1)))

    # -- colliders -------------------------------------------------------------------------------------

    def look_at_colliders(self) -> None:
        """One may be elsewhere, or larger."""
        self._see_depth(self._touches(self._simulation.positions()))

    def _see_depth(self, touch: float) -> None:
        """What a body holds, it pushes until all of it is out."""
        self._deep = touch < -(OUT if self._deep else DEEP)

    def _free(self) -> NDArray[np.bool_]:
        free = ~self._simulation.topology.pinned
        if self._simulation.grabbed is not None:
            free[self._simulation.grabbed] = False
        return free

    def _touches(self, x: Floats) -> float:
        """How far the nearest particle that can move is from any margin [m]."""
        self._before = self._bodies
        if self._moving or self._simulation.scene.spheres:  # a slider sets a ball's radius
            self._bodies = self._simulation.bodies()
        if not self._bodies:
            return np.inf
        points = x[self._free()]
        nearest = np.inf
        for body in self._bodies:
            away = float(distance(body, points).min(initial=np.inf))
            self.worst.penetration = max(self.worst.penetration, -away)
            nearest = min(nearest, away - body.collider.margin)
            if not isinstance(body.collider, (Ground, Plane)):
                far = np.linalg.norm(body.center - self._middle) + np.linalg.norm(body.size)
                self._anchors = max(self._anchors, float(far)) if nearest < 0.1 else self._anchors
        return nearest

    def _travel(self) -> float:
        """How far a collider's surface has moved in the frame at most [m]."""
        pairs = zip(self._before, self._bodies, strict=True)
        return max(float(np.linalg.norm(b.center - a.center)) + float(np.abs(b.axes - a.axes).max()) for a, b in pairs)

    def _read(self) -> tuple[Floats, Floats]:
        return self._simulation.positions(), self._simulation.velocities()
