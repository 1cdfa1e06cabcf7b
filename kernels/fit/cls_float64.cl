/* Constrained least squares in float64 for chosen columns: projection, Newton for lambda, shrinking (see cls.cl).
 *
 *   z_rq         (R, Q) float         out, at the places: t(lambda)
 *   lambda_n     (N) float            in and out, at the chosen columns: lambda; N at least P
 *   source_ip    (n_light, P) SAMPLE_T
 *   chosen_f     (F) int              columns, F a multiple of 8; repeated ones are legal
 *   place_f      (F) int              where in z each goes
 *   analysis_ir  (n_light, R) double  samples to components
 *   singular_r   (R) double           sigma, descending
 *   weight_i     (n_light) double     E = sum_i weight_i source_i^2
 *
 *   ROOM         components that a column has private memory for, at least R
 */
#include "common/calls_double.clh"
#include "common/load_sample.clh"

#ifndef ROOM
#error "ROOM must be defined: at least the number of rows"
#endif

#define MAX_STEPS 60
#define DEPTH 64 /* lights whose samples are held at a time */

__kernel void refine_rq(__global float *restrict z_rq, __global float *restrict lambda_n,
                        __global const SAMPLE_T *restrict source_ip, __global const int *restrict chosen_f,
                        __global const int *restrict place_f, __global const double *restrict analysis_ir,
                        __global const double *restrict singular_r, __global const double *restrict weight_i,
                        __global const float *restrict curve_v, const float scale, const int size_i, const int size_p,
                        const int size_r, const int size_q)
{
    const int8 column = AT(__global const, int8, chosen_f + 8 * get_global_id(0));
    const int c[8] = {column.s0, column.s1, column.s2, column.s3, column.s4, column.s5, column.s6, column.s7};
    double8 b[ROOM];
    double8 energy = 0.0;
    for (int r = 0; r < size_r; r++) b[r] = 0.0;
    for (int i0 = 0; i0 < size_i; i0 += DEPTH) {
        const int depth = size_i - i0 < DEPTH ? size_i - i0 : DEPTH;
        double8 sample[DEPTH];
        for (int i = 0; i < depth; i++) {
            __global const SAMPLE_T *row = source_ip + (long)(i0 + i) * size_p;
            sample[i] = (double8)(
                load_sample(row, c[0], curve_v, scale), load_sample(row, c[1], curve_v, scale),
                load_sample(row, c[2], curve_v, scale), load_sample(row, c[3], curve_v, scale),
                load_sample(row, c[4], curve_v, scale), load_sample(row, c[5], curve_v, scale),
                load_sample(row, c[6], curve_v, scale), load_sample(row, c[7], curve_v, scale));
            energy = weight_i[i0 + i] * sample[i] * sample[i] + energy;
        }
        __global const double *analysis = analysis_ir + (long)i0 * size_r;
        int r = 0;
        for (; r + 4 <= size_r; r += 4) {
            double8 b0 = b[r], b1 = b[r + 1], b2 = b[r + 2], b3 = b[r + 3];
            for (int i = 0; i < depth; i++) {
                __global const double *factors = analysis + (long)i * size_r + r;
                b0 = factors[0] * sample[i] + b0;
                b1 = factors[1] * sample[i] + b1;
                b2 = factors[2] * sample[i] + b2;
                b3 = factors[3] * sample[i] + b3;
            }
            b[r] = b0;
            b[r + 1] = b1;
            b[r + 2] = b2;
            b[r + 3] = b3;
        }
        for (; r < size_r; r++)
            for (int i = 0; i < depth; i++) b[r] = analysis[(long)i * size_r + r] * sample[i] + b[r];
    }
    double8 norm = 0.0;
    for (int r = 0; r < size_r; r++) {
        b[r] *= singular_r[r];
        norm = b[r] * b[r] + norm;
    }
    const double8 inverse_root = 1.0 / root(energy);
    double8 lambda = root(norm) * inverse_root - singular_r[0] * singular_r[0];
    lambda = GREATER(lambda, (double8)0.0);
    for (int r = 0; r < size_r; r++) {
        const double8 least = ABSOLUTE(b[r]) * inverse_root - singular_r[r] * singular_r[r];
        lambda = GREATER(least, lambda);
    }
    /* What the first pass found is nearer; Newton also converges from above. */
    double8 found;
    for (int lane = 0; lane < 8; lane++) ((double *)&found)[lane] = 0.999 * lambda_n[c[lane]];
    lambda = found > lambda ? found : lambda;
    for (int k = 0; k < MAX_STEPS; k++) {
        double8 f = 0.0, slope = 0.0;
        for (int r = 0; r < size_r; r++) {
            const double8 inverse = 1.0 / (singular_r[r] * singular_r[r] + lambda);
            const double8 t = b[r] * inverse;
            f = t * t + f;
            slope = t * t * inverse + slope;
        }
        const double8 ahead = lambda + f / slope * (root(f / energy) - 1.0);
        const double8 next = GREATER(ahead, (double8)0.0), step = next - lambda;
        const long8 moved = ABSOLUTE(step) > 1e-12 * lambda;
        lambda = moved ? next : lambda;
        if (!any_lane(moved)) break;
    }
    __global const int *places = place_f + 8 * get_global_id(0);
    for (int lane = 0; lane < 8; lane++) lambda_n[c[lane]] = ((const double *)&lambda)[lane];
    for (int r = 0; r < size_r; r++) {
        const double8 t = b[r] / (singular_r[r] * singular_r[r] + lambda);
        for (int lane = 0; lane < 8; lane++) z_rq[(long)r * size_q + places[lane]] = ((const double *)&t)[lane];
    }
}
