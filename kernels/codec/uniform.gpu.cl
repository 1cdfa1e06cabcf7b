/* Uniform quantisation for GPUs: see codec/uniform.cl for the equations and the arrays.
 *
 *   GROUP     work-items of a group, along p, a power of two that divides STRETCH
 *   STRETCH   coefficients that one entry of errors_kji is for
 */
#if !defined(BITS) || !defined(STRETCH) || !defined(GROUP)
#error "BITS, STRETCH and GROUP must be defined"
#endif

/* Without fused operations low = -m step gives exactly 0 for code m, and all devices give the same codes. */
#pragma OPENCL FP_CONTRACT OFF

#define TOP ((float)((1 << BITS) - 1))

/* Adding and subtracting 1.5 2^23 rounds to the nearest integer. */
#define ROUNDER 12582912.0f
#define QUANTISE(y, inverse) (clamp((y) * (inverse), 0.0f, TOP) + ROUNDER - ROUNDER)

/* A step of 0 has only level 0. Steps are at least 2^-128 or so of what low is; the inverse is kept finite. */
#define INVERSE(step) ((step) > 0.0f ? fmin(1.0f / (step), FLT_MAX) : 0.0f)

/* A group keeps its stretch in registers while it goes through the quantisers j. */
kernel __attribute__((reqd_work_group_size(GROUP, 1, 1))) void
measure_uniform_kji(global float *restrict errors_kji, global const float *restrict coeffs_kp,
                    global const float *restrict lows_kj, global const float *restrict steps_kj,
                    global const float *restrict scales_k, const int size_j, const int size_i, const ulong size_p)
{
    local float sums[GROUP];
    const int item = get_local_id(0), i = get_group_id(0), k = get_group_id(1);
    const size_t first = (size_t)i * STRETCH + item;
    float value[STRETCH / GROUP];
#pragma unroll
    for (int v = 0; v < STRETCH / GROUP; v++) {
        const size_t p = first + v * GROUP;
        value[v] = p < size_p ? coeffs_kp[k * size_p + p] * scales_k[k] : 0.0f;
    }
    for (int j = 0; j < size_j; j++) {
        const float low = lows_kj[k * size_j + j], step = steps_kj[k * size_j + j], inverse = INVERSE(step);
        float sum = 0.0f;
#pragma unroll
        for (int v = 0; v < STRETCH / GROUP; v++) {
            const float y = value[v] - low;
            const float error = y - QUANTISE(y, inverse) * step;
            sum += first + v * GROUP < size_p ? error * error : 0.0f;
        }
        sums[item] = sum;
        barrier(CLK_LOCAL_MEM_FENCE);
        for (int reach = GROUP / 2; reach > 0; reach /= 2) {
            if (item < reach) sums[item] += sums[item + reach];
            barrier(CLK_LOCAL_MEM_FENCE);
        }
        if (item == 0) errors_kji[((size_t)k * size_j + j) * size_i + i] = sums[0];
        barrier(CLK_LOCAL_MEM_FENCE);
    }
}

kernel void quantise_uniform_kp(global ushort *restrict codes_kp, global const float *restrict coeffs_kp,
                                global const float *restrict low_k, global const float *restrict step_k,
                                global const float *restrict scales_k, const ulong size_p)
{
    const size_t p = get_global_id(0), k = get_global_id(1);
    if (p >= size_p) return;
    const float y = coeffs_kp[k * size_p + p] * scales_k[k] - low_k[k];
    codes_kp[k * size_p + p] = (ushort)QUANTISE(y, INVERSE(step_k[k]));
}

kernel void dequantise_uniform_kp(global float *restrict coeffs_kp, global const ushort *restrict codes_kp,
                                  global const float *restrict low_k, global const float *restrict step_k,
                                  global const float *restrict unscales_k, const ulong size_p)
{
    const size_t p = get_global_id(0), k = get_global_id(1);
    if (p >= size_p) return;
    /* The last level may lie beyond the largest float by a rounding. */
    const float level = (float)codes_kp[k * size_p + p] * step_k[k] + low_k[k];
    coeffs_kp[k * size_p + p] = clamp(level * unscales_k[k], -FLT_MAX, FLT_MAX);
}
