"""Mutations of references: closed forms, solutions in float64, and measurements of runs. Part of `mutations.py`."""

from __future__ import annotations

from mutation import Mutation

EXACT = "validate/test_exact.py::"
DRAPE = "validate/test_drape.py::"
WOVEN = "validate/test_woven.py::"
JUDGES = "validate/test_judges.py::"
MOTION = "reference/test_dynamics.py::"
REST = "reference/test_rest.py::"
BOUNDS = "stress/test_case_bounds.py::"
VARIANTS = "stress/test_case_variants.py::"

REFERENCES = [
    Mutation(
        "hanging-chain-misses-its-last-weight",
        "evaluation/validate/exact.py",
        "return mass * GRAVITY * links * (links + 1) / (2 * constant)",
        "return mass * GRAVITY * links * links / (2 * constant)",
        (EXACT + "test_hanging_drop_is_the_sum_of_the_springs",),
    ),
    Mutation(
        "drum-of-a-continuum",
        "evaluation/validate/exact.py",
        "squares = 4 * np.sin(n * pi / (2 * cells)) ** 2",
        "squares = (n * pi / cells) ** 2",
        (EXACT + "test_a_taut_square_sags_by_the_published_share",),
    ),
    Mutation(
        "bias-modulus-of-half-the-diagonals",
        "evaluation/validate/exact.py",
        "return 4 * shear * (structural + 2 * shear) / (structural + 4 * shear)",
        "return 4 * shear * (structural + shear) / (structural + 4 * shear)",
        (EXACT + "test_the_bias_modulus_of_a_grid_has_the_published_numbers",),
    ),
    Mutation(
        "published-range-without-distance",
        "evaluation/validate/drape.py",
        "abs(result.coefficient - nearest), *INSIDE)",
        "0.0, *INSIDE)",
        (DRAPE + "test_the_error_is_the_distance_from_the_published_range",),
    ),
    Mutation(
        "shadow-counts-overlaps-twice",
        "evaluation/validate/drape.py",
        "return len(np.unique(cells[covered] @ [2.0**24, 1.0])) * cell**2",
        "return len(cells[covered]) * cell**2",
        (DRAPE + "test_the_shadow_of_a_cone_is_that_of_its_base",),
    ),
    Mutation(
        "curve-ends-at-its-last-point",
        "evaluation/validate/woven.py",
        "    if x > x_last:\n",
        "    if False:\n",
        (WOVEN + "test_a_typed_curve_is_linear_between_its_points_and_after_them",),
    ),
    Mutation(
        "shear-moment-compared-with-itself",
        "evaluation/validate/woven.py",
        'yield relative(what, typed("shear", angle), moment, *TYPED)',
        'yield relative(what, typed("shear", angle), typed("shear", angle), *TYPED)',
        (WOVEN + "test_a_moment_of_shear_that_is_too_large_falls_short",),
    ),
    Mutation(
        "creep-not-measured",
        "evaluation/validate/friction.py",
        'yield at_most("creep over the ground [m]", drift, *CREEP)',
        'yield at_most("creep over the ground [m]", 0.0, *CREEP)',
        (JUDGES + "test_noise_falls_short_in_every_row",),
    ),
    Mutation(
        "held-weight-compared-with-itself",
        "evaluation/validate/hanging.py",
        "rows = [relative(whats[0], 1.0, up / weight, *HELD)]",
        "rows = [relative(whats[0], 1.0, 1.0, *HELD)]",
        (JUDGES + "test_noise_falls_short_in_every_row",),
    ),
    Mutation(
        "strand-compared-with-itself",
        "evaluation/validate/strand.py",
        'row = relative("longer by [m]", exact, measured, *STRAND)',
        'row = relative("longer by [m]", exact, exact, *STRAND)',
        (JUDGES + "test_noise_falls_short_in_every_row",),
    ),
    Mutation(
        "mirror-image-not-compared",
        "evaluation/validate/symmetry.py",
        'row = at_most("difference to its mirror image [m]", float(np.abs(image - x).max()), *EQUAL)',
        'row = at_most("difference to its mirror image [m]", 0.0, *EQUAL)',
        (JUDGES + "test_noise_falls_short_in_every_row",),
    ),
    Mutation(
        "reference-friction-without-bound",
        "evaluation/reference/unilateral_contact.py",
        "reduction = np.minimum(friction * pushed, speed)",
        "reduction = np.minimum(1e9, speed)",
        (MOTION + "test_a_sheet_slides_down_a_slope",),
    ),
    Mutation(
        "reference-contact-without-bounce",
        "evaluation/reference/unilateral_contact.py",
        "(1 + bounce) * approach",
        "approach",
        (MOTION + "test_reflection_returns_the_restitution_of_the_speed",),
    ),
    Mutation(
        "reference-clip-at-rest",
        "evaluation/reference/unilateral_contact.py",
        "return velocity + at.axes @ self.distance.velocity() if",
        "return velocity if",
        ("reference/test_surfaces.py::test_a_mesh_with_a_clip_carries_and_lifts_cloth",),
    ),
    Mutation(
        "reference-clip-does-not-deform",
        "evaluation/reference/collider_distance.py",
        "self._seconds, self._vertices = seconds, self._vertices_at(seconds)",
        "self._seconds, self._vertices = seconds, self._vertices_at(0.0)",
        ("reference/test_surfaces.py::test_a_mesh_with_a_clip_has_the_distances_of_its_shape_at_a_time",),
    ),
    Mutation(
        "reference-membrane-without-damping",
        "evaluation/reference/solution.py",
        "return force if model.membrane is None else",
        "return force if True else",
        ("reference/test_solution.py::test_a_membrane_moves_as_with_a_fine_solver",),
    ),
    Mutation(
        "strip-of-meshes-always-as-long-as-it-should-be",
        "evaluation/validate/drape.py",
        "float(height[0] - height[end].mean()) / STRIP_LENGTH",
        "drop",
        ("validate/test_drape.py::test_a_strip_droops_and_swings_as_beams_do",),
    ),
    Mutation(
        "reference-surface-at-rest",
        "evaluation/reference/unilateral_contact.py",
        "relative = (v - obstacle.surface_velocity(x, at))[:, touched]",
        "relative = v[:, touched]",
        (MOTION + "test_a_sheet_sticks_to_a_slope_and_moves_with_it",),
    ),
    Mutation(
        "reference-penalty-also-outside",
        "evaluation/reference/unilateral_contact.py",
        "pushed = h * obstacle.collider.stiffness / area_density * np.maximum(-gap, 0.0)",
        "pushed = h * obstacle.collider.stiffness / area_density * np.abs(gap)",
        (MOTION + "test_repulsion_does_not_act_above_the_margin",),
    ),
    Mutation(
        "strain-of-softer-cloth",
        "evaluation/reference/static_solution.py",
        "(softer.strains(rest_positions(softer)) / excess)",
        "softer.strains(rest_positions(softer))",
        (REST + "test_the_strain_of_very_stiff_cloth_is_inversely_proportional_to_stiffness",),
    ),
    Mutation(
        "static-solution-far-from-equilibrium",
        "evaluation/reference/static_solution.py",
        "RESIDUAL = 0.02 ",
        "RESIDUAL = 50.0 ",
        (REST + "test_the_top_spring_of_a_hanging_strip_carries_the_weight_below_it",),
    ),
    Mutation(
        "layers-may-fall-off-the-bar",
        "evaluation/stress/layered_cloth.py",
        "int((heights.max(axis=1) < bar.center[1]).sum()), 0)",
        "int((heights.max(axis=1) < bar.center[1]).sum()))",
        (BOUNDS + "test_no_layer_may_fall_off_the_bar",),
    ),
    Mutation(
        "verlet-judged-by-another-cloth",
        "evaluation/stress/extremes.py",
        'rest = sheet(CELLS) if trial.setting.solver.name == "verlet" else None',
        "rest = None",
        (VARIANTS + "test_verlet_whose_shares_are_no_constants_is_judged_by_the_base_sheet",),
    ),
    Mutation(
        "verlet-keeps-its-shares-in-mid-run",
        "evaluation/stress/changes.py",
        'if trial.setting.solver.name == "verlet":',
        "if False:",
        (VARIANTS + "test_verlet_whose_shares_are_no_constants_is_judged_by_the_base_sheet",),
    ),
]
