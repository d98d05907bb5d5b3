"""Events: changes of a simulation as data, and what each does. Recordings store them, and replay applies them."""

from __future__ import annotations

from base64 import b64decode
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple, SupportsIndex

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..collision.colliders import colliders_of
from ..geometry.scene_loader import check_geometry
from ..kernels.step_params import MAX_GRABS
from ..scene import Scene, scene_to_toml
from ..scene.fabric_schema import PRESET_NAMES
from ..scene.overrides import with_solver
from ..scene.presets import with_fabric
from ..scene.reader import folder_of, scene_from_toml
from ..scene.schema import COLLIDERS
from ..scene.solver_catalog import SOLVER_CATALOG
from ..system.errors import RENAMED_SOLVERS, UsageError, choose_from, short_repr
from .checkpoint import read_checkpoint
from .frame_contact import check_movable, describe_intersections, displacement_to
from .grabbing import Grab, vertices_in_radius
from .parameter_values import check_frames, check_numbers, check_radius, check_target, check_vectors


@dataclass(frozen=True)
class Event:
    """One change of a simulation, as its listeners get it and recordings store it."""

    name: str
    """Name of the change: that of the method, "set_param", "move_grab", or "release"."""
    arguments: tuple[Any, ...] = ()
    """Its arguments, which TOML can store."""


if TYPE_CHECKING:
    from .simulation import Simulation

Vectors = list[list[float]]


def reset(simulation: Simulation) -> None:
    start = simulation.topology.start
    simulation.grabs, simulation.displacements = {}, {}
    simulation.set_pins(simulation.topology.pinned ^ simulation.built.pin_changes)
    simulation.set_frame(0)  # before placing, which tells penetration-free contact the frame
    simulation.place(start)
    simulation.solver.set_velocities(np.zeros_like(start), simulation.h)
    simulation.depenetration.invalidate()
    simulation.set_torn(False)


def set_state(
    simulation: Simulation, positions: Vectors, velocities: Vectors | list[float], frame: int | None = None
) -> None:
    shape, number = simulation.topology.start.shape, simulation.frame if frame is None else check_frames(frame, "frame")
    x = check_vectors(positions, "positions", shape)
    contact = simulation.scene.self_collision
    if contact is not None and contact.penetration_free and not contact.untangle:
        found = describe_intersections(simulation.topology, x)
        if found:
            raise ValueError(f"positions with intersections, which self_collision.penetration_free forbids: {found}")
    v = np.array(np.broadcast_to(check_vectors(velocities, "velocities", shape, (3,)), shape))
    v[simulation.topology.pinned] = 0.0
    for grabbed in list(simulation.grabs):
        release(simulation, grabbed)
    simulation.set_frame(number)  # before placing, which tells penetration-free contact the frame
    simulation.place(x)
    simulation.solver.set_velocities(v, simulation.h)
    simulation.depenetration.invalidate()


def set_param(simulation: Simulation, name: str, value: float | bool) -> None:
    params, h = simulation.params, simulation.h
    value = params.check(name, value)
    parameter = params.known().get(name)
    if parameter is not None and parameter.section in COLLIDERS and value > params[name]:
        # The collider may grow around particles.
        changed = getattr(simulation.scene, parameter.section)[parameter.index]
        rows = [collider is changed for collider in colliders_of(simulation.scene)]
        simulation.depenetration.invalidate(rows.index(True))
    params.assign(name, value)
    if simulation.h != h:
        simulation.solver.change_substep(h, simulation.h)


def switch_solver(simulation: Simulation, name: str) -> None:
    if name not in SOLVER_CATALOG:
        raise UsageError(f"unknown solver {name!r}{choose_from(name, SOLVER_CATALOG, RENAMED_SOLVERS)}")
    scene = with_solver(simulation.scene, name, simulation.original_scene)
    setting = {"substeps": scene.solver.substeps, "iterations": scene.solver.iterations}
    simulation.rebuild(scene, simulation.built.pin_changes, **setting)


def switch_fabric(simulation: Simulation, name: str) -> None:
    if name not in ("", *PRESET_NAMES):
        raise UsageError(f"unknown fabric {name!r}{choose_from(name, PRESET_NAMES)}")
    scene = with_fabric(simulation.scene, name, simulation.original_scene)
    simulation.rebuild(scene, simulation.built.pin_changes)


def switch_scene(simulation: Simulation, text: str, folder: str = "") -> None:
    scene = scene_from_toml(text, simulation.scene, folder)
    check_geometry(scene, scene.name)
    for name in ("file", "rows", "columns", "layers"):
        ours, theirs = getattr(simulation.scene.cloth, name), getattr(scene.cloth, name)
        if ours != theirs:
            raise UsageError(f"the new scene has {theirs} {name}, the running cloth has {ours}")
    simulation.rebuild(scene, simulation.built.pin_changes)


def grab(simulation: Simulation, particle: int, radius: float, number: int) -> None:
    if type(number) is not int or not 0 <= number < MAX_GRABS or number in simulation.grabs:
        raise ValueError(f"grab numbers must be unique and in 0..{MAX_GRABS - 1}, got {short_repr(number)}")
    radius = check_radius(radius)
    free = ~simulation.topology.pinned
    for other in simulation.grabs.values():
        free[other.particles] = False
        if particle in other.particles:
            raise ValueError(f"particle {particle} is grabbed already")
    particles = vertices_in_radius(simulation.topology.flat, free, simulation.check_particle(particle), radius)
    rest = simulation.positions()[particles]
    simulation.set_grabs(simulation.grabs | {number: Grab(particles, rest, rest[0], rest[0])})


def move_grab(simulation: Simulation, number: int, *target: float) -> None:
    if number not in simulation.grabs:
        raise ValueError(f"there is no grab {number}")
    simulation.grabs[number].target = check_target(target)


def move_collider(simulation: Simulation, row: int, *target: float) -> None:
    check_movable(simulation, row)
    simulation.displacements[row] = displacement_to(simulation, row, check_target(target))


def release(simulation: Simulation, number: int) -> None:
    """Free particles get the mean velocity of the grab's last frames."""
    if number not in simulation.grabs:
        return
    released = simulation.grabs[number]
    simulation.set_grabs({k: grab for k, grab in simulation.grabs.items() if k != number})
    free = released.particles[~simulation.topology.pinned[released.particles]]
    simulation.solver.set_velocities(released.velocity(), simulation.h, of=free)


def pin(simulation: Simulation, particle: int, on: bool) -> None:
    pinned = simulation.topology.pinned.copy()
    pinned[simulation.check_particle(particle)] = on
    simulation.set_pins(pinned)


def pin_within(simulation: Simulation, particle: int, radius: float, on: bool) -> None:
    """Pin or unpin a particle and all within a radius [m] of it on the sheet."""
    pinned, flat = simulation.topology.pinned.copy(), simulation.topology.flat
    others = pinned != on
    pinned[vertices_in_radius(flat, others, simulation.check_particle(particle), check_radius(radius))] = on
    simulation.set_pins(pinned)


def untear(simulation: Simulation) -> None:
    simulation.set_torn(False)


def load(simulation: Simulation, content: str) -> None:
    read_checkpoint(simulation, b64decode(content))


def find_pairs(simulation: Simulation) -> None:
    """Let self-collision find its pairs anew, as it does in a simulation that loads a checkpoint."""
    simulation.find_pairs(moved=False)


def prepare_checkpoint(simulation: Simulation) -> None:
    """Let a simulation whose checkpoint is written go on with the bits of one that loads it.

    A checkpoint has no pairs of self-collision. The order in which they were found changes the last bits.
    """
    if simulation.scene.self_collision is not None:
        simulation.apply(Event("find_pairs"))


def report_roll_back(simulation: Simulation) -> None:
    """Do nothing: `DivergenceGuard.roll_back` has restored the last stable frame, and reports it by this event."""


class EventKind(NamedTuple):
    """What all events of one name have in common."""

    handler: Callable[..., None]
    """Carries out the event: called with the simulation and the event's arguments."""
    argument_types: tuple[tuple[type, ...], ...] = ()
    """Types that each argument may have in a recording; `list` is one or more positions."""
    optional: int = 0
    """How many of the last arguments may be left out."""


EVENTS: dict[str, EventKind] = {
    "set_param": EventKind(set_param, ((str,), (bool, int, float))),
    "switch_solver": EventKind(switch_solver, ((str,),)),
    "switch_fabric": EventKind(switch_fabric, ((str,),)),
    "switch_scene": EventKind(switch_scene, ((str,), (str,)), optional=1),  # as TOML, folder of its files
    "grab": EventKind(grab, ((int,), (float,), (int,))),  # particle, radius [m], number of the grab
    "move_grab": EventKind(move_grab, ((int,), (float,), (float,), (float,))),  # number, target [m]
    "release": EventKind(release, ((int,),)),
    "move_collider": EventKind(move_collider, ((int,), (float,), (float,), (float,))),  # row, target [m]
    "pin": EventKind(pin, ((int,), (bool,))),
    "pin_within": EventKind(pin_within, ((int,), (float,), (bool,))),  # particle, radius [m]
    "reset": EventKind(reset),
    "set_state": EventKind(set_state, ((list,), (list,), (int,)), optional=1),  # positions, velocities, frame
    "untear": EventKind(untear),
    "load": EventKind(load, ((str,),)),  # a checkpoint in base64
    "find_pairs": EventKind(find_pairs),
    "roll_back": EventKind(report_roll_back),
}


MAX_EXACT = 1 << 53  # up to which a float has the value of every integer


def check_event(event: object) -> Event:
    """Return an event with arguments of the types that a recording may have.

    Raises ValueError unless it is an event with a known name, as many arguments as it needs, and numbers where it needs
    numbers.
    """
    if not isinstance(event, Event):
        raise ValueError(f"an event must be a tc.Event, such as tc.Event('reset'), not {short_repr(event)}")
    if event.name not in EVENTS:
        raise ValueError(f"unknown event {event.name!r}{choose_from(event.name, EVENTS)}")
    needed, optional = len(EVENTS[event.name].argument_types), EVENTS[event.name].optional
    if not needed - optional <= len(event.arguments) <= needed:
        needed -= optional
        raise ValueError(f"event {event.name} needs {needed} arguments, got {short_repr(event.arguments)}")
    kinds = EVENTS[event.name].argument_types
    arguments = tuple(_as_recorded(one, of) for one, of in zip(event.arguments, kinds, strict=False))
    for number, (argument, of) in enumerate(zip(arguments, kinds, strict=False), 1):
        # What takes the place of text or a list, the handler refuses; of numbers it may accept some: 0.0 is a grab 0.
        if type(argument) not in of and (isinstance(argument, bytes) or of[0] in (bool, int, float)):
            names = " or ".join(kind.__name__ for kind in of)
            raise ValueError(f"argument {number} of event {event.name} must be {names}, not {short_repr(argument)}")
    return Event(event.name, arguments)


def _as_recorded(argument: Any, kinds: tuple[type, ...]) -> Any:
    """Return an argument as one of these types if it has the same value: numbers of NumPy, and integers for floats."""
    if list in kinds:
        numbers = check_numbers(argument)
        return numbers.tolist() if numbers.ndim and numbers.size else argument
    if isinstance(argument, (np.generic, np.ndarray)) and argument.ndim == 0:
        argument = argument.item()
    if type(argument) is int and int not in kinds and float in kinds and abs(argument) <= MAX_EXACT:
        return float(argument)
    return argument


MAX_CHANGES = 1000  # by listeners in answer to one event: more will not end


class EventQueue:
    """Passes events to listeners in the order of the events, also those of changes that a listener makes."""

    def __init__(self) -> None:
        self._events: list[Event] = []

    def pass_on(self, event: Event, listeners: list[Callable[[Event], object]]) -> None:
        """Call all listeners with an event. The event of a change by a listener follows when all have had this one.

        An exception of a listener is raised when all have had all events. Raises RuntimeError if they make changes
        without end.
        """
        self._events.append(event)
        if len(self._events) > 1:
            return
        failures = []
        try:
            for number, waiting in enumerate(self._events):  # grows meanwhile
                if number > MAX_CHANGES:
                    raise RuntimeError("listeners answer each change with another one, without end")
                for listener in tuple(listeners):
                    try:
                        listener(waiting)
                    except Exception as failure:
                        failures.append(failure)
        finally:
            self._events.clear()
        if failures:
            raise failures[0]


def scene_event(scene: Scene) -> Event:
    """Return the event that switches to a scene. It has a folder only if the scene has files that are not shipped."""
    folder = folder_of(scene)
    return Event("switch_scene", (scene_to_toml(scene), *[folder] * bool(folder)))


def collider_event(simulation: Simulation, collider: SupportsIndex | str, target: ArrayLike) -> Event:
    """Return the event that moves a collider, by its row or its name, to a target [m]. Raises ValueError."""
    row: object = collider
    if isinstance(collider, str):
        names = [getattr(one, "name", "") for one in colliders_of(simulation.scene)]
        if not any(names):
            raise ValueError(f"no collider is named {collider!r}: none has a name; move it by its index, from 0")
        if not collider or collider not in names:
            raise ValueError(f"no collider is named {collider!r}{choose_from(collider, filter(None, names))}")
        row = names.index(collider)
    elif isinstance(collider, bool) or not isinstance(collider, (int, np.integer)):
        raise ValueError(f"a collider is an index or a name, not {short_repr(collider)}")
    return Event("move_collider", (row, *map(float, check_target(target))))


def particle_of(simulation: Simulation, particle: ArrayLike) -> int:
    """Return a particle's index. `particle` is that index or a position [m], which stands for the nearest particle.

    Raises ValueError, also for a mask, for several integers, which may be meant as indices, and if the nearest particle
    is farther away than the cloth is long.
    """
    if np.ndim(particle) == 0:
        return simulation.check_particle(particle)  # type: ignore[arg-type]
    if np.asarray(particle).dtype.kind in "iub":
        raise ValueError(
            "a particle is one index, such as 12, or a position with decimals, such as [0.0, 1.5, 0.0],"
            f" not {short_repr(particle)}: call once for each particle"
        )
    position = check_vectors(particle, "the position of a particle", (3,))
    away = np.linalg.norm(simulation.positions() - position, axis=1)
    nearest = int(away.argmin())
    if away[nearest] > simulation.topology.longest_side:
        raise ValueError(
            f"no particle is near the position {short_repr(particle)}: the nearest is {away[nearest]:.3g} m away;"
            " one particle is an index or a position"
        )
    return nearest


def pin_event(simulation: Simulation, particle: ArrayLike, radius: float, on: bool) -> Event:
    """Return the event that pins or unpins a particle and all within `radius` [m] of it. Raises ValueError."""
    particle, radius = particle_of(simulation, particle), check_radius(radius)
    return Event("pin_within", (particle, radius, on)) if radius else Event("pin", (particle, on))


# Arguments of events that listeners receive although they raised: the solver or fabric exists, but the running cloth
# does not support it. Rebuilding the cloth may have changed the last bits of its state.
RECORD_EVEN_IF_FAILED = {
    "switch_solver": [(name,) for name in SOLVER_CATALOG],
    "switch_fabric": [(name,) for name in ("", *PRESET_NAMES)],
}


class GrabHandle:
    """A grab of a simulation, from `Simulation.grab`."""

    __slots__ = ("_grab", "_simulation", "number")  # `grab.target = ...` is an error: `move_to` moves it

    def __init__(self, simulation: Simulation, number: int) -> None:
        self._simulation, self.number = simulation, number
        self._grab = simulation.grabs[number]

    def __repr__(self) -> str:
        count = len(self.particles)
        held = f"of {count} particle{'s' * (count != 1)}" if self.active else "released"
        return f"<GrabHandle {self.number}: {held}>"

    @property
    def active(self) -> bool:
        """Whether it still holds particles. A reset releases all grabs, and so does closing the simulation."""
        return not self._simulation.closed and self._simulation.grabs.get(self.number) is self._grab

    @property
    def particles(self) -> NDArray[np.int64]:
        """Indices of the grabbed particles, first the one passed to `grab`; empty once released."""
        return self._grab.particles if self.active else np.zeros(0, np.int64)

    @property
    def force(self) -> NDArray[np.float64]:
        """Force of the grab on the cloth [N], (3,): the sum of `reaction_forces` of its particles; 0 once released."""
        if not self.active:
            return np.zeros(3)
        total: NDArray[np.float64] = self._simulation.reaction_forces()[self.particles].sum(axis=0)
        return total

    def move_to(self, target: ArrayLike) -> None:
        """Move the grab to `target` (x, y, z) [m] within the next frame. Raises ValueError, also after its release."""
        point = check_target(target)
        if not self.active:
            raise ValueError("the grab was released; `grab_handles` of the simulation are those that hold particles")
        self._simulation.apply(Event("move_grab", (self.number, *map(float, point))))

    def release(self) -> None:
        """Release the particles with the mean velocity of the grab's last frames. Releasing twice does no harm."""
        if self.active:
            self._simulation.apply(Event("release", (self.number,)))
