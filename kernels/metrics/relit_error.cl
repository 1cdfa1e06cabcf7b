/* Sums of squared differences between relit radiance and the stack's own code values, in units of the peak; what is relit
 * never leaves the cache.
 *
 *   error_mn    (M, N) float      sum over the columns of tile n of weight (a - b)^2
 *   coeffs_kp   (K, P) COEFF_T    coefficients of linear radiance, or of sRGB code values
 *   source_mp   (M, P) SAMPLE_T   code values; b = clip(scale source) to [0, 1]
 *   weight_p    (P) float         1 where the pixel counts, else 0
 *   packed_o    basis (M, K) in row blocks (matmul.py packs it); a = clip(basis coeffs) to [0, 1], as ENCODE says
 *   heights_b   (n_block) int     rows of each block, 1 to 8
 *   first, end  int               columns where tile 0 begins, and where the last one ends
 *
 *   ENCODE      1: radiance to sRGB code values; -1: these to radiance; 0: neither
 *   COEFF_HALF  1 where COEFF_T is half, 0 where it is float
 *
 * float32 error of a sum below eps32 TILE / 8 of it.
 */
#include "common/lanes.clh"
#include "common/types.clh"
#include "common/transfer.clh"
#include "common/row_blocks.clh"

#ifndef ENCODE
#error "ENCODE must be defined"
#endif
#ifndef COEFF_HALF
#error "COEFF_HALF must be defined: 0 or 1"
#endif

#if COEFF_HALF
#define COEFF_T half
#define LOAD_COEFF(pointer, index) vload_half((index), (pointer))
#define LOAD_COEFF8(pointer) LOAD_HALF8(__global const, pointer)
#else
#define COEFF_T float
#define LOAD_COEFF(pointer, index) ((pointer)[index])
#define LOAD_COEFF8(pointer) AT(__global const, float8, pointer)
#endif

#if VECTOR == 16
#define LOAD_WEIGHTS(p) (vecf)(AT(__global const, float8, p), AT(__global const, float8, (p) + 8))
#elif VECTOR == 4
#define LOAD_WEIGHTS(p) AT(__global const, float4, p)
#else
#define LOAD_WEIGHTS(p) AT(__global const, float8, p)
#endif

/* NaN stays NaN. */
#define CLIP(x) ((x) < 0.0f ? 0.0f : (x) > 1.0f ? 1.0f : (x))

/* What is shown of radiance, a float or a vector. */
#if ENCODE > 0
#define SHOWN(x) encode_srgb(CLIP(x))
#elif ENCODE < 0
#define SHOWN(x) decode_srgb(CLIP(x))
#else
#define SHOWN(x) CLIP(x)
#endif

/* Sum of weight (a - b)^2 over count columns of one light. */
INLINE float sum_errors(__local const vecf *relit, __global const SAMPLE_T *source, __global const float *weight,
                        const float scale, const int count)
{
    int c = 0;
    float sum = 0.0f;
#if ENCODE >= 0 /* there is no inverse of vectors */
    if (count == TILE) {
        vecf given[TILE_VECTORS];
        vecf sums = 0.0f;
#if SAMPLE_HALF
        for (; c < TILE; c += 8) AT(, float8, (float *)given + c) = scale * LOAD_SAMPLE8(source, c);
#else
        /* A loop of fixed length without calls: compilers vectorise it with the conversion. */
        for (; c < TILE; c++) ((float *)given)[c] = scale * LOAD_SAMPLE(source, c);
#endif
        for (int v = 0; v < TILE_VECTORS; v++) {
            const vecf d = SHOWN(relit[v]) - CLIP(given[v]);
            sums += LOAD_WEIGHTS(weight + v * VECTOR) * d * d;
        }
        for (int lane = 0; lane < VECTOR; lane++) sum += ((const float *)&sums)[lane];
    }
#endif
    for (; c < count; c++) {
        const float d = SHOWN(((__local const float *)relit)[c]) - CLIP(scale * LOAD_SAMPLE(source, c));
        sum += weight[c] * d * d;
    }
    return sum;
}

/* tile[k][c] = coeffs[k0 + k][column + c] for c < count, else 0. */
static void load_coeffs(__local float *tile, __global const COEFF_T *restrict coeffs_kp, const int k0, const int rows,
                        const int column, const int count, const int size_p)
{
    for (int k = 0; k < rows; k++) {
        __global const COEFF_T *row = coeffs_kp + (long)(k0 + k) * size_p + column;
        int c = 0;
        for (; c + 8 <= count; c += 8) AT(__local, float8, tile + k * TILE + c) = LOAD_COEFF8(row + c);
        for (; c < count; c++) tile[k * TILE + c] = LOAD_COEFF(row, c);
        for (; c < TILE; c++) tile[k * TILE + c] = 0.0f;
    }
}

__kernel void sum_relit_error_mn(__global float *restrict error_mn, __global const COEFF_T *restrict coeffs_kp,
                                 __global const SAMPLE_T *restrict source_mp, __global const float *restrict weight_p,
                                 __global const float *restrict packed_o, __global const int *restrict heights_b,
                                 const float scale, const int first, const int end, const int size_m, const int size_n,
                                 const int size_k, const int size_p, const int size_b)
{
    __local vecf tile[CHUNK * TILE_VECTORS];
    __local vecf sums[8 * TILE_VECTORS];
    const int n = get_global_id(0), column = first + n * TILE;
    const int count = LESSER(TILE, end - column);
    __global const float *operator = packed_o;
    int m = 0;
    for (int b = 0; b < size_b; b++) {
        const int height = heights_b[b];
        /* Each light lies in pages of its own, where hardware does not look ahead. */
        if (count == TILE)
            for (int r = 0; r < height; r++)
                PREFETCH_ROW(source_mp + (long)(m + r) * size_p + column, TILE * (int)sizeof(SAMPLE_T));
        for (int k0 = 0; k0 < size_k; k0 += CHUNK) {
            const int rows = LESSER(CHUNK, size_k - k0);
            if (b == 0 || size_k > CHUNK)
                load_coeffs((__local float *)tile, coeffs_kp, k0, rows, column, count, size_p);
            apply_block(height, tile, operator + k0 * height, rows, sums, k0 == 0);
        }
        for (int r = 0; r < height; r++, m++)
            error_mn[(long)m * size_n + n] = sum_errors(sums + r * TILE_VECTORS, source_mp + (long)m * size_p + column,
                                                        weight_p + column, scale, count);
        operator += (long)height * size_k;
    }
}
