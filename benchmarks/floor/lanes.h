// SIMD vectors of floats, and vec3 of them.
//
// These are vector extensions of GCC and clang: eight floats with AVX, four with SSE or NEON. GCC would store wider
// vectors in memory, which is twice as slow. With AVX-512, `-DLANES=16` selects sixteen: up to 1.7 times as fast, but
// slower on a grid that does not fill them. Only the estimate of an inverse square root depends on the processor.
#pragma once

#if defined(__SSE2__)
#include <immintrin.h>
#endif

#if !defined(LANES)
#if defined(__AVX__)
#define LANES 8
#else
#define LANES 4
#endif
#elif LANES != 16 || !defined(__AVX512F__)
#error "LANES may be set to 16, with AVX-512"
#endif

#define INLINE static inline __attribute__((always_inline))

typedef float floats __attribute__((vector_size(4 * LANES)));
typedef int ints __attribute__((vector_size(4 * LANES)));
typedef long long words __attribute__((vector_size(4 * LANES)));

#if LANES == 16
#define NEXT 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15, 15  // the lane that each lane gets
#define BEFORE 16, 0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14
#elif LANES == 8
#define NEXT 1, 2, 3, 4, 5, 6, 7, 7
#define BEFORE 8, 0, 1, 2, 3, 4, 5, 6
#else
#define NEXT 1, 2, 3, 3
#define BEFORE 4, 0, 1, 2
#endif

// x, y and z of LANES particles: an array of structures of arrays (AoSoA).
typedef struct {
    floats x, y, z;
} vec;

INLINE floats splat(float a) { return a - (floats){0}; }

// Comparing two floats gives a mask: all bits of a lane are set where it holds.
INLINE floats where(ints mask, floats a) { return (floats)(mask & (ints)a); }

INLINE int any(ints mask) {
    words pairs = (words)mask;
    long long some = 0;
    for (int i = 0; i < LANES / 2; i++) some |= pairs[i];
    return some != 0;
}

// Lane k gets lane k + 1; the last lane keeps its value.
INLINE floats from_next_lane(floats a) {
#if defined(__clang__)
    return __builtin_shufflevector(a, a, NEXT);
#else
    return __builtin_shuffle(a, (ints){NEXT});
#endif
}

// Lane k gets lane k - 1, the first lane 0.
INLINE floats from_lane_before(floats a) {
#if defined(__clang__)
    return __builtin_shufflevector(a, (floats){0}, BEFORE);
#else
    return __builtin_shuffle(a, (floats){0}, (ints){BEFORE});
#endif
}

// 1/sqrt(a) to single precision: an estimate r, then Newton steps r (3 - a r^2) / 2. With a square root and a
// division the one unit that does both would be busy for longer than all the rest of a spring takes.
INLINE floats inverse_root(floats a) {
    floats half = 0.5f * a;
#if LANES == 16
    floats r = (floats)_mm512_rsqrt14_ps((__m512)a);  // good to 14 bits: one step is enough
#elif defined(__AVX__)
    floats r = (floats)_mm256_rsqrt_ps((__m256)a);  // 12 bits: the same
#elif defined(__SSE2__)
    floats r = (floats)_mm_rsqrt_ps((__m128)a);  // the same
#else
    floats r = (floats)(0x5f375a86 - ((ints)a >> 1));  // halved exponent, 4 bits: three steps (C. Lomont 2003)
    r = r * (1.5f - half * r * r);
    r = r * (1.5f - half * r * r);
#endif
    return r * (1.5f - half * r * r);
}

INLINE vec add(vec a, vec b) { return (vec){a.x + b.x, a.y + b.y, a.z + b.z}; }
INLINE vec sub(vec a, vec b) { return (vec){a.x - b.x, a.y - b.y, a.z - b.z}; }
INLINE vec scale(vec a, floats s) { return (vec){a.x * s, a.y * s, a.z * s}; }
INLINE floats dot(vec a, vec b) { return a.x * b.x + a.y * b.y + a.z * b.z; }

// a·a, kept from 0 so that its inverse root is finite; 1e-30 m² is far below the square of any length here.
INLINE floats squared(vec a) { return 1e-30f + a.x * a.x + a.y * a.y + a.z * a.z; }

INLINE vec cross(vec a, vec b) {
    return (vec){a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x};
}

INLINE vec vec_from_next_lane(vec a) {
    return (vec){from_next_lane(a.x), from_next_lane(a.y), from_next_lane(a.z)};
}

INLINE vec vec_from_lane_before(vec a) {
    return (vec){from_lane_before(a.x), from_lane_before(a.y), from_lane_before(a.z)};
}
