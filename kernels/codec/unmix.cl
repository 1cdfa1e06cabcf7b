/* Coefficients of a part of an image, of planes in which they are sums: what matmul.cl makes of a plane of ones more,
 * pixel by pixel with the channels side by side, for CPUs.
 *
 *   coeffs_khwc   (K, H, W, C) float   coeffs[k][row + y][column + x][c] = operator[k C + c][J]
 *                                          + sum_j operator[k C + c][j] planes[j][top + y][left + x]
 *   planes_jyx    (J, Y, X) float
 *   packed_o      operator (K C, J + 1) in blocks of rows, for each block J + 1 runs of its rows' values
 *   heights_b     (B) int              rows of each block, 1 to 8; of a multiple of 3 where there are 3 channels
 *
 * Global size (ceil(width / TILE), rows): a work-item makes TILE pixels of a row, of planes that it copies to a local
 * tile. Planes are read once and coefficients written once: these are 5 to 20 times as many bytes, and what would go
 * through memory between a product and its interleaving costs as much as the product. What passes float32 becomes its
 * largest number; there are no infinities, and no NaN. Error as of matmul.cl.
 */
#define SAMPLE_T float
#define SAMPLE_HALF 0
#define CURVE 0
#define REAL_BITS 32
#include "common/load_tile.clh"
#include "common/row_blocks.clh"

#define AHEAD 8 /* planes between a fetch and its use */
#define BOUNDED(type, x) WITHIN(x, (type)(-MAXFLOAT), (type)(MAXFLOAT))

/* to[3 x + c] = from[c][x] */
INLINE void interleave_3(__global float *to, __local const float *from, const int count)
{
    int x = 0;
    for (; x + 8 <= count; x += 8, to += 24) {
        const float8 r = AT(__local const, float8, from + x), g = AT(__local const, float8, from + TILE + x);
        const float8 b = AT(__local const, float8, from + 2 * TILE + x);
        const float8 a = BOUNDED(float8, r), d = BOUNDED(float8, g), e = BOUNDED(float8, b);
        AT(__global, float8, to) = (float8)(a.s0, d.s0, e.s0, a.s1, d.s1, e.s1, a.s2, d.s2);
        AT(__global, float8, to + 8) = (float8)(e.s2, a.s3, d.s3, e.s3, a.s4, d.s4, e.s4, a.s5);
        AT(__global, float8, to + 16) = (float8)(d.s5, e.s5, a.s6, d.s6, e.s6, a.s7, d.s7, e.s7);
    }
    for (; x < count; ++x, to += 3)
        for (int c = 0; c < 3; ++c)
            to[c] = BOUNDED(float, from[c * TILE + x]);
}

INLINE void put_channel(__global float *to, __local const float *from, const int count, const int channels)
{
    int x = 0;
    if (channels == 1)
        for (; x + 8 <= count; x += 8) {
            const float8 value = AT(__local const, float8, from + x);
            AT(__global, float8, to + x) = BOUNDED(float8, value);
        }
    for (; x < count; ++x)
        to[(size_t)x * channels] = BOUNDED(float, from[x]);
}

/* Rows i0 to i0 + rows of the planes, and of ones behind them. */
INLINE void load_planes(__local vecr *tile, __global const float *planes, const size_t plane, const int i0,
                        const int rows, const int size_j, const int count)
{
    for (int i = 0; i < rows; ++i) {
        __local float *to = (__local float *)(tile + i * TILE_VECTORS);
        if (i0 + i == size_j) {
            for (int x = 0; x < TILE; ++x)
                to[x] = 1.0f;
            continue;
        }
        __global const float *from = planes + (i0 + i) * plane;
        if (i0 + i + AHEAD < size_j && count == TILE)
            PREFETCH_ROW(from + AHEAD * plane, TILE * (int)sizeof(float));
        load_row(to, from, count, 0, 1.0f);
    }
}

__kernel void unmix_planes(__global float *restrict coeffs_khwc, __global const float *restrict planes_jyx,
                           __global const float *restrict packed_o, __global const int *restrict heights_b,
                           const int row, const int column, const int top, const int left, const int width,
                           const int size_k, const int size_h, const int size_w, const int size_c, const int size_b,
                           const int size_j, const int size_y, const int size_x)
{
    __local vecr tile[CHUNK * TILE_VECTORS];
    __local vecr sums[8 * TILE_VECTORS];
    const int first = get_global_id(0) * TILE, y = get_global_id(1), count = LESSER(TILE, width - first);
    const size_t plane = (size_t)size_y * size_x, map = (size_t)size_h * size_w * size_c;
    __global const float *planes = planes_jyx + (size_t)(top + y) * size_x + left + first;
    __global float *to = coeffs_khwc + ((size_t)(row + y) * size_w + column + first) * size_c;
    __global const float *operator = packed_o;
    int m = 0;
    for (int b = 0; b < size_b; ++b) {
        const int height = heights_b[b];
        for (int i0 = 0; i0 <= size_j; i0 += CHUNK) {
            const int rows = LESSER(CHUNK, size_j + 1 - i0);
            if (b == 0 || size_j >= CHUNK)
                load_planes(tile, planes, plane, i0, rows, size_j, count);
            apply_block(height, tile, operator + i0 * height, rows, sums, i0 == 0);
        }
        __local const float *made = (__local const float *)sums;
        if (size_c == 3)
            for (int r = 0; r < height; r += 3)
                interleave_3(to + (size_t)((m + r) / 3) * map, made + r * TILE, count);
        else
            for (int r = 0; r < height; ++r) {
                const int k = (m + r) / size_c, c = (m + r) % size_c;
                put_channel(to + (size_t)k * map + c, made + r * TILE, count, size_c);
            }
        operator += (size_t)height * (size_j + 1);
        m += height;
    }
}
