"""Independent float64 solutions of scenes, in NumPy: what the solvers are judged by. Shares no code with them."""

from .rest import rest_strain

__all__ = ["rest_strain"]
