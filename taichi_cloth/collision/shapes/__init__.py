"""All collider shapes, in the order of the collider table. A new shape is a file here and a line below."""

from .box import BOX
from .capsule import CAPSULE
from .mesh import MESH
from .plane import PLANE
from .shape import NO_IMPACT, Shape
from .sphere import SPHERE

SHAPES: tuple[Shape, ...] = (SPHERE, CAPSULE, BOX, PLANE, MESH)

__all__ = ["MESH", "NO_IMPACT", "SHAPES", "SPHERE", "Shape"]
