"""Lines of springs for the direct solver."""

from hypothesis import given
from hypothesis import strategies as st

from taichi_cloth.geometry.simd_layout import LINE_DIRECTIONS, spring_lines
from taichi_cloth.geometry.topology import build_sheet


@given(st.integers(2, 7), st.integers(2, 7), st.integers(1, 2), st.lists(st.booleans(), min_size=6, max_size=6))
def test_lines_contain_each_spring_once_and_are_as_long_as_possible(
    rows: int, columns: int, diagonals: int, directions: list[bool]
) -> None:
    topology = build_sheet(
        rows=rows,
        columns=columns,
        width=1.0,
        height=1.0,
        center=(0.0, 0.0, 0.0),
        rotation=(0.0, 0.0, 0.0),
        area_density=0.2,
        pins=(),
        directions=directions,
        diagonals=diagonals,
    )
    table, order = spring_lines(topology)
    expected = [e for e in range(topology.spring_count) if topology.direction[e] in LINE_DIRECTIONS]
    assert sorted(order.tolist()) == expected
    assert table[:, 3].sum() == len(order)
    starts = {(topology.direction[e], min(topology.ends[e])) for e in expected}
    for particle, stride, first, count in table.tolist():
        for j, e in enumerate(order[first : first + count].tolist()):
            assert sorted(topology.ends[e]) == [particle + j * stride, particle + (j + 1) * stride]
        d = topology.direction[order[first]]
        assert set(topology.direction[order[first : first + count]]) == {d}
        last = particle + count * stride
        at_edge = (d in (0, 2) and last % columns == columns - 1) or (d == 3 and last % columns == 0)
        assert at_edge or (d, last) not in starts


def test_a_full_sheet_has_a_line_for_each_row_column_and_diagonal() -> None:
    topology = build_sheet(
        rows=3,
        columns=4,
        width=1.0,
        height=1.0,
        center=(0.0, 0.0, 0.0),
        rotation=(0.0, 0.0, 0.0),
        area_density=0.2,
        pins=(),
        directions=[True] * 6,
    )
    table, _ = spring_lines(topology)
    found = [tuple(line) for line in table[:, [0, 1, 3]].tolist()]
    assert found[:3] == [(0, 1, 3), (4, 1, 3), (8, 1, 3)]
    assert set(found[3:7]) == {(column, 4, 2) for column in range(4)}
    assert set(found[7:11]) == {(4, 5, 1), (0, 5, 2), (1, 5, 2), (2, 5, 1)}
    assert set(found[11:]) == {(1, 3, 1), (2, 3, 2), (3, 3, 2), (7, 3, 1)}
