// The explicit step of a sheet of springs in optimized C on one thread.
//
//   ./explicit ROWS COLUMNS SUBSTEPS 1 FRAMES [dump]
//
// The sheet is level at the start and hangs by the two corners of its first row. A substep is one leapfrog step: forces
// of all springs and of gravity, then velocities, then positions with the new velocities. ITERATIONS must be 1.
//
// A substep must be shorter than 2/ω of the stiffest mode: this takes about 1.8 · COLUMNS substeps (measured).
#include "program.h"

#define FRAME_SECONDS (1.0 / 60)

static const float WIDTH = 1.45f, HEIGHT = 1;                    // [m]
static const float AREA_DENSITY = 0.2f;                          // [kg/m²]
static const float GRAVITY = 9.81f;                              // [m/s²]
static const float DAMPING = 1;                                  // [1/s]
static const float STRUCTURAL = 2000, SHEAR = 1000, BEND = 20;   // [N/m]

// Spring constants [N/m] at one packet; 0 in lanes where the spring would end outside the sheet.
typedef struct {
    floats along, diagonal, skip;  // to the right
    floats down, skip_down;
} constants;

// A spring along an edge has half the constant: there is cloth on one side only. `number` is its row or column.
static float edge_share(int number, int count) { return number % (count - 1) ? 1 : 0.5f; }

typedef struct {
    sheet sheet;
    vec *v;           // [m/s] an array of its own: differences of float positions lose digits with every substep
    vec *force[3];    // [N] on the row in hand and on the two below it
    constants *k[2];  // by place, in rows inside the sheet and in the first and the last one
    float h, kept;    // [s] substep; share of velocity left after it
    float kick;       // [s] for which forces act on velocities: h, and half of it at first (leapfrog)
} cloth;

static cloth lay(arguments a) {
    cloth c = {.sheet = make_sheet(a.rows, a.columns, HALO, WIDTH, HEIGHT, 0, 1, AREA_DENSITY)};
    sheet *s = &c.sheet;
    hold(s, 0, 0);
    hold(s, 0, s->columns - 1);
    c.v = zeros((size_t)s->rows * s->stride, sizeof(vec));
    for (int i = 0; i < 3; i++) c.force[i] = zeros(s->stride, sizeof(vec));
    for (int edge = 0; edge < 2; edge++) {
        c.k[edge] = zeros(s->strip, sizeof(constants));
        float share = edge_share(edge ? 0 : 1, s->rows);
        for (int p = 0; p < s->strip; p++) {
            floats next = has_right(s, p, 1), after_next = has_right(s, p, 2), inside;
            for (int lane = 0; lane < LANES; lane++) inside[lane] = edge_share(lane * s->strip + p, s->columns);
            c.k[edge][p] = (constants){STRUCTURAL * share * next, SHEAR * next, BEND * share * after_next,
                                       STRUCTURAL * inside, BEND * inside};
        }
    }
    for (int row = 0; row < s->rows; row++) copy_halo(s, s->x, row);
    c.h = FRAME_SECONDS / a.substeps;
    c.kick = c.h / 2;
    c.kept = expf(-DAMPING * c.h);
    return c;
}

// Adds the force of the spring between p and q to both ends.
INLINE void attract(vec p, vec q, floats k, floats rest, vec *on_p, vec *on_q) {
    vec gap = sub(q, p);
    vec pull = scale(gap, k * (1 - rest * inverse_root(squared(gap))));
    *on_p = add(*on_p, pull);
    *on_q = sub(*on_q, pull);
}

// Adds the forces of the springs that go right or down from a row: on this row, the next, and the one after that. Each
// spring is computed once; sums that the next packet continues stay in registers.
INLINE void gather_springs(const cloth *c, int row, int rows_below, vec *force, vec *force_below, vec *force_after) {
    const sheet *s = &c->sheet;
    const constants *k = c->k[row % (s->rows - 1) == 0];
    const vec *x = s->x + at(s, row, 0);
    const vec *x_below = rows_below >= 1 ? x + s->stride : x, *x_after = rows_below >= 2 ? x + 2 * s->stride : x;
    floats side = splat(s->side), diagonal = splat(s->side * sqrtf(2)), skip = splat(2 * s->side);
    vec p = x[0], on_p = force[0], right = x[1], on_right = force[1], down = x_below[0], on_down = force_below[0];
    for (int i = 0; i < s->strip; i++) {
        vec after = x[i + 2], on_after = force[i + 2];
        attract(p, right, k[i].along, side, &on_p, &on_right);
        attract(p, after, k[i].skip, skip, &on_p, &on_after);
        if (rows_below >= 1) {
            vec down_right = x_below[i + 1], on_down_right = force_below[i + 1];
            attract(p, down, k[i].down, side, &on_p, &on_down);
            attract(p, down_right, k[i].diagonal, diagonal, &on_p, &on_down_right);
            attract(right, down, k[i].diagonal, diagonal, &on_right, &on_down);
            force_below[i] = on_down;
            down = down_right;
            on_down = on_down_right;
        }
        if (rows_below >= 2) attract(p, x_after[i], k[i].skip_down, skip, &on_p, &force_after[i]);
        force[i] = on_p;
        p = right;
        on_p = on_right;
        right = after;
        on_right = on_after;
    }
    force[s->strip] = on_p;
    force[s->strip + 1] = on_right;
    force_below[s->strip] = on_down;
}

// Velocities and positions of a row; its forces are set to zero for the row three further down.
static void step_row(const cloth *c, int row, vec *force) {
    const sheet *s = &c->sheet;
    for (int p = 0; p < HALO; p++) force[p] = add(force[p], vec_from_lane_before(force[s->strip + p]));
    for (int p = 0; p < s->strip; p++) {
        int i = at(s, row, p);
        vec a = scale(force[p], s->inverse_mass[i]);
        a.y -= where(s->inverse_mass[i] > 0, splat(GRAVITY));
        c->v[i] = add(scale(c->v[i], splat(c->kept)), scale(a, splat(c->kick)));
        s->x[i] = add(s->x[i], scale(c->v[i], splat(c->h)));
    }
    copy_halo(s, s->x, row);
    memset(force, 0, s->stride * sizeof(vec));
}

static void step(cloth *c) {
    int last = c->sheet.rows - 1;
    for (int row = 0; row <= last; row++) {  // each spring is its upper end's: after its own a row can go on
        vec *f = c->force[row % 3], *g = c->force[(row + 1) % 3], *e = c->force[(row + 2) % 3];
        if (row + 2 <= last)
            gather_springs(c, row, 2, f, g, e);
        else
            gather_springs(c, row, last - row, f, g, e);
        step_row(c, row, f);
    }
    c->kick = c->h;
}

int main(int count, char **words) {
    arguments a = read_arguments(count, words);
    if (a.iterations != 1) stop(2, "an explicit step has nothing to iterate: ITERATIONS is 1");
    cloth c = lay(a);
    double *ms = zeros(a.frames, sizeof(double));
    for (int frame = 0; frame < a.frames; frame++) {
        double start = milliseconds();
        for (int i = 0; i < a.substeps; i++) step(&c);
        ms[frame] = milliseconds() - start;
    }
    return report("explicit", a, &c.sheet, ms);
}
