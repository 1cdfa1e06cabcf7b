/* Two-dimensional 9/7 wavelet for GPUs, and the dequantiser of its subbands: see codec/wavelet.cl for the planes, the
 * passes and the equations.
 *
 * One work-item for each sample or pair of samples. Global size (x rounded up to groups, y, planes): work-items beyond
 * the first axis' extent do nothing. In both passes neighbours have neighbouring x, or pairs n along a row, whose nine
 * samples overlap in the cache.
 */
typedef float lifted;
#include "codec/lifting.clh"

/* planes[k c][y][x] = scale[k] coeffs[k][y][x][c]. */
__kernel void planes_from_coeffs(__global float *restrict planes_pyx, __global const float *restrict coeffs_khwc,
                                 __global const float *restrict scale_k, const int size_h, const int size_w,
                                 const int size_c, const int size_y, const int size_x)
{
    const int x = get_global_id(0), y = get_global_id(1), p = get_global_id(2);
    if (x >= size_w) return;
    const int k = p / size_c, c = p % size_c;
    planes_pyx[((size_t)p * size_y + y) * size_x + x] =
        scale_k[k] * coeffs_khwc[(((size_t)k * size_h + y) * size_w + x) * size_c + c];
}

/* coeffs[k][y][x][c] = scale[k] planes[k c][y][x], kept within the range of float32. */
__kernel void coeffs_from_planes(__global float *restrict coeffs_khwc, __global const float *restrict planes_pyx,
                                 __global const float *restrict scale_k, const int size_h, const int size_w,
                                 const int size_c, const int size_y, const int size_x)
{
    const int x = get_global_id(0), y = get_global_id(1), p = get_global_id(2);
    if (x >= size_w) return;
    const int k = p / size_c, c = p % size_c;
    const float value = scale_k[k] * planes_pyx[((size_t)p * size_y + y) * size_x + x];
    coeffs_khwc[(((size_t)k * size_h + y) * size_w + x) * size_c + c] = clamp(value, -MAXFLOAT, MAXFLOAT);
}

/* Pair n of a line of `size` samples that lie `stride` apart, from samples to bands. */
static void analyse_pair(__global float *to, __global const float *from, const int n, const int size,
                         const size_t stride)
{
    if (size == 1) {
        to[0] = from[0];
        return;
    }
    float s[5], d[4], low, high;
    for (int i = 0; i < 5; i++) s[i] = from[mirror(2 * (n + i - 2), size) * stride];
    for (int i = 0; i < 4; i++) d[i] = from[mirror(2 * (n + i - 2) + 1, size) * stride];
    analyse(s, d, &low, &high);
    to[n * stride] = low;
    if (2 * n + 1 < size) to[((size + 1) / 2 + n) * stride] = high;
}

/* The same from bands to samples. */
static void synthesise_pair(__global float *to, __global const float *from, const int n, const int size,
                            const size_t stride)
{
    if (size == 1) {
        to[0] = from[0];
        return;
    }
    const int n_low = (size + 1) / 2;
    float low[4], high[5], even, odd;
    for (int i = 0; i < 4; i++) low[i] = from[mirror(2 * (n + i - 1), size) / 2 * stride];
    for (int i = 0; i < 5; i++) high[i] = from[(n_low + mirror(2 * (n + i - 2) + 1, size) / 2) * stride];
    synthesise(low, high, &even, &odd);
    to[2 * n * stride] = even;
    if (2 * n + 1 < size) to[(2 * n + 1) * stride] = odd;
}

/* Vertical passes: global size (width, ceil(height / 2), planes), of which the kernel needs no more than the pitch. */
__kernel void analyse_columns(__global float *restrict bands_pyx, __global const float *restrict planes_pyx,
                              const int height, const int size_y, const int size_x)
{
    const int x = get_global_id(0);
    const size_t column = (size_t)get_global_id(2) * size_y * size_x + x;
    if (x < size_x) analyse_pair(bands_pyx + column, planes_pyx + column, get_global_id(1), height, size_x);
}

__kernel void synthesise_columns(__global float *restrict planes_pyx, __global const float *restrict bands_pyx,
                                 const int height, const int size_y, const int size_x)
{
    const int x = get_global_id(0);
    const size_t column = (size_t)get_global_id(2) * size_y * size_x + x;
    if (x < size_x) synthesise_pair(planes_pyx + column, bands_pyx + column, get_global_id(1), height, size_x);
}

/* Horizontal passes: global size (ceil(width / 2), height, planes). */
__kernel void analyse_rows(__global float *restrict bands_pyx, __global const float *restrict planes_pyx,
                           const int width, const int size_y, const int size_x)
{
    const int n = get_global_id(0);
    const size_t row = ((size_t)get_global_id(2) * size_y + get_global_id(1)) * size_x;
    if (2 * n < width) analyse_pair(bands_pyx + row, planes_pyx + row, n, width, 1);
}

__kernel void synthesise_rows(__global float *restrict planes_pyx, __global const float *restrict bands_pyx,
                              const int width, const int size_y, const int size_x)
{
    const int n = get_global_id(0);
    const size_t row = ((size_t)get_global_id(2) * size_y + get_global_id(1)) * size_x;
    if (2 * n < width) synthesise_pair(planes_pyx + row, bands_pyx + row, n, width, 1);
}

/* v = sign(index) (|index| - bias[|index| > 1]) step; `first` is the plane of channel 0. */
__kernel void dequantise(__global float *restrict planes_pyx, __global const int *restrict index_chw, const float step,
                         const float bias_of_one, const float bias_of_more, const int first, const int size_h,
                         const int size_w, const int size_y, const int size_x)
{
    const int x = get_global_id(0), y = get_global_id(1), c = get_global_id(2);
    if (x >= size_w) return;
    const int index = index_chw[((size_t)c * size_h + y) * size_w + x];
    const int magnitude = abs(index);
    float value = 0.0f;
    if (magnitude > 0) value = step * ((float)magnitude - (magnitude == 1 ? bias_of_one : bias_of_more));
    planes_pyx[((size_t)(first + c) * size_y + y) * size_x + x] = index < 0 ? -value : value;
}
