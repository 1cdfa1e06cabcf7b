/* One regularisation for each channel, for GPUs: see fit/spline.cl for the equation and the arrays.
 *
 * A work-item takes one column, its neighbours adjacent q.
 */
#include "common/real.clh"

__kernel void scale_rq(__global REAL *restrict z_rq, __global const REAL *restrict factor_rc, const int size_r,
                       const int size_q, const int size_c)
{
    const int q = get_global_id(0);
    if (q >= size_q) return;
    const int c = q % size_c;
    for (int r = 0; r < size_r; r++) z_rq[(long)r * size_q + q] *= factor_rc[r * size_c + c];
}
