/* Constrained least squares with several constraints at once: the bound on the energy of noise-resistant fitting
 * (eq. 17), and bounds on values at stated directions.
 *
 *   z_rq         (R, Q) Z        in: W' beta; out: the coefficients t in the eigenbasis
 *   lambda_q     (Q) float       out: lambda, `least` where the energy is below its bound
 *   unmet_q      (Q) int         out: 1 where not all constraints can be met, 2 where the search did not end, else 0
 *   energy_q     (Q) Z           E, in the units of z^2
 *   unit_q       (Q) REAL        radiance 1 in the units of the samples
 *   singular_r   (R) REAL        sigma; 0 for what no light sees
 *   rows_js         (J, S) REAL      values at the directions of the eigenbasis, zeros beyond R
 *   across_rt         (R, T) REAL      the same, zeros beyond J
 *   low_t, high_t  (T) REAL      in units of radiance; +-1e30 for none, and beyond J
 *   scratch_wn   (work-items, SCRATCH) REAL
 *   least        REAL            what lambda is at least: it takes the least energy of what is equally near
 *   least_energy REAL            of any t that meets the bounds, in units of radiance^2
 *
 *   Z_BITS       32 or 64, the type of z
 *   ROOM         components that there is memory for, at least R
 *
 * A work-item takes 8 columns at a time: for those lambda is found without bounds first (fit/cls.cl), and values are
 * compared. Columns that miss a bound go through fit/active_set.clh one by one. In double what is found is the least to
 * some 1e-9 of it; bounds are met to 1e-9 sqrt(E), the energy's to 1e-10.
 */
#include "fit/active_set.clh"

#ifndef Z_BITS
#error "Z_BITS must be defined: 32 or 64"
#elif Z_BITS == 64
#define Z double
typedef double8 z8;
#else
#define Z float
typedef float8 z8;
#endif
typedef z8 __attribute__((aligned(Z_BITS / 8))) z8_at;
#ifndef ROOM
#error "ROOM must be defined: at least the number of rows"
#endif

#if REAL_BITS == 64
#define SETTLED_CLS 1e-12
#else
#define SETTLED_CLS 4e-7f
#endif
#define CLS_STEPS 60

/* The lambda of eq. 25, at least `least`, by Newton from the left. */
INLINE lanes search_lambda(const lanes *b, __global const REAL *singular_r, const int size_r, const lanes energy,
                           const REAL least)
{
    const lanes inverse_root = 1.0f / root(energy);
    lanes norm = 0.0f, lambda = least;
    for (int r = 0; r < size_r; r++) {
        const lanes alone = ABSOLUTE(b[r]) * inverse_root - singular_r[r] * singular_r[r];
        lambda = GREATER(alone, lambda);
        norm = b[r] * b[r] + norm;
    }
    norm = root(norm) * inverse_root - singular_r[0] * singular_r[0];
    lambda = GREATER(norm, lambda);
    for (int k = 0; k < CLS_STEPS; k++) {
        lanes f = 0.0f, slope = FLT_MIN;
        for (int r = 0; r < size_r; r++) {
            const lanes inverse = 1.0f / (singular_r[r] * singular_r[r] + lambda);
            const lanes t = b[r] * inverse;
            f = t * t + f;
            slope = t * t * inverse + slope;
        }
        const lanes ahead = lambda + f / slope * (root(f) * inverse_root - 1.0f);
        const lanes next = GREATER(ahead, (lanes)least), step = next - lambda;
        const lanes_mask moved = ABSOLUTE(step) > SETTLED_CLS * lambda;
        lambda = moved ? next : lambda;
        if (!any_lane(moved)) break;
    }
    return lambda;
}

/* By how much each column misses its bounds at most. */
INLINE lanes worst_miss(const lanes *t, __global const REAL *rows_js, __global const REAL *low_t,
                        __global const REAL *high_t, const lanes unit, const int size_j, const int size_r)
{
    lanes worst = 0.0f;
    for (int j = 0; j < size_j; j += 2) {
        const int other = j + 1 < size_j ? j + 1 : j;
        __global const REAL *row = rows_js + (long)j * WIDTH_R, *next = rows_js + (long)other * WIDTH_R;
        lanes x = 0.0f, y = 0.0f;
        for (int r = 0; r < size_r; r++) {
            x = row[r] * t[r] + x;
            y = next[r] * t[r] + y;
        }
        lanes miss = unit * low_t[j] - x;
        worst = GREATER(miss, worst);
        miss = x - unit * high_t[j];
        worst = GREATER(miss, worst);
        miss = unit * low_t[other] - y;
        worst = GREATER(miss, worst);
        miss = y - unit * high_t[other];
        worst = GREATER(miss, worst);
    }
    return worst;
}

__kernel void fit_bounded_rq(__global Z *restrict z_rq, __global float *restrict lambda_q,
                             __global int *restrict unmet_q, __global const Z *restrict energy_q,
                             __global const REAL *restrict unit_q, __global const REAL *restrict singular_r,
                             __global const REAL *restrict rows_js, __global const REAL *restrict across_rt,
                             __global const REAL *restrict low_t, __global const REAL *restrict high_t,
                             __global REAL *restrict scratch_wn, const REAL least, const REAL least_energy,
                             const int first, const int end, const int size_j, const int size_r, const int size_q)
{
    __global REAL *scratch = scratch_wn + (long)get_global_id(0) * SCRATCH;
    column_state c = {scratch + GRAM_PLACE, scratch + FACTOR_PLACE, scratch + ROWS_PLACE,
                      scratch + COLUMN_PLACE, scratch + COLUMN_PLACE + WIDTH_R, scratch + COLUMN_PLACE + 2 * WIDTH_R,
                      scratch + COLUMN_PLACE + 3 * WIDTH_R,
                      scratch + SMALL_PLACE, scratch + SMALL_PLACE + MAX_ACTIVE, scratch + SMALL_PLACE + 2 * MAX_ACTIVE,
                      scratch + SMALL_PLACE + 3 * MAX_ACTIVE, scratch + SMALL_PLACE + 4 * MAX_ACTIVE,
                      rows_js, across_rt, low_t, high_t, 1.0f, 0, size_j, size_r};
    for (int n = 0; n < 3 * WIDTH_R + WIDTH_J; n++) scratch[COLUMN_PLACE + n] = 0.0f;
    for (int group = first + get_global_id(0); group < end; group += get_global_size(0)) {
        const int q = group * LANES;
        lanes b[ROOM], t[ROOM];
        for (int r = 0; r < size_r; r++)
            b[r] = singular_r[r] * CONVERT(AT(__global const, z8, z_rq + (long)r * size_q + q), lanes);
        const lanes given = CONVERT(AT(__global const, z8, energy_q + q), lanes);
        const lanes energy = GREATER(given, (lanes)FLT_MIN); /* of black columns any positive bound will do */
        const lanes unit = AT(__global const, real8, unit_q + q);
        lanes lambda = search_lambda(b, singular_r, size_r, energy, least);
        for (int r = 0; r < size_r; r++) t[r] = b[r] / (singular_r[r] * singular_r[r] + lambda);
        const lanes worst = worst_miss(t, rows_js, low_t, high_t, unit, size_j, size_r);
        int unmet[LANES];
        for (int lane = 0; lane < LANES; lane++) {
            unmet[lane] = ((const REAL *)&given)[lane] < least_energy * unit_q[q + lane] * unit_q[q + lane];
            if (unmet[lane] || !(((const REAL *)&worst)[lane] > MISSED * sqrt(((const REAL *)&energy)[lane]))) continue;
            for (int r = 0; r < size_r; r++) c.b[r] = ((const REAL *)(b + r))[lane];
            c.unit = unit_q[q + lane];
            c.active = 0;
            const int met =
                solve_column(&c, singular_r, ((const REAL *)&energy)[lane], least, (REAL *)&lambda + lane);
            for (int r = 0; r < size_r; r++) ((REAL *)(t + r))[lane] = c.t[r];
            unmet[lane] = met ? 0 : 2;
        }
        for (int r = 0; r < size_r; r++) AT(__global, z8, z_rq + (long)r * size_q + q) = CONVERT(t[r], z8);
        for (int lane = 0; lane < LANES; lane++) {
            unmet_q[q + lane] = unmet[lane];
            lambda_q[q + lane] = ((const REAL *)&lambda)[lane];
        }
    }
}
