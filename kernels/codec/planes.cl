/* Planes of what a map's coefficients hang on linearly: of samples, behind the sRGB curve or not. Nothing between the two
 * leaves the cache.
 *
 *   plane_jyx    (J, Y, X) float       plane[j][row + h][w] = sum_cn last[j][c n] v[n][h][w][c] - offset[j]
 *   source_ihwc  (I, H, W, C) SAMPLE_T code values; with a CURVE turned to linear radiance on the way
 *   first_o      (N, I) in row blocks  v = bent(first radiance)
 *   heights_b    (n_block) int         their rows, 1 to 8
 *   last_e       (J, C N) in row blocks
 *   heights_d    (n_block) int
 *   curve_v, offset_j, scale
 *
 *   BEND    1 where v are code values of radiance, 0 where they are sums as they are
 *   TILE    pixels of a row that a work-item makes; CHUNK, DEPTH see row_blocks.clh
 *   ROOM    C N at most
 *
 * Global size: (tiles of a row, H).
 */
#define DECODE 0
#define FINITE 1
#include "common/source_tile.clh"
#include "codec/bend.clh"
#include "codec/plane_rows.clh"

#if !defined(BEND) || !defined(ROOM)
#error "BEND and ROOM must be defined"
#endif

/* tile[i][x] = one channel of count pixels of light i0 + i, else 0. */
INLINE void load_channel(__local float *tile, __global const SAMPLE_T *source, const int rows, const long size_p,
                         const int size_c, const int count, __global const float *curve_v, const float scale)
{
    for (int i = 0; i < rows; i++) {
        __global const SAMPLE_T *row = source + i * size_p;
        __local float *to = tile + i * TILE;
        if (size_c == 3)
            for (int x = 0; x < count; x++) to[x] = load_sample(row, 3 * x, curve_v, scale);
        else
            for (int x = 0; x < count; x++) to[x] = load_sample(row, size_c * x, curve_v, scale);
        for (int x = count; x < TILE; x++) to[x] = 0.0f;
    }
}

__kernel void make_planes_jyx(__global float *restrict plane_jyx, __global const SAMPLE_T *restrict source_ihwc,
                              __global const float *restrict first_o, __global const int *restrict heights_b,
                              __global const float *restrict last_e, __global const int *restrict heights_d,
                              __global const float *restrict curve_v, __global const float *restrict offset_j,
                              const float scale, const int row, const int count_n, const int size_j, const int size_y,
                              const int size_x, const int size_i, const int size_h, const int size_w,
                              const int size_c, const int size_b, const int size_d)
{
    __local vecf tile[CHUNK * TILE_VECTORS];
    __local vecf values[ROOM * TILE_VECTORS];
    __local vecf sums[8 * TILE_VECTORS];
    const int x = get_global_id(0) * TILE, y = get_global_id(1);
    const int count = LESSER(TILE, size_w - x);
    const long size_p = (long)size_h * size_w * size_c;
    __global const SAMPLE_T *source = source_ihwc + ((long)y * size_w + x) * size_c;
    for (int c = 0; c < size_c; c++) {
        __local vecf *of_channel = values + c * count_n * TILE_VECTORS;
        for (int i0 = 0; i0 < size_i; i0 += CHUNK) {
            const int rows = LESSER(CHUNK, size_i - i0);
            load_channel((__local float *)tile, source + i0 * size_p + c, rows, size_p, size_c, count, curve_v, scale);
            __global const float *operator = first_o;
            int n = 0;
            for (int b = 0; b < size_b; b++) {
                const int height = heights_b[b];
                apply_block(height, tile, operator + i0 * height, rows, of_channel + n * TILE_VECTORS, i0 == 0);
                operator += height * size_i;
                n += height;
            }
        }
#if BEND
        for (int v = 0; v < count_n * TILE_VECTORS; v++) of_channel[v] = bend(of_channel[v]);
#endif
    }
    store_planes(plane_jyx + (long)(row + y) * size_x + x, (long)size_y * size_x, values, last_e, heights_d, offset_j,
                 size_c * count_n, size_d, count, sums);
}
