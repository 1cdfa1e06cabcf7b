/* Nearest codeword of each vector (Gersho and Gray 1992, chapter 10, full search).
 *
 *   codes_p = argmin_j sum_d (vectors_dp - codebook_jd)^2,  squares_p = that sum
 *
 *   vectors_dp    (d, p) float32; p a multiple of LANES * BLOCK
 *   codebook_jd   (j, d) float32; j a multiple of ROWS (repeat the last codeword)
 *   codes_p       (p,) the lowest such j
 *   squares_p     (p,) float32; relative error (d + 2) eps32
 *
 * A work-item takes BLOCK vectors of LANES neighbouring p, and goes through the codebook by ROWS codewords at once, so
 * that each value loaded is used several times.
 */
#include "common/lanes.clh"

#if LANES == 8
typedef float8 real;
typedef int8 whole;
#define REALS(space, p) AT(space, float8, p)
#define SHORTS(p) AT(global, ushort8, p)
#define TO_SHORTS(x) CONVERT(x, ushort8)
#elif LANES == 1
typedef float real;
typedef int whole;
#define REALS(space, p) (*(p))
#define SHORTS(p) (*(p))
#define TO_SHORTS (ushort)
#else
#error "LANES must be defined: 8 (CPU) or 1 (GPU)"
#endif
#ifndef BLOCK
#error "BLOCK must be defined: how many groups of LANES vectors a work-item searches for"
#endif
#ifndef ROWS
#error "ROWS must be defined: codewords that are compared at once"
#endif

kernel void search_vq_p(global ushort *restrict codes_p, global float *restrict squares_p,
                        global const float *restrict vectors_dp, global const float *restrict codebook_jd,
                        const int size_d, const int size_j, const int size_p)
{
    const size_t first = get_global_id(0) * (LANES * BLOCK);
    if (first >= (size_t)size_p)
        return;
    real nearest[BLOCK];
    whole code[BLOCK];
    for (int i = 0; i < BLOCK; i++) {
        nearest[i] = INFINITY;
        code[i] = 0;
    }
    for (int j = 0; j < size_j; j += ROWS) {
        real square[ROWS][BLOCK];
#pragma unroll
        for (int r = 0; r < ROWS; r++)
#pragma unroll
            for (int i = 0; i < BLOCK; i++)
                square[r][i] = 0.0f;
        for (int d = 0; d < size_d; d++) {
            real x[BLOCK];
#pragma unroll
            for (int i = 0; i < BLOCK; i++)
                x[i] = REALS(global const, vectors_dp + (size_t)d * size_p + first + i * LANES);
#pragma unroll
            for (int r = 0; r < ROWS; r++) {
                const float y = codebook_jd[(size_t)(j + r) * size_d + d];
#pragma unroll
                for (int i = 0; i < BLOCK; i++)
                    square[r][i] += (x[i] - y) * (x[i] - y);
            }
        }
#pragma unroll
        for (int r = 0; r < ROWS; r++)
#pragma unroll
            for (int i = 0; i < BLOCK; i++) {
                const whole nearer = square[r][i] < nearest[i];
                nearest[i] = nearer ? square[r][i] : nearest[i];
                code[i] = nearer ? (whole)(j + r) : code[i];
            }
    }
    for (int i = 0; i < BLOCK; i++) {
        REALS(global, squares_p + first + i * LANES) = nearest[i];
        SHORTS(codes_p + first + i * LANES) = TO_SHORTS(code[i]);
    }
}
