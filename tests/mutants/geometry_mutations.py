"""Mutations of the geometry: grids, mesh files, maps, coloring, signed distances. Part of `mutations.py`."""

from __future__ import annotations

from mutation import Mutation

MESH_SPRINGS = "geometry/test_mesh_springs.py::"

GEOMETRY = [
    Mutation(
        "farthest-pins-first",
        "geometry/tethers.py",
        'order = np.argsort(distances, axis=0, kind="stable")[:MAX_TETHERS]',
        'order = np.argsort(-distances, axis=0, kind="stable")[:MAX_TETHERS]',
        ("geometry/test_tether_lengths.py::test_two_corners_are_two_runs_the_nearer_first",),
    ),
    Mutation(
        "frequency-halved",
        "geometry/stability_bounds.py",
        "return MARGIN * sqrt(max(largest, 0.0))",
        "return 0.5 * MARGIN * sqrt(max(largest, 0.0))",
        ("geometry/test_stability_bounds.py::test_a_chain_has_its_textbook_frequency",),
    ),
    Mutation(
        "stable-substeps-without-damping",
        "geometry/stability_bounds.py",
        "(damping_time + sqrt(damping_time**2 + 4 / frequency**2))",
        "sqrt(4 / frequency**2)",
        ("geometry/test_stability_bounds.py::test_the_damped_symplectic_substep_is_the_longest_stable_one",),
    ),
    Mutation(
        "explicit-substeps-in-resonance",
        "geometry/stability_bounds.py",
        "MAX_PHASE = sqrt(3)",
        "MAX_PHASE = 2.0",
        ("solvers/test_explicit.py::test_a_curtain_that_was_pulled_hard_comes_to_rest",),
    ),
    Mutation(
        "half-the-mass-per-corner",
        "geometry/topology.py",
        "(area * area_density / 3)[:, None]",
        "(area * area_density / 2)[:, None]",
        ("geometry/test_topology.py::test_each_corner_gets_a_third_of_the_mass_of_a_triangle",),
    ),
    Mutation(
        "edge-springs-not-halved",
        "geometry/topology.py",
        "ends), 0.5, 1.0), (len",
        "ends), 1.0, 1.0), (len",
        ("solvers/test_hanging.py::test_every_spring_carries_the_weight_below_it[lines-serial-1-1]",),
    ),
    Mutation(
        "warp-and-weft-swapped",
        "geometry/topology.py",
        "[0, 1, 4, 5]] = aspect, 1 / aspect, aspect, 1 / aspect",
        "[0, 1, 4, 5]] = 1 / aspect, aspect, 1 / aspect, aspect",
        (
            "geometry/test_mesh_springs.py::test_a_mesh_of_quads_has_the_springs_and_bending_links_of_the_grid",
            "simulation/test_fabrics.py::test_hanging_strips_stretch_by_their_stiffness",
        ),
    ),
    Mutation(
        "twist-energy-halved",
        "geometry/bending.py",
        "twist = 2 * bending / (a * b)",
        "twist = bending / (a * b)",
        ("geometry/test_bending_links.py::test_energy_of_bent_twisted_and_saddle_shaped_sheets",),
    ),
    Mutation(
        "all-threads-tear-at-once",
        "geometry/tearing.py",
        "torn = (strains > limit) & (strains >= worst)",
        "torn = strains > limit",
        ("geometry/test_tearing.py::test_of_adjacent_threads_only_the_most_strained_tears",),
    ),
    Mutation(
        "adjacency-of-wrong-rows",
        "geometry/topology.py",
        "(order // corners.shape[1])",
        "(order // (corners.shape[1] + 1))",
        ("geometry/test_adjacency.py::test_every_row_is_listed_at_each_of_its_particles",),
    ),
    Mutation(
        "kinetic-energy-not-halved",
        "geometry/topology.py",
        "kinetic = 0.5 * float(",
        "kinetic = float(",
        ("geometry/test_cloth_metrics.py::test_energies_of_a_moving_sheet",),
    ),
    Mutation(
        "strain-relative-to-the-longest-spring",
        "geometry/topology.py",
        "axis=1) / topology.rest[springs] - 1",
        "axis=1) / topology.rest[springs].max() - 1",
        ("geometry/test_cloth_metrics.py::test_strain_is_length_over_rest_length_minus_one",),
    ),
    Mutation(
        "strain-not-relative",
        "geometry/topology.py",
        "axis=1) / topology.rest[springs] - 1",
        "axis=1) - topology.rest[springs]",
        ("geometry/test_cloth_metrics.py::test_strain_is_length_over_rest_length_minus_one",),
    ),
    Mutation(
        "map-of-other-rows-and-columns",
        "geometry/cloth_builder.py",
        "if shape is not None and values.shape == shape:",
        "if shape is not None and values.size == count:",
        ("geometry/test_maps.py::test_wrong_numbers_of_a_map_are_refused_in_one_line",),
    ),
    Mutation(
        "map-above-one",
        "scene/keys.py",
        "or not 0 <= value <= 1:  # NaN fails",
        "or value < 0:",
        ("geometry/test_maps.py::test_wrong_numbers_of_a_map_are_refused_in_one_line",),
    ),
    Mutation(
        "bending-across-the-boundary",
        "geometry/bending.py",
        "        derivatives -= _across_boundary(derivatives, across)\n",
        "",
        (MESH_SPRINGS + "test_second_derivatives_of_a_quadratic_surface_are_exact",),
    ),
    Mutation(
        "bending-fits-linear-functions-too",
        "geometry/bending.py",
        "        quadratic -= linear @ (np.linalg.pinv(weighted @ linear, hermitian=True) @ (weighted @ quadratic))\n",
        "",
        (MESH_SPRINGS + "test_stretching_in_the_plane_causes_no_bending_force",),
    ),
    Mutation(
        "bending-of-few-neighbors",
        "geometry/bending.py",
        "rows = rows[~determined & (self.used[rows] < self._counts[rows])]",
        "rows = rows[:0]",
        (MESH_SPRINGS + "test_second_derivatives_of_a_quadratic_surface_are_exact",),
    ),
    Mutation(
        "twist-of-triangles-not-doubled",
        "geometry/bending.py",
        "enumerate((weft, warp, 2 * np.sqrt(warp * weft)))",
        "enumerate((weft, warp, np.sqrt(warp * weft)))",
        (MESH_SPRINGS + "test_triangles_are_equally_stiff_along_all_directions",),
    ),
    Mutation(
        "room-for-the-links-of-a-grid",
        "state/constraint_data.py",
        "capacity(max(len(links.ends), len(grid.DIRECTIONS) * particles))",
        "capacity(len(grid.DIRECTIONS) * particles)",
        ("solvers/test_mesh_files.py::test_a_fan_has_more_bending_links_than_a_grid_of_its_size",),
    ),
]
