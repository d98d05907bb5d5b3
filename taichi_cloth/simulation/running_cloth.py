"""The moving cloth of a simulation: building it for a scene, stepping, rebuilding while it moves, forces, tearing."""

from __future__ import annotations

import weakref
from collections.abc import Callable, Mapping
from typing import SupportsIndex

import numpy as np
from numpy.typing import NDArray

from .. import state
from ..collision.colliders import colliders_of, in_first_pose, pose
from ..collision.response import Depenetration
from ..geometry.cloth_builder import attachment_ids, spring_stiffness
from ..geometry.spring_model import spring_model, wind_of
from ..geometry.tearing import TearState
from ..geometry.topology import origin_shift, spring_strains
from ..kernels.integration import any_longer_than
from ..scene import Scene, parameters_of
from ..scene.collider_schema import Collider, Ground
from ..scene.schema import FRAME_SECONDS
from ..solvers import FrameInput, Solver
from ..state.constraint_data import upload_grabbed
from ..state.field_pool import upload, upload_all
from ..system.errors import UsageError
from ..system.taichi_compat import ProgramRef
from ..system.taichi_runtime import check_thread
from .builder import StepRow, build, release_solver
from .frame_contact import Displacement, IntersectionGuard, expire_candidates, move_colliders, present_colliders
from .grabbing import Grab, all_grabbed
from .parameter_values import HasParameters, Parameters, check_frames, check_particle, with_values

Floats = NDArray[np.float64]

FOLLOW_FRAMES = 10  # between two looks whether the cloth has moved far from its origin


class RunningCloth(HasParameters):
    """A simulation without events: its changes do not reach listeners."""

    reduces_damping = True  # whether its solver may shorten the damping time of springs
    origin: Floats  # what positions in the fields are relative to [m], (3,): it follows a cloth that moves far away

    def __init__(self, scene: Scene, layout: str | None, on_set: Callable[[str, float | bool], None]) -> None:
        """`scene` is checked; `on_set` is called when a runtime parameter is to be set."""
        check_thread()
        self.requested_layout, self.original_scene = layout, scene
        self._params = Parameters(on_set)
        self.grabs: dict[int, Grab] = {}
        self.displacements: dict[int, Displacement] = {}  # of colliders, by their row
        self._frame, self._is_within_frame = 0, False
        self.frames_stepped = 0  # since the simulation was opened; a reset does not change it
        self._tear: TearState | None = None
        self._build(scene, None)

    def _build(self, scene: Scene, pin_changes: NDArray[np.bool_] | None, **values: float) -> None:
        """Build cloth and solver of a scene at its start. `values`: of runtime parameters."""
        solver, built = build(scene, self.requested_layout, pin_changes, reduces_damping=self.reduces_damping)
        self.params.replace_known(parameters_of(scene), **values)
        self._scene, self.topology, self.built = scene, built.topology, built
        self._inverse_mass, self.origin = state.inverse_mass(built.topology), built.topology.origin
        self._solver: Solver | None = solver
        self._program, self._row = ProgramRef(), StepRow(scene, built.topology, built.damping_time)
        self.depenetration = Depenetration(count := len(colliders_of(scene)))
        self.displacements = {row: one for row, one in self.displacements.items() if row < count}
        self.has_self_contact = False
        self._guard = IntersectionGuard(solver, built.topology) if solver.features.penetration_free else None
        self.find_pairs()
        torn = () if self._tear is None else (self._tear.ends,)
        self._tear = TearState(built.topology, *torn) if scene.tearing is not None else None
        self._rebuild_topology()
        # Releases the fields once: on close(), or when nothing refers to the cloth any more.
        self._release = weakref.finalize(self, release_solver, solver)
        self._release.atexit = False  # Taichi may be gone by then

    def rebuild(self, scene: Scene, pin_changes: NDArray[np.bool_], **values: float) -> None:
        """Continue with another scene of the same sheet. Raises UsageError, and changes nothing, if it cannot."""
        x, v, params, tear = self.positions(), self.velocities(), self.params.values_by_name, self._tear
        before = self.scene, self.built.pin_changes
        try:
            self._build_at(x, v, scene, pin_changes, **values)
        except BaseException:  # also Ctrl-C: what was released belongs to the next simulation
            try:
                self._tear = tear
                self.params.replace_known(parameters_of(before[0]), **params)
                self._build_at(x, v, *before)
            except BaseException:
                self.close()
                raise
            raise

    def _build_at(self, x: Floats, v: Floats, scene: Scene, pins: NDArray[np.bool_], **values: float) -> None:
        """Release the cloth, and build one at these positions [m] and velocities [m/s], (N, 3). Others as `_build`."""
        self._release()
        self._build(scene, pins, **values)
        self.place(x)
        self.solver.set_velocities(np.where(self.topology.pinned[:, None], 0.0, v), self.h)

    def close(self) -> None:
        """Release the fields for the next simulation. Closing twice does no harm."""
        self._release()
        self._solver = None

    @property
    def closed(self) -> bool:
        """Whether it was closed, or Taichi was stopped or restarted."""
        return self._solver is None or not self._program.runs()

    def __repr__(self) -> str:
        state = "closed" if self.closed else f"frame {self.frame}, {self.topology.particle_count} particles"
        return f"<Simulation {self.scene.name!r}: {state}>"

    def _check_usable(self) -> Solver:
        check_thread()
        if self._solver is None:
            raise RuntimeError("this simulation is closed")
        if not self._program.runs():
            raise RuntimeError("Taichi was stopped or restarted, which ends every simulation: open a new one")
        return self._solver

    @property
    def solver(self) -> Solver:
        """The running solver. Raises RuntimeError once the simulation is closed, or Taichi has ended.

        Raises UsageError in another thread than the one that started Taichi, and in a forked process.
        """
        return self._check_usable()

    @property
    def cloth(self) -> state.ClothState:
        """The fields of the cloth. Raises RuntimeError once the simulation is closed."""
        return self.solver.cloth

    @property
    def scene(self) -> Scene:
        """The scene that runs: the last one switched to, with the solver and fabric switched to."""
        return self._scene

    # -- stepping ------------------------------------------------------------------------------------------------------

    @property
    def frame(self) -> int:
        """Number of the frame: those stepped since the start, or since the last reset."""
        return self._frame

    def set_frame(self, number: int) -> None:
        """Set the number of the frame, and with it the time that wind and colliders follow. The cloth stays."""
        self._frame = number

    @property
    def seconds(self) -> float:
        """Simulated time [s]."""
        return self.frame * FRAME_SECONDS

    @property
    def substeps(self) -> int:
        """Substeps of a frame: the requested number, or more if the solver needs them to be stable."""
        return max(int(self.params["substeps"]), self.built.min_stable_substeps)

    @property
    def h(self) -> float:
        """Length of a substep [s]."""
        return FRAME_SECONDS / self.substeps

    def step(self, frames: SupportsIndex = 1) -> None:
        """Advance by frames of 1/60 s. Raises ValueError for a number that is not an integer from 0."""
        self.check_between_frames()
        for _ in range(check_frames(frames)):
            self.solver.step(self._frame_input())
            self._end_frame()

    def step_by_substep(self, callback: Callable[[float], object]) -> None:
        """Advance by one frame, bit-equal to `step`, with `callback(fraction of the frame)` after each substep.

        It may only read: a change, step or checkpoint raises UsageError. If it raises, the frame ends without it.
        """
        self.check_between_frames()
        parts = self._frame_input().by_substep()
        self._is_within_frame = True
        try:
            for part in parts:
                self.solver.step(part)
                callback(part.last / part.substeps)
        finally:
            self._is_within_frame = False
            for part in parts:
                self.solver.step(part)
            self._end_frame()

    def check_between_frames(self) -> None:
        if self._is_within_frame:
            raise UsageError("a callback of step_by_substep may only read: change, step and save between two frames")

    def _frame_input(self) -> FrameInput:
        start, end = self.seconds, self.seconds + FRAME_SECONDS
        if self._guard is not None:
            self._guard.begin_frame(self.frame)
        values, wind_on, h = self.params.values_by_name, self.params.wind_on, self.h
        params = self._row.at(values, wind_on=wind_on, grabs=self.grabs, origin=self.origin, seconds=start, h=h)
        return FrameInput(
            substeps=self.substeps,
            iterations=int(values["iterations"]),
            h=h,
            grabbed_count=sum(len(grab.particles) for grab in self.grabs.values()),
            params=params,
            colliders=move_colliders(self, start, end),
        )

    def _end_frame(self) -> None:
        for grab in self.grabs.values():
            grab.end_frame()
        self.displacements = {row: Displacement(one.end, one.end) for row, one in self.displacements.items()}
        self._frame += 1
        self.frames_stepped += 1
        if self._tear is not None:
            self._tear_overstretched(self._tear)
        if self._frame % FOLLOW_FRAMES == 0 and self.topology.max_distance is None:
            self._follow_cloth()

    def _follow_cloth(self) -> None:
        """Move the origin if the cloth is far from it. The cloth does not move by a bit."""
        x = self.cloth.to_numpy(self.cloth.x)
        if (shift := origin_shift(x)).any():
            self.set_origin(self.origin + shift)
            upload_all((self.cloth.x, x - shift), (self.cloth.x_prev, self.cloth.to_numpy(self.cloth.x_prev) - shift))
            self.set_grabs(self.grabs)
            self.find_pairs(moved=False)

    def set_origin(self, origin: Floats) -> None:
        """Set what positions in the fields are relative to [m], (3,), which does not change the fields."""
        self.origin = origin
        self.cloth.origin[None] = origin

    def scene_colliders(self) -> list[Collider | Ground]:
        return present_colliders(self)

    # -- state ---------------------------------------------------------------------------------------------------------

    def positions(self) -> NDArray[np.float64]:
        """Return the position of every particle [m], (N, 3)."""
        return self.cloth.to_numpy(self.cloth.x).astype(np.float64) + self.origin

    def velocities(self) -> NDArray[np.float64]:
        """Return the velocity of every particle [m/s], (N, 3)."""
        return self.solver.velocities(self.h)

    def free_positions(self) -> Floats:
        """Return the positions of the particles that are not pinned [m], (M, 3)."""
        return self.positions()[~self.topology.pinned]

    def place(self, x: Floats) -> None:
        """Set all positions [m], (N, 3), at rest; grabbed particles stay grabbed."""
        start = self.topology.origin
        self.set_origin(start + origin_shift(x - start) if self.topology.max_distance is None else start)
        upload_all(*((field, x - self.origin) for field in (self.cloth.x, self.cloth.x_prev)))
        self.find_pairs()
        self.set_grabs(self.grabs)

    def find_pairs(self, *, moved: bool = True) -> None:
        """Let self-collision find its pairs anew. `moved`: to where the cloth may intersect itself."""
        expire_candidates(self.solver.layout)
        if self._guard is not None:
            self._guard.restart(self.frame, moved=moved)

    @property
    def penetration_free_since(self) -> int | None:
        """First frame from which no part of the cloth passes through another; None if that is not guaranteed."""
        return None if self._guard is None else self._guard.clean_since

    @property
    def is_held_still(self) -> bool:
        """Whether penetration-free contact lets nothing move, because more pairs are near than it can list."""
        data = self.solver.layout.pair_data
        return self._guard is not None and data is not None and bool(data.pairs.overflowed[None])

    @property
    def grabbed(self) -> NDArray[np.int64]:
        """Indices of all grabbed particles, (M,)."""
        return all_grabbed(self.grabs)[0]

    def set_grabs(self, grabs: Mapping[int, Grab]) -> None:
        """Replace all grabs: grabbed particles have no inverse mass, all others their own."""
        self.grabs = dict(grabs)
        inverse_mass = self._inverse_mass.copy()
        if grabs:
            particles, rest, numbers = all_grabbed(grabs)
            inverse_mass[particles] = 0.0
            upload_grabbed(self.solver.layout, self.topology, particles, rest - self.origin, numbers)
        upload(self.cloth.inverse_mass, inverse_mass)

    def set_pins(self, pinned: NDArray[np.bool_]) -> None:
        """Set which particles are pinned, (N,), and rebuild what depends on it."""
        if (changes := self.topology.pinned ^ pinned).any():
            self.rebuild(self.scene, self.built.pin_changes ^ changes)

    @property
    def added_pins(self) -> NDArray[np.int64]:
        """Indices of the particles that are pinned in addition to those of the scene."""
        return np.flatnonzero(self.built.pin_changes & self.topology.pinned)

    def check_particle(self, particle: SupportsIndex) -> int:
        """Return a particle's index. Raises ValueError if there is none."""
        return check_particle(particle, self.topology.particle_count)

    # -- forces --------------------------------------------------------------------------------------------------------

    def forces(self) -> NDArray[np.float64]:
        """Return the force of springs, bending, gravity and wind on every particle [N], (N, 3), as the cloth is now.

        It is computed in float64 from positions and velocities, and does not depend on the solver. Not included are
        contact, self-collision, tethers, the strain limit, max distances and `damping`. Raises UsageError for `verlet`.
        """
        scene = self._scene_with_units()
        model, x, v = spring_model(scene, self.topology), self.positions().T, self.velocities().T
        force = model.elastic_force(x) + model.weight()
        if self.solver.features.spring_damping:
            force += model.damping_force(x, v)
        if (wind := wind_of(scene, model)) is not None:
            force += wind.force(x, v, self.seconds)
        return np.ascontiguousarray(force.T)

    def elastic_energy(self) -> float:
        """Return the energy of springs, or of a membrane or weave, and of bending [J], from whose forces `forces` is.

        With the energies of `metrics` it is the total energy. Raises UsageError for `verlet`.
        """
        return spring_model(self._scene_with_units(), self.topology).elastic_energy(self.positions().T)

    def _scene_with_units(self) -> Scene:
        """Return the scene with the present values of its parameters. Raises UsageError for `verlet`."""
        if self.solver.info.stiffness_section == "verlet":
            raise UsageError(
                f"{self.solver.name} has stiffnesses without unit, and so no forces and no energy: use another solver"
            )
        return with_values(self.scene, self.params, self.built.damping_time)

    def reaction_forces(self) -> NDArray[np.float64]:
        """Return the force that holds each particle [N], (N, 3): that of its pin, attachment or grab; 0 if it is free.

        It is mass times acceleration over the last two frames, minus `forces`, as of now: while a grab or an attachment
        accelerates, take the mean over the substeps (`step_by_substep`). What holds a particle against contact,
        self-collision, tethers, the strain limit and max distances is not included. Forces are wrong if the iterations
        of the solver have not converged: those on a cloth at rest then do not add up to its weight. Raises UsageError
        for `verlet`.
        """
        forces = self._prescribed_acceleration() * self.topology.mass[:, None] - self.forces()
        held = self.topology.pinned.copy()
        held[self.grabbed] = True
        return np.where(held[:, None], forces, 0.0)

    def _prescribed_acceleration(self) -> Floats:
        """Return the acceleration of held particles over the last two frames [m/s²], (N, 3); 0 for pins at rest."""
        acceleration = np.zeros_like(self.topology.start)
        owner = attachment_ids(self.scene, self.topology)
        for k, attachment in enumerate(self.scene.attachments):
            local = in_first_pose(attachment, self.topology.start[owner == k])
            poses = [pose(attachment, max(self.seconds - n * FRAME_SECONDS, 0.0)) for n in range(3)]
            now, last, before = (center + local @ axes.T for center, axes in poses)
            acceleration[owner == k] = (now - 2 * last + before) / FRAME_SECONDS**2
        for grab in self.grabs.values():
            acceleration[grab.particles] = grab.acceleration()
        return acceleration

    # -- tearing -------------------------------------------------------------------------------------------------------

    @property
    def torn(self) -> NDArray[np.bool_]:
        """Which springs of the untorn cloth tore, (E,), without bend springs that went with them; empty if none can."""
        return np.zeros(0, bool) if self._tear is None else self._tear.torn.copy()

    def set_torn(self, torn: NDArray[np.bool_] | bool) -> None:
        """Set which springs are torn, as the property has them, or all."""
        if self._tear is not None:
            self._tear.torn[:] = torn
            self._rebuild_topology()

    def _tear_overstretched(self, tear: TearState) -> None:
        counts, limit = self.topology.family_counts, float(self.params["tearing_strain"])
        tearable = counts.get("structural", 0) + counts.get("shear", 0)  # they come first
        if any_longer_than(self.cloth, tearable, limit):
            tear.tear_overstretched(spring_strains(tear.untorn, self.positions()), limit)
            self._rebuild_topology()

    def _rebuild_topology(self) -> None:
        """Continue with the springs and triangles that are not torn."""
        remaining = self.topology if self._tear is None else self._tear.remaining()
        if remaining is not self.topology:
            self.topology, self.has_self_contact = remaining, False
            stiffness = spring_stiffness(self.scene, self.solver.info.stiffness_section, remaining)
            self.solver.rebuild_topology(remaining, stiffness)
            if self._guard is not None:
                self._guard.change_topology(remaining)


def check_simulation(value: object) -> None:
    """Raise TypeError for anything that is not a simulation."""
    if not isinstance(value, RunningCloth):
        hint = ": use tc.Simulation(scene)" if isinstance(value, (Scene, str, dict)) else ""
        raise TypeError(f"a simulation is needed, not a {type(value).__name__}{hint}")
