"""Watches a cloth, frame by frame, and says when it is not alive any more."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..contact.bodies import Body, distance, is_still, leaps, turn_between
from ..measure.cloth import energies
from ..mesh.from_scene import stiffness_of
from ..scene.model import FRAME_SECONDS, Ground, Plane
from ..simulation import Simulation
from ..solvers.base import ExplicitSolver

Floats = NDArray[np.float64]

ENERGY_SLACK = 0.01  # of all the energy that was at hand
REACH_SIDES = 2.0  # sides of the sheet that a particle may be away from all that holds or carries it
DEEP, OUT = 0.01, 1e-3  # [m] below the margin: from where on a collider holds particles, and until when
EJECTED = 2.0  # [m/s] the most that a held particle may be ejected at
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

    **Energy** is that of motion, height, springs and bending. It may not exceed what there was at the start and what
    was given since, plus 1 % of all energy that was at hand: motion and stretch at the start, all that was given, and
    the weight times two sides. It is one sum throughout: what is at hand, what is given and what is judged.

    A spring of constant k, wrong by e, has ½·k'·e² in it, with the constant of the scene's fabric whatever the method,
    and k' = k / (1 + c·k·h²·(w_a + w_b)) where the method is implicit (w are inverse masses, h is the substep). An
    implicit substep leaves of a mode of frequency ω no more energy than V / (1 + h²ω²); n springs in a row, held at one
    end, have h²ω² = c·k·h²·(w_a + w_b) in their slowest mode, with c = ½·(π/2n)², and more in all others. So k' is
    the least constant that counts all of the energy that any mode can set free. It differs from k where a spring is far
    too stiff for the substep, and its error is what the iterations left.

    **What is given** is known exactly where something is done between two frames, such as moving a pin or turning a
    parameter: it is the difference of the sums (`given`). Within a frame, growth counts as given up to a bound on the
    work, the sum of (with T_i the magnitudes of the spring forces on particle i added up, and the larger of the values
    before and after the frame, which lasts Δt):

    - hand: Σ over substeps max(F·d, 0), with F the larger of the forces needed before and after, and d its way;
    - wind: Σ_i p_i·|d_i|, full pressure p_i on a particle's area, along its way d_i;
    - a collider that moves: Σ_i s_i·(m_i·(|v_i| + |v_i'|)/Δt + T_i + m_i·g) over all particles that it may touch, s_i
      the way of its surface: the momentum that it can have given, times its speed;
    - a collider that holds particles, because it appeared around them: Σ_i u_i·(T_i + m_i·g) + ½·m_i·(2 m/s)², u_i by
      how much less deep the particle is, the last term once a particle: 2 m/s is the most that it may be ejected at.
    """

    def __init__(self, simulation: Simulation, worst: Worst, far: float = 0.0) -> None:
        """Keeps the `worst` up to date. `far` [m]: how much farther than usual the load itself takes the cloth."""
        if not np.isfinite(far):
            raise ValueError("the reach needs a finite bound")
        self._simulation = simulation
        self._far = far
        cloth = simulation.scene.cloth
        self._side = max(cloth.width, cloth.height)
        self._slowest = 0.5 * (np.pi / (2 * (max(cloth.rows, cloth.columns) - 1))) ** 2  # c, as above
        self._read_scene()
        self.worst = worst

    def _read_scene(self) -> None:
        topology = self._simulation.topology
        self._total = float(topology.mass.sum())
        self._weight = np.where(topology.pinned, 0.0, 1 / topology.mass)
        self.springs_are_others()
        self._bodies = self._simulation.bodies()
        self._moving = [not is_still(body.collider) for body in self._bodies]

    def scene_is_another(self) -> None:
        """Masses, springs and colliders are those of another scene of the same sheet; what one holds it may eject."""
        self._read_scene()
        self._ejected[:] = False

    def springs_are_others(self) -> None:
        """Reads the springs of the simulation's method."""
        simulation, topology = self._simulation, self._simulation.topology
        self._woven = topology
        self._ends = np.ascontiguousarray(topology.ends.T)
        self._bonds = np.ascontiguousarray(topology.bonds.ends.T)
        self._rest = topology.rest
        self._threads = topology.family("structural") if topology.spring_count else np.zeros(0, np.int64)
        self._stiffness = stiffness_of(simulation.scene, "fabric", topology)
        self._compression = simulation.scene.fabric.compression
        self._constants_of: object = None

    def begin(self) -> None:
        """From here on. The places of the pins are those they must keep."""
        x, v = self._read()
        self._middle = x.mean(axis=0)
        self._pins = np.float32(x[self._simulation.topology.pinned])
        self._anchors = float(np.linalg.norm(x - self._middle, axis=1).max())
        self._seconds = self._hand_work = 0.0
        self._allowed = self._last = self.energy(x, v)
        self._at_hand = self._motion + self._elastic
        self._x, self._v = x, v
        self._deep, self._ejected = False, np.zeros(len(x), bool)
        self._meet_colliders(x)

    def given(self, joules: float) -> None:
        """Work that was done on the cloth, or taken from it, and since when its energy is another."""
        self._allowed += joules
        self._at_hand += max(joules, 0.0)
        self._last += joules

    def pins_are_at(self, places: Floats) -> None:
        """Where the pins are from now on [m]."""
        self._pins = np.float32(places)
        self.reach(places)

    def reach(self, places: Floats) -> None:
        """Something that carries the cloth is there [m]."""
        self._anchors = max(self._anchors, float(np.linalg.norm(places - self._middle, axis=1).max()))

    def energy(self, x: Floats, v: Floats) -> float:
        """All of it [J]."""
        simulation = self._simulation
        topology = simulation.topology
        if topology is not self._woven:
            self.springs_are_others()  # it tore
        if simulation.grabbed is not None:
            v = v.copy()
            v[simulation.held] = 0.0  # a hand has no mass
        self._motion, height = energies(topology, x, v, float(simulation.get("gravity")))
        gap = np.take(x, self._ends[1], 0) - np.take(x, self._ends[0], 0)
        self._lengths = np.sqrt(np.einsum("ij,ij->i", gap, gap))
        bent = np.take(x, self._bonds[1], 0) - np.take(x, self._bonds[0], 0)
        errors = self._lengths - self._rest
        constants = self._constants() * np.where(errors < 0, self._compression, 1.0)
        self._elastic = 0.5 * float(constants @ errors**2)
        self._elastic += 0.5 * float(topology.bonds.constant @ np.einsum("ij,ij->i", bent, bent))
        near = float(np.abs(x - topology.origin).max(initial=0.0))
        self._rounding = 2 * float(constants.sum()) * (ROUNDING * near) ** 2
        return self._motion + height + self._elastic

    def _constants(self) -> Floats:
        """k' of every spring [N/m]."""
        simulation = self._simulation
        key = simulation.substeps, simulation.get("stiffness")
        if key != self._constants_of:
            k = self._stiffness * float(key[1])
            if not isinstance(simulation.solver, ExplicitSolver):
                h = FRAME_SECONDS / key[0]
                both = self._weight[self._ends[0]] + self._weight[self._ends[1]]
                k = k / (1 + self._slowest * k * h * h * both)
            self._constants_of, self._acting = key, k
        return self._acting

    def look(self) -> None:
        """Takes in the frame that was just run. Raises Broken."""
        simulation, topology, worst = self._simulation, self._simulation.topology, self.worst
        x, v = self._read()
        self._seconds += FRAME_SECONDS
        for what, values in (("positions", x), ("velocities", v)):
            if not (finite := np.isfinite(values)).all():
                raise Broken(f"particles whose {what} are not finite", int((~finite).any(axis=1).sum()), 0)
        if not np.array_equal(np.float32(x[topology.pinned]), self._pins):
            raise Broken("a pin moved [m]", float(np.abs(x[topology.pinned] - self._pins).max()), 0)

        energy = self.energy(x, v)
        growth = energy - self._last
        if growth > 0:
            self.given(min(growth, self._work_bound(x, v)))
        self._last, self._x, self._v, self._hand_work = energy, x, v, 0.0
        self._meet_colliders(x)

        gravity = abs(float(simulation.get("gravity")))
        scale = self._at_hand + self._total * gravity * REACH_SIDES * self._side
        over = energy - self._allowed - self._rounding
        worst.energy = max(worst.energy, over / scale if scale > 0 else 0.0)
        free = self._free()
        self.speed = float(np.sqrt(np.einsum("ij,ij->i", v, v)[free].max(initial=0.0)))
        worst.speed = max(worst.speed, self.speed)
        self.strain = float((self._lengths[self._threads] / self._rest[self._threads] - 1).max(initial=0.0))
        worst.strain = max(worst.strain, self.strain)
        if over > ENERGY_SLACK * scale:
            raise Broken("energy above all that was given [J]", over, ENERGY_SLACK * scale)
        flight = 0.0
        if not topology.pinned.any() or (simulation.scene.tear is not None and simulation.torn.any()):
            flight = self._seconds * np.sqrt(2 * self._at_hand / self._total) + gravity * self._seconds**2 / 2
        most = self._anchors + REACH_SIDES * self._side + self._far + flight
        away = float(np.linalg.norm(x - self._middle, axis=1).max())
        if away > most:
            raise Broken("a particle is away from all that holds it [m]", away, most)

    # -- work within a frame ---------------------------------------------------------------------------

    def _work_bound(self, x: Floats, v: Floats) -> float:
        """The most that was given to the cloth in the frame that ends so [J]."""
        work = self._hand_work + self.wind_work(x, v)
        if any(self._moving) or self._deep:
            work += self._collider_work(x, v)
        return work

    def begin_hand_work(self) -> None:
        """A hand moves in the frame that begins. Call `add_hand_work` after each of its substeps."""
        self._hand_at, self._hand_force = self._hand()

    def add_hand_work(self) -> None:
        places, force = self._hand()
        way = places - self._hand_at
        before, after = (np.einsum("ij,ij->i", f, way) for f in (self._hand_force, force))
        self._hand_work += float(np.maximum(np.maximum(before, after), 0.0).sum())
        self._hand_at, self._hand_force = places, force

    def _hand(self) -> tuple[Floats, Floats]:
        """Where particles that hands hold are, and the force that it takes to hold them there [N]."""
        simulation = self._simulation
        x, held = simulation.positions(), simulation.held
        self.energy(x, np.zeros_like(x))  # the lengths of the springs
        force = -self._forces(x)
        force[:, 1] += simulation.topology.mass * float(simulation.get("gravity"))
        return x[held], force[held]

    def _pulls(self, x: Floats) -> tuple[Floats, Floats]:
        """Pull of each spring [N] at these places, whose lengths are known, and the vectors of bending links (B, 3)."""
        errors = self._lengths - self._rest
        pulls: Floats = self._constants() * np.where(errors < 0, self._compression, 1.0) * errors
        bonds = self._simulation.topology.bonds
        bent = np.take(x, self._bonds[1], 0) - np.take(x, self._bonds[0], 0)
        return pulls, bonds.constant[:, None] * bent

    def _forces(self, x: Floats) -> Floats:
        """Of springs and bending on every particle [N], (N, 3), at places whose lengths are known."""
        pulls, bent = self._pulls(x)
        gap = np.take(x, self._ends[1], 0) - np.take(x, self._ends[0], 0)
        along = gap * (pulls / np.maximum(self._lengths, 1e-12))[:, None]
        force = np.zeros_like(x)
        for ends, pull in ((self._ends, along), (self._bonds, bent)):
            for k in range(3):
                force[:, k] += np.bincount(ends[0], pull[:, k], len(x)) - np.bincount(ends[1], pull[:, k], len(x))
        return force

    def _tensions(self, x: Floats) -> Floats:
        """T_i: the magnitudes of all spring and bending forces on every particle, added up [N], (N,)."""
        pulls, bent = self._pulls(x)
        total = np.zeros(len(x))
        for ends, size in ((self._ends, np.abs(pulls)), (self._bonds, np.linalg.norm(bent, axis=1))):
            total += np.bincount(ends[0], size, len(x)) + np.bincount(ends[1], size, len(x))
        return total

    def wind_work(self, x: Floats, v: Floats) -> float:
        """At most: full pressure on every particle's share of the sheet, along its way [J]."""
        simulation, wind = self._simulation, self._simulation.scene.wind
        if wind is None or not simulation.get("wind"):
            return 0.0
        air = float(np.hypot(simulation.get("wind_x"), simulation.get("wind_z"))) * (1 + wind.turbulence)
        if air == 0:
            return 0.0
        area = simulation.topology.mass / simulation.scene.cloth.area_density
        fastest = np.maximum(*(np.einsum("ij,ij->i", u, u) for u in (self._v, v)))
        force = wind.air_density / 2 * max(wind.drag, wind.lift) * area * (air + np.sqrt(fastest)) ** 2
        return float(force @ np.linalg.norm(x - self._x, axis=1))

    def _collider_work(self, x: Floats, v: Floats) -> float:
        """At most, of colliders that move and of those that hold particles [J]: see the class."""
        topology, simulation = self._simulation.topology, self._simulation
        after = self._tensions(x)
        self.energy(self._x, self._v)
        tension = np.maximum(after, self._tensions(self._x))
        self.energy(x, v)
        load = tension + topology.mass * abs(float(simulation.get("gravity")))
        hit = topology.mass * (np.linalg.norm(self._v, axis=1) + np.linalg.norm(v, axis=1)) / FRAME_SECONDS
        way = np.linalg.norm(x - self._x, axis=1)
        free = self._free()
        work = 0.0
        for before, now, moving in zip(self._bodies, simulation.bodies(), self._moving, strict=True):
            if moving and leaps(now.collider, simulation.seconds - FRAME_SECONDS, simulation.seconds):
                before, moving, self._deep = now, False, True  # it appeared there
                self._ejected[:] = False
            deep, deep_now = (body.collider.margin - distance(body, p) for body, p in ((before, self._x), (now, x)))
            if moving:
                surface = self._surface_way(before, now, x)
                near = free & (np.maximum(deep, deep_now) > -(surface + way + NEAR))
                work += float((surface * (hit + load))[near].sum())
            if self._deep:
                inside = free & (deep > OUT)
                work += float((np.maximum(deep - deep_now, 0.0) * load)[inside].sum())
                work += EJECTED**2 / 2 * float(topology.mass[inside & ~self._ejected].sum())
                self._ejected |= inside
        return work

    def _surface_way(self, before: Body, now: Body, x: Floats) -> Floats:
        """How far a body's surface beside each particle went in the frame at most [m], (N,)."""
        angle = float(np.linalg.norm(turn_between(before.axes, now.axes)))
        arms = (np.linalg.norm(p - body.center, axis=1) for body, p in ((before, self._x), (now, x)))
        way: Floats = float(np.linalg.norm(now.center - before.center)) + angle * np.maximum(*arms)
        return way

    # -- colliders -------------------------------------------------------------------------------------

    def look_at_colliders(self) -> None:
        """One may be elsewhere, or larger: what it holds now it may eject."""
        known = self._bodies
        self._meet_colliders(self._simulation.positions())
        if any(not np.array_equal(a.size, b.size) for a, b in zip(known, self._bodies, strict=True)):
            self._ejected[:] = False

    def _meet_colliders(self, x: Floats) -> None:
        """Notes where colliders are, how deep particles are in them, and that what they carry reaches so far."""
        if any(self._moving) or self._simulation.scene.spheres:  # a slider sets a ball's radius
            self._bodies = self._simulation.bodies()
        if not self._bodies:
            return
        points = x[self._free()]
        deepest = -np.inf
        for body in self._bodies:
            away = float(distance(body, points).min(initial=np.inf))
            self.worst.penetration = max(self.worst.penetration, -away)
            deepest = max(deepest, body.collider.margin - away)
            if not isinstance(body.collider, (Ground, Plane)) and away - body.collider.margin < 0.1:
                far = float(np.linalg.norm(body.center - self._middle) + np.linalg.norm(body.size))
                self._anchors = max(self._anchors, far)
        # What a body holds, it pushes until all of it is out.
        self._deep = deepest > (OUT if self._deep else DEEP)

    def _free(self) -> NDArray[np.bool_]:
        free = ~self._simulation.topology.pinned
        if self._simulation.grabbed is not None:
            free[self._simulation.held] = False
        return free

    def _read(self) -> tuple[Floats, Floats]:
        return self._simulation.positions(), self._simulation.velocities()
