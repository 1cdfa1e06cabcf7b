/* The sRGB curve of values in place; see bend.clh.
 *
 *   values_p   (P) float   becomes sign(v) curve(|v|)
 *
 *   STRETCH    values of a work-item, a multiple of VECTOR
 */
#include "codec/bend.clh"

#ifndef STRETCH
#error "STRETCH must be defined"
#endif

#if VECTOR == 16
#define LOAD(p) (vecf)(AT(global, float8, p), AT(global, float8, (p) + 8))
#define STORE(x, p) (AT(global, float8, p) = (x).lo, AT(global, float8, (p) + 8) = (x).hi)
#elif VECTOR == 8
#define LOAD(p) AT(global, float8, p)
#define STORE(x, p) (AT(global, float8, p) = (x))
#else
#define LOAD(p) AT(global, float4, p)
#define STORE(x, p) (AT(global, float4, p) = (x))
#endif

kernel void bend_values_p(global float *restrict values_p, const ulong size_p)
{
    const size_t start = get_global_id(0) * (size_t)STRETCH;
    const size_t stop = LESSER(start + STRETCH, (size_t)size_p);
    size_t p = start;
    for (; p + VECTOR <= stop; p += VECTOR) {
        const vecf bent = bend(LOAD(values_p + p));
        STORE(bent, values_p + p);
    }
    for (; p < stop; p++) {
        const vecf bent = bend((vecf)(values_p[p]));
        values_p[p] = bent.s0;
    }
}
