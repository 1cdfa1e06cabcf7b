/* Constrained least squares with several constraints at once: the bound on the energy of noise-resistant fitting
 * (noise-resistant-fitting, eq. 17), and bounds on values at stated directions.
 *
 *   z_rq         (R, Q) Z        in: W' beta; out: the coefficients t in the eigenbasis
 *   lambda_q     (Q) float       out: lambda, `least` where the energy is below its bound
 *   unmet_q      (Q) int         out: 1 where not all constraints can be met, 2 where the search did not end, else 0
 *   energy_q     (Q) Z           E, in the units of z^2
 *   unit_q       (Q) REAL        radiance 1 in the units of the samples
 *   singular_s   (S) REAL        sigma; 0 for what no light sees, and beyond R
 *   rows_js         (J, S) REAL      values at the directions of the eigenbasis, zeros beyond R
 *   across_st         (S, T) float     the same, zeros beyond R and J
 *   low_t, high_t  (T) REAL      in units of radiance; +-1e30 for none, and beyond J
 *   scratch_wn   (work-items, size_n) REAL
 *   least        REAL            what lambda is at least: it takes the least energy of what is equally near
 *   least_energy REAL            of any t that meets the bounds, in units of radiance^2
 *   doubt        float           error of a value that is summed in float, in sqrt(E)
 *   longest      float           norm of a row, at most
 *
 *   Z_BITS       32 or 64, the type of z
 *   ROOM         components that there is memory for, at least R
 *   fast_steps   steps in which everything moves at once, before lambda is bracketed; some 5 are usual at degree 6
 *   wide_a       rows that there is memory for, a multiple of 8
 *   joining      rows that join at a time
 *
 * A work-item takes 8 columns at a time, for which lambda is found roughly as if there were no bounds on values (fit/cls.cl).
 * From there each goes through fit/active_set.clh. In double what is found is the least to some 1e-9 of it; bounds are
 * met to 1e-9 sqrt(E), the energy's to 1e-10.
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

#define ROUGHLY 1e-2f /* of lambda: where a column's own search begins */
#define CLS_STEPS 60

/* Roughly the lambda of eq. 25, at least `least`, by Newton from the left; b in sqrt(E). */
INLINE float8 search_lambda(const float8 *b, __global const REAL *singular_s, const int size_r, const float least)
{
    float8 norm = 0.0f, lambda = least;
    for (int r = 0; r < size_r; r++) {
        const float8 alone = ABSOLUTE(b[r]) - (float)(singular_s[r] * singular_s[r]);
        lambda = GREATER(alone, lambda);
        norm = b[r] * b[r] + norm;
    }
    norm = root(norm) - (float)(singular_s[0] * singular_s[0]);
    lambda = GREATER(norm, lambda);
    for (int k = 0; k < CLS_STEPS; k++) {
        float8 f = 0.0f, slope = FLT_MIN;
        for (int r = 0; r < size_r; r++) {
            const float8 inverse = 1.0f / ((float)(singular_s[r] * singular_s[r]) + lambda);
            const float8 t = b[r] * inverse, square = t * t;
            f = square + f;
            slope = square * inverse + slope;
        }
        const float8 ahead = lambda + f / slope * (root(f) - 1.0f);
        const float8 next = GREATER(ahead, (float8)least), step = next - lambda;
        const int8 moved = ABSOLUTE(step) > ROUGHLY * lambda;
        lambda = moved ? next : lambda;
        if (!any_lane(moved)) break;
    }
    return lambda;
}

__kernel void fit_bounded_rq(__global Z *restrict z_rq, __global float *restrict lambda_q,
                             __global int *restrict unmet_q, __global const Z *restrict energy_q,
                             __global const REAL *restrict unit_q, __global const REAL *restrict singular_s,
                             __global const REAL *restrict rows_js, __global const float *restrict across_st,
                             __global const REAL *restrict low_t, __global const REAL *restrict high_t,
                             __global REAL *restrict scratch_wn, const REAL least, const REAL least_energy,
                             const float doubt, const float longest,
                             const int fast_steps, const int wide_a, const int joining, const int size_n,
                             const int first, const int end, const int size_j, const int size_r, const int size_q)
{
    const int wide_r = (size_r + 7) / 8 * 8, wide_j = (size_j + 15) / 16 * 16;
    __global REAL *place = scratch_wn + (long)get_global_id(0) * size_n;
    for (int n = 0; n < size_n; n++) place[n] = 0.0f;
#define TAKE(size) ((place += (size)) - (size))
    column_state c;
    c.gram = TAKE(wide_a * wide_a);
    c.factor = TAKE(wide_a * wide_a);
    c.panels = TAKE(wide_a * wide_r);
    c.back = TAKE(16 * wide_a);
    c.t = TAKE(wide_r);
    c.b = TAKE(wide_r);
    c.inverse = TAKE(wide_r);
    c.scaled = TAKE(wide_r);
    c.seen = TAKE(wide_r);
    c.single = (__global float *)TAKE(wide_r);
    c.miss = (__global float *)TAKE(wide_j);
    c.low = (__global float *)TAKE(wide_j);
    c.high = (__global float *)TAKE(wide_j);
    c.mu = TAKE(wide_a);
    c.next = TAKE(wide_a);
    c.limit = TAKE(wide_a);
    c.bound = TAKE(wide_a);
    c.slope = TAKE(wide_a);
    c.pivot = TAKE(wide_a);
    c.sign = TAKE(wide_a);
    c.place = TAKE(wide_a);
    c.rows_js = rows_js;
    c.across_st = across_st;
    c.low_t = low_t;
    c.high_t = high_t;
    c.doubt = doubt;
    c.longest = longest;
    c.size_r = size_r;
    c.wide_r = wide_r;
    c.wide_j = wide_j;
    c.wide_a = wide_a;
    c.joining = joining;
    c.fast_steps = fast_steps;
    for (int group = first + get_global_id(0); group < end; group += get_global_size(0)) {
        const int q = group * LANES;
        lanes b[ROOM];
        for (int r = 0; r < size_r; r++)
            b[r] = singular_s[r] * CONVERT(AT(__global const, z8, z_rq + (long)r * size_q + q), lanes);
        const lanes given = CONVERT(AT(__global const, z8, energy_q + q), lanes);
        const lanes energy = GREATER(given, (lanes)TINY); /* of black columns any positive bound will do */
        const lanes inverse_root = 1.0f / root(energy);
        float8 rough_b[ROOM];
        for (int r = 0; r < size_r; r++) {
            const lanes part = b[r] * inverse_root;
            rough_b[r] = CONVERT(part, float8);
        }
        const float8 rough = search_lambda(rough_b, singular_s, size_r, (float)GREATER(least, (REAL)FLT_MIN));
        lanes lambda = CONVERT(rough, lanes);
        int unmet[LANES];
        for (int lane = 0; lane < LANES; lane++) {
            c.unit = unit_q[q + lane];
            c.active = 0;
            for (int r = 0; r < size_r; r++) c.b[r] = ((const REAL *)(b + r))[lane];
            unmet[lane] = ((const REAL *)&given)[lane] < least_energy * c.unit * c.unit;
            if (!unmet[lane] &&
                !solve_column(&c, singular_s, ((const REAL *)&energy)[lane], least, (REAL *)&lambda + lane))
                unmet[lane] = 2;
            for (int r = 0; r < size_r; r++) ((REAL *)(b + r))[lane] = c.t[r];
        }
        for (int r = 0; r < size_r; r++) AT(__global, z8, z_rq + (long)r * size_q + q) = CONVERT(b[r], z8);
        for (int lane = 0; lane < LANES; lane++) {
            unmet_q[q + lane] = unmet[lane];
            lambda_q[q + lane] = ((const REAL *)&lambda)[lane];
        }
    }
}
