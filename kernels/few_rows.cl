/* out = operator x source for CPUs, up to 4 rows, as relighting has them: see matmul.cl for the arrays.
 *
 *   packed_o   operator as one block: n_in runs of ROWS values (matmul.py packs it)
 *
 *   ROWS       operator rows
 *   TILE       columns of a work-item, a multiple of 8
 *
 * Bound by the bandwidth of the source, of which each work-item reads RUN rows at a time: longer stretches than the
 * tiles of matmul.cl have, and no copy. |error| <= eps32 (RUN + n_in / RUN) sum |terms|.
 */
#include "common/types.clh"

#if !defined(ROWS) || !defined(TILE)
#error "ROWS (of the operator, 1 to 4) and TILE (columns) must be defined"
#endif

#define RUN 8

#if SAMPLE_HALF
#define LOAD8(pointer) LOAD_HALF8(__global const, pointer)
#else
#define LOAD8(pointer) AT(__global const, float8, pointer)
#endif

/* Written out by name because arrays of vectors are not kept in registers. */
#if ROWS == 1
#define EACH_ROW(DO) DO(0)
#elif ROWS == 2
#define EACH_ROW(DO) DO(0) DO(1)
#elif ROWS == 3
#define EACH_ROW(DO) DO(0) DO(1) DO(2)
#elif ROWS == 4
#define EACH_ROW(DO) DO(0) DO(1) DO(2) DO(3)
#else
#error "ROWS must be 1 to 4"
#endif
#define DECLARE_RUN(r) float8 low_##r = 0.0f, high_##r = 0.0f;
#define ADD_TERMS(r)                                  \
    low_##r = factors[i * ROWS + r] * low + low_##r;    \
    high_##r = factors[i * ROWS + r] * high + high_##r;
#define KEEP_SUMS(r)                                                       \
    AT(__local, float8, sums + r * TILE + c) = fresh ? low_##r : low_##r + AT(__local, float8, sums + r * TILE + c); \
    AT(__local, float8, sums + r * TILE + c + 8) =                           \
        fresh ? high_##r : high_##r + AT(__local, float8, sums + r * TILE + c + 8);

/* sums[r][c] (+)= sum over count rows of factors[i][r] row_i[c], for c < filled. */
static inline __attribute__((always_inline)) void add_rows(__local float *sums, __global const SAMPLE_T *rows,
                                                           __global const float *factors, const int count,
                                                           const int filled, const int size_p, const int fresh)
{
    int c = 0;
    for (; c + 16 <= filled; c += 16) {
        EACH_ROW(DECLARE_RUN)
        for (int i = 0; i < count; i++) {
            __global const SAMPLE_T *from = rows + (long)i * size_p + c;
            const float8 low = LOAD8(from), high = LOAD8(from + 8);
            EACH_ROW(ADD_TERMS)
        }
        EACH_ROW(KEEP_SUMS)
    }
    for (; c < filled; c++)
        for (int r = 0; r < ROWS; r++) {
            float run = 0.0f;
            for (int i = 0; i < count; i++)
                run = factors[i * ROWS + r] * LOAD_SAMPLE(rows + (long)i * size_p, c) + run;
            sums[r * TILE + c] = fresh ? run : run + sums[r * TILE + c];
        }
}

__kernel void apply_few_rows_mq(__global float *restrict out_mq, __global const SAMPLE_T *restrict source_ip,
                                __global const float *restrict packed_o, const int size_m, const int size_q,
                                const int size_i, const int size_p)
{
    __local float sums[ROWS * TILE];
    const int first = get_global_id(0) * TILE;
    const int filled = min(TILE, size_p - first);
    const int wanted = min(TILE, size_q - first);
    for (int i0 = 0; i0 < size_i; i0 += RUN) {
        __global const SAMPLE_T *rows = source_ip + (long)i0 * size_p + first;
        __global const float *factors = packed_o + i0 * ROWS;
        if (i0 + RUN <= size_i)
            add_rows(sums, rows, factors, RUN, filled, size_p, i0 == 0);
        else
            add_rows(sums, rows, factors, size_i - i0, filled, size_p, i0 == 0);
    }
    for (int r = 0; r < size_m; r++)
        for (int c = 0; c < wanted; c++)
            out_mq[(long)r * size_q + first + c] = c < filled ? sums[r * TILE + c] : 0.0f;
}
