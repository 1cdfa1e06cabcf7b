/* Uniform quantisation with 2^BITS levels for each map (noise-resistant-fitting, section III-B-3).
 *
 *   q_kp = clamp(round((x_kp s_k - low_k) / step_k), 0, 2^BITS - 1)        x'_kp = (low_k + q_kp step_k) / s_k
 *
 *   coeffs_kp       (k, p) float32
 *   codes_kp        (k, p) q
 *   low_k, step_k   (k,) first level and step, in units of 1/s_k; step is 0 for a constant map
 *   s_k             a power of two that brings the largest magnitude of the map near 1, so that no product or
 *                   square leaves float32; unscale_k is its inverse
 *
 * |x' - x| <= step/(2 s) + 2^-22 max|x| inside the interval.
 */
#include "common/lanes.clh"

#ifndef BITS
#error "BITS must be defined: 1 to 16 bits per coefficient"
#endif
#ifndef STRETCH
#error "STRETCH must be defined: coefficients that a work-item handles, a multiple of 8"
#endif

/* Without fused operations low = -m step gives exactly 0 for code m, and all devices give the same codes. */
#pragma OPENCL FP_CONTRACT OFF

#define TOP ((float)((1 << BITS) - 1))

/* Adding and subtracting 1.5 2^23 rounds to the nearest integer. */
#define ROUNDER 12582912.0f
#define QUANTISE(y, inverse) (WITHIN((y) * (inverse), 0.0f, TOP) + ROUNDER - ROUNDER)

/* A step of 0 has only level 0. Steps are at least 2^-128 or so of what low is; the inverse is kept finite. */
#define INVERSE(step) ((step) > 0.0f ? LESSER(1.0f / (step), FLT_MAX) : 0.0f)

/* Squared error, in units of 1/s^2, of each stretch i of map k under the quantiser j; added up on the host in float64. */
kernel void measure_uniform_kji(global float *restrict errors_kji, global const float *restrict coeffs_kp,
                                global const float *restrict lows_kj, global const float *restrict steps_kj,
                                global const float *restrict scales_k, const int size_j, const int size_i,
                                const ulong size_p)
{
    const size_t i = get_global_id(0), k = get_global_id(1);
    if (i >= size_i)
        return;
    const size_t start = i * STRETCH, stop = LESSER(start + STRETCH, (size_t)size_p);
    global const float *x = coeffs_kp + k * size_p;
    const float scale = scales_k[k];
    for (int j = 0; j < size_j; j++) {
        const float low = lows_kj[k * size_j + j], step = steps_kj[k * size_j + j], inverse = INVERSE(step);
        float8 sum = 0.0f;
        size_t p = start;
        for (; p + 8 <= stop; p += 8) {
            const float8 y = AT(global const, float8, x + p) * scale - low;
            const float8 error = y - QUANTISE(y, inverse) * step;
            sum += error * error;
        }
        float rest = 0.0f;
        for (; p < stop; p++) {
            const float y = x[p] * scale - low;
            const float error = y - QUANTISE(y, inverse) * step;
            rest += error * error;
        }
        const float4 half_sum = sum.lo + sum.hi;
        errors_kji[(k * size_j + j) * size_i + i] =
            (half_sum.s0 + half_sum.s1) + (half_sum.s2 + half_sum.s3) + rest;
    }
}

kernel void quantise_uniform_kp(global ushort *restrict codes_kp, global const float *restrict coeffs_kp,
                                global const float *restrict low_k, global const float *restrict step_k,
                                global const float *restrict scales_k, const ulong size_p)
{
    const size_t start = get_global_id(0) * STRETCH, stop = LESSER(start + STRETCH, (size_t)size_p);
    const size_t k = get_global_id(1);
    global const float *x = coeffs_kp + k * size_p;
    global ushort *codes = codes_kp + k * size_p;
    const float scale = scales_k[k], low = low_k[k], inverse = INVERSE(step_k[k]);
    size_t p = start;
    for (; p + 8 <= stop; p += 8) {
        const float8 y = AT(global const, float8, x + p) * scale - low;
        AT(global, ushort8, codes + p) = CONVERT(QUANTISE(y, inverse), ushort8);
    }
    for (; p < stop; p++) {
        const float y = x[p] * scale - low;
        codes[p] = (ushort)QUANTISE(y, inverse);
    }
}

kernel void dequantise_uniform_kp(global float *restrict coeffs_kp, global const ushort *restrict codes_kp,
                                  global const float *restrict low_k, global const float *restrict step_k,
                                  global const float *restrict unscales_k, const ulong size_p)
{
    const size_t start = get_global_id(0) * STRETCH, stop = LESSER(start + STRETCH, (size_t)size_p);
    const size_t k = get_global_id(1);
    global const ushort *codes = codes_kp + k * size_p;
    global float *x = coeffs_kp + k * size_p;
    const float unscale = unscales_k[k], low = low_k[k], step = step_k[k];
    size_t p = start;
    /* The last level may lie beyond the largest float by a rounding. */
    for (; p + 8 <= stop; p += 8) {
        const float8 level = CONVERT(AT(global const, ushort8, codes + p), float8) * step + low;
        AT(global, float8, x + p) = WITHIN(level * unscale, -FLT_MAX, FLT_MAX);
    }
    for (; p < stop; p++)
        x[p] = WITHIN(((float)codes[p] * step + low) * unscale, -FLT_MAX, FLT_MAX);
}
