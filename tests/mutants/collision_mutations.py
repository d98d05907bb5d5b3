"""Mutations of collision detection and response, and self-collision. Part of `mutations.py`."""

from __future__ import annotations

from mutation import Mutation

BODIES = "collision/test_colliders.py::"

CLIPS = "collision/test_deforming_meshes.py::"
PENETRATION_FREE = "collision/test_penetration_free.py::"

COLLISION = [
    Mutation(
        "friction-ignores-collider-translation",
        "collision/response.py",
        "surface = broadcast(travel * fraction, x) + cross(",
        "surface = broadcast(travel * 0.0, x) + cross(",
        (BODIES + "test_a_moving_collider_drags_cloth_along[planes-False]",),
    ),
    Mutation(
        "friction-ignores-collider-rotation",
        "collision/response.py",
        "cross(broadcast(rotation * fraction, x), offset + push)",
        "cross(broadcast(rotation * 0.0, x), offset + push)",
        (BODIES + "test_a_rotating_plate_drags_cloth_along",),
    ),
    Mutation(
        "no-continuous-collision-detection",
        "collision/response.py",
        "impact <= 1.0, stopped",
        "impact <= -1.0, stopped",
        ("collision/test_ccd.py::test_no_particle_passes_through_a_fast_sphere_in_one_substep",),
    ),
    Mutation(
        "collider-at-the-start-of-the-substep",
        "collision/response.py",
        "PROJECTION, project, ctx.s + 1.0)",
        "PROJECTION, project, ctx.s + 0.0)",
        (BODIES + "test_particles_leave_a_moving_and_rotating_collider_by_the_shortest_displacement[4-spheres]",),
    ),
    Mutation(
        "time-of-impact-of-the-far-side",
        "collision/shapes/sphere.py",
        "time = (neg(b) - ti.sqrt(",
        "time = (neg(b) + ti.sqrt(",
        ("collision/test_ccd.py::test_paths_stop_where_they_first_reach_the_margin[spheres]",),
    ),
    Mutation(
        "capsule-without-ends",
        "collision/shapes/capsule.py",
        "ti.min(ti.max(dot(offset, along), -size.x), size.x)",
        "dot(offset, along)",
        (BODIES + "test_particles_leave_a_moving_and_rotating_collider_by_the_shortest_displacement[4-capsules]",),
    ),
    Mutation(
        "restitution-of-one",
        "collision/response.py",
        "-(1.0 + restitution) * ti.min(dot(normal, velocity), 0.0)",
        "-2.0 * ti.min(dot(normal, velocity), 0.0)",
        ("collision/test_response.py::test_reflected_cloth_bounces_to_the_restitution_squared_times_its_height",),
    ),
    Mutation(
        "repulsion-without-area-density",
        "collision/response.py",
        "table[row, COLLIDER_STIFFNESS] / ctx.params[AREA_DENSITY]",
        "table[row, COLLIDER_STIFFNESS]",
        ("collision/test_response.py::test_repelled_cloth_rests_where_the_pressure_carries_its_weight",),
    ),
    Mutation(
        "depenetration-at-once",
        "collision/response.py",
        "GROWTH_RATE = 0.2",
        "GROWTH_RATE = 20.0",
        ("collision/test_depenetration.py::test_the_depth_of_a_collider_is_tracked_until_it_is_zero",),
    ),
    Mutation(
        "teleports-are-swept",
        "collision/colliders.py",
        "> TELEPORT_SPEED * (b[0] - a[0]))",
        "> 1e9 + TELEPORT_SPEED * (b[0] - a[0]))",
        ("collision/test_depenetration.py::test_keyframes_faster_than_sound_are_a_teleport",),
    ),
    Mutation(
        "self-collision-does-not-bring-back",
        "collision/self_collision.py",
        "side = ti.select(gap.dot(start_gap) < 0.0, -1.0, 1.0)",
        "side = 1.0",
        ("collision/test_self_collision.py::test_a_particle_that_passed_through_another_is_moved_back",),
    ),
    Mutation(
        "self-collision-without-friction",
        "collision/self_collision.py",
        "push += friction_correction(push, slide, ctx.params[SELF_FRICTION])",
        "push += friction_correction(push, slide, 0.0 * ctx.params[SELF_FRICTION])",
        ("collision/test_self_collision.py::test_friction_stops_sliding_along_a_contact",),
    ),
    Mutation(
        "self-collision-at-half-the-thickness",
        "collision/self_collision.py",
        "depth = thickness - side * distance",
        "depth = 0.5 * thickness - side * distance",
        ("collision/test_self_collision.py::test_approaching_particles_stop_a_thickness_apart",),
    ),
    Mutation(
        "separation-speed-unbounded",
        "collision/self_collision.py",
        "MAX_SEPARATION_SPEED = 1.5 ",
        "MAX_SEPARATION_SPEED = 150.0 ",
        ("collision/test_self_collision.py::test_particles_too_close_at_the_start_are_separated_slowly",),
    ),
    Mutation(
        "anchors-of-any-earlier-substep",
        "collision/static_friction.py",
        "if anchors.last_contact[entry] == ctx.s - 1:",
        "if anchors.last_contact[entry] >= 0:",
        ("collision/test_static_friction.py::test_an_anchor_lasts_while_the_pair_is_in_contact",),
    ),
    Mutation(
        "static-friction-unbounded",
        "collision/static_friction.py",
        "slide *= ti.min(1.0,",
        "slide *= ti.max(1.0,",
        ("collision/test_static_friction.py::test_an_anchor_lasts_while_the_pair_is_in_contact",),
    ),
    Mutation(
        "broad-phase-skips-cells",
        "collision/self_broadphase.py",
        "        for r in range(5):",
        "        for r in range(4):",
        ("collision/test_self_collision.py::test_the_broad_phase_finds_all_pairs",),
    ),
    Mutation(
        "intersections-of-infinite-lines",
        "collision/untangling.py",
        "signed_volume(a, b, c, p) * signed_volume(a, b, c, q) < 0.0",
        "signed_volume(a, b, c, p) * signed_volume(a, b, c, q) < 1e9",
        ("collision/test_self_collision.py::test_intersections_match_brute_force",),
    ),
    Mutation(
        "intersecting-particles-keep-contact",
        "collision/self_collision.py",
        "if distance < thickness and intersecting == 0:",
        "if distance < thickness and intersecting >= 0:",
        ("collision/test_untangling.py::test_contact_is_released_at_intersections",),
    ),
    Mutation(
        "triangle-friction-ignores-motion",
        "collision/triangle_collision.py",
        "slid = weights.x * path_a + weights.y * path_b + weights.z * path_c",
        "slid = 0.0 * (weights.x * path_a + weights.y * path_b + weights.z * path_c)",
        ("collision/test_triangle_collision.py::test_friction_drags_the_contact_point_along",),
    ),
    # -- deforming meshes ----------------------------------------------------------------------------------------------
    Mutation(
        "clip-surface-without-velocity",
        "collision/deforming_meshes.py",
        "surface = packet(cloth, contacts.motion, i) * fraction",
        "surface = packet(cloth, contacts.motion, i) * 0.0",
        (CLIPS + "test_a_moving_floor_drags_a_sheet_by_coulombs_law",),
    ),
    Mutation(
        "clip-inside-is-outside",
        "collision/deforming_meshes.py",
        "offset / distance * ti.select(offset.dot(normal) < 0.0, -1.0, 1.0)",
        "offset / distance",
        (CLIPS + "test_particles_near_any_feature_get_out_to_the_margin_or_stay",),
    ),
    Mutation(
        "clip-lists-outlive-their-time",
        "collision/deforming_meshes.py",
        " or end > contacts.until[i]:",
        ":",
        (CLIPS + "test_a_sheet_shot_at_a_thick_body_stops_at_its_surface",),
    ),
    Mutation(
        "clip-balls-are-never-left",
        "collision/deforming_meshes.py",
        "deviation > contacts.radius[i]",
        "deviation > 1e9",
        (CLIPS + "test_a_sheet_that_begins_to_fall_within_a_frame_stops_at_the_surface",),
    ),
    Mutation(
        "clip-depth-of-faces-only",
        "collision/deforming_meshes.py",
        "inside = int(away.dot(feature_normal(surfaces, nearest, weights)) < 0.0)",
        "inside = int(away.dot(surfaces.face_normal[nearest]) < 0.0)",
        (CLIPS + "test_penetration_is_the_depth_of_the_deepest_particle",),
    ),
    Mutation(
        "clip-samples-without-interpolation",
        "geometry/mesh_clip.py",
        "share = position - k",
        "share = 0.0 * position",
        (CLIPS + "test_a_growing_body_pushes_cloth_to_its_margin[xpbd-serial]", "geometry/test_mesh_clip.py"),
    ),
    # -- penetration-free contact --------------------------------------------------------------------------------------
    Mutation(
        "truncation-is-not-applied",
        "collision/truncation.py",
        "        if fraction < 1.0:\n            ti.atomic_add",
        "        if fraction < 0.0:\n            ti.atomic_add",
        (PENETRATION_FREE + "test_attachments_that_are_driven_through_cloth_lag_behind",),
    ),
    Mutation(
        "truncation-goes-too-far",
        "collision/truncation.py",
        "ti.atomic_min(data.next_fraction[i], fraction)",
        "ti.atomic_min(data.next_fraction[i], 0.3 + 0.7 * fraction)",
        (PENETRATION_FREE + "test_attachments_that_are_driven_through_cloth_lag_behind",),
    ),
    Mutation(
        "truncation-leaves-balls",
        "collision/truncation.py",
        "elif not is_in_ball(data, i, 0.0):",
        "elif is_in_ball(data, i, 1e9):",
        (PENETRATION_FREE + "test_a_sheet_thrown_at_100_meters_per_second_stays_on_its_side",),
    ),
    Mutation(
        "guard-claims-a-clean-state",
        "simulation/frame_contact.py",
        "        if not len(found):\n            self.clean_since = frame",
        "        if found is not None:\n            self.clean_since = frame",
        (PENETRATION_FREE + "test_untangle_lets_parts_come_apart_and_tells_when",),
    ),
]
