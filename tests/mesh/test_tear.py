"""Which springs give way, and what is left of a sheet without them. No Taichi."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from taichi_cloth.mesh.from_scene import topology_of
from taichi_cloth.mesh.tear import Tear
from taichi_cloth.mesh.topology import Topology
from taichi_cloth.scene import Scene
from taichi_cloth.scene.model import Cloth, Springs


def make(rows: int = 5, columns: int = 7, structural: float = 1.0, diagonals: int = 2) -> Topology:
    cloth = Cloth(rows=rows, columns=columns, pins=(), diagonals=diagonals)
    return topology_of(Scene(cloth=cloth, springs=Springs(structural=structural)), "springs")


def strains(topology: Topology, **by_pair: float) -> np.ndarray:
    """No strain but in the springs that are named by their ends, as in _16_17."""
    found = np.zeros(topology.spring_count)
    for pair, strain in by_pair.items():
        a, b = map(int, pair.split("_")[1:])
        (number,) = np.flatnonzero((topology.ends == sorted((a, b))).all(axis=1))
        found[number] = strain
    return found


def pairs(topology: Topology) -> set[frozenset[int]]:
    return {frozenset(pair) for pair in topology.ends.tolist()}


def test_what_is_whole_stays_the_same_object() -> None:
    topology = make()
    tear = Tear(topology)
    assert not tear.give_way(strains(topology, _16_17=0.49), 0.5)
    assert tear.left() is topology


def test_a_thread_takes_its_triangles_and_the_bend_springs_over_it() -> None:
    topology = make()
    tear = Tear(topology)
    assert tear.give_way(strains(topology, _16_17=0.51), 0.5)
    left = tear.left()
    assert pairs(topology) - pairs(left) == {frozenset(p) for p in ((16, 17), (15, 17), (16, 18))}
    beside = [set(t) for t in topology.triangles.tolist() if {16, 17} <= set(t)]
    assert len(beside) == 2
    gone = {frozenset(t) for t in topology.triangles.tolist()} - {frozenset(t) for t in left.triangles.tolist()}
    assert gone == {frozenset(t) for t in beside}
    assert len(left.cells) == left.triangle_count
    np.testing.assert_array_equal(left.mass, topology.mass)


def test_of_threads_that_meet_only_the_longest_gives_way() -> None:
    topology = make()
    tear = Tear(topology)
    pulled = strains(topology, _16_17=0.6, _17_18=0.7, _10_17=0.8, _0_1=0.55)
    assert tear.give_way(pulled, 0.5)
    assert {frozenset(p) for p in topology.ends[tear.torn].tolist()} == {frozenset((10, 17)), frozenset((0, 1))}
    assert tear.give_way(pulled, 0.5)  # what it carried goes to the next
    assert frozenset((17, 18)) in {frozenset(p) for p in topology.ends[tear.torn].tolist()}


def test_bend_springs_do_not_tear_by_themselves() -> None:
    topology = make()
    assert not Tear(topology).give_way(strains(topology, _15_17=3.0), 0.5)


def test_a_cloth_of_bend_springs_alone_keeps_them() -> None:
    topology = make(structural=0.0)
    tear = Tear(topology)
    assert tear.give_way(strains(topology, _9_17=1.0), 0.5)
    assert len(tear.left().family("bend")) == len(topology.family("bend"))


@given(st.integers(2, 7), st.integers(2, 7), st.integers(1, 2), st.data())
def test_what_is_left_is_a_cloth(rows: int, columns: int, diagonals: int, data: st.DataObject) -> None:
    topology = make(rows, columns, diagonals=diagonals)
    tear = Tear(topology)
    seed = data.draw(st.integers(0, 2**31))
    for _ in range(3):
        tear.give_way(np.random.default_rng(seed).random(topology.spring_count), 0.3)
        seed += 1
    left = tear.left()
    alive = pairs(left)
    assert alive <= pairs(topology)
    assert left.spring_count == len(left.rest) == left.shares.shape[1] == sum(b.count for b in left.batches)
    assert left.spring_count == 0 or left.batches[0].first == 0
    for batch in left.batches:
        own = left.ends[batch.first : batch.first + batch.count]
        assert len(np.unique(own)) == own.size  # still one colour
    threads = {frozenset(p) for f in ("structural", "shear") for p in left.ends[left.family(f)].tolist()}
    once = {frozenset(p) for f in ("structural", "shear") for p in topology.ends[topology.family(f)].tolist()}
    for triangle in left.triangles.tolist():
        for side in ({triangle[0], triangle[1]}, {triangle[1], triangle[2]}, {triangle[0], triangle[2]}):
            assert frozenset(side) in threads
    assert threads == once - {frozenset(p) for p in topology.ends[tear.torn].tolist()}
    for a, b in left.ends[left.family("bend")].tolist():
        assert {frozenset((a, (a + b) // 2)), frozenset(((a + b) // 2, b))} <= threads


def test_the_longest_of_a_mirrored_pair_may_be_two() -> None:
    topology = make()
    tear = Tear(topology)
    assert tear.give_way(strains(topology, _16_17=0.6, _17_18=0.6), 0.5)
    assert tear.torn.sum() == 2
