/* Constrained least squares from samples to coefficients in one pass: projection, lambda, shrinking and synthesis of
 * TILE columns at a time, which never leave the cache in between. See cls.cl for the equations, lambda.clh for the search.
 *
 *   coeffs_kp     (K, P) float         out
 *   lambda_p      (P) float            out: lambda, 0 where the bound holds without
 *   doubt_p       (P) float            out: relative error that lambda may have, from rounding errors of z and of f
 *   source_ip     (n_light, P) SAMPLE_T
 *   analysis_a    samples to components, packed in row blocks (matmul.py)
 *   heights_b     (n_block) int        rows of each block
 *   synthesis_s   components to coefficients, packed in row blocks
 *   heights_c     (n_block) int
 *   weight_i      (n_light) float      E = sum_i weight_i source_i^2
 *   last_it       (n_light, LAST) double   rows of the analysis of the LAST smallest sigma (REFINED)
 *   singular_r, square_r, inverse_r  (R) float   sigma, sigma^2, 1/sigma^2
 *   table_rn      (R, N_NODE) float    sigma^2 / (sigma^2 + node)^2
 *   rounding      float                error of a z_r, divided by sqrt(E)
 *   tolerance     float                doubt above which z is projected again
 *
 * Where lambda is ill-conditioned it follows components of small sigma, which carry the rounding errors of large sums.
 * Vectors with such a column have those components summed again in float64, and lambda found anew, if
 *
 *   REFINED       is 1; with 0 there is nothing of float64, last_it included
 *   ONTO_BOUND    1 where the search gets too few steps to end: t is scaled by sqrt(E/f) where f exceeds E. Else 0
 *   ROOM          components that there is memory for, at least R
 */
#include "common/source_tile.clh"
#include "fit/lambda.clh"

#if !defined(REFINED) || !defined(ONTO_BOUND)
#error "REFINED and ONTO_BOUND must be defined: 0 or 1"
#endif
#ifndef ROOM
#error "ROOM must be defined: at least the number of components"
#endif

#define EVALUATION 4e-7f /* relative error of f and E in float32 */

#if REFINED
#pragma OPENCL EXTENSION cl_khr_fp64 : enable

#define LAST 8

#define EACH_LAST(DO) DO(0) DO(1) DO(2) DO(3) DO(4) DO(5) DO(6) DO(7)
#if VECTOR == 16
typedef double8 __attribute__((aligned(8))) double8_at;
#define DECLARE_SUM(t) double8 low_##t = 0.0, high_##t = 0.0;
#define ADD_SAMPLE(t)                      \
    low_##t = factors[t] * low + low_##t;    \
    high_##t = factors[t] * high + high_##t;
#define KEEP_SUM(t) AT(__local, double8, sums + t * VECTOR) += low_##t; AT(__local, double8, sums + t * VECTOR + 8) += high_##t;
#else
#if VECTOR == 8
typedef double8 vecd;
#else
typedef double4 vecd;
#endif
typedef vecd __attribute__((aligned(8))) vecd_at;
#define DECLARE_SUM(t) vecd low_##t = 0.0;
#define ADD_SAMPLE(t) low_##t = factors[t] * low + low_##t;
#define KEEP_SUM(t) AT(__local, vecd, sums + t * VECTOR) += low_##t;
#endif

/* sums[t][c] += sum over rows of last[i][t] tile[i][c], for one vector of columns. */
INLINE void sum_last(__local double *sums, __local const vecf *tile, __global const double *last, const int rows)
{
    EACH_LAST(DECLARE_SUM)
    for (int i = 0; i < rows; i++) {
        const vecf samples = tile[i * TILE_VECTORS];
#if VECTOR == 16
        const double8 low = CONVERT(samples.lo, double8), high = CONVERT(samples.hi, double8);
#else
        const vecd low = CONVERT(samples, vecd);
#endif
        __global const double *factors = last + i * LAST;
        EACH_LAST(ADD_SAMPLE)
    }
    EACH_LAST(KEEP_SUM)
}
#endif

/* Replace z by t(lambda) in the `wanted` lanes; return the relative error that lambda may have when the first `rough`
 * z_r are rounded sums. */
INLINE vecf shrink(__local vecf *z, const vecf *b, __global const float *restrict singular_r,
                   __global const float *restrict square_r, const vecf energy, const vecf lambda, const float rounding,
                   const int size_r, const int rough, const veci wanted)
{
    vecf square = 0.0f, slope = 0.0f, gain = 0.0f;
    for (int r = 0; r < size_r; r += 2) {
        /* Two components to a division; the last of an odd number goes with itself. */
        const int other = r + 1 < size_r ? r + 1 : r;
        const vecf x = square_r[r] + lambda, y = square_r[other] + lambda;
        const vecf inverse = 1.0f / (x * y);
        const vecf p = y * inverse, q = x * inverse;
        const vecf t = b[r] * p;
        const vecf tp = t * p;
        square = t * t + square;
        slope = t * tp + slope;
        if (r < rough) gain = tp * tp * square_r[r] + gain;
        z[r * TILE_VECTORS] = wanted ? t : z[r * TILE_VECTORS];
        if (other == r) break;
        const vecf u = b[other] * q;
        const vecf uq = u * q;
        square = u * u + square;
        slope = u * uq + slope;
        if (other < rough) gain = uq * uq * square_r[other] + gain;
        z[other * TILE_VECTORS] = wanted ? u : z[other * TILE_VECTORS];
    }
#if ONTO_BOUND
    const vecf factor = square > energy ? root(energy / square) : (vecf)(1.0f);
    for (int r = 0; r < size_r; r++) z[r * TILE_VECTORS] *= wanted ? factor : (vecf)(1.0f);
#endif
    const vecf doubt = (rounding * root(energy * gain) + 0.5f * EVALUATION * square) / (lambda * slope);
    return lambda > 0.0f ? doubt : (vecf)(0.0f);
}

__kernel void fit_cls_kp(__global float *restrict coeffs_kp, __global float *restrict lambda_p,
                         __global float *restrict doubt_p, __global const SAMPLE_T *restrict source_ip,
                         __global const float *restrict analysis_a, __global const int *restrict heights_b,
                         __global const float *restrict synthesis_s, __global const int *restrict heights_c,
                         __global const float *restrict weight_i,
#if REFINED
                         __global const double *restrict last_it,
#endif
                         __global const float *restrict singular_r, __global const float *restrict square_r,
                         __global const float *restrict inverse_r, __global const float *restrict table_rn,
                         __global const float *restrict curve_v, const float scale, const float first_node,
                         const float node_step, const float rounding, const float tolerance, const int iterations,
                         const int size_i, const int size_p, const int size_r, const int size_b, const int size_c)
{
    __local vecf tile[CHUNK * TILE_VECTORS];
    __local vecf z[ROOM * TILE_VECTORS];
    __local vecf sums[8 * TILE_VECTORS];
    __local vecf energies[TILE_VECTORS], lambdas[TILE_VECTORS], doubts[TILE_VECTORS];
#if REFINED
    __local double exact[TILE_VECTORS * LAST * VECTOR];
    int again[TILE_VECTORS], some = 0;
#endif
    const int first = get_global_id(0) * TILE;
    const int filled = LESSER(TILE, size_p - first);
    vecf b[ROOM];

    for (int i0 = 0; i0 < size_i; i0 += CHUNK) {
        const int rows = LESSER(CHUNK, size_i - i0);
        load_tile(tile, source_ip, i0, rows, first, filled, size_p, curve_v, scale);
        sum_energy(energies, tile, weight_i + i0, rows, i0 == 0);
        __local vecf *out = z;
        __global const float *operator = analysis_a;
        for (int k = 0; k < size_b; k++) {
            const int height = heights_b[k];
            apply_block(height, tile, operator + i0 * height, rows, out, i0 == 0);
            operator += (long)height * size_i;
            out += height * TILE_VECTORS;
        }
    }

    for (int v = 0; v < TILE_VECTORS; v++) {
        for (int r = 0; r < size_r; r++) b[r] = singular_r[r] * z[r * TILE_VECTORS + v];
        /* Black columns: any positive bound will do. */
        const vecf energy = GREATER(energies[v], FLT_MIN);
        const vecf guess = guess_lambda(b, inverse_r, table_rn, size_r, energy, first_node, node_step);
        const vecf lambda = search_lambda(b, square_r, size_r, energy, guess, iterations);
        const vecf doubt = shrink(z + v, b, singular_r, square_r, energy, lambda, rounding, size_r, size_r, -1);
        energies[v] = energy;
        lambdas[v] = lambda;
        doubts[v] = doubt;
#if REFINED
        again[v] = any_lane(doubt > tolerance);
        some |= again[v];
#endif
    }
#if REFINED
    if (some) {
        for (int c = 0; c < TILE_VECTORS * LAST * VECTOR; c++) exact[c] = 0.0;
        for (int i0 = 0; i0 < size_i; i0 += CHUNK) {
            const int rows = LESSER(CHUNK, size_i - i0);
            if (size_i > CHUNK) load_tile(tile, source_ip, i0, rows, first, filled, size_p, curve_v, scale);
            for (int v = 0; v < TILE_VECTORS; v++)
                if (again[v]) sum_last(exact + v * LAST * VECTOR, tile + v, last_it + (long)i0 * LAST, rows);
        }
        for (int v = 0; v < TILE_VECTORS; v++) {
            if (!again[v]) continue;
            /* b from t is as good as it was: a relative rounding error. */
            for (int r = 0; r < size_r; r++) b[r] = z[r * TILE_VECTORS + v] * (square_r[r] + lambdas[v]);
            const int rough = size_r > LAST ? size_r - LAST : 0;
            for (int r = rough; r < size_r; r++) {
                for (int c = 0; c < VECTOR; c++)
                    ((float *)(b + r))[c] = singular_r[r] * exact[(v * LAST + r - rough) * VECTOR + c];
            }
            const vecf lambda = search_lambda(b, square_r, size_r, energies[v], lambdas[v], iterations);
            const veci wanted = doubts[v] > tolerance;
            const vecf doubt =
                shrink(z + v, b, singular_r, square_r, energies[v], lambda, rounding, size_r, rough, wanted);
            doubts[v] = wanted ? doubt : doubts[v];
            lambdas[v] = wanted ? lambda : lambdas[v];
        }
    }
#endif
    store_row(lambda_p + first, (__local const float *)lambdas, filled, 0);
    store_row(doubt_p + first, (__local const float *)doubts, filled, 0);
    __global const float *operator = synthesis_s;
    int k = 0;
    for (int c = 0; c < size_c; c++) {
        const int height = heights_c[c];
        apply_block(height, z, operator, size_r, sums, 1);
        for (int r = 0; r < height; r++)
            store_row(coeffs_kp + (long)(k + r) * size_p + first, (__local const float *)(sums + r * TILE_VECTORS),
                      filled, 0);
        operator += (long)height * size_r;
        k += height;
    }
}
