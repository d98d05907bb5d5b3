"""Builds the cloth of a scene: its topology, pins, maps and spring stiffnesses. NumPy, and Pillow for images.

`section` is the scene section that contains the spring stiffnesses of the solver: `verlet` (0…1) or `fabric` (SI).
"""

from __future__ import annotations

import warnings
from collections.abc import Iterable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ..scene.fabric_schema import Fabric
from ..scene.keys import CORNERS, EDGES, GROUP, REGION
from ..scene.presets import map_path
from ..scene.schema import Cloth, Scene
from ..system.errors import PinError, UsageError, install_command, short_repr, shown_path
from ..system.taichi_runtime import memory_bytes
from . import grid
from .bending import Bending
from .cloth_mesh import ClothMesh, load_cloth_mesh
from .grid import DIRECTIONS, cell_aspect
from .layers import pinned_mask_of_layers, stack_layers
from .membrane_model import ElasticTriangles, build_membrane
from .mesh_springs import build_mesh
from .topology import STIFFNESS_KEYS, Topology, build_sheet, stiffness_of
from .weave_model import build_weave

MAX_BYTES = 64_000_000
MAX_PIXELS = 100_000_000

Floats = NDArray[np.float64]


def read_map(path: Path, count: int, uv: Floats | None, cloth: str, shape: tuple[int, int] | None = None) -> Floats:
    """Return the values of a map for `count` particles, (N,).

    `uv`: texture coordinates of the particles, (N, 2), from the left and from the bottom; only images need them.
    `cloth`: name of the cloth in messages. `shape`: rows and columns of a sheet. Raises ValueError with one line.
    """
    suffix = path.suffix.lower()
    try:
        size = path.stat().st_size
    except (OSError, ValueError) as error:  # ValueError: a path with a zero byte
        raise ValueError(f"{path} cannot be read: {getattr(error, 'strerror', None) or error}") from None
    if size > MAX_BYTES:
        raise ValueError(f"{path} is larger than {MAX_BYTES} bytes")
    if suffix not in (".csv", ".npy"):
        if uv is None:
            raise ValueError(f"{cloth} has vertices without texture coordinates (`vt`), which an image as map needs")
        return sample_map(_read_image(path), uv)
    values = _read_csv(path) if suffix == ".csv" else _read_npy(path)
    values = _one_for_each(values, count, shape, f"{path} ")
    wrong = np.flatnonzero(~((values >= 0) & (values <= 1)))  # NaN fails both tests
    if len(wrong):
        raise ValueError(f"{path}: value {wrong[0] + 1} is {values[wrong[0]]:g}, not 0 to 1")
    return values


def _one_for_each(values: Floats, count: int, shape: tuple[int, int] | None, name: str) -> Floats:
    """Return the values of a map as (N,). `shape`: rows and columns of a sheet, which the map may have."""
    if shape is not None and values.shape == shape:
        return values.reshape(-1)
    if values.shape != (count,):
        rows = "" if shape is None else f", nor rows and columns as the sheet, {shape}"
        raise ValueError(f"{name}has values of shape {values.shape}, not one for each of {count} particles{rows}")
    return values


def sample_map(gray: Floats, uv: Floats) -> Floats:
    """Sample a grayscale image (height, width) at texture coordinates `uv`, (N, 2), by bilinear interpolation.

    The centers of the outermost pixels lie on the edges 0 and 1. Outside 0…1 the image repeats, as textures do.
    """
    outside = (uv < 0) | (uv > 1)
    u, v = np.where(outside, uv % 1, uv).T
    height, width = gray.shape
    x, y = u * (width - 1), (1 - v) * (height - 1)
    left, top = np.minimum(x.astype(int), max(width - 2, 0)), np.minimum(y.astype(int), max(height - 2, 0))
    right, bottom = np.minimum(left + 1, width - 1), np.minimum(top + 1, height - 1)
    x, y = x - left, y - top
    upper = gray[top, left] * (1 - x) + gray[top, right] * x
    lower = gray[bottom, left] * (1 - x) + gray[bottom, right] * x
    values: Floats = upper * (1 - y) + lower * y
    return values


def _read_image(path: Path) -> Floats:
    """Return the brightness of an image, 0…1, (height, width). Raises ValueError, and UsageError without Pillow."""
    try:
        from PIL import Image
    except ImportError:
        raise UsageError(f"images as maps need Pillow: {install_command('maps')}") from None
    try:
        with warnings.catch_warnings(action="ignore"):  # Pillow warns of large images; here they are an error
            opened = Image.open(path)
        with opened as image:
            if image.width * image.height > MAX_PIXELS:
                raise ValueError(f"it has more than {MAX_PIXELS} pixels")
            if image.mode.startswith("I"):  # 16 bits
                return np.clip(np.asarray(image, np.float64) / 65535, 0.0, 1.0)
            return np.asarray(image.convert("L"), np.float64) / 255
    except Exception as error:  # Pillow raises many kinds of errors for a broken file
        raise ValueError(f"{path} is not a usable image: {short_repr(str(error))}") from None


def _read_csv(path: Path) -> Floats:
    """Return the numbers of a file with one per line. Raises ValueError."""
    values = []
    for line, text in enumerate(path.read_text(encoding="utf-8-sig", errors="replace").splitlines(), 1):
        try:
            if text.strip():
                values.append(float(text))
        except ValueError:
            raise ValueError(
                f"{path}: line {line}: {short_repr(text)} is not a number; each line must have one"
            ) from None
    return np.array(values)


def _read_npy(path: Path) -> Floats:
    """Return the array of a NumPy file. Raises ValueError."""
    try:
        array = np.load(path, allow_pickle=False)
        return np.asarray(array, np.float64)
    except Exception as error:
        raise ValueError(f"{path} is not a NumPy array of numbers: {short_repr(str(error))}") from None


PIN_THRESHOLD = 0.5  # a particle is pinned where the `pin` map is at least this
MIN_SIZE, MAX_SIZE = 0.001, 1000.0  # [m] limits of the longest side of a mesh's bounding box, the same as of a sheet


def build_topology(scene: Scene, section: str) -> Topology:
    """Return the cloth at its start, with pins and max distances.

    Springs of zero stiffness are left out: of a grid by direction, of a mesh by family.
    """
    bending = bending_of(scene.fabric) if section == "fabric" else 0.0
    topology = _without_pins(scene, _used_directions(scene, section), bending)
    pins = [*scene.cloth.pins, *(pin for attachment in scene.attachments for pin in attachment.pins)]
    fixed = attached_particles(scene, topology, pins)
    if scene.maps and scene.maps.pin:
        fixed[weight_map(scene, "pin") >= PIN_THRESHOLD] = True
    membrane: ElasticTriangles | None = None
    if (model := model_of(scene, section)) == "membrane":
        membrane = build_membrane(scene.fabric, scene.cloth, topology, stiffness_map(scene))
    elif model == "weave" and scene.weave is not None:
        membrane = build_weave(scene.weave, scene.fabric.compression, topology, stiffness_map(scene))
    return replace(topology, pinned=fixed, membrane=membrane, max_distance=max_distances(scene))


def model_of(scene: Scene, section: str) -> str:
    """Return the model of the cloth of a scene, one of `FABRIC_MODELS`, for solvers with the stiffness of a section."""
    return scene.fabric.model if section == "fabric" else "springs"


def bending_of(fabric: Fabric) -> tuple[float, float]:
    """Return the bending stiffness along columns and rows [N·m], between which warp and weft may lie at an angle."""
    warp, weft = fabric.bending_stiffness, fabric.bending_weft or fabric.bending_stiffness
    share = np.sin(np.radians(fabric.warp_angle)) ** 2 if fabric.model == "membrane" else 0.0
    return float(warp + (weft - warp) * share), float(weft + (warp - weft) * share)


def max_distances(scene: Scene) -> NDArray[np.float64] | None:
    """Return the max distance of every particle from its start [m], (N,), or None if the scene has no map of it."""
    maps = scene.maps
    if maps is None or not maps.max_distance:
        return None
    return maps.max_distance_min + (maps.max_distance_max - maps.max_distance_min) * weight_map(scene, "max_distance")


def spring_stiffness(scene: Scene, section: str, topology: Topology) -> NDArray[np.float64]:
    """Return the stiffness of every spring, (E,): 0…1 in section `verlet`, [N/m] in section `fabric`.

    The springs of a membrane or a weave have none: they are edges whose strain is measured.
    """
    constants = _stiffness_values(scene, section)
    stiffness: NDArray[np.float64]
    if topology.membrane is not None:
        return np.zeros(topology.spring_count)
    if section == "verlet":
        stiffness = topology.by_family(constants)
    else:
        stiffness = stiffness_of(list(constants.values()), topology.stiffness_factors)
    factor = stiffness_map(scene)
    if factor is not None:
        stiffness = stiffness * factor[topology.ends].mean(axis=1)
    return np.minimum(stiffness, 1.0) if section == "verlet" else stiffness


def stiffness_map(scene: Scene) -> NDArray[np.float64] | None:
    """Return the factor on the stiffness at every particle, (N,), or None if the scene has no map of it."""
    maps = scene.maps
    if maps is None or not maps.stiffness:
        return None
    return maps.stiffness_min + (maps.stiffness_max - maps.stiffness_min) * weight_map(scene, "stiffness")


def weight_map(scene: Scene, name: str) -> NDArray[np.float64]:
    """Return the values 0…1 of one of `schema.MAP_NAMES` for every particle, (N,).

    Raises ValueError with a one-line message if the map's file cannot be used.
    """
    assert scene.maps is not None
    given, cloth = getattr(scene.maps, name), scene.cloth
    if cloth.file:
        file = _mesh_of(cloth)
        count, uv, title, shape = len(file.vertices), file.uv, cloth.file, None
    else:
        uv = np.tile(grid.particle_uv(cloth.rows, cloth.columns), (cloth.layers, 1))
        count, title, shape = len(uv), "the sheet", (cloth.layers * cloth.rows, cloth.columns)
    if isinstance(given, str):
        return read_map(shown_path(map_path(given, scene.maps.folder)), count, uv, title, shape)  # errors name it
    return _one_for_each(np.array(given), count, shape, "")


def attachment_ids(scene: Scene, topology: Topology) -> NDArray[np.int64]:
    """Return the index of the attachment of every particle, (N,), −1 if it has none; the last one if it has several."""
    ids = np.full(topology.particle_count, -1)
    for k, attachment in enumerate(scene.attachments):
        ids[attached_particles(scene, topology, attachment.pins)] = k
    return ids


def attached_particles(scene: Scene, topology: Topology, pins: Iterable[str | int]) -> NDArray[np.bool_]:
    """Return which particles the pins include, (N,). Raises PinError for a pin that the cloth does not have."""
    mask = np.zeros(topology.particle_count, bool)
    for pin in pins:
        mask[_particles_of_pin(scene, topology, pin)] = True
    return mask


def check_mesh(cloth: Cloth) -> None:
    """Raise ValueError with a one-line message if the mesh file is not usable as cloth, too small or too large."""
    longest = float(np.ptp(_mesh_of(cloth).vertices, axis=0).max()) * cloth.scale
    if not MIN_SIZE <= longest <= MAX_SIZE:
        raise ValueError(f"the cloth would be {longest:g} m in size, not {MIN_SIZE} to {MAX_SIZE:g} m: change scale")


def build_particles(scene: Scene) -> Topology:
    """Return the cloth at its start, without springs and pins."""
    return _without_pins(scene, [False] * len(DIRECTIONS), 0.0)


def particle_count_text(scene: Scene) -> str:
    """Return the number of particles as text: `30×24`, columns × rows, for a sheet, `1519` for a mesh file."""
    cloth = scene.cloth
    return str(len(_mesh_of(cloth).vertices)) if cloth.file else f"{cloth.columns}×{cloth.rows}"


BYTES_PER_PARTICLE = 1800  # peak memory: 1.5 to 1.8 kB from 100×100 to 300×300 particles, depending on the solver


def particle_count(cloth: Cloth) -> int:
    """Return the number of particles of a cloth."""
    return len(_mesh_of(cloth).vertices) if cloth.file else cloth.rows * cloth.columns * cloth.layers


def too_many_particles(scene: Scene) -> str:
    """Return why a cloth that needs more memory than this machine has is refused, or ""."""
    particles, present = particle_count(scene.cloth), memory_bytes()
    needed = BYTES_PER_PARTICLE * particles
    if present is None or needed <= present:
        return ""
    return (
        f"{particles:,} particles need about {needed / 1e9:.3g} GB of memory, more than the {present / 1e9:.3g} GB of"
        " this machine"
    )


def reason_not_a_grid(scene: Scene) -> str:
    """Return why the cloth of a scene is no grid with complete rows, or ""."""
    if scene.cloth.file:
        return "cloth.file is a mesh without rows"
    return "tearing breaks rows" if scene.tearing is not None else ""


def component_count(scene: Scene) -> int:
    """Return the number of connected components of the cloth."""
    return _mesh_of(scene.cloth).graph_distance[1] if scene.cloth.file else scene.cloth.layers


def _mesh_of(cloth: Cloth) -> ClothMesh:
    return load_cloth_mesh(cloth.file, cloth.folder)


def _without_pins(scene: Scene, directions: Sequence[bool], bending: Bending) -> Topology:
    """Return the cloth without pins, with springs in these of `grid.DIRECTIONS`; of a mesh file, in their families."""
    cloth = scene.cloth
    if cloth.file:
        return build_mesh(
            _mesh_of(cloth),
            scale=cloth.scale,
            center=cloth.center,
            rotation=cloth.rotation,
            area_density=cloth.area_density,
            families={family for (family, _, _), used in zip(DIRECTIONS, directions, strict=True) if used},
            diagonals=cloth.diagonals,
            bending=bending,
        )
    layer = build_sheet(
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
        mass_lumping=cloth.mass_lumping,
        corner_mass=cloth.corner_mass,
        corner_mass_at=cloth.corner_mass_at,
        bending=bending,
    )
    if cloth.layers == 1:
        return layer
    return stack_layers(
        layer,
        cloth.layers,
        spacing=cloth.layer_spacing,
        layer_rotation=cloth.layer_rotation,
        center=cloth.center,
        rotation=cloth.rotation,
        pins=(),
    )


def _particles_of_pin(scene: Scene, topology: Topology, pin: str | int) -> NDArray[np.generic]:
    """Return the particles of one pin, as indices or as a mask, (N,). Raises PinError."""
    cloth, count = scene.cloth, topology.particle_count
    if isinstance(pin, int):
        if not 0 <= pin < count:
            raise PinError(f"{short_repr(pin)} is not a particle: indices run from 0 to {count - 1}")
        return np.array([pin])
    if pin.startswith(REGION):
        return _in_region(scene, topology, pin.removeprefix(REGION))
    if not cloth.file:
        if pin.startswith(GROUP):
            raise PinError(
                f"{short_repr(pin)} needs a mesh file, but the cloth is a sheet: use an edge or {REGION}NAME"
            )
        return pinned_mask_of_layers(cloth.rows, cloth.columns, cloth.layers, [pin])
    groups = _mesh_of(cloth).groups
    if pin in (*EDGES, *CORNERS):
        reason = (
            f"{short_repr(pin)} needs a sheet, but the cloth is {cloth.file}: use {REGION}NAME, {GROUP}NAME or an index"
        )
        raise PinError(reason)
    name = pin.removeprefix(GROUP)
    if name not in groups:
        known = ", ".join(groups) or "none"
        raise PinError(f"{cloth.file} has no group {short_repr(name)}; it has {known}", name, groups)
    return groups[name]


def _in_region(scene: Scene, topology: Topology, name: str) -> NDArray[np.bool_]:
    """Return which particles start in a region, (N,). Raises PinError if there are none, or no such region."""
    regions = {region.name: region for region in scene.regions}
    if name not in regions:
        known = ", ".join(regions) or "none"
        raise PinError(f"[[regions]] has no region {short_repr(name)}; it has {known}", name, regions)
    region, start = regions[name], topology.start
    inside: NDArray[np.bool_] = np.all((start >= region.min) & (start <= region.max), axis=1)
    if (np.array(region.min) > region.max).any():
        raise PinError(f"the min of region {short_repr(name)} exceeds its max: {region.min}, {region.max} m")
    if not inside.any():
        low, high = (", ".join(f"{c:.4g}" for c in end) for end in (start.min(axis=0), start.max(axis=0)))
        raise PinError(f"no particle starts in region {short_repr(name)}: the cloth extends from [{low}] to [{high}] m")
    return inside


def _stiffness_values(scene: Scene, section: str) -> dict[str, float]:
    """Return the stiffness by spring family (`verlet`), or by `STIFFNESS_KEYS` (`fabric`)."""
    if section == "verlet":
        return {family: getattr(scene.verlet, family) for family in ("structural", "shear", "bend")}
    return {name: getattr(scene.fabric, name) for name in STIFFNESS_KEYS}


def _used_directions(scene: Scene, section: str) -> list[bool]:
    """Return which of `grid.DIRECTIONS` have springs. Shear alone adds edges of meshes, and short sides of cells."""
    if model_of(scene, section) != "springs":
        return [family == "structural" for family, _, _ in DIRECTIONS]
    k = _stiffness_values(scene, section)
    if section == "verlet":
        return [k[family] > 0 for family, _, _ in DIRECTIONS]
    stiffness = [k["weft"], k["warp"], k["shear"], k["shear"], k["bend_spring"], k["bend_spring"]]
    cloth = scene.cloth
    if cloth.file:
        stiffness[0] = k["weft"] + k["shear"]
    elif aspect := round(np.log(cell_aspect(cloth.rows, cloth.columns, cloth.width, cloth.height)), 9):
        stiffness[int(aspect < 0)] += k["shear"]
    return [constant > 0 for constant in stiffness]
