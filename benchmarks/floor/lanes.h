// Eight floats that are treated at once, and vectors of three of them.
//
// GCC's vector extension, which clang has too: a value is one AVX register, or two of SSE or NEON. Only the
// estimate of an inverse root is particular to a processor.
#pragma once

#if defined(__AVX__)
#include <immintrin.h>
#endif

#define LANES 8
#define INLINE static inline __attribute__((always_inline))

typedef float v8 __attribute__((vector_size(4 * LANES)));
typedef int v8i __attribute__((vector_size(4 * LANES)));
typedef long long v4w __attribute__((vector_size(4 * LANES)));

// x, y and z of eight particles: a structure of arrays in pieces of one register.
typedef struct {
    v8 x, y, z;
} vec;

INLINE v8 splat(float a) { return a - (v8){0}; }

// Comparing two v8 gives a mask: all bits of a lane are set where it holds.
INLINE v8 where(v8i mask, v8 a) { return (v8)(mask & (v8i)a); }

INLINE int any(v8i mask) {
    v4w pairs = (v4w)mask;
    return (pairs[0] | pairs[1] | pairs[2] | pairs[3]) != 0;
}

// Lane k gets lane k + 1, the last lane keeps its own.
INLINE v8 from_next_lane(v8 a) {
#if defined(__clang__)
    return __builtin_shufflevector(a, a, 1, 2, 3, 4, 5, 6, 7, 7);
#else
    return __builtin_shuffle(a, (v8i){1, 2, 3, 4, 5, 6, 7, 7});
#endif
}

// Lane k gets lane k - 1, the first lane 0.
INLINE v8 from_lane_before(v8 a) {
#if defined(__clang__)
    return __builtin_shufflevector(a, (v8){0}, 8, 0, 1, 2, 3, 4, 5, 6);
#else
    return __builtin_shuffle(a, (v8){0}, (v8i){8, 0, 1, 2, 3, 4, 5, 6});
#endif
}

// 1/sqrt(a) to single precision: an estimate r, then Newton steps r (3 - a r^2) / 2. With a square root and a
// division the one unit that does both would be busy for longer than all the rest of a spring takes.
INLINE v8 inverse_root(v8 a) {
    v8 half = 0.5f * a;
#if defined(__AVX__)
    v8 r = (v8)_mm256_rsqrt_ps((__m256)a);  // good to 12 bits: one step is enough
#else
    v8 r = (v8)(0x5f375a86 - ((v8i)a >> 1));  // halved exponent, 4 bits: three steps (C. Lomont 2003)
    r = r * (1.5f - half * r * r);
    r = r * (1.5f - half * r * r);
#endif
    return r * (1.5f - half * r * r);
}

INLINE vec add(vec a, vec b) { return (vec){a.x + b.x, a.y + b.y, a.z + b.z}; }
INLINE vec sub(vec a, vec b) { return (vec){a.x - b.x, a.y - b.y, a.z - b.z}; }
INLINE vec scale(vec a, v8 s) { return (vec){a.x * s, a.y * s, a.z * s}; }
INLINE v8 dot(vec a, vec b) { return a.x * b.x + a.y * b.y + a.z * b.z; }

// a·a, kept from 0 so that its inverse root is finite; 1e-30 m² is far below the square of any length here.
INLINE v8 squared(vec a) { return 1e-30f + a.x * a.x + a.y * a.y + a.z * a.z; }

INLINE vec cross(vec a, vec b) {
    return (vec){a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x};
}

INLINE vec vec_from_next_lane(vec a) {
    return (vec){from_next_lane(a.x), from_next_lane(a.y), from_next_lane(a.z)};
}

INLINE vec vec_from_lane_before(vec a) {
    return (vec){from_lane_before(a.x), from_lane_before(a.y), from_lane_before(a.z)};
}
