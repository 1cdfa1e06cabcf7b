/* value[v] = 0, v of V. Global size (ceil(V / item)): a work-item writes `item` of them. */
__kernel void write_zeros_v(__global float *restrict value_v, const int item, const int size_v)
{
    const int first = get_global_id(0) * item, end = size_v - first < item ? size_v : first + item;
    for (int v = first; v < end; v++)
        value_v[v] = 0.0f;
}
