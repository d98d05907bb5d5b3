"""Cloth state: the Taichi fields that kernels read and write, in serial, SIMD and parallel layout."""

from .cloth_state import ClothState, acquire_state, inverse_mass, release_state

__all__ = ["ClothState", "acquire_state", "inverse_mass", "release_state"]
