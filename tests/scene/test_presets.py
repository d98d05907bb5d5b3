"""Fabric presets: their files, the springs of the same stiffness, and keys that a scene sets itself. No Taichi."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from taichi_cloth.__main__ import main
from taichi_cloth.geometry.scene_loader import load_scene
from taichi_cloth.scene import SceneError, key_table, presets, scene_to_toml
from taichi_cloth.scene.fabric_schema import PRESET_NAMES, Fabric, VerletSprings
from taichi_cloth.scene.presets import (
    asset_folder,
    load_preset,
    membrane_constants_of,
    preset_values,
    spring_stiffness_of,
    with_fabric,
)
from taichi_cloth.scene.schema import Cloth, Scene

constants = st.floats(0.1, 1e6)  # [N/m]

Write = Callable[[str | bytes], Path]
Refuse = Callable[..., SceneError]

# Warp, weft and diagonal constants [N/m], computed by another program.
CONSTANTS = {
    "silk": (2580.62, 940.363, 19.7872),
    "cotton": (8544.7, 6344.5, 55.83),
    "denim": (14891.8, 9291.3, 109.52),
    "leather": (43500.0, 43500.0, 21750.0),
    "rubber": (1267.5, 1267.5, 633.75),
    "chainmail": (1999750.0, 2999750.0, 250.05),
}


def strip_stiffness(warp: float, weft: float, shear: float) -> tuple[float, float, float]:
    """Return the stiffness along warp, weft and 45° of a grid with these springs, by inverting its 3×3 matrix.

    In a cell of side c a spring along the unit vector n with constant k and length l adds k·l²/c²·(n nᵀ)⊗(n nᵀ).
    """
    stiffness = np.zeros((3, 3))
    for constant, length, angle in ((warp, 1, 0), (weft, 1, 90), (shear, 2**0.5, 45), (shear, 2**0.5, -45)):
        x, y = np.cos(np.radians(angle)), np.sin(np.radians(angle))
        strain = np.array([x * x, y * y, x * y])  # of the spring, for strains xx, yy and engineering shear
        stiffness += constant * length**2 * np.outer(strain, strain)
    compliance = np.linalg.inv(stiffness)
    stress = np.array([0.5, 0.5, 0.5])  # unit stress at 45°
    return 1 / compliance[0, 0], 1 / compliance[1, 1], 1 / float(stress @ compliance @ stress)


# -- the files ---------------------------------------------------------------------------------------------


def test_preset_names_are_those_of_the_files() -> None:
    assert set(PRESET_NAMES) == {path.stem for path in (asset_folder() / "presets").glob("*.toml")}


@pytest.mark.parametrize("name", PRESET_NAMES)
def test_every_number_has_a_source(name: str) -> None:
    fabric = load_preset(name)
    assert fabric.title
    stretching = {"tensor"} if "tensor" in fabric.sources else {"warp", "weft", "bias"}
    optional = {"bending_weft", "damping"} | (set() if "tensor" in stretching else {"poisson"})
    found = {key for key in optional if getattr(fabric, key)}
    assert set(fabric.sources) == {"area_density", *stretching, "bending", "verlet"} | found
    assert all(len(source.split()) > 3 for source in fabric.sources.values())
    kinds = {source.split()[0].rstrip(":") for key, source in fabric.sources.items() if key != "verlet"}
    assert kinds <= {"measured", "computed", "estimate", "collected", "textbook"}


ABOVE_0 = "must be a number above 0 and up to 1e+09, got"
GUESS = "value = 0.3\nsource = 'a guess'\n[bending] "


@pytest.mark.parametrize(
    ("name", "old", "new", "message"),
    [
        ("denim", "value = 15000.0\nsource", "value = 15000.0\nno_source", "warp.source: every number needs a source"),
        ("denim", "value = 15000.0", "value = -1", f"warp.value: {ABOVE_0} -1"),
        ("denim", "value = 15000.0", "value = nan", f"warp.value: {ABOVE_0} nan"),
        ("denim", "value = 15000.0", "value = true", f"warp.value: {ABOVE_0} true"),
        ("denim", "value = 15000.0", "worth = 15000.0", f"warp.value: {ABOVE_0} None"),
        ("denim", "structural = 1.0", "structural = 1.5", "verlet.structural: must be a number above 0 and up to 1,"),
        ("denim", "[weft] ", "[woof] ", "must have area_density, bending, bias"),
        ("navy-sparkle-sweat", "c12 = -39.7506", "c12 = nan", "tensor.c12: must be a number above -1e+09 and up to"),
        ("navy-sparkle-sweat", "c66 = 17.6163", "c66 = -1", f"tensor.c66: {ABOVE_0} -1"),
        ("navy-sparkle-sweat", "c11 = 6.54487\n", "", f"tensor.c11: {ABOVE_0} None"),
        ("navy-sparkle-sweat", "[bending] ", f"[poisson]\n{GUESS}", "must have area_density, bending, look, tensor"),
        ("navy-sparkle-sweat", "[bending] ", f"[warp]\n{GUESS}", "must have area_density, bending, look, tensor"),
    ],
)
def test_an_invalid_preset_file_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str, old: str, new: str, message: str
) -> None:
    text = (asset_folder() / "presets" / f"{name}.toml").read_text(encoding="utf-8")
    assert old in text
    (tmp_path / "presets").mkdir()
    (tmp_path / "presets" / f"{name}.toml").write_text(text.replace(old, new, 1), encoding="utf-8")
    monkeypatch.setattr(presets, "asset_folder", lambda: tmp_path)
    with pytest.raises(SceneError) as caught:
        load_preset(name)
    assert f"{name}.toml: {message}" in str(caught.value)


def test_at_least_eight_fabrics_are_measured() -> None:
    """Every number of them is measured, but those of `verlet`, which are not physical quantities."""
    fabrics = [load_preset(name) for name in PRESET_NAMES]
    sources = [[text for key, text in one.sources.items() if key != "verlet"] for one in fabrics]
    assert sum(all(text.startswith("measured: ") for text in texts) for texts in sources) == 10


# -- measured tensors --------------------------------------------------------------------------------------


def test_the_tensor_of_a_measured_fabric_is_that_of_its_file() -> None:
    """Twice c₂₂, c₁₁ and c₁₂ of the data, and c₃₃; a quarter of the bending constants."""
    denim = load_preset("11oz-black-denim")
    found = membrane_constants_of(denim.warp, denim.weft, denim.bias, denim.poisson)
    assert found == pytest.approx((2 * 1013.88629, 2 * 205.352005, 2 * 10.234077, 53.387184), rel=1e-5)
    assert (denim.bending, denim.bending_weft) == pytest.approx((96.951576e-6 / 4, 64.196457e-6 / 4), rel=1e-3)
    assert denim.measured_tensor is None
    assert denim.damping == 0.0


@given(st.floats(0.1, 1e5), st.floats(0.1, 1e5), st.floats(-1e5, 1e5))
def test_a_tensor_is_projected_to_the_nearest_one_that_is_positive_definite(c11: float, c22: float, c12: float) -> None:
    values, vectors = np.linalg.eigh([[c11, c12], [c12, c22]])
    found = presets.positive_definite(c11, c22, c12)
    if values[0] >= presets.MIN_EIGENVALUE * values[1]:
        assert found == (c11, c22, c12)
    nearest = (vectors * np.maximum(values, presets.MIN_EIGENVALUE * values[1])) @ vectors.T
    assert found == pytest.approx((nearest[0, 0], nearest[1, 1], nearest[0, 1]), rel=1e-9, abs=1e-9 * values[1])


@given(constants, constants, constants, st.floats(-0.99, 0.99))
def test_strips_are_the_reverse_of_the_membranes_constants(c11: float, c22: float, c66: float, share: float) -> None:
    tensor = c11, c22, share * (c11 * c22) ** 0.5, c66
    warp, weft, bias, poisson = presets.strips_of(*tensor)
    assert membrane_constants_of(warp, weft, bias, poisson) == pytest.approx(tensor, rel=1e-3)


def test_a_tensor_that_is_not_positive_definite_is_kept_as_measured_and_projected() -> None:
    sweater = load_preset("navy-sparkle-sweat")
    assert sweater.measured_tensor == (6.54487, 24.9727, -39.7506, 17.6163)
    tensor = membrane_constants_of(sweater.warp, sweater.weft, sweater.bias, sweater.poisson)
    eigenvalues = np.linalg.eigvalsh([[tensor[0], tensor[2]], [tensor[2], tensor[1]]])
    assert eigenvalues[0] / eigenvalues[1] == pytest.approx(presets.MIN_EIGENVALUE)
    assert [name for name in PRESET_NAMES if load_preset(name).measured_tensor] == ["navy-sparkle-sweat"]


def test_the_eigenvalues_of_the_other_measured_tensors_are_above_the_bound() -> None:
    """docs/presets.md gives the smallest share."""
    shares = []
    for fabric in map(load_preset, PRESET_NAMES):
        if "tensor" in fabric.sources and fabric.measured_tensor is None:
            c11, c22, c12, _ = membrane_constants_of(fabric.warp, fabric.weft, fabric.bias, fabric.poisson)
            low, high = np.linalg.eigvalsh([[c11, c12], [c12, c22]])
            shares.append(low / high)
    assert len(shares) == 9
    assert f"{min(shares):.2f}" == "0.12"


# -- measured stiffness to springs -------------------------------------------------------------------------


@pytest.mark.parametrize("name", PRESET_NAMES)
def test_spring_stiffness_of_each_preset(name: str) -> None:
    fabric = load_preset(name)
    found = spring_stiffness_of(fabric.warp, fabric.weft, fabric.bias)
    assert found == pytest.approx(CONSTANTS.get(name, found), rel=1e-4)
    assert strip_stiffness(*found) == pytest.approx((fabric.warp, fabric.weft, fabric.bias), rel=1e-9)


@given(constants, constants, constants)
def test_spring_stiffness_is_recovered_from_the_strip_stiffness(warp: float, weft: float, shear: float) -> None:
    # With diagonals far stiffer than a thread, the thread's stiffness is a small difference of large numbers.
    assert spring_stiffness_of(*strip_stiffness(warp, weft, shear)) == pytest.approx(
        (warp, weft, shear), rel=1e-6, abs=1e-6 * max(warp, weft, shear)
    )


def test_a_bias_stiffness_above_that_of_any_grid_is_refused() -> None:
    with pytest.raises(ValueError, match="no grid of springs has 2000, 1000 and 9000 N/m"):
        spring_stiffness_of(2000.0, 1000.0, 9000.0)


def test_a_single_diagonal_is_twice_as_stiff() -> None:
    two, one = [preset_values(load_preset("denim"), Scene(cloth=Cloth(diagonals=count))) for count in (2, 1)]
    shear = two["fabric"]["shear"]
    assert isinstance(shear, float)
    assert one["fabric"] == {**two["fabric"], "shear": 2 * shear}


@pytest.mark.parametrize("name", PRESET_NAMES)
def test_a_membrane_has_the_measured_strips_and_poissons_ratio(name: str) -> None:
    fabric = load_preset(name)
    c11, c22, c12, c66 = membrane_constants_of(fabric.warp, fabric.weft, fabric.bias, fabric.poisson)
    s = np.linalg.inv([[c11, c12, 0.0], [c12, c22, 0.0], [0.0, 0.0, c66]])
    strips = 1 / s[0, 0], 1 / s[1, 1], 4 / (s[0, 0] + s[1, 1] + 2 * s[0, 1] + s[2, 2])
    assert strips == pytest.approx((fabric.warp, fabric.weft, fabric.bias), rel=1e-9)
    assert -s[0, 1] / s[0, 0] == pytest.approx(fabric.poisson)
    assert np.linalg.eigvalsh(s).min() > 0


def test_rubber_keeps_its_volume() -> None:
    fabric = load_preset("rubber")
    assert fabric.poisson == 0.5
    assert fabric.sources["poisson"]
    constants = membrane_constants_of(fabric.warp, fabric.weft, fabric.bias, fabric.poisson)
    assert constants == pytest.approx(np.array([4 / 3, 4 / 3, 2 / 3, 1 / 3]) * fabric.warp)
    assert load_preset("cotton").poisson == 0.0


def test_a_preset_sets_the_tensor_of_membranes_only(write: Write) -> None:
    springs = load_scene(write(GRID + "[fabric]\npreset = 'rubber'"))
    membrane = load_scene(write(GRID + "[fabric]\npreset = 'rubber'\nmodel = 'membrane'\nc66 = 7.0"))
    assert (springs.fabric.c11, springs.fabric.c66) == (0.0, 0.0)
    assert (membrane.fabric.c12, membrane.fabric.c66) == (pytest.approx(2 / 3 * 1690), 7.0)
    denim = with_fabric(membrane, "denim", membrane)
    assert denim.fabric.c22 == pytest.approx(9400.0)
    assert with_fabric(denim, "", membrane).fabric == membrane.fabric


# -- in a scene --------------------------------------------------------------------------------------------

GRID = "[cloth]\nrows = 11\ncolumns = 11\nwidth = 1.0\nheight = 1.0\n"


@pytest.mark.parametrize("name", PRESET_NAMES)
def test_a_scene_gets_the_values_of_its_preset(write: Write, name: str) -> None:
    scene = load_scene(write(GRID + f"[fabric]\npreset = '{name}'"))
    fabric = load_preset(name)
    assert scene.cloth.area_density == fabric.area_density
    springs = CONSTANTS.get(name) or spring_stiffness_of(fabric.warp, fabric.weft, fabric.bias)
    assert (scene.fabric.warp, scene.fabric.weft, scene.fabric.shear) == pytest.approx(springs, rel=1e-4)
    bending = scene.fabric.bend_spring, scene.fabric.bending_stiffness, scene.fabric.bending_weft
    assert bending == (0.0, fabric.bending, fabric.bending_weft)
    assert scene.fabric.damping_time == fabric.damping
    assert scene.verlet == VerletSprings(fabric.structural, fabric.shear, fabric.bend)
    assert scene.fabric.preset == name


def test_an_empty_preset_changes_nothing(write: Write) -> None:
    assert load_scene(write("[fabric]\npreset = ''")) == load_scene(write(""))


def test_keys_of_the_file_take_precedence_over_the_preset(write: Write) -> None:
    path = write(
        "[cloth]\narea_density = 0.3\n[fabric]\nwarp=9\npreset='silk'\nbending_stiffness=0\n[verlet]\nshear=0.7"
    )
    scene, silk = load_scene(path), load_preset("silk")
    assert (scene.cloth.area_density, scene.fabric.warp, scene.fabric.bending_stiffness, scene.verlet.shear) == (
        0.3,
        9,
        0,
        0.7,
    )
    assert scene.fabric.weft == pytest.approx(CONSTANTS["silk"][1], rel=1e-4)
    assert (scene.fabric.damping_time, scene.verlet.bend) == (silk.damping, silk.bend)


def test_a_key_set_to_its_default_takes_precedence_too(write: Write) -> None:
    assert load_scene(write("[fabric]\npreset = 'silk'\nwarp = 2000")).fabric.warp == 2000


def test_overrides_take_precedence_over_the_preset(write: Write) -> None:
    path = write(GRID + "[fabric]\nwarp = 9")
    for key in ("preset", "fabric", "fabric_preset"):
        overrides: dict[str, Any] = {key: "denim"}
        scene = load_scene(path, **overrides)
        assert (scene.fabric.warp, scene.fabric.weft) == pytest.approx(CONSTANTS["denim"][:2], rel=1e-4)
    assert load_scene(path, preset="denim", weft=5.0, area_density=1.0).fabric.weft == 5
    assert load_scene(path, area_density=1.0, preset="denim").cloth.area_density == 1
    path = write(GRID + "[fabric]\npreset = 'silk'")
    assert load_scene(path, fabric="denim") == load_scene(write(GRID + "[fabric]\npreset = 'denim'"))
    assert load_scene(path, fabric="").fabric == Fabric()


def test_an_unknown_preset_is_one_line(
    write: Write, refuse: Refuse, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    path = write("[fabric]\npreset = 'denm'")
    assert str(refuse(path)) == (
        f"{path}: fabric.preset: 'denm' is not one of: {', '.join(PRESET_NAMES)}, \"\" (did you mean 'denim'?)"
    )
    assert refuse("curtain", preset="wool", rows=3).key == "fabric.preset"
    assert refuse("curtain", fabric=3).reason == "must be a string, got 3"
    assert main(["check", str(path)]) == 2
    assert main(["render", "curtain", "--set", "fabric=denm"]) == 2
    printed = capsys.readouterr()
    found, (count, refused) = printed.out.splitlines(), printed.err.splitlines()
    assert count == "taichi-cloth: 1 mistake"
    assert [line.endswith("(did you mean 'denim'?)") for line in (*found, refused)] == [True, True]
    with pytest.raises(SceneError, match="did you mean 'chainmail'"):
        load_preset("chain mail")


@pytest.mark.parametrize("more", [{}, {"warp": 7.5}, {"verlet_bend": 0.0, "diagonals": 1}])
@pytest.mark.parametrize("name", PRESET_NAMES)
def test_a_scene_with_a_preset_is_equal_when_read_back(write: Write, name: str, more: dict[str, Any]) -> None:
    scene = load_scene(write(GRID), preset=name, **more)
    text = scene_to_toml(scene)
    assert f'\npreset = "{name}"\n' in text
    assert load_scene(write(text)) == scene


def test_the_table_of_keys_lists_all_presets() -> None:
    [row] = [row for row in key_table() if row[:2] == ("[fabric]", "preset")]
    assert row[2:5] == ('""', "", f'{", ".join(PRESET_NAMES)}, ""')


def test_list_prints_every_preset_with_its_constants_and_the_kinds_of_their_sources(
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert main(["list", "--presets"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert [line.split()[0] for line in lines[:-1:3]] == list(PRESET_NAMES)
    assert [" ".join(line.split()) for line in lines[6:9]] == [
        "denim Denim: a heavy cotton twill",
        "0.407 kg/m²; warp 15000, weft 9400, bias 430 N/m; bending 6e-05 N·m",
        "computed: area density, weft, bias, damping; collected: warp; measured: bending",
    ]
    row = PRESET_NAMES.index("navy-sparkle-sweat")
    assert "bending 1.1e-05 and 1.5e-05 N·m" in lines[3 * row + 1]
    assert lines[3 * row + 2].endswith("; the tensor, not positive definite as measured, is projected")
    assert max(map(len, lines)) <= 120


def test_a_preset_override_replaces_the_fabric_keys_of_the_file() -> None:
    assert load_scene("curtain").verlet.bend != load_preset("silk").bend
    silk = load_scene("curtain", fabric="silk")
    assert silk.verlet.bend == load_preset("silk").bend
    assert silk.cloth.area_density == load_preset("silk").area_density
    assert load_scene("curtain", verlet_bend=0.3, fabric="silk").verlet.bend == 0.3


def test_a_python_scene_with_the_name_of_a_fabric_is_refused() -> None:
    """No other form works there: the message must not propose one."""
    with pytest.raises(SceneError, match=r'^scene: fabric\.preset: is applied by load_scene only, .* fabric="silk"\)$'):
        Scene(fabric="denim")  # type: ignore[arg-type]


@pytest.mark.parametrize("fabric", [{"preset": "denim"}, Fabric(preset="denim"), Fabric(preset="denim", warp=5.0)])
def test_a_preset_of_a_python_scene_is_refused(fabric: Any) -> None:
    """Its other sections would not have the values of the preset."""
    with pytest.raises(SceneError, match=r"fabric\.preset: is applied by load_scene only, as in tc\.load_scene"):
        Scene(fabric=fabric)
    loaded = load_scene("curtain", fabric=fabric)
    assert loaded.fabric.weft == pytest.approx(CONSTANTS["denim"][1], rel=1e-4)
    own_warp = isinstance(fabric, Fabric) and "warp" in fabric.given_keys
    assert loaded.fabric.warp == pytest.approx(5.0 if own_warp else CONSTANTS["denim"][0], rel=1e-4)
    assert loaded.cloth.area_density == load_preset("denim").area_density
    assert replace(Scene(), fabric=loaded.fabric).fabric == loaded.fabric  # it was applied


def test_a_preset_in_a_dict_with_all_sections_is_applied() -> None:
    assert load_scene({"fabric": {"preset": "denim"}}).fabric.warp > 10_000
    assert Scene(fabric={"preset": ""}).fabric == Fabric()  # type: ignore[arg-type]
