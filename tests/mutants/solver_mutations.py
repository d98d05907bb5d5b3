"""Mutations of the solvers. Part of `mutations.py`."""

from __future__ import annotations

from mutation import Mutation

MEMBRANE = "solvers/test_membrane.py::"
WEAVE, WEAVE_MODEL = "solvers/test_weave.py::", "geometry/test_weave_model.py::"
CONTRACT = "solvers/test_contract.py::"

SOLVERS = [
    Mutation(
        "xpbd-keeps-multipliers",
        "solvers/xpbd.py",
        "    clear_elastic_multipliers(cloth, features)  # (4)\n",
        "",
        ("solvers/test_xpbd.py::test_a_spring_has_the_amplitude_and_phase_of_backward_euler[240-1]",),
    ),
    Mutation(
        "xpbd-clears-multipliers-every-iteration",
        "solvers/xpbd.py",
        "    solve_elastic_constraints(cloth",
        "    clear_elastic_multipliers(cloth, features)\n    solve_elastic_constraints(cloth",
        ("solvers/test_xpbd.py::test_a_spring_has_the_amplitude_and_phase_of_backward_euler[240-8]",),
    ),
    Mutation(
        "membrane-multipliers-stay-nan",
        "kernels/membrane_constraints.py",
        "ti.Vector.zero(ti.f32, LANES if ti.static(cloth.is_simd) else 3)",
        "cloth.membrane.multiplier[n] * 0.0",
        (MEMBRANE + "test_after_a_reset_the_cloth_moves_as_if_no_number_had_been_lost[xpbd-serial]",),
    ),
    Mutation(
        "membrane-steps-without-limit",
        "kernels/membrane_constraints.py",
        "ti.min(ti.max(area, 0.0), trace)",
        "trace",
        (MEMBRANE + "test_a_flattened_triangle_opens_to_its_shape_and_not_beyond",),
    ),
    Mutation(
        "membrane-negative-determinant",
        "kernels/membrane_constraints.py",
        "ti.max(a11 * p11 + a12 * p12 + a13 * p13, LEAST_DETERMINANT * (a11 * a22) * a33)",
        "a11 * p11 + a12 * p12 + a13 * p13",
        (MEMBRANE + "test_xpbd_recovers_from_grabs_that_jump_by_meters_every_frame",),
    ),
    Mutation(
        "membrane-solved-without-two-entries",
        "kernels/membrane_constraints.py",
        "k11 * lambda1 + k12 * lambda2",
        "k11 * lambda1",
        (MEMBRANE + "test_one_projection_is_that_of_a_float64_solution",),
    ),
    Mutation(
        "lines-keep-moves-of-empty-lanes",
        "kernels/line_solver.py",
        "range(ti.static(lines.moved.shape[0]))",
        "range(layout[ROWS] * layout[ROW_STRIDE])",
        (CONTRACT + "test_after_a_reset_the_cloth_moves_as_if_no_number_had_been_lost[lines-simd]",),
    ),
    Mutation(
        "membrane-without-poissons-effect",
        "kernels/membrane_forces.py",
        "c12 * e1 + c22 * e2 + c26 * e12",
        "c22 * e2 + c26 * e12",
        (MEMBRANE + "test_kernel_forces_are_those_of_the_float64_membrane[0.0-1.0]",),
    ),
    Mutation(
        "membrane-cells-upside-down",
        "kernels/membrane_forces.py",
        "down, along = -params[CELL_ROWS]",
        "down, along = params[CELL_ROWS]",
        (MEMBRANE + "test_all_layouts_move_alike[turned-simd-explicit]",),
    ),
    Mutation(
        "membrane-product-without-tension",
        "kernels/membrane_forces.py",
        "    return s1, s2, s12, t1, t2, t12\n",
        "    return s1, s2, s12, 0.0 * t1, 0.0 * t2, 0.0 * t12\n",
        (MEMBRANE + "test_the_product_is_the_change_of_the_force",),
    ),
    Mutation(
        "membrane-constraints-half-coupled",
        "kernels/membrane_constraints.py",
        "2.0 * w12 * e12",
        "w12 * e12",
        (MEMBRANE + "test_one_projection_is_that_of_a_float64_solution",),
    ),
    Mutation(
        "membrane-of-a-grid-twice-as-stiff",
        "geometry/membrane_model.py",
        "np.int32), 0.5",
        "np.int32), 1.0",
        ("geometry/test_membrane_model.py::test_a_grid_has_two_triangulations_of_half_weight",),
    ),
    Mutation(
        "membrane-bound-without-tension",
        "geometry/membrane_model.py",
        "tension = (3 * (1 + MAX_STRAIN) ** 2 - 1) / 2",
        "tension = 1.0",
        ("geometry/test_membrane_model.py::test_the_bound_is_met_in_tension_along_the_warp",),
    ),
    Mutation(
        "weave-shear-of-one-sign",
        "kernels/membrane_forces.py",
        "abs_(angle)) * ti.select(cosine < 0.0, -1.0, 1.0)",
        "abs_(angle))",
        (WEAVE + "test_kernel_forces_are_those_of_the_float64_model[0.003-1.0-0.0-flat]",),
    ),
    Mutation(
        "weave-bends-without-reaction",
        "kernels/membrane_forces.py",
        "total -= on_a + on_c",
        "total += on_a + on_c",
        (WEAVE + "test_all_layouts_move_alike[plain-parallel-explicit]",),
    ),
    Mutation(
        "weave-short-threads-turn",
        "geometry/weave_model.py",
        "np.where(stretch > MIN_STRETCH, across * self.cosine / length**2, 0.0)",
        "across * self.cosine / length**2",
        (WEAVE_MODEL + "test_forces_are_minus_the_gradient_of_the_energy",),
    ),
    Mutation(
        "weave-bound-without-margin",
        "geometry/weave_model.py",
        "margin, shortest = KINK_MARGIN**2",
        "margin, shortest = 1.0",
        (WEAVE_MODEL + "test_no_vibration_is_faster_than_the_bound",),
    ),
    Mutation(
        "weave-threads-on-edges-are-whole",
        "geometry/weave_model.py",
        "share[:, :, [0, -1]] = 0.5",
        "share[:, :, [0, -1]] = 1.0",
        (WEAVE_MODEL + "test_threads_on_edges_represent_half_a_cell",),
    ),
    Mutation(
        "curves-may-be-level",
        "scene/keys.py",
        "if high <= low:",
        "if high < low:",
        ("scene/test_weave_keys.py::test_a_wrong_curve_is_one_line",),
    ),
    Mutation(
        "verlet-undamped",
        "solvers/verlet.py",
        "verlet_step(x, cloth.x_prev[i], params[VELOCITY_FACTOR],",
        "verlet_step(x, cloth.x_prev[i], 1.0,",
        ("solvers/test_verlet.py::test_verlet_matches_the_pbd_loop_to_rounding",),
    ),
    Mutation(
        "verlet-velocities-not-rescaled",
        "solvers/verlet.py",
        "rescale_velocities(self.cloth, new / old)",
        "rescale_velocities(self.cloth, 1.0)",
        ("solvers/test_contract.py::test_changing_the_substeps_keeps_velocities[verlet-simd]",),
    ),
    Mutation(
        "explicit-full-kick-at-the-start",
        "solvers/explicit.py",
        "kick = 0.5",
        "kick = 1.0",
        ("solvers/test_explicit.py::test_explicit_is_of_second_order",),
    ),
    Mutation(
        "rk4-equal-weights",
        "solvers/rk4.py",
        "1.0 / 6.0 if outer else 1.0 / 3.0",
        "0.25",
        ("solvers/test_explicit.py::test_rk4_is_of_fourth_order",),
    ),
    Mutation(
        "rk4-grab-at-the-end-in-every-stage",
        "solvers/rk4.py",
        "move_kinematic_particles(cloth, features, ctx, ctx.s + time)",
        "move_kinematic_particles(cloth, features, ctx, ctx.s + 1.0)",
        ("solvers/test_explicit.py::test_every_stage_of_rk4_uses_the_position_of_the_grab",),
    ),
    Mutation(
        "two-stages-wrong-stage-length",
        "solvers/two_stage.py",
        "GAMMA = 1 - sqrt(0.5)",
        "GAMMA = 1 - sqrt(0.4)",
        ("solvers/test_contract.py::test_free_fall_follows_its_discrete_closed_form[lines-simd]",),
    ),
    Mutation(
        "two-stages-without-extrapolation",
        "solvers/two_stage.py",
        "        ahead = EXTRAPOLATION\n",
        "        ahead = 0.0\n",
        ("solvers/test_implicit.py::test_many_iterations_converge_to_the_two_stage_step[serial-False]",),
    ),
    Mutation(
        "two-stages-extrapolate-impulses",
        "solvers/two_stage.py",
        "    prepare_extrapolation(cloth)\n    stage = ti.static(ctx._replace(dt_scale=STAGE_LENGTH))\n"
        "    project_distance_bounds(cloth, features, stage)\n    project_self_contacts(cloth, features, stage)\n"
        "    project_colliders(cloth, features, ti.static(stage._replace(s=stage_end(ctx) - 1.0)))\n",
        "    stage = ti.static(ctx._replace(dt_scale=STAGE_LENGTH))\n"
        "    project_distance_bounds(cloth, features, stage)\n    project_self_contacts(cloth, features, stage)\n"
        "    project_colliders(cloth, features, ti.static(stage._replace(s=stage_end(ctx) - 1.0)))\n"
        "    prepare_extrapolation(cloth)\n",
        ("solvers/test_two_stage.py::test_a_sheet_that_lands_in_any_part_of_a_substep_stays_down[lines]",),
    ),
    Mutation(
        "two-stages-lose-small-corrections",
        "solvers/lines.py",
        "    move_with_velocity(cloth, h)\n",
        "",
        ("solvers/test_two_stage.py::test_the_energy_stays_constant_in_very_short_steps[lines-simd]",),
    ),
    Mutation(
        "implicit-loses-small-corrections",
        "solvers/implicit.py",
        "    move_with_velocity(cloth, h)\n",
        "    for i in range(cloth.packet_count[None]):\n        cloth.x[i] = cloth.x[i] + cloth.cg.solution[i]\n",
        ("solvers/test_two_stage.py::test_the_energy_stays_constant_in_very_short_steps[implicit-simd]",),
    ),
    Mutation(
        "lines-substeps-too-long",
        "geometry/stability_bounds.py",
        "COURANT = 1.4",
        "COURANT = 2.8",
        ("solvers/test_lines.py::test_a_fine_curtain_takes_the_substeps_that_transverse_waves_require",),
    ),
    Mutation(
        "two-stages-without-strain-limit",
        "solvers/two_stage.py",
        "    project_strain_limit(cloth, features, ctx, ctx.h * STAGE_LENGTH)\n",
        "",
        ("solvers/test_strain_limit.py::test_hanging_cloth_is_stretched_to_the_limit[implicit]",),
    ),
    Mutation(
        "implicit-ends-newtons-method-too-early",
        "solvers/implicit.py",
        "LINEAR_RANGE = 0.03 ",
        "LINEAR_RANGE = 0.1 ",
        ("solvers/test_implicit.py::test_a_strip_that_is_folded_back_comes_to_rest[simd]",),
    ),
    Mutation(
        "implicit-keeps-only-the-last-correction",
        "solvers/implicit.py",
        "cloth.correction[i] = cloth.correction[i] + cloth.cg.solution[i]",
        "cloth.correction[i] = cloth.cg.solution[i]",
        ("solvers/test_implicit.py::test_many_iterations_converge_to_the_two_stage_step[serial-False]",),
    ),
    Mutation(
        "force-phase-limit-doubled",
        "geometry/stability_bounds.py",
        "MAX_FORCE_PHASE = 0.7",
        "MAX_FORCE_PHASE = 1.4",
        (
            "solvers/test_bending.py::test_a_compressed_strip_comes_to_rest",
            "solvers/test_bending.py::test_a_stiff_sheet_takes_more_substeps",
        ),
    ),
    Mutation(
        "explicit-held-particles-without-velocity",
        "solvers/explicit.py",
        "    if ctx.s == ctx.substeps:  # the frame ends",
        "    if ctx.s < 0:  # the frame ends",
        (
            "solvers/test_contract.py::test_held_particles_have_the_velocity_of_their_grab[explicit-serial]",
            "simulation/test_reaction_forces.py"
            "::test_a_damped_sheet_that_is_lifted_evenly_weighs_what_it_weighs[explicit]",
        ),
    ),
    Mutation(
        "implicit-never-leaves-the-linear-range",
        "solvers/implicit.py",
        "LINEAR_RANGE = 0.03 ",
        "LINEAR_RANGE = 1e3 ",
        ("solvers/test_implicit.py::test_an_iteration_takes_more_steps_where_particles_move_far[serial]",),
    ),
]
