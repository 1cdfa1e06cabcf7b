/* Whether values are finite: bits of a magnitude below those of infinity.
 *
 *   refused_j   (j) 1 where the stretch of work-item j, STRETCH values from STRETCH j on, holds an infinity or a NaN
 *   values_p    (p) float32
 */
#include "common/lanes.clh"

#ifndef STRETCH
#error "STRETCH must be defined: values of a work-item, a multiple of 32"
#endif

#define MAGNITUDE 0x7FFFFFFFu
#define INFINITE 0x7F800000u

kernel void find_infinite_j(global uchar *restrict refused_j, global const float *restrict values_p,
                            const ulong size_p)
{
    const size_t start = get_global_id(0) * (size_t)STRETCH;
    const size_t stop = LESSER(start + STRETCH, (size_t)size_p);
    global const uint *bits = (global const uint *)values_p;
    uint8 a = 0, b = 0, c = 0, d = 0;
    size_t p = start;
    for (; p + 32 <= stop; p += 32) {
        const uint8 w = AT(global const, uint8, bits + p) & MAGNITUDE;
        const uint8 x = AT(global const, uint8, bits + p + 8) & MAGNITUDE;
        const uint8 y = AT(global const, uint8, bits + p + 16) & MAGNITUDE;
        const uint8 z = AT(global const, uint8, bits + p + 24) & MAGNITUDE;
        a = GREATER(w, a);
        b = GREATER(x, b);
        c = GREATER(y, c);
        d = GREATER(z, d);
    }
    a = GREATER(a, b);
    c = GREATER(c, d);
    a = GREATER(a, c);
    int refused = any_lane(a >= INFINITE);
    for (; p < stop; p++) refused |= (bits[p] & MAGNITUDE) >= INFINITE;
    refused_j[get_global_id(0)] = (uchar)(refused != 0);
}
