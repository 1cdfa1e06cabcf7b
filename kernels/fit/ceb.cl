/* Constrained eigenbasis: keep the leading eigenvectors while the squared norm stays within a bound.
 * Noise-resistant-fitting, eq. 31-35, but stopping before the sum crosses E, so that the constraint holds (the paper's
 * pseudocode keeps the term that crosses; CROSSING does as printed).
 *
 *   z_rq        (R, Q) REAL     in: W' beta; out: z_r / sigma_r for the kept r, else 0
 *   rank_q      (Q) int         out: number of eigenvectors kept
 *   energy_q    (Q) REAL        E, in the units of z^2
 *   singular_r  (R) REAL        sigma, descending
 *   end_r       (R) int         of each r, one past the last component whose sigma equals its own
 *
 *   CROSSING    0, or 1 to keep the eigenvector whose term crosses E
 *
 * Components of equal sigma are kept or dropped together: which eigenvectors stand for them is chance, and lights that
 * are turned around an axis of symmetry would change the image.
 *
 * A constant pixel's squared norm is E exactly: sums up to ROUNDING above E pass, or chance would decide on its last
 * term, all there is at degree 0. From degree 4 on the rounding errors of z / sigma are larger; what chance then decides
 * on is below 0.6% of the image. ROUNDING is smaller for double.
 */
#include "common/columns.clh"
#include "fit/bound.clh"

#ifndef CROSSING
#error "CROSSING must be defined: 0 or 1"
#endif

__kernel void truncate_rq(__global REAL *restrict z_rq, __global int *restrict rank_q,
                          __global const REAL *restrict energy_q, __global const REAL *restrict singular_r,
                          __global const int *restrict end_r, const int size_r, const int size_q)
{
    const int q = get_global_id(0) * LANES;
    const lanes energy = LOAD_LANES(energy_q + q) * (1.0f + ROUNDING);
    lanes sum = 0.0f;
    lanes_mask keeping = -1, rank = 0;
    for (int first = 0; first < size_r;) {
        const int end = end_r[first];
#if CROSSING
        keeping &= sum < energy;
#endif
        for (int r = first; r < end; r++) {
            __global REAL *row = z_rq + (long)r * size_q + q;
            const lanes z = LOAD_LANES(row) / singular_r[r];
            sum = z * z + sum;
            STORE_LANES(z, row);
        }
#if !CROSSING
        keeping &= sum <= energy;
#endif
        for (int r = first; r < end; r++) {
            __global REAL *row = z_rq + (long)r * size_q + q;
            rank -= keeping;
            STORE_LANES(keeping ? LOAD_LANES(row) : (lanes)0.0f, row);
        }
        first = end;
    }
    AT(__global, int8, rank_q + q) = CONVERT(rank, int8);
}
