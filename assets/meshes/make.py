"""Writes the meshes of this folder anew: `python assets/meshes/make.py`."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from taichi_cloth.mesh.rings import rings

HERE = Path(__file__).parent
RINGS, SPOKES = 46, 44
SHEET_RINGS = 22  # 1519 points
DISC_SPOKES = 96

# Sections of a head on its shoulders and a foot: height, half width, half depth, and how far forward its middle is [m].
SECTIONS = """
    0.000 0.115 0.105 0.000
    0.020 0.118 0.108 0.000
    0.045 0.080 0.074 0.000
    0.075 0.058 0.056 0.000
    0.105 0.070 0.064 0.000
    0.140 0.130 0.088 0.000
    0.190 0.175 0.105 0.004
    0.250 0.198 0.108 0.002
    0.295 0.190 0.098 0.000
    0.325 0.145 0.085 0.000
    0.350 0.085 0.070 0.004
    0.385 0.058 0.061 0.008
    0.425 0.054 0.060 0.012
    0.450 0.058 0.075 0.024
    0.490 0.070 0.092 0.026
    0.540 0.078 0.100 0.018
    0.580 0.077 0.098 0.010
    0.615 0.066 0.084 0.006
    0.640 0.046 0.058 0.004
    0.655 0.022 0.028 0.003
"""
# What stands out of the face: height, angle from straight ahead [radians], spread of both, and how far [m].
FEATURES = ((0.497, 0.0, 0.014, 0.13, 0.024), (0.520, 0.0, 0.016, 0.09, 0.012), (0.456, 0.0, 0.012, 0.25, 0.010))
HOLLOWS = ((0.520, 0.38, 0.014, 0.20, -0.008), (0.520, -0.38, 0.014, 0.20, -0.008))


def bust() -> tuple[NDArray[np.float64], list[list[int]]]:
    """Points [m] and faces, counted from 0: rings of quads between two ends."""
    table = np.array(SECTIONS.split(), float).reshape(-1, 4)
    fine = np.linspace(0, table[-1, 0], 400)
    padded = np.pad(
        np.stack([np.interp(fine, table[:, 0], table[:, k]) for k in (1, 2, 3)]), ((0, 0), (10, 10)), "edge"
    )
    smooth = np.stack([np.convolve(row, np.hanning(21) / np.hanning(21).sum(), "valid") for row in padded])
    heights = np.linspace(0, table[-1, 0], RINGS)
    wide, deep, ahead = (np.interp(heights, fine, row)[:, None] for row in smooth)
    angle = np.linspace(0, 2 * np.pi, SPOKES, endpoint=False)
    out = np.zeros((RINGS, SPOKES))
    for height, where, tall, broad, far in (*FEATURES, *HOLLOWS):
        off = (angle - where + np.pi) % (2 * np.pi) - np.pi
        out += far * np.exp(-(((heights[:, None] - height) / tall) ** 2) - (off / broad) ** 2)
    x, z = wide * np.sin(angle), (deep + out) * np.cos(angle) + ahead
    rings = np.stack([x, np.broadcast_to(heights[:, None], x.shape), z], axis=-1).reshape(-1, 3)
    ends = [[0.0, 0.0, 0.0], [0.0, table[-1, 0] + 0.004, 0.003]]
    index = np.arange(RINGS * SPOKES).reshape(RINGS, SPOKES)
    right = np.roll(index, -1, axis=1)
    quads = np.stack([index[:-1], right[:-1], right[1:], index[1:]], axis=-1).reshape(-1, 4).tolist()
    low, high = RINGS * SPOKES, RINGS * SPOKES + 1
    below = [[low, b, a] for a, b in zip(index[0], right[0], strict=True)]
    above = [[high, a, b] for a, b in zip(index[-1], right[-1], strict=True)]
    return np.concatenate([rings, ends]), quads + below + above


def round_sheet() -> tuple[NDArray[np.float64], list[list[int]]]:
    """A level disc of radius 1. Its faces run counter-clockwise, seen from above."""
    points, faces = rings(np.arange(1, SHEET_RINGS + 1) / SHEET_RINGS)
    return points, faces.tolist()


def disc() -> tuple[NDArray[np.float64], list[list[int]]]:
    """A solid round plate of radius 1 and thickness 0.1: quads around, and a fan above and below."""
    angle = np.linspace(0, 2 * np.pi, DISC_SPOKES, endpoint=False)
    low, high = (np.stack([np.cos(angle), np.full(len(angle), y), -np.sin(angle)], axis=-1) for y in (-0.05, 0.05))
    index = np.arange(DISC_SPOKES)
    right, bottom, top = np.roll(index, -1), 2 * DISC_SPOKES, 2 * DISC_SPOKES + 1
    around = np.stack([index, right, right + DISC_SPOKES, index + DISC_SPOKES], axis=-1).tolist()
    below = [[bottom, b, a] for a, b in zip(index, right, strict=True)]
    above = [[top, a + DISC_SPOKES, b + DISC_SPOKES] for a, b in zip(index, right, strict=True)]
    return np.concatenate([low, high, [[0.0, -0.05, 0.0], [0.0, 0.05, 0.0]]]), around + below + above


MESHES = {
    "bust": (bust, "A head on its shoulders"),
    "round": (round_sheet, "A round sheet of radius 1"),
    "disc": (disc, "A round plate of radius 1"),
}


def main() -> None:
    for name, (make, what) in MESHES.items():
        points, faces = make()
        lines = [f"# {what}; written by make.py."]
        lines += ["v " + " ".join(f"{c:.4f}".rstrip("0").rstrip(".") for c in point + 0.0) for point in points]
        lines += ["f " + " ".join(str(corner + 1) for corner in face) for face in faces]
        (HERE / f"{name}.obj").write_text("\n".join(lines) + "\n")


if __name__ == "__main__":
    main()
