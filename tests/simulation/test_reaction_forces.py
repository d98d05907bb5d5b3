"""Forces on the cloth, and the forces that pins, attachments and grabs exert on it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from taichi_cloth.scene.collider_schema import Attachment
from taichi_cloth.scene.fabric_schema import Fabric
from taichi_cloth.scene.schema import FRAME_SECONDS, Cloth, Forces, Scene, Solver, Tearing, Weave, Wind
from taichi_cloth.scene.solver_catalog import SOLVER_CATALOG
from taichi_cloth.simulation.simulation import Simulation
from taichi_cloth.system.errors import UsageError

GRAVITY = 9.81
CORNERS = ("top-left", "top-right")
SHEET = Scene(
    cloth=Cloth(rows=9, columns=9, width=1.0, height=1.0, center=(0.0, 0.0, 0.0), pins=CORNERS),
    fabric=Fabric(warp=100.0, weft=100.0, shear=30.0, bend_spring=1.0),
    solver=Solver(name="explicit", substeps=1, iterations=1, damping=4.0),
    forces=Forces(gravity=GRAVITY),
)
WEIGHT = 0.2 * GRAVITY
SI_SOLVERS = [name for name, info in SOLVER_CATALOG.items() if info.stiffness_section == "fabric"]
CONVERGED = {"explicit": (1, 1), "rk4": (1, 1), "lines": (20, 4), "xpbd": (30, 10), "implicit": (10, 20)}


def sheet(solver: str = "explicit", **sections: object) -> Scene:
    substeps, iterations = CONVERGED[solver]
    settings = replace(SHEET.solver, name=solver, substeps=substeps, iterations=iterations)
    return replace(SHEET, solver=settings, **sections)  # type: ignore[arg-type]


def without_pins() -> Cloth:
    return replace(SHEET.cloth, pins=())


@pytest.mark.usefixtures("serial_layout")
@pytest.mark.parametrize("solver", SI_SOLVERS)
def test_pins_and_grabs_hold_the_weight_of_a_sheet_at_rest(solver: str) -> None:
    with Simulation(sheet(solver)) as simulation:
        simulation.step(240)
        pinned = simulation.topology.pinned
        forces, reactions = simulation.forces(), simulation.reaction_forces()
        assert reactions[pinned].sum(axis=0) == pytest.approx([0.0, WEIGHT, 0.0], abs=1e-3 * WEIGHT)
        assert reactions[~pinned] == pytest.approx(0.0, abs=0.0)
        left, right = reactions[pinned]
        assert left == pytest.approx(right * [-1, 1, 1], abs=1e-3 * WEIGHT)  # the sheet pulls both inwards
        assert left[0] < -0.1 * WEIGHT
        assert np.abs(forces[~pinned]).max() < 2e-3 * WEIGHT

        # The same sheet in two hands: pins become grabs of the same particles.
        grabs = [simulation.grab(int(k)) for k in np.flatnonzero(pinned)]
        for grab in grabs:
            simulation.unpin(int(grab.particles[0]))
        simulation.step(2)
        held = [grab.force for grab in grabs]
        assert sum(held) == pytest.approx([0.0, WEIGHT, 0.0], abs=1e-3 * WEIGHT)
        assert held[0] == pytest.approx(left, abs=1e-3 * WEIGHT)
        grabs[0].release()
        assert grabs[0].force.tolist() == [0.0, 0.0, 0.0]


@pytest.mark.parametrize("solver", ["explicit", "rk4"])
def test_a_damped_sheet_that_is_lifted_evenly_weighs_what_it_weighs(solver: str) -> None:
    """The dampers act on the velocity relative to the pins: none, once the sheet moves as a whole."""
    lifted = Attachment(pins=CORNERS, keyframes=((0.0, 0.0, 0.0, 0.0), (9.0, 0.0, 4.5, 0.0)))
    fabric = replace(SHEET.fabric, damping_time=1e-3)
    solver_settings = replace(sheet(solver).solver, damping=0.0)
    scene = replace(sheet(solver), cloth=without_pins(), attachments=(lifted,), fabric=fabric, solver=solver_settings)
    with Simulation(scene, "serial") as simulation:
        simulation.step(300)
        assert simulation.velocities()[simulation.topology.pinned, 1] == pytest.approx(0.5, rel=1e-4)
        mean = np.mean([step_and_lift(simulation) for _ in range(120)])
        assert mean == pytest.approx(WEIGHT, rel=0.02)


def step_and_lift(simulation: Simulation) -> float:
    """Advance one frame and return the upward force that holds the sheet [N]."""
    simulation.step()
    return float(simulation.reaction_forces()[:, 1].sum())


def test_a_patch_takes_the_force_of_all_its_particles() -> None:
    with Simulation(sheet(cloth=without_pins()), "serial") as simulation:
        patches = [simulation.grab(index, radius=0.3) for index in (0, 8)]
        simulation.step(240)
        forces = simulation.reaction_forces()
        assert forces[patches[0].particles].sum(axis=0) == pytest.approx(patches[0].force)
        assert sum(patch.force for patch in patches) == pytest.approx([0.0, WEIGHT, 0.0], abs=1e-3 * WEIGHT)


def test_a_sheet_held_as_a_whole_needs_its_mass_times_acceleration_and_its_weight() -> None:
    acceleration = np.array([3.0, 0.0, -2.0])
    with Simulation(
        sheet(cloth=without_pins(), fabric=replace(SHEET.fabric, damping_time=1e-3)), "serial"
    ) as simulation:
        grab = simulation.grab(40, radius=9.0)
        assert len(grab.particles) == simulation.topology.particle_count
        assert grab.force == pytest.approx([0.0, WEIGHT, 0.0], rel=1e-5)
        start = simulation.positions()[40]
        for frame in range(1, 6):
            grab.move_to(start + acceleration * (frame * FRAME_SECONDS) ** 2 / 2)
            simulation.step()
            # The first step begins at rest: half a frame at the acceleration.
            expected = acceleration * 0.2 * (0.5 if frame == 1 else 1.0) + [0.0, WEIGHT, 0.0]
            assert grab.force == pytest.approx(expected, abs=1e-4)


def test_attached_pins_need_the_force_that_their_motion_takes() -> None:
    amplitude, period = 0.5, 1.0
    attachment = Attachment(
        pins=("top", "bottom"), center=(0.0, 0.0, 0.0), oscillation=(amplitude, 0.0, 0.0), period=(period, 1.0, 1.0)
    )
    cloth = replace(SHEET.cloth, rows=2, columns=4, pins=())
    with Simulation(sheet(cloth=cloth, attachments=(attachment,)), "serial") as simulation:
        for _ in range(20):
            simulation.step()
        before = simulation.seconds - FRAME_SECONDS  # the middle of the last two frames
        acceleration = -amplitude * (2 * np.pi / period) ** 2 * np.sin(2 * np.pi * before / period)
        total = simulation.reaction_forces().sum(axis=0)
        assert total == pytest.approx([0.2 * acceleration, WEIGHT, 0.0], rel=2e-3, abs=1e-6)
        simulation.unpin(0)
        assert simulation.reaction_forces()[0].tolist() == [0.0, 0.0, 0.0]


def test_an_attachment_that_turns_pulls_its_pins_to_its_center() -> None:
    center = np.array([2.0, 0.0, 0.0])
    attachment = Attachment(pins=("top", "bottom"), center=(2.0, 0.0, 0.0), spin=(0.0, 0.0, 90.0))
    cloth = replace(SHEET.cloth, rows=2, columns=2, pins=())
    with Simulation(sheet(cloth=cloth, attachments=(attachment,), forces=Forces(gravity=0.0)), "serial") as simulation:
        simulation.step(10)
        angle = np.pi / 2 * (simulation.seconds - FRAME_SECONDS)  # in the middle of the last two frames
        turn = np.array([[np.cos(angle), -np.sin(angle), 0.0], [np.sin(angle), np.cos(angle), 0.0], [0.0, 0.0, 1.0]])
        from_center = (simulation.topology.start - center) @ turn.T
        expected = -simulation.topology.mass[:, None] * (np.pi / 2) ** 2 * from_center
        assert simulation.reaction_forces() == pytest.approx(expected, rel=1e-3, abs=1e-3)


@pytest.mark.parametrize(
    "sections",
    [
        {"fabric": replace(SHEET.fabric, damping_time=2e-3)},
        {"fabric": replace(SHEET.fabric, compression=0.2, bend_spring=0.0, bending_stiffness=1e-3)},
        {"wind": Wind(x=3.0, z=-5.0, turbulence=0.8, lift=0.7), "seed": 5},
        {"cloth": replace(SHEET.cloth, center=(40.0, 3.0, 0.0)), "wind": Wind(z=-5.0)},
        {"tearing": Tearing(strain=0.2)},
    ],
    ids=["damping", "compression and bending", "wind", "far away", "torn"],
)
def test_forces_are_those_of_the_kernels(sections: dict[str, object]) -> None:
    """The first half kick of `explicit` changes a velocity by half a substep times force over mass."""
    scene = sheet(**sections)
    solver = replace(scene.solver, substeps=1000, damping=0.0, stiffness=0.7)
    with Simulation(replace(scene, solver=solver), "serial") as simulation:
        simulation.step(3)
        random = np.random.default_rng(0)
        start = simulation.topology.start
        simulation.params["stiffness"] = 0.9
        simulation.params["gravity"] = 4.0
        simulation.set_state(start + random.normal(0, 0.01, start.shape), random.normal(0, 1, start.shape))
        if scene.tearing is not None:
            simulation.step()
            assert simulation.torn.any()
        forces, before, h, mass = simulation.forces(), simulation.velocities(), simulation.h, simulation.topology.mass
        after: list[np.ndarray] = []
        simulation.step_by_substep(lambda fraction: after.append(simulation.velocities()))
        kick = (after[0] - before) * mass[:, None] / (h / 2)
        free = ~simulation.topology.pinned
        assert forces[free] == pytest.approx(kick[free], rel=1e-2, abs=2e-3 * np.abs(kick[free]).max())


def test_wind_that_is_off_still_resists_motion() -> None:
    with Simulation(sheet(wind=Wind(z=6.0)), "serial") as simulation:
        weight = -simulation.topology.mass[:, None] * [0.0, GRAVITY, 0.0]
        assert (simulation.forces() - weight)[:, 2].sum() > 1.0
        simulation.params["wind"] = False
        assert simulation.forces() == pytest.approx(weight, abs=1e-6)
        simulation.set_state(simulation.topology.start, (0.0, 0.0, 6.0))
        assert (simulation.forces() - weight)[:, 2].sum() < -1.0


def test_forces_without_a_unit_are_refused_in_one_line() -> None:
    with Simulation(sheet(), "serial") as simulation:
        grab = simulation.grab(40)
        simulation.switch_solver("verlet")
        for read in (simulation.forces, simulation.reaction_forces, simulation.elastic_energy, lambda: grab.force):
            with pytest.raises(
                UsageError, match=r"\Averlet has stiffnesses without unit, and so no forces and no energy: .+\Z"
            ):
                read()
        simulation.switch_solver("xpbd")
        assert np.isfinite(grab.force).all()


def test_a_cloth_that_has_collapsed_to_a_point_has_finite_forces() -> None:
    with Simulation(sheet(fabric=replace(SHEET.fabric, damping_time=1e-3)), "serial") as simulation:
        simulation.set_state(np.zeros_like(simulation.topology.start))
        assert np.isfinite(simulation.forces()).all()


CURVE = ((0.05, 5.0), (0.2, 30.0))  # strain, tension [N/m]
WEAVE = Weave(warp=CURVE, weft=CURVE, shear=((10.0, 1.0), (30.0, 5.0)))


@pytest.mark.parametrize("model", ["springs", "membrane", "weave"])
def test_the_total_energy_of_an_undamped_cloth_is_constant(model: str) -> None:
    """Kinetic and potential energy change by a hundred times more than their sum with the elastic energy."""
    fabric = replace(SHEET.fabric, model=model, bending_stiffness=1e-3, bend_spring=1.0 * (model == "springs"))
    scene = replace(
        SHEET,
        fabric=fabric,
        solver=Solver("rk4", 200, 1, damping=0.0),
        weave=WEAVE if model == "weave" else None,
    )
    with Simulation(scene, "serial") as simulation:
        simulation.set_state(simulation.topology.start, (0.0, 0.0, 1.0))
        totals, others = [], []
        for _ in range(20):
            simulation.step()
            metrics = simulation.metrics()
            others.append(metrics.kinetic_energy + metrics.potential_energy)
            totals.append(others[-1] + simulation.elastic_energy())
        assert np.ptp(totals) < 0.01 * np.ptp(others)


def test_the_elastic_energy_has_the_present_values_of_parameters() -> None:
    with Simulation(sheet(), "serial") as simulation:
        simulation.set_state(1.1 * simulation.topology.start)
        before = simulation.elastic_energy()
        topology, fabric = simulation.topology, SHEET.fabric
        constants = np.array([fabric.weft, fabric.warp, fabric.shear, fabric.bend_spring]) @ topology.stiffness_factors
        assert before == pytest.approx(0.5 * float(constants @ (0.1 * topology.rest) ** 2), rel=1e-5)
        simulation.params["stiffness"] = 0.5
        assert simulation.elastic_energy() == pytest.approx(before / 2)
