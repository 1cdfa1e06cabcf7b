/* Decode one subband of the channels of a map's quantiser indices: what subbands.py and range_coding.py say, bit for bit, at
 * the speed of a compiled loop. One work-item: every symbol hangs on those before it.
 *
 *   index_chw    (c, h, w) int     decoded into
 *   size_chw     (c, h, w) int     magnitudes of the differences from the prediction, for contexts
 *   place_f      (f) int           first row and column, rows, columns, 0 for LL and 1 for details, number of
 *                                  relatives, and of each first row and column, rows, columns, and 1 where it is of
 *                                  a coarser level
 *   slope_c      (c) double        of indices on those of the channel before
 *   found_ct     (c, 3) long       what slopes are learnt from: sums of products with the channel before and of its
 *                                  squares, of indices divided by 2^shift, and the shift
 *   counts_ms    (m, ALPHABET) long    frequency tables of magnitudes
 *   signs_ab     (5, 2) long           of signs
 *   state_n      (n) ulong         the range coder between two launches, and what a launch found: see LOWER, ...
 *   words_v      (v) uint          what is decoded
 *   scratch_q    (q) int           SCRATCH for each sample of the largest batch, and TABLES
 *
 * The range coder is constriction's RangeEncoder with words of 32 bits and 24 bits of precision; a frequency table
 * becomes cumulative as its Categorical(perfect=False) does it: left_s = trunc(sum_{t < s} count_t scale) + s,
 * scale = (2^24 - symbols) / total, in double, which every device rounds alike.
 */
#pragma OPENCL EXTENSION cl_khr_fp64 : enable
/* Each double operation is rounded by itself, or predictions would differ from those of other decoders. */
#pragma OPENCL FP_CONTRACT OFF
#include "common/inline.clh"

#define DIRECT 16
#define ALPHABET (DIRECT + 4 * 27)
#define CLASSES 64
#define PREDICTED 3
#define CONTEXTS (PREDICTED * CLASSES) /* of one site */
#define SCRATCH 4
#define TABLES (CONTEXTS + ALPHABET + ALPHABET + 1)
#define GAIN 1024
#define LIMIT (GAIN * 8192L)
#define RAW_DIGIT 23
#define WIDEST 28
#define MAX_SIZE (1 << 22)
#define MAX_PREDICTED (1 << 29)
#define MAX_DIFFERENCE (1 << 30)
#define PRECISION 24

enum { LOWER, RANGE, POINT, AT, FAULT };
enum { SOUND, IMPOSSIBLE, TOO_LARGE };

/* The range decoder while a launch lasts. */
typedef struct {
    ulong lower, range, point;
    ulong at, size;       /* in words */
    int fault;
    __global const uint *words;
} coder_t;

/* Where the next symbol lies in [0, 2^24). */
INLINE uint decode_place(coder_t *coder)
{
    const ulong place = (coder->point - coder->lower) / (coder->range >> PRECISION);
    if (place >> PRECISION)
        coder->fault = IMPOSSIBLE;
    return coder->fault ? 0 : (uint)place;
}

INLINE void decode_part(coder_t *coder, const uint left, const uint size)
{
    const ulong scale = coder->range >> PRECISION;
    coder->lower += scale * left;
    coder->range = scale * size;
    if (coder->range >> 32)
        return;
    coder->lower <<= 32;
    coder->range <<= 32;
    coder->point <<= 32;
    if (coder->at < coder->size)
        coder->point |= coder->words[coder->at++];
}

/* An integer of at most RAW_DIGIT bits, all alike. */
INLINE int decode_digit(coder_t *coder, const int bits)
{
    const int shift = PRECISION - bits;
    const uint digit = decode_place(coder) >> shift;
    decode_part(coder, digit << shift, 1u << shift);
    return (int)digit;
}

/* The bounds of each symbol, in left. */
INLINE void accumulate(__global const long *counts, __global uint *left, const int symbols)
{
    long total = 0, below = 0;
    for (int s = 0; s < symbols; ++s)
        total += counts[s];
    const double scale = (double)((1 << PRECISION) - symbols) / (double)total;
    for (int s = 0; s < symbols; ++s) {
        left[s] = (uint)((double)below * scale) + (uint)s;
        below += counts[s];
    }
    left[symbols] = 1u << PRECISION;
}

INLINE int decode_symbol(coder_t *coder, __global const uint *left)
{
    const uint place = decode_place(coder);
    int s = 0;
    while (left[s + 1] <= place)
        ++s;
    decode_part(coder, left[s], left[s + 1] - left[s]);
    return s;
}

INLINE void learn(__global long *counts, __global const uint *seen, const int symbols)
{
    long weight = 0;
    for (int s = 0; s < symbols; ++s)
        weight += counts[s] += (long)GAIN * seen[s];
    while (weight > LIMIT) {
        weight = 0;
        for (int s = 0; s < symbols; ++s)
            weight += counts[s] = (counts[s] + 1) >> 1;
    }
}

INLINE int octave_of(const uint value) { return 31 - (int)clz(value); }

INLINE int raw_bits_of(const int symbol) { return symbol < DIRECT ? 0 : 2 + (symbol - DIRECT) / 4; }

INLINE int first_of(const int symbol)
{
    return symbol < DIRECT ? symbol : (4 + (symbol - DIRECT) % 4) << raw_bits_of(symbol);
}

/* Two classes an octave. */
INLINE int class_of(const uint activity)
{
    if (activity < 2)
        return (int)activity;
    const int octave = octave_of(activity);
    return 2 * octave + (int)((activity >> (octave - 1)) & 1u);
}

/* One subband of one channel, and what its contexts are made of. */
typedef struct {
    __global int *index, *size;          /* of the subband's first sample */
    __global const int *size_of_channel; /* of the channel's first sample */
    __global const int *place;
    size_t plane;
    int pitch, rows, columns, site, channel;
    double slope;
} band_t;

/* Expected from the channel before; rounded to even by what a double cannot hold. */
INLINE int predict(const band_t *band, const size_t at)
{
    if (band->channel == 0)
        return 0;
    const double magic = 6755399441055744.0, here = band->index[(ptrdiff_t)at - (ptrdiff_t)band->plane] * band->slope;
    const double expected = (here + magic) - magic, most = MAX_PREDICTED;
    return (int)(expected > most ? most : expected < -most ? -most : expected);
}

/* floor(sum / count) */
INLINE long floor_mean(const long sum, const int count)
{
    const long mean = sum / count;
    return mean - (sum % count < 0);
}

/* Offsets of the neighbours of a sample that are coded in earlier cosets. */
INLINE void list_neighbours(const band_t *band, const int coset, int *offsets)
{
    const int diagonal = coset == 1, pitch = band->pitch;
    offsets[0] = diagonal ? -pitch - 1 : -1;
    offsets[1] = diagonal ? -pitch + 1 : 1;
    offsets[2] = diagonal ? pitch - 1 : -pitch;
    offsets[3] = diagonal ? pitch + 1 : pitch;
}

/* Which of them lie inside the subband, as bits. */
INLINE int find_inside(const band_t *band, const int coset, const int y, const int x)
{
    const int left = x > 0, right = x + 1 < band->columns, up = y > 0, down = y + 1 < band->rows;
    if (coset == 1)
        return (up & left) | (up & right) << 1 | (down & left) << 2 | (down & right) << 3;
    return left | right << 1 | up << 2 | down << 3;
}

/* The mean of the neighbours' differences, rounded down. */
INLINE long expect_low(const band_t *band, const int coset, const int y, const int x)
{
    const size_t at = (size_t)y * band->pitch + x;
    const int inside = find_inside(band, coset, y, x);
    long sum = 0;
    int offsets[4];
    list_neighbours(band, coset, offsets);
    for (int n = 0; n < 4; ++n)
        if (inside >> n & 1)
            sum += (long)band->index[at + offsets[n]] - predict(band, at + offsets[n]);
    return floor_mean(sum, max((int)popcount(inside), 1));
}

/* Four times the neighbours' mean size. */
INLINE uint find_nearby(const band_t *band, const int coset, const int y, const int x, const int *offsets)
{
    __global const int *size = band->size + (size_t)y * band->pitch + x;
    if (y > 0 && x > 0 && y + 1 < band->rows && x + 1 < band->columns)
        return size[offsets[0]] + size[offsets[1]] + size[offsets[2]] + size[offsets[3]];
    const int inside = find_inside(band, coset, y, x);
    uint sum = 0;
    for (int n = 0; n < 4; ++n)
        if (inside >> n & 1)
            sum += size[offsets[n]];
    return 4 * sum / max((int)popcount(inside), 1);
}

/* What sizes tell of a row's samples: those of relatives, and of the channel before. */
typedef struct {
    __global const int *relatives[3], *before;
    int ends[3], halved[3];
    int count, hints;
} hints_t;

INLINE hints_t find_hints(const band_t *band, const int y)
{
    hints_t hints;
    hints.count = band->place[5];
    for (int r = 0; r < hints.count; ++r) {
        __global const int *relative = band->place + 6 + 5 * r;
        const int row = relative[4] ? y / 2 : y;
        hints.relatives[r] = band->size_of_channel + (size_t)(relative[0] + row) * band->pitch + relative[1];
        hints.ends[r] = row < relative[2] ? relative[3] : 0;
        hints.halved[r] = relative[4];
    }
    hints.before = band->size + (ptrdiff_t)((size_t)y * band->pitch) - (ptrdiff_t)band->plane;
    hints.hints = hints.count + (band->channel > 0);
    return hints;
}

/* Four times their mean. */
INLINE uint find_hinted(const band_t *band, const hints_t *hints, const int x)
{
    uint sum = band->channel ? hints->before[x] : 0;
    for (int r = 0; r < hints->count; ++r) {
        const int column = x >> hints->halved[r];
        sum += column < hints->ends[r] ? hints->relatives[r][column] : 0;
    }
    switch (hints->hints) {
    case 0:
        return 0;
    case 1:
        return 4 * sum;
    case 2:
        return 2 * sum;
    case 3:
        return 4 * sum / 3;
    default:
        return sum;
    }
}

#define EACH_ROW(from, to)                        \
    for (int coset = from; coset <= to; ++coset) \
        for (int y = coset == 1 || coset == 3; y < band->rows; y += 2)
#define EACH_SAMPLE_OF_ROW for (int x = coset == 1 || coset == 2; x < band->columns; x += 2, ++i)

/* What is to be coded, in LL less what the samples before tell: the one to the left, or the neighbours. */
INLINE long expect_difference(const band_t *band, const int coset, const int y, const int x)
{
    const size_t at = (size_t)y * band->pitch + x;
    if (coset)
        return expect_low(band, coset, y, x);
    if (x + y == 0)
        return 0;
    const size_t before = x ? at - 2 : at - 2 * (size_t)band->pitch;
    return (long)band->index[before] - predict(band, before);
}

/* Arrays of the samples of a batch, and of contexts. */
typedef struct {
    __global int *residual, *context, *order, *symbol;
    __global uint *ends, *seen, *left;
    int samples;
} batch_t;

/* Contexts in the lower 16 bits, what is predicted above them. */
INLINE void gather_batch(const band_t *band, batch_t *batch, const int from, const int to)
{
    int i = 0;
    for (int m = 0; m < CONTEXTS; ++m)
        batch->ends[m] = 0;
    EACH_ROW(from, to)
    {
        const hints_t hints = find_hints(band, y);
        int offsets[4];
        list_neighbours(band, coset, offsets);
        EACH_SAMPLE_OF_ROW
        {
            const size_t at = (size_t)y * band->pitch + x;
            const int expected = predict(band, at), near = clamp(expected, -2, 2);
            const uint hinted = find_hinted(band, &hints, x);
            const uint activity = coset ? 3 * find_nearby(band, coset, y, x, offsets) + hinted : 4 * hinted;
            const int m = (int)abs(near) * CLASSES + class_of(activity);
            batch->context[i] = m | (near + 2) << 16;
            batch->ends[m]++;
        }
    }
    batch->samples = i;
    /* Contexts one after another, of each the samples in their order. */
    int end = 0;
    for (int m = 0; m < CONTEXTS; ++m) {
        const int first = end;
        end += batch->ends[m];
        batch->ends[m] = first;
    }
    for (i = 0; i < batch->samples; ++i)
        batch->order[batch->ends[batch->context[i] & 0xffff]++] = i;
}

INLINE void decode_symbols(batch_t *batch, coder_t *coder, __global long *counts)
{
    for (int m = 0, first = 0; m < CONTEXTS; first = batch->ends[m++]) {
        const int end = batch->ends[m];
        if (first == end)
            continue;
        accumulate(counts + m * ALPHABET, batch->left, ALPHABET);
        for (int s = 0; s < ALPHABET; ++s)
            batch->seen[s] = 0;
        for (int n = first; n < end; ++n) {
            const int i = batch->order[n];
            const int s = decode_symbol(coder, batch->left);
            batch->symbol[i] = s;
            batch->seen[s]++;
        }
        learn(counts + m * ALPHABET, batch->seen, ALPHABET);
    }
}

/* The bits below large symbols, narrow ones first. */
INLINE void decode_raw(batch_t *batch, coder_t *coder)
{
    int large = 0, widest = 0;
    for (int i = 0; i < batch->samples; ++i) {
        if (batch->symbol[i] >= DIRECT) {
            batch->order[large++] = i;
            widest = max(widest, raw_bits_of(batch->symbol[i]));
        }
        batch->residual[i] = first_of(batch->symbol[i]);
    }
    for (int width = 2; width <= widest; ++width) {
        for (int shift = 0; shift < width; shift += RAW_DIGIT) {
            const int bits = min(RAW_DIGIT, width - shift);
            for (int n = 0; n < large; ++n) {
                const int i = batch->order[n];
                if (raw_bits_of(batch->symbol[i]) != width)
                    continue;
                batch->residual[i] += decode_digit(coder, bits) << shift;
            }
        }
    }
}

/* In the context of what is predicted. */
INLINE void decode_signs(batch_t *batch, coder_t *coder, __global long *signs)
{
    uint present = 0;
    for (int i = 0; i < batch->samples; ++i)
        present |= batch->symbol[i] ? 1u << (batch->context[i] >> 16) : 0u;
    for (int near = 0; near < 5; ++near) {
        if (!(present >> near & 1))
            continue;
        accumulate(signs + 2 * near, batch->left, 2);
        batch->seen[0] = batch->seen[1] = 0;
        for (int i = 0; i < batch->samples; ++i) {
            if (batch->symbol[i] == 0 || batch->context[i] >> 16 != near)
                continue;
            const int negative = decode_symbol(coder, batch->left);
            batch->seen[negative]++;
            if (negative)
                batch->residual[i] = -batch->residual[i];
        }
        learn(signs + 2 * near, batch->seen, 2);
    }
}

INLINE void keep_batch(const band_t *band, const batch_t *batch, coder_t *coder, const int from, const int to)
{
    int i = 0;
    EACH_ROW(from, to) EACH_SAMPLE_OF_ROW
    {
        const size_t at = (size_t)y * band->pitch + x;
        band->size[at] = (int)min(abs(batch->residual[i]), (uint)MAX_SIZE);
        long value = batch->residual[i] + (band->site ? 0 : expect_difference(band, coset, y, x));
        if (value > MAX_DIFFERENCE || value < -MAX_DIFFERENCE) {
            coder->fault = coder->fault ? coder->fault : TOO_LARGE;
            value = 0;
        }
        band->index[at] = predict(band, at) + (int)value;
    }
}

/* Sums of products and squares of the channel before, of integers small enough that sums are exact. */
INLINE void measure_slope(const band_t *band, __global long *found)
{
    uint largest = 0;
    long product = 0, square = 0;
    for (int y = 0; y < band->rows; ++y)
        for (int x = 0; x < band->columns; ++x) {
            const ptrdiff_t at = (ptrdiff_t)y * band->pitch + x;
            largest = max(largest, max(abs(band->index[at]), abs(band->index[at - (ptrdiff_t)band->plane])));
        }
    const int shift = max(largest ? octave_of(largest) + 1 - 20 : 0, 0);
    for (int y = 0; y < band->rows; ++y)
        for (int x = 0; x < band->columns; ++x) {
            const ptrdiff_t at = (ptrdiff_t)y * band->pitch + x;
            const long before = band->index[at - (ptrdiff_t)band->plane] >> shift, here = band->index[at] >> shift;
            product += before * here;
            square += before * before;
        }
    found[0] = product;
    found[1] = square;
    found[2] = shift;
}

__kernel void decode_subband(__global int *index_chw, __global int *size_chw, __global const int *place_f,
                           __global const double *slope_c, __global long *found_ct, __global long *counts_ms,
                           __global long *signs_ab, __global ulong *state_n, __global const uint *words_v,
                           __global int *scratch_q, const int size_c, const int size_h, const int size_w,
                           const ulong size_v, const ulong size_q)
{
    const size_t plane = (size_t)size_h * size_w, start = (size_t)place_f[0] * size_w + place_f[1];
    const size_t capacity = (size_q - TABLES) / SCRATCH;
    coder_t coder = {state_n[LOWER], state_n[RANGE], state_n[POINT], state_n[AT], size_v, SOUND, words_v};
    batch_t batch = {scratch_q, scratch_q + capacity, scratch_q + 2 * capacity, scratch_q + 3 * capacity};
    batch.ends = (__global uint *)(scratch_q + SCRATCH * capacity);
    batch.seen = batch.ends + CONTEXTS;
    batch.left = batch.seen + ALPHABET;
    for (int channel = 0; channel < size_c && coder.fault == SOUND; ++channel) {
        const int site = place_f[4] && channel ? 2 : place_f[4];
        __global int *sizes = size_chw + channel * plane;
        const band_t band = {index_chw + channel * plane + start, sizes + start, sizes, place_f, plane, size_w,
                             place_f[2], place_f[3], site, channel, slope_c[channel]};
        for (int from = 0; from < 3 && coder.fault == SOUND; ++from) {
            const int to = from + (from == 2);
            gather_batch(&band, &batch, from, to);
            decode_symbols(&batch, &coder, counts_ms + (size_t)(2 * site + (from > 0)) * CONTEXTS * ALPHABET);
            decode_raw(&batch, &coder);
            decode_signs(&batch, &coder, signs_ab);
            keep_batch(&band, &batch, &coder, from, to);
        }
        if (channel)
            measure_slope(&band, found_ct + 3 * channel);
    }
    state_n[LOWER] = coder.lower;
    state_n[RANGE] = coder.range;
    state_n[POINT] = coder.point;
    state_n[AT] = coder.at;
    state_n[FAULT] = coder.fault;
}
