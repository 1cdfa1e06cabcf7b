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

typedef vecf __attribute__((aligned(4))) vecf_at;

#define FOURS (VECTOR / 4)

typedef union {
    vecf all;
    float4 four[FOURS];
    float each[VECTOR];
} lanes_of;

/* Four texels from w on of a row, of which each channel has its lanes. */
INLINE void store_four(__global float *row, const int w, const float4 r, const float4 g, const float4 b)
{
#if CHANNELS == 3
    __global float *out = row + 3 * w;
    AT(__global, float4, out) = (float4)(r.s0, g.s0, b.s0, r.s1);
    AT(__global, float4, out + 4) = (float4)(g.s1, b.s1, r.s2, g.s2);
    AT(__global, float4, out + 8) = (float4)(b.s2, r.s3, g.s3, b.s3);
#else
    AT(__global, float4, row + w) = r;
#endif
}

/* Texels first .. first + count, or, where step is -1, back from first. */
INLINE void store_lanes(__global float *row, const int first, const int step, const int count, const lanes_of *lanes)
{
    const int last = CHANNELS - 1, middle = last / 2;
    int i = 0;
    for (int f = 0; f < FOURS; f++)
        if (4 * f + 4 <= count) {
            const float4 r = lanes[0].four[f], g = lanes[middle].four[f], b = lanes[last].four[f];
            if (step > 0)
                store_four(row, first + 4 * f, r, g, b);
            else
                store_four(row, first - 4 * f - 3, r.s3210, g.s3210, b.s3210);
            i = 4 * f + 4;
        }
    for (; i < count; i++)
        for (int c = 0; c < CHANNELS; c++) row[(first + step * i) * CHANNELS + c] = lanes[c].each[i];
}

__kernel void expand_orders_khwc(__global float *restrict maps_khwc, __global const float *restrict sums_hkmy,
                                 __global const float *restrict waves_mjx, const int size_k, const int size_h,
                                 const int size_w, const int size_m, const int size_x)
{
    const int h = get_global_id(0), k = get_global_id(1);
    __global const float *sums = sums_hkmy + ((long)h * size_k + k) * size_m * (2 * CHANNELS);
    __global float *row = maps_khwc + ((long)k * size_h + h) * size_w * CHANNELS;
    const int columns = size_w / FOLD;

    for (int first = 0; first < columns; first += VECTOR) {
        vecf cosines[2 * CHANNELS], sines[2 * CHANNELS]; /* of even m, then of odd */
        for (int i = 0; i < 2 * CHANNELS; i++) cosines[i] = sines[i] = 0.0f;
        __global const float *wave = waves_mjx + first, *sum = sums;
        int m = 0;
        for (; m + 1 < size_m; m += 2, wave += 4L * size_x, sum += 4 * CHANNELS) {
            const vecf even_cosine = AT(__global const, vecf, wave), even_sine = AT(__global const, vecf, wave + size_x);
            const vecf odd_cosine = AT(__global const, vecf, wave + 2 * size_x);
            const vecf odd_sine = AT(__global const, vecf, wave + 3 * size_x);
            for (int c = 0; c < CHANNELS; c++) {
                cosines[c] += sum[2 * c] * even_cosine;
                sines[c] += sum[2 * c + 1] * even_sine;
                cosines[CHANNELS + c] += sum[2 * CHANNELS + 2 * c] * odd_cosine;
                sines[CHANNELS + c] += sum[2 * CHANNELS + 2 * c + 1] * odd_sine;
            }
        }
        if (m < size_m) {
            const vecf cosine = AT(__global const, vecf, wave), sine = AT(__global const, vecf, wave + size_x);
            for (int c = 0; c < CHANNELS; c++) {
                cosines[c] += sum[2 * c] * cosine;
                sines[c] += sum[2 * c + 1] * sine;
            }
        }
        const int count = LESSER(VECTOR, columns - first);
        lanes_of here[CHANNELS], across[CHANNELS], mirrored[CHANNELS], opposite[CHANNELS];
        for (int c = 0; c < CHANNELS; c++) {
            const vecf same = cosines[c] + sines[CHANNELS + c], other = cosines[CHANNELS + c] + sines[c];
            const vecf like = cosines[c] - sines[CHANNELS + c], unlike = cosines[CHANNELS + c] - sines[c];
            here[c].all = same + other;
            mirrored[c].all = same - other;
            across[c].all = like + unlike;
            opposite[c].all = like - unlike;
        }
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
