/* Channels of maps to their components and back: what a rotation of each map's channels makes of them.
 *
 * component d of map k = sum_c rotation[k, d, c] scale[k] channel c, put into plane place[k, d] (-1: nowhere), and the
 * transpose of it. A scale is given as two factors, each within float32's range where their product need not be.
 * Error bound: size_c + 2 roundings of the sum of magnitudes.
 */

/* Global size (height, n_coeff). Rows of planes go on with zeros to size_x. */
__kernel void rotate_channels(__global float *plane_jyx, __global const float *coeffs_khwc,
                              __global const float *rotation_ro, __global const float *scale_k2,
                              __global const int *place_kd, const int rotated, const int size_h, const int size_w,
                              const int size_c, const int size_y, const int size_x)
{
    const int y = get_global_id(0), k = get_global_id(1);
    __global const float *from = coeffs_khwc + ((size_t)k * size_h + y) * size_w * size_c;
    const float first = scale_k2[2 * k], second = scale_k2[2 * k + 1];
    for (int d = 0; d < size_c; ++d) {
        const int j = place_kd[k * size_c + d];
        if (j < 0)
            continue;
        __global float *to = plane_jyx + ((size_t)j * size_y + y) * size_x;
        __global const float *row = rotation_ro + ((size_t)k * size_c + d) * size_c;
        if (!rotated) {
            for (int x = 0; x < size_w; ++x)
                to[x] = from[x * size_c + d] * first * second;
        } else if (size_c == 3) {
            const float a = row[0], b = row[1], c = row[2];
            for (int x = 0; x < size_w; ++x)
                to[x] = (a * (from[3 * x] * first) + b * (from[3 * x + 1] * first) + c * (from[3 * x + 2] * first)) * second;
        } else {
            for (int x = 0; x < size_w; ++x) {
                float sum = 0.0f;
                for (int c = 0; c < size_c; ++c)
                    sum += row[c] * (from[x * size_c + c] * first);
                to[x] = sum * second;
            }
        }
        for (int x = size_w; x < size_x; ++x)
            to[x] = 0.0f;
    }
}

#define LARGEST 0x1.fffffep127f
#define CLAMPED(value) ((value) > LARGEST ? LARGEST : (value) < -LARGEST ? -LARGEST : (value))

/* Global size (height, n_coeff). Maps without planes become 0; what passes float32 its largest number. */
__kernel void unrotate_channels(__global float *coeffs_khwc, __global const float *plane_jyx,
                                __global const float *rotation_ro, __global const float *scale_k2,
                                __global const int *place_kd, const int rotated, const int size_h, const int size_w,
                                const int size_c, const int size_y, const int size_x)
{
    const int y = get_global_id(0), k = get_global_id(1);
    __global float *to = coeffs_khwc + ((size_t)k * size_h + y) * size_w * size_c;
    const float first = scale_k2[2 * k], second = scale_k2[2 * k + 1];
    __global const int *place = place_kd + (size_t)k * size_c;
    __global const float *rotation = rotation_ro + (size_t)k * size_c * size_c;
    const size_t plane = (size_t)size_y * size_x, row = (size_t)y * size_x;
    if (place[0] < 0) {
        for (int i = 0; i < size_w * size_c; ++i)
            to[i] = 0.0f;
    } else if (rotated && size_c == 3) {
        __global const float *p = plane_jyx + place[0] * plane + row, *q = plane_jyx + place[1] * plane + row;
        __global const float *r = plane_jyx + place[2] * plane + row;
        for (int x = 0; x < size_w; ++x) {
            const float u = p[x], v = q[x], w = r[x];
            for (int c = 0; c < 3; ++c) {
                const float value = (rotation[c] * u + rotation[3 + c] * v + rotation[6 + c] * w) * first * second;
                to[3 * x + c] = CLAMPED(value);
            }
        }
    } else {
        for (int c = 0; c < size_c; ++c)
            for (int x = 0; x < size_w; ++x) {
                float sum = 0.0f;
                if (rotated)
                    for (int d = 0; d < size_c; ++d)
                        sum += rotation[d * size_c + c] * plane_jyx[place[d] * plane + row + x];
                else
                    sum = plane_jyx[place[c] * plane + row + x];
                const float value = sum * first * second;
                to[x * size_c + c] = CLAMPED(value);
            }
    }
}
