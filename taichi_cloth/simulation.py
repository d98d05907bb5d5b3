"""A scene that runs: one cloth, one solver, the hands that hold it and the parameters a slider moves."""

from __future__ import annotations

import weakref
from collections.abc import Callable
from dataclasses import replace
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
    penetration,
)
from .contact.crossings import crossings
from .contact.release import Release
from .controls_row import ControlsRow
from .errors import WrongUse
from .given import places, radius_of, target_point
from .hand import Hand, patch
from .hands import Hands, all_held, hands_of, saved_hands
from .kernels.controls import MOST_HANDS
from .kernels.tearing import longer_than
from .measure.cloth import Measures, energies, spring_strains
from .mesh.from_scene import stiffness_of
from .mesh.tear import Tear
from .save_file import read_save, write_save
from .scene import Scene, check_scene, live_keys, scene_to_toml
from .scene.errors import shown
from .scene.live import LiveKey, check_live
from .scene.model import FRAME_SECONDS, PRESET_NAMES, USUAL, Collider, Ground
from .scene.presets import in_fabric
from .scene_solver import give_back, made_for
from .scene_stages import words_for
from .solvers import SOLVERS, FrameInput, Solver
from .state.fields import put, put_all
from .state.held import hold
from .state.near import come_near
from .state.program import ProgramRef

Floats = NDArray[np.float64]


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
        self._own = scene
        self._keys: dict[str, LiveKey] = {}
        self._live: dict[str, float] = {}
        self._wind_on = True
        self._tear: Tear | None = None
        self._hands: Hands = {}
        self.frame = 0
        self._open(scene, None)

    def _open(self, scene: Scene, repinned: NDArray[np.bool_] | None, **live: float) -> None:
        """Makes the cloth and the solver of a scene, at the start; `repinned` as in `made_for`.

        A live parameter keeps what it was set to, unless the scene says something else of it than the last one did, or
        `live` does.
        """
        topology, solver, repinned, damping_time, least = made_for(scene, self._path, repinned)
        keys = live_keys(scene)
        kept = {name for name, key in self._keys.items() if name in keys and keys[name].value == key.value}
        self._live = {name: self._live[name] if name in kept else key.value for name, key in keys.items()} | live
        self._keys = keys
        self.scene, self.topology, self._repinned = scene, topology, repinned
        self._inverse_mass = state.inverse_mass(topology)
        self._solver: Solver | None = solver
        self._program = ProgramRef()
        self._damping_time, self._least_substeps = damping_time, least
        self._row = ControlsRow(scene, topology.origin, damping_time)
        self._letting_out = Release(solver.stages.bodies)
        self._near = False  # whether crossings were asked for
        torn = () if self._tear is None else (self._tear.ends,)
        self._tear = Tear(topology, *torn) if scene.tear is not None else None
        self._weave()
        # Gives the fields back once, on close() or when nobody refers to the simulation any more.
        self._give_back = weakref.finalize(self, give_back, self._solver)
        self._give_back.atexit = False  # Taichi may be gone by then

    def _reopen(self, scene: Scene, repinned: NDArray[np.bool_], **live: float) -> None:
        """Opens another scene of the same sheet in the place of this one: nothing that moves changes.

        Raises WrongUse, and changes nothing, where it cannot be opened.
        """
        x, velocities = self.positions(), self.velocities()
        before = self.scene, self._repinned
        self._give_back()
        try:
            self._open(scene, repinned, **live)
        except WrongUse:
            self._open(*before)
            raise
        finally:
            self._put(x)
            velocities[self.topology.pinned] = 0.0
            self.solver.set_velocities(velocities, self._substep)

    # -- running ---------------------------------------------------------------------------------------

    def advance_frame(self) -> None:
        """Moves the cloth, the spheres and the hands by one frame of 1/60 s."""
        self.solver.advance_frame(self._input())
        self._end_frame()

    def advance_slowly(self, look: Callable[[float], object]) -> None:
        """The same frame, to the last bit, in slow motion: `look` is called after every substep with the share of the
        frame that has passed, and `positions` are those of that moment.
        """
        for part in self._input().one_by_one():
            self.solver.advance_frame(part)
            look(part.last / part.substeps)
        self._end_frame()

    def _end_frame(self) -> None:
        for hand in self._hands.values():
            hand.end_frame()
        self.frame += 1
        if self._tear is not None:
            self._give_way(self._tear)

    def reset(self) -> None:
        """Back to the first frame, bit for bit, with the scene's own pins; parameters keep what they were set to."""
        self._hands = {}
        if self._repinned.any():
            self._reopen(self.scene, np.zeros_like(self._repinned))
        self._put(self.topology.start)
        self.solver.set_velocities(np.zeros_like(self.topology.start), self._substep)
        self._letting_out.ask()
        self.mend()
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
        for hand in list(self._hands):
            self.release(hand)
        self._put(x)
        self.solver.set_velocities(v, self._substep)
        self._letting_out.ask()

    def close(self) -> None:
        """Gives the cloth's memory back for the next simulation. Closing twice does no harm."""
        self._give_back()
        self._solver = None

    @property
    def closed(self) -> bool:
        """Whether it can go no further: it was closed, or Taichi was stopped or started anew."""
        return self._solver is None or not self._program.runs()

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

    def change(self, scene: Scene) -> None:
        """Goes on with another scene of the same sheet, from the same places and velocities, pins and hand.

        All it says of fabric, method, forces and colliders holds from now on; one that begins around the cloth lets it
        out. Live parameters keep what they were set to, unless the scene says something else of them than before. The
        first time that stages come together which never did, their kernels are compiled: some seconds.

        Raises SceneError, and WrongUse for another grid and for springs that would take too many substeps; then nothing
        has changed.
        """
        scene = check_scene(scene)
        for name in ("file", "rows", "columns", "sheets"):
            ours, theirs = getattr(self.scene.cloth, name), getattr(scene.cloth, name)
            if ours != theirs:
                raise WrongUse(f"{scene.name} has {theirs} {name}, the cloth that runs has {ours}")
        self._reopen(scene, self._repinned)

    def change_solver(self, name: str) -> None:
        """Goes on with another method, from the same places and velocities, with the springs of its own section.

        It takes its usual substeps and iterations; the scene's own method takes the scene's.

        Raises WrongUse, and changes nothing, for an unknown name and for one that would take too many substeps.
        """
        if name not in SOLVERS:
            raise WrongUse(f"{name!r} is not a solver: {', '.join(SOLVERS)}")
        own = self._own.solver
        substeps, iterations = (own.substeps, own.iterations) if name == own.name else USUAL[name]
        solver = replace(own, name=name, substeps=substeps, iterations=iterations)
        self._reopen(replace(self.scene, solver=solver), self._repinned, substeps=substeps, iterations=iterations)

    def change_fabric(self, name: str) -> None:
        """Goes on as another of the shipped fabrics, or, by the name "", as that of the scene it was made with.

        Raises WrongUse, and changes nothing, for an unknown name and for one that would take too many substeps.
        """
        if name not in ("", *PRESET_NAMES):
            raise WrongUse(f"{name!r} is not a fabric: {', '.join(PRESET_NAMES)}")
        self._reopen(in_fabric(self.scene, name, self._own), self._repinned)

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

    # -- tearing ---------------------------------------------------------------------------------------

    @property
    def torn(self) -> NDArray[np.bool_]:
        """Which springs of the whole cloth have given way, (E,); nothing of a cloth that does not tear."""
        return np.zeros(0, bool) if self._tear is None else self._tear.torn.copy()

    def mend(self, torn: NDArray[np.bool_] | bool = False) -> None:
        """Joins again what is torn, but for what is `torn`, as that property tells it."""
        if self._tear is not None:
            self._tear.torn[:] = torn
            self._weave()

    def _give_way(self, tear: Tear) -> None:
        """Tears what a frame has stretched too far."""
        counts, most = self.topology.family_counts, self._live["tear_strain"]
        threads = counts.get("structural", 0) + counts.get("shear", 0)
        if longer_than(self.cloth, threads, most):
            tear.give_way(spring_strains(tear.whole, self.positions()), most)
            self._weave()

    def _weave(self) -> None:
        """Goes on with what is left of the cloth."""
        left = self.topology if self._tear is None else self._tear.left()
        if left is not self.topology:
            self.topology, self._near = left, False
            self.solver.weave(left, stiffness_of(self.scene, self.solver.springs, left))

    # -- hands -----------------------------------------------------------------------------------------

    @property
    def grabbed(self) -> int | None:
        """Index of the particle that the first hand took; those around it are in `held`."""
        return self.grabbed_by(0)

    def grabbed_by(self, hand: int) -> int | None:
        """Index of the particle that a hand took."""
        return int(self._hands[hand].particles[0]) if hand in self._hands else None

    @property
    def held(self) -> NDArray[np.int64]:
        """Indices of all particles that are held, (M,), of each hand the one that it took first."""
        return all_held(self._hands)[0]

    @property
    def added_pins(self) -> NDArray[np.int64]:
        """Indices of the particles that `pin` has pinned besides the scene's own."""
        return np.flatnonzero(self._repinned & self.topology.pinned)

    def grab(self, index: int, target: ArrayLike, radius: float = 0.0, hand: int = 0) -> None:
        """Holds a particle and leads it to `target` (x, y, z) [m] within the next frame.

        With it go all that are within `radius` [m] on the sheet and neither pinned nor held, as they lie (`hand.py`).
        Call it again with the same index to move the hand; another index lets go of what was held. There are
        `MOST_HANDS` hands, by number.
        Raises ValueError for an index that is no particle, or one that another hand holds, for a target not of three
        numbers up to `given.FARTHEST`, for a radius that is not from 0 up to it, and for a hand that does not exist.
        """
        point = target_point(target)
        index = self._particle(index)
        within = radius_of(radius)
        if type(hand) is not int or not 0 <= hand < MOST_HANDS:
            raise ValueError(f"hand {shown(hand)} does not exist: they run from 0 to {MOST_HANDS - 1}")
        if self.grabbed_by(hand) == index:
            self._hands[hand].target = point
            return
        free = ~self.topology.pinned
        for number, other in self._hands.items():
            if number != hand:
                free[other.particles] = False
                if index in other.particles:
                    raise ValueError(f"particle {index} is held by hand {number}")
        self.release(hand)
        particles = patch(self.topology.flat, free, index, within)
        taken = self.positions()[particles]
        self._hold(self._hands | {hand: Hand(particles, taken, taken[0], point)})

    def release(self, hand: int = 0) -> None:
        """Lets go: what was held has its mass again, and the mean velocity of the hand's last frames."""
        if hand not in self._hands:
            return
        empty = self._hands[hand]
        self._hold({number: other for number, other in self._hands.items() if number != hand})
        thrown = empty.particles[self._inverse_mass[empty.particles] > 0]
        self.solver.set_velocities(empty.velocity(), self._substep, of=thrown)

    def pin(self, index: int, on: bool = True) -> None:
        """Pins a particle where it is, or lets a pin go, one of the scene's own too; `reset` brings those back.

        All that depends on pins is made anew: tethers, the least substeps, a factor. A pin of a grip that is let go and
        pinned again is the grip's again, wherever that is by then. Raises ValueError for an index that is no particle.
        """
        index = self._particle(index)
        if bool(self.topology.pinned[index]) != bool(on):
            self._reopen(self.scene, self._repinned ^ (np.arange(len(self._repinned)) == index))

    def _particle(self, index: int) -> int:
        """An index that is checked. Raises ValueError."""
        if not isinstance(index, (int, np.integer)):
            raise ValueError(f"a particle is told by its index, not {shown(index)}")
        count = self.topology.particle_count
        if not 0 <= index < count:
            raise ValueError(f"particle {index} does not exist: indices run from 0 to {count - 1}")
        return int(index)

    def _hold(self, hands: Hands) -> None:
        """From now on these hands: what they hold has no inverse mass, all others have their own."""
        self._hands = hands
        masses = self._inverse_mass.copy()
        if hands:
            particles, taken, numbers = all_held(hands)
            masses[particles] = 0.0
            hold(self.solver.work, self.topology, particles, taken, numbers)
        put(self.cloth.inverse_mass, masses)

    # -- reading ---------------------------------------------------------------------------------------

    @property
    def solver(self) -> Solver:
        """The method that runs. Raises RuntimeError once the simulation is closed, or Taichi has ended."""
        if self._solver is None:
            raise RuntimeError("this simulation is closed")
        if not self._program.runs():
            raise RuntimeError("Taichi was stopped or started anew, which ends every simulation: open a new one")
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
        colliders = dict.fromkeys(type(collider).__name__.lower() for collider in colliders_of(self.scene))
        tearing = () if self._tear is None else ("tear",)
        return (*self.topology.family_counts, *words_for(self.solver.stages), *tearing, *colliders)

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
            hands = hands_of(saved, self.topology.particle_count)
            for name in ("x", "x_prev", "velocity", "taken", "ways"):
                places(saved[name], name, saved[name].shape)
            if saved["frame"] < 0:
                raise ValueError(f"there is no frame {saved['frame']}")
        except ValueError as error:
            raise ValueError(f"{path}: damaged: {error}") from None
        if (saved["pinned"] != self.topology.pinned).any():
            self._reopen(self.scene, self._repinned ^ self.topology.pinned ^ saved["pinned"])
        self._live = live
        self._letting_out.depth[:] = saved["release"]
        self.mend(saved["torn"])
        self._wind_on = bool(saved["wind_on"])
        self.frame = int(saved["frame"])
        put_all(*((getattr(self.cloth, name), saved[name]) for name in ("x", "x_prev", "velocity")))
        self._hold(hands)

    def _checked_live(self, values: list[float]) -> dict[str, float]:
        """Live parameters from a save's numbers, all of them float. Raises ValueError."""
        pairs = zip(self._keys.values(), values, strict=True)
        return {key.name: check_live(key, int(v) if key.is_int and v == int(v) else v) for key, v in pairs}

    def _moving(self) -> dict[str, NDArray[Any]]:
        return {
            "x": self.cloth.taken(self.cloth.x),
            "x_prev": self.cloth.taken(self.cloth.x_prev),
            "velocity": self.cloth.taken(self.cloth.velocity),
            "frame": np.array(self.frame, np.int64),
            "torn": self.torn,
            "release": self._letting_out.depth.copy(),
            "live": np.array(list(self._live.values()), np.float64),
            "wind_on": np.array(self._wind_on),
            "pinned": self.topology.pinned,
            **saved_hands(self._hands),
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
            held=len(self.held),
            controls=self._row.at(self._live, blowing=self._wind_on, hands=self._hands, seconds=start, h=self._substep),
            bodies=body_table([*colliders, *self.scene.grips], start, end, smaller, tuple(self.topology.origin)),
        )

    def _put(self, x: Floats) -> None:
        """Every particle at its place [m], (N, 3), and the hands about what they hold."""
        put_all(*((field, x - self.topology.origin) for field in (self.cloth.x, self.cloth.x_prev)))
        self._hold(self._hands)

    def _free_positions(self) -> Floats:
        return self.positions()[~self.topology.pinned]

    def _colliders(self) -> list[Collider | Ground]:
        """All of the scene's; a slider sets the first sphere's radius."""
        colliders = colliders_of(self.scene)
        if self.scene.spheres:
            colliders[0] = replace(self.scene.spheres[0], radius=self._live["sphere_radius"])
        return colliders
