/* The sRGB curve of values of any size, in place; below 0 that of their magnitudes.
 *
 *   values_p   (P) float   becomes sign(v) curve(|v|)
 *
 *   DECODE     0 radiance to code values, 1 code values to radiance
 *   STRETCH    values of a work-item, a multiple of VECTOR
 *
 * A power is 2^(p log2 v): of v = 2^e m, m in [0.7, 1.42], the logarithm is the series of atanh up to s^9, s = (m - 1) / (m + 1),
 * which leaves 1e-9, and 2^f, |f| < 0.51, that of exp up to f^7, which leaves 6e-9. The integer part of p e is taken off
 * before anything is rounded. Error of float below 5e-7 of the value, plus 2e-8. Too large for float is infinite; NaN stays NaN.
 */
#include "common/lanes.clh"
#include "common/vector.clh"

#if !defined(DECODE) || !defined(STRETCH)
#error "DECODE and STRETCH must be defined"
#endif

/* p = HIGH + LOW, where HIGH e is exact. */
#if DECODE
#define HIGH 2.375f
#define LOW 0.025f
#else
#define HIGH 0.40625f
#define LOW 0.010416667f
#endif
#define POWER (HIGH + LOW)
#define ROOT_HALF 0x3F3504F3 /* the bits of sqrt(1/2) */
#define ROUNDER 12582912.0f  /* 1.5 2^23: what is added to it is rounded to a whole number */

/* x^p of x > 0 */
INLINE vecf power_of(const vecf x)
{
    const veci bits = AS_VECI(x) - ROOT_HALF;
    const veci exponent = bits >> 23;
    const vecf m = AS_VECF((bits & 0x7FFFFF) + ROOT_HALF);
    const vecf s = (m - 1.0f) / (m + 1.0f), t = s * s;
    const vecf log = s * (2.88539008f + t * (0.961796694f + t * (0.577078016f + t * (0.412198583f + t * 0.320598898f))));
    const vecf e = CONVERT(exponent, vecf);
    const vecf whole_part = (HIGH * e + ROUNDER) - ROUNDER;
    const vecf rest = (HIGH * e - whole_part) + (LOW * e + POWER * log);
    const vecf more = (rest + ROUNDER) - ROUNDER;
    const vecf f = rest - more;
    vecf power = 1.52527338e-5f * f + 1.54035304e-4f;
    power = power * f + 1.33335581e-3f;
    power = power * f + 9.61812911e-3f;
    power = power * f + 5.55041087e-2f;
    power = power * f + 2.40226507e-1f;
    power = power * f + 6.93147181e-1f;
    power = power * f + 1.0f;
    veci i = CONVERT(whole_part + more, veci);
    i = i > 129 ? 129 : i;
    i = i < -125 ? -125 : i;
    return power * AS_VECF((i + 126) << 23) * 2.0f; /* of 2^129 the bits are those of infinity */
}

INLINE vecf bend(const vecf v)
{
    const vecf x = AS_VECF(AS_VECI(v) & 0x7FFFFFFF);
#if DECODE
    const vecf bent = power_of((x + 0.055f) / 1.055f);
    const vecf r = x <= 0.04045f ? x / 12.92f : bent;
#else
    const vecf bent = 1.055f * power_of(x) - 0.055f;
    const vecf r = x <= 0.0031308f ? x * 12.92f : x > FLT_MAX ? x : bent;
#endif
    const vecf kept = x == x ? r : x;
    return AS_VECF(AS_VECI(kept) | (AS_VECI(v) & (int)0x80000000));
}

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
