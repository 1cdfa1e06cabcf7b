/* Reflected light by brute force, B(n) = sum_t w_t L_t rho(theta_i, theta_o, phi) (frequency-space-environment-maps, eq. 2).
 *
 *   out_cn        (C, N) float       radiance; N a multiple of VECTOR
 *   central_dn    (3, N) float       x, y, z of the unit central direction C of each point
 *   view_dn       (3, N) float       of the unit view V
 *   texel_tj      (T, 3 + C) float   x, y, z of the unit direction s, then w L of each channel (w in steradian)
 *   edge                             texels count where C . s >= edge, -2 for all: the truncated lobe of appendix D
 *   number                           exponent, or 1 / sigma
 *   scale                            factor on the reflectance
 *
 * LOBE 0: max(C . s, 0)^number (Phong). LOBE 1: exp(-(theta_h number)^2) where N . s > 0, N halfway between C and V
 * (eq. 11). LOBE 2: max(cos(theta_i - theta_o), 0)^number (Kajiya and Kay).
 * A work-item takes VECTOR points, their sums in registers, over RUN texels at a time. Powers and exponentials are taken
 * four lanes at a time, where one of the four is within the edge.
 * |error| <= eps32 (RUN + T / RUN + 8 (1 + number^2)) B
 */
#include "common/lanes.clh"
#include "common/vector.clh"

#if !defined(CHANNELS) || !defined(RUN) || !defined(LOBE)
#error "CHANNELS (1 or 3), RUN (texels) and LOBE (0, 1 or 2) must be defined"
#endif

#define FOURS (VECTOR / 4)

typedef union {
    vecf all;
    float4 four[FOURS];
    float each[VECTOR];
} lanes_of;

/* The lobe from the cosines of s to C, V and N, and of V to C and N. */
INLINE float4 lobe(const float4 to_central, const float4 to_view, const float4 to_normal, const float4 view_central,
                   const float4 view_normal, const float number)
{
#if LOBE == 1
    const float4 length = root(GREATER(2.0f + 2.0f * to_view, 1e-12f));
    const float4 cosine = WITHIN((to_normal + view_normal) / length, -1.0f, 1.0f);
    const float4 facet = acos(cosine) * number;
    return to_normal > 0.0f ? exp(-facet * facet) : (float4)0.0f;
#else
#if LOBE == 2
    const float4 across = root(GREATER(1.0f - to_central * to_central, 0.0f));
    const float4 base = to_central * view_central + across * root(GREATER(1.0f - view_central * view_central, 0.0f));
#else
    const float4 base = to_central;
#endif
    return base > 0.0f ? exp(number * log(GREATER(base, 1e-30f))) : (float4)0.0f;
#endif
}

__kernel void integrate_lobe_cn(__global float *restrict out_cn, __global const float *restrict central_dn,
                                __global const float *restrict view_dn, __global const float *restrict texel_tj,
                                const float edge, const float number, const float scale, const int size_n,
                                const int size_t)
{
    const int first = get_global_id(0) * VECTOR;
    lanes_of c[3], v[3], n[3], whole[CHANNELS], co, vn;
    for (int d = 0; d < 3; d++)
        for (int lane = 0; lane < VECTOR; lane++) {
            c[d].each[lane] = central_dn[(long)d * size_n + first + lane];
            v[d].each[lane] = view_dn[(long)d * size_n + first + lane];
        }
    co.all = c[0].all * v[0].all + c[1].all * v[1].all + c[2].all * v[2].all;
    for (int f = 0; f < FOURS; f++) {
        const float4 length = root(GREATER(2.0f + 2.0f * co.four[f], 1e-12f)); /* of C + V */
        for (int d = 0; d < 3; d++) n[d].four[f] = (c[d].four[f] + v[d].four[f]) / length;
    }
    vn.all = n[0].all * v[0].all + n[1].all * v[1].all + n[2].all * v[2].all;
    for (int k = 0; k < CHANNELS; k++) whole[k].all = 0.0f;
    for (int start = 0; start < size_t; start += RUN) {
        const int end = LESSER(start + RUN, size_t);
        lanes_of run[CHANNELS];
        for (int k = 0; k < CHANNELS; k++) run[k].all = 0.0f;
        for (int t = start; t < end; t++) {
            __global const float *texel = texel_tj + (long)t * (3 + CHANNELS);
            const float x = texel[0], y = texel[1], z = texel[2];
            lanes_of cosine;
            cosine.all = x * c[0].all + y * c[1].all + z * c[2].all;
            if (!any_lane(cosine.all >= edge)) continue;
            for (int f = 0; f < FOURS; f++) {
                if (!any_lane(cosine.four[f] >= edge)) continue;
                const float4 to_view = x * v[0].four[f] + y * v[1].four[f] + z * v[2].four[f];
                const float4 to_normal = x * n[0].four[f] + y * n[1].four[f] + z * n[2].four[f];
                const float4 value = lobe(cosine.four[f], to_view, to_normal, co.four[f], vn.four[f], number);
                const float4 within = cosine.four[f] >= edge ? value : (float4)0.0f;
                for (int k = 0; k < CHANNELS; k++) run[k].four[f] += texel[3 + k] * within;
            }
        }
        for (int k = 0; k < CHANNELS; k++) whole[k].all += run[k].all;
    }
    for (int k = 0; k < CHANNELS; k++)
        for (int lane = 0; lane < VECTOR; lane++)
            out_cn[(long)k * size_n + first + lane] = scale * whole[k].each[lane];
}
