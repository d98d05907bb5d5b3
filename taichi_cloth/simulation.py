"""A scene that runs: one cloth, one solver, the hand that holds it and the parameters a slider moves."""

from __future__ import annotations

import weakref
from dataclasses import replace
from math import exp, hypot
from os import PathLike
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from . import state
from .contact.bodies import (
    Body,
    bodies_at,
    body_table,
    colliders_of,
    counts_of,
    meets_triangles,
    penetration,
    pose,
    repulsion_frequency,
)
from .contact.crossings import crossings
from .contact.release import Release
from .errors import WrongUse
from .given import places, target_point
from .hand import Hand
from .kernels import controls as c
from .kernels.grab import set_inverse_mass
from .measure.cloth import Measures, energies, spring_strains
from .mesh.from_scene import holder_of, stiffness_of, topology_of
from .mesh.solid import distances_of
from .save_file import read_save, write_save
from .scene import Scene, check_scene, live_keys, scene_to_toml
from .scene.errors import shown
from .scene.live import check_live
from .scene.model import (
    COLLIDERS,
    FRAME_SECONDS,
    PROJECTION,
    REFLECTION,
    REPULSION,
    USUAL,
    Collider,
    Ground,
)
from .solvers import SOLVERS, FrameInput, Solver, Stages, path_for
from .state import distances
from .state.fields import put
from .state.grips import grip
from .state.near import come_near

Floats = NDArray[np.float64]

MOST_SUBSTEPS = 200_000  # of a frame, which takes seconds then on a thousand particles


def _give_back(solver: Solver) -> None:
    solver.close()
    state.give_back(solver.cloth)


class Simulation:
    """One running scene. Needs Taichi to be started (`taichi_cloth.start()`).

    `advance_frame()` moves it by 1/60 s. Positions are in metres, y up; particles are numbered row by row
    from the top-left corner of the sheet, those of a mesh file as it has them. Close it, or use it in a `with` block,
    when it is done with.
    """

    def __init__(self, scene: Scene, path: str | None = None) -> None:
        """`path` forces the layout that is worked on (`Solver.paths`); else the grid's size decides.

        Raises SceneError for a scene that no file may hold, and WrongUse for a path that its solver does not have and
        for springs that would take too many substeps.
        """
        scene = check_scene(scene)
        self._path = path
        colliders = colliders_of(scene)
        projecting: dict[str, Any] = dict(zip(COLLIDERS, counts_of(colliders, PROJECTION), strict=True))
        self._stages = Stages(
            wind=scene.wind is not None,
            **projecting,
            reflecting=counts_of(colliders, REFLECTION),
            repelling=counts_of(colliders, REPULSION),
            distances=distances.take([distances_of(mesh) for mesh in scene.meshes]),
            triangles=any(meets_triangles(collider) for collider in colliders),
            swept=any(collider.swept for collider in colliders),
            spring_damping=scene.fabric.damping_time > 0,
            strain_limit=0 if scene.limit is None else scene.limit.sweeps,
            tethers=scene.tethers is not None,
            grips=bool(scene.grips),
            self_collision=scene.self_collision is not None,
            self_triangles=scene.self_collision is not None and scene.self_collision.contacts == "triangles",
        )
        self._give_back_distances = weakref.finalize(self, distances.give_back, self._stages.distances)
        self._give_back_distances.atexit = False
        self._keys = live_keys(scene)
        self._live = {name: key.value for name, key in self._keys.items()}
        self._wind_on = True
        self._gust_phase = np.random.default_rng(scene.seed).random(3)  # [turns]
        self._own = scene.solver
        self._open(scene)
        self._inverse_mass = state.inverse_mass(self.topology)
        self._hand: Hand | None = None
        self._letting_out = Release(self._stages.bodies)
        self.frame = 0

    def _open(self, scene: Scene) -> None:
        """Makes the cloth and the solver of a scene, at the start."""
        kind = SOLVERS[scene.solver.name]
        topology = topology_of(scene, kind.springs)
        path = path_for(
            kind,
            topology.shape,
            self._path,
            sheets=topology.sheets,
            triangles=self._stages.triangles,
            mapped=scene.maps is not None and bool(scene.maps.stiffness),
            colours=len(topology.batches),
        )
        stiffness = stiffness_of(scene, kind.springs, topology)
        cloth = state.take(topology)
        cloth.upload(topology, stiffness)
        solver = kind(cloth, topology, stiffness, self._stages, path)
        if scene.grips:
            centers = np.array([pose(one, 0.0)[0] for one in scene.grips])
            grip(solver.work, topology, holder_of(scene, topology), centers)
        repelled = repulsion_frequency(colliders_of(scene), scene.cloth.area_density)
        solver.frequency = hypot(solver.frequency, repelled)
        damping_time = solver.damping_time(scene.fabric.damping_time)
        least = solver.least_substeps(damping_time)
        if least > MOST_SUBSTEPS:
            _give_back(solver)
            raise WrongUse(
                f"{scene.name}: {kind.name} would take {least:,} substeps a frame, more than {MOST_SUBSTEPS:,}: its "
                "springs or its bending are too stiff for particles so light, or its cells too narrow"
            )
        self.scene, self.topology = scene, topology
        self._solver: Solver | None = solver
        self._damping_time, self._least_substeps = damping_time, least
        self._near = False  # whether crossings were asked for
        # Gives the fields back once, on close() or when nobody refers to the simulation any more.
        self._give_back = weakref.finalize(self, _give_back, self._solver)
        self._give_back.atexit = False  # Taichi may be gone by then

    # -- running ---------------------------------------------------------------------------------------

    def advance_frame(self) -> None:
        """Moves the cloth, the spheres and the hand by one frame of 1/60 s."""
        self.solver.advance_frame(self._input())
        if self._hand is not None:
            self._hand.end_frame()
        self.frame += 1

    def reset(self) -> None:
        """Back to the first frame, bit for bit; parameters that were set keep their values."""
        self._put(self.topology.start, self._inverse_mass)
        self.solver.set_velocities(np.zeros_like(self.topology.start), self._substep)
        self._hand = None
        self._letting_out.ask()
        self.frame = 0

    def place(self, positions: ArrayLike, velocities: ArrayLike = (0.0, 0.0, 0.0)) -> None:
        """Puts every particle at its place [m], shape (N, 3), with a velocity [m/s], (N, 3) or one for all.

        A pin stays where it is put. Raises ValueError, and changes nothing, for another shape and for numbers that are
        not finite or beyond `given.FARTHEST`.
        """
        shape = self.topology.start.shape
        x = places(positions, "positions", shape)
        v = np.array(np.broadcast_to(places(velocities, "velocities", shape, (3,)), shape))
        v[self.topology.pinned] = 0.0
        self.release()
        self._put(x, self._inverse_mass)
        self.solver.set_velocities(v, self._substep)
        self._letting_out.ask()

    def close(self) -> None:
        """Gives the cloth's memory back for the next simulation. Closing twice does no harm."""
        self._give_back()
        self._give_back_distances()
        self._solver = None

    def __enter__(self) -> Simulation:
        return self

    def __exit__(self, *exception: object) -> None:
        self.close()

    # -- parameters ------------------------------------------------------------------------------------

    def get(self, name: str) -> float | bool:
        """Value of a live parameter, or of the switch `wind`. Raises ValueError for an unknown name."""
        if name == "wind":
            return self._wind_on
        return self._live[self._key(name)]

    def set(self, name: str, value: float | bool) -> None:
        """Changes a live parameter (`live_keys(scene)` lists them), or switches `wind` on or off.

        It takes effect with the next frame. Raises ValueError, and changes nothing, for an unknown name, for a
        value that is no number or out of range, and for a switch that is not True or False.
        """
        if name == "wind":
            if not isinstance(value, (bool, np.bool_)):
                raise ValueError(f"wind is switched by True and False, not {shown(value)}")
            self._wind_on = bool(value)
            return
        checked = check_live(self._keys[self._key(name)], value)
        before = self._substep
        if name == "sphere_radius" and checked > self._live[name]:
            self._letting_out.ask(0)
        self._live[name] = checked
        if self._substep != before:
            self.solver.change_substep(before, self._substep)

    def change_solver(self, name: str) -> None:
        """Goes on with another method, from the same places and velocities, with the springs of its own section.

        It takes its usual substeps and iterations; the scene's own method takes the scene's.

        Raises WrongUse, and changes nothing, for an unknown name and for one that would take too many substeps.
        """
        if name not in SOLVERS:
            raise WrongUse(f"{name!r} is not a solver: {', '.join(SOLVERS)}")
        x, velocities = self.positions(), self.velocities()
        own = self._own
        substeps, iterations = (own.substeps, own.iterations) if name == own.name else USUAL[name]
        before = self.scene
        self._give_back()
        try:
            self._open(replace(before, solver=replace(own, name=name, substeps=substeps, iterations=iterations)))
            self._live |= {"substeps": substeps, "iterations": iterations}
        except WrongUse:
            self._open(before)
            raise
        finally:
            self._put(x, self._inverse_masses())
            self.solver.set_velocities(velocities, self._substep)

    def _key(self, name: str) -> str:
        if name not in self._keys:
            raise ValueError(f"{name!r} is not a live parameter of {self.scene.name}: {', '.join(self._keys)}, wind")
        return name

    @property
    def _substep(self) -> float:
        """Length of a substep [s]."""
        return FRAME_SECONDS / self.substeps

    @property
    def least_substeps(self) -> int:
        """The fewest that the solver is stable with."""
        return self._least_substeps

    @property
    def substeps(self) -> int:
        """Substeps of a frame: those asked for, or those that the solver needs to be stable if they are more."""
        return max(int(self._live["substeps"]), self._least_substeps)

    # -- the hand --------------------------------------------------------------------------------------

    @property
    def grabbed(self) -> int | None:
        """Index of the held particle."""
        return None if self._hand is None else self._hand.particle

    def grab(self, index: int, target: ArrayLike) -> None:
        """Holds one particle and leads it to `target` (x, y, z) [m] within the next frame.

        Call it again with the same index to move the hand; another index lets go of the first particle.
        Raises ValueError for an index that is no particle and for a target not of three numbers up to `given.FARTHEST`.
        """
        point = target_point(target)
        if not isinstance(index, (int, np.integer)):
            raise ValueError(f"a particle is told by its index, not {shown(index)}")
        if not 0 <= index < self.topology.particle_count:
            raise ValueError(
                f"particle {index} does not exist: indices run from 0 to {self.topology.particle_count - 1}"
            )
        if self._hand is not None and self._hand.particle == index:
            self._hand.target = point
            return
        self.release()
        set_inverse_mass(self.cloth, index, 0.0)
        self._hand = Hand(index, self.positions()[index], point)

    def release(self) -> None:
        """Lets go: the particle has its mass again and the mean velocity of the hand's last frames."""
        hand, self._hand = self._hand, None
        if hand is None:
            return
        inverse_mass = float(self._inverse_mass[hand.particle])
        set_inverse_mass(self.cloth, hand.particle, inverse_mass)
        if inverse_mass > 0:
            self.solver.set_velocity(hand.particle, hand.velocity(), self._substep)

    def _inverse_masses(self) -> NDArray[np.float32]:
        """1/mass [1/kg] of every particle, (N,): 0 for pins and for the one that the hand holds."""
        masses = self._inverse_mass.copy()
        if self._hand is not None:
            masses[self._hand.particle] = 0.0
        return masses

    # -- reading ---------------------------------------------------------------------------------------

    @property
    def solver(self) -> Solver:
        """The method that runs. Raises RuntimeError once the simulation is closed."""
        if self._solver is None:
            raise RuntimeError("this simulation is closed")
        return self._solver

    @property
    def cloth(self) -> state.ClothState:
        """The fields of the cloth. Raises RuntimeError once the simulation is closed."""
        return self.solver.cloth

    @property
    def seconds(self) -> float:
        """Simulated time [s]."""
        return self.frame * FRAME_SECONDS

    @property
    def stages(self) -> tuple[str, ...]:
        """Names of what is switched on: spring families, limits, forces and colliders."""
        names = {
            "bending": "bending",
            "strain_limit": "limit",
            "tethers": "tethers",
            "grips": "grips",
            "wind": "wind",
            "self_collision": "self-collision",
            "swept": "swept",
            "triangles": "triangles",
        }
        on = (name for stage, name in names.items() if getattr(self.solver.stages, stage))
        colliders = dict.fromkeys(type(collider).__name__.lower() for collider in colliders_of(self.scene))
        return (*self.topology.family_counts, *on, *colliders)

    @property
    def method(self) -> str:
        """The solver with its substeps, iterations and path: `verlet 5×12 · lanes`."""
        iterations = f"×{self._live['iterations']}" if self.solver.iterates else ""
        return f"{self.solver.name} {self.substeps}{iterations} · {self.solver.path}"

    @property
    def advice(self) -> str:
        """One line where the solver takes other substeps or dashpots than asked for; else nothing."""
        words = []
        asked, name = int(self._live["substeps"]), self.solver.name
        if asked < self._least_substeps:
            words.append(f"{name} takes {self._least_substeps} substeps, not {asked}: fewer are unstable")
        wanted = self.scene.fabric.damping_time
        if self._damping_time < wanted:
            words.append(f"{name} shortens the dashpots' {1e3 * wanted:.3g} ms to {1e3 * self._damping_time:.3g} ms")
        return "; ".join(words)

    def positions(self) -> Floats:
        """Where every particle is [m], shape (N, 3)."""
        return self.cloth.taken(self.cloth.x).astype(np.float64) + self.topology.origin

    def velocities(self) -> Floats:
        """Velocity of every particle [m/s], shape (N, 3)."""
        return self.solver.velocities(self._substep)

    def bodies(self) -> list[Body]:
        """Every collider as it is now: spheres, capsules, boxes, planes, the ground, meshes."""
        return bodies_at(self._colliders(), self.seconds)

    def measure(self) -> Measures:
        """Strain, energy [J] and penetration [m] of the cloth as it is now."""
        x = self.positions()
        strains = spring_strains(self.topology, x)
        family = self.topology.family("structural")
        strains = strains[family] if len(family) else strains
        kinetic, potential = energies(self.topology, x, self.velocities(), self._live["gravity"])
        return Measures(
            max_strain=float(strains.max(initial=0.0)),
            mean_strain=float(np.abs(strains).mean()) if len(strains) else 0.0,
            kinetic_energy=kinetic,
            potential_energy=potential,
            penetration=penetration(self.bodies(), x),
            finite=bool(np.isfinite(x).all()),
            crossings=self.crossings() if self.scene.self_collision is not None else None,
        )

    def crossings(self) -> int:
        """How many edges of the cloth go through one of its triangles."""
        if not self._near:
            come_near(self.cloth, self.topology)
            self._near = True
        return int(crossings(self.cloth))

    # -- saving ----------------------------------------------------------------------------------------

    def save(self, path: str | PathLike[str]) -> None:
        """Writes all that moves to `path` (NumPy .npz). Raises OSError; a half-written file never stays."""
        write_save(path, scene_to_toml(self.scene), self._moving())

    def load(self, path: str | PathLike[str]) -> None:
        """Goes on from a save: the frames that follow are bit-equal to those of a run that never stopped.

        Raises OSError where the file cannot be read, and ValueError where it is no save or one of another scene.
        """
        saved = read_save(path, scene_to_toml(self.scene), self._moving())
        try:
            live = self._checked_live(saved["live"].tolist())
            hand = self._checked_hand(int(saved["held"]), saved["hand"])
            for name in ("x", "x_prev", "velocity", "hand"):
                places(saved[name], name, saved[name].shape)
            if saved["frame"] < 0:
                raise ValueError(f"there is no frame {saved['frame']}")
        except ValueError as error:
            raise ValueError(f"{path}: damaged: {error}") from None
        self._live, self._hand = live, hand
        self._letting_out.depth[:] = saved["release"]
        self._wind_on = bool(saved["wind_on"])
        self.frame = int(saved["frame"])
        self.cloth.put(saved["x"], saved["x_prev"], self._inverse_masses())
        put(self.cloth.velocity, saved["velocity"])

    def _checked_live(self, values: list[float]) -> dict[str, float]:
        """Live parameters from a save's numbers, all of them float. Raises ValueError."""
        pairs = zip(self._keys.values(), values, strict=True)
        return {key.name: check_live(key, int(v) if key.is_int and v == int(v) else v) for key, v in pairs}

    def _checked_hand(self, held: int, rows: Floats) -> Hand | None:
        """The hand from a save's rows: its start, its target and its path, at least one. Raises ValueError."""
        if held == -1 and len(rows) == 0:
            return None
        if not 0 <= held < self.topology.particle_count or len(rows) < 3:
            raise ValueError(f"no hand holds particle {held} with {len(rows)} places")
        return Hand(held, rows[0], rows[1], rows[2:])

    def _moving(self) -> dict[str, NDArray[Any]]:
        return {
            "x": self.cloth.taken(self.cloth.x),
            "x_prev": self.cloth.taken(self.cloth.x_prev),
            "velocity": self.cloth.taken(self.cloth.velocity),
            "frame": np.array(self.frame, np.int64),
            "release": self._letting_out.depth.copy(),
            "live": np.array(list(self._live.values()), np.float64),
            "wind_on": np.array(self._wind_on),
            "held": np.array(-1 if self._hand is None else self._hand.particle, np.int64),
            "hand": np.array(
                [] if self._hand is None else [self._hand.start, self._hand.target, *self._hand.path], np.float64
            ).reshape(-1, 3),
        }

    # -- one frame's input -----------------------------------------------------------------------------

    def _input(self) -> FrameInput:
        start, end = self.seconds, self.seconds + FRAME_SECONDS
        colliders = self._colliders()
        smaller = self._letting_out.depths(colliders, self._free_positions, start, end)
        return FrameInput(
            substeps=self.substeps,
            iterations=int(self._live["iterations"]),
            h=self._substep,
            held=-1 if self._hand is None else self._hand.particle,
            controls=self._controls(),
            bodies=body_table([*colliders, *self.scene.grips], start, end, smaller, tuple(self.topology.origin)),
        )

    def _put(self, x: Floats, inverse_mass: NDArray[np.float32]) -> None:
        self.cloth.put(x - self.topology.origin, x - self.topology.origin, inverse_mass)

    def _free_positions(self) -> Floats:
        return self.positions()[~self.topology.pinned]

    def _controls(self) -> NDArray[np.float32]:
        controls = np.zeros(c.COUNT, np.float32)
        controls[c.GRAVITY] = self._live["gravity"]
        controls[c.AREA_DENSITY] = self.scene.cloth.area_density
        controls[c.KEPT] = exp(-self._live["damping"] * self._substep)
        controls[c.STIFFNESS] = self._live["stiffness"]
        controls[c.DAMPING_TIME] = self._damping_time
        controls[c.MOST_STRAIN] = self._live.get("limit_strain", 0.0)
        controls[c.TETHER_SLACK] = self._live.get("tethers_slack", 1.0)
        touching = self.scene.self_collision
        if touching is not None:
            controls[c.THICKNESS] = self._live["self_collision_thickness"]
            controls[c.SELF_FRICTION] = touching.friction
        wind = self.scene.wind
        if wind is not None:
            # Switched off, the air stands still; it still slows the cloth.
            x, z = (self._live["wind_x"], self._live["wind_z"]) if self._wind_on else (0.0, 0.0)
            controls[c.WIND_X], controls[c.WIND_Z] = x, z
            controls[c.GUST] = wind.turbulence * np.hypot(x, z)
            controls[c.DRAG], controls[c.LIFT] = wind.drag, wind.lift
            controls[c.HALF_AIR_DENSITY] = wind.air_density / 2
            # Kept within a turn in float64: float32 would lose the phase in a long run.
            turns = self._gust_phase + np.asarray(c.GUST_RATES) * self.seconds
            turns -= np.asarray(c.GUST_WAVES) @ self.topology.origin
            controls[c.GUST_TURNS : c.GUST_TURNS + 3] = turns % 1
        if self._hand is not None:
            controls[c.GRAB_FROM : c.GRAB_FROM + 3] = self._hand.start - self.topology.origin
            controls[c.GRAB_TO : c.GRAB_TO + 3] = self._hand.target - self.topology.origin
        return controls

    def _colliders(self) -> list[Collider | Ground]:
        """All of the scene's; a slider sets the first sphere's radius."""
        colliders = colliders_of(self.scene)
        if self.scene.spheres:
            colliders[0] = replace(self.scene.spheres[0], radius=self._live["sphere_radius"])
        return colliders
