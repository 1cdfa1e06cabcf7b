/* Constrained least squares: the least lambda >= 0 that keeps the squared norm of the coefficients within a bound.
 * Noise-resistant-fitting, eq. 19-25, with b' = sigma z so that nothing is squared twice:
 *
 *   t_r(lambda) = sigma_r z_r / (sigma_r^2 + lambda),      f(lambda) = sum_r t_r^2 <= E
 *
 *   z_rq        (R, Q) REAL     in: W' beta; out: t(lambda), the coefficients in the eigenbasis
 *   lambda_q    (Q) float       out: lambda, 0 where f(0) <= E
 *   doubt_q     (Q) float       out: relative change of lambda for an error of z by sqrt(E) in every component,
 *                               sqrt(E) |t sigma/(s + lambda)| / (lambda sum t^2/(s + lambda)); 0 where lambda is 0
 *   energy_q    (Q) REAL        E, in the units of z^2
 *   singular_r  (R) REAL        sigma, descending
 *
 * Bisection. The paper starts at lambda = 1 with lower bound 0 and halves. Halving the interval leaves lambda off by
 * up to 0.3 of itself when sigma^2 spans nine decades, so we halve its logarithm: go down or up by 16 until lambda is
 * bracketed, then take geometric means. The upper end is returned: there the constraint holds. |z sigma| / sqrt(E)
 * is an upper end in any case. ARITHMETIC searches as printed: from 1, doubled until lambda is bracketed, then
 * arithmetic means; after k steps lambda is off by up to 2^-k, or its own size where that is less.
 *
 * Newton, safeguarded: lambda <- lambda + (f/r) (sqrt(f/E) - 1) with r = sum t^2/(s + lambda). 1/|c| is concave in
 * lambda, so the iteration comes from the left and never overshoots. It starts where no t_r alone exceeds sqrt(E):
 * below that, t^2/(s + lambda) overflows once s spans more than some twenty decades.
 *
 *   ROOM        components that a column has private memory for, at least R
 *   PAIRED      1 where the product of two sigma^2 is a normal number, else 0
 *   ARITHMETIC  1 for the bisection as the paper has it, else 0
 *   ONTO_BOUND  1 where Newton gets too few steps to end: it is then below lambda, and t is scaled by sqrt(E/f) where f
 *               exceeds E. Else 0
 */
#include "common/columns.clh"
#include "fit/bound.clh"

#ifndef ROOM
#error "ROOM must be defined: at least the number of rows"
#endif
#ifndef PAIRED
#error "PAIRED must be defined: 1 where the product of two sigma^2 is a normal number, else 0"
#endif
#ifndef ARITHMETIC
#error "ARITHMETIC must be defined: 1 for the paper's bisection, else 0"
#endif
#ifndef ONTO_BOUND
#error "ONTO_BOUND must be defined: 1 to scale t onto the bound, else 0"
#endif

static inline __attribute__((always_inline)) lanes squared_norm(const lanes *b, __global const REAL *restrict singular_r,
                                                              const int size_r, const lanes lambda)
{
    lanes f = 0.0f, g = 0.0f;
    int r = 0;
#if PAIRED
    /* One division and two sums for two components: divisions, then waiting for one sum, take most of the time. */
    for (; r + 2 <= size_r; r += 2) {
        const lanes x = singular_r[r] * singular_r[r] + lambda, y = singular_r[r + 1] * singular_r[r + 1] + lambda;
        const lanes inverse = 1.0f / (x * y);
        const lanes t = b[r] * (y * inverse), u = b[r + 1] * (x * inverse);
        f = t * t + f;
        g = u * u + g;
    }
#endif
    for (; r < size_r; r++) {
        const lanes t = b[r] / (singular_r[r] * singular_r[r] + lambda);
        f = t * t + f;
    }
    return f + g;
}

static inline __attribute__((always_inline)) lanes load_scaled(lanes *b, __global const REAL *restrict z_rq, __global const REAL *restrict singular_r,
                         const int q, const int size_r, const int size_q)
{
    lanes norm = 0.0f;
    for (int r = 0; r < size_r; r++) {
        b[r] = singular_r[r] * LOAD_LANES(z_rq + (long)r * size_q + q);
        norm = b[r] * b[r] + norm;
    }
    return norm;
}

static inline __attribute__((always_inline)) void store_shrunk(__global REAL *restrict z_rq, __global float *restrict doubt_q, const lanes *b,
                         __global const REAL *restrict singular_r, const lanes energy, const lanes lambda, const int q,
                         const int size_r, const int size_q)
{
    lanes slope = 0.0f, gain = 0.0f;
#if ONTO_BOUND
    lanes norm = 0.0f;
#endif
    for (int r = 0; r < size_r; r++) {
        const lanes inverse = 1.0f / (singular_r[r] * singular_r[r] + lambda);
        const lanes t = b[r] * inverse;
        const lanes g = t * inverse * singular_r[r];
        slope = t * t * inverse + slope;
        gain = g * g + gain;
        STORE_LANES(t, z_rq + (long)r * size_q + q);
#if ONTO_BOUND
        norm = t * t + norm;
#endif
    }
#if ONTO_BOUND
    const lanes factor = norm > energy ? root(energy / norm) : (lanes)1.0f;
    for (int r = 0; r < size_r; r++)
        STORE_LANES(factor * LOAD_LANES(z_rq + (long)r * size_q + q), z_rq + (long)r * size_q + q);
#endif
    const lanes doubt = root(energy) * root(gain) / (lambda * slope);
    STORE_FLOATS(lambda > 0.0f ? doubt : (lanes)0.0f, doubt_q + q);
}

__kernel void shrink_by_bisection_rq(__global REAL *restrict z_rq, __global float *restrict lambda_q,
                                     __global float *restrict doubt_q, __global const REAL *restrict energy_q,
                                     __global const REAL *restrict singular_r, const int iterations,
                                     const int size_r, const int size_q)
{
    const int q = get_global_id(0) * LANES;
    lanes b[ROOM];
    const lanes norm = load_scaled(b, z_rq, singular_r, q, size_r, size_q);
    const lanes energy = LOAD_LANES(energy_q + q);
    const lanes_mask held = squared_norm(b, singular_r, size_r, 0.0f) <= energy;

    lanes low = 0.0f, high = root(norm / energy), lambda = ARITHMETIC ? (lanes)1.0f : LESSER(high, (lanes)1.0f);
    lanes_mask bracketed = 0;
    if (!all_lanes(held)) {
        for (int k = 0; k < iterations; k++) {
            const lanes_mask feasible = squared_norm(b, singular_r, size_r, lambda) <= energy;
            high = feasible ? lambda : high;
            low = feasible ? low : lambda;
            bracketed |= feasible;
#if ARITHMETIC
            const lanes middle = 0.5f * (low + high);
            lambda = bracketed ? middle : lambda * 2.0f; /* not held below the upper end, for the paper knows none */
#else
            const lanes up = LESSER(lambda * STEP, high), down = high / STEP;
            const lanes middle = root(low) * root(high);
            lambda = low == 0.0f ? down : bracketed ? middle : up;
#endif
        }
    }
    lambda = held ? (lanes)0.0f : high;
    STORE_FLOATS(lambda, lambda_q + q);
    store_shrunk(z_rq, doubt_q, b, singular_r, energy, lambda, q, size_r, size_q);
}

__kernel void shrink_by_newton_rq(__global REAL *restrict z_rq, __global float *restrict lambda_q,
                                  __global float *restrict doubt_q, __global const REAL *restrict energy_q,
                                  __global const REAL *restrict singular_r, const int iterations,
                                  const int size_r, const int size_q)
{
    const int q = get_global_id(0) * LANES;
    lanes b[ROOM];
    const lanes norm = load_scaled(b, z_rq, singular_r, q, size_r, size_q);
    const lanes energy = LOAD_LANES(energy_q + q);
    /* Black columns: any finite lambda gives zeros; 0/0 must not spread. */
    const lanes_mask empty = energy <= 0.0f;
    const lanes inverse_root = 1.0f / root(energy);
    const lanes first = root(norm) * inverse_root - singular_r[0] * singular_r[0];
    lanes lambda = GREATER(first, (lanes)0.0f);
    for (int r = 0; r < size_r; r++) {
        const lanes least = ABSOLUTE(b[r]) * inverse_root - singular_r[r] * singular_r[r];
        lambda = GREATER(least, lambda);
    }
    lambda = empty ? (lanes)0.0f : lambda;

    for (int k = 0; k < iterations; k++) {
        lanes f = 0.0f, slope = 0.0f;
        for (int r = 0; r < size_r; r++) {
            const lanes inverse = 1.0f / (singular_r[r] * singular_r[r] + lambda);
            const lanes t = b[r] * inverse;
            f = t * t + f;
            slope = t * t * inverse + slope;
        }
        const lanes ahead = lambda + f / slope * (root(f / energy) - 1.0f);
        const lanes next = GREATER(ahead, (lanes)0.0f), step = next - lambda;
        const lanes_mask moved = !empty && ABSOLUTE(step) > SETTLED * lambda;
        lambda = moved ? next : lambda;
        if (!any_lane(moved)) break;
    }
    STORE_FLOATS(lambda, lambda_q + q);
    store_shrunk(z_rq, doubt_q, b, singular_r, energy, lambda, q, size_r, size_q);
}
