"""All references, in the order of the report, and what a method cannot reach."""

from __future__ import annotations

from ..errors import WrongUse
from . import air, bending, contact, flight, hanging, swing, symmetry
from .row import Reference
from .setups import ALL, ELASTIC

EULER = "its steps are of first order: Euler's, however well each is solved"
ALONG_THE_TANGENT = "a step goes along the tangent and is pulled back: a turn loses (1 + 2Ω²ht)^½ of its rate"
ROUNDING = "every correction rounds a place to float32, and the velocity is what the place moved, over h"
NEAR_LIMIT = "it stills vibrations that are near the limit of its stability"
STILLS = "implicit steps still the vibrations that are faster than they are"
UNDAMPED = "nothing damps the sheet's own vibration"
UNFINISHED = "the usual iterations do not reach the solution of a substep"

# Method by method, what of a reference its nature or its usual setting puts out of reach.
PULLED_BACK = dict.fromkeys(("verlet", "xpbd", "projective"), ALONG_THE_TANGENT)
FIRST_ORDER = dict.fromkeys(("verlet", "xpbd", "projective"), EULER)
ROUNDED = dict.fromkeys(("verlet", "xpbd", "projective"), ROUNDING)

STAND_IN = dict.fromkeys(ELASTIC, "springs to the particle after the next bend with the cube of the angle")

UNDONE = {"xpbd": UNFINISHED}

REFERENCES = (
    Reference("A1.1", "free fall", "Newton; Euler's steps summed", flight.free_fall, ALL),
    Reference("A1.2", "free fall, all on", "as A1.1", flight.fall_with_everything, ALL),
    Reference("A1.3", "free fall in float32", "as A1.1", flight.fall_from_heights, ALL, {"verlet": ROUNDING}),
    Reference("A1.4", "parabola", "as A1.1", flight.parabola, ALL),
    Reference("A1.5", "spin-down", "recursion of a rigid pair's angle", flight.spin, ALL),
    Reference("A1.6", "momentum", "conservation", flight.momentum, ALL, ROUNDED),
    Reference("A2.1", "pendulum", "complete elliptic integral", swing.pendulum, ALL, PULLED_BACK),
    Reference("A2.2", "one spring", "the method's own discrete law", swing.one_spring, ELASTIC),
    Reference("A2.3", "hanging strip", "zeros of Laguerre's L20", swing.curtain_modes, ALL, {"projective": UNFINISHED}),
    Reference("A2.4", "taut strip", "2√(T/ma)·sin(jπ/2N)", swing.taut_strip, ELASTIC, UNDONE),
    Reference("A3.1", "hanging sheet", "sum of the weights below", hanging.elongation, ELASTIC, UNDONE),
    Reference("A3.2", "artificial stretch", "fixed point of a red-black sweep", hanging.stretch, ("verlet",)),
    Reference("A3.3", "hammock", "equilibrium of its springs", hanging.hammock, ELASTIC, UNDONE),
    Reference("A3.4", "buckling", "Euler's elastica", bending.buckling, ELASTIC),
    Reference("A4.1", "doubling", "linear bending", bending.doubling, ELASTIC),
    Reference(
        "A4.2", "doubling, springs", "linear bending", bending.doubling_by_springs, ("spring", "lines"), STAND_IN
    ),
    Reference("A4.3", "cantilever", "heavy elastica", bending.droop, ELASTIC, {"projective": UNFINISHED}),
    Reference("A4.4", "pear loop", "elastica", bending.loop, ELASTIC),
    Reference(
        "A5.1",
        "stiffness of a grid",
        "homogenised springs",
        hanging.modulus,
        ELASTIC,
        dict.fromkeys(("xpbd", "lines"), UNFINISHED),
    ),
    Reference("A6.1", "fall in air", "½ρC_D·v² = σg; tanh", air.falling, ALL, FIRST_ORDER),
    Reference(
        "A6.2",
        "sail",
        "−b·ln cos(x/b); (H/p)(t + t³/3)",
        air.sail,
        ALL,
        dict.fromkeys(("verlet", "xpbd", "projective"), UNFINISHED),
    ),
    Reference("A7.1", "sliding to a stop", "v²/(2μg), Coulomb", contact.stopping, ALL),
    Reference("A7.2", "rest on the ground", "-", contact.resting, ALL, dict.fromkeys(("spring", "rk4"), UNDAMPED)),
    Reference("A8.1", "rest shape", "-", symmetry.at_rest, ALL, dict.fromkeys(ALL, ROUNDING)),
    Reference("A8.2", "rotation", "-", symmetry.turned, ALL, {"projective": ROUNDING}),
    Reference("A8.3", "mirror", "-", symmetry.mirrored, ALL),
    Reference("A8.4", "far from the origin", "-", symmetry.far_away, ALL, ROUNDED),
    Reference("A8.5", "order", "Richardson", symmetry.order, ELASTIC),
    Reference(
        "A8.6", "energy", "conservation", symmetry.energy, ELASTIC, FIRST_ORDER | {"lines": STILLS, "rk4": NEAR_LIMIT}
    ),
    Reference("A8.7", "mesh", "-", hanging.finer_hammock, ("spring", "lines", "rk4")),
    Reference("B1", "swinging curtain", "float64, converged", swing.swinging_curtain, ALL, FIRST_ORDER),
    Reference("B3", "iterations", "sum of the weights below", hanging.independence, ("xpbd", "lines")),
)


def chosen(only: str | None, solver: str | None) -> list[tuple[Reference, str]]:
    """References, by number or its beginning, with each of their solvers, or with one. Raises WrongUse for none."""
    pairs = [
        (reference, name)
        for reference in REFERENCES
        for name in reference.solvers
        if reference.number.startswith(only or "") and solver in (None, name)
    ]
    if not pairs:
        numbers = ", ".join(reference.number for reference in REFERENCES)
        with_solver = f" with {solver}" if solver else ""
        raise WrongUse(f"no reference {only!r}{with_solver}: {numbers}")
    return pairs
