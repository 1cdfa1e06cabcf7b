/* out = operator x source: a small matrix applied to every column (pixel and channel) of a row-major array.
 *
 *   out_mq      (n_out, Q) REAL       out[m][p] = sum_i operator[m][i] source[i][p]     for p < min(P, Q), else 0
 *   energy_q    (Q) REAL              energy[p] = sum_i weight[i] source[i][p]^2        (WITH_ENERGY)
 *   source_ip   (n_in, P) SAMPLE_T    code values; with a CURVE turned to linear radiance on the way
 *   packed_o    operator in row blocks: for each block, n_in runs of its rows' values (matmul.py packs it)
 *   heights_b   (n_block) int         rows of each block, 1 to 8
 *   weight_i    (n_in) REAL
 *
 * One work-item makes TILE columns. It converts CHUNK rows of the source at a time into a local tile, which cures the
 * row pitch of large images, and multiplies the tile by each row block with the sums in registers. Sums are flushed
 * every DEPTH rows: |error| <= eps (DEPTH + n_in / DEPTH) sum |terms|.
 */
#include "common/source_tile.clh"

#ifndef WITH_ENERGY
#error "WITH_ENERGY must be defined: 0 or 1"
#endif

__kernel void apply_operator_mq(__global REAL *restrict out_mq,
#if WITH_ENERGY
                                __global REAL *restrict energy_q, __global const REAL *restrict weight_i,
#endif
                                __global const SAMPLE_T *restrict source_ip, __global const REAL *restrict packed_o,
                                __global const int *restrict heights_b, __global const REAL *restrict curve_v,
                                const REAL scale, const int size_m, const int size_q, const int size_i,
                                const int size_p, const int size_b)
{
    __local vecr tile[CHUNK * TILE_VECTORS];
    __local vecr sums[8 * TILE_VECTORS];
    const int first = get_global_id(0) * TILE;
    const int filled = min(TILE, size_p - first);
    const int wanted = min(TILE, size_q - first);

    for (int i0 = 0; i0 < size_i; i0 += CHUNK) {
        const int rows = min(CHUNK, size_i - i0);
        load_tile(tile, source_ip, i0, rows, first, filled, size_p, curve_v, scale);
#if WITH_ENERGY
        sum_energy(sums, tile, weight_i + i0, rows, 1);
        store_row(energy_q + first, (__local const REAL *)sums, wanted, i0 > 0);
#endif
        __global const REAL *operator = packed_o;
        int m = 0;
        for (int b = 0; b < size_b; b++) {
            const int height = heights_b[b];
            apply_block(height, tile, operator + i0 * height, rows, sums, 1);
            for (int r = 0; r < height; r++)
                store_row(out_mq + (long)(m + r) * size_q + first, (__local const REAL *)(sums + r * TILE_VECTORS),
                          wanted, i0 > 0);
            operator += (long)height * size_i;
            m += height;
        }
    }
}
