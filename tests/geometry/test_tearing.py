"""Which springs tear, and the remaining sheet. No Taichi."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from taichi_cloth.geometry.cloth_builder import build_topology
from taichi_cloth.geometry.tearing import TearState
from taichi_cloth.geometry.topology import Topology
from taichi_cloth.scene.fabric_schema import VerletSprings
from taichi_cloth.scene.schema import Cloth, Scene


def make(rows: int = 5, columns: int = 7, structural: float = 1.0, diagonals: int = 2) -> Topology:
    cloth = Cloth(rows=rows, columns=columns, pins=(), diagonals=diagonals)
    return build_topology(Scene(cloth=cloth, verlet=VerletSprings(structural=structural)), "verlet")


def strains(topology: Topology, **by_pair: float) -> np.ndarray:
    """Return strains that are zero except for the springs that are named by their ends, as in _16_17."""
    found = np.zeros(topology.spring_count)
    for pair, strain in by_pair.items():
        a, b = map(int, pair.split("_")[1:])
        (number,) = np.flatnonzero((topology.ends == sorted((a, b))).all(axis=1))
        found[number] = strain
    return found


def pairs(topology: Topology) -> set[frozenset[int]]:
    return {frozenset(pair) for pair in topology.ends.tolist()}


def test_an_untorn_cloth_stays_the_same_object() -> None:
    topology = make()
    tear = TearState(topology)
    assert not tear.tear_overstretched(strains(topology, _16_17=0.49), 0.5)
    assert tear.remaining() is topology


def test_a_torn_thread_removes_its_triangles_and_bend_springs() -> None:
    topology = make()
    tear = TearState(topology)
    assert tear.tear_overstretched(strains(topology, _16_17=0.51), 0.5)
    left = tear.remaining()
    assert pairs(topology) - pairs(left) == {frozenset(p) for p in ((16, 17), (15, 17), (16, 18))}
    adjacent = [set(t) for t in topology.triangles.tolist() if {16, 17} <= set(t)]
    assert len(adjacent) == 2
    removed = {frozenset(t) for t in topology.triangles.tolist()} - {frozenset(t) for t in left.triangles.tolist()}
    assert removed == {frozenset(t) for t in adjacent}
    assert len(left.cells) == left.triangle_count
    np.testing.assert_array_equal(left.mass, topology.mass)


def test_of_adjacent_threads_only_the_most_strained_tears() -> None:
    topology = make()
    tear = TearState(topology)
    strained = strains(topology, _16_17=0.6, _17_18=0.7, _10_17=0.8, _0_1=0.55)
    assert tear.tear_overstretched(strained, 0.5)
    assert {frozenset(p) for p in topology.ends[tear.torn].tolist()} == {frozenset((10, 17)), frozenset((0, 1))}
    assert tear.tear_overstretched(strained, 0.5)  # its load moves to the next spring
    assert frozenset((17, 18)) in {frozenset(p) for p in topology.ends[tear.torn].tolist()}


def test_bend_springs_do_not_tear_by_themselves() -> None:
    topology = make()
    assert not TearState(topology).tear_overstretched(strains(topology, _15_17=3.0), 0.5)


def test_a_cloth_without_structural_springs_keeps_its_bend_springs() -> None:
    topology = make(structural=0.0)
    tear = TearState(topology)
    assert tear.tear_overstretched(strains(topology, _9_17=1.0), 0.5)
    assert len(tear.remaining().family("bend")) == len(topology.family("bend"))


@given(st.integers(2, 7), st.integers(2, 7), st.integers(1, 2), st.data())
def test_the_remaining_cloth_is_consistent(rows: int, columns: int, diagonals: int, data: st.DataObject) -> None:
    topology = make(rows, columns, diagonals=diagonals)
    tear = TearState(topology)
    seed = data.draw(st.integers(0, 2**31))
    for _ in range(3):
        tear.tear_overstretched(np.random.default_rng(seed).random(topology.spring_count), 0.3)
        seed += 1
    left = tear.remaining()
    intact = pairs(left)
    assert intact <= pairs(topology)
    assert left.spring_count == len(left.rest) == left.stiffness_factors.shape[1] == sum(b.count for b in left.batches)
    assert left.spring_count == 0 or left.batches[0].first == 0
    for batch in left.batches:
        own = left.ends[batch.first : batch.first + batch.count]
        assert len(np.unique(own)) == own.size  # still one color
    threads = {frozenset(p) for f in ("structural", "shear") for p in left.ends[left.family(f)].tolist()}
    original = {frozenset(p) for f in ("structural", "shear") for p in topology.ends[topology.family(f)].tolist()}
    for triangle in left.triangles.tolist():
        for side in ({triangle[0], triangle[1]}, {triangle[1], triangle[2]}, {triangle[0], triangle[2]}):
            assert frozenset(side) in threads
    assert threads == original - {frozenset(p) for p in topology.ends[tear.torn].tolist()}
    for a, b in left.ends[left.family("bend")].tolist():
        assert {frozenset((a, (a + b) // 2)), frozenset(((a + b) // 2, b))} <= threads


def test_two_threads_of_equal_strain_tear_together() -> None:
    topology = make()
    tear = TearState(topology)
    assert tear.tear_overstretched(strains(topology, _16_17=0.6, _17_18=0.6), 0.5)
    assert tear.torn.sum() == 2
