"""Writes the meshes of this folder anew: `python assets/meshes/make.py`."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from taichi_cloth.evaluation.validate.drape import rings

HERE = Path(__file__).parent
RINGS, SPOKES = 46, 44
SHEET_RINGS = 22  # 1519 points
DISC_SPOKES = 96
SKIRT_CELL, SKIRT_RINGS = 0.028, (4, 20)  # [m]; rings of the waist and of the hem

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


def circle_skirt() -> tuple[NDArray[np.float64], list[list[int]]]:
    """A circle skirt, cut flat [m]: the rings of a disc from the waist, which stands up by a centimeter, to the hem."""
    points, faces = rings(SKIRT_CELL * np.arange(1, SKIRT_RINGS[1] + 1))
    points[np.hypot(points[:, 0], points[:, 2]) < SKIRT_CELL * (SKIRT_RINGS[0] + 0.5), 1] = 0.01
    inside = 1 + 3 * SKIRT_RINGS[0] * (SKIRT_RINGS[0] - 1)  # points of the rings within the waist
    return points[inside:], (faces[(faces >= inside).all(axis=1)] - inside).tolist()


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


# The ribbon runs along the curve (t³ − 3t, t⁴ − 4t²), which crosses itself three times, over and under itself in turn
# (Shastri, *Polynomial representations of knots*, Tohoku Math. J. 44, 1992). Its width is along z, across the plane of
# the curve, so that it is bent and not stretched.
KNOT_SCALE, RIBBON_CELL, RIBBON_WIDTH = 0.045, 0.0125, 3  # [m], [m], [cells]
LIFT = 0.033  # [m] distance of each crossing part from the plane; twice as much is more than the width
CROSSINGS = (-1.949, -1.732, -0.515, 0.504, 1.732, 1.936)  # parameters t, over and under in turn
BEND, TAIL, KNOT_END = 0.08, 0.2, 2.0  # radius [m] and straight length [m] of each end, and t where it begins


def knot() -> tuple[NDArray[np.float64], list[list[int]]]:
    """A ribbon with a loose overhand knot [m]; its ends are level and point to the left and the right."""
    t = np.linspace(0, KNOT_END, 20_001)
    half = KNOT_SCALE * np.stack([t**3 - 3 * t, t**4 - 4 * t**2], axis=-1)  # the other half is its mirror image
    rise = np.arctan2(4 * KNOT_END**3 - 8 * KNOT_END, 3 * KNOT_END**2 - 3)  # direction of the end
    angle = np.linspace(rise, 0, 2001)[1:]
    arc = half[-1] + BEND * np.stack([np.sin(rise) - np.sin(angle), np.cos(angle) - np.cos(rise)], axis=-1)
    straight = arc[-1] + np.stack([np.linspace(0, TAIL, 2001)[1:], np.zeros(2000)], axis=-1)
    right = np.concatenate([half, arc, straight])
    t = np.concatenate([t, KNOT_END + np.linspace(0, 1, 4001)[1:]])
    x, y = np.concatenate([right[:0:-1] * [-1, 1], right]).T
    t = np.concatenate([-t[:0:-1], t])

    where = np.array([t[0], -KNOT_END - 0.3, *CROSSINGS, KNOT_END + 0.3, t[-1]])
    height = LIFT * np.array([0.3, 0.8, 1, -1, 1, -1, 1, -1, -0.8, -0.3])
    k = np.clip(np.searchsorted(where, t) - 1, 0, len(where) - 2)
    share = (t - where[k]) / (where[k + 1] - where[k])
    z = height[k] + (height[k + 1] - height[k]) * share**2 * (3 - 2 * share)

    curve = np.stack([x, y, z], axis=-1)
    length = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(curve, axis=0), axis=1))])
    even = np.linspace(0, length[-1], round(length[-1] / RIBBON_CELL) + 1)
    middle = np.stack([np.interp(even, length, column) for column in curve.T], axis=-1)
    across = RIBBON_CELL * (np.arange(RIBBON_WIDTH + 1) - RIBBON_WIDTH / 2)
    points = middle[:, None] + across[:, None] * [0.0, 0.0, 1.0]
    index = np.arange(points[..., 0].size).reshape(points.shape[:2])
    quads = np.stack([index[:-1, :-1], index[1:, :-1], index[1:, 1:], index[:-1, 1:]], axis=-1)
    return points.reshape(-1, 3), quads.reshape(-1, 4).tolist()


MESHES = {
    "bust": (bust, "A head on its shoulders"),
    "round": (round_sheet, "A round sheet of radius 1"),
    "skirt": (circle_skirt, "A circle skirt, cut flat: waist of 11 cm, hem of 56 cm"),
    "disc": (disc, "A round plate of radius 1"),
    "knot": (knot, "A ribbon with a loose overhand knot"),
}


def obj(name: str) -> str:
    """The content of an OBJ file."""
    make, what = MESHES[name]
    points, faces = make()
    lines = [f"# {what}; written by make.py."]
    lines += ["v " + " ".join(f"{c:.4f}".rstrip("0").rstrip(".") for c in point + 0.0) for point in points]
    lines += ["f " + " ".join(str(corner + 1) for corner in face) for face in faces]
    return "\n".join(lines) + "\n"


def main() -> None:
    for name in MESHES:
        (HERE / f"{name}.obj").write_text(obj(name), encoding="utf-8", newline="\n")


if __name__ == "__main__":
    main()
