/* One regularisation for each channel: z_r <- z_r factor_rc, c the channel of the column.
 *
 *   z_rq        (R, Q) REAL     in and out: components; columns have their channels adjacent, so c = q mod C
 *   factor_rc   (R, C) REAL     sigma / (sigma^2 + lambda_c)
 *
 * |error| <= eps |z factor|
 */
#include "common/columns.clh"

__kernel void scale_rq(__global REAL *restrict z_rq, __global const REAL *restrict factor_rc, const int size_r,
                       const int size_q, const int size_c)
{
    const int q = get_global_id(0) * LANES;
    for (int r = 0; r < size_r; r++) {
        __global REAL *row = z_rq + (long)r * size_q + q;
        for (int lane = 0; lane < LANES; lane++) row[lane] *= factor_rc[r * size_c + (q + lane) % size_c];
    }
}
