/* Irradiance by brute force, E(n) = sum_t w_t L_t max(0, n . s_t) (irradiance-environment-maps, eq. 1).
 *
 *   out_cn        (C, N) float       irradiance; N a multiple of VECTOR
 *   normal_dn     (3, N) float       x, y, z of the unit normals
 *   texel_tj      (T, 3 + C) float   x, y, z of the unit direction s, then w L of each channel (w in steradian)
 *
 * A work-item takes VECTOR normals, their sums in registers, over RUN texels at a time, whose sums are then added up:
 * |error| <= eps32 (RUN + T / RUN + 4) E
 */
#include "common/lanes.clh"
#include "common/vector.clh"

#if !defined(CHANNELS) || !defined(RUN)
#error "CHANNELS (1 or 3) and RUN (texels) must be defined"
#endif

__kernel void integrate_hemisphere_cn(__global float *restrict out_cn, __global const float *restrict normal_dn,
                                      __global const float *restrict texel_tj, const int size_n, const int size_t)
{
    const int first = get_global_id(0) * VECTOR;
    vecf x, y, z, whole[CHANNELS];
    for (int lane = 0; lane < VECTOR; lane++) {
        ((float *)&x)[lane] = normal_dn[first + lane];
        ((float *)&y)[lane] = normal_dn[size_n + first + lane];
        ((float *)&z)[lane] = normal_dn[2L * size_n + first + lane];
    }
    for (int c = 0; c < CHANNELS; c++) whole[c] = 0.0f;
    for (int start = 0; start < size_t; start += RUN) {
        const int end = LESSER(start + RUN, size_t);
        vecf run[CHANNELS];
        for (int c = 0; c < CHANNELS; c++) run[c] = 0.0f;
        for (int t = start; t < end; t++) {
            __global const float *texel = texel_tj + (long)t * (3 + CHANNELS);
            const vecf cosine = texel[0] * x + texel[1] * y + texel[2] * z;
            const vecf seen = cosine > 0.0f ? cosine : (vecf)0.0f;
            for (int c = 0; c < CHANNELS; c++) run[c] = texel[3 + c] * seen + run[c];
        }
        for (int c = 0; c < CHANNELS; c++) whole[c] += run[c];
    }
    for (int c = 0; c < CHANNELS; c++)
        for (int lane = 0; lane < VECTOR; lane++)
            out_cn[(long)c * size_n + first + lane] = ((float *)(whole + c))[lane];
}
