"""Clips of deforming meshes: the points of a mesh over time, from PC2 files, OBJ sequences or USD files. NumPy only.

Positions between two samples are interpolated linearly. The readers check everything that a simulation relies on: the
number of points, finite numbers, and at least one sample.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..scene.collider_schema import Mesh
from ..scene.presets import mesh_path
from ..system.files import Version, file_version
from .obj_reader import FARTHEST, MAX_POINTS, ObjError, read_obj

Floats = NDArray[np.float64]
Samples = list[NDArray[np.floating[Any]]]  # (points, 3) each

MAX_BYTES = 1_000_000_000  # of all samples of a clip
PC2_HEADER = struct.Struct("<12siiffi")  # signature, version, points, start frame, sampling rate, samples
PC2_SIGNATURE = b"POINTCACHE2\0"
USD_SUFFIXES = (".usd", ".usda", ".usdc", ".usdz")


@dataclass(frozen=True, eq=False)
class MeshClip:
    """The points of a mesh at equal intervals, in the unit of the file."""

    samples: NDArray[np.float32]
    """(samples, points, 3)."""
    rate: float
    """Samples per second."""
    loops: bool
    """Whether the first sample follows the last; otherwise the last one stays."""

    def at(self, seconds: float) -> Floats:
        """Return the points at a time [s], (points, 3)."""
        count, position = len(self.samples), seconds * self.rate
        position = position % count if self.loops else min(max(position, 0.0), count - 1.0)
        k = min(int(position), count - 1)
        share = position - k
        after = (k + 1) % count if self.loops else min(k + 1, count - 1)
        points: Floats = (1 - share) * self.samples[k].astype(np.float64) + share * self.samples[after]
        return points


def clip_of(mesh: Mesh, points: int) -> MeshClip:
    """Return the clip of a deforming mesh whose file has this number of points. It is cached (`file_version`).

    Raises ValueError with a one-line message if the clip cannot be used.
    """
    path = clip_path(mesh)
    return MeshClip(*_cached(path, file_version(path), points, mesh.clip_rate), mesh.clip_loop)


def clip_path(mesh: Mesh) -> Path:
    """Return the absolute path of the clip of a mesh, with a `*` for a sequence of files."""
    return mesh_path(mesh.file, mesh.folder).absolute().parent / mesh.clip


@lru_cache(maxsize=16)
def _cached(path: Path, version: Version, points: int, rate: float) -> tuple[NDArray[np.float32], float]:
    """Return the samples of a clip and their number per second."""
    if "*" in path.name:
        samples = _read_sequence(path)
    elif path.suffix == ".pc2":
        samples = _read_pc2(path)
    elif path.suffix in USD_SUFFIXES:
        samples, rate = _read_usd(path)
    else:
        raise _error(path, f"is no clip: use a .pc2 file, a USD file ({', '.join(USD_SUFFIXES)}), or walk_*.obj")
    for k, sample in enumerate(samples):
        if sample.shape != (points, 3):
            raise _error(path, f"sample {k} has {len(sample)} points, but the mesh has {points}")
        if not np.isfinite(sample).all() or np.abs(sample).max() > FARTHEST:
            bad = int(np.argmax(~(np.abs(sample) <= FARTHEST).all(axis=1)))
            raise _error(path, f"point {bad} of sample {k} is {sample[bad].tolist()}: not finite, or too far away")
    return np.array(samples, np.float32), rate


def _error(path: Path, reason: str) -> ObjError:
    return ObjError(path, 0, reason)


def _read_sequence(pattern: Path) -> Samples:
    """Return the vertices of all OBJ files that match, in the order of their names."""
    files = sorted(pattern.parent.glob(pattern.name))
    if not files:
        raise _error(pattern, "no file matches")
    return [read_obj(file)[0] for file in files]


def _read_pc2(path: Path) -> Samples:
    """Return the samples of a PC2 point cache."""
    try:
        with path.open("rb") as file:
            content = file.read(MAX_BYTES + 1)
    except (OSError, ValueError) as error:
        raise _error(path, f"cannot be read: {getattr(error, 'strerror', None) or error}") from None
    if len(content) > MAX_BYTES:
        raise _error(path, f"is larger than {MAX_BYTES} bytes")
    if len(content) < PC2_HEADER.size or not content.startswith(PC2_SIGNATURE):
        raise _error(path, "is no PC2 point cache")
    _, version, points, _, _, samples = PC2_HEADER.unpack_from(content)
    if version != 1 or not 0 < points <= MAX_POINTS or samples < 1:
        raise _error(path, f"is a PC2 point cache of version {version} with {points} points and {samples} samples")
    expected = PC2_HEADER.size + 12 * points * samples
    if len(content) != expected:
        raise _error(path, f"has {len(content)} bytes, but {samples} samples of {points} points are {expected}")
    return list(np.frombuffer(content, "<f4", offset=PC2_HEADER.size).reshape(samples, points, 3))


def _read_usd(path: Path) -> tuple[Samples, float]:
    """Return the samples of the first mesh of a USD file whose points move, and their number per second."""
    try:
        from pxr import Usd, UsdGeom
    except ImportError:
        raise _error(path, "needs the package usd-core: pip install '.[usd]'") from None
    if not path.is_file():
        raise _error(path, "cannot be read: No such file or directory")
    try:
        stage = Usd.Stage.Open(str(path))
    except Exception as error:  # the errors of USD have several lines
        raise _error(path, f"cannot be read: {str(error).splitlines()[0]}") from None
    for prim in stage.Traverse():
        attribute = UsdGeom.Mesh(prim).GetPointsAttr()
        times = attribute.GetTimeSamples() if prim.IsA(UsdGeom.Mesh) else []
        if len(times) > 1:
            steps = np.diff(times)
            if np.ptp(steps) > 1e-6 * steps.mean():
                raise _error(path, f"the samples of {prim.GetPath()} are not at equal intervals")
            samples = [np.array(attribute.Get(time), np.float32) for time in times]
            return samples, float(stage.GetTimeCodesPerSecond() / steps.mean())
    raise _error(path, "has no mesh whose points have time samples")
