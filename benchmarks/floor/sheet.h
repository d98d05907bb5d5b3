// A flat cloth of square cells, divided into LANES vertical strips: each lane of a vector is one strip.
//
// Column j of the cloth is packet j % strip, lane j / strip. A spring between two packets of a row is then the same
// expression for LANES particles; only springs across the right border of a strip use the next lane.
#pragma once

#include <stdint.h>
#include <stdlib.h>

#include "lanes.h"

#define HALO 2  // places at the end of a row for copies of the next strip's first ones: a bend spring reaches two

typedef struct {
    int rows, columns;
    int strip;         // places of a row
    int stride;        // from a row to the one below it, in places: strip + HALO
    float side;        // [m] of a cell
    vec *x;            // [m] where the particles are
    floats *inverse_mass;  // [1/kg] 0 where a particle is held, and in lanes beyond the last column
} sheet;

INLINE int at(const sheet *s, int row, int place) { return row * s->stride + place; }

// Allocates zeros, aligned for vectors. They are never freed: the program ends with its cloth.
static inline void *zeros(size_t count, size_t size) {
    char *p = calloc(count * size + 64, 1);
    if (p == NULL) abort();
    return p + (64 - (uintptr_t)p % 64);
}

// 1 in the lanes whose particle has another one `right` columns further, 0 in the others.
static inline floats has_right(const sheet *s, int place, int right) {
    floats has;
    for (int lane = 0; lane < LANES; lane++) has[lane] = lane * s->strip + place + right < s->columns;
    return has;
}

static inline void hold(sheet *s, int row, int column) {
    s->inverse_mass[at(s, row, column % s->strip)][column / s->strip] = 0;
}

// Copies the first packets of the next strip behind the end of a row (halo), in any array of the sheet's shape.
INLINE void copy_halo(const sheet *s, vec *values, int row) {
    for (int p = 0; p < HALO; p++)
        values[at(s, row, s->strip + p)] = vec_from_next_lane(values[at(s, row, p)]);
}

// Cells are divided into two triangles along alternating diagonals, the first cell from its upper left to its lower
// right. Returns whether a cell is. A strip has an even number of packets, so that all lanes agree.
INLINE int falling(int row, int place) { return (row + place) % 2 == 0; }

// Number of triangles at a particle: two of each of its cells where the diagonals meet, one elsewhere.
static inline int triangles_at(const sheet *s, int row, int column) {
    int cells = (row % (s->rows - 1) ? 2 : 1) * (column % (s->columns - 1) ? 2 : 1);
    return falling(row, column) ? 2 * cells : cells;
}

// Columns go along +x and rows along (0, down_y, down_z) from the corner (-width/2, top, 0) [m]; each
// triangle gives a third of its mass to each corner. `strip` becomes a multiple of `unit`, which is even.
static inline sheet make_sheet(int rows, int columns, int unit, float width, float top, float down_y, float down_z,
                               float area_density) {
    sheet s = {.rows = rows, .columns = columns, .side = width / (columns - 1)};
    s.strip = ((columns + LANES - 1) / LANES + unit - 1) / unit * unit;
    s.stride = s.strip + HALO;
    s.x = zeros((size_t)rows * s.stride, sizeof(vec));
    s.inverse_mass = zeros((size_t)rows * s.stride, sizeof(floats));
    for (int row = 0; row < rows; row++)
        for (int place = 0; place < s.strip; place++)
            for (int lane = 0; lane < LANES; lane++) {
                int column = lane * s.strip + place, i = at(&s, row, place);
                s.x[i].x[lane] = s.side * column - width / 2;
                s.x[i].y[lane] = s.side * row * down_y + top;
                s.x[i].z[lane] = s.side * row * down_z;
                float mass = triangles_at(&s, row, column) / 6.0f * area_density * s.side * s.side;
                s.inverse_mass[i][lane] = column < columns ? 1 / mass : 0;
            }
    return s;
}
