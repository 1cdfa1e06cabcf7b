/* What kernels ask OpenCL for, as opencl.clh declares it. */
#include <math.h>
#include <stddef.h>
#include <stdint.h>

size_t work_item[3], work_items[3] = {1, 1, 1};

size_t host_global_id(unsigned axis) { return work_item[axis]; }
size_t host_global_size(unsigned axis) { return work_items[axis]; }
float host_log2(float x) { return log2f(x); }

float host_half(uint16_t bits)
{
    const int exponent = bits >> 10 & 31, fraction = bits & 1023;
    const float size = exponent == 31 ? (fraction ? NAN : INFINITY)
                       : exponent     ? ldexpf((float)(1024 + fraction), exponent - 25)
                                      : ldexpf((float)fraction, -24);
    return bits >> 15 ? -size : size;
}
