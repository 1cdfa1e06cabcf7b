/* Coefficients of a part of an image, of planes in which they are sums: what matmul.cl makes of a plane of ones more,
 * pixel by pixel with the channels side by side, for CPUs.
 *
 *   coeffs_khwc   (K, H, W, C) float   coeffs[k][row + y][column + x][c] = operator[k C + c][J]
 *                                          + sum_j operator[k C + c][j] planes[j][top + y][left + x]
 *   planes_jyx    (J, Y, X) float
 *   packed_o      operator (K C, J + 1) in blocks of rows, for each block J + 1 runs of its rows' values
 *   heights_b     (B) int              rows of each block, 1 to 8; of a multiple of 3 where there are 3 channels
 *
 * Global size (ceil((width + 15) / TILE), rows): a work-item makes TILE pixels of a row or fewer, of planes that it
 * copies to a local tile. Planes are read once and coefficients written once: these are 5 to 20 times as many bytes,
 * and what would go through memory between a product and its interleaving costs as much as the product. What passes
 * float32 becomes its largest number; there are no infinities, and no NaN. Error as of matmul.cl.
 */
#define SAMPLE_T float
#define SAMPLE_HALF 0
#define CURVE 0
#define REAL_BITS 32
#include "common/load_tile.clh"
#include "common/row_blocks.clh"

#define AHEAD 8 /* planes between a fetch and its use */
#define BOUNDED(type, x) WITHIN(x, (type)(-MAXFLOAT), (type)(MAXFLOAT))

#if VECTOR == 16 && HAS_BUILTIN(__builtin_shufflevector)
#define GROUP 16
typedef float16 group_t;
typedef float16_at group_at;
#else
#define GROUP 8
typedef float8 group_t;
typedef float8_at group_at;
#endif

/* What is written and not read passes by the caches, which would read its memory first: a fifth of the time
 * where a vector is a line of them, nothing where it is half of one. */
#if GROUP == 16 && defined(__SSE2__) && HAS_BUILTIN(__builtin_nontemporal_store) && HAS_BUILTIN(__builtin_ia32_sfence)
#define BEYOND(to) (int)(((size_t)(to) / sizeof(float)) % GROUP)
#define STREAM(pointer, value) __builtin_nontemporal_store(value, (__global group_t *)(pointer))
#define END_STREAMS __builtin_ia32_sfence();
#else
#define BEYOND(to) 0
#define STREAM(pointer, value) (*(__global group_at *)(pointer) = (value))
#define END_STREAMS
#endif

/* The first of pixels of three values that begins at a boundary: 3 x 5 = -1 mod 16. */
#define FIRST_OF_3(to) (5 * BEYOND(to) % GROUP)

INLINE group_t bounded_group(__local const float *from)
{
    const group_t value = *(__local const group_at *)from;
    return BOUNDED(group_t, value);
}

/* to[3 x + c] = from[c][x], x of a group, by PUT. */
#if GROUP == 16
#define MIXED(a, b, ...) __builtin_shufflevector(a, b, __VA_ARGS__)
#define GROUP_OF_3(PUT, to, from)                                                                                     \
    {                                                                                                                 \
        const group_t r = bounded_group(from), g = bounded_group((from) + TILE), b = bounded_group((from) + 2 * TILE); \
        const group_t p = MIXED(r, g, 0, 16, 0, 1, 17, 0, 2, 18, 0, 3, 19, 0, 4, 20, 0, 5);                           \
        const group_t q = MIXED(r, g, 21, 0, 6, 22, 0, 7, 23, 0, 8, 24, 0, 9, 25, 0, 10, 26);                         \
        const group_t s = MIXED(r, g, 0, 11, 27, 0, 12, 28, 0, 13, 29, 0, 14, 30, 0, 15, 31, 0);                      \
        PUT(to, MIXED(p, b, 0, 1, 16, 3, 4, 17, 6, 7, 18, 9, 10, 19, 12, 13, 20, 15));                                \
        PUT(to + 16, MIXED(q, b, 0, 21, 2, 3, 22, 5, 6, 23, 8, 9, 24, 11, 12, 25, 14, 15));                           \
        PUT(to + 32, MIXED(s, b, 26, 1, 2, 27, 4, 5, 28, 7, 8, 29, 10, 11, 30, 13, 14, 31));                          \
    }
#else
#define GROUP_OF_3(PUT, to, from)                                                                                     \
    {                                                                                                                 \
        const group_t r = bounded_group(from), g = bounded_group((from) + TILE), b = bounded_group((from) + 2 * TILE); \
        PUT(to, ((group_t)(r.s0, g.s0, b.s0, r.s1, g.s1, b.s1, r.s2, g.s2)));                                         \
        PUT(to + 8, ((group_t)(b.s2, r.s3, g.s3, b.s3, r.s4, g.s4, b.s4, r.s5)));                                     \
        PUT(to + 16, ((group_t)(g.s5, b.s5, r.s6, g.s6, b.s6, r.s7, g.s7, b.s7)));                                    \
    }
#endif

/* to[channels x + c] = from[c][x], x from first to end. */
INLINE void put_each(__global float *to, __local const float *from, const int first, const int end, const int channels)
{
    for (int x = first; x < end; ++x)
        for (int c = 0; c < channels; ++c)
            to[(size_t)x * channels + c] = BOUNDED(float, from[c * TILE + x]);
}

/* The same of three channels or one, in groups, which are streamed from where they begin at a line of the caches. */
INLINE void stream_row(__global float *to, __local const float *from, const int count, const int channels)
{
    const int first = LESSER(channels == 3 ? FIRST_OF_3(to) : (GROUP - BEYOND(to)) % GROUP, count);
    int x = first;
    put_each(to, from, 0, first, channels);
    if (channels == 3)
        for (; x + GROUP <= count; x += GROUP)
            GROUP_OF_3(STREAM, to + 3 * x, from + x)
    else
        for (; x + GROUP <= count; x += GROUP)
            STREAM(to + x, bounded_group(from + x));
    put_each(to, from, x, count, channels);
}

/* to[channels x] = from[x] */
INLINE void put_channel(__global float *to, __local const float *from, const int count, const int channels)
{
    for (int x = 0; x < count; ++x)
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
    const int y = get_global_id(1);
    /* A tile's group begins where a line does, in all maps whose values are a multiple of a line. */
    __global const float *begins = coeffs_khwc + ((size_t)(row + y) * size_w + column) * size_c;
    const int lead = size_c == 3 ? (GROUP - FIRST_OF_3(begins)) % GROUP : 0;
    const int begin = get_global_id(0) * TILE - lead, first = begin < 0 ? 0 : begin;
    const int count = LESSER(begin + TILE, width) - first;
    if (count <= 0)
        return;
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
        const int together = size_c == 3 ? 3 : 1; /* rows of `made` that are channels of one coefficient */
        for (int r = 0; r < height; r += together) {
            __global float *at = to + (size_t)((m + r) / size_c) * map;
            if (size_c == together)
                stream_row(at, made + r * TILE, count, together);
            else
                put_channel(at + (m + r) % size_c, made + r * TILE, count, size_c);
        }
        operator += (size_t)height * (size_j + 1);
        m += height;
    }
    END_STREAMS
}
