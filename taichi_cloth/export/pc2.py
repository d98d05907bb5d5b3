"""PC2 point caches (3ds Max; Blender's Mesh Cache): where every point of a mesh is at each sample. NumPy only.

A header of 32 bytes, then x, y, z of every point, sample after sample; all little-endian, float32.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

from ..files import whole_file
from .sheet import Floats

SIGNATURE, VERSION = b"POINTCACHE2\0", 1
START, RATE = 0.0, 1.0  # [frames] the first sample's, and from one to the next
HEADER = "<12siiffi"  # signature, version, points, start, rate, samples


@contextmanager
def pc2_clip(path: Path, particles: int, samples: int) -> Iterator[Callable[[Floats], None]]:
    """A function that writes the next sample, places (N, 3) [m]; it must be called `samples` times.

    The file appears at the end of the block, whole. Raises OSError, and ValueError for another number of samples.
    """
    size = struct.calcsize(HEADER) + 12 * particles * samples
    with whole_file(path) as file:
        file.write(struct.pack(HEADER, SIGNATURE, VERSION, particles, START, RATE, samples))

        def add(x: Floats) -> None:
            file.write(x.astype("<f4").tobytes())

        yield add
        if file.tell() != size:
            raise ValueError(f"{path}: {file.tell()} bytes were written, not {size}")
