"""Fields with which a cloth finds where it touches itself (`contact/self_collision.py`)."""

from dataclasses import dataclass
from typing import Any

import numpy as np
import taichi as ti

from ..kernels.hashing import BLOCK
from ..mesh.topology import Topology
from . import fields
from .places import place_count, place_in
from .pool import attached, capacity


@dataclass(eq=False)
class Buckets:
    """Numbers of things, sorted by where they are (`kernels/hashing.py`)."""

    first: Any  # (B + 1,)
    members: Any
    middle: Any  # [m] vec3 of the box of each when it was sorted
    half: Any  # [m] vec3 half its sides
    sums: Any  # of a block of buckets each


@dataclass(eq=False)
class Candidates:
    """What may touch soon: two numbers each (`contact/candidates.py`)."""

    rows: Any  # ivec2
    touching: Any  # 1 for those that do now
    count: Any  # 0-D, more than there are rows where they are too few


@dataclass(eq=False)
class Near:
    """What a cloth, in any layout, needs to find its contacts with itself.

    Particles go by their place in the layout: in strips slot·8 + lane, else their own number.
    """

    particle: Any  # (N,) place of every particle
    flat: Any  # [m] vec3 by place, on the sheet before it was sewn or folded
    edges: Any  # ivec2 (3·T,) sides of the triangles, each once
    triangles: Any  # ivec3 (T,)
    depths: Any  # by place, sum over the contacts that a particle has a part in, in whole units
    deepest: Any  # by place, the largest of them
    moves: Any  # ivec3 by place, what they move it by, in whole units: the same in whatever order they are added
    through: Any  # by place, 1 where a cloth goes through itself (`contact/tangles.py`), else 0
    points: Buckets
    sides: Buckets  # the edges, by their middles
    pairs: Candidates  # of particles
    corners: Candidates  # triangle and particle
    crossings: Candidates  # of edges
    listed_at: Any  # [m] vec3 where every particle was when they were listed
    listed_for: Any  # [m] 0-D the thickness then
    stale: Any  # 0-D 1: they must be listed anew
    reach: Any  # [m] 0-D how near they were
    side: Any  # [m] 0-D of a cube of the hash
    crossed: Any  # 0-D edges that go through a triangle, when they were counted last
    longest: Any  # [m] 0-D longest edge at rest
    particle_count: Any  # 0-D
    edge_count: Any  # 0-D
    triangle_count: Any  # 0-D


def come_near(work: Any, topology: Topology) -> None:
    """Gives a cloth or its strips their `near`, filled."""
    near = attached(work, "near", lambda: _allocate(work))
    place = place_in(work, topology, np.arange(topology.particle_count))
    flat = np.zeros((near.flat.shape[0], 3))
    flat[place] = topology.flat
    edges = topology.edges
    fields.put_all(
        (near.particle, place),
        (near.flat, flat),
        (near.edges, place[edges]),
        (near.triangles, place[topology.triangles]),
        (near.through, np.zeros(0)),
    )
    near.longest[None] = float(np.linalg.norm(np.diff(topology.flat[edges], axis=1), axis=2).max(initial=0.0))
    near.listed_for[None] = 0.0  # nothing is listed yet
    near.particle_count[None], near.edge_count[None] = len(place), len(edges)
    near.triangle_count[None] = topology.triangle_count


def _candidates(room: int) -> Candidates:
    return Candidates(rows=fields.rows(2, room), touching=fields.numbers(room, kind=ti.i32), count=fields.number())


def _buckets(count: int) -> Buckets:
    size = 2 * capacity(count)
    return Buckets(
        first=fields.numbers(size + 1, kind=ti.i32),
        members=fields.numbers(size, kind=ti.i32),
        middle=fields.rows(3, size, ti.f32),
        half=fields.rows(3, size, ti.f32),
        sums=fields.numbers(size // BLOCK + 1, kind=ti.i32),
    )


def _allocate(work: Any) -> Near:
    places = place_count(work)
    triangles = 2 * places if work.in_lanes else work.triangles.shape[0]
    return Near(
        particle=fields.numbers(places, kind=ti.i32),
        flat=fields.rows(3, places, ti.f32),
        edges=fields.rows(2, 3 * triangles),
        triangles=fields.rows(3, triangles),
        depths=fields.numbers(places, kind=ti.i32),
        deepest=fields.numbers(places, kind=ti.i32),
        moves=fields.rows(3, places),
        through=fields.numbers(places, kind=ti.i32),
        points=_buckets(places),
        sides=_buckets(3 * triangles),
        pairs=_candidates(16 * places),
        corners=_candidates(8 * triangles),
        crossings=_candidates(16 * triangles),
        listed_at=fields.rows(3, places, ti.f32),
        listed_for=ti.field(ti.f32, ()),
        stale=fields.number(),
        reach=ti.field(ti.f32, ()),
        side=ti.field(ti.f32, ()),
        crossed=fields.number(),
        longest=ti.field(ti.f32, ()),
        particle_count=fields.number(),
        edge_count=fields.number(),
        triangle_count=fields.number(),
    )
