/* BC6H, signed (DXGI_FORMAT_BC6H_SF16, the "BC6H format" of Direct3D 11; BPTC signed float of OpenGL 4.2): each block
 * of 4 x 4 texels of three components becomes 128 bits: a mode, two endpoints a, b of three components, and sixteen
 * 4-bit levels q_t. Only the modes with one region are written:
 *
 *   mode bits  3: a, b of 10 bits       mode bits  7: a of 11 bits, b - a of 9
 *   mode bits 11: a of 12, b - a of 8   mode bits 15: a of 16, b - a of 4
 *
 * The decoder spreads endpoints to -32767..32767 (unquantise), interpolates there with integers,
 *
 *   u = (A (64 - w_q) + B w_q + 32) >> 6,
 *
 * and reads sign u, |u| 31 >> 5 as the sign and the lower 15 bits of a binary16. All of it is exact.
 *
 * The encoder minimises the squared error of the values, not of their bits. It starts from two lines, the principal
 * axis of the bits with each component weighted by its largest unit in the last place, and that of the values; it
 * alternates levels (nearest of the 16 decoded colours) and endpoints (least squares in the bits, weighted by the
 * local unit), tries every mode, and at last moves single endpoint codes by 1 while that helps.
 *
 *   coeffs_khwc   (k, h, w, c) float32; magnitudes beyond 65504 are taken as 65504
 *   blocks_gbj    (g, b, 2) 64-bit words, low one first. Blocks b run along x, then y.
 *   refused_gb    (g, b) 1 where the decoder does not know the mode, or an endpoint means infinity
 *
 * With 3 channels a texel is the pixel and group g the coefficient k. With 1 channel the components are the
 * planes k = 3g, 3g+1, 3g+2; planes beyond the last are zeros when encoding and dropped when decoding. Blocks that
 * reach over an edge repeat the last row and column.
 *
 * Work-item (b, g).
 */
#include "codec/half_range.clh"
#include "common/lanes.clh"

#if !defined(CHANNELS) || (CHANNELS != 1 && CHANNELS != 3)
#error "CHANNELS must be defined: 3, or 1 for texels of three planes"
#endif


#define MAP_OF(g, m) (CHANNELS == 3 ? (g) : 3 * (g) + (m))
#define MODES 4

constant int mode_bits[MODES] = {3, 7, 11, 15};
constant int base_bits[MODES] = {10, 11, 12, 16};
constant int delta_bits[MODES] = {10, 9, 8, 4}; /* of mode 0: of the second endpoint itself */
constant int weights[16] = {0, 4, 9, 13, 17, 21, 26, 30, 34, 38, 43, 47, 51, 55, 60, 64};

/* Texel t of component m of block (g, y, x). */
size_t texel_offset(int g, int m, int y, int x, int t, int size_h, int size_w)
{
    const int row = LESSER(4 * y + t / 4, size_h - 1), column = LESSER(4 * x + t % 4, size_w - 1);
    return (((size_t)MAP_OF(g, m) * size_h + row) * size_w + column) * CHANNELS + (CHANNELS == 3 ? m : 0);
}

/* Endpoint code of some bits to -32767..32767. */
int unquantise(int code, int bits)
{
    const int magnitude = code < 0 ? -code : code;
    if (bits == 16)
        return code;
    const int spread = magnitude == 0                        ? 0
                       : magnitude >= (1 << (bits - 1)) - 1 ? 32767
                                                             : ((magnitude << 15) + 0x4000) >> (bits - 1);
    return code < 0 ? -spread : spread;
}

/* Nearly the nearest code; the search moves it where a neighbour is better. */
int quantise(float u, int bits)
{
    const int top = (1 << (bits - 1)) - 1;
    const float magnitude = u < 0.0f ? -u : u;
    const float code = bits == 16 ? magnitude + 0.5f : magnitude / (float)(1 << (16 - bits));
    const int rounded = (int)LESSER(code, (float)top);
    return u < 0.0f ? -rounded : rounded;
}

/* Level q between two spread endpoints, as bits of binary16 without sign, and the sign. */
int interpolate(int a, int b, int q)
{
    const int u = (a * (64 - weights[q]) + b * weights[q] + 32) >> 6;
    return u < 0 ? -((-u * 31) >> 5) : (u * 31) >> 5;
}

float half_value(int signed_bits)
{
    const int bits = signed_bits < 0 ? -signed_bits : signed_bits;
    const float magnitude = bits < 1024 ? (float)bits * 0x1p-24f : as_float((bits << 13) + (112 << 23));
    return signed_bits < 0 ? -magnitude : magnitude;
}

/* The same continued between the codes, and scaled by 32/31 to the range of endpoints. */
OF_VECTORS float16 bits_of(float16 x)
{
    const float16 magnitude = x < 0.0f ? -x : x;
    /* 2^23 units make a binade of float32; the subtraction is exact, for it is of integers. */
    const int16 offset = as_int16(magnitude) - (112 << 23);
    const float16 large = (float16)(1024.0f) + CONVERT(offset - (1 << 23), float16) * 0x1p-13f;
    const float16 u = (magnitude < 0x1p-14f ? magnitude * 0x1p24f : large) * (32.0f / 31.0f);
    return x < 0.0f ? -u : u;
}

/* Size of a step of the bits at x: 2^-24 2^(exponent + 14). */
OF_VECTORS float16 unit_at(float16 x)
{
    const float16 magnitude = x < 0.0f ? -x : x;
    const float16 power = as_float16(as_int16(magnitude) & 0x7F800000);
    return GREATER(power, 0x1p-14f) * 0x1p-10f;
}

OF_VECTORS float total(float16 v)
{
    const float8 a = v.lo + v.hi;
    const float4 b = a.lo + a.hi;
    return (b.x + b.y) + (b.z + b.w);
}

OF_VECTORS float least(float16 v)
{
    const float8 a = LESSER(v.lo, v.hi);
    const float4 b = LESSER(a.lo, a.hi);
    const float c = LESSER(b.x, b.y), d = LESSER(b.z, b.w);
    return LESSER(c, d);
}

/* A line's description: what goes into the block, its levels, and its squared error. */
typedef struct {
    int mode;
    int ends[2][3];
    float16 levels;
    float error;
} Line;

/* Levels and error of the line whose mode and ends are given. */
void measure(Line *line, const float16 x[3])
{
    float palette[3][16];
    const int bits = base_bits[line->mode];
    for (int m = 0; m < 3; m++) {
        const int a = unquantise(line->ends[0][m], bits), b = unquantise(line->ends[1][m], bits);
        for (int q = 0; q < 16; q++)
            palette[m][q] = half_value(interpolate(a, b, q));
    }
    float16 nearest = INFINITY, levels = 0.0f;
    for (int q = 0; q < 16; q++) {
        const float16 dx = x[0] - palette[0][q], dy = x[1] - palette[1][q], dz = x[2] - palette[2][q];
        const float16 square = dx * dx + dy * dy + dz * dz;
        const int16 nearer = square < nearest;
        nearest = nearer ? square : nearest;
        levels = nearer ? (float16)((float)q) : levels;
    }
    line->levels = levels;
    line->error = total(nearest);
}

int reach_of(int mode)
{
    return mode == 0 ? 1 << 20 : (1 << (delta_bits[mode] - 1)) - 1; /* symmetric: ends may have to be swapped */
}

/* Try the ends, in units of spread endpoints, in every mode; keep what is better than `best`. */
void try_ends(Line *best, const float ends[2][3], const float16 x[3])
{
    for (int mode = 0; mode < MODES; mode++) {
        Line line;
        line.mode = mode;
        for (int m = 0; m < 3; m++) {
            const int a = quantise(ends[0][m], base_bits[mode]), b = quantise(ends[1][m], base_bits[mode]);
            const int reach = reach_of(mode);
            line.ends[0][m] = a;
            line.ends[1][m] = WITHIN(b, a - reach, a + reach);
        }
        measure(&line, x);
        if (line.error < best->error)
            *best = line;
    }
}

/* Ends of the principal axis through the mean of y, at the extremes. */
void principal_ends(float ends[2][3], const float16 y[3])
{
    float mean[3], axis[3];
    float16 d[3];
    for (int m = 0; m < 3; m++) {
        mean[m] = total(y[m]) * 0.0625f;
        d[m] = y[m] - mean[m];
    }
    const float xx = total(d[0] * d[0]), yy = total(d[1] * d[1]), zz = total(d[2] * d[2]);
    const float xy = total(d[0] * d[1]), xz = total(d[0] * d[2]), yz = total(d[1] * d[2]);
    /* From the direction of the largest variance, which may at worst miss the axis that the refinement then finds. */
    axis[0] = xx >= yy && xx >= zz ? xx : yy >= zz ? xy : xz;
    axis[1] = xx >= yy && xx >= zz ? xy : yy >= zz ? yy : yz;
    axis[2] = xx >= yy && xx >= zz ? xz : yy >= zz ? yz : zz;
    for (int i = 0; i < 8; i++) {
        const float ax = axis[0], ay = axis[1], az = axis[2];
        const float longest = GREATER(GREATER(ax * ax, ay * ay), az * az);
        const float scale = longest > 1e-36f ? 1.0f / (xx + yy + zz) : 0.0f;
        axis[0] = (xx * ax + xy * ay + xz * az) * scale;
        axis[1] = (xy * ax + yy * ay + yz * az) * scale;
        axis[2] = (xz * ax + yz * ay + zz * az) * scale;
    }
    const float square = axis[0] * axis[0] + axis[1] * axis[1] + axis[2] * axis[2];
    const float inverse = square > 1e-36f ? 1.0f / square : 0.0f;
    const float16 along = (d[0] * axis[0] + d[1] * axis[1] + d[2] * axis[2]) * inverse;
    const float low = least(along), high = -least(-along);
    for (int m = 0; m < 3; m++) {
        ends[0][m] = mean[m] + low * axis[m];
        ends[1][m] = mean[m] + high * axis[m];
    }
}

/* Ends that are best for the levels, by least squares in the bits. */
void refine_ends(float ends[2][3], const Line *line, const float16 u[3], const float16 unit[3])
{
    float share[16];
    AT(private, float16, share) = line->levels;
    for (int t = 0; t < 16; t++)
        share[t] = weights[(int)share[t]] * (1.0f / 64.0f);
    const float16 s = AT(private, float16, share), r = 1.0f - s;
    for (int m = 0; m < 3; m++) {
        const float16 weight = unit[m] * unit[m];
        const float aa = total(weight * r * r), ab = total(weight * r * s), bb = total(weight * s * s);
        const float a = total(weight * r * u[m]), b = total(weight * s * u[m]);
        const float determinant = aa * bb - ab * ab;
        if (determinant > 1e-5f * aa * bb) {
            const float inverse = 1.0f / determinant;
            ends[0][m] = WITHIN((a * bb - b * ab) * inverse, -32767.0f, 32767.0f);
            ends[1][m] = WITHIN((b * aa - a * ab) * inverse, -32767.0f, 32767.0f);
        } else {
            for (int e = 0; e < 2; e++)
                ends[e][m] = (float)unquantise(line->ends[e][m], base_bits[line->mode]);
        }
    }
}

/* Move single endpoint codes by 1 while that lowers the error, some sweeps at most. */
void polish(Line *best, const float16 x[3])
{
    const int top = (1 << (base_bits[best->mode] - 1)) - 1, reach = reach_of(best->mode);
    for (int sweep = 0; sweep < 4; sweep++) {
        const float before = best->error;
        for (int i = 0; i < 12; i++) {
            const int e = i / 6, m = i / 2 % 3;
            Line line = *best;
            const int code = line.ends[e][m] + (i % 2 ? 1 : -1), delta = code - line.ends[1 - e][m];
            if (code < -top || code > top || delta < -reach || delta > reach)
                continue;
            line.ends[e][m] = code;
            measure(&line, x);
            if (line.error < best->error)
                *best = line;
        }
        if (!(best->error < before))
            break;
    }
}

kernel void encode_bc6h_gbj(global ulong *restrict blocks_gbj, global const float *restrict coeffs_khwc,
                            const int size_k, const int size_h, const int size_w)
{
    const int rows = (size_h + 3) / 4, columns = (size_w + 3) / 4;
    const int b = get_global_id(0), g = get_global_id(1);
    if (b >= rows * columns)
        return;
    float16 x[3], u[3], unit[3], weighted[3];
    float largest_unit[3];
    for (int m = 0; m < 3; m++) {
        float texels[16];
        for (int t = 0; t < 16; t++) {
            const float value =
                MAP_OF(g, m) < size_k
                    ? coeffs_khwc[texel_offset(g, m, b / columns, b % columns, t, size_h, size_w)]
                    : 0.0f;
            texels[t] = WITHIN(value, -LARGEST, LARGEST);
        }
        x[m] = AT(private, float16, texels);
        u[m] = bits_of(x[m]);
        unit[m] = unit_at(x[m]);
        largest_unit[m] = -least(-unit[m]);
        weighted[m] = u[m] * largest_unit[m];
    }

    Line best;
    best.error = INFINITY;
    for (int start = 0; start < 2; start++) {
        float ends[2][3];
        Line line;
        line.error = INFINITY;
        if (start == 0) {
            principal_ends(ends, weighted);
            for (int m = 0; m < 3; m++)
                for (int e = 0; e < 2; e++)
                    ends[e][m] /= largest_unit[m];
        } else {
            float16 values = 0.0f;
            principal_ends(ends, x);
            values.s012 = (float3)(ends[0][0], ends[0][1], ends[0][2]);
            values.s456 = (float3)(ends[1][0], ends[1][1], ends[1][2]);
            values = bits_of(WITHIN(values, -LARGEST, LARGEST));
            ends[0][0] = values.s0;
            ends[0][1] = values.s1;
            ends[0][2] = values.s2;
            ends[1][0] = values.s4;
            ends[1][1] = values.s5;
            ends[1][2] = values.s6;
        }
        try_ends(&line, ends, x);
        for (int round = 0; round < 2; round++) {
            refine_ends(ends, &line, u, unit);
            try_ends(&line, ends, x);
        }
        if (line.error < best.error)
            best = line;
    }
    polish(&best, x);

    /* The first level has no top bit, so it must be below 8. */
    const int swap = best.levels.s0 >= 8.0f;
    float levels[16];
    AT(private, float16, levels) = swap ? 15.0f - best.levels : best.levels;
    const int bits = base_bits[best.mode], deltas = delta_bits[best.mode];
    ulong base[3], other[3];
    for (int m = 0; m < 3; m++) {
        const int a = best.ends[swap][m], to = best.ends[1 - swap][m];
        base[m] = a & 0x3FF;
        other[m] = (best.mode == 0 ? to : to - a) & ((1 << deltas) - 1);
        for (int i = 10; i < bits; i++) /* the upper bits of the base, highest first */
            other[m] |= (ulong)((a >> i) & 1) << (deltas + bits - 1 - i);
    }
    ulong low = (ulong)mode_bits[best.mode] | base[0] << 5 | base[1] << 15 | base[2] << 25 | other[0] << 35 |
                other[1] << 45 | other[2] << 55;
    ulong high = other[2] >> 9 | (ulong)levels[0] << 1;
    for (int t = 1; t < 16; t++)
        high |= (ulong)levels[t] << (4 * t);
    global ulong *out = blocks_gbj + ((size_t)g * rows * columns + b) * 2;
    out[0] = low;
    out[1] = high;
}

int sign_extend(int value, int bits)
{
    return (value << (32 - bits)) >> (32 - bits);
}

kernel void decode_bc6h_khwc(global float *restrict coeffs_khwc, global uchar *restrict refused_gb,
                             global const ulong *restrict blocks_gbj, const int size_k, const int size_h,
                             const int size_w)
{
    const int rows = (size_h + 3) / 4, columns = (size_w + 3) / 4;
    const int b = get_global_id(0), g = get_global_id(1);
    if (b >= rows * columns)
        return;
    const size_t at = (size_t)g * rows * columns + b;
    const ulong low = blocks_gbj[2 * at], high = blocks_gbj[2 * at + 1];
    int mode = 0, known = 0;
    for (int i = 0; i < MODES; i++)
        if ((low & 31) == mode_bits[i]) {
            mode = i;
            known = 1;
        }
    const int bits = base_bits[mode], deltas = delta_bits[mode];
    const int others[3] = {(int)(low >> 35) & 0x3FF, (int)(low >> 45) & 0x3FF, (int)(low >> 55 | (high & 1) << 9)};
    for (int m = 0; m < 3; m++) {
        int a = (int)(low >> (5 + 10 * m)) & 0x3FF;
        for (int i = 10; i < bits; i++)
            a |= ((others[m] >> (deltas + bits - 1 - i)) & 1) << i;
        a = sign_extend(a, bits);
        int to = sign_extend(others[m] & ((1 << deltas) - 1), deltas);
        if (mode > 0)
            to = sign_extend(a + to, bits);
        known &= a >= -32767 && to >= -32767; /* 16 bits could say -32768, which decodes to infinity */
        a = unquantise(a, bits);
        to = unquantise(to, bits);
        for (int t = 0; t < 16; t++) {
            if (4 * (b / columns) + t / 4 >= size_h || 4 * (b % columns) + t % 4 >= size_w || MAP_OF(g, m) >= size_k)
                continue;
            const int level = t == 0 ? (int)(high >> 1) & 7 : (int)(high >> (4 * t)) & 15;
            coeffs_khwc[texel_offset(g, m, b / columns, b % columns, t, size_h, size_w)] =
                half_value(interpolate(a, to, level));
        }
    }
    refused_gb[at] = (uchar)!known;
}
