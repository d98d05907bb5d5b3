"""Mutations of the simulation: parameters, grabs, checkpoints and the divergence check. Part of `mutations.py`."""

from __future__ import annotations

from mutation import Mutation

SIMULATION = [
    Mutation(
        "release-velocity-of-one-frame",
        "simulation/grabbing.py",
        "RELEASE_FRAMES = 3",
        "RELEASE_FRAMES = 1",
        ("simulation/test_grabbing.py::test_a_released_grab_keeps_its_mean_velocity_over_three_frames",),
    ),
    Mutation(
        "grab-takes-pins",
        "simulation/grabbing.py",
        "within = free & (",
        "within = (",
        ("simulation/test_grabbing.py::test_a_patch_has_the_free_particles_within_the_radius_on_the_sheet",),
    ),
    Mutation(
        "two-grabs-hold-one-particle",
        "simulation/events.py",
        "        free[other.particles] = False\n",
        "",
        ("simulation/test_grabbing.py::test_a_grabbed_particle_cannot_be_grabbed_again",),
    ),
    Mutation(
        "released-pins-get-velocity",
        "simulation/events.py",
        "free = released.particles[~simulation.topology.pinned[released.particles]]",
        "free = released.particles",
        (
            "solvers/test_contract.py::test_a_released_pin_stays_pinned[verlet-simd]",
            "simulation/test_grabbing.py::test_a_particle_pinned_while_grabbed_stays_where_it_is_released",
        ),
    ),
    Mutation(
        "target-error-never-missed",
        "simulation/error_estimate.py",
        "good = [row for row in rows if row.error <= target]",
        "good = rows",
        ("evaluation/test_error_estimate.py::test_the_fastest_setting_that_meets_the_target_is_selected",),
    ),
    Mutation(
        "reset-keeps-torn-springs",
        "simulation/events.py",
        "    simulation.depenetration.invalidate()\n    simulation.untear()\n",
        "    simulation.depenetration.invalidate()\n",
        ("simulation/test_tear_events.py::test_reset_restores_all_springs_bit_for_bit",),
    ),
    Mutation(
        "wind-switch-not-loaded",
        "simulation/checkpoint.py",
        'simulation.params.wind_on = bool(arrays["wind_on"])',
        "pass",
        ("faults/test_checkpoints.py::test_the_wind_switch_is_saved",),
    ),
]
