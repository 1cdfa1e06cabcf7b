/* Sums over the azimuths of a lat-long map, sum_w L e^(-i m beta) (frequency-space-environment-maps, 6.1).
 *
 *   sums_hmcj       (H, M, C, 2) float   out: real and imaginary part
 *   radiance_hwc    (H, W, C) float      linear radiance L
 *   waves_mjx       (M, 2, X) float      cos(m beta), -sin(m beta) at the first W / FOLD columns; X of whole vectors
 *
 * Columns have beta = 3/2 pi - 2 pi (w + 1/2) / W, so those at w, W - 1 - w, W / 2 - 1 - w and W / 2 + w have waves that
 * differ by signs alone: they are added first where W is a multiple of 4 (FOLD 4), the first two where it is of 2 (FOLD 2).
 * A work-item takes 12 lines, those of ROWS rows' channels, BLOCK of their folded columns at a time.
 * |error| <= eps32 (BLOCK / VECTOR + W / (FOLD BLOCK) + 8) sum |L|
 */
#include "common/lanes.clh"
#include "common/vector.clh"

#if !defined(BLOCK) || !defined(CHANNELS) || !defined(FOLD)
#error "BLOCK (columns, a multiple of VECTOR), CHANNELS (1 or 3) and FOLD (1, 2 or 4) must be defined"
#endif

#define LINES 12
#define ROWS (LINES / CHANNELS)
#define VECTORS (BLOCK / VECTOR)

/* Written out by name because arrays of vectors are not kept in registers. */
#define EACH_LINE(DO) DO(0) DO(1) DO(2) DO(3) DO(4) DO(5) DO(6) DO(7) DO(8) DO(9) DO(10) DO(11)
#define DECLARE_SUM(i) vecf sum_##i = 0.0f;
#define ADD_TERM(i) sum_##i += factor * from[i * VECTORS + v];
#define KEEP_SUM(i) line[i] = total_of(sum_##i);

/* Sums of columns for cosines and sines of even m, then of odd m; 0 of what FOLD leaves out. */
#define FOLDED(to, stride, a, e, b, d)          \
    (to)[0] = ((a) + (e)) + ((b) + (d));          \
    (to)[stride] = ((a) - (e)) - ((b) - (d));     \
    (to)[2 * (stride)] = ((a) - (e)) + ((b) - (d)); \
    (to)[3 * (stride)] = ((a) + (e)) - ((b) + (d));

#if CHANNELS == 3
/* Four texels from a pointer on, as one vector for each channel. */
INLINE void load_four(float4 *planes, __global const float *from, const int back)
{
    const float4 a = AT(__global const, float4, from), b = AT(__global const, float4, from + 4);
    const float4 c = AT(__global const, float4, from + 8);
    const float4 red = (float4)(a.s0, a.s3, b.s2, c.s1), green = (float4)(a.s1, b.s0, b.s3, c.s2);
    const float4 blue = (float4)(a.s2, b.s1, c.s0, c.s3);
    planes[0] = back ? red.s3210 : red;
    planes[1] = back ? green.s3210 : green;
    planes[2] = back ? blue.s3210 : blue;
}
#else
INLINE void load_four(float4 *planes, __global const float *from, const int back)
{
    const float4 a = AT(__global const, float4, from);
    planes[0] = back ? a.s3210 : a;
}
#endif

/* Fold columns first .. first + filled of a row into kinds of LINES lines; the rest of the block becomes 0. */
INLINE void fold_row(float *folded, __global const float *row, const int first, const int filled, const int size_w)
{
    const int kind = LINES * BLOCK;
    int x = 0;
    for (; x + 4 <= filled; x += 4) {
        const int w = first + x;
        float4 a[CHANNELS], e[CHANNELS], b[CHANNELS], d[CHANNELS];
        for (int c = 0; c < CHANNELS; c++) e[c] = b[c] = d[c] = 0.0f;
        load_four(a, row + w * CHANNELS, 0);
#if FOLD >= 2
        load_four(e, row + (size_w - 4 - w) * CHANNELS, 1);
#endif
#if FOLD == 4
        load_four(b, row + (size_w / 2 - 4 - w) * CHANNELS, 1);
        load_four(d, row + (size_w / 2 + w) * CHANNELS, 0);
#endif
        for (int c = 0; c < CHANNELS; c++) {
            float4_at *to = (float4_at *)(folded + c * BLOCK + x);
            FOLDED(to, kind / 4, a[c], e[c], b[c], d[c])
        }
    }
    for (; x < BLOCK; x++)
        for (int c = 0; c < CHANNELS; c++) {
            const int w = first + x;
            float a = 0.0f, e = 0.0f, b = 0.0f, d = 0.0f;
            if (x < filled) {
                a = row[w * CHANNELS + c];
#if FOLD >= 2
                e = row[(size_w - 1 - w) * CHANNELS + c];
#endif
#if FOLD == 4
                b = row[(size_w / 2 - 1 - w) * CHANNELS + c];
                d = row[(size_w / 2 + w) * CHANNELS + c];
#endif
            }
            FOLDED(folded + c * BLOCK + x, kind, a, e, b, d)
        }
}

__kernel void sum_azimuths_hmjc(__global float *restrict sums_hmcj, __global const float *restrict radiance_hwc,
                                __global const float *restrict waves_mjx, const int size_h, const int size_m,
                                const int size_w, const int size_x)
{
    const int first_row = get_global_id(0) * ROWS;
    vecf folded[4 * LINES * VECTORS];
    for (int first = 0; first < size_w / FOLD; first += BLOCK) {
        const int filled = LESSER(BLOCK, size_w / FOLD - first);
        for (int r = 0; r < ROWS; r++) /* rows beyond the last one are folded again, and not stored */
            fold_row((float *)folded + r * CHANNELS * BLOCK,
                     radiance_hwc + (long)LESSER(first_row + r, size_h - 1) * size_w * CHANNELS, first, filled, size_w);
        const int vectors = (filled + VECTOR - 1) / VECTOR;
        for (int n = 0; n < 2 * size_m; n++) {
            const vecf *from = folded + (n % 4) * (LINES * VECTORS);
            __global const float *wave = waves_mjx + (long)n * size_x + first;
            float line[LINES];
            EACH_LINE(DECLARE_SUM)
            for (int v = 0; v < vectors; v++) {
                const vecf factor = AT(__global const, vecf, wave + v * VECTOR);
                EACH_LINE(ADD_TERM)
            }
            EACH_LINE(KEEP_SUM)
            for (int r = 0; r < ROWS; r++)
                for (int c = 0; c < CHANNELS && first_row + r < size_h; c++) {
                    __global float *out = sums_hmcj + (((long)(first_row + r) * size_m + n / 2) * CHANNELS + c) * 2 + n % 2;
                    *out = first ? *out + line[r * CHANNELS + c] : line[r * CHANNELS + c];
                }
        }
    }
}
