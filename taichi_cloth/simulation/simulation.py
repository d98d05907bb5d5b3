"""`Simulation`: the public interface of a running scene."""

from __future__ import annotations

import weakref
from base64 import b64encode
from collections.abc import Callable
from functools import partial
from os import PathLike
from pathlib import Path
from typing import Any, BinaryIO, Self, SupportsIndex

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..collision.colliders import PosedCollider, colliders_of, pose_colliders
from ..geometry.scene_loader import check_scene
from ..geometry.topology import ClothMetrics, energies, spring_strains
from ..scene import Scene
from ..system.errors import UsageError
from .builder import feature_names, warnings_of
from .checkpoint import checkpoint_bytes, read_checkpoint, write_checkpoint
from .events import (
    EVENTS,
    RECORD_EVEN_IF_FAILED,
    Event,
    EventQueue,
    GrabHandle,
    check_event,
    collider_event,
    particle_of,
    pin_event,
    prepare_checkpoint,
    scene_event,
)
from .frame_contact import intersection_count, penetration
from .grabbing import free_number
from .parameter_values import check_frames, check_radius, check_vectors
from .running_cloth import RunningCloth

Listener = Callable[[Event], object]


def _set_param(simulation: weakref.ref[Simulation], name: str, value: float | bool) -> None:
    """Apply a change of `Simulation.params`, which must not keep the simulation alive."""
    if (running := simulation()) is not None:
        running.apply(Event("set_param", (name, value)))


class Simulation(RunningCloth):
    """One running scene. The first use of `tc.Simulation` starts Taichi on the CPU, unless `tc.init` has started it.

    A frame is 1/60 s. Positions are in meters, y up; particles are numbered row by row from the top left corner of the
    sheet, those of a mesh file in its order. `params` holds the runtime parameters by name. Close a simulation when
    done, or use it in a `with` block. All changes are events: `apply` applies one and calls the `listeners`.
    """

    def __init__(self, scene: Scene | str | Path | dict[str, Any], layout: str | None = None) -> None:
        """`scene`: made in Python, or a name, path or dict for `load_scene`.

        `layout`: "simd", "serial" or "parallel"; chosen for the cloth and the backend if None.

        Raises SceneError for an invalid scene, and UsageError for a layout that is not supported and for springs that
        would take more than 200,000 substeps a frame; `warnings` tells if they take more than requested.
        """
        self.listeners: list[Listener] = []
        self._queue = EventQueue()
        self.has_changed = False
        """Whether an event was applied since the simulation was opened."""
        super().__init__(check_scene(scene), layout, partial(_set_param, weakref.ref(self)))

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exception: object) -> None:
        self.close()

    # -- changes -------------------------------------------------------------------------------------------------------

    def apply(self, event: Event) -> None:
        """Carry out a change, and pass it to all listeners, in the order of the changes.

        An event that raises has changed nothing, except in two cases. A switch that the cloth does not support may
        change the last bits of the state, and listeners receive it too. An error of a listener is raised at the end.
        """
        self._check_usable()
        self.check_between_frames()
        event = check_event(event)
        try:
            EVENTS[event.name].handler(self, *event.arguments)
        except UsageError:
            if event.arguments[:1] in RECORD_EVEN_IF_FAILED.get(event.name, ()):
                self.notify(event)
            raise
        self.notify(event)

    def notify(self, event: Event) -> None:
        """Pass an event to the listeners, without carrying it out."""
        self.has_changed = True
        self._queue.pass_on(event, self.listeners)

    def reset(self) -> None:
        """Return to the first frame, bit for bit, with the scene's own pins. Parameters, solver and fabric stay."""
        self.apply(Event("reset"))

    def set_state(self, positions: ArrayLike, velocities: ArrayLike = (0, 0, 0), frame: int | None = None) -> None:
        """Set the position of every particle [m], (N, 3), and its velocity [m/s], (N, 3) or one for all.

        `frame`: that of this state, whose time wind and colliders follow; None keeps the present one. Pins jump to
        where they are put, which shakes the cloth; attachments and grabs move evenly. Attached particles return to
        their attachment in the next frame. Raises ValueError, and changes nothing, for another shape, numbers that are
        not finite or exceed 10⁶, and with `penetration_free` for intersections, unless `untangle` is on.
        """
        shape = self.topology.start.shape
        x, v = check_vectors(positions, "positions", shape), check_vectors(velocities, "velocities", shape, (3,))
        self.apply(Event("set_state", (x, v) if frame is None else (x, v, check_frames(frame, "frame"))))

    def switch_solver(self, name: str) -> None:
        """Continue with another solver, from the same positions and velocities, with the springs of its own section.

        It gets its default substeps and iterations; the scene's own solver those of the scene. Raises UsageError, and
        changes nothing, for an unknown name and for springs that would take too many substeps.
        """
        self.apply(Event("switch_solver", (name,)))

    def switch_fabric(self, name: str) -> None:
        """Continue with a shipped fabric, or by the name "" with that of the original scene.

        Raises UsageError, and changes nothing, for an unknown name and for springs that would take too many substeps.
        """
        self.apply(Event("switch_fabric", (name,)))

    def switch_scene(self, scene: Scene | str | Path | dict[str, Any]) -> None:
        """Continue with another scene, from the same positions and velocities, with pins and grabs.

        Its sheet must have the same rows, columns, layers and mesh file. All else applies from now on, also another
        size; a collider that appears around the cloth lets it out slowly. A parameter keeps its value unless the scenes
        differ in it. New combinations of features are compiled, which takes seconds. Raises SceneError, and UsageError
        for a sheet with other particles and for too many substeps; nothing has changed then.
        """
        self.apply(scene_event(check_scene(scene)))

    def grab(self, particle: ArrayLike, radius: float = 0.0) -> GrabHandle:
        """Grab a particle, with all that are within `radius` [m] on the sheet and neither pinned nor grabbed.

        `particle`: an index, or a position [m] for the nearest one. If it is pinned, its pin moves with the grab, and
        stays there. Raises ValueError for one that does not exist or is grabbed, a bad radius, and if no grab is free.
        """
        number = free_number(self.grabs)
        self.apply(Event("grab", (particle_of(self, particle), check_radius(radius), number)))
        return GrabHandle(self, number)

    @property
    def grab_handles(self) -> list[GrabHandle]:
        """Handles of all grabs, also of those that `load` has restored."""
        return [GrabHandle(self, number) for number in self.grabs]

    def move_collider(self, collider: SupportsIndex | str, target: ArrayLike) -> None:
        """Move the center of a collider, by index in `colliders()` or by name, to `target` [m] within the next frame.

        From there its own motion goes on until `reset`. Above 340 m/s it jumps. Raises ValueError, also for the ground.
        """
        self.apply(collider_event(self, collider, target))

    def pin(self, particle: ArrayLike, radius: float = 0.0) -> None:
        """Pin a particle, as in `grab`, and all within `radius` [m] on the sheet, where they are.

        One of an attachment that was unpinned is attached again. Raises ValueError.
        """
        self.apply(pin_event(self, particle, radius, True))

    def unpin(self, particle: ArrayLike, radius: float = 0.0) -> None:
        """Unpin a particle, as in `grab`, and all within `radius` [m] on the sheet, also of the scene's own.

        `reset` restores the pins of the scene. Raises ValueError.
        """
        self.apply(pin_event(self, particle, radius, False))

    def untear(self) -> None:
        """Restore all torn springs, where the cloth is now."""
        self.apply(Event("untear"))

    def save(self, path: str | PathLike[str] | BinaryIO) -> None:
        """Write a checkpoint (.npz) between frames, where self-collision finds its pairs anew. Raises OSError."""
        prepare_checkpoint(self)
        write_checkpoint(self, path)

    def load(self, path: str | PathLike[str] | BinaryIO) -> None:
        """Continue from a checkpoint, with the same bits as the run that wrote it, in the same layout.

        `path` may be a binary file open at its start. Raises OSError, and ValueError for one of another scene.
        """
        self.check_between_frames()
        read_checkpoint(self, path)
        self.notify(Event("load", (b64encode(checkpoint_bytes(self)).decode(),)))

    # -- reading -------------------------------------------------------------------------------------------------------

    @property
    def min_stable_substeps(self) -> int:
        """The fewest substeps at which the solver is stable."""
        return self.built.min_stable_substeps

    @property
    def triangles(self) -> NDArray[np.int32]:
        """The three particles of every triangle that is not torn, (T, 3); docs/api.md tells their order."""
        return self.topology.triangles.copy()

    @property
    def features(self) -> tuple[str, ...]:
        """Names of spring families, constraints, forces and colliders in use."""
        colliders = dict.fromkeys(type(collider).__name__.lower() for collider in colliders_of(self.scene))
        tearing = () if self.scene.tearing is None else ("tearing",)
        families = () if self.solver.features.membrane else self.topology.family_counts
        return (*families, *feature_names(self.solver.features), *tearing, *colliders)

    @property
    def method(self) -> str:
        """The solver with its substeps, iterations and layout: `verlet 5×12 · simd`."""
        iterations = "" if self.solver.info.is_explicit else f"×{self.params['iterations']}"
        return f"{self.solver.name} {self.substeps}{iterations} · {self.solver.layout_name}"

    @property
    def warnings(self) -> str:
        """One line about what is not as requested or is unusual, or if the cloth is held still, else empty."""
        return "; ".join(warnings_of(self))

    def colliders(self) -> list[PosedCollider]:
        """Return every collider as it is now: spheres, capsules, boxes, planes with the ground, meshes."""
        return pose_colliders(self.scene_colliders(), self.seconds)

    def metrics(self) -> ClothMetrics:
        """Return strain, energy and penetration of the cloth as it is now."""
        x = self.positions()
        family = self.topology.family("structural")
        strains = spring_strains(self.topology, x, family if len(family) else slice(None))
        kinetic, potential = energies(self.topology, x, self.velocities(), float(self.params["gravity"]))
        return ClothMetrics(
            max_strain=float(strains.max(initial=0.0)),
            mean_strain=float(np.abs(strains).mean()) if len(strains) else 0.0,
            kinetic_energy=kinetic,
            potential_energy=potential,
            penetration=penetration(self, x),
            finite=bool(np.isfinite(x).all()),
            intersections=self.intersections() if self.scene.self_collision is not None else None,
        )

    def intersections(self) -> int:
        """Return how many times an edge of the cloth passes through one of its triangles; touching does not count."""
        return intersection_count(self)
