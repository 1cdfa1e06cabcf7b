/* Planes of a part of a map that lies in memory: channels are taken apart, multiplied and put in place within the cache.
 *
 *   plane_jyx    (J, Y, X) float       plane[j][row + h][w] = sum_kc last[j][k c] coeff[k][top + h][left + w][c] - offset[j]
 *   coeff_khwc   (K, H, W, C) float
 *   last_e       (J, K C) in row blocks
 *   heights_d    (n_block) int         their rows, 1 to 8
 *   offset_j     (J) float
 *
 *   TILE    pixels of a row that a work-item makes; DEPTH see row_blocks.clh, where CHUNK bounds nothing here
 *   ROOM    K C at most
 *
 * Global size: (tiles of `width` pixels, rows). |error| <= eps (DEPTH + K C / DEPTH + 1) sum |terms|.
 */
#include "codec/plane_rows.clh"

#ifndef ROOM
#error "ROOM must be defined: values of a pixel, at most"
#endif

#define AHEAD 4 /* maps between a fetch and its use: each lies in pages of its own, where hardware does not look ahead */

/* Channels of count pixels of a map: to[c][x], 0 beyond. */
INLINE void split_channels(__local float *to, __global const float *from, const int size_c, const int count)
{
    int x = 0;
    if (size_c == 3)
        for (; x + 8 <= count; x += 8) {
            const float8 a = AT(__global const, float8, from + 3 * x), b = AT(__global const, float8, from + 3 * x + 8),
                         c = AT(__global const, float8, from + 3 * x + 16);
            AT(__local, float8, to + x) = (float8)(a.s036, b.s147, c.s25);
            AT(__local, float8, to + TILE + x) = (float8)(a.s147, b.s25, c.s036);
            AT(__local, float8, to + 2 * TILE + x) = (float8)(a.s25, b.s036, c.s147);
        }
    for (; x < TILE; x++)
        for (int c = 0; c < size_c; c++) to[c * TILE + x] = x < count ? from[(long)x * size_c + c] : 0.0f;
}

__kernel void planes_of_map_jyx(__global float *restrict plane_jyx, __global const float *restrict coeff_khwc,
                                __global const float *restrict last_e, __global const int *restrict heights_d,
                                __global const float *restrict offset_j, const int row, const int top, const int left,
                                const int width, const int size_j, const int size_y, const int size_x,
                                const int size_k, const int size_h, const int size_w, const int size_c,
                                const int size_d)
{
    __local vecf values[ROOM * TILE_VECTORS];
    __local vecf sums[8 * TILE_VECTORS];
    const int x = get_global_id(0) * TILE, y = get_global_id(1), count = LESSER(TILE, width - x);
    const long size_p = (long)size_h * size_w * size_c;
    __global const float *from = coeff_khwc + ((long)(top + y) * size_w + left + x) * size_c;
    for (int k = 0; k < size_k; k++) {
        if (k + AHEAD < size_k)
            for (int at = 0; at < count * size_c; at += 16) PREFETCH(from + (k + AHEAD) * size_p + at);
        split_channels((__local float *)values + k * size_c * TILE, from + k * size_p, size_c, count);
    }
    store_planes(plane_jyx + (long)(row + y) * size_x + x, (long)size_y * size_x, values, last_e, heights_d, offset_j,
                 size_k * size_c, size_d, count, sums);
}
