/* S3TC-like coding of float texels (noise-resistant-fitting, section III-B-2): each block of 4 x 4 texels of three
 * components x_t becomes two endpoints a, b in float32 and sixteen 2-bit levels q_t in 0..3,
 *
 *   x_t ~ a + q_t (b - a)/3,
 *
 * 28 bytes of 192. The line starts as the block's principal axis through its mean, ends at the extremes of the
 * projection; then least squares gives the endpoints that are best for the levels, and the levels are chosen
 * anew, twice. Both steps can only lower the squared error.
 *
 *   coeffs_khwc   (k, h, w, c) float32, any finite values
 *   blocks_gjb    (g, 7, b) 32-bit words: a in j = 0..2 and b in 3..5 (bits of float32), levels in 6: texel
 *                 t = 4 row + column of the block has bits 2t and 2t+1. Blocks b run along x, then y.
 *
 * With 3 channels a texel is the pixel and group g the coefficient k. With 1 channel the components are the
 * planes k = 3g, 3g+1, 3g+2; planes beyond the last are zeros when encoding and dropped when decoding. Blocks that
 * reach over an edge repeat the last row and column.
 *
 * Error of the decoder: 2^-22 max(|a|,|b|) per value. A component that is constant over a block decodes exactly.
 *
 * A work-item handles LANES blocks side by side, each in one lane of a vector, along a row of blocks
 * (get_global_id(1) = g rows + row), in steps of the global size.
 */
#include "common/lanes.clh"

#if LANES == 8
typedef float8 real;
typedef int8 whole;
typedef uint8 word;
#define AS_REAL as_float8
#define AS_WORD as_uint8
#define REALS(space, p) AT(space, float8, p)
#define WORDS(space, p) AT(space, uint8, p)
#elif LANES == 1
typedef float real;
typedef int whole;
typedef uint word;
#define AS_REAL as_float
#define AS_WORD as_uint
#define REALS(space, p) (*(p))
#define WORDS(space, p) (*(p))
#else
#error "LANES must be defined: 8 blocks in the lanes of vectors (CPU) or 1 (GPU)"
#endif
#if !defined(CHANNELS) || (CHANNELS != 1 && CHANNELS != 3)
#error "CHANNELS must be defined: 3, or 1 for texels of three planes"
#endif

/* Adding and subtracting 1.5 2^23 rounds to an integer, which then is the low bits of the float. */
#define ROUNDER 12582912.0f

/* Index along k of component m of group g. */
#define MAP_OF(g, m) (CHANNELS == 3 ? (g) : 3 * (g) + (m))

/* A piece is four neighbouring floats of one block: of 12 interleaved ones, or of one plane's 4. */
#define PIECE_TEXEL(m, i) (CHANNELS == 3 ? (4 * (m) + (i)) / 3 : (i))
#define PIECE_COMPONENT(m, i) (CHANNELS == 3 ? (4 * (m) + (i)) % 3 : (m))

/* Offset of row y of what piece m reads, from the start of the map. */
size_t row_offset(int g, int m, int y, int size_h, int size_w)
{
    return ((size_t)MAP_OF(g, m) * size_h + y) * size_w * CHANNELS + (CHANNELS == 3 ? 4 * m : 0);
}

#if LANES == 8
/* Turn four pieces of blocks (0|4), (1|5), (2|6), (3|7) into four vectors over blocks 0..7, or back. */
void transpose(float8 v[4])
{
    const float8 a = (float8)(v[0].s0, v[1].s0, v[0].s1, v[1].s1, v[0].s4, v[1].s4, v[0].s5, v[1].s5);
    const float8 b = (float8)(v[2].s0, v[3].s0, v[2].s1, v[3].s1, v[2].s4, v[3].s4, v[2].s5, v[3].s5);
    const float8 c = (float8)(v[0].s2, v[1].s2, v[0].s3, v[1].s3, v[0].s6, v[1].s6, v[0].s7, v[1].s7);
    const float8 d = (float8)(v[2].s2, v[3].s2, v[2].s3, v[3].s3, v[2].s6, v[3].s6, v[2].s7, v[3].s7);
    v[0] = (float8)(a.s0, a.s1, b.s0, b.s1, a.s4, a.s5, b.s4, b.s5);
    v[1] = (float8)(a.s2, a.s3, b.s2, b.s3, a.s6, a.s7, b.s6, b.s7);
    v[2] = (float8)(c.s0, c.s1, d.s0, d.s1, c.s4, c.s5, d.s4, d.s5);
    v[3] = (float8)(c.s2, c.s3, d.s2, d.s3, c.s6, c.s7, d.s6, d.s7);
}

/* Eight whole blocks from column block b on. */
void load_whole(real x[3][16], global const float *restrict coeffs, int g, int y, int b, int size_k, int size_h,
                int size_w)
{
#pragma unroll
    for (int r = 0; r < 4; r++)
#pragma unroll
        for (int m = 0; m < 3; m++) {
            float8 v[4] = {(float8)(0.0f), (float8)(0.0f), (float8)(0.0f), (float8)(0.0f)};
            if (MAP_OF(g, m) < size_k) {
                global const float *p =
                    coeffs + row_offset(g, m, LESSER(4 * y + r, size_h - 1), size_h, size_w) + (size_t)b * 4 * CHANNELS;
#pragma unroll
                for (int i = 0; i < 4; i++)
                    v[i] = (float8)(AT(global const, float4, p + 4 * CHANNELS * i),
                                    AT(global const, float4, p + 4 * CHANNELS * (i + 4)));
                transpose(v);
            }
#pragma unroll
            for (int i = 0; i < 4; i++)
                x[PIECE_COMPONENT(m, i)][4 * r + PIECE_TEXEL(m, i)] = v[i];
        }
}
#endif

/* Any blocks: value by value, with the last row, column and block repeated. */
void load_edge(real x[3][16], global const float *restrict coeffs, int g, int y, int b, int size_k, int size_h,
               int size_w)
{
    for (int m = 0; m < 3; m++)
        for (int t = 0; t < 16; t++) {
            float lanes[LANES];
            for (int lane = 0; lane < LANES; lane++) {
                const int column = LESSER(4 * (b + lane) + t % 4, size_w - 1);
                const int row = LESSER(4 * y + t / 4, size_h - 1);
                const int k = MAP_OF(g, m);
                lanes[lane] = k < size_k ? coeffs[(((size_t)k * size_h + row) * size_w + column) * CHANNELS +
                                                  (CHANNELS == 3 ? m : 0)]
                                         : 0.0f;
            }
            x[m][t] = REALS(private, lanes);
        }
}

/* Endpoints (a, b) and levels of the blocks x, which is overwritten. */
void fit_line(real ends[6], word *levels, real x[3][16])
{
    /* Shift by the middle of each range and scale by a power of two to a half-range of 1 to 4: exact, cannot
       overflow, and puts any block from 1e-45 to 3e38 where squares are safe. */
    real centre[3], reach = 0.0f;
#pragma unroll
    for (int j = 0; j < 3; j++) {
        real low = x[j][0], high = x[j][0];
#pragma unroll
        for (int t = 1; t < 16; t++) {
            low = LESSER(low, x[j][t]);
            high = GREATER(high, x[j][t]);
        }
        const real half_range = 0.5f * high - 0.5f * low;
        centre[j] = low + half_range; /* low itself where constant */
        reach = GREATER(reach, half_range);
    }
    word exponent = AS_WORD(reach) >> 23;
    exponent = WITHIN(exponent, (word)(1), (word)(253));
    const real scale = AS_REAL(((word)(254) - exponent) << 23);
    const real unscale = AS_REAL(exponent << 23);

    real sum[3] = {0.0f, 0.0f, 0.0f};
    real xx = 0.0f, xy = 0.0f, xz = 0.0f, yy = 0.0f, yz = 0.0f, zz = 0.0f;
#pragma unroll
    for (int t = 0; t < 16; t++) {
        const real u = (x[0][t] - centre[0]) * scale;
        const real v = (x[1][t] - centre[1]) * scale;
        const real w = (x[2][t] - centre[2]) * scale;
        x[0][t] = u;
        x[1][t] = v;
        x[2][t] = w;
        sum[0] += u;
        sum[1] += v;
        sum[2] += w;
        xx += u * u;
        xy += u * v;
        xz += u * w;
        yy += v * v;
        yz += v * w;
        zz += w * w;
    }
    xx -= sum[0] * sum[0] * 0.0625f;
    xy -= sum[0] * sum[1] * 0.0625f;
    xz -= sum[0] * sum[2] * 0.0625f;
    yy -= sum[1] * sum[1] * 0.0625f;
    yz -= sum[1] * sum[2] * 0.0625f;
    zz -= sum[2] * sum[2] * 0.0625f;

    /* Principal axis: the 64th power of the covariance, by squaring with the trace kept at 1, has nothing left but
       the largest eigenvalues; its longest column cannot be orthogonal to their vectors, as a start for the plain
       power iteration can. A constant block gives 0. */
#pragma unroll
    for (int i = 0; i < 7; i++) {
        const real trace = xx + yy + zz;
        const real inverse = trace > 0.0f ? 1.0f / trace : trace;
        xx *= inverse;
        xy *= inverse;
        xz *= inverse;
        yy *= inverse;
        yz *= inverse;
        zz *= inverse;
        if (i < 6) {
            const real nxx = xx * xx + xy * xy + xz * xz;
            const real nxy = xx * xy + xy * yy + xz * yz;
            const real nxz = xx * xz + xy * yz + xz * zz;
            const real nyy = xy * xy + yy * yy + yz * yz;
            const real nyz = xy * xz + yy * yz + yz * zz;
            const real nzz = xz * xz + yz * yz + zz * zz;
            xx = nxx;
            xy = nxy;
            xz = nxz;
            yy = nyy;
            yz = nyz;
            zz = nzz;
        }
    }
    const whole second = yy > xx, third = zz > GREATER(xx, yy);
    const real ax = third ? xz : second ? xy : xx;
    const real ay = third ? yz : second ? yy : xy;
    const real az = third ? zz : second ? yz : xz;

    /* Levels along the axis, between the extremes. */
    real low = x[0][0] * ax + x[1][0] * ay + x[2][0] * az, high = low;
    real along[16];
    along[0] = low;
#pragma unroll
    for (int t = 1; t < 16; t++) {
        along[t] = x[0][t] * ax + x[1][t] * ay + x[2][t] * az;
        low = LESSER(low, along[t]);
        high = GREATER(high, along[t]);
    }
    real slope = high > low ? 3.0f / (high - low) : (real)(0.0f);
#pragma unroll
    for (int t = 0; t < 16; t++)
        along[t] = (along[t] - low) * slope;

    real start[3], step[3]; /* x_t ~ start + q_t step */
#pragma unroll
    for (int round = 0; round < 2; round++) {
        real q_sum = 0.0f, qq = 0.0f, qx = 0.0f, qy = 0.0f, qz = 0.0f;
#pragma unroll
        for (int t = 0; t < 16; t++) {
            real q = WITHIN(along[t], 0.0f, 3.0f);
            q = (q + ROUNDER) - ROUNDER;
            q_sum += q;
            qq += q * q;
            qx += q * x[0][t];
            qy += q * x[1][t];
            qz += q * x[2][t];
        }
        const real spread = qq - q_sum * q_sum * 0.0625f; /* exact: multiples of 1/16 */
        const real inverse = spread > 0.0f ? 1.0f / spread : spread;
        const real mean = q_sum * 0.0625f;
        step[0] = (qx - mean * sum[0]) * inverse;
        step[1] = (qy - mean * sum[1]) * inverse;
        step[2] = (qz - mean * sum[2]) * inverse;
#pragma unroll
        for (int j = 0; j < 3; j++)
            start[j] = sum[j] * 0.0625f - mean * step[j];
        if (round == 1) {
            /* The last levels are for the endpoints as they are stored, rounded to float32. */
#pragma unroll
            for (int j = 0; j < 3; j++) {
                const real stop = start[j] + 3.0f * step[j];
                const real from = centre[j] + start[j] * unscale, to = centre[j] + stop * unscale;
                ends[j] = WITHIN(from, -FLT_MAX, FLT_MAX);
                ends[j + 3] = WITHIN(to, -FLT_MAX, FLT_MAX);
                start[j] = (ends[j] - centre[j]) * scale;
                step[j] = ((ends[j + 3] - centre[j]) * scale - start[j]) * (1.0f / 3.0f);
            }
        }
        const real square = step[0] * step[0] + step[1] * step[1] + step[2] * step[2];
        slope = square > 0.0f ? 1.0f / square : square;
        const real sx = step[0] * slope, sy = step[1] * slope, sz = step[2] * slope;
        const real offset = start[0] * sx + start[1] * sy + start[2] * sz;
#pragma unroll
        for (int t = 0; t < 16; t++)
            along[t] = x[0][t] * sx + x[1][t] * sy + x[2][t] * sz - offset;
    }
    word bits = 0;
#pragma unroll
    for (int t = 0; t < 16; t++) {
        const real q = WITHIN(along[t], 0.0f, 3.0f) + ROUNDER;
        bits |= (AS_WORD(q) & 3) << (2 * t);
    }
    *levels = bits;
}

kernel void encode_s3tc_gjb(global uint *restrict blocks_gjb, global const float *restrict coeffs_khwc,
                            const int size_k, const int size_h, const int size_w)
{
    const int rows = (size_h + 3) / 4, columns = (size_w + 3) / 4;
    const int y = get_global_id(1) % rows, g = get_global_id(1) / rows;
    const size_t size_b = (size_t)rows * columns;
    for (int b = get_global_id(0) * LANES; b < columns; b += get_global_size(0) * LANES) {
        real x[3][16], ends[6];
        word levels;
#if LANES == 8
        if (4 * (b + 8) <= size_w)
            load_whole(x, coeffs_khwc, g, y, b, size_k, size_h, size_w);
        else
#endif
            load_edge(x, coeffs_khwc, g, y, b, size_k, size_h, size_w);
        fit_line(ends, &levels, x);
        for (int j = 0; j < 7; j++) {
            const word value = j < 6 ? AS_WORD(ends[j < 6 ? j : 0]) : levels;
            global uint *out = blocks_gjb + ((size_t)g * 7 + j) * size_b + (size_t)y * columns + b;
            if (b + LANES <= columns) {
                WORDS(global, out) = value;
            } else {
                uint lanes[LANES];
                WORDS(private, lanes) = value;
                for (int lane = 0; b + lane < columns; lane++)
                    out[lane] = lanes[lane];
            }
        }
    }
}

/* The levels lie at a, a + 2h/3, b - 2h/3, b with h = (b - a)/2: no overflow, and exactly a where a = b. */
real level_value(whole q, real a, real b)
{
    const real third = (0.5f * b - 0.5f * a) * (2.0f / 3.0f);
    const real end = q < 2 ? a : b;
    return end + (q == 1 ? third : q == 2 ? -third : (real)(0.0f));
}

kernel void decode_s3tc_khwc(global float *restrict coeffs_khwc, global const uint *restrict blocks_gjb,
                             const int size_k, const int size_h, const int size_w)
{
    const int rows = (size_h + 3) / 4, columns = (size_w + 3) / 4;
    const int y = get_global_id(1) % rows, g = get_global_id(1) / rows;
    const size_t size_b = (size_t)rows * columns;
    for (int b = get_global_id(0) * LANES; b < columns; b += get_global_size(0) * LANES) {
        word words[7];
        for (int j = 0; j < 7; j++) {
            global const uint *in = blocks_gjb + ((size_t)g * 7 + j) * size_b + (size_t)y * columns + b;
            if (b + LANES <= columns) {
                words[j] = WORDS(global const, in);
            } else {
                uint lanes[LANES];
                for (int lane = 0; lane < LANES; lane++)
                    lanes[lane] = in[LESSER(lane, columns - 1 - b)];
                words[j] = WORDS(private, lanes);
            }
        }
        real ends[6];
        for (int j = 0; j < 6; j++)
            ends[j] = AS_REAL(words[j]);
#if LANES == 8
        if (4 * (b + 8) <= size_w) {
#pragma unroll
            for (int r = 0; r < 4; r++)
#pragma unroll
                for (int m = 0; m < 3; m++) {
                    if (4 * y + r >= size_h || MAP_OF(g, m) >= size_k)
                        continue;
                    float8 v[4];
#pragma unroll
                    for (int i = 0; i < 4; i++) {
                        const int j = PIECE_COMPONENT(m, i), t = 4 * r + PIECE_TEXEL(m, i);
                        v[i] = level_value(as_int8((words[6] >> (2 * t)) & 3), ends[j], ends[j + 3]);
                    }
                    transpose(v);
                    global float *p =
                        coeffs_khwc + row_offset(g, m, 4 * y + r, size_h, size_w) + (size_t)b * 4 * CHANNELS;
#pragma unroll
                    for (int i = 0; i < 4; i++) {
                        AT(global, float4, p + 4 * CHANNELS * i) = v[i].lo;
                        AT(global, float4, p + 4 * CHANNELS * (i + 4)) = v[i].hi;
                    }
                }
            continue;
        }
#endif
        for (int m = 0; m < 3; m++)
            for (int t = 0; t < 16; t++) {
                const int row = 4 * y + t / 4, k = MAP_OF(g, m);
                if (row >= size_h || k >= size_k)
                    continue;
                float lanes[LANES];
                const word q = (words[6] >> (2 * t)) & 3;
#if LANES == 8
                REALS(private, lanes) = level_value(as_int8(q), ends[m], ends[m + 3]);
#else
                REALS(private, lanes) = level_value((int)q, ends[m], ends[m + 3]);
#endif
                for (int lane = 0; lane < LANES; lane++) {
                    const int column = 4 * (b + lane) + t % 4;
                    if (column < size_w)
                        coeffs_khwc[(((size_t)k * size_h + row) * size_w + column) * CHANNELS +
                                    (CHANNELS == 3 ? m : 0)] = lanes[lane];
                }
            }
    }
}
