/* Constrained eigenbasis for GPUs: see fit/ceb.cl for the equations, the arrays and CROSSING.
 *
 * A work-item takes one column, its neighbours adjacent q.
 */
#include "fit/bound.clh"

#ifndef CROSSING
#error "CROSSING must be defined: 0 or 1"
#endif

__kernel void truncate_rq(__global REAL *restrict z_rq, __global int *restrict rank_q,
                          __global const REAL *restrict energy_q, __constant const REAL *restrict singular_r,
                          __constant const int *restrict end_r, const int size_r, const int size_q)
{
    const int q = get_global_id(0);
    if (q >= size_q) return;
    const REAL energy = energy_q[q] * (1.0f + ROUNDING);
    REAL sum = 0.0f;
    int keeping = 1, rank = 0;
    for (int first = 0; first < size_r;) {
        const int end = end_r[first];
#if CROSSING
        keeping &= sum < energy;
#endif
        for (int r = first; r < end; r++) {
            __global REAL *value = z_rq + (long)r * size_q + q;
            const REAL z = *value / singular_r[r];
            sum = z * z + sum;
            *value = z;
        }
#if !CROSSING
        keeping &= sum <= energy;
#endif
        for (int r = first; r < end; r++) {
            __global REAL *value = z_rq + (long)r * size_q + q;
            rank += keeping;
            *value = keeping ? *value : 0.0f;
        }
        first = end;
    }
    rank_q[q] = rank;
}
