"""Checks, after every frame, that a cloth is alive: finite, pinned, within reach, and without energy from nothing."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ...collision.colliders import PosedCollider, is_static, pose, rotation_vector_between, signed_distance, teleports
from ...geometry.cloth_builder import attachment_ids, spring_stiffness
from ...geometry.topology import energies
from ...scene.collider_schema import Ground, Plane
from ...scene.schema import FRAME_SECONDS
from ...simulation.simulation import Simulation
from ...solvers.base import ExplicitSolver

Floats = NDArray[np.float64]

ENERGY_SLACK = 0.01  # share of the available energy
REACH_SIDES = 2.0  # distance from everything that supports the cloth that a particle may have, in sides of the sheet
EJECTION_START, EJECTION_END = (
    0.01,
    1e-3,
)  # [m] depth below the margin at which a collider starts and stops ejecting particles
EJECTED = 2.0  # [m/s] largest speed at which a collider may eject particles
NEAR = 1e-3  # [m] distance outside the margin up to which a moving collider may touch particles within the frame
ROUNDING = 2.0**-23  # relative rounding of float32


class Violation(Exception):
    """A violated bound: `what`, the value and the bound."""

    def __init__(self, what: str, value: float, bound: float) -> None:
        super().__init__(what)
        self.what, self.value, self.bound = what, value, bound


@dataclass
class Extremes:
    """The largest values over all frames."""

    energy: float = -1.0
    """Excess over the energy at the start and the work done since, as a share of the available energy."""
    strain: float = 0.0
    """Strain of structural springs."""
    speed: float = 0.0  # [m/s]
    penetration: float = 0.0
    """Depth of free particles below the surface of a collider [m]."""


class InvariantMonitor:
    """A monitor of one cloth. Call `begin` when the cloth is at its start, and `check_frame` after each frame.

    **Energy** is the sum of kinetic, gravitational, spring and bending energy. It may not exceed the energy at the
    start plus the work done since, plus 1 % of the available energy. That is the kinetic and elastic energy at the
    start, all positive work, and the weight times two sides of the sheet. Available energy, work and the check use the
    same sum.

    A spring of constant k with length error e stores ½·k'·e². The constant k is that of the scene's fabric for every
    solver. In explicit solvers k' = k; in implicit ones k' = k / (1 + c·k·h²·(w_a + w_b)), with inverse masses w and
    substep h. An implicit substep leaves a mode of frequency ω and energy V at most the energy V / (1 + h²ω²). A row of
    n springs that is fixed at one end has h²ω² = c·k·h²·(w_a + w_b) in its slowest mode, with c = ½·(π/2n)², and more
    in all other modes. So k' is the smallest constant that counts all energy that any mode can release. It differs from
    k only if a spring is far too stiff for the substep; then e is what the iterations left unsolved.

    **Work** done between two frames, for example by moving a pin or changing a parameter, is known exactly: it is the
    change of the energy (`add_work`). Within a frame, growth of the energy counts as work up to a bound, the sum of the
    terms below. T_i is the sum of the magnitudes of the spring forces on particle i, the larger of its values before
    and after the frame, which lasts Δt.

    - Grab: Σ max(F·d, 0) over substeps, with the displacement d of the grabbed particles and the force F needed to hold
      them, before or after the substep, whichever gives more.
    - Attachments: Σ_i (T_i + m_i·g)·|d_i| over their particles, with the displacement d_i, plus max |d_i|·|Δp|/Δt, with
      the change Δp of the momentum of the cloth: a pull may start within the frame.
    - Wind: Σ_i p_i·|d_i|, with the full pressure p_i on the area of a particle, along its displacement d_i.
    - Moving collider: Σ_i s_i·(m_i·(|v_i| + |v_i'|)/Δt + T_i + m_i·g) over all particles that it may touch, with the
      displacement s_i of its surface: the momentum that it can have transferred, times its speed.
    - Collider that ejects particles, because it appeared around them: Σ_i u_i·(T_i + m_i·g) + ½·m_i·(2 m/s)², with the
      decrease u_i of the depth of a particle. The last term counts once per particle: particles may be ejected at 2 m/s
      at most.
    """

    def __init__(self, simulation: Simulation, worst: Extremes, far: float = 0.0) -> None:
        """`worst` is updated in every frame. `far` [m] is added to the reach, for cloth that its load moves farther.

        Raises ValueError if `far` is not finite.
        """
        if not np.isfinite(far):
            raise ValueError("far must be finite")
        self._simulation = simulation
        self._far = far
        cloth = simulation.scene.cloth
        self._side = max(cloth.width, cloth.height)
        self._slowest_mode = 0.5 * (np.pi / (2 * (max(cloth.rows, cloth.columns) - 1))) ** 2  # c of the class docstring
        self._read_scene()
        self.worst = worst

    def _read_scene(self) -> None:
        topology = self._simulation.topology
        self._total_mass = float(topology.mass.sum())
        self._inverse_mass = np.where(topology.pinned, 0.0, 1 / topology.mass)
        self.read_springs()
        self._colliders = self._simulation.colliders()
        self._moving = [not is_static(posed.collider) for posed in self._colliders]
        owners = attachment_ids(self._simulation.scene, topology)
        self._attached = owners >= 0
        self._attachments = [
            (one, owners[topology.pinned] == k, topology.start[owners == k])
            for k, one in enumerate(self._simulation.scene.attachments)
        ]

    def read_scene(self) -> None:
        """Read masses, springs and colliders after a change of the scene. Colliders may eject what they enclose now."""
        self._read_scene()
        self._ejected[:] = False

    def read_springs(self) -> None:
        """Read the springs of the simulation after a change of the solver, or after the cloth tore."""
        simulation, topology = self._simulation, self._simulation.topology
        self._springs_topology = topology
        self._ends = np.ascontiguousarray(topology.ends.T)
        self._bending_ends = np.ascontiguousarray(topology.bending_links.ends.T)
        self._rest = topology.rest
        self._structural = topology.family("structural") if topology.spring_count else np.zeros(0, np.int64)
        self._stiffness = spring_stiffness(simulation.scene, "fabric", topology)
        self._compression = simulation.scene.fabric.compression
        self._constants_key: object = None

    def begin(self) -> None:
        """Start checking from the current state. Pins must keep their current positions."""
        x, v = self._read()
        self._center = x.mean(axis=0)
        self._pins = x[self._simulation.topology.pinned].astype(np.float32)
        self._support_radius = float(np.linalg.norm(x - self._center, axis=1).max())
        self._seconds = self._grab_work = 0.0
        self._allowed = self._last = self.energy(x, v)
        self._available = self._kinetic + self._elastic
        self._x, self._v = x, v
        self._ejecting, self._ejected = False, np.zeros(len(x), bool)
        self._meet_colliders(x)

    def add_work(self, joules: float) -> None:
        """Count work done on the cloth [J]; negative if energy was removed. The last energy changes by as much."""
        self._allowed += joules
        self._available += max(joules, 0.0)
        self._last += joules

    def set_pin_positions(self, positions: Floats) -> None:
        """Set the positions that pins must keep from now on [m]."""
        self._pins = positions.astype(np.float32)
        self.extend_reach(positions)

    def _move_attached_pins(self) -> None:
        """Set the positions of attached pins from the poses of their attachments now, which kernels round."""
        self._pin_rounding = np.zeros(len(self._pins))
        for attachment, pins, start in self._attachments:
            (center, axes), (now, axes_now) = (pose(attachment, at) for at in (0.0, self._simulation.seconds))
            positions = now + (start - center) @ axes @ axes_now.T
            self._pin_rounding[pins] = 4 * ROUNDING * np.abs(positions).max()
            self._pins[pins] = positions
            self.extend_reach(positions)

    def extend_reach(self, positions: Floats) -> None:
        """Extend the reach to positions of something that supports the cloth [m]."""
        self._support_radius = max(self._support_radius, float(np.linalg.norm(positions - self._center, axis=1).max()))

    def energy(self, x: Floats, v: Floats) -> float:
        """Return the energy at these positions and velocities [J], and store spring lengths and parts of the sum."""
        simulation = self._simulation
        topology = simulation.topology
        if topology is not self._springs_topology:
            self.read_springs()  # it tore
        if len(simulation.grabbed):
            v = v.copy()
            v[simulation.grabbed] = 0.0  # grabbed particles have prescribed motion and no kinetic energy
        self._kinetic, height = energies(topology, x, v, float(simulation.params["gravity"]))
        gap = np.take(x, self._ends[1], 0) - np.take(x, self._ends[0], 0)
        self._lengths = np.sqrt(np.einsum("ij,ij->i", gap, gap))
        bent = np.take(x, self._bending_ends[1], 0) - np.take(x, self._bending_ends[0], 0)
        errors = self._lengths - self._rest
        constants = self._constants() * np.where(errors < 0, self._compression, 1.0)
        self._elastic = 0.5 * float(constants @ errors**2)
        self._elastic += 0.5 * float(topology.bending_links.stiffness @ np.einsum("ij,ij->i", bent, bent))
        near = float(np.abs(x - simulation.origin).max(initial=0.0))
        self._rounding = 2 * float(constants.sum()) * (ROUNDING * near) ** 2
        return self._kinetic + height + self._elastic

    def _constants(self) -> Floats:
        """Return the effective constant k' of every spring [N/m]."""
        simulation = self._simulation
        key = simulation.substeps, simulation.params["stiffness"]
        if key != self._constants_key:
            k = self._stiffness * float(key[1])
            if not isinstance(simulation.solver, ExplicitSolver):
                h = FRAME_SECONDS / key[0]
                both = self._inverse_mass[self._ends[0]] + self._inverse_mass[self._ends[1]]
                k = k / (1 + self._slowest_mode * k * h * h * both)
            self._constants_key, self._effective = key, k
        return self._effective

    def check_frame(self) -> None:
        """Check the frame that has just run. Raises Violation."""
        simulation, topology, worst = self._simulation, self._simulation.topology, self.worst
        x, v = self._read()
        self._seconds += FRAME_SECONDS
        for what, values in (("positions", x), ("velocities", v)):
            if not (finite := np.isfinite(values)).all():
                raise Violation(f"particles whose {what} are not finite", int((~finite).any(axis=1).sum()), 0)
        self._move_attached_pins()
        moved = np.abs(np.float32(x[topology.pinned]) - self._pins).max(axis=1, initial=0.0)
        if (moved > self._pin_rounding).any():
            raise Violation("a pin moved [m]", float(moved.max()), float(self._pin_rounding.max()))

        energy = self.energy(x, v)
        growth = energy - self._last
        if growth > 0:
            self.add_work(min(growth, self._work_bound(x, v)))
        self._last, self._x, self._v, self._grab_work = energy, x, v, 0.0
        self._meet_colliders(x)

        gravity = abs(float(simulation.params["gravity"]))
        scale = self._available + self._total_mass * gravity * REACH_SIDES * self._side
        over = energy - self._allowed - self._rounding
        worst.energy = max(worst.energy, over / scale if scale > 0 else 0.0)
        free = self._free()
        self.speed = float(np.sqrt(np.einsum("ij,ij->i", v, v)[free].max(initial=0.0)))
        worst.speed = max(worst.speed, self.speed)
        structural = self._structural
        self.strain = float((self._lengths[structural] / self._rest[structural] - 1).max(initial=0.0))
        worst.strain = max(worst.strain, self.strain)
        if over > ENERGY_SLACK * scale:
            raise Violation("energy above all that was given [J]", over, ENERGY_SLACK * scale)
        flight = 0.0
        if not topology.pinned.any() or (simulation.scene.tearing is not None and simulation.torn.any()):
            flight = self._seconds * np.sqrt(2 * self._available / self._total_mass) + gravity * self._seconds**2 / 2
        limit = self._support_radius + REACH_SIDES * self._side + self._far + flight
        away = float(np.linalg.norm(x - self._center, axis=1).max())
        if away > limit:
            raise Violation("a particle is away from all that holds it [m]", away, limit)

    # -- work within a frame -------------------------------------------------------------------------------------------

    def _work_bound(self, x: Floats, v: Floats) -> float:
        """Return the bound on the work done in the frame that ends in this state [J]."""
        work = self._grab_work + self.wind_work(x, v)
        if any(self._moving) or self._ejecting or self._attached.any():
            load = self._load(x, v)
            displacement = np.linalg.norm(x - self._x, axis=1)
            work += self._attachment_work(v, load, displacement)
            work += self._collider_work(x, v, load, displacement)
        return work

    def begin_grab_work(self) -> None:
        """Start to sum the work of grabs in the next frame. Call `add_grab_work` after each substep."""
        self._grab_positions, self._grab_forces = self._grab_state()

    def add_grab_work(self) -> None:
        """Add the work of grabs in the last substep."""
        positions, force = self._grab_state()
        displacement = positions - self._grab_positions
        before, after = (np.einsum("ij,ij->i", f, displacement) for f in (self._grab_forces, force))
        self._grab_work += float(np.maximum(np.maximum(before, after), 0.0).sum())
        self._grab_positions, self._grab_forces = positions, force

    def _grab_state(self) -> tuple[Floats, Floats]:
        """Return the positions of grabbed particles [m], and the forces needed to hold them there [N]."""
        simulation = self._simulation
        x, grabbed = simulation.positions(), simulation.grabbed
        self.energy(x, np.zeros_like(x))  # stores the spring lengths
        force = -self._forces(x)
        force[:, 1] += simulation.topology.mass * float(simulation.params["gravity"])
        return x[grabbed], force[grabbed]

    def _pair_forces(self, x: Floats) -> tuple[Floats, Floats]:
        """Return the tension of each spring and the force of each bending link (B, 3) [N]. Uses the stored lengths."""
        errors = self._lengths - self._rest
        tensions: Floats = self._constants() * np.where(errors < 0, self._compression, 1.0) * errors
        links = self._simulation.topology.bending_links
        bent = np.take(x, self._bending_ends[1], 0) - np.take(x, self._bending_ends[0], 0)
        return tensions, links.stiffness[:, None] * bent

    def _forces(self, x: Floats) -> Floats:
        """Return the force of springs and bending on every particle [N], (N, 3). Uses the stored lengths."""
        tensions, bending = self._pair_forces(x)
        gap = np.take(x, self._ends[1], 0) - np.take(x, self._ends[0], 0)
        along = gap * (tensions / np.maximum(self._lengths, 1e-12))[:, None]
        force = np.zeros_like(x)
        for ends, pair in ((self._ends, along), (self._bending_ends, bending)):
            for k in range(3):
                force[:, k] += np.bincount(ends[0], pair[:, k], len(x)) - np.bincount(ends[1], pair[:, k], len(x))
        return force

    def _tensions(self, x: Floats) -> Floats:
        """Return T_i, the sum of the magnitudes of spring and bending forces on every particle [N], (N,)."""
        tensions, bending = self._pair_forces(x)
        total = np.zeros(len(x))
        for ends, size in ((self._ends, np.abs(tensions)), (self._bending_ends, np.linalg.norm(bending, axis=1))):
            total += np.bincount(ends[0], size, len(x)) + np.bincount(ends[1], size, len(x))
        return total

    def wind_work(self, x: Floats, v: Floats) -> float:
        """Return the bound on the work of wind [J]: full pressure on every particle's area, along its displacement."""
        simulation, wind = self._simulation, self._simulation.scene.wind
        if wind is None or not simulation.params["wind"]:
            return 0.0
        air = float(np.hypot(simulation.params["wind_x"], simulation.params["wind_z"])) * (1 + wind.turbulence)
        if air == 0:
            return 0.0
        area = simulation.topology.mass / simulation.scene.cloth.area_density
        fastest = np.maximum(*(np.einsum("ij,ij->i", u, u) for u in (self._v, v)))
        force = wind.air_density / 2 * max(wind.drag, wind.lift) * area * (air + np.sqrt(fastest)) ** 2
        return float(force @ np.linalg.norm(x - self._x, axis=1))

    def _attachment_work(self, v: Floats, load: Floats, displacement: Floats) -> float:
        """Return the bound on the work of attachments [J], as in the class docstring."""
        attached = self._attached
        impulse = np.linalg.norm(np.where(self._free(), self._simulation.topology.mass, 0.0) @ (v - self._v))
        hit = float(impulse) / FRAME_SECONDS
        return float((load * displacement)[attached].sum()) + hit * float(displacement[attached].max(initial=0.0))

    def _load(self, x: Floats, v: Floats) -> Floats:
        """Return T_i + m_i·g of every particle [N], (N,), as in the class docstring."""
        after = self._tensions(x)
        self.energy(self._x, self._v)
        tension: Floats = np.maximum(after, self._tensions(self._x))
        self.energy(x, v)
        return tension + self._simulation.topology.mass * abs(float(self._simulation.params["gravity"]))

    def _collider_work(self, x: Floats, v: Floats, load: Floats, displacement: Floats) -> float:
        """Return the bound on the work of colliders that move or eject particles [J], as in the class docstring."""
        topology, simulation = self._simulation.topology, self._simulation
        hit = topology.mass * (np.linalg.norm(self._v, axis=1) + np.linalg.norm(v, axis=1)) / FRAME_SECONDS
        free = self._free()
        work = 0.0
        for before, now, moving in zip(self._colliders, simulation.colliders(), self._moving, strict=True):
            if moving and teleports(now.collider, simulation.seconds - FRAME_SECONDS, simulation.seconds):
                before, moving, self._ejecting = now, False, True  # it appeared at its new pose
                self._ejected[:] = False
            deep, deep_now = (
                posed.collider.margin - signed_distance(posed, p) for posed, p in ((before, self._x), (now, x))
            )
            if moving:
                surface = self._surface_displacement(before, now, x)
                near = free & (np.maximum(deep, deep_now) > -(surface + displacement + NEAR))
                work += float((surface * (hit + load))[near].sum())
            if self._ejecting:
                inside = free & (deep > EJECTION_END)
                work += float((np.maximum(deep - deep_now, 0.0) * load)[inside].sum())
                work += EJECTED**2 / 2 * float(topology.mass[inside & ~self._ejected].sum())
                self._ejected |= inside
        return work

    def _surface_displacement(self, before: PosedCollider, now: PosedCollider, x: Floats) -> Floats:
        """Return a bound on the displacement of a collider's surface at each particle in the frame [m], (N,)."""
        angle = float(np.linalg.norm(rotation_vector_between(before.axes, now.axes)))
        arms = (np.linalg.norm(p - posed.center, axis=1) for posed, p in ((before, self._x), (now, x)))
        bound: Floats = float(np.linalg.norm(now.center - before.center)) + angle * np.maximum(*arms)
        return bound

    # -- colliders -----------------------------------------------------------------------------------------------------

    def read_colliders(self) -> None:
        """Read the colliders after a change between frames. One that changed size may eject what it encloses now."""
        known = self._colliders
        self._meet_colliders(self._simulation.positions())
        if any(not np.array_equal(a.size, b.size) for a, b in zip(known, self._colliders, strict=True)):
            self._ejected[:] = False

    def _meet_colliders(self, x: Floats) -> None:
        """Update colliders, penetration, whether they eject particles, and the reach of cloth that they support."""
        if any(self._moving) or self._simulation.scene.spheres:  # a runtime parameter sets the radius of a sphere
            self._colliders = self._simulation.colliders()
        if not self._colliders:
            return
        points = x[self._free()]
        deepest = -np.inf
        for posed in self._colliders:
            distance = float(signed_distance(posed, points).min(initial=np.inf))
            self.worst.penetration = max(self.worst.penetration, -distance)
            deepest = max(deepest, posed.collider.margin - distance)
            if not isinstance(posed.collider, (Ground, Plane)) and distance - posed.collider.margin < 0.1:
                farthest = float(np.linalg.norm(posed.center - self._center) + np.linalg.norm(posed.size))
                self._support_radius = max(self._support_radius, farthest)
        # A collider that ejects particles does so until all of them are out.
        self._ejecting = deepest > (EJECTION_END if self._ejecting else EJECTION_START)

    def _free(self) -> NDArray[np.bool_]:
        """Return a mask of the particles that are neither pinned nor grabbed, (N,)."""
        free = ~self._simulation.topology.pinned
        if len(self._simulation.grabbed):
            free[self._simulation.grabbed] = False
        return free

    def _read(self) -> tuple[Floats, Floats]:
        return self._simulation.positions(), self._simulation.velocities()
