/* IEEE 754 binary16, rounded to nearest even.
 *
 *   halves_p = binary16(coeffs_p), |error| <= max(2^-11 |coeffs_p|, 2^-25)
 *
 *   coeffs_p   (p,) float32, unit of the coefficients
 *   halves_p   (p,) binary16
 *   refused_j  (j,) 1 where the stretch of work-item j holds a value that is refused: to encode, one that
 *              rounds to infinity (|x| >= 65520); to decode, an infinity or a NaN
 *
 * Work-item j converts the stretch of 8 VECTORS values from 8 VECTORS j on. With CLAMP, values beyond 65504
 * become +-65504 (and are flagged still).
 */
#include "common/lanes.clh"

#include "codec/half_range.clh"

#ifndef VECTORS
#error "VECTORS must be defined: how many vectors of eight values a work-item converts"
#endif
#ifndef CLAMP
#error "CLAMP must be defined: 1 to clamp what overflows, else 0"
#endif

kernel void encode_half_p(global half *restrict halves_p, global uchar *restrict refused_j,
                          global const float *restrict coeffs_p, const ulong size_p)
{
    const size_t start = get_global_id(0) * (8 * VECTORS);
    if (start >= size_p)
        return;
    const size_t stop = LESSER(start + 8 * VECTORS, (size_t)size_p);
    int8 over = (int8)(0);
    size_t p = start;
    for (; p + 8 <= stop; p += 8) {
        float8 x = AT(global const, float8, coeffs_p + p);
        over |= (x >= OVERFLOW) | (x <= -OVERFLOW);
#if CLAMP
        x = WITHIN(x, -LARGEST, LARGEST);
#endif
        STORE_HALF8(global, x, halves_p + p);
    }
    int refused = any_lane(over);
    for (; p < stop; p++) {
        float x = coeffs_p[p];
        refused |= x >= OVERFLOW || x <= -OVERFLOW;
#if CLAMP
        x = WITHIN(x, -LARGEST, LARGEST);
#endif
        vstore_half_rte(x, p, halves_p);
    }
    refused_j[get_global_id(0)] = (uchar)(refused != 0);
}

kernel void decode_half_p(global float *restrict coeffs_p, global uchar *restrict refused_j,
                          global const half *restrict halves_p, const ulong size_p)
{
    const size_t start = get_global_id(0) * (8 * VECTORS);
    if (start >= size_p)
        return;
    const size_t stop = LESSER(start + 8 * VECTORS, (size_t)size_p);
    ushort8 largest = 0; /* magnitudes as bits: comparing the floats themselves takes five times as long */
    size_t p = start;
    for (; p + 8 <= stop; p += 8) {
        const ushort8 size = AT(global const, ushort8, halves_p + p) & (ushort)0x7FFF;
        largest = GREATER(size, largest);
        AT(global, float8, coeffs_p + p) = LOAD_HALF8(global const, halves_p + p);
    }
    int refused = 0;
    for (int lane = 0; lane < 8; lane++)
        refused |= ((const ushort *)&largest)[lane] >= 0x7C00;
    for (; p < stop; p++) {
        const float x = vload_half(p, halves_p);
        refused |= !(x >= -LARGEST && x <= LARGEST);
        coeffs_p[p] = x;
    }
    refused_j[get_global_id(0)] = (uchar)(refused != 0);
}
