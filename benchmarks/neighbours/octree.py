"""An octree of points that is built anew for every search, as the thesis has it. For the comparison only."""

import taichi as ti
import taichi.math as tm

FULL = 8  # points in a leaf
DEEPEST = 21


@ti.data_oriented
class Octree:
    """Room for `count` points; a node has eight children in a row, or a chain of points."""

    def __init__(self, count: int) -> None:
        self.children = ti.field(ti.i32, 4 * count + 64)  # first of eight, 0 for a leaf
        self.held = ti.field(ti.i32, 4 * count + 64)  # points in a leaf
        self.first = ti.field(ti.i32, 4 * count + 64)
        self.next = ti.field(ti.i32, count)
        self.stack = ti.field(ti.i32, 8 * DEEPEST)
        self.corner = ti.Vector.field(3, ti.f32, 8 * DEEPEST)
        self.side = ti.field(ti.f32, 8 * DEEPEST)

    @ti.func
    def child_of(self, x: tm.vec3, middle: tm.vec3) -> int:
        return int(x.x >= middle.x) + 2 * int(x.y >= middle.y) + 4 * int(x.z >= middle.z)

    @ti.func
    def insert(self, x: ti.template(), i: int, corner: tm.vec3, side: float, nodes: int) -> int:
        """Returns how many nodes there are then."""
        node, depth, low, wide, count = 0, 0, corner, side, nodes
        placed = False
        while not placed:
            if self.children[node] == 0 and (self.held[node] < FULL or depth == DEEPEST):
                self.next[i] = self.first[node]
                self.first[node] = i
                self.held[node] += 1
                placed = True
            else:
                wide *= 0.5
                middle = low + wide
                if self.children[node] == 0:  # full: its points go to eight new leaves
                    begin = count
                    count += 8
                    for k in range(8):
                        self.children[begin + k], self.held[begin + k], self.first[begin + k] = 0, 0, -1
                    self.children[node] = begin
                    p = self.first[node]
                    while p >= 0:
                        after, leaf = self.next[p], begin + self.child_of(x[p], middle)
                        self.next[p] = self.first[leaf]
                        self.first[leaf] = p
                        self.held[leaf] += 1
                        p = after
                c = self.child_of(x[i], middle)
                low += wide * tm.vec3(c & 1, (c >> 1) & 1, c >> 2)
                node = self.children[node] + c
                depth += 1
        return count

    @ti.kernel
    def pairs(self, x: ti.template(), count: int, corner: tm.vec3, side: float, reach: float) -> int:
        """Builds the tree and counts the pairs nearer than `reach` [m]."""
        found = 0
        ti.loop_config(serialize=True)
        for _ in range(1):
            self.children[0], self.held[0], self.first[0] = 0, 0, -1
            nodes = 1
            for i in range(count):
                nodes = self.insert(x, i, corner, side, nodes)
            for i in range(count):
                self.stack[0], self.corner[0], self.side[0] = 0, corner, side
                top = 1
                while top > 0:
                    top -= 1
                    node, low, wide = self.stack[top], self.corner[top], self.side[top]
                    beyond = ti.max(ti.max(low - x[i], x[i] - low - wide), 0.0)
                    if beyond.dot(beyond) < reach * reach:
                        if self.children[node] > 0:
                            for c in range(8):
                                self.stack[top] = self.children[node] + c
                                self.corner[top] = low + 0.5 * wide * tm.vec3(c & 1, (c >> 1) & 1, c >> 2)
                                self.side[top] = 0.5 * wide
                                top += 1
                        else:
                            p = self.first[node]
                            while p >= 0:
                                away = x[p] - x[i]
                                if i < p and away.dot(away) < reach * reach:
                                    found += 1
                                p = self.next[p]
        return found
