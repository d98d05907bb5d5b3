"""The simulation as Python users have it: a notebook shows it by itself."""

from __future__ import annotations

from ..simulation import Simulation as Plain
from .picture import picture


class Simulation(Plain):
    __doc__ = Plain.__doc__

    def _repr_png_(self) -> bytes | None:
        """The cloth as it is now; nothing of one that is closed."""
        return None if self.closed else picture(self)._repr_png_()
