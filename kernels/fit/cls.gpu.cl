/* Constrained least squares for GPUs: see fit/cls.cl for the equations, the searches, the arrays,
 * ARITHMETIC and ONTO_BOUND.
 *
 *   N_COMPONENT   R
 *
 * A work-item takes one column, its neighbours adjacent q. Up to IN_REGISTERS components b' = sigma z stays in
 * registers, for which the loops must be unrolled; of more, every step reads z again.
 */
#include "fit/bound.clh"

#ifndef N_COMPONENT
#error "N_COMPONENT must be defined: the number of rows"
#endif
#ifndef ARITHMETIC
#error "ARITHMETIC must be defined: 1 for the paper's bisection, else 0"
#endif
#ifndef ONTO_BOUND
#error "ONTO_BOUND must be defined: 1 to scale t onto the bound, else 0"
#endif

#define IN_REGISTERS 64
#if N_COMPONENT <= IN_REGISTERS
typedef const REAL *column;
#define TERM(b, r) (b)[r]
#define UNROLL N_COMPONENT
#else
typedef __global const REAL *column;
#define TERM(b, r) (singular_r[r] * (b)[(long)(r) * size_q])
#define UNROLL 8
#endif

/* f(lambda), and minus half its derivative, sum t^2 / (s + lambda). */
static REAL squared_norm(column b, __constant const REAL *singular_r, const int size_q, const REAL lambda,
                          REAL *slope)
{
    REAL f = 0.0f, r_sum = 0.0f;
#pragma unroll UNROLL
    for (int r = 0; r < N_COMPONENT; r++) {
        const REAL inverse = 1.0f / (singular_r[r] * singular_r[r] + lambda);
        const REAL t = TERM(b, r) * inverse;
        f = t * t + f;
        r_sum = t * t * inverse + r_sum;
    }
    *slope = r_sum;
    return f;
}

/* |b'|, and the least lambda where no |t_r| alone exceeds root. */
static REAL norm_of(column b, __constant const REAL *singular_r, const int size_q, const REAL root, REAL *least)
{
    REAL square = 0.0f, lambda = 0.0f;
#pragma unroll UNROLL
    for (int r = 0; r < N_COMPONENT; r++) {
        const REAL term = TERM(b, r);
        square = term * term + square;
        lambda = fmax(lambda, fabs(term) / root - singular_r[r] * singular_r[r]);
    }
    *least = lambda;
    return sqrt(square);
}

/* z <- t(lambda); returns the doubt of lambda. */
static REAL store_shrunk(__global REAL *z_rq, column b, __constant const REAL *singular_r, const REAL energy,
                          const REAL lambda, const int q, const int size_q)
{
    REAL slope = 0.0f, gain = 0.0f;
#if ONTO_BOUND
    REAL norm = 0.0f;
#endif
#pragma unroll UNROLL
    for (int r = 0; r < N_COMPONENT; r++) {
        const REAL inverse = 1.0f / (singular_r[r] * singular_r[r] + lambda);
        const REAL t = TERM(b, r) * inverse;
        const REAL g = t * inverse * singular_r[r];
        slope = t * t * inverse + slope;
        gain = g * g + gain;
        z_rq[(long)r * size_q + q] = t;
#if ONTO_BOUND
        norm = t * t + norm;
#endif
    }
#if ONTO_BOUND
    const REAL factor = norm > energy ? sqrt(energy / norm) : (REAL)1.0f;
    for (int r = 0; r < N_COMPONENT; r++) z_rq[(long)r * size_q + q] *= factor;
#endif
    return lambda > 0.0f ? sqrt(energy) * sqrt(gain) / (lambda * slope) : 0.0f;
}

static void load_column(REAL *b, __global const REAL *z_rq, __constant const REAL *singular_r, const int q,
                        const int size_q)
{
#pragma unroll UNROLL
    for (int r = 0; r < N_COMPONENT; r++) b[r] = singular_r[r] * z_rq[(long)r * size_q + q];
}

#if N_COMPONENT <= IN_REGISTERS
#define DECLARE_COLUMN(b)  \
    REAL b[N_COMPONENT]; \
    load_column(b, z_rq, singular_r, q, size_q)
#else
#define DECLARE_COLUMN(b) column b = z_rq + q
#endif

__kernel void shrink_by_bisection_rq(__global REAL *z_rq, __global float *restrict lambda_q,
                                     __global float *restrict doubt_q, __global const REAL *restrict energy_q,
                                     __constant const REAL *restrict singular_r, const int iterations,
                                     const int size_r, const int size_q)
{
    const int q = get_global_id(0);
    if (q >= size_q) return;
    DECLARE_COLUMN(b);
    const REAL energy = energy_q[q];
    REAL unused;
    const int held = squared_norm(b, singular_r, size_q, 0.0f, &unused) <= energy;

    REAL low = 0.0f, high = norm_of(b, singular_r, size_q, 1.0f, &unused) / sqrt(energy);
    REAL lambda = ARITHMETIC ? (REAL)1.0f : fmin((REAL)1.0f, high);
    int bracketed = 0;
    for (int k = 0; k < iterations && !held; k++) {
        if (squared_norm(b, singular_r, size_q, lambda, &unused) <= energy) {
            high = lambda;
            bracketed = 1;
        } else {
            low = lambda;
        }
#if ARITHMETIC
        lambda = bracketed ? 0.5f * (low + high) : lambda * 2.0f;
#else
        const REAL up = fmin(lambda * STEP, high), down = high / STEP, middle = sqrt(low) * sqrt(high);
        lambda = low == 0.0f ? down : bracketed ? middle : up;
#endif
    }
    lambda = held ? 0.0f : high;
    lambda_q[q] = lambda;
    doubt_q[q] = store_shrunk(z_rq, b, singular_r, energy, lambda, q, size_q);
}

__kernel void shrink_by_newton_rq(__global REAL *z_rq, __global float *restrict lambda_q,
                                  __global float *restrict doubt_q, __global const REAL *restrict energy_q,
                                  __constant const REAL *restrict singular_r, const int iterations,
                                  const int size_r, const int size_q)
{
    const int q = get_global_id(0);
    if (q >= size_q) return;
    DECLARE_COLUMN(b);
    const REAL energy = energy_q[q];
    REAL lambda = 0.0f;
    /* Black columns: any finite lambda gives zeros; 0/0 must not spread. */
    if (energy > 0.0f) {
        const REAL root = sqrt(energy), norm = norm_of(b, singular_r, size_q, root, &lambda);
        lambda = fmax(lambda, norm / root - singular_r[0] * singular_r[0]);
        for (int k = 0; k < iterations; k++) {
            REAL slope;
            const REAL f = squared_norm(b, singular_r, size_q, lambda, &slope);
            const REAL next = fmax(lambda + f / slope * (sqrt(f / energy) - 1.0f), (REAL)0.0f);
            /* NaN from a column without components ends the search too. */
            if (!(fabs(next - lambda) > SETTLED * lambda)) break;
            lambda = next;
        }
    }
    lambda_q[q] = lambda;
    doubt_q[q] = store_shrunk(z_rq, b, singular_r, energy, lambda, q, size_q);
}
