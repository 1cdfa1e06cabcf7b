/* Normals with matte terms and gloss of each pixel, by Gauss-Newton steps with non-negative weights.
 *
 * A sample, in units of the pixel's reference, is  sum_m c_m B_m(n),  c >= 0, with s = n . l, v = n . view, h = n . half:
 *   matte   s,  s^2,  s / (s + v)                                             (Lambert; limb-darkened; Lommel-Seeliger)
 *   lobe j  s a^4 / ((h^2 (a^2 - 1) + 1)^2 (half . view)^2)                  (Trowbridge-Reitz with Kelemen's visibility)
 * Each step weights samples by their residual and solves for c and the turn of n at once, by coordinate descent.
 *
 *   normal_dq      (3, Q) float       out: unit vectors, 0 where a pixel is black; Q a multiple of VECTOR
 *   albedo_cq      (C, Q) float       out: radiance of the matte terms under a light along n
 *   confidence_q   (Q) float          out: 1 less the mean residual, each up to LOST of the reference, over LOST
 *   error_q, count_q (Q) float        out: sum of u / (1 + u), u = (residual / held_to)^2, of lit samples that are not fitted; how many
 *   sample_ciq     (C, I, Q) float    linear radiance, of near lights times the squared distance
 *   light_id       (I, 3) float       unit vectors to the lights; where NEAR, positions
 *   view_dq        (3, Q) float       unit vectors to the camera
 *   place_dq       (3, Q) float       positions of pixels, used where NEAR
 *   fitted_i       (I) int            0: a light that is left out and predicted
 *   lobe_jb        (J, 2) float       a^2 - 1 and a^4 of each lobe
 *   scale_s        (S) float          residual, as a share of model and reference, at which a weight is 1/2, step by step
 *   most           float              samples from here on are clipped
 *   share          float              what shadows hold, as a share of the reference
 *   held_to        float              residual, as a share of model and reference, that is half wrong
 *   kept           int                samples from the darkest up to the reference
 *   rounds         int                of coordinate descent in a step
 *
 *   VECTOR         pixels of a work-item: 4, 8 or 16
 *   ROOM, CHANNELS, LOBES    lights in private memory, C, J
 *   SECOND, THIRD, NEAR      1: the second matte term is used, the third, and lights are positions
 *   PULL                     how far a round of coordinate descent goes beyond the least
 *   DARK, SHADOW, LOST, LEAST_DETERMINANT
 *
 * clrelight.variation.reflectance does the same in NumPy and float64, but that the reference is bracketed to 2^-8 here.
 */
#include "variation/lit_pixels.clh"

#if !defined(ROOM) || !defined(CHANNELS) || !defined(LOBES) || !defined(SECOND) || !defined(THIRD) || !defined(NEAR)
#error "ROOM, CHANNELS, LOBES, SECOND, THIRD and NEAR must be defined"
#endif
#ifndef PULL
#error "PULL must be defined"
#endif
#if !defined(DARK) || !defined(SHADOW) || !defined(LOST) || !defined(LEAST_DETERMINANT)
#error "DARK, SHADOW, LOST and LEAST_DETERMINANT must be defined"
#endif

#define MATTE (1 + SECOND + THIRD)
#define WEIGHTS (MATTE + LOBES)
#define UNKNOWNS (WEIGHTS + 2)
#define RIDGE 1e-4f
#define DAMPING 1e-3f
#define MOST_TURN 0.15f

/* What a pixel is: its frame, the camera, where it lies, and the weights of its terms. */
typedef struct {
    vectors n, t, b, view, place;
    vecf seen, weight[WEIGHTS];
} pixels;

/* What the law says of one light: the sample and the matte part of it, its terms and how it turns with n, the cosine. */
typedef struct {
    vecf model, matte, cosine, term[UNKNOWNS];
} answers;

INLINE vecf dot3(const vectors a, const vectors b)
{
    return a.x * b.x + a.y * b.y + a.z * b.z;
}

INLINE vectors unit_of(const vectors v)
{
    const vecf scale = 1.0f / GREATER(root(dot3(v, v)), (vecf)TINY);
    const vectors out = {v.x * scale, v.y * scale, v.z * scale};
    return out;
}

INLINE vectors light_at(__global const float *restrict light_id, const int i, const vectors place)
{
    vectors out = {light_id[3 * i], light_id[3 * i + 1], light_id[3 * i + 2]};
#if NEAR
    out.x -= place.x;
    out.y -= place.y;
    out.z -= place.z;
    out = unit_of(out);
#endif
    return out;
}

/* Two vectors across n: Duff and others, Building an Orthonormal Basis, Revisited. */
INLINE void set_frame(pixels *p)
{
    const vectors n = p->n;
    const vecf sign = n.z >= 0.0f ? (vecf)1.0f : (vecf)-1.0f, a = -1.0f / (sign + n.z), c = n.x * n.y * a;
    p->t.x = 1.0f + sign * n.x * n.x * a;
    p->t.y = sign * c;
    p->t.z = -sign * n.x;
    p->b.x = c;
    p->b.y = sign + n.y * n.y * a;
    p->b.z = -n.y;
    const vecf seen = dot3(n, p->view);
    p->seen = GREATER(seen, (vecf)0.1f);
}

INLINE answers answer(const pixels *p, const vectors l, __global const float *restrict lobe_jb)
{
    answers out;
    const vecf raw = dot3(p->n, l), s = GREATER(raw, (vecf)0.0f), lit = raw > 0.0f ? (vecf)1.0f : (vecf)0.0f;
    vecf by_light = p->weight[0], by_half = 0.0f, by_view = 0.0f;
    out.cosine = raw;
    out.term[0] = s;
    out.matte = p->weight[0] * s;
#if SECOND
    out.term[1] = s * s;
    out.matte += p->weight[1] * out.term[1];
    by_light += 2.0f * p->weight[1] * s;
#endif
#if THIRD
    const vecf both = 1.0f / (s + p->seen), limb = p->weight[MATTE - 1] * both * both;
    out.term[MATTE - 1] = s * both;
    out.matte += p->weight[MATTE - 1] * s * both;
    by_light += limb * p->seen;
    by_view = -limb * s;
#endif
    out.model = out.matte;
    const vecf lt = dot3(p->t, l), lb = dot3(p->b, l), vt = dot3(p->t, p->view), vb = dot3(p->b, p->view);
#if LOBES
    const vecf across = 2.0f + 2.0f * dot3(p->view, l), wide = root(GREATER(across, (vecf)0.16f));
    const vecf inverse = 1.0f / wide, facing = (raw + dot3(p->n, p->view)) * inverse;
    const vecf h = GREATER(facing, (vecf)0.0f), visible = 4.0f * inverse * inverse;
    for (int j = 0; j < LOBES; j++) {
        const float e = lobe_jb[2 * j], peak = lobe_jb[2 * j + 1];
        const vecf x = 1.0f / (h * h * e + 1.0f), d = x * x * visible * peak, weighted = p->weight[MATTE + j] * d;
        out.term[MATTE + j] = d * s;
        out.model += weighted * s;
        by_light += weighted;
        by_half -= weighted * x * (4.0f * e);
    }
    by_half *= inverse * h * s;
#endif
    by_light *= lit;
    out.term[WEIGHTS] = by_light * lt + by_half * (lt + vt) + by_view * vt;
    out.term[WEIGHTS + 1] = by_light * lb + by_half * (lb + vb) + by_view * vb;
    return out;
}

/* Least squares over all fitted samples: where the steps start. */
INLINE vectors plain(const vecf *lit, __global const float *restrict light_id, __global const int *restrict fitted_i,
                     const vectors place, const int size_i)
{
    vecf a = 0.0f, b = 0.0f, c = 0.0f, d = 0.0f, e = 0.0f, f = 0.0f, x = 0.0f, y = 0.0f, z = 0.0f;
    for (int i = 0; i < size_i; i++) {
        const vectors l = light_at(light_id, i, place);
        const float fitted = fitted_i[i] ? 1.0f : 0.0f;
        const vecf p = l.x * fitted, q = l.y * fitted, r = l.z * fitted, value = ABSOLUTE(lit[i]);
        a += p * l.x;
        b += p * l.y;
        c += p * l.z;
        d += q * l.y;
        e += q * l.z;
        f += r * l.z;
        x += p * value;
        y += q * value;
        z += r * value;
    }
    const vecf unit = 1.0f / GREATER(a + d + f, (vecf)TINY);
    a *= unit, b *= unit, c *= unit, d *= unit, e *= unit, f *= unit;
    const vecf df = d * f - e * e, cb = c * e - b * f, be = b * e - c * d;
    const vecf af = a * f - c * c, bc = b * c - a * e, ad = a * d - b * b;
    const vecf determinant = a * df + b * cb + c * be;
    const veci sound = determinant > LEAST_DETERMINANT;
    vectors found;
    found.x = sound ? df * x + cb * y + be * z : (vecf)0.0f;
    found.y = sound ? cb * x + af * y + bc * z : (vecf)0.0f;
    found.z = sound ? be * x + bc * y + ad * z : (vecf)1.0f;
    return unit_of(found);
}

/* A bracket from above of the sample that `wanted` of the fitted do not exceed. */
INLINE vecf reference_of(const vecf *lit, __global const int *restrict fitted_i, const int size_i, const int wanted,
                           const vecf greatest)
{
    vecf low = 0.0f, high = greatest;
    for (int step = 0; step < 8; step++) {
        const vecf middle = 0.5f * (low + high);
        veci count = 0;
        for (int i = 0; i < size_i; i++) count -= fitted_i[i] ? (ABSOLUTE(lit[i]) <= middle) : (veci)0;
        const veci enough = count >= wanted;
        high = enough ? middle : high;
        low = enough ? low : middle;
    }
    return high;
}

/* One step: weights of the terms, and n turned. */
INLINE void turn(pixels *p, const vecf gram[UNKNOWNS][UNKNOWNS], const vecf *right, const int rounds)
{
    vecf x[UNKNOWNS], diagonal[UNKNOWNS], inverse[UNKNOWNS], trace = 0.0f;
    for (int k = 0; k < WEIGHTS; k++) {
        x[k] = p->weight[k];
        trace += gram[k][k];
    }
    x[WEIGHTS] = x[WEIGHTS + 1] = 0.0f;
    const vecf ridge = RIDGE * trace + 1e-9f, damping = DAMPING * (gram[WEIGHTS][WEIGHTS] + gram[WEIGHTS + 1][WEIGHTS + 1]) + 1e-9f;
    for (int k = 0; k < UNKNOWNS; k++) {
        diagonal[k] = gram[k][k] + (k < WEIGHTS ? ridge : damping);
        inverse[k] = 1.0f / diagonal[k];
    }
    for (int round = 0; round < rounds; round++) {
        for (int k = 0; k < UNKNOWNS; k++) {
            vecf left = right[k] - diagonal[k] * x[k];
            for (int j = 0; j < UNKNOWNS; j++)
                if (j != k) left -= (j < k ? gram[j][k] : gram[k][j]) * x[j];
            x[k] += PULL * left * inverse[k];
            if (k < WEIGHTS) x[k] = GREATER(x[k], (vecf)0.0f);
        }
    }
    for (int k = 0; k < WEIGHTS; k++) p->weight[k] = x[k];
    const vecf size = root(x[WEIGHTS] * x[WEIGHTS] + x[WEIGHTS + 1] * x[WEIGHTS + 1]);
    const vecf scale = size > MOST_TURN ? MOST_TURN / size : (vecf)1.0f;
    const vecf u = x[WEIGHTS] * scale, w = x[WEIGHTS + 1] * scale;
    p->n.x += u * p->t.x + w * p->b.x;
    p->n.y += u * p->t.y + w * p->b.y;
    p->n.z += u * p->t.z + w * p->b.z;
    p->n = unit_of(p->n);
    set_frame(p);
}

__kernel void solve_reflectance_dq(
    __global float *restrict normal_dq, __global float *restrict albedo_cq, __global float *restrict confidence_q,
    __global float *restrict error_q, __global float *restrict count_q, __global const float *restrict sample_ciq,
    __global const float *restrict light_id, __global const float *restrict view_dq, __global const float *restrict place_dq,
    __global const int *restrict fitted_i, __global const float *restrict lobe_jb,
    __global const float *restrict scale_s, const float most, const float share, const float held_to, const int kept, const int rounds,
    const int size_i, const int size_q, const int size_s)
{
    const int q = get_global_id(0) * VECTOR;
    vecf lit[ROOM]; /* the channels' mean, negative where one is clipped; later in units of the reference */
    vecf least = MAXFLOAT, greatest = 0.0f;
    for (int i = 0; i < size_i; i++) {
        veci clipped;
        const vecf grey = grey_of(sample_ciq, i, q, size_i, size_q, most, &clipped);
        lit[i] = clipped ? -grey : grey;
        if (fitted_i[i]) {
            least = LESSER(least, grey);
            greatest = GREATER(greatest, grey);
        }
    }
    pixels p;
    p.view.x = LOAD(view_dq + q), p.view.y = LOAD(view_dq + size_q + q), p.view.z = LOAD(view_dq + 2L * size_q + q);
    p.place = p.view;
#if NEAR
    p.place.x = LOAD(place_dq + q), p.place.y = LOAD(place_dq + size_q + q), p.place.z = LOAD(place_dq + 2L * size_q + q);
#endif
    p.n = plain(lit, light_id, fitted_i, p.place, size_i);
    set_frame(&p);
    for (int k = 0; k < WEIGHTS; k++) p.weight[k] = 0.0f;
    const vecf high = reference_of(lit, fitted_i, size_i, kept, greatest), held = share * high;
    const vecf offset = LESSER(least, held), unit = 1.0f / GREATER(high, (vecf)TINY);
    for (int i = 0; i < size_i; i++) {
        const vecf raised = (ABSOLUTE(lit[i]) - offset) * unit;
        lit[i] = (lit[i] < 0.0f && high > TINY) ? -1.0f - raised : raised;
    }
    for (int step = -1; step < size_s; step++) {
        vecf gram[UNKNOWNS][UNKNOWNS], right[UNKNOWNS];
        for (int k = 0; k < UNKNOWNS; k++) {
            right[k] = 0.0f;
            for (int j = k; j < UNKNOWNS; j++) gram[k][j] = 0.0f;
        }
        const float inverse = step < 0 ? 0.0f : 1.0f / scale_s[step < 0 ? 0 : step], dark = step < 0 ? 0.5f * DARK : DARK;
        for (int i = 0; i < size_i; i++) {
            if (!fitted_i[i]) continue;
            const answers said = answer(&p, light_at(light_id, i, p.place), lobe_jb);
            const vecf span = 1.0f / ((step < 0 ? lit[i] : said.model) + 1.0f);
            const vecf off = (lit[i] - said.model) * span * inverse, counted = span * span / (1.0f + off * off);
            const vecf weight = ((said.cosine > dark) & (lit[i] > SHADOW)) ? counted : (vecf)0.0f;
            for (int k = 0; k < UNKNOWNS; k++) {
                const vecf weighted = weight * said.term[k];
                right[k] += weighted * lit[i];
                for (int j = k; j < UNKNOWNS; j++) gram[k][j] += weighted * said.term[j];
            }
        }
        turn(&p, gram, right, step < 0 ? 3 * rounds : rounds);
    }
    vecf lost = 0.0f, error = 0.0f, count = 0.0f, whole = 0.0f, shaded = 0.0f, sum[CHANNELS];
    for (int c = 0; c < CHANNELS; c++) sum[c] = 0.0f;
    const float last = 1.0f / scale_s[size_s - 1];
    for (int i = 0; i < size_i; i++) {
        const answers said = answer(&p, light_at(light_id, i, p.place), lobe_jb);
        const vecf off = ABSOLUTE(lit[i] - said.model);
        const veci shown = (said.cosine > DARK) & (lit[i] > SHADOW);
        if (!fitted_i[i]) {
            const vecf far = off / (said.model + 1.0f) * (1.0f / held_to), square = far * far;
            error += shown ? square / (1.0f + square) : (vecf)0.0f;
            count += shown ? (vecf)1.0f : (vecf)0.0f;
            continue;
        }
        const vecf clear = lit[i] < 0.0f ? (vecf)LOST : off;
        lost += LESSER(clear, (vecf)LOST);
        const vecf span = 1.0f / (said.model + 1.0f), far = off * span * last;
        const vecf counted = said.matte * said.matte * span * span * span * span / (1.0f + far * far);
        const vecf weight = shown ? counted : (vecf)0.0f;
        whole += weight * said.model * said.model;
        shaded += weight * said.model;
        for (int c = 0; c < CHANNELS; c++) sum[c] += weight * said.model * LOAD(sample_ciq + ((long)c * size_i + i) * size_q + q);
    }
    vecf matte = p.weight[0];
#if SECOND
    matte += p.weight[1];
#endif
#if THIRD
    matte += p.weight[MATTE - 1] / (1.0f + p.seen);
#endif
    const vecf scale = whole > TINY ? matte / whole : (vecf)0.0f;
    for (int c = 0; c < CHANNELS; c++) {
        const vecf albedo = (sum[c] - offset * shaded) * scale;
        STORE(albedo > 0.0f ? albedo : (vecf)0.0f, albedo_cq + (long)c * size_q + q);
    }
    const veci found = high > TINY;
    STORE(found ? p.n.x : (vecf)0.0f, normal_dq + q);
    STORE(found ? p.n.y : (vecf)0.0f, normal_dq + size_q + q);
    STORE(found ? p.n.z : (vecf)0.0f, normal_dq + 2L * size_q + q);
    STORE(found ? 1.0f - lost * (1.0f / (LOST * size_i)) : (vecf)0.0f, confidence_q + q);
    STORE(error, error_q + q);
    STORE(count, count_q + q);
}
