"""The cloth that a scene describes, and its springs as numbers. NumPy only.

`section` is where the scene's solver takes its spring constants from: `springs` (0…1) or `fabric` (SI).
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..scene.errors import PinError, shown
from ..scene.library import map_path
from ..scene.model import CORNERS, EDGES, GROUP, REGION, Cloth, Scene
from . import grid
from .cloth_file import ClothFile, cloth_file
from .grid import DIRECTIONS
from .imported import imported
from .maps import read_map
from .pile import pile, pinned
from .topology import CONSTANTS, Topology, sheet

HELD_FROM = 0.5  # of a map
SMALLEST, LARGEST = 0.001, 1000.0  # [m] longest side of a file's box, as of a sheet


def topology_of(scene: Scene, section: str) -> Topology:
    """The cloth at its start. A family of springs of no stiffness, in a grid a direction, is left out."""
    bending = scene.fabric.bending if section == "fabric" else 0.0
    topology = _unpinned(scene, _directions(scene, section), bending)
    pins = [*scene.cloth.pins, *(pin for grip in scene.grips for pin in grip.pins)]
    fixed = held(scene, topology, pins)
    if scene.maps and scene.maps.pin:
        fixed[map_of(scene, "pin") >= HELD_FROM] = True
    return replace(topology, pinned=fixed, leash=leash_of(scene))


def leash_of(scene: Scene) -> NDArray[np.float64] | None:
    """How far each particle may go from its start [m], (N,), where the scene says so."""
    maps = scene.maps
    if maps is None or not maps.max_distance:
        return None
    return maps.max_distance_lo + (maps.max_distance_hi - maps.max_distance_lo) * map_of(scene, "max_distance")


def stiffness_of(scene: Scene, section: str, topology: Topology) -> NDArray[np.float64]:
    """Of every spring, (E,), 0…1 or [N/m]."""
    constants = _constants(scene, section)
    each: NDArray[np.float64]
    if section == "springs":
        each = topology.by_family(constants)
    else:
        each = np.array(list(constants.values())) @ topology.shares
    if scene.maps and scene.maps.stiffness:
        low, high = scene.maps.stiffness_lo, scene.maps.stiffness_hi
        each = each * (low + (high - low) * map_of(scene, "stiffness")[topology.ends].mean(axis=1))
    return np.minimum(each, 1.0) if section == "springs" else each


def map_of(scene: Scene, name: str) -> NDArray[np.float64]:
    """One of `model.MAP_NAMES`, 0…1 for every particle, (N,). Raises ValueError, one line, for a file that is none."""
    assert scene.maps is not None
    path = map_path(getattr(scene.maps, name), scene.maps.folder)
    cloth = scene.cloth
    if cloth.file:
        file = _file(cloth)
        return read_map(path, len(file.points), file.spots, cloth.file)
    spots = np.tile(grid.spots(cloth.rows, cloth.columns), (cloth.sheets, 1))
    return read_map(path, len(spots), spots, "the sheet")


def holder_of(scene: Scene, topology: Topology) -> NDArray[np.int64]:
    """Number of the grip that holds each particle, (N,), −1 for none; of two that would hold it, the last does."""
    holder = np.full(topology.particle_count, -1)
    for k, grip in enumerate(scene.grips):
        holder[held(scene, topology, grip.pins)] = k
    return holder


def held(scene: Scene, topology: Topology, pins: Iterable[str | int]) -> NDArray[np.bool_]:
    """Which particles these pins are, (N,). Raises PinError for a pin that the cloth has not."""
    found = np.zeros(topology.particle_count, bool)
    for pin in pins:
        found[_held(scene, topology, pin)] = True
    return found


def check_mesh(cloth: Cloth) -> None:
    """Raises ValueError, one line, for a mesh file that is no cloth or one of another size."""
    longest = float(np.ptp(_file(cloth).points, axis=0).max()) * cloth.scale
    if not SMALLEST <= longest <= LARGEST:
        raise ValueError(f"the cloth would be {longest:g} m large, not {SMALLEST} to {LARGEST:g} m: choose its scale")


def particles_of(scene: Scene) -> Topology:
    """The cloth at its start without springs and pins."""
    return _unpinned(scene, [False] * len(DIRECTIONS), 0.0)


def count_of(scene: Scene) -> str:
    """How many particles there are: `30×24`, or `1519` in a mesh file."""
    cloth = scene.cloth
    return str(len(_file(cloth).points)) if cloth.file else f"{cloth.columns}×{cloth.rows}"


def pieces_of(scene: Scene) -> int:
    """How many pieces the cloth has that nothing joins."""
    return _file(scene.cloth).steps[1] if scene.cloth.file else scene.cloth.sheets


def _file(cloth: Cloth) -> ClothFile:
    return cloth_file(cloth.file, cloth.folder)


def _unpinned(scene: Scene, directions: Sequence[bool], bending: float) -> Topology:
    """The cloth with springs in these of `grid.DIRECTIONS`, or in their families."""
    cloth = scene.cloth
    if cloth.file:
        return imported(
            _file(cloth),
            scale=cloth.scale,
            center=cloth.center,
            rotation=cloth.rotation,
            area_density=cloth.area_density,
            families={family for (family, _, _), has in zip(DIRECTIONS, directions, strict=True) if has},
            diagonals=cloth.diagonals,
            bending=bending,
        )
    one = sheet(
        rows=cloth.rows,
        columns=cloth.columns,
        width=cloth.width,
        height=cloth.height,
        center=cloth.center,
        rotation=cloth.rotation,
        area_density=cloth.area_density,
        pins=(),
        directions=directions,
        diagonals=cloth.diagonals,
        lumping=cloth.lumping,
        weight=cloth.weight,
        weight_at=cloth.weight_at,
        bending=bending,
    )
    if cloth.sheets == 1:
        return one
    return pile(
        one, cloth.sheets, gap=cloth.gap, turn=cloth.turn, center=cloth.center, rotation=cloth.rotation, pins=()
    )


def _held(scene: Scene, topology: Topology, pin: str | int) -> NDArray[Any]:
    """The particles of one pin: indices, or which, (N,)."""
    cloth, count = scene.cloth, topology.particle_count
    if isinstance(pin, int):
        if not 0 <= pin < count:
            raise PinError(f"{shown(pin)} is no particle: indices run from 0 to {count - 1}")
        return np.array([pin])
    if pin.startswith(REGION):
        return _in_region(scene, topology, pin.removeprefix(REGION))
    if not cloth.file:
        if pin.startswith(GROUP):
            raise PinError(f"{shown(pin)} is of a mesh file, and the cloth is a sheet: name an edge or a {REGION}NAME")
        return pinned(cloth.rows, cloth.columns, cloth.sheets, [pin])
    groups = _file(cloth).groups
    if pin in (*EDGES, *CORNERS):
        reason = f"{shown(pin)} is of a sheet, and {cloth.file} has no rows: {REGION}NAME, {GROUP}NAME or an index"
        raise PinError(reason)
    name = pin.removeprefix(GROUP)
    if name not in groups:
        known = ", ".join(groups) or "none"
        raise PinError(f"{cloth.file} has no group {shown(name)}; it has {known}", name, groups)
    return groups[name]


def _in_region(scene: Scene, topology: Topology, name: str) -> NDArray[np.bool_]:
    """Which particles start in a region, (N,): one at least."""
    regions = {region.name: region for region in scene.regions}
    if name not in regions:
        known = ", ".join(regions) or "none"
        raise PinError(f"there is no region {shown(name)} in [[regions]]; there is {known}", name, regions)
    region, start = regions[name], topology.start
    inside: NDArray[np.bool_] = np.all((start >= region.low) & (start <= region.high), axis=1)
    if not inside.any():
        low, high = (", ".join(f"{c:.4g}" for c in end) for end in (start.min(axis=0), start.max(axis=0)))
        raise PinError(f"no particle starts in region {shown(name)}: the cloth is from [{low}] to [{high}] m")
    return inside


def _constants(scene: Scene, section: str) -> dict[str, float]:
    """By family of springs, or the four of `CONSTANTS`."""
    if section == "springs":
        return {family: getattr(scene.springs, family) for family in ("structural", "shear", "bend")}
    return {name: getattr(scene.fabric, name) for name in CONSTANTS}


def _directions(scene: Scene, section: str) -> list[bool]:
    """In which of `grid.DIRECTIONS` there are springs. Edges of triangles are their shear springs, too."""
    k = _constants(scene, section)
    if section == "springs":
        return [k[family] > 0 for family, _, _ in DIRECTIONS]
    on = [k["weft"], k["warp"], k["shear"], k["shear"], k["bend"], k["bend"]]
    if scene.cloth.file:
        on[0] = k["weft"] + k["shear"]
    return [constant > 0 for constant in on]
