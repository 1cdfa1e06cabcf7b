/* Scaled normals by iteratively reweighted least squares, rho n from rho n . l = b (illumination-variation, eq. 1-2).
 *
 *   scaled_dq      (3, Q) float       out: rho n of the channels' mean; Q a multiple of VECTOR
 *   albedo_cq      (C, Q) float       out: radiance under a light along n
 *   confidence_q   (Q) float          out: 1 less the mean residual, each up to LOST of the albedo, over LOST
 *   sample_ciq     (C, I, Q) float    linear radiance
 *   light_id       (I, 3) float       unit vectors to the lights
 *   inverse_di     (3, I) float       their pseudoinverse
 *   scale_s        (S) float          residual, as a share of the albedo, at which a weight is 1/2, step by step
 *   most           float              samples from here on are clipped
 *   share          float              what shadows hold, as a share of the albedo
 *   kept, dim      int                samples that count from the darkest; of them, those that the start leaves out
 *
 *   VECTOR         pixels of a work-item: 4, 8 or 16
 *   ROOM           lights that a pixel has private memory for, at least I
 *   CHANNELS       C
 *   DARK, SHADOW, LOST, LEAST_DETERMINANT   as clrelight/variation/normals.py has them
 *
 * clrelight.variation.normals does the same in NumPy, but that order statistics are bracketed here to 2^-8 of a pixel's
 * brightest sample, and systems solved in float: for directions of condition k, n is off by some k^2 eps32.
 */
#include "variation/lit_pixels.clh"

#if !defined(ROOM) || !defined(CHANNELS) || !defined(DARK) || !defined(SHADOW) || !defined(LOST)
#error "ROOM, CHANNELS, DARK, SHADOW and LOST must be defined"
#endif
#ifndef LEAST_DETERMINANT
#error "LEAST_DETERMINANT must be defined: of systems of trace 1"
#endif


typedef struct {
    vecf xx, xy, xz, yy, yz, zz, x, y, z;
} sums;

INLINE vecf length_of(const vectors v)
{
    return root(v.x * v.x + v.y * v.y + v.z * v.z);
}

INLINE void add(sums *s, const vecf weight, const vecf value, const float x, const float y, const float z)
{
    const vecf a = weight * x, b = weight * y, c = weight * z;
    s->xx += a * x;
    s->xy += a * y;
    s->xz += a * z;
    s->yy += b * y;
    s->yz += b * z;
    s->zz += c * z;
    s->x += a * value;
    s->y += b * value;
    s->z += c * value;
}

INLINE vectors solve(const sums s, const vectors before)
{
    const vecf trace = s.xx + s.yy + s.zz, unit = 1.0f / GREATER(trace, (vecf)TINY);
    const vecf a = s.xx * unit, b = s.xy * unit, c = s.xz * unit, d = s.yy * unit, e = s.yz * unit, f = s.zz * unit;
    const vecf df = d * f - e * e, cb = c * e - b * f, be = b * e - c * d;
    const vecf af = a * f - c * c, bc = b * c - a * e, ad = a * d - b * b;
    const vecf determinant = a * df + b * cb + c * be;
    const veci sound = determinant > LEAST_DETERMINANT;
    const vecf factor = unit / (sound ? determinant : (vecf)1.0f);
    const vecf x = s.x * factor, y = s.y * factor, z = s.z * factor;
    vectors found;
    found.x = sound ? df * x + cb * y + be * z : before.x;
    found.y = sound ? cb * x + af * y + bc * z : before.y;
    found.z = sound ? be * x + bc * y + ad * z : before.z;
    return found;
}

/* A bracket of the sample that `wanted` of them do not exceed. */
INLINE void bracket(const vecf *grey, const int size_i, const int wanted, const vecf greatest, vecf *low, vecf *high)
{
    *low = 0.0f;
    *high = greatest;
    for (int step = 0; step < 8; step++) {
        const vecf middle = 0.5f * (*low + *high);
        veci count = 0;
        for (int i = 0; i < size_i; i++) count -= ABSOLUTE(grey[i]) <= middle;
        const veci enough = count >= wanted;
        *high = enough ? middle : *high;
        *low = enough ? *low : middle;
    }
}

INLINE vecf weight_of(const vecf lit, const vecf shade, const vecf length, const vecf inverse)
{
    const vecf off = (lit - shade) * inverse, above = off > 0.0f ? off : (vecf)0.0f;
    const vecf weight = 1.0f / ((off * off + 1.0f) * (above * above + 1.0f));
    return ((shade > DARK * length) & (lit > SHADOW * length)) ? weight : (vecf)0.0f;
}

__kernel void solve_normals_dq(__global float *restrict scaled_dq, __global float *restrict albedo_cq,
                               __global float *restrict confidence_q, __global const float *restrict sample_ciq,
                               __global const float *restrict light_id, __global const float *restrict inverse_di,
                               __global const float *restrict scale_s, const float most, const float share, const int kept,
                               const int dim, const int size_i, const int size_q, const int size_s)
{
    const int q = get_global_id(0) * VECTOR;
    const sums none = {0.0f, 0.0f, 0.0f, 0.0f, 0.0f, 0.0f, 0.0f, 0.0f, 0.0f};
    vecf lit[ROOM]; /* the channels' mean, negative where one is clipped; later less what shadows hold, or -1 */
    vecf least = MAXFLOAT, greatest = 0.0f;
    vectors plain = {0.0f, 0.0f, 0.0f};
    for (int i = 0; i < size_i; i++) {
        veci clipped;
        const vecf grey = grey_of(sample_ciq, i, q, size_i, size_q, most, &clipped);
        lit[i] = clipped ? -grey : grey;
        least = LESSER(least, grey);
        greatest = GREATER(greatest, grey);
        plain.x += inverse_di[i] * grey;
        plain.y += inverse_di[size_i + i] * grey;
        plain.z += inverse_di[2 * size_i + i] * grey;
    }
    vecf low, bright, darkest = 0.0f, unused;
    bracket(lit, size_i, kept, greatest, &low, &bright);
    if (dim > 0) bracket(lit, size_i, dim + 1, greatest, &darkest, &unused);
    sums s = none;
    for (int i = 0; i < size_i; i++) {
        const vecf grey = lit[i];
        const vecf weight = ((grey >= darkest) & (grey <= bright)) ? (vecf)1.0f : (vecf)0.0f;
        add(&s, weight, grey, light_id[3 * i], light_id[3 * i + 1], light_id[3 * i + 2]);
    }
    vectors found = solve(s, plain);
    const vecf held = share * length_of(found), offset = LESSER(least, held);
    for (int i = 0; i < size_i; i++) lit[i] = ((lit[i] >= 0.0f) & (lit[i] <= bright)) ? lit[i] - offset : (vecf)-1.0f;
    for (int step = 0; step < size_s; step++) {
        const vecf length = length_of(found), inverse = 1.0f / GREATER(scale_s[step] * length, (vecf)TINY);
        s = none;
        for (int i = 0; i < size_i; i++) {
            const float x = light_id[3 * i], y = light_id[3 * i + 1], z = light_id[3 * i + 2];
            const vecf shade = x * found.x + y * found.y + z * found.z;
            add(&s, weight_of(lit[i], shade, length, inverse), lit[i], x, y, z);
        }
        found = solve(s, found);
    }
    const vecf length = length_of(found), inverse = 1.0f / GREATER(length, (vecf)TINY);
    const vecf last = inverse / scale_s[size_s - 1];
    vecf whole = 0.0f, shaded = 0.0f, lost = 0.0f, sum[CHANNELS];
    for (int c = 0; c < CHANNELS; c++) sum[c] = 0.0f;
    for (int i = 0; i < size_i; i++) {
        const float x = light_id[3 * i], y = light_id[3 * i + 1], z = light_id[3 * i + 2];
        const vecf shade = x * found.x + y * found.y + z * found.z;
        const vecf seen = shade > 0.0f ? shade : (vecf)0.0f;
        const vecf weight = weight_of(lit[i], shade, length, last) * seen * inverse;
        whole += weight * seen * inverse;
        shaded += weight;
        vecf total = 0.0f;
        for (int c = 0; c < CHANNELS; c++) {
            const vecf sample = LOAD(sample_ciq + ((long)c * size_i + i) * size_q + q);
            sum[c] += weight * sample;
            total += sample;
        }
        const vecf off = ABSOLUTE(total * (1.0f / CHANNELS) - offset - seen) * inverse;
        lost += LESSER(off, (vecf)LOST);
    }
    const vecf unit = 1.0f / GREATER(whole, (vecf)TINY);
    for (int c = 0; c < CHANNELS; c++) {
        const vecf albedo = (sum[c] - offset * shaded) * unit;
        STORE(albedo > 0.0f ? albedo : (vecf)0.0f, albedo_cq + (long)c * size_q + q);
    }
    STORE(found.x, scaled_dq + q);
    STORE(found.y, scaled_dq + size_q + q);
    STORE(found.z, scaled_dq + 2L * size_q + q);
    STORE(length > TINY ? 1.0f - lost * (1.0f / (LOST * size_i)) : (vecf)0.0f, confidence_q + q);
}
