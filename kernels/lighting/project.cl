/* Spherical-harmonic projection of texels, c_k = sum_t w_t L_t y_k(s_t), as sums of parts of the texels.
 *
 *   partial_gkc   (G, K, C) float    out: the sum over the texels of part g, k = l (l + 1) + m
 *   geometry_jt   (4, T) float       x, y, z of the unit direction s, and the solid angle w in steradian
 *   radiance_tc   (T, C) float       linear radiance L
 *   step_kf       (K, 2) float       for m >= 0 at k(l, m): factors a, b of the recurrence over l
 *
 * A work-item takes `each` texels of part g, BLOCK at a time, and keeps the polynomials of a block in private memory.
 * With y_lm = N Q_lm(z) Re or Im (x + i y)^m, Q_lm = a (z Q_(l-1)m - b Q_(l-2)m) (Holmes and Featherstone 2002, eq. 11):
 * the factor N, sqrt(2) for m > 0, is the host's. Real and imaginary parts below 1e-32 count as 0: they would become
 * denormal, and |Q| is below 1e21 up to degree 100.
 * |error| <= eps32 (BLOCK / VECTOR + parts of blocks + 4 degree) sum |w L y|
 */
#include "common/lanes.clh"
#include "common/vector.clh"

#if !defined(BLOCK) || !defined(CHANNELS)
#error "BLOCK (texels, a multiple of VECTOR) and CHANNELS (1 or 3) must be defined"
#endif

#define VECTORS (BLOCK / VECTOR)
#define TINY 1e-32f

/* part[t] = values[t] for t < filled, 0 for the rest of the block; a loop of fixed length is vectorised. */
static void load_part(float *part, __global const float *values, const int filled)
{
    int t = 0;
    if (filled == BLOCK)
        for (; t < BLOCK; t++) part[t] = values[t];
    for (; t < filled; t++) part[t] = values[t];
    for (; t < BLOCK; t++) part[t] = 0.0f;
}

/* light[t] = weight[t] x one channel; texels of no weight may hold anything. */
static void load_light(float *light, const float *weight, __global const float *channel, const int filled)
{
    int t = 0;
    if (filled == BLOCK)
        for (; t < BLOCK; t++) light[t] = weight[t] > 0.0f ? weight[t] * channel[t * CHANNELS] : 0.0f;
    for (; t < filled; t++) light[t] = weight[t] > 0.0f ? weight[t] * channel[t * CHANNELS] : 0.0f;
    for (; t < BLOCK; t++) light[t] = 0.0f;
}

/* re + i im <- (x + i y) (re + i im), with 0 for what is too small to matter */
static void turn_further(vecf *re, vecf *im, const vecf x, const vecf y)
{
    const vecf next = x * *re - y * *im;
    const vecf other = x * *im + y * *re;
    *re = ((next > TINY) | (next < -TINY)) ? next : (vecf)0.0f;
    *im = ((other > TINY) | (other < -TINY)) ? other : (vecf)0.0f;
}

__kernel void project_texels_gkc(__global float *restrict partial_gkc, __global const float *restrict geometry_jt,
                                 __global const float *restrict radiance_tc, __global const float *restrict step_kf,
                                 const int degree, const int each, const int size_k, const int size_t)
{
    const int part = get_global_id(0);
    __global float *sums = partial_gkc + (long)part * size_k * CHANNELS;
    const long first = (long)part * each;
    const long end = LESSER(first + each, (long)size_t);
    vecf x[VECTORS], y[VECTORS], z[VECTORS], re[VECTORS], im[VECTORS], before[VECTORS], now[VECTORS];
    vecf weight[VECTORS], light[CHANNELS * VECTORS];

    for (int i = 0; i < size_k * CHANNELS; i++) sums[i] = 0.0f;
    for (long start = first; start < end; start += BLOCK) {
        const int filled = (int)LESSER((long)BLOCK, end - start);
        load_part((float *)x, geometry_jt + start, filled);
        load_part((float *)y, geometry_jt + size_t + start, filled);
        load_part((float *)z, geometry_jt + 2L * size_t + start, filled);
        load_part((float *)weight, geometry_jt + 3L * size_t + start, filled);
        for (int c = 0; c < CHANNELS; c++)
            load_light((float *)(light + c * VECTORS), (const float *)weight, radiance_tc + start * CHANNELS + c, filled);
        for (int v = 0; v < VECTORS; v++) {
            re[v] = 1.0f;
            im[v] = 0.0f;
        }
        float sectoral = 0.28209479177387814f; /* sqrt(1 / 4 pi) */
        for (int m = 0; m <= degree; m++) {
            if (m > 0) {
                sectoral *= step_kf[2 * (m * (m + 1) + m)];
                for (int v = 0; v < VECTORS; v++) turn_further(re + v, im + v, x[v], y[v]);
            }
            for (int v = 0; v < VECTORS; v++) {
                before[v] = 0.0f;
                now[v] = sectoral;
            }
            for (int l = m; l <= degree; l++) {
                const int k = l * (l + 1);
                const float a = step_kf[2 * (k + m)], b = step_kf[2 * (k + m) + 1];
                vecf cosine[CHANNELS], sine[CHANNELS];
                for (int c = 0; c < CHANNELS; c++) cosine[c] = sine[c] = 0.0f;
                for (int v = 0; v < VECTORS; v++) {
                    if (l > m) {
                        const vecf next = a * (z[v] * now[v] - b * before[v]);
                        before[v] = now[v];
                        now[v] = next;
                    }
                    const vecf even = now[v] * re[v], odd = now[v] * im[v];
                    for (int c = 0; c < CHANNELS; c++) {
                        cosine[c] = even * light[c * VECTORS + v] + cosine[c];
                        sine[c] = odd * light[c * VECTORS + v] + sine[c];
                    }
                }
                for (int c = 0; c < CHANNELS; c++) {
                    sums[(k + m) * CHANNELS + c] += total_of(cosine[c]);
                    if (m > 0) sums[(k - m) * CHANNELS + c] += total_of(sine[c]);
                }
            }
        }
    }
}
