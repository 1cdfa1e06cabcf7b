/* Two-dimensional 9/7 wavelet on planes, and the quantiser of its subbands.
 *
 * Planes are (p, y, x): p = coefficient map times channel, y rows, x columns padded to a multiple of 8 (what the padding
 * holds is never used). One level works on the top left height by width of each plane: a vertical pass into scratch
 * planes, then a horizontal pass back; each leaves its ceil(n/2) low samples in front of its floor(n/2) high ones.
 * Rows and columns commute, so the inverse takes the passes in the same order. A side of one sample is copied.
 *
 * Error: forward and inverse together return each sample within 16 eps32 max|plane| per level.
 */
typedef float8 lifted;
#include "codec/lifting.clh"

/* planes[k c][y][x] = scale[k] coeffs[k][y][x][c]. Global size (width, height, maps times channels). */
__kernel void planes_from_coeffs(
    __global float *restrict planes_pyx,
    __global const float *restrict coeffs_khwc,
    __global const float *restrict scale_k,
    const int size_h,
    const int size_w,
    const int size_c,
    const int size_y,
    const int size_x)
{
    const int x = get_global_id(0), y = get_global_id(1), p = get_global_id(2);
    const int k = p / size_c, c = p % size_c;
    const size_t from = (((size_t)k * size_h + y) * size_w + x) * size_c + c;
    planes_pyx[((size_t)p * size_y + y) * size_x + x] = scale_k[k] * coeffs_khwc[from];
}

/* coeffs[k][y][x][c] = scale[k] planes[k c][y][x], kept within the range of float32. Same global size. */
__kernel void coeffs_from_planes(
    __global float *restrict coeffs_khwc,
    __global const float *restrict planes_pyx,
    __global const float *restrict scale_k,
    const int size_h,
    const int size_w,
    const int size_c,
    const int size_y,
    const int size_x)
{
    const int x = get_global_id(0), y = get_global_id(1), p = get_global_id(2);
    const int k = p / size_c, c = p % size_c;
    const size_t to = (((size_t)k * size_h + y) * size_w + x) * size_c + c;
    const float value = scale_k[k] * planes_pyx[((size_t)p * size_y + y) * size_x + x];
    coeffs_khwc[to] = clamp(value, -MAXFLOAT, MAXFLOAT);
}

/* Vertical pass of the forward transform. Global size (ceil(width/8), ceil(height/2), planes): 8 columns, one pair. */
__kernel void analyse_columns(
    __global float *restrict bands_pyx,
    __global const float *restrict planes_pyx,
    const int height,
    const int size_y,
    const int size_x)
{
    const int n = get_global_id(1);
    const size_t corner = (size_t)get_global_id(2) * size_y * size_x + 8 * get_global_id(0);
    __global const float *from = planes_pyx + corner;
    __global float *to = bands_pyx + corner;
    if (height == 1) {
        vstore8(vload8(0, from), 0, to);
        return;
    }
    float8 s[5], d[4], low, high;
    for (int i = 0; i < 5; ++i)
        s[i] = vload8(0, from + (size_t)mirror(2 * (n + i - 2), height) * size_x);
    for (int i = 0; i < 4; ++i)
        d[i] = vload8(0, from + (size_t)mirror(2 * (n + i - 2) + 1, height) * size_x);
    analyse(s, d, &low, &high);
    vstore8(low, 0, to + (size_t)n * size_x);
    if (2 * n + 1 < height)
        vstore8(high, 0, to + (size_t)((height + 1) / 2 + n) * size_x);
}

/* Vertical pass of the inverse. Global size as for analyse_columns. */
__kernel void synthesise_columns(
    __global float *restrict planes_pyx,
    __global const float *restrict bands_pyx,
    const int height,
    const int size_y,
    const int size_x)
{
    const int n = get_global_id(1), n_low = (height + 1) / 2;
    const size_t corner = (size_t)get_global_id(2) * size_y * size_x + 8 * get_global_id(0);
    __global const float *from = bands_pyx + corner;
    __global float *to = planes_pyx + corner;
    if (height == 1) {
        vstore8(vload8(0, from), 0, to);
        return;
    }
    float8 low[4], high[5], even, odd;
    for (int i = 0; i < 4; ++i)
        low[i] = vload8(0, from + (size_t)(mirror(2 * (n + i - 1), height) / 2) * size_x);
    for (int i = 0; i < 5; ++i)
        high[i] = vload8(0, from + (size_t)(n_low + mirror(2 * (n + i - 2) + 1, height) / 2) * size_x);
    synthesise(low, high, &even, &odd);
    vstore8(even, 0, to + (size_t)(2 * n) * size_x);
    if (2 * n + 1 < height)
        vstore8(odd, 0, to + (size_t)(2 * n + 1) * size_x);
}

/* Sixteen samples from position x of a signal with symmetric extension. */
inline float16 load_signal(__global const float *signal, int x, int size)
{
    if (x >= 0 && x + 16 <= size)
        return vload16(0, signal + x);
    float samples[16];
    for (int i = 0; i < 16; ++i)
        samples[i] = signal[mirror(x + i, size)];
    return vload16(0, samples);
}

/* Eight samples from pair n of one half (parity 0 low, 1 high) of an analysed signal with symmetric extension. */
inline float8 load_half(__global const float *bands, int n, int parity, int size)
{
    const int n_low = (size + 1) / 2;
    const int count = parity ? size / 2 : n_low;
    __global const float *half_band = bands + (parity ? n_low : 0);
    if (n >= 0 && n + 8 <= count)
        return vload8(0, half_band + n);
    float samples[8];
    for (int i = 0; i < 8; ++i)
        samples[i] = half_band[mirror(2 * (n + i) + parity, size) / 2];
    return vload8(0, samples);
}

inline void store_some(__global float *to, float8 values, int count)
{
    if (count >= 8) {
        vstore8(values, 0, to);
        return;
    }
    float samples[8];
    vstore8(values, 0, samples);
    for (int i = 0; i < count; ++i)
        to[i] = samples[i];
}

/* Horizontal pass of the forward transform. Global size (ceil(width/16), height, planes): 8 pairs of one row. */
__kernel void analyse_rows(
    __global float *restrict bands_pyx,
    __global const float *restrict planes_pyx,
    const int width,
    const int size_y,
    const int size_x)
{
    const int n = 8 * get_global_id(0), n_low = (width + 1) / 2;
    const size_t row = ((size_t)get_global_id(2) * size_y + get_global_id(1)) * size_x;
    if (width == 1) {
        bands_pyx[row] = planes_pyx[row];
        return;
    }
    float8 s[5], d[4], low, high;
    for (int i = 0; i < 5; ++i) {
        const float16 pairs = load_signal(planes_pyx + row, 2 * (n + i - 2), width);
        s[i] = pairs.even;
        if (i < 4)
            d[i] = pairs.odd;
    }
    analyse(s, d, &low, &high);
    store_some(bands_pyx + row + n, low, n_low - n);
    store_some(bands_pyx + row + n_low + n, high, width / 2 - n);
}

/* Horizontal pass of the inverse. Global size as for analyse_rows. */
__kernel void synthesise_rows(
    __global float *restrict planes_pyx,
    __global const float *restrict bands_pyx,
    const int width,
    const int size_y,
    const int size_x)
{
    const int n = 8 * get_global_id(0);
    const size_t row = ((size_t)get_global_id(2) * size_y + get_global_id(1)) * size_x;
    if (width == 1) {
        planes_pyx[row] = bands_pyx[row];
        return;
    }
    float8 low[4], high[5], even, odd;
    for (int i = 0; i < 4; ++i)
        low[i] = load_half(bands_pyx + row, n + i - 1, 0, width);
    for (int i = 0; i < 5; ++i)
        high[i] = load_half(bands_pyx + row, n + i - 2, 1, width);
    synthesise(low, high, &even, &odd);
    float16 pairs;
    pairs.even = even;
    pairs.odd = odd;
    store_some(planes_pyx + row + 2 * n, pairs.lo, width - 2 * n);
    store_some(planes_pyx + row + 2 * n + 8, pairs.hi, width - 2 * n - 8);
}

/* index = sign(v) floor(|v| / step + rounding): a uniform quantiser, with a dead zone where rounding < 1/2.
 * `first` is the plane of channel 0; global size (width, height, channels). |v|/step must stay below 2^31. */
__kernel void quantise(
    __global int *restrict index_chw,
    __global const float *restrict planes_pyx,
    const float inverse_step,
    const float rounding,
    const int first,
    const int size_h,
    const int size_w,
    const int size_y,
    const int size_x)
{
    const int x = get_global_id(0), y = get_global_id(1), c = get_global_id(2);
    const float value = planes_pyx[((size_t)(first + c) * size_y + y) * size_x + x];
    const int magnitude = convert_int(floor(fabs(value) * inverse_step + rounding));
    index_chw[((size_t)c * size_h + y) * size_w + x] = value < 0.0f ? -magnitude : magnitude;
}

/* v = sign(index) (|index| - bias[|index| > 1]) step: reconstruction below the middle of the interval, where the
 * samples are. Same global size. */
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
