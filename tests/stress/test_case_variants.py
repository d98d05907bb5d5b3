"""Every value of a variant reaches the cloth: no two variants of a case are the same run."""

from collections.abc import Callable
from functools import cache
from typing import Any

import numpy as np
import pytest
from walks import CELLS, STATIC, Walk, small, walk

from taichi_cloth.evaluation.stress import case_catalog, extremes, loads
from taichi_cloth.evaluation.stress.changes import base
from taichi_cloth.evaluation.stress.setup import DENSITY, Setting
from taichi_cloth.evaluation.stress.unit import Case, Variant
from taichi_cloth.geometry.cloth_builder import build_topology, spring_stiffness
from taichi_cloth.scene import Scene
from taichi_cloth.scene.schema import Solver

CASES = {case.number: case for case in case_catalog.CASES}


@pytest.fixture(autouse=True)
def few_cells(serial_layout: None, monkeypatch: pytest.MonkeyPatch) -> None:
    small(monkeypatch)


@cache
def walks(number: int) -> list[Walk]:
    return [walk(variant.run) for variant in CASES[number].variants]


def variant(number: int, name: str) -> Variant:
    [found] = [one for one in CASES[number].variants if one.name == name]
    return found


def test_there_are_forty_cases_with_unique_names() -> None:
    assert list(CASES) == list(range(1, 41))
    assert len({case.name for case in CASES.values()}) == 40
    for case in CASES.values():
        assert len({one.name for one in case.variants}) == len(case.variants) > 0


# Values of the specification, read from the scene that a variant opens last.
KEYS: dict[int, tuple[Callable[[Scene], Any], list[Any]]] = {
    1: (lambda s: (s.fabric.warp, s.fabric.weft, s.fabric.shear), [(10.0**k,) * 3 for k in range(10)]),
    2: (lambda s: s.maps and s.maps.stiffness_max / s.maps.stiffness_min, [pytest.approx(1e4), pytest.approx(1e6)]),
    3: (
        lambda s: (s.cloth.corner_mass / DENSITY * CELLS**2, s.cloth.corner_mass_at),
        [(pytest.approx(times * CELLS**2 / 32**2), "bottom-right") for times in (10, 100, 1000, 10_000)],
    ),
    17: (
        lambda s: s.spheres[0].keyframes[1][3] / s.spheres[0].keyframes[1][0],
        [pytest.approx(v) for v in (5, 20, 50, 100)],
    ),
    18: (
        lambda s: (s.spheres[0].collide_with, s.spheres[0].radius, s.spheres[0].center[:2]),
        [(against, 0.01, pytest.approx((0.5 / CELLS,) * 2)) for against in ("particles", "triangles")],
    ),
    19: (lambda s: (s.spheres[0].radius, s.spheres[0].friction), [(0.3, 0.0)]),
    20: (lambda s: s.spheres[0].radius, [1.0]),
    21: (lambda s: s.spheres[0].radius, [0.3, 1e-3]),
    22: (lambda s: (s.spheres[0].radius, s.spheres[0].center), [(0.15, pytest.approx((-0.5, 0.4, 0.0)))]),
    23: (  # balls of 0.3 m, 1 m apart: they touch after 0.2 m each, and overlap by 0.1 m after 0.25 m
        lambda s: [(ball.radius, [abs(key[3]) for key in ball.keyframes]) for ball in s.spheres],
        [[(0.3, pytest.approx([0, 0.2, 0.2, 0.25, 0.25, 0]))] * 2],
    ),
    25: (lambda s: (s.cloth.rows, s.cloth.columns), [*case_catalog.GRIDS]),
    26: (lambda s: s.forces.gravity, [0.0, -9.81, 1e3, 1e5, 9.81]),
    27: (lambda s: s.wind and (s.wind.x, s.wind.z, s.wind.turbulence), [(0.0, 100.0, 0.0)]),
    28: (lambda s: s.wind and (s.wind.x, s.forces.gravity), [(2.0, 0.0), (2.0, 0.0)]),
    33: (lambda s: s.cloth.center, [(away, away, 0.0) for away in (100.0, 1000.0, 10_000.0)]),
    35: (
        lambda s: (s.planes[0].friction, -s.planes[0].rotation[2]),
        [(mu, slope) for slope in (30, 89) for mu in (0, 1, 10, 1e6)],
    ),
    36: (
        lambda s: (s.spheres[0].radius, s.spheres[0].friction, s.spheres[0].keyframes[1]),
        [(0.3, 0.4, (8.0, 0, 0, 0, 0, 8 * 180.0, 0))],
    ),
    37: (lambda s: (s.solver.damping, s.fabric.damping_time), [(0, 0), (1e6, 0), (2.0, 0), (0, 1.0)]),
    38: (
        lambda s: (s.strain_limit and s.strain_limit.strain, s.forces.gravity),
        [(0.01, pytest.approx(98.1)), (0.001, pytest.approx(98.1))],
    ),
}


@pytest.mark.parametrize("number", KEYS)
def test_the_values_of_the_variants_are_in_their_scenes(number: int) -> None:
    read, expected = KEYS[number]
    assert [read(one.scenes[-1]) for one in walks(number) if one.scenes] == expected


def test_the_stiffness_of_verlet_increases_with_the_decades() -> None:
    shares = [one.scenes[0].verlet.structural for one in walks(1)]
    assert shares == pytest.approx(np.linspace(0.1, 1.0, 10))


def test_verlet_whose_shares_are_no_constants_is_judged_by_the_base_sheet() -> None:
    verlet = Setting("verlet", Solver("verlet", 2, 1))
    for one in CASES[1].variants:
        assert walk(one.run).rest_scenes == [None]
        [still] = walk(one.run, setting=verlet).rest_scenes
        assert still is not None
        assert (still.fabric.warp, still.fabric.shear) == (1000.0, 1000.0)
    for name, first, last in (("k ×1e3", 1e-3, 1.0), ("k /1e3", 1.0, 1e-3)):
        one = walk(variant(31, name).run, setting=verlet)
        assert [scene.verlet.structural for scene in one.scenes] == pytest.approx([first, last])
        assert {scene.fabric.warp for scene in (*one.scenes, *one.rest_scenes) if scene} == {1000.0}
        usual = base().verlet
        for scene in one.scenes:
            share = scene.verlet.structural / usual.structural
            assert (scene.verlet.shear, scene.verlet.bend) == pytest.approx((share * usual.shear, share * usual.bend))


def test_one_half_of_the_sheet_is_stiffer() -> None:
    for ratio, one in zip((1e4, 1e6), walks(2), strict=True):
        scene = one.scenes[0]
        topology = build_topology(scene, "fabric")
        constants = spring_stiffness(scene, "fabric", topology) / topology.by_family(dict.fromkeys(FAMILIES, 1.0))
        ends = topology.start[topology.ends]
        x = ends[..., 0]
        inside = ~np.any(
            np.all(np.isclose(np.abs(ends[..., :2]), 0.5), axis=1), axis=1
        )  # springs along an edge have half
        left, right = (constants[side & inside] for side in ((x < -1e-6).all(axis=1), (x > 1e-6).all(axis=1)))
        assert left == pytest.approx(1000.0 * ratio)
        assert right == pytest.approx(1000.0)
        assert len(left) == len(right) > 0


FAMILIES = ("structural", "shear", "bend")


def test_one_free_corner_is_heavy() -> None:
    lightest, *_, heaviest = (build_topology(one.scenes[0], "fabric") for one in walks(3))
    assert np.flatnonzero(heaviest.mass - lightest.mass).tolist() == [heaviest.particle_count - 1]
    assert not heaviest.pinned[-1]
    assert heaviest.mass[-1] - lightest.mass[-1] == pytest.approx((10_000 - 10) * extremes.PARTICLE)


def test_the_refreshes_of_a_rate() -> None:
    for rate in (240, 120, 60, 30, 10):
        assert extremes.at_rate(rate)[-1] == pytest.approx(10.0)
        assert np.diff(extremes.at_rate(rate)) == pytest.approx(1 / rate)
    display, time_step = walks(4)
    assert display.frames == pytest.approx(4 * 600 + 400, abs=5)  # at 10 Hz the clock keeps 4 of 6 frames
    assert (time_step.frames, time_step.settled) == (0, 5)


def test_pins_move_by_the_given_distances() -> None:
    for times, one in zip((2, 5, 10), walks(7), strict=True):
        assert max(np.ptp(x[:, 0]) for x in one.pins) == pytest.approx(times)
        assert len(one.pins) == 12  # a tenth of a second each way
    for span, one in zip((0.1, 0.0, -0.5), walks(8), strict=True):
        assert min(x[1, 0] - x[0, 0] for x in one.pins) == pytest.approx(span, abs=1e-6)
    for one in (*walks(7), *walks(8)):
        assert np.ptp(one.pins[-1][:, 0]) == pytest.approx(1.0)


def loose(one: Walk) -> np.ndarray:
    """Return the positions of the free particles at the first start."""
    return one.started[0][~build_topology(one.scenes[0], "fabric").pinned]


def test_a_collapsed_sheet_is_at_one_point() -> None:
    point, micrometre, millimetre = (loose(one) for one in walks(9))
    assert (point == point[0]).all()
    assert 1e-7 < micrometre.std(axis=0).min() < micrometre.std(axis=0).max() < 1e-5
    assert 1e-4 < millimetre.std(axis=0).min() < millimetre.std(axis=0).max() < 1e-2
    for one in walks(9):
        assert np.array_equal(one.started[0], one.started[1])
        assert one.settled == 4  # after five and after ten seconds, twice


def test_a_flattened_sheet_is_flat() -> None:
    line, mirrored = (loose(one) for one in walks(10))
    assert (line[:, 1:] == 0).all()
    assert np.ptp(line[:, 0]) == pytest.approx(1.0)
    assert mirrored[:, 0].min() >= 0.0
    assert np.ptp(mirrored[:, 1]) == pytest.approx(1.0)


def test_a_random_start_depends_on_the_seed() -> None:
    one, other = (loose(walk(loads.random_start, seed)) for seed in (1, 2))
    assert np.abs(one).max() <= 0.5
    assert one.std(axis=0) == pytest.approx(np.full(3, 12**-0.5), rel=0.4)
    assert abs(np.corrcoef(one.ravel(), other.ravel())[0, 1]) < 0.5
    at_rest = build_topology(walk(loads.random_start).scenes[0], "fabric").start[CELLS + 1 :]
    assert np.linalg.norm(one - at_rest, axis=1).mean() > 0.3


def test_noise_has_the_given_size() -> None:
    for size, one in zip((1e-3, 0.1), walks(12), strict=True):
        free = ~build_topology(one.scenes[0], "fabric").pinned
        off = (one.started[0] - build_topology(one.scenes[0], "fabric").start)[free]
        assert off.std() == pytest.approx(size, rel=0.3)


def test_neighboring_columns_are_swapped() -> None:
    [one] = walks(13)
    columns = one.started[0].reshape(CELLS + 1, CELLS + 1, 3)[-1, :, 0]
    assert columns == pytest.approx(np.linspace(-0.5, 0.5, CELLS + 1)[[1, 0, 3, 2, 5, 4, 7, 6, 8]])


def test_the_wind_crosses_the_sheet_in_one_variant_only() -> None:
    still, crossing = ([value for name, value in one.sets if name == "wind_z"] for one in walks(28))
    assert set(still) == {0.0}
    assert min(crossing) < -0.01 < 0.01 < max(crossing)
    assert crossing[-1] == 0.0


def test_gravity_changes_its_sign_in_each_frame() -> None:
    signs = [value for name, value in walks(26)[-1].sets if name == "gravity"]
    assert signs == [9.81 * (-1) ** k for k in range(121)]


def test_a_yank_moves_the_grab_by_ten_meters_in_a_frame() -> None:
    [one] = walks(29)
    assert [target[2] - one.grabs[0][2] for target in one.grabs] == pytest.approx([0.0, 10.0, 0.0])
    assert one.rest == [0.05]


def test_the_wind_blows_five_times() -> None:
    [one] = walks(27)
    assert [value for name, value in one.sets if name == "wind"] == [1.0, 0.0] * 5 + [0.0]
    assert one.frames == 300


def test_a_tablecloth_is_pulled_at_a_meter_per_second() -> None:
    sizes = [(side, mu) for side in (CELLS + 1, 9, 5) for mu in (0.3, 0.03)]
    for (side, mu), one in zip(sizes, walks(39), strict=True):
        scene = one.scenes[0]
        assert scene.self_collision is not None
        assert (scene.cloth.layers, scene.self_collision.friction, scene.boxes[0].friction) == (2, mu, 0.0)
        assert (scene.cloth.rows, scene.cloth.columns, scene.cloth.width, scene.cloth.height) == (side, side, 1, 1)
        (start, *still), (end, *moved) = scene.attachments[0].keyframes
        assert (start, end - start, still, moved) == (1.0, 1.5, [0, 0, 0], [1.5, 0, 0])
        assert scene.attachments[0].pins == tuple(range(side - 1, side * side, side))
        assert scene.cloth.pins == ()


def test_a_ball_is_teleported_into_the_sheet_and_grows_within_a_frame() -> None:
    teleported, grown = walks(21)
    (t, *start), (arrives, *there), *_ = teleported.scenes[0].spheres[0].keyframes
    assert arrives - t < 1e-3
    assert there[2] - start[2] == pytest.approx(5.01)
    assert [value for name, value in grown.sets if name == "sphere_radius"] == [0.5, 1e-3]


def test_changes_reach_the_cloth() -> None:
    stiffer, softer, heavier, substeps, toggled, _ = walks(31)
    assert [one.scenes[1].fabric.warp / one.scenes[0].fabric.warp for one in (stiffer, softer)] == pytest.approx(
        [1e3, 1e-3]
    )
    assert heavier.scenes[1].cloth.area_density == pytest.approx(100 * heavier.scenes[0].cloth.area_density)
    assert [value for name, value in substeps.sets if name == "substeps"] == [20, 1]
    assert [len(scene.spheres) for scene in toggled.scenes] == [0, 1, 0, 1, 0, 1, 0]


def test_bad_input_has_the_named_numbers() -> None:
    assert [one.name for one in CASES[30].variants] == ["nan", "inf", "-inf"]
    for one in walks(30):
        assert one.broken == []


def test_ten_layers_are_rotated_and_spaced() -> None:
    for side, one in zip((CELLS + 1, 13), walks(15), strict=True):
        cloth, contact = one.scenes[0].cloth, one.scenes[0].self_collision
        assert (cloth.layers, cloth.layer_spacing, cloth.layer_rotation) == (10, 0.1, 9.0)
        assert (cloth.rows, cloth.columns, cloth.width, cloth.height) == (side, side, 1, 1)
        assert contact is not None
        assert contact.thickness == pytest.approx(0.9 / (side - 1))
        assert one.scenes[0].spheres[0].radius == 0.3
    cloths = [one.scenes[0].cloth for one in walks(16)]
    sizes = [(cloth.layers, cloth.rows, cloth.columns, cloth.width) for cloth in cloths]
    assert sizes == [(50, side, side, (side - 1) / CELLS) for side in (CELLS + 1, 7)]


def test_edges_twist_by_two_turns_each_and_back() -> None:
    [one] = walks(14)
    assert len(one.pins) == 1200
    corner = np.array([x[0, 1:] for x in one.pins])
    turned = np.unwrap(np.arctan2(corner[:, 1], corner[:, 0]))
    assert abs(turned[599] - turned[0]) == pytest.approx(4 * np.pi * 599 / 600, rel=1e-6)
    assert np.abs(np.diff(turned)) == pytest.approx(np.radians(72) / 60)
    assert one.pins[-1] == pytest.approx(build_topology(one.scenes[0], "fabric").start[[*LEFT_AND_RIGHT]], abs=1e-6)


LEFT_AND_RIGHT = sorted((CELLS + 1) * row + column for row in range(CELLS + 1) for column in (0, CELLS))


def test_the_long_run_has_the_frames_of_the_list() -> None:
    hanging, swinging = case_catalog.LONG.variants
    assert isinstance(case_catalog.LONG, Case)
    assert "1,000,000 frames hanging" in case_catalog.LONG.parameters
    assert "100,000 swinging" in case_catalog.LONG.parameters
    assert (hanging.run.args[1], swinging.run.args[1]) == (1_000_000, 100_000)  # type: ignore[attr-defined]
    assert (extremes.HANGING_FRAMES, extremes.SWINGING_FRAMES) == (3600, 3600)  # a minute each
    assert "--soak" in CASES[32].note


WEIGHT = 0.2 * 9.81  # [N] of the sheet of 1 m²; its springs have 1000 N/m
# What a case allows beyond the bounds of every case: distance from the start positions [m], for each scene it opens.
FAR: dict[int, list[list[float]]] = {
    1: [[8 * WEIGHT / 10**k] for k in range(10)],
    3: [[4 * WEIGHT * times / 1024 / 1000] for times in (10, 100, 1000, 10_000)],
    7: [[4.0], [10.0], [20.0]],
    16: [[2.0], [2.0]],
    17: [[1.0]] * 4,
    18: [[1.0]] * 2,
    25: [[]] * 5 + [[2.0]] * 8,
    26: [[0.0], [4 * WEIGHT / 1000], [4 * 200 / 1000], [4 * 20_000 / 1000], [0.0]],
    27: [[15.0]],
    29: [[10.0]],
    31: [[8 * WEIGHT / 1000], [8 * WEIGHT], [8 * 100 * WEIGHT / 1000], [0.0], [0.0], [0.0]],
}
# Strain at rest instead of the static one and 1 %, of all variants. That of case 22 has a test of its own.
REST_STRAIN: dict[int, list[float]] = {
    11: [0.05],
    28: [STATIC + 0.01] * 2,
    29: [0.05],
    38: [cap + 4 * 2.0**-23 * 32 for cap in (0.01, 0.001)],
    39: [0.01] * 6,
}
# Cloth whose static strain counts instead of that of the scene: (warp [N/m], gravity [m/s²]) of sheets hung by the top.
HUNG: dict[int, list[tuple[float, float] | None]] = {
    17: [(1000, 9.81)] * 4,
    18: [(1000, 9.81)] * 2,
    21: [(1000, 9.81)] * 2,
    23: [(1000, 9.81)],
    24: [None, (1000, 9.81), (1000, 9.81), None],
    26: [(1000, 0.0), (1000, 9.81), (1000, 1e3), (1000, 1e5), None],
    27: [(1000, 9.81)],
    31: [(1e6, 9.81), (1, 9.81), (1000, 9.81), (1000, 9.81), (1000, 9.81), (1000, 9.81)],
}
WALKED = [number for number in CASES if number not in (6, 40)]


@pytest.mark.parametrize("number", WALKED)
def test_only_the_typed_cases_may_go_far_or_have_another_strain_at_rest(number: int) -> None:
    opened = [one for one in walks(number) if one.scenes]
    far = [pytest.approx(expected) for expected in FAR.get(number, [[0.0] * len(one.far) for one in walks(number)])]
    assert [one.far for one in walks(number)] == far
    strains = [one.rest[0] for one in opened]
    if number != 22:
        assert strains == [pytest.approx(strain) for strain in REST_STRAIN.get(number, [None] * len(opened))]
    hung = [one.rest_scenes[0] for one in opened]
    assert [scene and (scene.fabric.warp, abs(scene.forces.gravity)) for scene in hung] == HUNG.get(
        number, [None] * len(opened)
    )
    for one in opened:
        assert len(set(one.rest)) == len(set(map(id, one.rest_scenes))) == 1  # the same each time it opens the scene
    for scene in filter(None, hung):
        assert (scene.wind, scene.cloth.layers, scene.strain_limit) == (None, 1, None)
        assert scene.cloth.pins == ("top",) or scene.cloth.file


@pytest.mark.parametrize("number", WALKED)
def test_only_frames_with_more_substeps_may_take_longer(number: int) -> None:
    limits = {one.name: found.limits for one, found in zip(CASES[number].variants, walks(number), strict=True)}
    longer = [pytest.approx(1000 / 30 * rate / 60) for rate in (240, 120)] + [pytest.approx(1000 / 30)] * 3
    expected = {4: {"display": [], "time step": longer}}
    assert limits == expected.get(number, {name: [] for name in limits})


@pytest.mark.parametrize("number", WALKED)
def test_every_variant_ends_at_rest_or_is_refused(number: int) -> None:
    for one in walks(number):
        assert one.settled >= len(one.started)
        assert one.settled or [figure.what for figure in one.figures] == ["refused"]
