/* Sums of squared differences for GPUs: see metrics/relit_error.cl for the equation, the arrays and ENCODE.
 *
 *   SEGMENT   columns that a group of work-items sums; group t of T times m + t makes error_mt[m][t]
 *   GROUP     its work-items, a power of two that divides SEGMENT
 *
 * Each work-item sums every GROUP-th column, then halves of the group are added until one sum is left: always the same
 * order. float32 error below eps32 (SEGMENT / GROUP + log2 GROUP + 4) of the sum.
 */
#include "common/types.clh"
#include "common/transfer.clh"

#if !defined(SEGMENT) || !defined(GROUP) || !defined(ENCODE)
#error "SEGMENT, GROUP and ENCODE must be defined"
#endif

/* NaN stays NaN. */
#define CLIP(x) ((x) < 0.0f ? 0.0f : (x) > 1.0f ? 1.0f : (x))

__kernel __attribute__((reqd_work_group_size(GROUP, 1, 1))) void
sum_squared_error_mt(__global float *restrict error_mt, __global const float *restrict relit_mp,
                     __global const SAMPLE_T *restrict source_mp, __global const float *restrict weight_p,
                     const float scale, const int size_m, const int size_t, const int size_p)
{
    __local float sums[GROUP];
    const int item = get_local_id(0), m = get_group_id(0) / size_t, t = get_group_id(0) % size_t;
    __global const float *relit = relit_mp + (long)m * size_p;
    __global const SAMPLE_T *source = source_mp + (long)m * size_p;
    float sum = 0.0f;
    for (int i = item; i < SEGMENT; i += GROUP) {
        const int p = t * SEGMENT + i;
        if (p < size_p) {
            float shown = CLIP(relit[p]);
#if ENCODE > 0
            shown = encode_srgb(shown);
#elif ENCODE < 0
            shown = decode_srgb(shown);
#endif
            const float d = shown - CLIP(scale * LOAD_SAMPLE(source, p));
            sum += weight_p[p] * d * d;
        }
    }
    sums[item] = sum;
    barrier(CLK_LOCAL_MEM_FENCE);
    for (int half_group = GROUP / 2; half_group > 0; half_group /= 2) {
        if (item < half_group) sums[item] += sums[item + half_group];
        barrier(CLK_LOCAL_MEM_FENCE);
    }
    if (item == 0) error_mt[(long)m * size_t + t] = sums[0];
}
