/* Multiply-adds from registers alone on a GPU: see speed/peak.cl.
 *
 *   sums_q   (Q) float    out: keeps the compiler from leaving the work out
 *
 * A work-item does 2 x 16 x 4 x steps float operations, in 16 chains that differ from each other and between work-items:
 * equal ones a compiler may merge, and lanes of a vector that nobody reads it may drop. Four steps to a turn of the loop
 * hide its counter.
 */
#define EACH(DO) \
    DO(0) DO(1) DO(2) DO(3) DO(4) DO(5) DO(6) DO(7) DO(8) DO(9) DO(10) DO(11) DO(12) DO(13) DO(14) DO(15)
#define DECLARE(r) float sum_##r = start + r;
#define STEP(r) sum_##r = factor * sum_##r + addend;
#define TOTAL(r) total += sum_##r;

__kernel void multiply_add_q(__global float *restrict sums_q, const float factor, const float addend, const int steps,
                             const int size_q)
{
    const int q = get_global_id(0);
    const float start = 1e-6f * q;
    EACH(DECLARE)
    for (int i = 0; i < steps; i++) {
        EACH(STEP)
        EACH(STEP)
        EACH(STEP)
        EACH(STEP)
    }
    float total = 0.0f;
    EACH(TOTAL)
    if (q < size_q) sums_q[q] = total;
}
