/* The sums of Fletcher's checksum, as HDF5's filter fletcher32 takes it (H5_checksum_fletcher32), over chunks whose
 * bytes lie scattered over the rows of a tile.
 *
 *   s = sum_q w_q    t = sum_q (N - q) w_q      over the words w_0 .. w_{N-1} of 16 bits of a chunk
 *
 *   sums_bs    (B, 2) ulong   out: s itself, and a number that is t modulo 65535, of each chunk
 *   bytes_mx   (M, X) uchar   rows of several images: M images, X bytes each
 *   image_n    (N) int        which of them hold pieces of the chunks
 *   place_n    (N) int        which piece of a chunk each of those holds; pieces that none holds count as zeros
 *   piece      bytes of a piece; piece b of an image belongs to chunk b
 *   skipped    bytes of each image before its first piece
 *   pieces     pieces of a chunk
 *
 * HDF5 takes the first byte of a word for the higher. Here it is the lower, as vectors load it: 256 times this is the
 * same modulo 65535, and left to the host. An odd byte at the end is a word with a zero. One work-item per chunk;
 * for CPU devices, which have the tile in their own memory.
 */
#define STEP_BYTES 64
#define STEP_WORDS 32
#define BLOCK_STEPS 256 /* 65535 * (1 + 2 + ... + 256) is below 2^32 */

/* Pieces begin at any byte. */
typedef struct __attribute__((packed)) {
    uint16 words;
} step_bytes;

/* 2^32 is 1 modulo 65535. */
ulong fold(const ulong x)
{
    return (x & 0xffffffffUL) + (x >> 32);
}

ulong total(const ulong16 x)
{
    const ulong8 a = x.lo + x.hi;
    const ulong4 b = a.lo + a.hi;
    return b.x + b.y + b.z + b.w;
}

/* Add a piece that begins `before` bytes into a chunk of `words` words. */
ulong2 add_piece(ulong2 sums, __global const uchar *bytes, ulong size, const ulong before, const ulong words)
{
    const ulong16 lane = (ulong16)(0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15);
    ulong weight = words - before / 2;
    if (before % 2 && size) { /* the second byte of a word */
        const ulong w = (ulong)*bytes << 8;
        sums += (ulong2)(w, weight * w);
        bytes++, size--, weight--;
    }
    while (size >= STEP_BYTES) {
        const uint steps = (uint)min(size / STEP_BYTES, (ulong)BLOCK_STEPS);
        uint16 even_s = 0, odd_s = 0, even_t = 0, odd_t = 0;
        for (uint step = 0; step < steps; step++) {
            const uint16 w = ((__global const step_bytes *)bytes)[step].words;
            even_s += w & 0xffffu;
            odd_s += w >> 16;
            even_t += even_s;
            odd_t += odd_s;
        }
        /* In even_t and odd_t a word of the last step counts once, one of the step before twice, and so on. */
        weight -= steps * STEP_WORDS;
        const ulong16 even = convert_ulong16(even_s), odd = convert_ulong16(odd_s);
        const ulong s = total(even + odd);
        const ulong late = STEP_WORDS * total(convert_ulong16(even_t) + convert_ulong16(odd_t));
        sums.x += s;
        sums.y = fold(sums.y) + weight * s + (late - total(2 * lane * even + (2 * lane + 1) * odd));
        bytes += steps * STEP_BYTES;
        size -= steps * STEP_BYTES;
    }
    for (; size > 1; size -= 2, bytes += 2, weight--) {
        const ulong w = bytes[0] | (ulong)bytes[1] << 8;
        sums += (ulong2)(w, weight * w);
    }
    if (size) sums += (ulong2)(*bytes, weight * *bytes);
    return (ulong2)(sums.x, fold(sums.y));
}

__kernel void sum_chunks_bs(__global ulong *restrict sums_bs, __global const uchar *restrict bytes_mx,
                            __global const int *restrict image_n, __global const int *restrict place_n,
                            const ulong piece, const ulong skipped, const ulong pieces, const ulong size_x,
                            const int size_n)
{
    const ulong b = get_global_id(0);
    const ulong words = (pieces * piece + 1) / 2;
    ulong2 sums = 0;
    for (int n = 0; n < size_n; n++) {
        __global const uchar *bytes = bytes_mx + image_n[n] * size_x + skipped + b * piece;
        sums = add_piece(sums, bytes, piece, place_n[n] * piece, words);
    }
    sums_bs[2 * b] = sums.x;
    sums_bs[2 * b + 1] = sums.y;
}
