"""Makes walker.obj, a figure, walker.pc2, its walk on the spot, and walker_clothes.obj, a skirt and a cape. NumPy only.

The figure is the smooth union of capsules, as a quad mesh with one vertex in each cell that its surface crosses (naive
surface nets: Gibson 1998, *Constrained elastic surface nets*). Each vertex follows the bones near it (linear blend
skinning). The trunk moves as the attachments of `walker.toml` do, so that clothes pinned to it stay on the skin.
"""

from pathlib import Path

import numpy as np

HERE = Path(__file__).parent
CELL = 0.031  # [m]
BLEND = 0.03  # [m] over which capsules merge
SKIN = 0.015  # [m] distance over which the influence of a bone falls to 1/e
RATE, PERIOD = 20, 1.2  # samples per second, seconds of two steps
WAIST = np.array([0.0, 1.0, 0.0])  # center of the trunk's motion
SWAY, BOB, ROLL = 0.015, 0.025, np.radians(2.0)  # amplitudes of the trunk [m, m, rad]

HIP, KNEE, ANKLE, TOE = (0.09, 0.92, 0.0), (0.10, 0.51, 0.01), (0.10, 0.09, -0.01), (0.11, 0.05, 0.13)
SHOULDER, ELBOW, WRIST, HAND = (0.17, 1.40, 0.0), (0.28, 1.15, -0.01), (0.35, 0.93, 0.03), (0.37, 0.84, 0.05)


def mirrored(point: tuple[float, float, float], side: int) -> tuple[float, float, float]:
    return (side * point[0], point[1], point[2])


def capsules() -> list[tuple[str, tuple[float, ...], tuple[float, ...], float, float]]:
    """Return bone, ends and radii at the ends of every capsule [m]."""
    parts = [
        ("trunk", (0.0, 0.95, 0.0), (0.0, 1.12, 0.0), 0.125, 0.11),
        ("trunk", (0.0, 1.12, 0.0), (0.0, 1.32, 0.0), 0.11, 0.13),
        ("trunk", (-0.06, 1.36, 0.0), (0.06, 1.36, 0.0), 0.10, 0.10),
        ("trunk", (0.0, 1.40, 0.0), (0.0, 1.55, 0.01), 0.055, 0.05),
        ("trunk", (0.0, 1.62, 0.01), (0.0, 1.68, 0.0), 0.085, 0.095),
    ]
    for side, name in ((-1, "left"), (1, "right")):
        at = [mirrored(point, side) for point in (HIP, KNEE, ANKLE, TOE, SHOULDER, ELBOW, WRIST, HAND)]
        hip, knee, ankle, toe, shoulder, elbow, wrist, hand = at
        parts += [
            ("trunk", (0.05 * side, 0.93, 0.0), hip, 0.11, 0.09),
            (f"{name} thigh", hip, knee, 0.085, 0.06),
            (f"{name} shin", knee, ankle, 0.058, 0.042),
            (f"{name} shin", ankle, toe, 0.042, 0.04),
            ("trunk", (0.08 * side, 1.38, 0.0), shoulder, 0.08, 0.06),
            (f"{name} arm", shoulder, elbow, 0.055, 0.044),
            (f"{name} forearm", elbow, wrist, 0.043, 0.034),
            (f"{name} forearm", wrist, hand, 0.034, 0.036),
        ]
    return parts


def distance(points: np.ndarray, a: tuple, b: tuple, radius_a: float, radius_b: float) -> np.ndarray:
    """Return the distance to a capsule whose radius changes along it [m]."""
    start, axis = np.array(a), np.subtract(b, a)
    t = np.clip((points - start) @ axis / (axis @ axis), 0, 1)
    return np.linalg.norm(points - start - t[:, None] * axis, axis=1) - radius_a - t * (radius_b - radius_a)


def figure(points: np.ndarray) -> np.ndarray:
    """Return the distance to the smooth union of all capsules [m]."""
    parts = np.array([distance(points, *capsule[1:]) for capsule in capsules()])
    return -BLEND / 4 * np.log(np.exp(-parts / (BLEND / 4)).sum(axis=0))


def surface_net() -> tuple[np.ndarray, np.ndarray]:
    """Return vertices (V, 3) [m] and quads (Q, 4) of the figure, counter-clockwise seen from outside."""
    low, high = np.array([-0.55, -0.06, -0.25]), np.array([0.55, 1.85, 0.30])
    axes = [np.arange(a, b, CELL) for a, b in zip(low, high, strict=True)]
    nodes = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)
    values = figure(nodes.reshape(-1, 3)).reshape(nodes.shape[:3])
    inside = values < 0
    cells = tuple(n - 1 for n in values.shape)
    total, count = np.zeros((*cells, 3)), np.zeros(cells)

    def at_corner(field: np.ndarray, corner: tuple[int, ...]) -> np.ndarray:
        return field[tuple(slice(c, c + n) for c, n in zip(corner, cells, strict=True))]

    for first in np.ndindex(2, 2, 2):
        for axis in (k for k in range(3) if first[k] == 0):  # the edges of each cell
            second = tuple(c + (k == axis) for k, c in enumerate(first))
            crosses = at_corner(inside, first) != at_corner(inside, second)
            change = at_corner(values, first) - at_corner(values, second)
            share = at_corner(values, first) / np.where(crosses, change, 1.0)
            edge = at_corner(nodes, second) - at_corner(nodes, first)
            total += np.where(crosses[..., None], at_corner(nodes, first) + share[..., None] * edge, 0.0)
            count += crosses
    active = count > 0
    number = np.full(cells, -1)
    number[active] = np.arange(active.sum())
    vertices = total[active] / count[active][:, None]
    quads = []
    for axis in range(3):
        u, v = (axis + 1) % 3, (axis + 2) % 3
        ahead = np.roll(inside, -1, axis=axis)
        crossing = inside != ahead
        crossing[tuple(slice(-1, None) if k == axis else slice(None) for k in range(3))] = False
        for at in np.argwhere(crossing):
            ring = []
            for du, dv in ((0, 0), (-1, 0), (-1, -1), (0, -1)):
                cell = at.copy()
                cell[u] += du
                cell[v] += dv
                ring.append(number[tuple(cell)])
            quads.append(ring if inside[tuple(at)] else ring[::-1])
    return vertices, np.array(quads)


def weights(vertices: np.ndarray) -> tuple[list[str], np.ndarray]:
    """Return the names of the bones, and their weights of every vertex, (V, bones)."""
    names = list(dict.fromkeys(capsule[0] for capsule in capsules()))
    near = np.full((len(vertices), len(names)), np.inf)
    for name, *shape in capsules():
        k = names.index(name)
        near[:, k] = np.minimum(near[:, k], distance(vertices, *shape))
    shares = np.exp(-np.maximum(near, 0.0) / SKIN)
    return names, shares / shares.sum(axis=1, keepdims=True)


def turn(point: tuple[float, float, float], angle: float, axis: int = 0) -> np.ndarray:
    """Return the 4×4 rotation about an axis through a point."""
    cosine, sine = np.cos(angle), np.sin(angle)
    u, v = (axis + 1) % 3, (axis + 2) % 3
    matrix = np.eye(4)
    matrix[u, u] = matrix[v, v] = cosine
    matrix[u, v], matrix[v, u] = -sine, sine
    matrix[:3, 3] = np.array(point) - matrix[:3, :3] @ point
    return matrix


def bones(phase: float) -> dict[str, np.ndarray]:
    """Return the pose of every bone at a phase of the walk [rad]."""
    trunk = turn(tuple(WAIST), ROLL * np.sin(phase), axis=2)
    trunk[:3, 3] += SWAY * np.sin(phase), BOB * np.sin(2 * phase + np.pi / 2), 0.0
    poses = {"trunk": trunk}
    for side, name, own in ((-1, "left", phase), (1, "right", phase + np.pi)):
        swing = np.radians(-20.0 * np.sin(own) - 4.0)
        bend = np.radians(6.0 + 48.0 * max(0.0, np.cos(own + 0.35)) ** 2)
        thigh = trunk @ turn(mirrored(HIP, side), swing)
        arm = trunk @ turn(mirrored(SHOULDER, side), np.radians(18.0 * np.sin(own)))
        forearm = np.radians(-18.0 + 10.0 * np.sin(own))
        poses |= {f"{name} thigh": thigh, f"{name} shin": thigh @ turn(mirrored(KNEE, side), bend)}
        poses |= {f"{name} arm": arm, f"{name} forearm": arm @ turn(mirrored(ELBOW, side), forearm)}
    return poses


def grid_faces(rows: int, columns: int, first: int, *, closed: bool) -> list[tuple[int, ...]]:
    """Return the quads of a grid of vertices from number `first` on; `closed` around each row."""
    faces = []
    for r in range(rows - 1):
        for k in range(columns if closed else columns - 1):
            here, after = first + r * columns + k, first + r * columns + (k + 1) % columns
            faces.append((here, here + columns, after + columns, after))
    return faces


def clothes() -> tuple[np.ndarray, list[tuple[int, ...]]]:
    """Return vertices and quads of a skirt, 50 cm long, and a cape, 62 cm long."""
    rows, columns = 17, 72
    around, down = 2 * np.pi * np.arange(columns) / columns, np.linspace(0, 1, rows)[:, None]
    wide, deep = 0.150 + 0.20 * down, 0.145 + 0.20 * down
    skirt = np.broadcast_arrays(wide * np.sin(around), 1.04 - 0.50 * down, deep * np.cos(around))
    length, across = 29, 33
    angle, drop = np.linspace(1.0, -1.0, across), np.linspace(0, 1, length)[:, None]
    cape = np.broadcast_arrays(
        (0.19 + 0.10 * drop) * np.sin(angle), 1.42 - 0.62 * drop, -(0.145 + 0.10 * drop) * np.cos(angle)
    )
    faces = grid_faces(rows, columns, 0, closed=True) + grid_faces(length, across, rows * columns, closed=False)
    return np.concatenate([np.stack(part, axis=-1).reshape(-1, 3) for part in (skirt, cape)]), faces


def write_obj(path: Path, vertices: np.ndarray, faces: list[tuple[int, ...]] | np.ndarray) -> None:
    lines = [f"v {x:.5f} {y:.5f} {z:.5f}" for x, y, z in vertices]
    lines += ["f " + " ".join(str(corner + 1) for corner in face) for face in faces]
    path.write_text(f"# made by {Path(__file__).name}\n" + "\n".join(lines) + "\n", encoding="utf-8")


def main() -> None:
    vertices, quads = surface_net()
    names, shares = weights(vertices)
    homogeneous = np.hstack([vertices, np.ones((len(vertices), 1))])
    samples = round(RATE * PERIOD)
    points = []
    for k in range(samples):
        poses = bones(2 * np.pi * k / samples)
        moved = np.array([homogeneous @ poses[name].T for name in names])[..., :3]
        points.append(np.einsum("vb,bvk->vk", shares, moved))
    write_obj(HERE / "walker.obj", vertices, quads)
    header = b"POINTCACHE2\0" + np.array([1, len(vertices)], "<i4").tobytes()
    header += np.array([0.0, 1.0], "<f4").tobytes() + np.array([samples], "<i4").tobytes()
    (HERE / "walker.pc2").write_bytes(header + np.array(points, "<f4").tobytes())
    write_obj(HERE / "walker_clothes.obj", *clothes())
    print(f"{len(vertices)} vertices, {2 * len(quads)} triangles, {samples} samples")


if __name__ == "__main__":
    main()
