/* Display values of radiance, and bytes of sums of them: what other programs' files hold.
 *
 * show_values_p: values_p becomes curve(clip(values_p)), straight on below 0; error below 5e-7 of the value.
 *
 *   values_p   (P) float   linear radiance, then display values
 *   low, high  float       what radiance is cut to; NaN becomes low
 *
 * code_values_q: the byte nearest to sum_tq + offset_t, cut to 0 .. 255; GROUP rows beside each other.
 *
 *   codes_q    (Q) uchar   [t / GROUP][p][t % GROUP], P columns a row
 *   sums_tp    (T, P) float
 *   offset_t   (T) float
 *
 *   STRETCH    values of a work-item, a multiple of VECTOR
 *   ENCODE     1 the sRGB curve, 0 none
 *   GROUP      rows of a group; T is a multiple of it
 */
#define DECODE 0
#define FINITE 1
#include "codec/bend.clh"

#ifndef STRETCH
#error "STRETCH must be defined"
#endif
#ifndef ENCODE
#error "ENCODE must be defined: 0 or 1"
#endif
#ifndef GROUP
#error "GROUP must be defined"
#endif

INLINE vecf shown(const vecf v, const float low, const float high)
{
    const vecf above = v > low ? v : low, x = above < high ? above : high;
#if ENCODE
    const vecf safe = x > 0.0031308f ? x : 0.0031308f;
    return x <= 0.0031308f ? x * 12.92f : 1.055f * power_of(safe) - 0.055f;
#else
    return x;
#endif
}

__kernel void show_values_p(__global float *restrict values_p, const float low, const float high, const ulong size_p)
{
    const size_t start = get_global_id(0) * (size_t)STRETCH;
    const size_t stop = LESSER(start + STRETCH, (size_t)size_p);
    size_t p = start;
    for (; p + VECTOR <= stop; p += VECTOR) {
        __global vecf_at *at = (__global vecf_at *)(values_p + p);
        *at = shown(*at, low, high);
    }
    for (; p < stop; p++) {
        const vecf one = shown((vecf)(values_p[p]), low, high);
        values_p[p] = one.s0;
    }
}

__kernel void code_values_q(__global uchar *restrict codes_q, __global const float *restrict sums_tp,
                            __global const float *restrict offset_t, const int size_t, const int size_p)
{
    const int group = get_global_id(1), start = (int)get_global_id(0) * STRETCH;
    const int stop = LESSER(start + STRETCH, size_p);
    __global uchar *codes = codes_q + (long)group * size_p * GROUP;
    for (int r = 0; r < GROUP; r++) {
        const float offset = offset_t[group * GROUP + r] + 0.5f;
        __global const float *sums = sums_tp + (long)(group * GROUP + r) * size_p;
        for (int p = start; p < stop; p++) {
            const float code = sums[p] + offset;
            codes[p * GROUP + r] = (uchar)(code > 0.0f ? code < 255.5f ? (int)code : 255 : 0);
        }
    }
}
