"""The moving data of a cloth as Taichi fields, in each layout that a solver works on."""

from .cloth import ClothState, give_back, inverse_mass, take

__all__ = ["ClothState", "give_back", "inverse_mass", "take"]
