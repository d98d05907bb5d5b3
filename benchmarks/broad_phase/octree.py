"""An octree of points, rebuilt for every search, as in the thesis on which the scene `table` is based."""

import taichi as ti
import taichi.math as tm

MAX_POINTS = 8  # in a leaf
MAX_DEPTH = 21


@ti.data_oriented
class Octree:
    """An octree for `count` points. A node has eight consecutive children, or a linked list of points."""

    def __init__(self, count: int) -> None:
        self.children = ti.field(ti.i32, 4 * count + 64)  # first of eight children; 0 for a leaf
        self.size = ti.field(ti.i32, 4 * count + 64)  # number of points in a leaf
        self.first = ti.field(ti.i32, 4 * count + 64)
        self.next = ti.field(ti.i32, count)
        self.stack = ti.field(ti.i32, 8 * MAX_DEPTH)
        self.corner = ti.Vector.field(3, ti.f32, 8 * MAX_DEPTH)
        self.side = ti.field(ti.f32, 8 * MAX_DEPTH)

    @ti.func
    def child_of(self, x: tm.vec3, middle: tm.vec3) -> int:
        return int(x.x >= middle.x) + 2 * int(x.y >= middle.y) + 4 * int(x.z >= middle.z)

    @ti.func
    def insert(self, x: ti.template(), i: int, corner: tm.vec3, side: float, nodes: int) -> int:
        """Insert point i, and return the new number of nodes."""
        node, depth, low, wide, count = 0, 0, corner, side, nodes
        inserted = False
        while not inserted:
            if self.children[node] == 0 and (self.size[node] < MAX_POINTS or depth == MAX_DEPTH):
                self.next[i] = self.first[node]
                self.first[node] = i
                self.size[node] += 1
                inserted = True
            else:
                wide *= 0.5
                middle = low + wide
                if self.children[node] == 0:  # full: move its points to eight new leaves
                    begin = count
                    count += 8
                    for k in range(8):
                        self.children[begin + k], self.size[begin + k], self.first[begin + k] = 0, 0, -1
                    self.children[node] = begin
                    p = self.first[node]
                    while p >= 0:
                        after, leaf = self.next[p], begin + self.child_of(x[p], middle)
                        self.next[p] = self.first[leaf]
                        self.first[leaf] = p
                        self.size[leaf] += 1
                        p = after
                c = self.child_of(x[i], middle)
                low += wide * tm.vec3(c & 1, (c >> 1) & 1, c >> 2)
                node = self.children[node] + c
                depth += 1
        return count

    @ti.kernel
    def pairs(self, x: ti.template(), count: int, corner: tm.vec3, side: float, reach: float) -> int:
        """Build the tree, and return the number of pairs closer than `reach` [m]."""
        found = 0
        ti.loop_config(serialize=True)
        for _ in range(1):
            self.children[0], self.size[0], self.first[0] = 0, 0, -1
            nodes = 1
            for i in range(count):
                nodes = self.insert(x, i, corner, side, nodes)
            for i in range(count):
                self.stack[0], self.corner[0], self.side[0] = 0, corner, side
                top = 1
                while top > 0:
                    top -= 1
                    node, low, wide = self.stack[top], self.corner[top], self.side[top]
                    outside = ti.max(ti.max(low - x[i], x[i] - low - wide), 0.0)
                    if outside.dot(outside) < reach * reach:
                        if self.children[node] > 0:
                            for c in range(8):
                                self.stack[top] = self.children[node] + c
                                self.corner[top] = low + 0.5 * wide * tm.vec3(c & 1, (c >> 1) & 1, c >> 2)
                                self.side[top] = 0.5 * wide
                                top += 1
                        else:
                            p = self.first[node]
                            while p >= 0:
                                offset = x[p] - x[i]
                                if i < p and offset.dot(offset) < reach * reach:
                                    found += 1
                                p = self.next[p]
        return found
