"""Checkpoints: all that moves in a simulation, as a NumPy .npz file."""

from __future__ import annotations

import io
import re
import zipfile
from collections import Counter
from math import prod
from os import PathLike
from typing import TYPE_CHECKING, Any, BinaryIO

import numpy as np
from numpy.lib import format as npy
from numpy.typing import NDArray

from ..scene import scene_to_toml
from ..scene.parameters import check_parameter
from ..state.field_pool import upload_all
from ..system.errors import one_line, short_repr
from ..system.files import atomic_file
from .frame_contact import displacement_array, displacements_from_array
from .grabbing import grab_arrays, grabs_from_arrays, restored_grab
from .parameter_values import check_vectors

if TYPE_CHECKING:
    from .simulation import Simulation

Arrays = dict[str, NDArray[Any]]

MOVED = "displacements"  # of colliders
VARYING = (MOVED, "grabbed", "grabbed_at", "grabs", "grab_paths")  # in length
FOLDER = re.compile(r'^(file|clip|pin|stiffness|max_distance) = "[^"]*[/\\]', re.MULTILINE)  # of a mesh or map file
MAX_BYTES = 1 << 24  # of what may vary: a scene's text, four bytes a character, and the grabs


def write_checkpoint(simulation: Simulation, path: str | PathLike[str] | BinaryIO) -> None:
    """Write a checkpoint to a path, where it appears whole or not at all, or to an open file. Raises OSError."""
    content = checkpoint_bytes(simulation)
    if isinstance(path, str | PathLike):
        with atomic_file(path) as file:
            file.write(content)
    else:
        path.write(content)


def checkpoint_bytes(simulation: Simulation) -> bytes:
    """Return the content of a checkpoint file. Raises UsageError within a frame."""
    simulation.check_between_frames()
    content = io.BytesIO()
    text = np.array(scene_to_toml(simulation.scene))
    np.savez(content, allow_pickle=False, scene=text, **state_arrays(simulation))
    return content.getvalue()


def state_arrays(simulation: Simulation) -> Arrays:
    """Return all that moves in a simulation."""
    cloth = simulation.cloth
    return {
        "x": cloth.to_numpy(cloth.x),
        "x_prev": cloth.to_numpy(cloth.x_prev),
        "velocity": cloth.to_numpy(cloth.velocity),
        "frame": np.array(simulation.frame, np.int64),
        "torn": simulation.torn,
        "depenetration": simulation.depenetration.reduction.copy(),
        "params": np.array(list(simulation.params.values_by_name.values()), np.float64),
        "wind_on": np.array(simulation.params.wind_on),
        "pinned": simulation.topology.pinned,
        "origin": simulation.origin,
        MOVED: displacement_array(simulation.displacements),
        **grab_arrays(simulation.grabs),
    }


def read_checkpoint(simulation: Simulation, source: str | PathLike[str] | BinaryIO | bytes) -> None:
    """Set the simulation's state from a path, an open file, or the content of one.

    Raises OSError if it cannot be read, and ValueError if it is not a checkpoint of this scene; nothing changes then.
    """
    name = str(source) if isinstance(source, str | PathLike) else "checkpoint"
    older = {MOVED: np.zeros((0, 7)), "origin": simulation.topology.origin}
    arrays = _read(name, source, scene_to_toml(simulation.scene), state_arrays(simulation), older)
    try:
        restore(simulation, arrays)
    except ValueError as error:
        raise ValueError(f"{name}: damaged: {error}") from None


def restore(simulation: Simulation, arrays: Arrays) -> None:
    """Set the simulation's state to one of its own scene, as `state_arrays` returned it.

    Raises ValueError, and changes nothing, for numbers that do not belong there.
    """
    known = simulation.params.known().values()
    numbers = zip(known, arrays["params"].tolist(), strict=True)
    values = {
        parameter.name: check_parameter(parameter, int(v) if parameter.is_int and v == int(v) else v)
        for parameter, v in numbers
    }
    grabs = grabs_from_arrays(arrays, simulation.topology.particle_count)
    displacements = displacements_from_array(arrays[MOVED], len(simulation.depenetration.reduction))
    for key in ("x", "x_prev", "velocity", "grabbed_at", "grab_paths", "origin", MOVED):
        check_vectors(arrays[key], key, arrays[key].shape)
    if arrays["frame"] < 0:
        raise ValueError(f"frame is {arrays['frame']}")
    simulation.set_pins(arrays["pinned"])
    simulation.params.values_by_name = values
    simulation.params.wind_on = bool(arrays["wind_on"])
    simulation.depenetration.reduction[:] = arrays["depenetration"]
    simulation.displacements = displacements
    simulation.set_torn(arrays["torn"])
    simulation.set_frame(int(arrays["frame"]))
    simulation.set_origin(arrays["origin"])
    upload_all(*((getattr(simulation.cloth, key), arrays[key]) for key in ("x", "x_prev", "velocity")))
    simulation.find_pairs()
    simulation.set_grabs({number: restored_grab(grab, simulation.grabs.get(number)) for number, grab in grabs.items()})


def _read(
    name: str, source: str | PathLike[str] | BinaryIO | bytes, scene_text: str, like: Arrays, older: Arrays
) -> Arrays:
    """Return the arrays of a checkpoint of the same scene.

    Scenes may name mesh and map files in other folders, as one that `save_scene` wrote does; only their names count.
    `like`: those of the present state. `older`: values of those that older checkpoints do not have.

    Raises ValueError naming the first line in which the scenes differ. Allocates nothing for what is too large.
    """
    scene_text = _without_folders(scene_text)
    limit = 2 * (MAX_BYTES + sum(array.nbytes for array in like.values()))
    arrays = {}
    try:
        if isinstance(source, str | PathLike):
            with open(source, "rb") as file:
                content = file.read(limit + 1)
        else:
            content = source if isinstance(source, bytes) else source.read(limit + 1)
        if len(content) > limit:
            raise ValueError(f"it is larger than {limit} bytes")
        with zipfile.ZipFile(io.BytesIO(content)) as archive:
            theirs = _without_folders(str(_entry(archive, "scene", np.array(""))))
            if theirs == scene_text:
                stored = {name.removesuffix(".npy") for name in archive.namelist()}
                arrays = {key: _entry(archive, key, like[key]) for key in like if key in stored or key not in older}
                arrays = older | arrays
    except OSError:
        raise
    except Exception as error:  # the readers of zip, deflate and NumPy headers raise a dozen kinds
        raise ValueError(f"{name}: not a checkpoint ({one_line(str(error))})") from None
    if theirs != scene_text:
        raise ValueError(f"{name}: a checkpoint of another scene{_first_difference(theirs, scene_text)}")
    for key, array in arrays.items():
        if not np.isfinite(array).all():
            raise ValueError(f"{name}: damaged: {key} is not finite")
    return arrays


def _first_difference(theirs: str, ours: str) -> str:
    """Return the first line in which the TOML text of the scene of a checkpoint differs from that of this scene."""
    its, own = _lines_by_key(theirs), _lines_by_key(ours)
    for (table, key), line in [*its.items(), *own.items()]:
        here, there = own.get((table, key)), its.get((table, key))
        if here != there:
            what = (
                f"it has {short_repr(line)}, this one has not" if here is None else f"this one has {short_repr(line)}"
            )
            if here is not None and there is not None:
                what = f"it has {short_repr(there)}, this one {short_repr(here)}"
            where = f", in {table[0]}" if key and table[0] else ""
            return f": {what}{where}; switch to its solver, fabric or scene before loading"
    return ""


def _lines_by_key(scene_text: str) -> dict[tuple[tuple[str, int], str], str]:
    """Return the lines of a scene by table, with its number among those of its name, and key; "" for the table."""
    table, tables, lines = ("", 0), Counter[str](), {}
    for line in filter(None, scene_text.splitlines()):
        key = line.partition(" = ")[0]
        if line.startswith("["):
            table, key = (line, tables[line]), ""
            tables[line] += 1
        lines[table, key] = line
    return lines


def _without_folders(scene_text: str) -> str:
    return FOLDER.sub(r'\1 = "', scene_text)


def _entry(archive: zipfile.ZipFile, name: str, like: NDArray[Any]) -> NDArray[Any]:
    """Return one array, read only if its header has the type and shape of `like`. Raises ValueError and others."""
    with archive.open(f"{name}.npy") as stream:
        header = npy.read_array_header_1_0 if npy.read_magic(stream) == (1, 0) else npy.read_array_header_2_0
        shape, _, dtype = header(stream)
    same_type = dtype == like.dtype or dtype.kind == like.dtype.kind == "U"
    varies = name in VARYING and len(shape) == like.ndim
    same_shape = shape == like.shape or (varies and shape[1:] == like.shape[1:])
    if not (same_type and same_shape) or prod(shape) * dtype.itemsize > max(like.nbytes, MAX_BYTES):
        raise ValueError(f"{name} is {dtype} of shape {shape}, not {like.dtype} of shape {like.shape}")
    with archive.open(f"{name}.npy") as stream:
        array: NDArray[Any] = npy.read_array(stream, allow_pickle=False)
    return array
