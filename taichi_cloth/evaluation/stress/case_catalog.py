"""All stress cases, in the order of the report."""

from __future__ import annotations

from functools import partial
from math import inf, nan

from . import changes, contact, extremes, layered_cloth, loads
from .changes import MESHES
from .unit import Case, Variant, variants

GRIDS = ((2, 2), (2, 3), (3, 2), (3, 3), (2, 8), (8, 2), (2, 1000), (1000, 2))  # rows and columns of particles
TOO_SMALL = ((1, 1), (1, 2), (2, 1), (1, 8), (8, 1))
RECOVERS = (
    "recovery is judged as rest is, by strain and speed; the shape is not compared, because springs that resist"
    " compression have several rest shapes"
)
SET_PINS = "pins are set at the start of each frame and jump there, which is harder than to move them within it"


def long_run(hanging: int, swinging: int) -> Case:
    """Return case 32 with these numbers of frames."""
    return Case(
        32,
        "long run",
        f"{hanging:,} frames hanging (drift < 0.1 mm after 20 s), {swinging:,} swinging undamped",
        (
            *variants(extremes.hanging, {"hanging": hanging}),
            *variants(extremes.swinging, {"swinging": swinging}),
        ),
        note=(
            f"the usual run has {hanging:,} frames hanging and {swinging:,} swinging, so that every method and start"
            f" can be run; `--soak` has {extremes.LONG_HANGING:,} and {extremes.LONG_SWINGING:,}, as the list; drift"
            " counts from 20 s on, when damping has ended the motion of the disturbed start"
        )
        if hanging < extremes.LONG_HANGING
        else "",
    )


LONG = long_run(extremes.LONG_HANGING, extremes.LONG_SWINGING)

CASES = (
    Case(
        1,
        "stiffness sweep",
        "1 to 1e9 N/m by decades, from two corners; speed < 20 m/s",
        variants(extremes.stiffness_sweep, {f"1e{k} N/m": 10.0**k for k in range(10)}),
        note="`verlet` has no constants: its shares go from 0.1 to 1 with the decades, and its bound on the strain is"
        " that of the sheet with 1000 N/m",
    ),
    Case(
        2,
        "stiffness ratio",
        "the springs of half the sheet ×1e4, ×1e6",
        variants(extremes.stiffness_ratio, {"1e4": 1e4, "1e6": 1e6}),
        note="`verlet` has no constants: the shares of both halves are in this ratio",
    ),
    Case(
        3,
        "mass ratio",
        "a weight on one free corner of 10 to 1e4 particles; strain reported",
        variants(extremes.mass_ratio, {f"×{times:g}": float(times) for times in (10, 100, 1000, 10_000)}),
    ),
    Case(
        4,
        "frame rates",
        "240, 120, 60, 30 and 10 frames per second; simulated time keeps up, the sag alike within 2 %",
        (Variant("display", extremes.frame_rates), Variant("time step", extremes.time_steps)),
        note=(
            "the program advances in frames of 1/60 s whatever a display does, so the rate of a display changes how"
            " many frames a picture has and not the step; below 15 Hz the clock drops time by design, which is"
            " reported. The variant `time step` has the substeps of each rate instead; `explicit` and `rk4` would raise"
            " too few, so they have their longest stable substep at 10 frames per second"
        ),
    ),
    Case(
        5,
        "uneven rates",
        "pictures 1/144 and 1/20 s apart, a second missed",
        (Variant("1/144 and 1/20 s", extremes.uneven_rates),),
        note=(
            "the program advances in frames of 1/60 s whatever a display does, and after a stall the clock drops all"
            " but four of them by design: the time simulated must be what is left"
        ),
    ),
    Case(
        6,
        "paused",
        "100 pictures at one time through clock, session and drawing; equal bits, then and a second later",
        (Variant("100 pictures", extremes.paused),),
        note="a clock that has not advanced runs no frame, so there is never a substep of 0 s",
    ),
    Case(
        7,
        "pins apart",
        "×2, ×5, ×10 in 0.1 s, held 1 s, back; strain within 0.1 % of the static one",
        variants(loads.pins_apart, {"×2": 2.0, "×5": 5.0, "×10": 10.0}),
        note=f"{SET_PINS}; they return to their places in 0.1 s and stay pinned: a sheet without pins would fall",
    ),
    Case(
        8,
        "pins together",
        "to 10 %, 0, past each other, and back",
        variants(loads.pins_together, {"to 10 %": 0.1, "to 0": 0.0, "past each other": -0.5}),
        note=f"{SET_PINS}; {RECOVERS}",
    ),
    Case(
        9,
        "collapsed start",
        "all particles but the pins at one point, or as near; twice for ten seconds, with equal bits",
        variants(loads.collapsed, {"one point": 0.0, "1 µm": 1e-6, "1 mm": 1e-3}),
    ),
    Case(
        10,
        "flattened start",
        "all in a line; one half on the other",
        variants(loads.flattened, {"in line": "in line", "mirrored": "mirrored"}),
    ),
    Case(
        11,
        "random start",
        "anywhere in a box of 1 m; strain < 5 % at the end",
        (Variant("uniform", loads.random_start),),
    ),
    Case(
        12,
        "noise",
        "places off by 1 mm, by 0.1 m",
        variants(loads.noise, {"1 mm": 1e-3, "0.1 m": 0.1}),
        note=RECOVERS,
    ),
    Case(
        13,
        "inverted cells",
        "every second column changes its place with the next; no intersections at the end",
        (Variant("columns", loads.inverted),),
    ),
    Case(
        14,
        "twist",
        "two edges by 720° each, at 72°/s, and back; no intersections at the end, the shape within 1 cm",
        (Variant("720°", layered_cloth.twist),),
        note=f"{SET_PINS}; intersections on the way are only recorded: the specification forbids them only for methods"
        " that claim to prevent them",
    ),
    Case(
        15,
        "layers",
        "10 sheets, 0.1 m apart, turned by 9° each, and a ball on top; gap ≥ half the thickness",
        variants(layered_cloth.layers, {"10 sheets": None, "10 sheets of 13×13": 12}),
        note=(
            "sheets of 13×13 particles also, which cost less; colliders have prescribed motion, so the ball is pressed"
            " a thickness deep into the pile and does not rest on it by its weight; it must end within a thickness of"
            " the pile; gaps are measured every 30 frames, because that takes longer than a frame"
        ),
    ),
    Case(
        16,
        "many layers",
        "50 sheets on a bar; none falls off, as fast as any other case",
        variants(layered_cloth.many_layers, {"50 sheets": None, "50 sheets of 7×7": 6}),
        note="sheets of 7×7 particles also, with cells of the same size; no method is fast enough for them either, and"
        " the specification bounds only the time; gaps and intersections at the end are only recorded",
    ),
    Case(
        17,
        "fast ball",
        "radius 0.1 m at 5 to 100 m/s; goes through no particle",
        variants(contact.fast_ball, {f"{speed} m/s": float(speed) for speed in (5, 20, 50, 100)}),
        note="a particle may be 1 m farther away than usual, because the ball takes it along",
    ),
    Case(
        18,
        "small fast ball",
        "radius 1 cm at 20 m/s at the middle of a cell of 3 cm; reports whether it passes through",
        variants(contact.small_ball, {"against particles": "particles", "against triangles": "triangles"}),
        note="a particle may be 1 m farther away than usual, because the ball takes it along",
    ),
    Case(
        19,
        "fast cloth",
        "at 100 m/s against a ball; never faster, to rounding, none through",
        (Variant("100 m/s", contact.fast_cloth),),
        note="without gravity, which would make the sheet faster than it was thrown",
    ),
    Case(
        20,
        "engulfed",
        "a ball of 1 m around all of it; out at 2 m/s at most",
        (Variant("1 m", layered_cloth.engulfed),),
        note="without gravity, which would add to the speed of what the ball pushes out",
    ),
    Case(
        21,
        "teleported ball",
        "at once within the cloth, or at once large; out at 2 m/s at most",
        (Variant("teleported", layered_cloth.teleported), Variant("0 to 0.5 m", layered_cloth.inflated)),
        note="the ball is gone again after six seconds: no independent code computes the rest shape on it; a radius of"
        " 0 is refused, so `0 to 0.5 m` starts with 1 mm",
    ),
    Case(
        22,
        "ball on a pin",
        "the pin 5 cm inside; it stays, no buzz",
        (Variant("5 cm", layered_cloth.ball_on_pin),),
        note="geometry stretches the two springs from the pin around the ball: the bound of the static strain plus 1 %"
        " applies to springs off the ball",
    ),
    Case(
        23,
        "squeeze",
        "between two balls that close to a gap of 0, then to 10 cm of overlap",
        (Variant("0, then 10 cm", layered_cloth.squeeze),),
        note=f"{RECOVERS}; whether the sheet slips out is not judged: it hangs by its top edge, and cannot leave balls"
        " that close on its middle",
    ),
    Case(
        24,
        "degenerate mesh",
        "doubled points, springs of no length, triangles of no area and of 1:1e4: refused by name, or alive",
        (
            *variants(extremes.degenerate, {kind: kind for kind in MESHES}),
            Variant("1:1e4 cells", extremes.flat_cells),
            Variant("particles together", extremes.coincident_particles),
        ),
    ),
    Case(
        25,
        "tiny grids",
        "1×1 to 1×8 and 8×1 (refused), 2×2 to 2×1000 and 1000×2",
        (
            *variants(extremes.too_small, {f"{rows}×{columns}": (rows, columns) for rows, columns in TOO_SMALL}),
            *variants(extremes.tiny, {f"{rows}×{columns}": (rows, columns) for rows, columns in GRIDS}),
        ),
        note="cells are 3 cm wide, and a particle may be 2 m away, which on the smallest grids binds nothing",
    ),
    Case(
        26,
        "gravity",
        "0, upwards, 1e3, 1e5 m/s², another sign each frame",
        (
            *variants(loads.gravity, {"0": 0.0, "upwards": -9.81, "1e3 m/s²": 1e3, "1e5 m/s²": 1e5}),
            Variant("sign flips", loads.gravity_flips),
        ),
    ),
    Case(
        27,
        "gusts",
        "100 m/s for half a second, five times",
        (Variant("100 m/s", loads.gusts),),
        note=f"{RECOVERS}; a particle may be 15 m farther away than usual, because the wind blows it",
    ),
    Case(
        28,
        "edge-on wind",
        "a taut sheet, 2 m/s in its plane, and crossing it; chatter < 1 mm/s",
        variants(loads.edge_on_wind, {"n·v = 0": 0.0, "crossing zero": 0.01}),
        note=(
            "the sheet is taut between two edges, without gravity: one that hangs has free edges, and those flutter in"
            " any edge-on wind, which is motion and not chatter. While it blows, chatter is a quarter of the second"
            " difference of velocities between frames: all of an oscillation from frame to frame, half of one of 15 Hz"
        ),
    ),
    Case(
        29,
        "yank",
        "a grabbed particle goes 10 m in a frame, and back; strain < 5 % at the end",
        variants(loads.yank, {"10 m": 10.0}),
    ),
    Case(
        30,
        "bad input",
        "not a number, infinite, negative, unknown; refused by name, nothing changes",
        variants(changes.bad_input, {"nan": nan, "inf": inf, "-inf": -inf}),
    ),
    Case(
        31,
        "changes in mid run",
        "k ×1e3, /1e3, mass ×100, substeps 20 to 1, a ball that is there and is not, method; no jump",
        (
            *variants(changes.stiffer, {"k ×1e3": 1e3, "k /1e3": 1e-3}),
            *variants(changes.heavier, {"mass ×100": 100.0}),
            *variants(changes.substeps, {"substeps 20 to 1": (20, 1)}),
            Variant("ball toggled", changes.toggled_collider),
            Variant("method", changes.other_solver),
        ),
        note=(
            "constants and masses change as a user changes them: the sheet goes on with another scene; in `verlet`,"
            " which has no constants, the shares change by the same factor, and the bound stays that of the base sheet;"
            " `explicit` and `rk4` have up to 20 times the substeps that they need to be stable, and then those"
        ),
    ),
    long_run(extremes.HANGING_FRAMES, extremes.SWINGING_FRAMES),
    Case(
        33,
        "far away",
        "100, 1000, 10,000 m from the origin; falls ½gt² within 1 % plus one substep, sags alike within 1 %",
        variants(extremes.far_away, {f"{away:g} m": away for away in (100.0, 1000.0, 10_000.0)}),
        note="steps of h by Euler's method fall ½gt·h farther than ½gt², which the bound adds",
    ),
    Case(
        34,
        "pins",
        "none, all, one pinned and let go in turn each frame",
        (
            Variant("none", loads.no_pins),
            Variant("all", loads.all_pins),
            Variant("toggled", loads.toggled_pin),
        ),
    ),
    Case(
        35,
        "friction",
        "0, 1, 10, 1e6 on 30° and 89°; creep < 1 mm in a minute where it holds",
        variants(
            contact.slope, {f"μ = {mu:g}, {slope:g}°": (mu, slope) for slope in (30.0, 89.0) for mu in (0, 1, 10, 1e6)}
        ),
        note="a sheet that slides is never at rest: its speed is bounded by what damping leaves of its weight",
    ),
    Case(
        36,
        "rotating ball",
        f"radius 0.3 m, 180°/s, μ = 0.4; the sheet at most {contact.FASTER:.1%} faster, and at {contact.TURNED:g} of"
        " its rate at the end",
        (Variant("180°/s", contact.rotating_ball),),
        note="the ball stops after eight seconds, so that the sheet can come to rest; a sheet that the ball takes along"
        " turns a little faster while its free parts move toward the axis",
    ),
    Case(
        37,
        "damping",
        "0, 1e6, negative (refused), spring damping of 1 s (falls ½gt² within 1 % plus one substep)",
        (
            Variant("0", loads.undamped),
            *variants(loads.overdamped, {"1e6": 1e6}),
            Variant("negative", loads.refuses_negative),
            *variants(loads.falls_with_spring_damping, {"damping time 1 s": 1.0}),
        ),
        note="as in case 33, the bound on the fall adds ½gt·h",
    ),
    Case(
        38,
        "strain limit",
        f"1 %, 0.1 % under 10 g; held in every frame, to {loads.CAP_ROUNDING:.1g} for rounding",
        variants(loads.strain_cap, {"1 %": 0.01, "0.1 %": 0.001}),
    ),
    Case(
        39,
        "tablecloth",
        f"pulled by an edge at 1 m/s from under a loose sheet; friction on it ≤ μ·weight, plus {contact.HEAVIER:.0%}",
        variants(contact.tablecloth, {"1 m/s": 0.3, "1 m/s, μ = 0.03": 0.03})
        + variants(partial(contact.tablecloth, cells=8), {"1 m/s, 9×9": 0.3, "1 m/s, 9×9, μ = 0.03": 0.03})
        + variants(partial(contact.tablecloth, cells=4), {"1 m/s, 5×5": 0.3, "1 m/s, 5×5, μ = 0.03": 0.03}),
        note=(
            "sheets of 9×9 and 5×5 particles also, which cost less; friction is judged as a mean over a tenth of a"
            " second, over which the pressure of sheets that vibrate against each other is the weight, to 1 %;"
            " bodies in a scene are led and weigh nothing, so a loose sheet takes the place of the ball on the"
            " tablecloth: the friction on it is its change of momentum, and with μ = 0.3 takes it along after 0.17 m,"
            " so that only with μ = 0.03 the tablecloth can leave it; whether it does, and the mean friction, are only"
            " recorded. With most solvers that mean is below μ times the weight; the cause is not known"
        ),
    ),
    Case(40, "large grid", "1024², one frame; stretch reported", (Variant("1024²", extremes.large),)),
)
