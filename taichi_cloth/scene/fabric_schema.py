"""The fabric: stiffness of springs, membranes and weaves, and the colors and patterns of the cloth."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from math import sqrt

from ..system.errors import Mistakes
from .keys import Curve, Table, key_field, keys_of

FABRIC_MODELS = ("springs", "membrane", "weave")
PRESET_NAMES = (  # assets/presets: from light to heavy, first those named after a kind of cloth
    *("silk", "cotton", "denim", "leather", "rubber", "chainmail"),
    *("tango-red-jet-set", "white-dots-on-blk", "gray-interlock", "white-swim-solid", "royal-target"),
    *("navy-sparkle-sweat", "pink-ribbon-brown", "ivory-rib-knit", "camel-ponte-roma", "11oz-black-denim"),
)
MAX_SLOPE = 1e9  # of a curve, as the stiffness of springs [N/m]
PATTERN_NAMES = ("plain", "check", "stripe", "gingham", "twill", "ring")  # render/colors.py


@dataclass(frozen=True)
class VerletSprings(Table):
    """Stiffness of the distance constraints of solver `verlet`. A family of springs with stiffness 0 is left out."""

    structural: float = key_field(
        1.0, "fraction of the length error corrected per iteration, between neighbors", min=0.0, max=1.0
    )
    shear: float = key_field(
        1.0, "fraction of the length error corrected per iteration, on the diagonals of cells", min=0.0, max=1.0
    )
    bend: float = key_field(
        0.2, "fraction of the length error corrected per iteration, between particles two apart", min=0.0, max=1.0
    )


@dataclass(frozen=True)
class Fabric(Table):
    """Stiffness in SI units, for all solvers but `verlet`. Springs with stiffness 0 are left out.

    `warp` and `weft` are those of the structural springs: forces per strain and meter of width, independent of the
    grid. On cells that are not square, springs are scaled so that the cloth is as stiff. In a scene file, a preset sets
    all of these keys but `compression`, and also `area_density` in `[cloth]`, `[verlet]`, and colors and pattern in
    `[look]`. Keys that the file sets take precedence. Only `load_scene` applies a preset.

    A membrane has no springs. If `c11`, `c22`, `c12` and `c66` are all 0, they are those of a grid of springs. A weave
    has the curves of `[weave]`.
    """

    warp: float = key_field(2000.0, "stiffness of the springs along columns", "N/m", min=0.0, max=1e9)
    weft: float = key_field(2000.0, "stiffness of the springs along rows", "N/m", min=0.0, max=1e9)
    shear: float = key_field(1000.0, "stiffness of the springs along the diagonals of cells", "N/m", min=0.0, max=1e9)
    bend_spring: float = key_field(
        20.0,
        "stiffness of the springs between particles two apart; they resist bending nonlinearly",
        "N/m",
        min=0.0,
        max=1e9,
    )
    bending_stiffness: float = key_field(
        0.0, "bending stiffness of the sheet, independent of the grid", "N·m", min=0.0, max=1e6
    )
    bending_weft: float = key_field(0.0, "bending stiffness along the weft; 0: the same", "N·m", min=0.0, max=1e6)
    compression: float = key_field(
        1.0,
        "stiffness of shortened springs as a fraction of their stiffness in tension; 0: yarns go slack",
        min=0.0,
        max=1.0,
        param="COMPRESSION",
    )
    damping_time: float = key_field(
        0.0, "damping coefficient of a spring divided by its stiffness; not in implicit", "s", min=0.0, max=1.0
    )
    model: str = key_field(
        "springs",
        "springs: between neighbors; membrane: triangles of an elastic continuum, with c11, c22, c12 and c66; weave:"
        " threads and their crossings, with the measured curves of [weave]",
        choices=FABRIC_MODELS,
    )
    c11: float = key_field(0.0, "stiffness of the membrane along the warp", "N/m", min=0.0, max=1e9)
    c22: float = key_field(0.0, "stiffness of the membrane along the weft", "N/m", min=0.0, max=1e9)
    c12: float = key_field(
        0.0, "stress along the warp per strain of the weft, and the reverse: Poisson's effect", "N/m", min=-1e9, max=1e9
    )
    c66: float = key_field(0.0, "shear stiffness of the membrane", "N/m", min=0.0, max=1e9)
    warp_angle: float = key_field(
        0.0, "angle from the columns to the warp of a membrane, counterclockwise", "degrees", min=-180.0, max=180.0
    )
    preset: str = key_field(
        "",
        "measured fabric that sets all fabric keys that the scene does not set",
        choices=(*PRESET_NAMES, ""),
    )


@dataclass(frozen=True)
class Weave(Table):
    """Measured curves of woven cloth, for `model = "weave"` in `[fabric]`: pairs [x, y] that increase from [0, 0].

    Between points a curve is linear, and after the last it continues in a straight line. Curves of tension and bending
    are per width of cloth, that of shear per area. Without a curve of bending, threads do not resist it.
    """

    warp: Curve = key_field(
        (), "tension [N/m] of cloth against the strain of threads along columns", axes=("strain", "tension")
    )
    weft: Curve = key_field(
        (), "tension [N/m] of cloth against the strain of threads along rows", axes=("strain", "tension")
    )
    shear: Curve = key_field(
        (), "moment [N/m] of crossings against the shear angle [degrees]", axes=("angle", "moment")
    )
    bending_warp: Curve = key_field(
        (), "bending moment [N] against the curvature [1/m] of threads along columns", axes=("curvature", "moment")
    )
    bending_weft: Curve = key_field(
        (), "bending moment [N] against the curvature [1/m] of threads along rows", axes=("curvature", "moment")
    )


def check_model(fabric: Fabric, weave: Weave | None, mistakes: Mistakes) -> None:
    """Check the keys of a fabric that belong to its model: the tensor of a membrane, the curves of a weave."""
    tensor = {name: getattr(fabric, name) for name in ("c11", "c22", "c12", "c66")}
    if fabric.model == "weave":
        _check_weave(fabric, weave, mistakes)
    elif weave is not None and not mistakes.concern("fabric.model"):
        mistakes.add("weave", 'belongs to a weave: set fabric.model = "weave"')
    if fabric.model != "membrane":
        set_keys = [f"fabric.{name}" for name, value in tensor.items() if value]
        if set_keys:
            mistakes.add(set_keys[0], 'belongs to a membrane: set fabric.model = "membrane"')
        return
    if not any(tensor.values()):
        tensor = {"warp": fabric.warp, "weft": fabric.weft, "shear": fabric.shear}
    for name, value in tensor.items():
        if name != "c12" and value <= 0:
            mistakes.add(f"fabric.{name}", f"must be greater than 0 for a membrane, got {value:g}")
            return
    if abs(fabric.c12) ** 2 >= fabric.c11 * fabric.c22 > 0:
        limit = f"between ±√(c11·c22) = ±{sqrt(fabric.c11 * fabric.c22):g} N/m, else stretching releases energy"
        mistakes.add("fabric.c12", f"must be {limit}, got {fabric.c12:g}")


def _check_weave(fabric: Fabric, weave: Weave | None, mistakes: Mistakes) -> None:
    if fabric.warp_angle:
        mistakes.add(
            "fabric.warp_angle",
            f"must be 0 for a weave, whose threads are the grid's, got {fabric.warp_angle:g}",
        )
    if weave is None:
        if not mistakes.concern("weave"):
            mistakes.add("weave", 'is missing: fabric.model = "weave" needs the curves warp, weft and shear')
        return
    for name, key in keys_of(Weave).items():
        points = getattr(weave, name)
        if not points and name in ("warp", "weft", "shear") and not mistakes.concern(f"weave.{name}"):
            mistakes.add(f"weave.{name}", "is missing: a weave needs the curves warp, weft and shear")
        for (x, y), (x_after, y_after) in pairwise(((0.0, 0.0), *points)):
            if y_after - y > MAX_SLOPE * (x_after - x):
                mistakes.add(f"weave.{name}", f"rises by more than {MAX_SLOPE:g} per {key.axes[0]} after {x:g}")


@dataclass(frozen=True)
class Look(Table):
    """Colors and patterns. They do not affect the motion. A fabric preset sets its own."""

    color: str = key_field("#b5303c", "first color of the pattern", color=True)
    second_color: str = key_field("#e9dcc3", "second color of the pattern", color=True)
    pattern_scale: int = key_field(
        3, "cells per check, per stripe or per half period of a twill; on a mesh file, edges per ring", min=1, max=2048
    )
    pattern: str = key_field("check", "pattern of the two colors", choices=PATTERN_NAMES)
    sheen: float = key_field(0.08, "brightness of the specular highlight", min=0.0, max=1.0)
    pole: bool = key_field(False, "draws a pole along the top edge")
