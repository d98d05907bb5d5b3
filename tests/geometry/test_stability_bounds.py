"""The bound of the vibration frequencies: exact where known in closed form, and never too low."""

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import sparse
from scipy.sparse.linalg import eigsh

from taichi_cloth.geometry.stability_bounds import MARGIN, max_frequency, min_rk4_substeps, min_symplectic_substeps
from taichi_cloth.geometry.topology import Topology, build_sheet


def grid(rows: int, columns: int, **changes: Any) -> Topology:
    arguments: dict[str, Any] = {
        "rows": rows,
        "columns": columns,
        "width": 0.1 * (columns - 1),
        "height": 0.1 * (rows - 1),
        "center": (0.0, 0.0, 0.0),
        "rotation": (0.0, 0.0, 0.0),
        "area_density": 0.2,
        "pins": ("top",),
        "directions": (True,) * 6,
    }
    return build_sheet(**{**arguments, **changes})


def test_a_chain_has_its_textbook_frequency() -> None:
    # N equal masses on N equal springs below a pin: ω = 2·√(k/m)·sin((2N − 1)·π/(4N + 2)).
    n = 20
    chain = grid(n + 1, 2, directions=(False, True, False, False, False, False), mass_lumping="uniform")
    expected = 2 * np.sqrt(50.0 / chain.mass[0]) * np.sin((2 * n - 1) * np.pi / (4 * n + 2))
    found = max_frequency(chain, np.full(chain.spring_count, 50.0))
    assert found / MARGIN == pytest.approx(expected, rel=1e-3)


@settings(max_examples=25)
@given(st.integers(2, 8), st.integers(2, 8), st.integers(0, 2**31))
def test_no_shape_of_the_cloth_vibrates_faster(rows: int, columns: int, seed: int) -> None:
    topology = grid(rows, columns, pins=("top-left",))
    random = np.random.default_rng(seed)
    stiffness = 10.0 ** random.uniform(0, 4, topology.spring_count)
    x = random.standard_normal((topology.particle_count, 3))  # crumpled at random
    matrix = np.zeros((topology.particle_count, 3) * 2)
    for (a, b), k in zip(topology.ends, stiffness, strict=True):
        n = (x[b] - x[a]) / np.linalg.norm(x[b] - x[a])
        block = k * np.outer(n, n)
        for i, j, sign in ((a, a, 1), (b, b, 1), (a, b, -1), (b, a, -1)):
            matrix[i, :, j, :] += sign * block
    w = np.where(topology.pinned, 0, 1 / np.sqrt(topology.mass))
    scaled = (matrix * w[:, None, None, None] * w[None, None, :, None]).reshape(w.size * 3, w.size * 3)
    assert np.sqrt(np.linalg.eigvalsh(scaled)[-1]) <= max_frequency(topology, stiffness)


def test_a_cloth_without_springs_or_free_particles_has_no_frequency() -> None:
    assert max_frequency(grid(3, 3, pins=("top", "left", "right", "bottom", 4)), np.ones(40)[:28]) == 0.0
    bare = grid(3, 3, directions=(False,) * 6)
    assert max_frequency(bare, np.zeros(0)) == 0.0
    assert min_symplectic_substeps(0.0, 0.0, 1 / 60) == 1


@pytest.mark.parametrize("damping_time", [1e-4, 1e-2])
def test_the_damped_symplectic_substep_is_the_longest_stable_one(damping_time: float) -> None:
    omega, seconds = 5000.0, 1 / 60
    count = min_symplectic_substeps(omega, damping_time, seconds)

    def largest_root(substeps: int) -> float:
        h = seconds / substeps
        c = h * damping_time * omega**2
        return float(np.abs(np.roots([1, -(2 - c - (h * omega) ** 2), 1 - c])).max())

    assert largest_root(count) <= 1 + 1e-9
    assert largest_root(count - 1) > 1


def test_an_undamped_symplectic_substep_is_below_third_order_resonance() -> None:
    """With h·ω = √3 a mode returns after three steps."""
    frame, count = 1 / 60, min_symplectic_substeps(5000.0, 0.0, 1 / 60)
    assert count == 49  # 5000/60/√3 = 48.1
    turn = np.angle(np.roots([1, -(2 - (5000.0 * frame / 48.1125) ** 2), 1])[0])
    assert abs(turn) == pytest.approx(2 * np.pi / 3, rel=1e-4)


def growth(z: complex) -> float:
    """Return the growth factor of one step of the classical Runge–Kutta method, with z = h·λ."""
    return abs(1 + z + z**2 / 2 + z**3 / 6 + z**4 / 24)


@pytest.mark.parametrize(
    "damping_time", [0.0, *(ratio * 2 / 5000.0 for ratio in (0.01, 0.3, 0.54, 0.99, 1.0, 1.5, 30))]
)
def test_the_runge_kutta_substep_is_stable_for_every_mode_and_not_too_short(damping_time: float) -> None:
    omega, seconds = 5000.0, 10.0

    def largest(substeps: int) -> float:
        modes = omega * np.linspace(1e-3, 1, 500)
        roots = [np.roots([1, damping_time * w**2, w**2]) for w in modes]
        return max(growth(seconds / substeps * root) for pair in roots for root in pair)

    count = min_rk4_substeps(omega, damping_time, seconds)
    assert largest(count) <= 1 + 1e-9
    # The bound is a circle inside the dented stability region: at most 13 % more substeps than needed.
    assert largest(int(count * (0.999 if damping_time == 0 else 0.88))) > 1


def test_the_runge_kutta_substep_without_vibration_is_a_full_frame() -> None:
    assert min_rk4_substeps(0.0, 1e-3, 1 / 60) == 1


@pytest.mark.parametrize(("cells", "limit"), [(32, 3.61e-4), (128, 9.0e-5)])
def test_the_substep_of_a_flat_sheet_is_below_the_limit_of_its_fastest_vibration(cells: int, limit: float) -> None:
    """The limit [s] is 2/ω of a flat sheet of 1 m with 1000, 500 and 100 N/m and equal masses, 2·√(m/(4·(k_s + k_d))).

    The bound holds for crumpled shapes too, so its substep is shorter.
    """
    side = {"width": 1.0, "height": 1.0}
    topology = grid(cells + 1, cells + 1, pins=(), mass_lumping="uniform", **side)
    stiffness = topology.by_family({"structural": 1000.0, "shear": 500.0, "bend": 100.0})
    a, b = topology.ends.T
    gap = (topology.start[b] - topology.start[a])[:, :2]
    normal = gap / np.linalg.norm(gap, axis=1, keepdims=True)
    count = topology.particle_count
    index = np.arange(len(a))
    stretch = sparse.csr_array(
        (
            np.concatenate([normal, -normal]).ravel(),
            (np.repeat(np.tile(index, 2), 2), (2 * np.concatenate([b, a])[:, None] + [0, 1]).ravel()),
        ),
        shape=(len(a), 2 * count),
    )
    matrix = stretch.T @ sparse.diags_array(stiffness) @ stretch / topology.mass[0]
    first = np.random.default_rng(0).standard_normal(2 * count)
    [fastest] = eigsh(matrix, 1, return_eigenvectors=False, v0=first, tol=1e-3)
    exact = 2 / np.sqrt(float(fastest))
    assert exact == pytest.approx(limit, rel=0.01)
    assert 0.8 * exact < 2 / max_frequency(topology, stiffness) < exact
