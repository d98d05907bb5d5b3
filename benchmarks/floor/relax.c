// The frame of the browser demos in optimized C on one thread: damped Verlet, then position relaxation.
//
//   ./relax ROWS COLUMNS SUBSTEPS ITERATIONS FRAMES [dump]
//
// The scene is `curtain` without its ground and its gusts: it hangs by its top edge in the wind, and a ball swings
// through it. A substep is one Verlet step with gravity and air, then ITERATIONS iterations. An iteration relaxes every
// spring and moves every particle out of the ball.
//
// The springs have the order of taichi_cloth's grids, one direction after the other: along rows, down columns, along
// the diagonals to the lower right, along those to the lower left, then between particles two apart along rows and down
// columns. In each direction the springs with an even index in their chain come first (index = row / down, or
// column / right along a row). The springs of one half share no particle, so they do not depend on each other.
#include "program.h"

#define FRAME_SECONDS (1.0 / 60)
#define TURN 6.283185307179586

static const float WIDTH = 4.35f, TOP = 3.975f;                  // [m] 0.15 m between the 30 columns of the demo
static const float AREA_DENSITY = 0.2f;                          // [kg/m²]
static const float GRAVITY = 9.81f;                              // [m/s²]
static const float DAMPING = 1.5f;                               // [1/s]
static const float STRUCTURAL = 1, SHEAR = 1, BEND = 0.05f;      // share of an error corrected in one iteration
static const float WIND_X = 0.4f, WIND_Z = 0.9f;                 // [m/s]
static const float AIR_DENSITY = 1.225f, DRAG = 1, LIFT = 1;     // [kg/m³], 1, 1
static const float BALL_REACH = 0.75f;                           // [m] radius and margin

// Shares of a spring's length error that its ends correct: stiffness · w / (w_first + w_second); 0 without a spring.
typedef struct {
    floats first, second;
} shares;

// All springs of one direction: from column p of row r + first_row to column p + right of row r + second_row.
typedef struct {
    int first_row, second_row, right;
    float rest;             // [m]
    const shares **shares;  // [row][column]; equal rows are shared: the table fits into the L1 cache
} direction;

typedef struct {
    sheet sheet;
    vec *x_before;  // [m] positions one substep ago
    vec *force[2];  // [N] of the air on the row that is stepped and on the one below it
    floats *has_cell;   // by place: 1 in lanes with a cell between this column and the next, else 0
    direction directions[6];
    float h, kept;  // [s] substep; share of velocity left after it
    double time;    // [s]
    vec ball;       // [m] its centre, the same in all lanes
} cloth;

static direction make_direction(const sheet *s, int first_row, int second_row, int right, float stiffness) {
    int down = first_row + second_row;
    direction d = {first_row, second_row, right, s->side * sqrtf(down * down + right * right), NULL};
    d.shares = zeros(s->rows, sizeof(shares *));
    const shares *known[2] = {NULL, NULL};  // the last row's and the one's before: masses alternate
    for (int row = 0; row + down < s->rows; row++) {
        shares *fresh = zeros(s->strip, sizeof(shares));
        for (int place = 0; place < s->strip; place++) {
            int second = place + right, j = at(s, row + second_row, second % s->strip);
            floats w_first = s->inverse_mass[at(s, row + first_row, place)];
            floats w_second = second < s->strip ? s->inverse_mass[j] : from_next_lane(s->inverse_mass[j]);
            floats share = stiffness * has_right(s, place, right) / (w_first + w_second + 1e-30f);  // 0: both held
            fresh[place] = (shares){share * w_first, share * w_second};
        }
        const shares **same = &known[row % 2];
        if (*same == NULL || memcmp(*same, fresh, s->strip * sizeof(shares))) *same = fresh;
        d.shares[row] = *same;
    }
    return d;
}

static cloth hang(arguments a) {
    cloth c = {.sheet = make_sheet(a.rows, a.columns, 4, WIDTH, TOP, -1, 0, AREA_DENSITY)};
    sheet *s = &c.sheet;
    for (int column = 0; column < s->columns; column++) hold(s, 0, column);
    c.x_before = zeros((size_t)s->rows * s->stride, sizeof(vec));
    memcpy(c.x_before, s->x, (size_t)s->rows * s->stride * sizeof(vec));
    for (int i = 0; i < 2; i++) c.force[i] = zeros(s->stride, sizeof(vec));
    c.has_cell = zeros(s->strip, sizeof(floats));
    for (int place = 0; place < s->strip; place++) c.has_cell[place] = has_right(s, place, 1);
    c.directions[0] = make_direction(s, 0, 0, 1, STRUCTURAL);
    c.directions[1] = make_direction(s, 0, 1, 0, STRUCTURAL);
    c.directions[2] = make_direction(s, 0, 1, 1, SHEAR);
    c.directions[3] = make_direction(s, 1, 0, 1, SHEAR);
    c.directions[4] = make_direction(s, 0, 0, 2, BEND);
    c.directions[5] = make_direction(s, 0, 2, 0, BEND);
    c.h = FRAME_SECONDS / a.substeps;
    c.kept = expf(-DAMPING * c.h);
    return c;
}

// Moves `first`, and returns the correction of `second`, to be subtracted (Müller 2007, eq. 10-11).
INLINE vec project(vec *first, vec second, shares share, floats rest) {
    vec gap = sub(second, *first);
    floats error = 1 - rest * inverse_root(squared(gap));  // of the gap's length, as a part of it
    *first = add(*first, scale(gap, error * share.first));
    return scale(gap, error * share.second);
}

INLINE void relax_inside(vec *first, vec *second, shares share, floats rest) {
    vec p = *first, q = *second;
    vec back = project(&p, q, share, rest);
    *first = p;
    *second = sub(q, back);
}

// Relaxes springs that cross the border of a strip: `second` is in the next lane.
INLINE void relax_border(vec *first, vec *second, shares share, floats rest) {
    vec p = *first;
    vec back = project(&p, vec_from_next_lane(*second), share, rest);
    *first = p;
    *second = sub(*second, vec_from_lane_before(back));
}

// Springs along rows. The width of a strip is a multiple of four, so that even and odd are equal in all lanes, and
// only odd springs cross its border.
INLINE void relax_along(const sheet *s, const direction *d, int right) {
    floats rest = splat(d->rest);
    for (int odd = 0; odd < 2; odd++)
        for (int row = 0; row < s->rows; row++) {
            vec *x = s->x + at(s, row, 0);
            const shares *share = d->shares[row];
            for (int place = odd * right; place < s->strip - odd * right; place += 2 * right)
                for (int p = place; p < place + right; p++) relax_inside(x + p, x + p + right, share[p], rest);
            for (int p = 0; odd && p < right; p++)
                relax_border(x + s->strip - right + p, x + p, share[s->strip - right + p], rest);
        }
}

// Springs from a row to one below it; `right` is 0 or 1.
INLINE void relax_down(const sheet *s, const direction *d, int down, int right) {
    floats rest = splat(d->rest);
    for (int odd = 0; odd < 2; odd++)
        for (int row = 0; row + down < s->rows; row++) {
            if (row / down % 2 != odd) continue;
            vec *first = s->x + at(s, row + d->first_row, 0), *second = s->x + at(s, row + d->second_row, 0);
            const shares *share = d->shares[row];
            for (int p = 0; p < s->strip - right; p++) relax_inside(first + p, second + p + right, share[p], rest);
            if (right) relax_border(first + s->strip - 1, second, share[s->strip - 1], rest);
        }
}

static void push_out(const sheet *s, vec ball) {
    for (int row = 0; row < s->rows; row++)
        for (int i = at(s, row, 0); i < at(s, row, s->strip); i++) {
            vec away = sub(s->x[i], ball);
            floats square = squared(away);
            ints inside = (square < BALL_REACH * BALL_REACH) & (s->inverse_mass[i] > 0);
            if (!any(inside)) continue;
            floats stretch = where(inside, BALL_REACH * inverse_root(square) - 1);
            s->x[i] = add(s->x[i], scale(away, stretch));
        }
}

static void sweep(const cloth *c) {
    const sheet *s = &c->sheet;
    relax_along(s, &c->directions[0], 1);
    for (int i = 1; i < 4; i++) relax_down(s, &c->directions[i], 1, c->directions[i].right);
    relax_along(s, &c->directions[4], 2);
    relax_down(s, &c->directions[5], 2, 0);
    push_out(s, c->ball);
}

// The force [N] of the air on each corner of a triangle: a third of the total. `v` are the velocities of the corners.
//
// With the normal n of length A (the area), the velocity u of the air relative to the triangle, and d = n·u, the total is
// ½ρ·((C_D - C_L)·d²/(A·|u|)·u + C_L·d·|u|/A·n): drag ½ρ·A·|u|²·C_D·cos²θ along the air and lift across it.
INLINE vec air_on(vec a, vec b, vec c, vec v_a, vec v_b, vec v_c) {
    vec n = scale(cross(sub(b, a), sub(c, a)), splat(0.5f));
    vec v = scale(add(add(v_a, v_b), v_c), splat(1 / 3.0f));
    vec u = sub((vec){splat(WIND_X), splat(0), splat(WIND_Z)}, v);
    floats u_u = squared(u), d = dot(n, u);
    floats common = (0.5f * AIR_DENSITY / 3) * d * inverse_root(u_u * squared(n) + 1e-30f);  // d / (A·|u|)
    return add(scale(u, (DRAG - LIFT) * common * d), scale(n, LIFT * common * u_u));
}

INLINE vec velocity(const cloth *c, int i) {
    return scale(sub(c->sheet.x[i], c->x_before[i]), splat(1 / c->h));
}

// Adds the force of the air on the cells between a row and the row below. The corners of a cell are a b over c d.
static void gather_air(const cloth *c, int row, vec *force, vec *force_below) {
    const sheet *s = &c->sheet;
    for (int p = 0; p < s->strip; p++) {
        int i = at(s, row, p), j = at(s, row + 1, p), falls = falling(row, p);
        vec x_a = s->x[i], x_b = s->x[i + 1], x_c = s->x[j], x_d = s->x[j + 1];
        vec v_a = velocity(c, i), v_b = velocity(c, i + 1), v_c = velocity(c, j), v_d = velocity(c, j + 1);
        vec left = falls ? air_on(x_a, x_c, x_d, v_a, v_c, v_d) : air_on(x_a, x_c, x_b, v_a, v_c, v_b);
        vec right = falls ? air_on(x_a, x_d, x_b, v_a, v_d, v_b) : air_on(x_b, x_c, x_d, v_b, v_c, v_d);
        left = scale(left, c->has_cell[p]);
        right = scale(right, c->has_cell[p]);
        vec both = add(left, right);
        force[p] = add(force[p], falls ? both : left);
        force[p + 1] = add(force[p + 1], falls ? right : both);
        force_below[p] = add(force_below[p], falls ? left : both);
        force_below[p + 1] = add(force_below[p + 1], falls ? both : right);
    }
}

// x + (x - x_before)·kept + a·h² for a row; its forces are set to zero for the next one.
static void step_row(const cloth *c, int row, vec *force) {
    const sheet *s = &c->sheet;
    force[0] = add(force[0], vec_from_lane_before(force[s->strip]));
    for (int p = 0; p < s->strip; p++) {
        int i = at(s, row, p);
        vec x = s->x[i], moved = sub(x, c->x_before[i]), a = scale(force[p], s->inverse_mass[i]);
        a.y -= where(s->inverse_mass[i] > 0, splat(GRAVITY));
        s->x[i] = add(x, add(scale(moved, splat(c->kept)), scale(a, splat(c->h * c->h))));
        c->x_before[i] = x;
    }
    memset(force, 0, s->stride * sizeof(vec));
}

static void verlet_step(const cloth *c) {
    const sheet *s = &c->sheet;
    for (int row = 0; row < s->rows; row++) {
        copy_halo(s, s->x, row);
        copy_halo(s, c->x_before, row);
    }
    for (int row = 0; row < s->rows; row++) {  // a triangle reaches over two rows, so the upper one can go on at once
        vec *force = c->force[row % 2];
        if (row + 1 < s->rows) gather_air(c, row, force, c->force[(row + 1) % 2]);
        step_row(c, row, force);
    }
}

static void advance_frame(cloth *c, int substeps, int iterations) {
    for (int i = 0; i < substeps; i++) {
        c->time += c->h;
        double turns = TURN * c->time;
        c->ball = (vec){splat(1.3 * sin(turns / 11)), splat(1.3 + 0.2 * sin(turns / 7)), splat(1.7 * cos(turns / 6))};
        verlet_step(c);
        for (int k = 0; k < iterations; k++) sweep(c);
    }
}

int main(int count, char **words) {
    arguments a = read_arguments(count, words);
    cloth c = hang(a);
    double *ms = zeros(a.frames, sizeof(double));
    for (int frame = 0; frame < a.frames; frame++) {
        double start = milliseconds();
        advance_frame(&c, a.substeps, a.iterations);
        ms[frame] = milliseconds() - start;
    }
    return report("relax", a, &c.sheet, ms);
}
