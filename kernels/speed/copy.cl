/* A copy within the memory of the device, to see how fast it is at most.
 *
 *   out_p, source_p   (P) float
 *
 *   EACH     values that a work-item copies
 *   STRIDE   distance between them: 1 for a CPU, the size of a group for a GPU, whose neighbours then copy one stretch
 */
#if !defined(EACH) || !defined(STRIDE)
#error "EACH and STRIDE must be defined"
#endif

__kernel void copy_p(__global float *restrict out_p, __global const float *restrict source_p, const int size_p)
{
    const int item = get_global_id(0);
    const long first = (long)(item / STRIDE) * EACH * STRIDE + item % STRIDE;
    for (int i = 0; i < EACH; i++) {
        const long p = first + (long)i * STRIDE;
        if (p < size_p) out_p[p] = source_p[p];
    }
}
