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
        "    simulation.depenetration.invalidate()\n    simulation.set_torn(False)\n",
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
    Mutation(
        "frame-error-against-the-coarser-reference",
        "simulation/copies.py",
        "distances = np.linalg.norm(after - runs[1], axis=1)",
        "distances = np.linalg.norm(after - runs[0], axis=1)",
        (
            "simulation/test_copies.py::test_the_error_is_that_of_each_particle_and_their_root_mean_square",
            "simulation/test_copies.py::test_twice_the_substeps_make_a_quarter_of_the_error_of_a_second_order_solver[explicit]",
        ),
    ),
    Mutation(
        "step-error-of-the-frame-itself",
        "simulation/copies.py",
        "step_error=rms_distance(converged, runs[1])",
        "step_error=rms_distance(after, runs[1])",
        ("simulation/test_copies.py::test_residual_and_step_error_are_apart",),
    ),
    Mutation(
        "residual-against-the-reference",
        "simulation/copies.py",
        "residual=rms_distance(after, converged)",
        "residual=rms_distance(after, runs[1])",
        (
            "simulation/test_copies.py::test_residual_and_step_error_are_apart",
            "simulation/test_copies.py::test_converged_iterations_have_no_residual",
        ),
    ),
    Mutation(
        "reference-without-grabs",
        "simulation/copies.py",
        "self.set_grabs(",
        "dict(",
        ("simulation/test_copies.py::test_grabs_wind_parameters_pins_and_moving_colliders_act_on_the_reference",),
    ),
    Mutation(
        "reference-without-wind-switch",
        "simulation/copies.py",
        'self.params["wind"] = start.wind_on',
        "pass",
        ("simulation/test_copies.py::test_grabs_wind_parameters_pins_and_moving_colliders_act_on_the_reference",),
    ),
    Mutation(
        "reference-of-another-frame",
        "simulation/copies.py",
        "self.set_frame(start.frame)",
        "self.set_frame(start.frame + 1)",
        ("simulation/test_copies.py::test_grabs_wind_parameters_pins_and_moving_colliders_act_on_the_reference",),
    ),
    Mutation(
        "growth-with-converged-iterations",
        "simulation/copies.py",
        "self._same.iteration_factor, self._reference.refinement = 1,",
        "self._same.iteration_factor, self._reference.refinement = MANY_ITERATIONS,",
        ("simulation/test_copies.py::test_the_growth_is_the_distance_after_a_second_with_grabs_at_rest",),
    ),
    Mutation(
        "rewind-keeps-later-states",
        "simulation/rollback.py",
        "            del self._states[-self._back :]\n",
        "",
        ("simulation/test_rewind.py::test_the_states_after_the_present_one_are_dropped_when_the_cloth_moves_on",),
    ),
    Mutation(
        "rewind-without-limit",
        "simulation/rollback.py",
        "if old.can_undo or old.seconds >= oldest]",
        "if True]",
        ("simulation/test_rewind.py::test_time_and_memory_are_limited",),
    ),
    Mutation(
        "undo-of-later-changes",
        "simulation/rollback.py",
        "if state.can_undo and back >= self._back:",
        "if state.can_undo:",
        ("simulation/test_rewind.py::test_undo_after_going_back_undoes_what_came_before",),
    ),
    Mutation(
        "rewind-keeps-grabs",
        "simulation/rollback.py",
        "        restore(self._simulation, self._states[-1 - back].arrays)\n        self._simulation.set_grabs({})\n",
        "        restore(self._simulation, self._states[-1 - back].arrays)\n",
        (
            "simulation/test_rewind.py::test_undo_restores_the_state_before_each_change_the_last_first",
            "simulation/test_rewind.py::test_it_goes_back_to_the_nearest_state_and_on_with_the_same_bits",
        ),
    ),
    Mutation(
        "reactions-without-acceleration",
        "simulation/running_cloth.py",
        "self._prescribed_acceleration() * self.topology.mass[:, None] - self.forces()",
        "-self.forces()",
        (
            "simulation/test_reaction_forces.py::test_a_sheet_held_as_a_whole_needs_its_mass_times_acceleration_and_its_weight",
            "simulation/test_reaction_forces.py::test_attached_pins_need_the_force_that_their_motion_takes",
        ),
    ),
    Mutation(
        "forces-without-wind",
        "simulation/running_cloth.py",
        "force += wind.force(x, v, self.seconds)",
        "pass",
        (
            "simulation/test_reaction_forces.py::test_forces_are_those_of_the_kernels",
            "simulation/test_reaction_forces.py::test_wind_that_is_off_still_resists_motion",
        ),
    ),
    Mutation(
        "late-recording-without-events-before-it",
        "simulation/recording.py",
        "if simulation.has_changed or simulation.frames_stepped:",
        "if simulation.frames_stepped:",
        ("simulation/test_recording.py::test_a_recording_of_a_simulation_that_has_changed_begins_with_its_state[pin]",),
    ),
    Mutation(
        "late-recording-without-frames-before-it",
        "simulation/recording.py",
        "if simulation.has_changed or simulation.frames_stepped:",
        "if simulation.has_changed:",
        (
            "simulation/test_recording.py::test_a_recording_of_a_simulation_that_has_changed_begins_with_its_state[frames]",
        ),
    ),
    Mutation(
        "preset-of-a-python-scene-ignored",
        "scene/schema.py",
        "if name and len(fabric) < len(keys_of(Fabric)):",
        'if isinstance(self.fabric, dict) and fabric.get("preset"):',
        ("scene/test_presets.py::test_a_preset_of_a_python_scene_is_refused",),
    ),
    Mutation(
        "objects-set-all-keys",
        "scene/keys.py",
        "for name in keys_of(cls) if name in section.given_keys}",
        "for name in keys_of(cls)}",
        ("scene/test_overrides.py::test_an_object_sets_the_keys_that_were_given_as_a_dict_does",),
    ),
]
