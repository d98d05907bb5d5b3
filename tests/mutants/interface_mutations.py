"""Mutations of what users see: export, viewer and web page. Part of `mutations.py`."""

from __future__ import annotations

from mutation import Mutation

INTERFACES = [
    Mutation(
        "pc2-at-another-rate",
        "export/mesh_files.py",
        "START, RATE = 0.0, 1.0",
        "START, RATE = 0.0, 2.0",
        ("export/test_formats.py::test_pc2_contains_every_sample",),
    ),
    Mutation(
        "obj-indices-from-zero",
        "export/mesh_files.py",
        "(sheet.triangles + 1).tolist()",
        "sheet.triangles.tolist()",
        ("export/test_formats.py::test_obj_has_nine_digits_and_is_read_back_equal",),
    ),
    Mutation(
        "token-prefix-accepted",
        "web/server.py",
        "hmac.compare_digest(token.encode(), self.token.encode())",
        "self.token.startswith(token)",
        ("web/test_access.py::test_requests_without_the_token_are_rejected",),
    ),
    Mutation(
        "any-origin-accepted",
        "web/server.py",
        'urlsplit(request.headers["Origin"]).netloc != host',
        'not urlsplit(request.headers["Origin"]).netloc',
        ("web/test_access.py::test_only_the_own_page_of_the_server_may_connect",),
    ),
    Mutation(
        "any-host-accepted",
        "web/server.py",
        "if self.only_loopback and not is_loopback(_host_name(host)):",
        "if self.only_loopback and not host:",
        ("web/test_access.py::test_other_host_names_are_rejected",),
    ),
    Mutation(
        "parameters-not-clamped",
        "web/app.py",
        "clamped = min(max(value, parameter.slider_min), parameter.slider_max)",
        "clamped = max(value, parameter.slider_min)",
        ("web/test_commands.py::test_sliders_are_clamped_and_integers_are_rounded",),
    ),
    Mutation(
        "positions-of-pages-not-clamped",
        "web/protocol.py",
        "return min(max(number, low), high)",
        "return max(number, low)",
        ("web/test_protocol.py::test_views_are_clamped",),
    ),
    Mutation(
        "stalls-not-dropped",
        "simulation/frame_clock.py",
        "return min(frames, MAX_FRAMES)",
        "return frames",
        ("viewer/test_frame_clock.py::test_frames_missed_in_a_stall_are_dropped",),
    ),
    Mutation(
        "diverged-state-kept-for-rewinding",
        "viewer/session.py",
        "            if not self._guard.check_and_snapshot():\n"
        "                self.note = Refusal(self._guard.roll_back())\n"
        "                self.release_all()\n"
        "                self.frozen = True\n"
        "                break\n"
        "            self.rewind_buffer.add()\n",
        "            self.rewind_buffer.add()\n"
        "            if not self._guard.check_and_snapshot():\n"
        "                self.note = Refusal(self._guard.roll_back())\n"
        "                self.release_all()\n"
        "                self.frozen = True\n"
        "                break\n",
        ("viewer/test_session.py::test_a_state_that_diverged_is_not_kept_to_go_back_to",),
    ),
    Mutation(
        "error-of-another-scene-shown",
        "viewer/error_process.py",
        "self.answer, self._is_stale = None, True",
        "self._is_stale = True",
        (
            "viewer/test_session.py"
            "::test_a_frozen_cloth_that_has_changed_shows_no_time_and_error_of_the_one_before[next_scene]",
        ),
    ),
    Mutation(
        "measuring-without-pause",
        "viewer/error_process.py",
        "answer.seconds * (1 / SHARE_OF_TIME - 1)",
        "answer.seconds * SHARE_OF_TIME",
        ("viewer/test_error_process.py::test_measuring_takes_a_tenth_of_the_time",),
    ),
    Mutation(
        "answer-of-another-scene-taken",
        "viewer/error_process.py",
        "        if not self._is_stale:\n            self.answer = answer\n            self._add(self.error)\n",
        "        self.answer = answer\n        self._add(self.error)\n",
        ("viewer/test_error_process.py::test_an_answer_that_comes_after_the_cloth_has_changed_is_dropped",),
    ),
    Mutation(
        "errors-of-another-setting-in-the-median",
        "viewer/error_process.py",
        "        self.recent.clear()\n",
        "",
        ("viewer/test_session.py::test_an_error_that_arrives_while_the_cloth_is_frozen_is_shown",),
    ),
    Mutation(
        "slow-reference-not-refused",
        "viewer/error_process.py",
        "if error.seconds > MAX_SECONDS:",
        "if False:",
        ("viewer/test_error_process.py::test_a_reference_that_is_too_slow_or_diverges_is_refused",),
    ),
    Mutation(
        "refused-scene-sent-again",
        "viewer/error_process.py",
        "return not (is_refused or waits or self._is_busy)",
        "return not (waits or self._is_busy)",
        ("viewer/test_error_process.py::test_a_refused_scene_is_not_sent_again",),
    ),
    Mutation(
        "error-of-another-setting-shown",
        "viewer/session.py",
        'if event.name == "set_param" and self.meter is not None:',
        'if event.name == "set_params" and self.meter is not None:',
        ("viewer/test_session.py::test_another_setting_shows_no_error_of_the_one_before",),
    ),
    Mutation(
        "cloth-framed-under-the-panel",
        "render/camera.py",
        "        covered = 2 * self.view_shift\n",
        "        covered = 0.0\n",
        ("render/test_camera.py::test_a_cloth_under_the_panel_is_not_in_the_picture",),
    ),
    Mutation(
        "shift-of-near-points-ignored",
        "render/camera.py",
        "right = right + 2 * self.view_shift * half * back",
        "right = right + 0 * self.view_shift * half * back",
        ("render/test_camera.py::test_points_outside_the_picture_are_included[1.8-0.6]",),
    ),
    Mutation(
        "solids-lit-at-their-own-corners",
        "render/shading.py",
        "large = lengths.max(axis=1) > longest",
        "large = lengths.max(axis=1) > 100 * longest",
        (
            "render/test_lighting.py::test_a_divided_solid_has_short_edges_and_no_gaps",
            "render/test_draw_list.py::test_a_sphere_casts_its_shadow_on_the_middle_of_a_box[False]",
        ),
    ),
    Mutation(
        "order-of-sides-not-explained",
        "evaluation/compare.py",
        "if a and b and rms_a and rms_b and (a < b) != (rms_a < rms_b):",
        "if a and b and rms_a and rms_b and (a < b) == (rms_a < rms_b):",
        ("test_compare.py::test_figures_that_seem_to_contradict_each_other_are_explained",),
    ),
]
