/* Multiply-adds from registers alone, to see what the device can do at most.
 *
 *   sums_q   (Q) float    out: keeps the compiler from leaving the work out
 *
 * A work-item does 2 x 12 x VECTOR x steps float operations: 12 vectors of sums, because a multiply-add takes about
 * four cycles and up to two (times two, where the vector is wider than the hardware's) start in each.
 * With factor below 1 the sums tend to addend / (1 - factor): no overflow, no denormals.
 */
#include "common/vector.clh"

#define STEP(r) sum_##r = factor * sum_##r + addend;
#define EACH(DO) DO(0) DO(1) DO(2) DO(3) DO(4) DO(5) DO(6) DO(7) DO(8) DO(9) DO(10) DO(11)
#define DECLARE(r) vecf sum_##r = (float)r;
#define TOTAL(r) total += sum_##r;

__kernel void multiply_add_q(__global float *restrict sums_q, const float factor, const float addend, const int steps,
                             const int size_q)
{
    EACH(DECLARE)
    for (int i = 0; i < steps; i++) {
        EACH(STEP)
    }
    vecf total = 0.0f;
    EACH(TOTAL)
    if ((int)get_global_id(0) < size_q) sums_q[get_global_id(0)] = total.s0 + total.s3;
}
