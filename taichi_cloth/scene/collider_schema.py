"""Schema of what cloth is in contact with: motion, contact properties, colliders, the ground and attachments."""

from __future__ import annotations

from dataclasses import dataclass, field

from .keys import Keyframes, Pins, Table, Vec3, key_field

# Contact responses: positional projection, velocity reflection, penalty force (`collision/response.py`).
RESPONSES = ("projection", "reflection", "repulsion")
PROJECTION, REFLECTION, REPULSION = range(3)


@dataclass(frozen=True, kw_only=True)
class ContactProperties(Table):
    """Contact with a collider. `continuous` and collision with triangles require projection."""

    margin: float = key_field(0.02, "distance from the surface at which contact begins", "m", min=0.0, max=10.0)
    friction: float = key_field(0.4, "Coulomb friction coefficient", min=0.0, max=1e6)
    continuous: bool = key_field(False, "continuous collision detection: cloth cannot pass through within a substep")
    response: str = key_field(
        "projection",
        "projection moves cloth to the margin, reflection reverses its normal velocity by a restitution, repulsion is"
        " a penalty force",
        choices=RESPONSES,
    )
    restitution: float = key_field(0.5, "for reflection: fraction of the normal speed that remains", min=0.0, max=1.0)
    stiffness: float = key_field(
        2000.0, "for repulsion: pressure per meter of depth within the margin", "N/m³", min=0.0, max=1e9
    )


@dataclass(frozen=True, kw_only=True)
class Motion(Table):
    """Motion of a collider or attachment. Its center is at center + oscillation·sin(2π·t/period + phase) + keyframes.

    It rotates about its center: by `rocking`, with the same period and phase, then by `keyframes`, then by `spin`.
    """

    center: Vec3 = key_field((0.0, 1.0, 0.0), "center, without oscillation and keyframes", "m", min=-1e5, max=1e5)
    oscillation: Vec3 = key_field(
        (0.0, 0.0, 0.0), "amplitude of the oscillation along x, y, z", "m", min=-1000.0, max=1000.0
    )
    period: Vec3 = key_field((8.0, 8.0, 8.0), "period of oscillation and rocking, for x, y, z", "s", min=0.01, max=1e6)
    phase: Vec3 = key_field(
        (0.0, 0.0, 0.0), "initial phase of oscillation and rocking, for x, y, z", "degrees", min=-360.0, max=360.0
    )
    rocking: Vec3 = key_field(
        (0.0, 0.0, 0.0), "amplitude of the oscillating rotation about x, y, z", "degrees", min=-360.0, max=360.0
    )
    # `rotation_vector_between` (`collision/colliders.py`) finds the rotation of a frame only below half a turn, that is
    # 10,800 degrees/s. 6000 degrees/s about all three axes at once are 10,392 degrees/s.
    spin: Vec3 = key_field(
        (0.0, 0.0, 0.0), "angular velocity, a vector along the axis of rotation", "degrees/s", min=-6000.0, max=6000.0
    )
    keyframes: Keyframes = key_field(
        (),
        "rows [seconds, x, y, z] or [seconds, x, y, z, rx, ry, rz]: offset [m], rotation about x, then y, then z"
        " [degrees]; interpolated linearly, and constant before the first row and after the last",
        min=-1e5,
        max=1e5,
    )


@dataclass(frozen=True, kw_only=True)
class Attachment(Motion):
    """Pins that move together as one rigid body from their start positions, for example a bar or a hand.

    They are at their start positions at 0 s, whatever the pose is then, and only its changes move them. A particle that
    several attachments name is moved by the last of them.
    """

    pins: Pins = key_field((), "attached particles: edges, corners, particle indices, regions or groups, as in [cloth]")


@dataclass(frozen=True, kw_only=True)
class Collider(Motion, ContactProperties):
    """A body that the cloth cannot enter. `rotation` is its orientation before any motion."""

    name: str = key_field(
        "", "prefix of its runtime parameters, different for each collider; the first of each shape may omit it"
    )
    rotation: Vec3 = key_field((0.0, 0.0, 0.0), "rotation about x, then y, then z", "degrees", min=-360.0, max=360.0)


@dataclass(frozen=True, kw_only=True)
class RoundCollider(Collider):
    """A collider whose surface has a constant distance from a point or a segment."""

    collide_with: str = key_field(
        "particles",
        "what it collides with; a collider smaller than a cell needs triangles",
        choices=("particles", "triangles"),
    )


@dataclass(frozen=True, kw_only=True)
class Sphere(RoundCollider):
    """A sphere."""

    radius: float = key_field(
        0.5, "radius, without the margin", "m", min=0.0, max=1000.0, exclusive_min=True, slider=(0.05, 1.5)
    )


@dataclass(frozen=True, kw_only=True)
class Capsule(RoundCollider):
    """A cylinder with hemispherical ends, along y before rotation."""

    length: float = key_field(1.0, "distance between the centers of its ends", "m", min=0.0, max=1000.0)
    radius: float = key_field(0.1, "radius, without the margin", "m", min=0.0, max=1000.0, exclusive_min=True)


@dataclass(frozen=True, kw_only=True)
class Box(Collider):
    """A box with sides along x, y and z before rotation: a table top."""

    center: Vec3 = key_field((0.0, 0.5, 0.0), "center, without oscillation and keyframes", "m", min=-1e5, max=1e5)
    size: Vec3 = key_field((1.0, 1.0, 1.0), "full lengths of the sides along x, y, z", "m", min=0.001, max=1000.0)


@dataclass(frozen=True, kw_only=True)
class Plane(Collider):
    """An infinite plane, solid on one side: before rotation it is horizontal, and solid below."""

    center: Vec3 = key_field((0.0, 0.0, 0.0), "point on the plane", "m", min=-1e5, max=1e5)
    display_size: float = key_field(
        4.0, "side of the square that is drawn around its center", "m", min=0.001, max=1000.0
    )


@dataclass(frozen=True, kw_only=True)
class Mesh(Collider):
    """A solid bounded by a closed triangle mesh. Its center is that of its bounding box.

    With a `clip` it deforms: a body that walks. Cloth then meets its triangles, not a distance grid.
    """

    file: str = key_field("bust", "name of a shipped mesh, or path of an OBJ file relative to the scene file")
    scale: float = key_field(1.0, "length of one unit of the file", "m", min=0.0, max=1e6, exclusive_min=True)
    resolution: int = key_field(64, "cells of its signed distance grid along the longest side", min=4, max=256)
    clip: str = key_field(
        "", "its points over time, beside its file: a PC2 or USD file, or OBJ files walk_*.obj; empty if it is rigid"
    )
    clip_rate: float = key_field(
        30.0, "samples of the clip per second; a USD file has its own", "1/s", min=0.01, max=1000.0
    )
    clip_loop: bool = key_field(True, "the first sample of the clip follows the last")
    folder: str = field(default="", metadata={"derived": "folder of the scene file, for a mesh that is not shipped"})
    clip_time: float = field(default=0.0, metadata={"derived": "time of the clip whose shape this is [s]"})


@dataclass(frozen=True, kw_only=True)
class Ground(ContactProperties):
    """A horizontal floor."""

    height: float = key_field(0.0, "height of the floor", "m", min=-1e5, max=1e5)
