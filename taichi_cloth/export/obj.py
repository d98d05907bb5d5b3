"""Wavefront OBJ files, as text. NumPy only.

Numbers have nine digits: as many as float32 holds, a millionth of a millimetre a metre away.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ..errors import one_line
from ..files import whole_file
from .sheet import Floats, Sheet


def write_obj(path: Path, sheet: Sheet, x: Floats, normals: Floats | None = None) -> None:
    """Places (N, 3) [m] with texture coordinates, and normals (N, 3) if there are any. Raises OSError.

    Particles keep their order, which is that of the points in a point cache.
    """
    corner = "{0}/{0}" if normals is None else "{0}/{0}/{0}"
    face = "f " + " ".join(corner.replace("0", str(k)) for k in range(3)) + "\n"
    with whole_file(path) as file:
        file.write(f"# taichi_cloth, metres\no {one_line(sheet.name)}\n".encode())
        file.write(_lines("v", x) + _lines("vt", sheet.uv) + (b"s 1\n" if normals is None else _lines("vn", normals)))
        file.write("".join(face.format(*corners) for corners in (sheet.triangles + 1).tolist()).encode())


def _lines(word: str, rows: NDArray[np.float64]) -> bytes:
    line = f"{word}{' %.9g' * rows.shape[1]}\n"
    return (line * len(rows) % tuple(rows.ravel().tolist())).encode()
