/* Codes lie one behind the other, BITS bits each, lowest bit first; the last byte is filled up with zeros. Eight codes
 * take BITS bytes, so work-items never share a byte.
 *
 *   codes_p         (p,) below 2^BITS
 *   bytes_b         (b,) with b = ceil(p BITS / 8)
 */
#include "common/lanes.clh"

#ifndef BITS
#error "BITS must be defined: 1 to 16 bits per coefficient"
#endif
#ifndef STRETCH
#error "STRETCH must be defined: coefficients that a work-item handles, a multiple of 8"
#endif

kernel void pack_uniform_b(global uchar *restrict bytes_b, global const ushort *restrict codes_p, const ulong size_b,
                           const ulong size_p)
{
    const size_t start = get_global_id(0) * STRETCH, stop = LESSER(start + STRETCH, (size_t)size_p);
    size_t b = start / 8 * BITS;
    for (size_t p = start; p < stop; p += 8) {
        ulong queue = 0;
        uint queued = 0;
#pragma unroll
        for (int i = 0; i < 8; i++) {
            queue |= (ulong)(p + i < stop ? codes_p[p + i] : 0) << queued;
            queued += BITS;
            for (; queued >= 8; queued -= 8, queue >>= 8, b++)
                if (b < size_b)
                    bytes_b[b] = (uchar)queue;
        }
    }
}

kernel void unpack_uniform_p(global ushort *restrict codes_p, global const uchar *restrict bytes_b,
                             const ulong size_b, const ulong size_p)
{
    const size_t start = get_global_id(0) * STRETCH, stop = LESSER(start + STRETCH, (size_t)size_p);
    size_t b = start / 8 * BITS;
    for (size_t p = start; p < stop; p += 8) {
        ulong queue = 0;
        uint queued = 0;
#pragma unroll
        for (int i = 0; i < 8; i++) {
            for (; queued < BITS; queued += 8, b++)
                queue |= (ulong)(b < size_b ? bytes_b[b] : 0) << queued;
            if (p + i < stop)
                codes_p[p + i] = (ushort)(queue & ((1u << BITS) - 1));
            queue >>= BITS;
            queued -= BITS;
        }
    }
}
