"""Meshes without Taichi: grids, OBJ files, springs, bending links, signed distance grids, the SIMD layout."""
