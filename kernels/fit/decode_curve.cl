/* Values on the sRGB curve (IEC 61966-2-1), in place, to radiance: what is fitted as displayed becomes what lights add.
 *
 *   z_rq   (R, Q) REAL     in: value as displayed, 1 being the peak; out: radiance in units of the peak
 *
 * Below 0.04045 the curve is a line, also below 0, where fits overshoot; above 1.25 values count as 1.25. Between, the
 * polynomial is within 2.0e-6 of ((v + 0.055) / 1.055)^2.4, nearly the least for degree 8 (Chebyshev's nodes); pow() takes
 * more than 50 times as long on CPUs. With float's rounding the error is below 3e-6.
 */
#include "common/columns.clh"

__kernel void decode_rq(__global REAL *restrict z_rq, const int size_r, const int size_q)
{
    const int q = get_global_id(0) * LANES;
    if (q >= size_q) return; /* GPUs start an item a column */
    for (int r = 0; r < size_r; r++) {
        __global REAL *row = z_rq + (long)r * size_q + q;
        const lanes z = LOAD_LANES(row);
        const lanes v = z < R(1.25) ? z : (lanes)R(1.25);
        lanes bright = R(-0.025513354688882828) * v + R(0.15619172155857086);
        bright = bright * v + R(-0.4159978926181793);
        bright = bright * v + R(0.6479624509811401);
        bright = bright * v + R(-0.7048037648200989);
        bright = bright * v + R(0.8131167888641357);
        bright = bright * v + R(0.4934958815574646);
        bright = bright * v + R(0.034677933901548386);
        bright = bright * v + R(0.000870599877089262);
        STORE_LANES(v > R(0.04045) ? bright : v / R(12.92), row);
    }
}
