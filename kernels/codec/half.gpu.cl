/* IEEE 754 binary16 for GPUs: see codec/half.cl for the equation, the arrays and CLAMP.
 *
 *   STRETCH   values that a group of work-items converts, and that one refused_j is for
 *   GROUP     its work-items, which divide STRETCH
 */
#include "codec/half_range.clh"

#if !defined(STRETCH) || !defined(GROUP) || !defined(CLAMP)
#error "STRETCH, GROUP and CLAMP must be defined"
#endif

/* refused_j = 1 where any work-item of the group says so. Every work-item must come here. */
static void store_refused(global uchar *refused_j, local int *any_refused, const int refused)
{
    if (get_local_id(0) == 0) *any_refused = 0;
    barrier(CLK_LOCAL_MEM_FENCE);
    if (refused) atomic_or(any_refused, 1);
    barrier(CLK_LOCAL_MEM_FENCE);
    if (get_local_id(0) == 0) refused_j[get_group_id(0)] = (uchar)*any_refused;
}

kernel __attribute__((reqd_work_group_size(GROUP, 1, 1))) void
encode_half_p(global half *restrict halves_p, global uchar *restrict refused_j, global const float *restrict coeffs_p,
              const ulong size_p)
{
    local int any_refused;
    const size_t first = (size_t)get_group_id(0) * STRETCH + get_local_id(0);
    int refused = 0;
    for (int i = 0; i < STRETCH; i += GROUP) {
        const size_t p = first + i;
        if (p < size_p) {
            float x = coeffs_p[p];
            refused |= fabs(x) >= OVERFLOW;
#if CLAMP
            x = clamp(x, -LARGEST, LARGEST);
#endif
            vstore_half_rte(x, p, halves_p);
        }
    }
    store_refused(refused_j, &any_refused, refused);
}

kernel __attribute__((reqd_work_group_size(GROUP, 1, 1))) void
decode_half_p(global float *restrict coeffs_p, global uchar *restrict refused_j, global const half *restrict halves_p,
              const ulong size_p)
{
    local int any_refused;
    const size_t first = (size_t)get_group_id(0) * STRETCH + get_local_id(0);
    int refused = 0;
    for (int i = 0; i < STRETCH; i += GROUP) {
        const size_t p = first + i;
        if (p < size_p) {
            const float x = vload_half(p, halves_p);
            refused |= !(fabs(x) <= LARGEST); /* also NaN */
            coeffs_p[p] = x;
        }
    }
    store_refused(refused_j, &any_refused, refused);
}
