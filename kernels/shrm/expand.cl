/* Maps from sums over orders, map = Re sum_m A_m e^(i m beta) (frequency-space-environment-maps, eq. 14, last sum).
 *
 *   maps_khwc     (K, H, W, C) float       out: one map for each coefficient k of the view
 *   sums_hkmy     (H, K, M, 2 C) float     A_m: real and imaginary part of each channel
 *   waves_mjx     (M, 2, X) float          cos(m beta), -sin(m beta) at the first W / FOLD columns; X of whole vectors
 *
 * Columns have beta = 3/2 pi - 2 pi (w + 1/2) / W. At w, W - 1 - w, W / 2 - 1 - w and W / 2 + w the waves differ by signs
 * alone: sums over even and over odd m, of cosines and of sines, serve all four where W is a multiple of 4 (FOLD 4),
 * and the first two where it is of 2 (FOLD 2). A work-item takes the row h of the map k.
 * |error| <= eps32 (M + 4) sum |A_m|
 */
#include "common/lanes.clh"
#include "common/vector.clh"

#if !defined(CHANNELS) || !defined(FOLD)
#error "CHANNELS (1 or 3) and FOLD (1, 2 or 4) must be defined"
#endif

#if VECTOR >= 8
#define GROUP 8
typedef float8 group;
#define BACK(v) (v).s76543210
#else
#define GROUP 4
typedef float4 group;
#define BACK(v) (v).s3210
#endif
#define GROUPS (VECTOR / GROUP)

typedef union {
    vecf all;
    group part[GROUPS];
    float each[VECTOR];
} lanes_of;

/* A group of texels from w on of a row, of which each channel has its lanes. */
INLINE void store_group(__global float *row, const int w, const group r, const group g, const group b)
{
    __global float *out = row + CHANNELS * w;
#if CHANNELS == 1
#if GROUP == 8
    AT(__global, float8, out) = r;
#else
    AT(__global, float4, out) = r;
#endif
#elif GROUP == 8
    AT(__global, float8, out) = (float8)(r.s0, g.s0, b.s0, r.s1, g.s1, b.s1, r.s2, g.s2);
    AT(__global, float8, out + 8) = (float8)(b.s2, r.s3, g.s3, b.s3, r.s4, g.s4, b.s4, r.s5);
    AT(__global, float8, out + 16) = (float8)(g.s5, b.s5, r.s6, g.s6, b.s6, r.s7, g.s7, b.s7);
#else
    AT(__global, float4, out) = (float4)(r.s0, g.s0, b.s0, r.s1);
    AT(__global, float4, out + 4) = (float4)(g.s1, b.s1, r.s2, g.s2);
    AT(__global, float4, out + 8) = (float4)(b.s2, r.s3, g.s3, b.s3);
#endif
}

/* Texels first .. first + count, or, where step is -1, back from first. */
INLINE void store_lanes(__global float *row, const int first, const int step, const int count, const lanes_of *lanes)
{
    const int last = CHANNELS - 1, middle = last / 2;
    int i = 0;
    for (int f = 0; f < GROUPS; f++)
        if (GROUP * (f + 1) <= count) {
            const group r = lanes[0].part[f], g = lanes[middle].part[f], b = lanes[last].part[f];
            if (step > 0)
                store_group(row, first + GROUP * f, r, g, b);
            else
                store_group(row, first - GROUP * (f + 1) + 1, BACK(r), BACK(g), BACK(b));
            i = GROUP * (f + 1);
        }
    for (; i < count; i++)
        for (int c = 0; c < CHANNELS; c++) row[(first + step * i) * CHANNELS + c] = lanes[c].each[i];
}

/* Written out by name because arrays of vectors are not kept in registers. */
#if CHANNELS == 3
#define EACH_CHANNEL(DO) DO(0) DO(1) DO(2)
#else
#define EACH_CHANNEL(DO) DO(0)
#endif
#define DECLARE_SUMS(c) vecf even_cosine_##c = 0.0f, even_sine_##c = 0.0f, odd_cosine_##c = 0.0f, odd_sine_##c = 0.0f;
#define ADD_EVEN(c)                      \
    even_cosine_##c += sum[2 * c] * cosine; \
    even_sine_##c += sum[2 * c + 1] * sine;
#define ADD_ODD(c)                                         \
    odd_cosine_##c += sum[2 * CHANNELS + 2 * c] * odd_cosine; \
    odd_sine_##c += sum[2 * CHANNELS + 2 * c + 1] * odd_sine;
#define UNFOLD(c)                                                                              \
    here[c].all = (even_cosine_##c + odd_sine_##c) + (odd_cosine_##c + even_sine_##c);            \
    mirrored[c].all = (even_cosine_##c + odd_sine_##c) - (odd_cosine_##c + even_sine_##c);        \
    across[c].all = (even_cosine_##c - odd_sine_##c) + (odd_cosine_##c - even_sine_##c);          \
    opposite[c].all = (even_cosine_##c - odd_sine_##c) - (odd_cosine_##c - even_sine_##c);

__kernel void expand_orders_khwc(__global float *restrict maps_khwc, __global const float *restrict sums_hkmy,
                                 __global const float *restrict waves_mjx, const int size_k, const int size_h,
                                 const int size_w, const int size_m, const int size_x)
{
    const int h = get_global_id(0), k = get_global_id(1);
    __global const float *sums = sums_hkmy + ((long)h * size_k + k) * size_m * (2 * CHANNELS);
    __global float *row = maps_khwc + ((long)k * size_h + h) * size_w * CHANNELS;
    const int columns = size_w / FOLD;

    for (int first = 0; first < columns; first += VECTOR) {
        __global const float *wave = waves_mjx + first, *sum = sums;
        EACH_CHANNEL(DECLARE_SUMS)
        int m = 0;
        for (; m + 1 < size_m; m += 2, wave += 4L * size_x, sum += 4 * CHANNELS) {
            const vecf cosine = AT(__global const, vecf, wave), sine = AT(__global const, vecf, wave + size_x);
            EACH_CHANNEL(ADD_EVEN)
            const vecf odd_cosine = AT(__global const, vecf, wave + 2 * size_x);
            const vecf odd_sine = AT(__global const, vecf, wave + 3 * size_x);
            EACH_CHANNEL(ADD_ODD)
        }
        if (m < size_m) {
            const vecf cosine = AT(__global const, vecf, wave), sine = AT(__global const, vecf, wave + size_x);
            EACH_CHANNEL(ADD_EVEN)
        }
        const int count = LESSER(VECTOR, columns - first);
        lanes_of here[CHANNELS], across[CHANNELS], mirrored[CHANNELS], opposite[CHANNELS];
        EACH_CHANNEL(UNFOLD)
        store_lanes(row, first, 1, count, here);
#if FOLD >= 2
        store_lanes(row, size_w - 1 - first, -1, count, mirrored);
#endif
#if FOLD == 4
        store_lanes(row, size_w / 2 - 1 - first, -1, count, across);
        store_lanes(row, size_w / 2 + first, 1, count, opposite);
#endif
    }
}
