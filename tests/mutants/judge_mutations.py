"""Mutations of what judges and keeps: `stress`, `validate`, the guard, saves. Part of `mutations.py`."""

from __future__ import annotations

from mutation import Mutation

WATCH = "stress/test_watch.py::"
TRIAL = "stress/test_trial.py::"
BOUNDS = "stress/test_rows_bounds.py::"
VARIANTS = "stress/test_rows_variants.py::"
UNIT = "stress/test_unit.py::"
CAUSES = "stress/test_causes.py::"
REPORT = "stress/test_report.py::"
VALIDATED = "validate/test_validate.py::"

STRESS_ROWS = [
    Mutation(
        "gap-always-wide",
        "stress/gaps.py",
        "return min(nearest(p, q, triangles, reach) for a, b in pairwise(layers) for p, q in ((a, b), (b, a)))",
        "return reach",
        (BOUNDS + "test_the_gap_between_sheets",),
    ),
    Mutation(
        "gap-order-ignored",
        "stress/gaps.py",
        "return bool((np.diff(heights) > 0).all())",
        "return True",
        (BOUNDS + "test_sheets_that_changed_places_are_out_of_order",),
    ),
    Mutation(
        "ejection-at-any-speed",
        "stress/overlaps.py",
        "EJECTED = 2.0",
        "EJECTED = 2000.0",
        (BOUNDS + "test_the_most_speed",),
    ),
    Mutation(
        "creep-unbounded",
        "stress/friction.py",
        'trial.tell("creep [m]", float(moved), CREEP)',
        'trial.tell("creep [m]", float(moved), 1e3)',
        (BOUNDS + "test_creep_is_seen",),
    ),
    Mutation(
        "slide-unbounded",
        "stress/friction.py",
        "trial.settle(most_speed=speed + CALM_SPEED)",
        "trial.settle(most_speed=speed + 1e9)",
        (BOUNDS + "test_a_sheet_that_slides_may_be_as_much_faster_than_a_block_as_any_cloth_at_rest",),
    ),
    Mutation(
        "turning-rate-unbounded",
        "stress/friction.py",
        "rate / radians(SPIN), 1 + FASTER)",
        "rate / radians(SPIN), 1e9)",
        (BOUNDS + "test_a_sheet_may_not_turn_faster_than_its_ball",),
    ),
    Mutation(
        "friction-force-unbounded",
        "stress/friction.py",
        "/ (mu * weight), 1 + HEAVIER)",
        "/ (mu * weight), 1e9)",
        (BOUNDS + "test_friction_on_a_loose_sheet_is_measured",),
    ),
    Mutation(
        "ball-half-as-wide",
        "stress/shots.py",
        "(beside < radius)",
        "(beside < radius / 2)",
        (BOUNDS + "test_what_goes_through_a_ball",),
    ),
    Mutation(
        "cap-unbounded",
        "stress/loads.py",
        "trial.watch.strain - cap, CAP_ROUNDING)",
        "trial.watch.strain - cap, 1e9)",
        (BOUNDS + "test_a_cap_is_held_in_every_frame",),
    ),
    Mutation(
        "chatter-unbounded",
        "stress/loads.py",
        'trial.tell("speed edge-on [m/s]", trial.watch.speed, CHATTER)',
        'trial.tell("speed edge-on [m/s]", trial.watch.speed, 1e9)',
        (BOUNDS + "test_the_most_speed",),
    ),
    Mutation(
        "recovery-unbounded",
        "stress/loads.py",
        "abs(trial.watch.strain - static), RECOVERED)",
        "abs(trial.watch.strain - static), 1e9)",
        (BOUNDS + "test_what_was_pulled_apart_is_within_a_thousandth_of_its_static_strain",),
    ),
    Mutation(
        "drift-unbounded",
        "stress/rates.py",
        "DRIFT * SIDE)",
        "1e9 * SIDE)",
        (BOUNDS + "test_drift_is_seen",),
    ),
    Mutation(
        "rates-not-compared",
        "stress/rates.py",
        "abs(sags[1] / sags[0] - 1), SAG)",
        "0.0 * abs(sags[1] / sags[0] - 1), SAG)",
        (BOUNDS + "test_sags_of_two_rates_are_compared",),
    ),
    Mutation(
        "pause-not-compared",
        "stress/rates.py",
        'trial.tell("numbers that changed while paused", changed(before, session), 0)',
        'trial.tell("numbers that changed while paused", 0, 0)',
        (BOUNDS + "test_a_bit_that_changes_while_paused_is_seen",),
    ),
    Mutation(
        "refused-input-may-change",
        "stress/changes.py",
        'trial.tell("numbers that a refused input changed", changed, 0)',
        'trial.tell("numbers that a refused input changed", changed, 1e9)',
        (BOUNDS + "test_a_bit_that_a_refused_input_changes_is_seen",),
    ),
    Mutation(
        "places-may-jump",
        "stress/changes.py",
        "float(np.abs(trial.simulation.positions() - x).max()), 0)",
        "float(np.abs(trial.simulation.positions() - x).max()), 1e9)",
        (BOUNDS + "test_a_place_may_not_jump_by_a_bit",),
    ),
    Mutation(
        "speeds-may-jump",
        "stress/changes.py",
        "error, SPEED_ROUNDING + 2 * ROUNDING / h)",
        "error, 1e9)",
        (BOUNDS + "test_a_velocity_may_jump_by_what_float32_rounds",),
    ),
    Mutation(
        "speeds-are-rounded-coarsely",
        "stress/changes.py",
        "SPEED_ROUNDING = 1e-3 ",
        "SPEED_ROUNDING = 2e-3 ",
        (BOUNDS + "test_a_velocity_may_jump_by_what_float32_rounds",),
    ),
    Mutation(
        "second-time-not-compared",
        "stress/starts.py",
        "int((ends[0] != ends[1]).sum()), 0)",
        "int((ends[0] != ends[1]).sum()), 1e9)",
        (BOUNDS + "test_a_collapsed_sheet_that_ends_otherwise_the_second_time_is_seen",),
    ),
    Mutation(
        "far-sag-unbounded",
        "stress/sizes.py",
        "abs(sags[1] / sags[0] - 1), SAG)",
        "abs(sags[1] / sags[0] - 1), 1e9)",
        (BOUNDS + "test_a_sheet_far_away_sags_alike_to_a_hundredth",),
    ),
    Mutation(
        "far-sag-of-two-hundredths",
        "stress/sizes.py",
        "SAG = 0.01 ",
        "SAG = 0.02 ",
        (BOUNDS + "test_a_sheet_far_away_sags_alike_to_a_hundredth",),
    ),
    Mutation(
        "far-fall-of-two-hundredths",
        "stress/sizes.py",
        "FALL_SECONDS, FALL = 0.4, 0.01 ",
        "FALL_SECONDS, FALL = 0.4, 0.02 ",
        (BOUNDS + "test_a_fall_is_exact_to_a_hundredth_and_a_substep",),
    ),
    Mutation(
        "large-sheet-of-any-places",
        "stress/sizes.py",
        "int((~np.isfinite(trial.simulation.positions())).sum()), 0)",
        "int((~np.isfinite(trial.simulation.positions())).sum()), 1e9)",
        (BOUNDS + "test_a_place_of_a_large_sheet_that_is_not_finite_is_seen",),
    ),
    Mutation(
        "all-pins-may-go",
        "stress/loads.py",
        "float(np.abs(trial.simulation.positions() - np.float32(x)).max()), 0)",
        "float(np.abs(trial.simulation.positions() - np.float32(x)).max()), 1e9)",
        (BOUNDS + "test_a_pin_that_goes_by_one_bit_is_seen",),
    ),
    Mutation(
        "dashpots-fall-of-two-hundredths",
        "stress/loads.py",
        "FALLS = 0.01 ",
        "FALLS = 0.02 ",
        (BOUNDS + "test_a_fall_is_exact_to_a_hundredth_and_a_substep",),
    ),
    Mutation(
        "drift-of-a-thousandth",
        "stress/rates.py",
        "DRIFT = 1e-4 ",
        "DRIFT = 1e-3 ",
        (BOUNDS + "test_a_hanging_sheet_may_drift_by_a_ten_thousandth_of_its_side",),
    ),
    Mutation(
        "frames-pass-while-paused",
        "stress/rates.py",
        'trial.tell("frames that passed while paused", session.simulation.frame, 0)',
        'trial.tell("frames that passed while paused", session.simulation.frame, 1e9)',
        (BOUNDS + "test_frames_that_pass_while_paused_are_seen",),
    ),
    Mutation(
        "pause-not-compared-later",
        "stress/rates.py",
        'trial.tell("numbers that a pause changed later", changed(after, session), 0)',
        'trial.tell("numbers that a pause changed later", changed(after, session), 1e9)',
        (BOUNDS + "test_a_bit_that_a_pause_changed_later_is_seen",),
    ),
    Mutation(
        "twist-may-end-crossed",
        "stress/layers.py",
        '    trial.tell("crossings at the end", simulation.crossings(), 0)\n',
        '    trial.tell("crossings at the end", simulation.crossings(), 1e9)\n',
        (BOUNDS + "test_a_sheet_twisted_back_crosses_nothing",),
    ),
    Mutation(
        "twist-may-end-elsewhere",
        "stress/layers.py",
        "SHAPE = 0.01 * SIDE ",
        "SHAPE = 0.02 * SIDE ",
        (BOUNDS + "test_a_sheet_twisted_back_crosses_nothing",),
    ),
    Mutation(
        "pile-not-judged-at-its-end",
        "stress/layers.py",
        "    stack.run(2.5)\n    trial.settle()\n    stack.end()\n",
        "    stack.run(2.5)\n    trial.settle()\n",
        (BOUNDS + "test_a_pile_is_judged_at_its_end",),
    ),
    Mutation(
        "fast-ball-not-looked-at",
        "stress/shots.py",
        "    run_past(trial, (BEFORE + BEHIND) / speed + 2.6)\n",
        "    trial.run((BEFORE + BEHIND) / speed + 2.6)\n",
        (BOUNDS + "test_the_fast_ball_is_looked_at_in_every_frame",),
    ),
]

STRESS_JUDGE = [
    Mutation(
        "frames-of-a-tenth-of-a-second",
        "stress/trial.py",
        "SLOW_MS = 1000 / 30 ",
        "SLOW_MS = 1000 / 10 ",
        (TRIAL + "test_what_is_too_slow_stops",),
    ),
    Mutation(
        "timed-once",
        "stress/trial.py",
        "(count and count % TIMED_EVERY == 0)",
        "False",
        (TRIAL + "test_what_is_too_slow_stops",),
    ),
    Mutation(
        "look-is-timed",
        "stress/trial.py",
        "            simulation.advance_slowly(look)\n",
        "            simulation.advance_slowly(look)\n            self.times.append(99.0)\n",
        (TRIAL + "test_a_frame_that_is_looked_at_after_every_substep_is_not_timed",),
    ),
    Mutation(
        "calm-strain-loose",
        "stress/trial.py",
        "CALM_STRAIN = 0.01 ",
        "CALM_STRAIN = 0.5 ",
        (TRIAL + "test_strain_is_at_most_one_percent_above_the_static_one",),
    ),
    Mutation(
        "calm-speed-loose",
        "stress/trial.py",
        "CALM_SPEED = 0.1 ",
        "CALM_SPEED = 0.4 ",
        (TRIAL + "test_nothing_is_faster_than_a_tenth_of_a_metre_a_second",),
    ),
    Mutation(
        "told-bound-ignored",
        "stress/trial.py",
        "            self.demand(what, value, bound)\n\n    def refuses",
        "            pass\n\n    def refuses",
        (TRIAL + "test_what_is_told_and_refused",),
    ),
    Mutation(
        "settle-not-required",
        "stress/trial.py",
        "        if self._unjudged:\n",
        "        if False:\n",
        (TRIAL + "test_a_cloth_must_be_judged_at_rest",),
    ),
    Mutation(
        "growth-always-given",
        "stress/watch.py",
        "self.given(min(growth, self._work_bound(x, v)))",
        "self.given(growth)",
        (WATCH + "test_energy_out_of_nothing", WATCH + "test_what_may_do_work_excuses_no_more_than_it_can_do"),
    ),
    Mutation(
        "wind-gives-anything",
        "stress/watch.py",
        "return float(force @ np.linalg.norm(x - self._x, axis=1))",
        "return 1e9",
        (WATCH + "test_what_may_do_work_excuses_no_more_than_it_can_do",),
    ),
    Mutation(
        "pins-not-watched",
        "stress/watch.py",
        "if not np.array_equal(np.float32(x[topology.pinned]), self._pins):",
        "if False:",
        (WATCH + "test_a_pin_that_moves",),
    ),
    Mutation(
        "no-reach",
        "stress/watch.py",
        "if away > most:",
        "if away > 1e9 * most:",
        (WATCH + "test_a_particle_that_is_away",),
    ),
    Mutation(
        "energy-slack-wide",
        "stress/watch.py",
        "ENERGY_SLACK = 0.01 ",
        "ENERGY_SLACK = 10.0 ",
        (WATCH + "test_energy_out_of_nothing",),
    ),
    Mutation(
        "too-slow-counts-as-alive",
        "stress/unit.py",
        "return FAILED if self.failure else ALIVE if self.slow_ms is None else SLOW",
        "return FAILED if self.failure else ALIVE",
        (UNIT + "test_too_slow_is_neither_alive_nor_failed",),
    ),
    Mutation(
        "cause-without-bound",
        "stress/causes.py",
        "failure.what == self.what and failure.value <= self.most",
        "failure.what == self.what",
        (REPORT + "test_a_cause_explains_its_bound_alone",),
    ),
    Mutation(
        "cause-of-another-program",
        "stress/causes.py",
        "return alike and result.origin == self.origin",
        "return alike",
        (REPORT + "test_a_cause_explains_its_bound_alone",),
    ),
    Mutation(
        "mended-by-chance",
        "stress/causes.py",
        "for seed in (end.failure.seed, *others[: STARTS - 1])",
        "for seed in (end.failure.seed,)",
        (CAUSES + "test_the_start_that_failed_and_two_others_must_be_alive",),
    ),
    Mutation(
        "rounding-of-world-coordinates",
        "stress/watch.py",
        "np.abs(x - topology.origin).max(initial=0.0)",
        "np.abs(x).max(initial=0.0)",
        (WATCH + "test_energy_out_of_nothing_is_seen_ten_kilometres_away",),
    ),
    Mutation(
        "slide-may-stick",
        "stress/friction.py",
        'trial.tell("slower than a sliding block by [m/s]", behind, CALM_SPEED)',
        'trial.tell("slower than a sliding block by [m/s]", behind, 1e9)',
        (BOUNDS + "test_a_sheet_without_friction_slides",),
    ),
    Mutation(
        "experiment-believes-itself",
        "stress/causes.py",
        "    except Exception:  # it breaks a bound too, takes too long, or cannot be run so\n        return False\n",
        "    except Exception:  # it breaks a bound too, takes too long, or cannot be run so\n        return True\n",
        (CAUSES + "test_what_an_experiment_shows",),
    ),
    Mutation(
        "experiment-without-a-limit",
        "stress/causes.py",
        "        if sum(self.times) > 1e3 * self.seconds:\n",
        "        if False:\n",
        (CAUSES + "test_an_experiment_that_takes_too_long_shows_nothing",),
    ),
    Mutation(
        "any-strain-is-at-rest",
        "stress/causes.py",
        "    stays = there > end.failure.bound and np.isclose(here, there, rtol=STAYS)\n",
        "    stays = True\n",
        (CAUSES + "test_a_strain_that_float64_loses_is_not_at_rest",),
    ),
]

STRESS_VARIANTS = [
    Mutation(
        "one-stiffness-for-all",
        "stress/catalogue.py",
        'variants(springs.stiffness_sweep, {f"1e{k} N/m": 10.0**k for k in range(10)})',
        'variants(springs.stiffness_sweep, {f"1e{k} N/m": 1e3 for k in range(10)})',
        (VARIANTS + "test_each_value_is_in_the_scene",),
    ),
    Mutation(
        "ratio-of-one",
        "stress/catalogue.py",
        'variants(springs.stiffness_ratio, {"1e4": 1e4, "1e6": 1e6})',
        'variants(springs.stiffness_ratio, {"1e4": 1.0, "1e6": 1.0})',
        (VARIANTS + "test_one_half_of_the_sheet_is_stiffer", VARIANTS + "test_each_value_is_in_the_scene"),
    ),
    Mutation(
        "pins-stay",
        "stress/catalogue.py",
        '{"×2": 2.0, "×5": 5.0, "×10": 10.0}',
        '{"×2": 1.0, "×5": 1.0, "×10": 1.0}',
        (VARIANTS + "test_pins_go_so_far",),
    ),
]

KEPT = [
    Mutation(
        "guard-without-z",
        "kernels/guarding.py",
        "is_finite(x.x) * is_finite(x.y) * is_finite(x.z)",
        "is_finite(x.x) * is_finite(x.y)",
        ("test_guard.py::test_one_bad_component_of_one_particle_is_found",),
    ),
    Mutation(
        "wind-switch-lost",
        "simulation.py",
        'self._wind_on = bool(saved["wind_on"])',
        "pass",
        ("faults/test_saves.py::test_the_wind_switch_is_saved",),
    ),
]

VALIDATE = [
    Mutation(
        "verdict-ten-times-as-wide",
        "validate/row.py",
        "self.error > self.good:",
        "self.error > 10 * self.good:",
        (VALIDATED + "test_verdicts",),
    ),
    Mutation(
        "law-explains-ten-times-as-much",
        "validate/row.py",
        "Limit(law, error + (self.good if",
        "Limit(law, 10 * error + (self.good if",
        ("validate/test_bounds.py::test_a_law_explains_its_own_error_and_what_passes",),
    ),
    Mutation(
        "broken-never-told",
        "validate/row.py",
        "self.limit is not None and not self.explained",
        "False",
        (VALIDATED + "test_reasons_and_the_last_line", VALIDATED + "test_the_command"),
    ),
    Mutation(
        "beside-the-middle",
        "validate/setups.py",
        "x[-1 - side // 2]",
        "x[-(side // 2)]",
        (VALIDATED + "test_the_middle_of_the_bottom_is_at_the_same_place_whatever_the_cells",),
    ),
    Mutation(
        "best-row-of-the-curtain",
        "validate/swing.py",
        ".max(axis=(1, 2))",
        ".min(axis=(1, 2))",
        (VALIDATED + "test_every_row_of_the_curtain_is_judged",),
    ),
]

RUNNING = [
    Mutation(
        "case-changed-and-not-run-again",
        "stress/origin.py",
        "for name in {*JUDGES, *rows}}",
        "for name in JUDGES}",
        ("stress/test_origin.py::test_which_results_a_changed_file_is_about",),
    ),
    Mutation(
        "method-changed-and-not-run-again",
        "stress/origin.py",
        "for name in SOLVER_NAMES if name != solver}",
        "for name in SOLVER_NAMES}",
        ("stress/test_origin.py::test_which_results_a_changed_file_is_about",),
    ),
    Mutation(
        "older-results-not-told",
        "stress/store.py",
        "self.older = sum(not self._is_new(result) for result in self.results.values())",
        "self.older = 0",
        ("stress/test_store.py::test_older_results_stay_until_they_are_run_again",),
    ),
    Mutation(
        "jobs-outlive-their-parent",
        "side_by_side.py",
        "os._exit(1)",
        "pass",
        ("test_side_by_side.py::test_jobs_end_with_the_process_that_began_them",),
    ),
]

REFERENCE = [
    Mutation(
        "reference-triangle-corners-move-alike",
        "reference/triangles.py",
        "each = weight * self._inverse_mass[corners]",
        "each = np.full(3, self._inverse_mass[corners].mean() / 3)",
        ("reference/test_triangles.py::test_the_point_stops_and_momentum_and_spin_are_those_of_a_push_there",),
    ),
    Mutation(
        "reference-triangles-one-round",
        "reference/triangles.py",
        "ROUNDS = 200",
        "ROUNDS = 1",
        ("reference/test_triangles.py::test_triangles_that_share_corners_all_stop",),
    ),
    Mutation(
        "reference-triangles-no-friction",
        "reference/triangles.py",
        "np.array([approach]), self._friction)",
        "np.array([approach]), 0.0)",
        ("reference/test_triangles.py::test_friction_takes_its_share_of_what_is_stopped_and_never_more_than_there_is",),
    ),
    Mutation(
        "reference-goes-on-where-threads-tear",
        "reference/solution.py",
        "for one in (scene.limit, scene.tear)",
        "for one in (scene.limit,)",
        ("reference/test_solution.py::test_it_ends_before_a_strain_limit_acts_or_a_spring_tears",),
    ),
]

JUDGES: list[Mutation] = [*STRESS_ROWS, *STRESS_JUDGE, *STRESS_VARIANTS, *KEPT, *VALIDATE, *RUNNING, *REFERENCE]
