"""All cases, in the order of the report, and why some methods do not survive some."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import partial

from ..errors import WrongUse
from ..scene.model import SOLVER_NAMES
from ..solvers import SOLVERS
from . import changes, loads, sizes, springs, starts, touching
from .setting import SETTINGS, Setting
from .trial import Trial

FOLDS = "it has gone through itself and is knotted: an equilibrium, whose strain `spring` keeps as it is for 20 s"
VIBRATES = "only the damping of 2/s takes away what a violent start gave, and 5 s of it leave e^(−5)"
TURNS = "a short spring turns within a substep: an explicit step goes past, and gains what it overshoots by"
CHAINS = "chains are linearised where they are: in a crumpled sheet they pull the wrong way, for ever"
ENDLESS = "a constraint that is put right in one substep becomes a velocity, however far it was"
PLACES = "its colliders are not swept: only places are tested, not ways"
PUSHED = "a ball that grows out of the sheet opens its springs, and they snap back"
LAYERS = "friction of cloth on cloth acts once a substep, on what that substep pushes: a stack creeps, and slides out"
SHAKES = "it is as tight as a drum, and float32 rounds its places by a ten-millionth: its springs shake by it"
ONE_SWEEP = "a limit takes one sweep over the springs a substep unless it is told more: too few for so small a strain"
LEFT_WRONG = "springs that are solved one direction after the other are left wrong by the next"
CARRIES = "a heavy corner hangs on few springs, which one sweep a substep leaves too long"
COMPRESSED = "a sheet that falls or is thrown against its pins is left crumpled: see the flattened start"
REBOUNDS = "springs pull on what a ball has stopped, and throw it back faster than it came"


def because(reason: str, *settings: str) -> dict[str, str]:
    """One reason for several settings."""
    return dict.fromkeys(settings, reason)


@dataclass(frozen=True)
class Case:
    """What is done to the cloth. Starts take the variants of `parameters` in turn."""

    number: int
    name: str
    parameters: str
    run: Callable[[Trial], None]
    beyond: Mapping[str, str] = field(default_factory=dict)  # by setting: why it fails


CASES = (
    Case(1, "stiffness sweep", "1 to 1e9 N/m by decades, from two corners; speed < 20 m/s", springs.stiffness_sweep),
    Case(
        2,
        "stiffness ratio",
        "springs down the columns ×1e4, ×1e6",
        springs.stiffness_ratio,
        because(LEFT_WRONG, "lines", "projective") | because(VIBRATES, "spring"),
    ),
    Case(
        3,
        "mass ratio",
        "weights on the corners of 10 to 1e4 particles",
        springs.mass_ratio,
        because(CARRIES, "xpbd", "lines"),
    ),
    Case(4, "frame rates", "240 to 10 pictures a second; the sag alike within 2 %", springs.frame_rates),
    Case(5, "uneven rates", "pictures 1/144 and 1/20 s apart, a second missed", springs.uneven_rates),
    Case(6, "paused", "100 pictures at one time; equal bits", springs.paused),
    Case(
        7,
        "pins apart",
        "×2, ×5, ×10 in 0.1 s, held 1 s, back",
        loads.pins_apart,
        because(FOLDS, "xpbd", "rk4")
        | because(CHAINS, "lines")
        | because(TURNS, "spring")
        | because(ENDLESS, "verlet"),
    ),
    Case(
        8,
        "pins together",
        "to 10 %, 0, past each other, and back",
        loads.pins_together,
        because(FOLDS, "verlet", "xpbd") | because(CHAINS, "lines") | because(VIBRATES, "spring"),
    ),
    Case(9, "collapsed start", "all particles but the pins at one point", starts.collapsed, because(TURNS, "spring")),
    Case(
        10,
        "flattened start",
        "in a line; one half on the other",
        starts.flattened,
        because(FOLDS, "verlet", "xpbd", "projective")
        | because(TURNS, "spring")
        | because(VIBRATES, "rk4")
        | because(CHAINS, "lines"),
    ),
    Case(
        11,
        "random start",
        "anywhere in a box of 1 m; strain < 5 % at the end",
        starts.random_start,
        because(FOLDS, "verlet", "xpbd") | because(TURNS, "spring", "rk4") | because(CHAINS, "lines"),
    ),
    Case(
        12,
        "noise",
        "places off by 1 mm, by 0.1 m",
        starts.noise,
        because(FOLDS, "verlet", "xpbd") | because(TURNS, "spring", "rk4") | because(CHAINS, "lines"),
    ),
    Case(
        13,
        "inverted cells",
        "every second column changes its place with the next",
        starts.inverted,
        because(TURNS, "spring", "rk4") | because(CHAINS, "lines"),
    ),
    Case(
        14,
        "twist",
        "two edges by 720° each, at 144°/s, and back",
        loads.twist,
        because(FOLDS, "verlet", "xpbd", "spring", "rk4", "projective") | because(CHAINS, "lines"),
    ),
    Case(
        15,
        "layers",
        "10, folded of one strip, and a ball; gap ≥ half the thickness",
        touching.layers,
        because(LAYERS, *SOLVER_NAMES),
    ),
    Case(
        16,
        "many layers",
        "50 on a bar; gap ≥ half the thickness",
        touching.many_layers,
        because(LAYERS, *SOLVER_NAMES),
    ),
    Case(
        17,
        "fast ball",
        "radius 0.1 m at 5 to 100 m/s; goes through no particle",
        touching.fast_ball,
        because(PLACES, *SOLVER_NAMES),
    ),
    Case(18, "small fast ball", "radius 1 cm at 20 m/s, cells of 3 cm; told", touching.small_ball),
    Case(
        19,
        "fast cloth",
        "at 100 m/s against a ball; never faster, none through",
        touching.fast_cloth,
        because(REBOUNDS, *SOLVER_NAMES),
    ),
    Case(
        20,
        "engulfed",
        "a ball of 1 m around all of it; out at 2 m/s at most",
        touching.engulfed,
        because(PUSHED, "spring"),
    ),
    Case(
        21,
        "teleported ball",
        "at once within the cloth; out at 2 m/s at most",
        touching.teleported,
        because(PUSHED, "verlet", "xpbd", "spring", "lines", "rk4"),
    ),
    Case(
        22,
        "ball on a pin",
        "the pin 5 cm inside; no buzz",
        touching.ball_on_pin,
        because(TURNS, "spring") | because(VIBRATES, "xpbd", "rk4") | because(CHAINS, "lines"),
    ),
    Case(
        23,
        "squeeze",
        "between two balls that close to 10 cm of overlap",
        touching.squeeze,
        because(TURNS, "spring", "rk4") | because(CHAINS, "lines"),
    ),
    Case(
        24,
        "degenerate mesh",
        "points and rows on one another; cells of 1:1e4 (refused, or alive)",
        sizes.degenerate,
        because(TURNS, "spring", "rk4") | because(CHAINS, "lines") | because(LEFT_WRONG, "xpbd"),
    ),
    Case(25, "tiny grids", "1×1 (refused) to 2×1000", sizes.tiny),
    Case(
        26,
        "gravity",
        "0, upwards, 1e3, 1e5 m/s², another sign each frame",
        loads.gravity,
        because(COMPRESSED, "verlet", "xpbd") | because(VIBRATES, "spring", "rk4") | because(CHAINS, "lines"),
    ),
    Case(
        27,
        "gusts",
        "100 m/s for half a second, five times",
        loads.gusts,
        because(FOLDS, "verlet", "xpbd") | because(VIBRATES, "spring") | because(CHAINS, "lines"),
    ),
    Case(
        28,
        "edge-on wind",
        "a taut sheet, 2 m/s through edge-on and back; then < 1 mm/s",
        loads.edge_on_wind,
        because(SHAKES, "spring"),
    ),
    Case(
        29,
        "yank",
        "a grabbed particle goes 10 m in a frame, and back",
        loads.yank,
        because(VIBRATES, "verlet", "xpbd", "rk4", "projective") | because(TURNS, "spring") | because(CHAINS, "lines"),
    ),
    Case(30, "bad input", "NaN, infinite, negative, unknown; refused by name", changes.bad_input),
    Case(
        31,
        "changes in mid run",
        "constants ×1e3, /1e3, substeps, gravity, method, radius",
        changes.mid_run,
        because(ENDLESS, "verlet")
        | because(COMPRESSED, "xpbd")
        | because(VIBRATES, "spring", "rk4")
        | because(CHAINS, "lines"),
    ),
    Case(32, "long run", "10,000 frames hanging (drift < 0.1 mm), swinging undamped", springs.long_run),
    Case(33, "far away", "100, 1000, 10,000 m from the origin; the sag alike within 1 %", sizes.far_away),
    Case(34, "pins", "none, all, a hand in every other frame", loads.pins),
    Case(35, "friction", "0, 1, 10, 1e6 on 30°, 89°; a minute's rest; creep < 1 mm", touching.friction),
    Case(36, "rotating ball", "radius 0.3 m, 180°/s, μ = 0.4; never faster than the ball", touching.rotating_ball),
    Case(37, "damping", "0, 1e6, dashpots of 1 s (falls at g), negative (refused)", loads.damping),
    Case(
        38,
        "strain limit",
        "1 %, 0.1 % under 10 g; held within a tenth",
        loads.strain_cap,
        because(ONE_SWEEP, *SOLVER_NAMES),
    ),
    Case(
        39,
        "tablecloth",
        "pulled by an edge at 1 m/s over a table",
        touching.tablecloth,
        because(VIBRATES, "spring", "rk4") | because(CHAINS, "lines"),
    ),
    Case(40, "large grid", "1024², one frame; stretch told", sizes.large),
)


LONG_FRAMES = 1_000_000


def chosen(
    only: str | None, setting: str | None, *, long: bool = False, tear: float | None = None
) -> list[tuple[Case, Setting]]:
    """Cases, by number or name, with each setting or with one: by setting, so that kernels are used again.

    `long` makes a million frames of the long run. `tear` is the strain at which threads give way, with the settings
    that can do it. Raises WrongUse for no case, for a long run of another, and for a setting that cannot tear.
    """
    cases = [case for case in CASES if only is None or only in (str(case.number), case.name)]
    if not cases:
        raise WrongUse(f"no case {only!r}: {', '.join(f'{case.number} {case.name}' for case in CASES)}")
    if long:
        if [case.number for case in cases] != [32]:
            raise WrongUse("--long is about the long run: it goes with --only 32")
        cases = [replace(case, run=partial(springs.long_run, frames=LONG_FRAMES)) for case in cases]
    settings = [one for name, one in SETTINGS.items() if setting in (None, name)]
    if tear is not None:
        able = [one for one in SETTINGS.values() if not SOLVERS[one.solver.name].needs_rows]
        settings = [one.tearing(tear) for one in settings if one in able]
        if not settings:
            others = ", ".join(one.name for one in able)
            raise WrongUse(f"{setting} needs a grid of whole rows, and one that tears loses its rows: take {others}")
    return [(case, one) for one in settings for case in cases]
