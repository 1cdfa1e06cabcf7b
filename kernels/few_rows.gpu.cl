/* out = operator x source for GPUs, up to 16 rows, as relighting has them: see matmul.cl for the arrays.
 *
 *   packed_o   (n_in rounded up to DEPTH, STRIDE) the operator transposed, filled up with zeros
 *
 *   ROWS       operator rows, all of which each work-item sums; STRIDE is the next multiple of 4
 *   DEPTH      rows of the source after which sums are flushed: |error| <= eps (DEPTH + n_in / DEPTH + 2) sum |terms|
 *
 * Bound by the bandwidth of the source: a work-item takes COLUMNS columns that lie a group's width apart, so that
 * neighbours read one stretch, and all of them share the operator in local memory.
 */
#include "common/load_sample.clh"

#if !defined(ROWS) || !defined(DEPTH) || !defined(WITH_ENERGY)
#error "ROWS, DEPTH and WITH_ENERGY must be defined"
#endif

#define GROUP 128
#define COLUMNS 2
#define STRIDE ((ROWS + 3) / 4 * 4)

__kernel __attribute__((reqd_work_group_size(GROUP, 1, 1))) void
apply_few_rows_mq(__global REAL *restrict out_mq,
#if WITH_ENERGY
                  __global REAL *restrict energy_q, __global const REAL *restrict weight_i,
#endif
                  __global const SAMPLE_T *restrict source_ip, __global const REAL *restrict packed_o,
                  __global const REAL *restrict curve_v, const REAL scale, const int size_q, const int size_i,
                  const int size_p)
{
    __local REAL factors[DEPTH * STRIDE];
    const int first = get_group_id(0) * GROUP * COLUMNS + get_local_id(0);
    REAL sum[ROWS][COLUMNS] = {{0.0f}};
#if WITH_ENERGY
    REAL energy_sum[COLUMNS] = {0.0f};
#endif

    for (int i0 = 0; i0 < size_i; i0 += DEPTH) {
        const int depth = min(DEPTH, size_i - i0);
        for (int f = get_local_id(0); f < DEPTH * STRIDE; f += GROUP) factors[f] = packed_o[i0 * STRIDE + f];
        barrier(CLK_LOCAL_MEM_FENCE);
        REAL run[ROWS][COLUMNS] = {{0.0f}};
#if WITH_ENERGY
        REAL energy_run[COLUMNS] = {0.0f};
#endif
        for (int i = 0; i < depth; i++) {
            __global const SAMPLE_T *row = source_ip + (long)(i0 + i) * size_p;
            REAL value[COLUMNS];
#pragma unroll
            for (int c = 0; c < COLUMNS; c++) {
                value[c] = load_sample(row, min(first + c * GROUP, size_p - 1), curve_v, scale);
#if WITH_ENERGY
                energy_run[c] = weight_i[i0 + i] * value[c] * value[c] + energy_run[c];
#endif
            }
#pragma unroll
            for (int r = 0; r < ROWS; r++)
#pragma unroll
                for (int c = 0; c < COLUMNS; c++) run[r][c] = factors[i * STRIDE + r] * value[c] + run[r][c];
        }
#pragma unroll
        for (int c = 0; c < COLUMNS; c++) {
#pragma unroll
            for (int r = 0; r < ROWS; r++) sum[r][c] += run[r][c];
#if WITH_ENERGY
            energy_sum[c] += energy_run[c];
#endif
        }
        barrier(CLK_LOCAL_MEM_FENCE);
    }
#pragma unroll
    for (int c = 0; c < COLUMNS; c++) {
        const int q = first + c * GROUP;
        if (q < size_q) {
#pragma unroll
            for (int r = 0; r < ROWS; r++) out_mq[(long)r * size_q + q] = q < size_p ? sum[r][c] : 0.0f;
#if WITH_ENERGY
            energy_q[q] = q < size_p ? energy_sum[c] : 0.0f;
#endif
        }
    }
}
