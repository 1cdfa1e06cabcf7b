/* out = one row x source, as relighting by one light has it: see matmul.cl for the arrays.
 *
 *   packed_o   (n_in) float   the row
 *
 * Bound by the bandwidth of the source, which each work-item reads RUN rows at a time: longer stretches than the tiles
 * of matmul.cl have, and no copy. |error| <= eps32 (RUN + n_in / RUN) sum |terms|.
 */
#include "common/types.clh"

#ifndef TILE
#error "TILE must be defined: columns of a work-item, a multiple of 16"
#endif

#define RUN 8

#if SAMPLE_HALF
#define LOAD8(pointer) LOAD_HALF8(__global const, pointer)
#else
#define LOAD8(pointer) AT(__global const, float8, pointer)
#endif

/* sums[c] (+)= sum over count rows of factors[i] row_i[c], for c < filled. */
static inline __attribute__((always_inline)) void add_rows(__local float *sums, __global const SAMPLE_T *rows,
                                                           __global const float *factors, const int count,
                                                           const int filled, const int size_p, const int fresh)
{
    int c = 0;
    for (; c + 16 <= filled; c += 16) {
        float8 low = fresh ? 0.0f : AT(__local, float8, sums + c);
        float8 high = fresh ? 0.0f : AT(__local, float8, sums + c + 8);
        float8 low_run = 0.0f, high_run = 0.0f;
        for (int i = 0; i < count; i++) {
            __global const SAMPLE_T *from = rows + (long)i * size_p + c;
            low_run = factors[i] * LOAD8(from) + low_run;
            high_run = factors[i] * LOAD8(from + 8) + high_run;
        }
        AT(__local, float8, sums + c) = low + low_run;
        AT(__local, float8, sums + c + 8) = high + high_run;
    }
    for (; c < filled; c++) {
        float run = 0.0f;
        for (int i = 0; i < count; i++) run = factors[i] * LOAD_SAMPLE(rows + (long)i * size_p, c) + run;
        sums[c] = fresh ? run : sums[c] + run;
    }
}

__kernel void apply_row_mq(__global float *restrict out_mq, __global const SAMPLE_T *restrict source_ip,
                           __global const float *restrict packed_o, const int size_q, const int size_i,
                           const int size_p)
{
    __local float sums[TILE];
    const int first = get_global_id(0) * TILE;
    const int filled = min(TILE, size_p - first);
    const int wanted = min(TILE, size_q - first);
    for (int i0 = 0; i0 < size_i; i0 += RUN) {
        __global const SAMPLE_T *rows = source_ip + (long)i0 * size_p + first;
        if (i0 + RUN <= size_i)
            add_rows(sums, rows, packed_o + i0, RUN, filled, size_p, i0 == 0);
        else
            add_rows(sums, rows, packed_o + i0, size_i - i0, filled, size_p, i0 == 0);
    }
    for (int c = 0; c < wanted; c++) out_mq[first + c] = c < filled ? sums[c] : 0.0f;
}
