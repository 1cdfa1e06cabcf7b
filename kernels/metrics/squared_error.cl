/* Sums of squared differences between relit radiance and the stack's own code values, in units of the peak.
 *
 *   error_mt    (M, T) float      sum over segment t of the columns of weight (a - b)^2
 *   relit_mp    (M, P) float      linear radiance; a = clip(relit) to [0, 1], then by the stack's transfer
 *   source_mp   (M, P) SAMPLE_T   code values; b = clip(scale source) to [0, 1]
 *   weight_p    (P) float         1 where the pixel counts, else 0
 *
 *   SEGMENT     columns that one work-item sums; float32 error below eps32 SEGMENT / 8 of the sum
 *   ENCODE      0 linear, 1 sRGB
 */
#include "common/lanes.clh"
#include "common/types.clh"
#include "common/transfer.clh"

#if !defined(SEGMENT) || !defined(ENCODE)
#error "SEGMENT and ENCODE must be defined"
#endif

/* NaN stays NaN. */
#define CLIP(x) ((x) < 0.0f ? 0.0f : (x) > 1.0f ? 1.0f : (x))

static float display_value(const float radiance)
{
    const float v = CLIP(radiance);
#if ENCODE
    return encode_srgb(v);
#else
    return v;
#endif
}

__kernel void sum_squared_error_mt(__global float *restrict error_mt, __global const float *restrict relit_mp,
                                   __global const SAMPLE_T *restrict source_mp, __global const float *restrict weight_p,
                                   const float scale, const int size_m, const int size_t, const int size_p)
{
    const int m = get_global_id(0), t = get_global_id(1);
    __global const float *relit = relit_mp + (long)m * size_p;
    __global const SAMPLE_T *source = source_mp + (long)m * size_p;
    const int end = min((t + 1) * SEGMENT, size_p);
    int p = t * SEGMENT;
    float8 sums = 0.0f;
#if !ENCODE
    if (end == p + SEGMENT) {
        float given[SEGMENT];
#if SAMPLE_HALF
        for (int c = 0; c < SEGMENT; c += 8) AT(, float8, given + c) = scale * LOAD_SAMPLE8(source, p + c);
#else
        /* A loop of fixed length without calls: compilers vectorise it with the conversion. */
        for (int c = 0; c < SEGMENT; c++) given[c] = scale * LOAD_SAMPLE(source, p + c);
#endif
        for (int c = 0; c < SEGMENT; c += 8) {
            const float8 a = AT(__global const, float8, relit + p + c), b = AT(const, float8, given + c);
            const float8 d = CLIP(a) - CLIP(b);
            sums += AT(__global const, float8, weight_p + p + c) * d * d;
        }
        p = end;
    }
#endif
    float sum = sums.s0 + sums.s1 + sums.s2 + sums.s3 + sums.s4 + sums.s5 + sums.s6 + sums.s7;
    for (; p < end; p++) {
        const float d = display_value(relit[p]) - CLIP(scale * LOAD_SAMPLE(source, p));
        sum += weight_p[p] * d * d;
    }
    error_mt[(long)m * size_t + t] = sum;
}
