"""All references, in the order of the report."""

from __future__ import annotations

from ..errors import WrongUse
from . import air, bending, contact, drape, flight, hanging, membrane, strand, swing, symmetry
from .row import Reference
from .setups import ALL, ELASTIC

IMPLICIT = ("xpbd", "lines", "projective")
MESHES = ("xpbd", "spring", "rk4", "projective")  # and `verlet`, which has no stiffness in SI
DASHPOTS = ("xpbd", "spring", "lines", "rk4")  # `projective` leaves them out


REFERENCES = (
    Reference("A1.1", "free fall", "Newton; Euler's steps summed", flight.free_fall, ALL),
    Reference("A1.2", "free fall, all on", "as A1.1", flight.fall_with_everything, ALL),
    Reference("A1.3", "free fall in float32", "as A1.1", flight.fall_from_heights, ALL),
    Reference("A1.4", "parabola", "as A1.1", flight.parabola, ALL),
    Reference("A1.5", "spin-down", "recursion of a rigid pair's angle", flight.spin, ALL),
    Reference("A1.6", "momentum", "conservation", flight.momentum, ALL),
    Reference("A1.7", "damping", "e^(−ct)", flight.damping, ALL),
    Reference(
        "A2.1",
        "pendulum",
        "complete elliptic integral",
        swing.pendulum,
        ALL,
    ),
    Reference("A2.2", "one spring", "the method's own discrete law", swing.one_spring, ELASTIC),
    Reference(
        "A2.3",
        "hanging strip",
        "zeros of Laguerre's L20",
        swing.curtain_modes,
        ALL,
    ),
    Reference("A2.4", "taut strip", "2√(T/ma)·sin(jπ/2N)", swing.taut_strip, ELASTIC),
    Reference(
        "A2.5",
        "taut square",
        "Poisson's five points; springs under tension",
        membrane.drum,
        ELASTIC,
    ),
    Reference("A2.6", "strip along itself", "2√(k/m)·sin((2j−1)π/(4N+2))", swing.along_itself, ELASTIC),
    Reference("A2.7", "dashpot", "e^(−ζωt)·(cos + sin)", swing.dashpot, DASHPOTS),
    Reference(
        "A2.8",
        "pendulum's height",
        "conservation",
        swing.pendulum_height,
        ALL,
    ),
    Reference("A3.1", "hanging sheet", "sum of the weights below", hanging.elongation, ELASTIC),
    Reference("A3.2", "artificial stretch", "fixed point of a red-black sweep", hanging.stretch, ("verlet", "xpbd")),
    Reference("A3.3", "hammock", "equilibrium of its springs", hanging.hammock, ELASTIC),
    Reference("A3.4", "buckling", "Euler's elastica", bending.buckling, ELASTIC),
    Reference("A4.1", "doubling", "linear bending", bending.doubling, ELASTIC),
    Reference(
        "A4.2",
        "doubling, springs",
        "linear bending",
        bending.doubling_by_springs,
        ("spring", "lines"),
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
    ),
    Reference(
        "A5.1",
        "stiffness of a grid",
        "homogenised springs",
        membrane.modulus,
        ELASTIC,
    ),
    Reference("A5.2", "shear of a grid", "homogenised springs", membrane.panel, ELASTIC),
    Reference("A6.1", "fall in air", "½ρC_D·v² = σg; tanh", air.falling, ALL),
    Reference(
        "A6.2",
        "sail",
        "−b·ln cos(x/b); (H/p)(t + t³/3)",
        air.sail,
        ALL,
    ),
    Reference("A7.1", "sliding to a stop", "v²/(2μg), Coulomb", contact.stopping, ALL),
    Reference("A7.2", "rest on the ground", "-", contact.resting, ALL),
    Reference("A7.3", "incline", "tan θ = μ; g·(sin θ − μ·cos θ)", contact.incline, ALL),
    Reference(
        "A7.4",
        "scarf over a bar",
        "capstan with weight",
        contact.scarf,
        ALL,
    ),
    Reference("A7.5", "capstan", "e^(μφ)", contact.capstan, ELASTIC),
    Reference("A8.1", "rest shape", "-", symmetry.at_rest, ALL),
    Reference("A8.2", "rotation", "-", symmetry.turned, ALL),
    Reference("A8.3", "mirror", "-", symmetry.mirrored, ALL),
    Reference("A8.4", "far from the origin", "-", symmetry.far_away, ALL),
    Reference("A8.5", "order", "the same curtain in float64", symmetry.order, ELASTIC),
    Reference(
        "A8.6",
        "energy",
        "conservation",
        symmetry.energy,
        ELASTIC,
    ),
    Reference("A8.7", "mesh, hammock", "-", hanging.finer_hammock, ALL),
    Reference("A8.8", "on a ball", "-", symmetry.on_a_ball, ALL),
    Reference("A8.9", "mesh, swinging curtain", "-", swing.finer_curtain, ALL),
    Reference("A8.10", "transposition", "-", symmetry.transposed, ALL),
    Reference(
        "B1",
        "swinging curtain",
        "float64, converged",
        swing.swinging_curtain,
        ALL,
    ),
    Reference("B3", "iterations", "sum of the weights below", hanging.independence, ("xpbd", "lines")),
    Reference("B4", "substeps or iterations", "the method in float64", hanging.split, ("xpbd",)),
    Reference("B5", "force of a chain", "Newton's method in float64", strand.force, ("xpbd",)),
    Reference("B6.1", "heavy strand at rest", "sum of the weights below", strand.at_rest, IMPLICIT),
    Reference(
        "B6.2",
        "heavy strand: residual",
        "its own equation",
        strand.residual,
        IMPLICIT,
    ),
    Reference(
        "B6.3",
        "heavy strand: strains",
        "Newton's method in float64",
        strand.strains,
        IMPLICIT,
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
