/* Two-dimensional 9/7 wavelet on planes, and the dequantiser of its subbands.
 *
 * Planes are (p, y, x): p = coefficient map times channel, y rows, x columns padded to a multiple of 8 (what the padding
 * holds is never used). One level works on the top left height by width of each plane, and leaves the ceil(n/2) low
 * samples of each row and column in front of its floor(n/2) high ones; the next level works on the low ones.
 *
 * A work-item takes whole planes. It goes down a plane once per level: rows pass through the steps along y (see
 * lifting.clh) in buffers that fit the nearest cache, and each that comes out is lifted along x at once. Low rows go back
 * where they belong, for what they overwrite has been read; high rows wait in scratch memory.
 *
 *   planes_pyx    (p, y, x) float, in place
 *   scratch_ab    (a, b) float, a work-items: BUFFERS rows of x + SLACK values, then ceil(y/2) rows of x
 *
 * Error: forward and inverse together return each sample within 16 eps32 max|plane| per level.
 */
#include "codec/wavelet_rows.clh"

#define BUFFERS 10 /* rows on their way through the steps along y, and through those along x */

/* One row along x, from halves to samples, those and no more. */
static void synthesise_row(__global float *to, __global const float *from, const int width, __global float *even,
                           __global float *odd)
{
    if (width == 1) {
        to[0] = from[0];
        return;
    }
    const int n_high = width / 2, n_low = width - n_high;
    copy(odd, from + n_low, 1.0f / HIGH_GAIN, n_high);
    mirror_odd(odd, width);
    lift(even, from, 1.0f / LOW_GAIN, -DELTA, odd - 1, odd, n_low);
    mirror_even(even, width);
    add(odd, -GAMMA, even, even + 1, n_high);
    mirror_odd(odd, width);
    add(even, -BETA, odd - 1, odd, n_low);
    mirror_even(even, width);
    add(odd, -ALPHA, even, even + 1, n_high);
    int n = 0;
    for (; 2 * n + 16 <= width; n += 8) {
        const float8 s = AT(__global const, float8, even + n), d = AT(__global const, float8, odd + n);
        AT(__global, float8, to + 2 * n) = (float8)(s.s0, d.s0, s.s1, d.s1, s.s2, d.s2, s.s3, d.s3);
        AT(__global, float8, to + 2 * n + 8) = (float8)(s.s4, d.s4, s.s5, d.s5, s.s6, d.s6, s.s7, d.s7);
    }
    for (; n < n_low; n++) {
        to[2 * n] = even[n];
        if (n < n_high) to[2 * n + 1] = odd[n];
    }
}

/* One row along x into its place. */
static void place_row(__global float *to, __global const float *row, __global float *halves, const int width,
                      __global float *even, __global float *odd)
{
    analyse_row(halves, row, width, even, odd);
    copy(to, halves, 1.0f, width);
}

static void analyse_level(__global float *plane, __global float *scratch, const int height, const int width,
                          const int size_x)
{
    const int pitch = size_x + SLACK, n_high = height / 2, n_low = height - n_high;
    __global float *even = scratch + 8, *odd = even + pitch, *row = odd + pitch, *halves = row + pitch;
    __global float *s = halves + pitch, *next = s + pitch, *d = next + pitch;
    __global float *s_before = d + pitch, *d_before = s_before + pitch, *d_first = d_before + pitch;
    __global float *waiting = scratch + BUFFERS * pitch;
    copy(s, plane, 1.0f, width);
    if (height == 1) {
        place_row(plane, s, halves, width, even, odd);
        return;
    }
    /* In step n: s1[n] and d1[n]; then d2 and s2 of n - 1, with d2[n - 2] in d_first. Beyond the end of an even height
     * s[n + 1] = s[n], of an odd one d[n + 1] = d[n]. */
    for (int n = 0; n <= n_low; n++) {
        const int inside = n < n_high;
        if (inside) {
            copy(d, plane + (size_t)(2 * n + 1) * size_x, 1.0f, width);
            const int last = 2 * n + 2 >= height;
            if (!last) copy(next, plane + (size_t)(2 * n + 2) * size_x, 1.0f, width);
            add(d, ALPHA, s, last ? s : next, width);
        }
        if (n < n_low) add(s, BETA, n > 0 ? d_before : d, inside ? d : d_before, width);
        if (n > 0) {
            if (n <= n_high) add(d_before, GAMMA, s_before, n < n_low ? s : s_before, width);
            lift_last(row, s_before, LOW_GAIN, DELTA, n > 1 ? d_first : d_before, n <= n_high ? d_before : d_first, width);
            place_row(plane + (size_t)(n - 1) * size_x, row, halves, width, even, odd);
            if (n <= n_high) {
                copy(row, d_before, HIGH_GAIN, width);
                place_row(waiting + (size_t)(n - 1) * size_x, row, halves, width, even, odd);
            }
        }
        __global float *free_s = s_before, *free_d = d_first;
        d_first = d_before;
        d_before = d;
        d = free_d;
        s_before = s;
        s = next;
        next = free_s;
    }
    for (int y = 0; y < n_high; y++)
        copy(plane + (size_t)(n_low + y) * size_x, waiting + (size_t)y * size_x, 1.0f, width);
}

static void synthesise_level(__global float *plane, __global float *scratch, const int height, const int width,
                             const int size_x)
{
    const int pitch = size_x + SLACK, n_high = height / 2, n_low = height - n_high;
    __global float *even = scratch + 8, *odd = even + pitch, *row = odd + pitch;
    __global float *s = row + pitch, *s_before = s + pitch, *s_first = s_before + pitch;
    __global float *d = s_first + pitch, *d_before = d + pitch, *d_first = d_before + pitch;
    __global float *lows = scratch + BUFFERS * pitch;
    if (height == 1) {
        copy(row, plane, 1.0f, width);
        synthesise_row(plane, row, width, even, odd);
        return;
    }
    for (int y = 0; y < n_low; y++) copy(lows + (size_t)y * size_x, plane + (size_t)y * size_x, 1.0f, width);
    /* In step n: d2[n] and s1[n]; then d1 and s of n - 1, and d of n - 2. High rows are read before they are
     * overwritten: row 2n - 1 is high row 2n - 1 - n_low < n. */
    for (int n = 0; n <= n_high; n++) {
        const int inside = n < n_high;
        if (!inside && n_low == n_high) break;
        if (inside) copy(d, plane + (size_t)(n_low + n) * size_x, 1.0f / HIGH_GAIN, width);
        lift(s, lows + (size_t)n * size_x, 1.0f / LOW_GAIN, -DELTA, n > 0 ? d_before : d, inside ? d : d_before, width);
        if (n > 0) {
            add(d_before, -GAMMA, s_before, s, width);
            add(s_before, -BETA, n > 1 ? d_first : d_before, d_before, width);
            synthesise_row(plane + (size_t)(2 * n - 2) * size_x, s_before, width, even, odd);
        }
        if (n > 1) {
            add(d_first, -ALPHA, s_first, s_before, width);
            synthesise_row(plane + (size_t)(2 * n - 3) * size_x, d_first, width, even, odd);
        }
        __global float *free_s = s_first, *free_d = d_first;
        s_first = s_before;
        s_before = s;
        s = free_s;
        d_first = d_before;
        d_before = d;
        d = free_d;
    }
    if (n_low > n_high) {
        /* d_first holds d1 and s_first holds s of the last pair, s_before s1 of the single last row. */
        add(s_before, -BETA, d_first, d_first, width);
        synthesise_row(plane + (size_t)(height - 1) * size_x, s_before, width, even, odd);
        add(d_first, -ALPHA, s_first, s_before, width);
        synthesise_row(plane + (size_t)(height - 2) * size_x, d_first, width, even, odd);
    } else {
        const int n = n_high - 1;
        add(d_before, -GAMMA, s_before, s_before, width);
        add(s_before, -BETA, n > 0 ? d_first : d_before, d_before, width);
        synthesise_row(plane + (size_t)(2 * n) * size_x, s_before, width, even, odd);
        if (n > 0) {
            add(d_first, -ALPHA, s_first, s_before, width);
            synthesise_row(plane + (size_t)(2 * n - 1) * size_x, d_first, width, even, odd);
        }
        add(d_before, -ALPHA, s_before, s_before, width);
        synthesise_row(plane + (size_t)(2 * n + 1) * size_x, d_before, width, even, odd);
    }
}

/* Sizes of a level are those of the one before, halved upwards. */
#define AT_LEVEL(size, level) (((size) + (1 << (level)) - 1) >> (level))

/* All levels of the forward transform. Global size (a): work-item a takes planes a, a + size_a and so on. */
__kernel void analyse_planes(__global float *restrict planes_pyx, __global float *restrict scratch_ab,
                             const int levels, const int size_w, const int size_a, const int size_b, const int size_p,
                             const int size_y, const int size_x)
{
    __global float *scratch = scratch_ab + (size_t)get_global_id(0) * size_b;
    for (int p = get_global_id(0); p < size_p; p += size_a)
        for (int level = 0; level < levels; level++)
            analyse_level(planes_pyx + (size_t)p * size_y * size_x, scratch, AT_LEVEL(size_y, level),
                          AT_LEVEL(size_w, level), size_x);
}

/* The inverse. */
__kernel void synthesise_planes(__global float *restrict planes_pyx, __global float *restrict scratch_ab,
                                const int levels, const int size_w, const int size_a, const int size_b,
                                const int size_p, const int size_y, const int size_x)
{
    __global float *scratch = scratch_ab + (size_t)get_global_id(0) * size_b;
    for (int p = get_global_id(0); p < size_p; p += size_a)
        for (int level = levels - 1; level >= 0; level--)
            synthesise_level(planes_pyx + (size_t)p * size_y * size_x, scratch, AT_LEVEL(size_y, level),
                             AT_LEVEL(size_w, level), size_x);
}

/* to[c plane + x] = scale from[x C + c] */
static inline void split_row(__global float *to, __global const float *from, const float scale, const int count,
                             const int channels, const size_t plane)
{
    if (channels == 3)
        for (int x = 0; x < count; x++) {
            to[x] = scale * from[3 * x];
            to[plane + x] = scale * from[3 * x + 1];
            to[2 * plane + x] = scale * from[3 * x + 2];
        }
    else
        for (int c = 0; c < channels; c++)
            for (int x = 0; x < count; x++) to[c * plane + x] = scale * from[(size_t)x * channels + c];
}

/* planes[k c][y][x] = scale[k] coeffs[k][y][x][c]. Global size (height, maps): a row of one map. */
__kernel void planes_from_coeffs(__global float *restrict planes_pyx, __global const float *restrict coeffs_khwc,
                                 __global const float *restrict scale_k, const int size_h, const int size_w,
                                 const int size_c, const int size_y, const int size_x)
{
    const int y = get_global_id(0), k = get_global_id(1);
    split_row(planes_pyx + ((size_t)k * size_c * size_y + y) * size_x,
              coeffs_khwc + ((size_t)k * size_h + y) * size_w * size_c, scale_k[k], size_w, size_c,
              (size_t)size_y * size_x);
}

/* coeffs[k][y][x][c] = scale[k] planes[k c][y][x], kept within the range of float32. Same global size. */
__kernel void coeffs_from_planes(__global float *restrict coeffs_khwc, __global const float *restrict planes_pyx,
                                 __global const float *restrict scale_k, const int size_h, const int size_w,
                                 const int size_c, const int size_y, const int size_x)
{
    const int y = get_global_id(0), k = get_global_id(1);
    const float scale = scale_k[k];
    __global float *to = coeffs_khwc + ((size_t)k * size_h + y) * size_w * size_c;
    __global const float *from = planes_pyx + ((size_t)k * size_c * size_y + y) * size_x;
    const size_t plane = (size_t)size_y * size_x;
#define BACK(value) WITHIN(scale * (value), -MAXFLOAT, MAXFLOAT)
    if (size_c == 3)
        for (int x = 0; x < size_w; x++) {
            to[3 * x] = BACK(from[x]);
            to[3 * x + 1] = BACK(from[plane + x]);
            to[3 * x + 2] = BACK(from[2 * plane + x]);
        }
    else
        for (int c = 0; c < size_c; c++)
            for (int x = 0; x < size_w; x++) to[(size_t)x * size_c + c] = BACK(from[c * plane + x]);
}

/* v = sign(index) (|index| - bias[|index| > 1]) step: reconstruction below the middle of the interval, where the
 * samples are. `first` is the plane of channel 0; global size (width, height, channels). */
__kernel void dequantise(
    __global float *restrict planes_pyx,
    __global const int *restrict index_chw,
    const float step,
    const float bias_of_one,
    const float bias_of_more,
    const int first,
    const int size_h,
    const int size_w,
    const int size_y,
    const int size_x)
{
    const int x = get_global_id(0), y = get_global_id(1), c = get_global_id(2);
    const int index = index_chw[((size_t)c * size_h + y) * size_w + x];
    const int magnitude = abs(index);
    float value = 0.0f;
    if (magnitude > 0)
        value = step * ((float)magnitude - (magnitude == 1 ? bias_of_one : bias_of_more));
    planes_pyx[((size_t)(first + c) * size_y + y) * size_x + x] = index < 0 ? -value : value;
}
