/* out = operator x source for GPUs, from 17 rows on: see matmul.cl for the arrays. Fewer rows: few_rows.gpu.cl.
 *
 *   packed_o    for each block of THREADS_Y ROWS operator rows, and each of size_i rounded up to DEPTH: one value of
 *               every row, thread by thread, filled up with zeros to a multiple of 4 (matmul_gpu.py packs it)
 *
 *   ROWS        operator rows whose sums a work-item keeps in registers, for COLUMNS columns each
 *   THREADS_Y   work-items that share a column; a group is 32 x THREADS_Y, the 32 along the columns
 *   DEPTH       rows of the source that a local tile holds, a multiple of THREADS_Y
 *   RUN         tiles after which the sums are flushed, so that |error| <= eps (RUN DEPTH + n_in / (RUN DEPTH) + 2)
 *               sum |terms|
 *
 * A group makes 32 COLUMNS columns of one row block. Every sample is read once, by neighbours of its own row, and
 * converted on its way into local memory. A work-item's columns lie 32 apart: reads and writes of 32 work-items are
 * one stretch, whatever the row pitch. Local memory: DEPTH (32 COLUMNS + THREADS_Y (ROWS + 3)) values, at
 * most 13 KiB of float.
 */
#include "common/load_sample.clh"

#if !defined(ROWS) || !defined(THREADS_Y) || !defined(DEPTH) || !defined(RUN) || !defined(WITH_ENERGY)
#error "ROWS, THREADS_Y, DEPTH, RUN and WITH_ENERGY must be defined"
#endif
#if DEPTH % THREADS_Y != 0
#error "DEPTH must be a multiple of THREADS_Y"
#endif

#define THREADS_X 32
#define COLUMNS 4
#define WIDTH (THREADS_X * COLUMNS)
#define STRIDE ((ROWS + 3) / 4 * 4)
#define GROUP (THREADS_X * THREADS_Y)

__kernel __attribute__((reqd_work_group_size(GROUP, 1, 1))) void
apply_operator_mq(__global REAL *restrict out_mq,
#if WITH_ENERGY
                  __global REAL *restrict energy_q, __global const REAL *restrict weight_i,
#endif
                  __global const SAMPLE_T *restrict source_ip, __global const REAL *restrict packed_o,
                  __global const REAL *restrict curve_v, const REAL scale, const int size_m, const int size_q,
                  const int size_i, const int size_p, const int size_b)
{
    __local REAL tile[DEPTH * WIDTH];
    __local REAL factors[DEPTH * THREADS_Y * STRIDE];
    const int x = get_local_id(0) % THREADS_X, y = get_local_id(0) / THREADS_X;
    /* Row blocks are neighbours, so that the second finds the source in the cache. */
    const int block = get_group_id(0) % size_b, first = get_group_id(0) / size_b * WIDTH + x;
    const int tiles = (size_i + DEPTH - 1) / DEPTH;
    __global const REAL *packed = packed_o + (long)block * tiles * DEPTH * THREADS_Y * STRIDE;

    REAL sum[ROWS][COLUMNS], run[ROWS][COLUMNS];
#pragma unroll
    for (int r = 0; r < ROWS; r++)
#pragma unroll
        for (int c = 0; c < COLUMNS; c++) sum[r][c] = run[r][c] = 0.0f;
#if WITH_ENERGY
    REAL energy_sum[COLUMNS] = {0.0f}, energy_run[COLUMNS] = {0.0f};
#endif

    for (int t = 0; t < tiles; t++) {
        for (int i = y; i < DEPTH; i += THREADS_Y) {
            const int light = t * DEPTH + i;
            __global const SAMPLE_T *row = source_ip + (long)light * size_p;
#pragma unroll
            for (int c = 0; c < COLUMNS; c++) {
                const int p = first + c * THREADS_X;
                const int inside = light < size_i && p < size_p;
                const REAL value = inside ? load_sample(row, p, curve_v, scale) : 0.0f;
                tile[i * WIDTH + c * THREADS_X + x] = value;
#if WITH_ENERGY
                if (inside) energy_run[c] = weight_i[light] * value * value + energy_run[c];
#endif
            }
        }
        for (int f = get_local_id(0); f < DEPTH * THREADS_Y * STRIDE; f += GROUP)
            factors[f] = packed[(long)t * DEPTH * THREADS_Y * STRIDE + f];
        barrier(CLK_LOCAL_MEM_FENCE);

        for (int i = 0; i < DEPTH; i++) {
            REAL column[COLUMNS];
#pragma unroll
            for (int c = 0; c < COLUMNS; c++) column[c] = tile[i * WIDTH + c * THREADS_X + x];
#pragma unroll
            for (int r = 0; r < ROWS; r++) {
                const REAL factor = factors[(i * THREADS_Y + y) * STRIDE + r];
#pragma unroll
                for (int c = 0; c < COLUMNS; c++) run[r][c] = factor * column[c] + run[r][c];
            }
        }
        if ((t + 1) % RUN == 0 || t + 1 == tiles) {
#pragma unroll
            for (int r = 0; r < ROWS; r++)
#pragma unroll
                for (int c = 0; c < COLUMNS; c++) {
                    sum[r][c] += run[r][c];
                    run[r][c] = 0.0f;
                }
#if WITH_ENERGY
#pragma unroll
            for (int c = 0; c < COLUMNS; c++) {
                energy_sum[c] += energy_run[c];
                energy_run[c] = 0.0f;
            }
#endif
        }
        barrier(CLK_LOCAL_MEM_FENCE);
    }

#pragma unroll
    for (int r = 0; r < ROWS; r++) {
        const int m = (block * THREADS_Y + y) * ROWS + r;
#pragma unroll
        for (int c = 0; c < COLUMNS; c++) {
            const int q = first + c * THREADS_X;
            if (m < size_m && q < size_q) out_mq[(long)m * size_q + q] = sum[r][c];
        }
    }
#if WITH_ENERGY
    /* Work-items of one column each have the energy of every THREADS_Y-th row of the source. */
#pragma unroll
    for (int c = 0; c < COLUMNS; c++) tile[y * WIDTH + c * THREADS_X + x] = energy_sum[c];
    barrier(CLK_LOCAL_MEM_FENCE);
    for (int c = get_local_id(0); c < WIDTH; c += GROUP) {
        const int q = first - x + c;
        REAL energy = 0.0f;
        for (int part = 0; part < THREADS_Y; part++) energy += tile[part * WIDTH + c];
        if (block == 0 && q < size_q) energy_q[q] = energy;
    }
#endif
}
