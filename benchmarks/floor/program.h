// What both programs share around their cloth: arguments in, a clock, one line of JSON out.
#pragma once

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

#include "sheet.h"

typedef struct {
    int rows, columns, substeps, iterations, frames;
    int dump;  // 1: the positions after the last frame are printed too
} arguments;

static inline _Noreturn void stop(int status, const char *message) {
    fprintf(stderr, "%s\n", message);
    exit(status);
}

static inline int count_in(const char *word, int low) {
    char *end;
    long value = strtol(word, &end, 10);
    if (end == word || *end || value < low || value > 100000)
        stop(2, "ROWS and COLUMNS are whole numbers from 2, SUBSTEPS, ITERATIONS and FRAMES from 1, to 100000");
    return (int)value;
}

static inline arguments read_arguments(int count, char **words) {
    int dump = count == 7 && strcmp(words[6], "dump") == 0;
    if (count != 6 && !dump) stop(2, "arguments: ROWS COLUMNS SUBSTEPS ITERATIONS FRAMES [dump]");
    return (arguments){count_in(words[1], 2), count_in(words[2], 2), count_in(words[3], 1),
                       count_in(words[4], 1), count_in(words[5], 1), dump};
}

static inline double milliseconds(void) {
    struct timespec t;
    clock_gettime(CLOCK_MONOTONIC, &t);
    return 1e3 * t.tv_sec + 1e-6 * t.tv_nsec;
}

static inline void position(const sheet *s, int row, int column, double out[3]) {
    int i = at(s, row, column % s->strip), lane = column / s->strip;
    out[0] = s->x[i].x[lane];
    out[1] = s->x[i].y[lane];
    out[2] = s->x[i].z[lane];
}

// |strain| of the spring between two neighbours.
static inline double strain(const sheet *s, int row, int column, int down, int right) {
    double p[3], q[3];
    position(s, row, column, p);
    position(s, row + down, column + right, q);
    double x = q[0] - p[0], y = q[1] - p[1], z = q[2] - p[2];
    return fabs(sqrt(x * x + y * y + z * z) / s->side - 1);
}

static inline int compare(const void *a, const void *b) {
    return (*(const double *)a > *(const double *)b) - (*(const double *)a < *(const double *)b);
}

// Prints the line and returns the exit status; sorts `ms`, the time of each frame.
static inline int report(const char *program, arguments a, const sheet *s, double *ms) {
    double height = 0, largest = 0, p[3];
    for (int row = 0; row < s->rows; row++)
        for (int column = 0; column < s->columns; column++) {
            position(s, row, column, p);
            height += p[1] / (s->rows * s->columns);
            if (row + 1 < s->rows) largest = fmax(largest, strain(s, row, column, 1, 0));
            if (column + 1 < s->columns) largest = fmax(largest, strain(s, row, column, 0, 1));
        }
    if (!isfinite(height)) stop(1, "the cloth blew up: its step is too long for its springs; more substeps");
    qsort(ms, a.frames, sizeof(double), compare);
    printf("{\"program\": \"%s\", \"lanes\": %d, \"rows\": %d, \"columns\": %d, ", program, LANES, a.rows, a.columns);
    printf("\"substeps\": %d, \"iterations\": %d, \"frames\": %d, ", a.substeps, a.iterations, a.frames);
    printf("\"median_ms\": %.5f, \"best_ms\": %.5f, \"p95_ms\": %.5f, \"max_strain\": %.6g, \"mean_height\": %.7g",
           (ms[(a.frames - 1) / 2] + ms[a.frames / 2]) / 2, ms[0], ms[(95 * a.frames + 99) / 100 - 1], largest, height);
    for (int i = 0; a.dump && i < s->rows * s->columns; i++) {
        position(s, i / s->columns, i % s->columns, p);
        printf("%s[%.9g, %.9g, %.9g]", i ? ", " : ", \"positions\": [", p[0], p[1], p[2]);
    }
    printf(a.dump ? "]}\n" : "}\n");
    return 0;
}
