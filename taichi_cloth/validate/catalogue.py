"""All references, in the order of the report, and what a method cannot reach."""

from __future__ import annotations

from ..errors import WrongUse
from . import air, bending, contact, drape, flight, hanging, membrane, strand, swing, symmetry
from .row import Known, Reference
from .setups import ALL, ELASTIC

EULER = "its steps are of first order: Euler's, however well each is solved"
ALONG_THE_TANGENT = "a step goes along the tangent and is pulled back: a turn loses (1 + 2Ω²ht)^½ of its rate"
ROUNDING = "its velocity is the difference of two places in float32, over h"
STILLS = "implicit steps still the vibrations that are faster than they are"
HALF_KICK = "the velocity that it tells has half a substep of weight in it, ½g·h, which the ground takes with the next"
UNFINISHED = "the usual iterations do not reach the solution of a substep"
HUNDRED = "100 iterations do not reach the solution of a substep"
TURNED = "it adds up moves along threads that have turned since, and does not take them back"
LATE = "it sees the dashpot's force half a substep late, and its substeps are as long as is stable"
UNHELD = "each sweep pulls on, and friction holds no more than what contact pushes in that sweep"
ONE_SIDED = "springs that are relaxed one after the other pull a sheet out of its symmetry"
ESTIMATED = "the bending of silk and leather is an estimate: 0.75 and 0.7 times as much would drape as published"
CUBIC = "springs to the particle after the next bend with the cube of the angle"

IMPLICIT = ("xpbd", "lines", "projective")
MESHES = ("xpbd", "spring", "rk4", "projective")  # and `verlet`, which has no stiffness in SI
DASHPOTS = ("xpbd", "spring", "lines", "rk4")  # `projective` leaves them out


def known(reason: str, **most: float) -> dict[str, Known]:
    """One reason for several solvers, each with its own bound: a third above what was measured."""
    return {solver: Known(reason, bound) for solver, bound in most.items()}


REFERENCES = (
    Reference("A1.1", "free fall", "Newton; Euler's steps summed", flight.free_fall, ALL),
    Reference("A1.2", "free fall, all on", "as A1.1", flight.fall_with_everything, ALL),
    Reference("A1.3", "free fall in float32", "as A1.1", flight.fall_from_heights, ALL),
    Reference("A1.4", "parabola", "as A1.1", flight.parabola, ALL),
    Reference("A1.5", "spin-down", "recursion of a rigid pair's angle", flight.spin, ALL),
    Reference("A1.6", "momentum", "conservation", flight.momentum, ALL, known(ROUNDING, verlet=9e-4)),
    Reference("A1.7", "damping", "e^(−ct)", flight.damping, ALL),
    Reference(
        "A2.1",
        "pendulum",
        "complete elliptic integral",
        swing.pendulum,
        ALL,
        known(ALONG_THE_TANGENT, verlet=0.46, xpbd=0.23, projective=0.27),
    ),
    Reference("A2.2", "one spring", "the method's own discrete law", swing.one_spring, ELASTIC),
    Reference(
        "A2.3",
        "hanging strip",
        "zeros of Laguerre's L20",
        swing.curtain_modes,
        ALL,
        known(UNFINISHED, projective=0.15),
    ),
    Reference("A2.4", "taut strip", "2√(T/ma)·sin(jπ/2N)", swing.taut_strip, ELASTIC, known(UNFINISHED, xpbd=0.11)),
    Reference(
        "A2.5",
        "taut square",
        "Poisson's five points; springs under tension",
        membrane.drum,
        ELASTIC,
        known(UNFINISHED, xpbd=0.6),
    ),
    Reference("A2.6", "strip along itself", "2√(k/m)·sin((2j−1)π/(4N+2))", swing.along_itself, ELASTIC),
    Reference("A2.7", "dashpot", "e^(−ζωt)·(cos + sin)", swing.dashpot, DASHPOTS, known(LATE, spring=0.032)),
    Reference(
        "A2.8",
        "pendulum's height",
        "conservation",
        swing.pendulum_height,
        ALL,
        known(ALONG_THE_TANGENT, verlet=0.42, xpbd=0.085, projective=0.12),
    ),
    Reference(
        "A3.1", "hanging sheet", "sum of the weights below", hanging.elongation, ELASTIC, known(UNFINISHED, xpbd=2)
    ),
    Reference("A3.2", "artificial stretch", "fixed point of a red-black sweep", hanging.stretch, ("verlet",)),
    Reference("A3.3", "hammock", "equilibrium of its springs", hanging.hammock, ELASTIC),
    Reference("A3.4", "buckling", "Euler's elastica", bending.buckling, ELASTIC),
    Reference("A4.1", "doubling", "linear bending", bending.doubling, ELASTIC),
    Reference(
        "A4.2",
        "doubling, springs",
        "linear bending",
        bending.doubling_by_springs,
        ("spring", "lines"),
        known(CUBIC, spring=0.5, lines=0.5),
    ),
    Reference("A4.3", "cantilever", "heavy elastica", bending.droop, ELASTIC),
    Reference("A4.4", "pear loop", "elastica", bending.loop, ELASTIC),
    Reference("A4.5", "tip load", "elastica with both weights", bending.tip_load, ELASTIC),
    Reference(
        "A4.6",
        "drape coefficient",
        "published measurements",
        drape.drape,
        MESHES,
        known(ESTIMATED, spring=13, rk4=13, projective=14.5),
    ),
    Reference(
        "A5.1",
        "stiffness of a grid",
        "homogenised springs",
        hanging.modulus,
        ELASTIC,
        known(UNFINISHED, xpbd=0.85, lines=0.17),
    ),
    Reference("A5.2", "shear of a grid", "homogenised springs", membrane.panel, ELASTIC, known(UNFINISHED, xpbd=0.78)),
    Reference("A6.1", "fall in air", "½ρC_D·v² = σg; tanh", air.falling, ALL, known(EULER, verlet=0.024)),
    Reference(
        "A6.2",
        "sail",
        "−b·ln cos(x/b); (H/p)(t + t³/3)",
        air.sail,
        ALL,
        known(UNFINISHED, verlet=0.015, projective=0.023),
    ),
    Reference("A7.1", "sliding to a stop", "v²/(2μg), Coulomb", contact.stopping, ALL),
    Reference("A7.2", "rest on the ground", "-", contact.resting, ALL, known(HALF_KICK, spring=8e-6, rk4=1.6e-5)),
    Reference("A7.3", "incline", "tan θ = μ; g·(sin θ − μ·cos θ)", contact.incline, ALL),
    Reference(
        "A7.4",
        "scarf over a bar",
        "capstan with weight",
        contact.scarf,
        ALL,
        known(UNHELD, verlet=0.7, xpbd=0.35) | known(UNFINISHED, projective=0.18),
    ),
    Reference("A8.1", "rest shape", "-", symmetry.at_rest, ALL),
    Reference("A8.2", "rotation", "-", symmetry.turned, ALL),
    Reference("A8.3", "mirror", "-", symmetry.mirrored, ALL),
    Reference("A8.4", "far from the origin", "-", symmetry.far_away, ALL),
    Reference("A8.5", "order", "Richardson", symmetry.order, ELASTIC),
    Reference(
        "A8.6",
        "energy",
        "conservation",
        symmetry.energy,
        ELASTIC,
        known(EULER, xpbd=0.14, projective=0.26) | known(STILLS, lines=0.27),
    ),
    Reference("A8.7", "mesh", "-", hanging.finer_hammock, ("spring", "lines", "rk4")),
    Reference(
        "A8.8", "on a ball", "-", symmetry.on_a_ball, ALL, known(ONE_SIDED, verlet=0.056, xpbd=0.06, lines=0.008)
    ),
    Reference(
        "B1",
        "swinging curtain",
        "float64, converged",
        swing.swinging_curtain,
        ALL,
        known(EULER, verlet=0.086, xpbd=0.04, projective=0.018),
    ),
    Reference("B3", "iterations", "sum of the weights below", hanging.independence, ("xpbd", "lines")),
    Reference("B4", "substeps or iterations", "the method in float64", hanging.split, ("xpbd",)),
    Reference("B5", "force of a chain", "Newton's method in float64", strand.force, ("xpbd",)),
    Reference(
        "B6.1", "heavy strand at rest", "sum of the weights below", strand.at_rest, IMPLICIT, known(HUNDRED, xpbd=350)
    ),
    Reference(
        "B6.2",
        "heavy strand: residual",
        "its own equation",
        strand.residual,
        IMPLICIT,
        known(HUNDRED, xpbd=1.7e6, projective=280) | known(TURNED, lines=130),
    ),
    Reference(
        "B6.3",
        "heavy strand: strains",
        "Newton's method in float64",
        strand.strains,
        IMPLICIT,
        known(HUNDRED, xpbd=870, projective=0.15) | known(TURNED, lines=0.028),
    ),
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
