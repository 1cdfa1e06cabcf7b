/* Decode units: see units.clh, and units.py for what the arrays hold. */
#define PARENT_T uchar
#define PARENT_SIZES
#include "codec/units.clh"

/* A stream being read: four rANS states, words of 16 bits from its front, and bits as they are from its back. */
typedef struct {
    uint state[LANES];
    __global const uchar *bytes;
    uint at, end;  /* of words, and of what is left for them */
    ulong bits;    /* from the back */
    int held;
    int coarse; /* bits of every magnitude that contexts do not look at */
    int fault;
} decoder_t;

INLINE uint next_word(decoder_t *d)
{
    if (d->at + 2 > d->end) {
        d->fault = 1;
        return 0;
    }
    const uint word = d->bytes[d->at] | (uint)d->bytes[d->at + 1] << 8;
    d->at += 2;
    return word;
}

INLINE uint take_bits(decoder_t *d, const int count)
{
    while (d->held < count) {
        if (d->end <= d->at) {
            d->fault = 1;
            return 0;
        }
        d->bits |= (ulong)d->bytes[--d->end] << d->held;
        d->held += 8;
    }
    const uint value = (uint)(d->bits & ((1ul << count) - 1ul));
    d->bits >>= count;
    d->held -= count;
    return value;
}

/* Bits ahead, many at once, where there are many: the same that `take_bits` would take one byte at a time. */
INLINE void fetch_bits(decoder_t *d)
{
    if (d->held >= 32 || d->end - d->at < 4)
        return;
    __global const uchar *from = d->bytes + d->end - 4;
    const uint four = (uint)from[0] << 24 | (uint)from[1] << 16 | (uint)from[2] << 8 | from[3];
    d->bits |= (ulong)four << d->held;
    d->held += 32;
    d->end -= 4;
}

/* Bytes back that were fetched and not begun: words may follow. */
INLINE void return_bits(decoder_t *d)
{
    const int whole = d->held >> 3;
    d->end += whole;
    d->held -= 8 * whole;
    d->bits &= (1ul << d->held) - 1ul;
}

/* Exp-Golomb of an order. */
INLINE int take_large(decoder_t *d, const int order)
{
    int octave = order;
    while (octave < 28 && !d->fault && !take_bits(d, 1))
        octave++;
    return (int)((1u << octave) | (octave ? take_bits(d, octave) : 0u)) - (1 << order);
}

INLINE void begin_stream(decoder_t *d, __global const uchar *bytes, const uint size)
{
    d->bytes = bytes;
    d->at = 4 * LANES;
    d->end = size;
    d->bits = 0;
    d->held = 0;
    d->fault = size < 4 * LANES;
    for (int lane = 0; lane < LANES; ++lane)
        d->state[lane] = d->fault ? RENORMALISED
                                  : bytes[4 * lane] | (uint)bytes[4 * lane + 1] << 8 | (uint)bytes[4 * lane + 2] << 16 |
                                        (uint)bytes[4 * lane + 3] << 24;
}

/* Whether all was read that there is, and nothing else. */
INLINE int is_spent(const decoder_t *d)
{
    int spent = d->at == d->end && d->held < 8 && d->bits == 0;
    for (int lane = 0; lane < LANES; ++lane)
        spent &= d->state[lane] == RENORMALISED;
    return spent;
}

/* The last symbol whose share begins at or before a slot. */
INLINE int find_symbol(__global const ushort *left, const uint slot)
{
#if defined(__AVX512BW__) && defined(__AVX512VL__)
    const short16 begins = as_short16(LOAD(ushort16, left)), at = (short)slot;
    return __builtin_popcount((uint)__builtin_ia32_ucmpw256_mask(begins, at, 2, 0xffff)) - 1; /* those that do not pass it */
#elif defined(__SSE2__)
    const short8 low = as_short8(LOAD(ushort8, left)), high = as_short8(LOAD(ushort8, left + 8)), end = (short)(slot + 1);
    return octave_of((uint)__builtin_ia32_pmovmskb128(__builtin_ia32_packsswb128(end > low, end > high)));
#else
    const short16 begins = as_short16(LOAD(ushort16, left)), reached = begins <= (short)slot;
    const short8 a = reached.lo + reached.hi;
    const short4 b = a.lo + a.hi;
    const short2 c = b.lo + b.hi;
    return -(c.x + c.y) - 1;
#endif
}

INLINE uint renormalise(decoder_t *d, const uint state) { return state < RENORMALISED ? state << 16 | next_word(d) : state; }

/* Behind the last share of a context stands a 0, which begins the next: less than all of the slots are any symbol's. */
#define DECODE(state, context, symbol)                                                      \
    {                                                                                       \
        __global const ushort *left = work->left + (context)*SYMBOLS;                       \
        const uint slot = (state) & (ONE - 1);                                              \
        const int found = find_symbol(left, slot);                                          \
        const uint both = LOAD(uint, left + found), begin = both & 0xffff;                  \
        const uint share = ((both >> 16) - begin) & (ONE - 1);                              \
        state = share * ((state) >> PRECISION) + slot - begin;                              \
        symbol = found;                                                                     \
    }

/* The same as `renormalise` where there are words for all lanes: which take one is hard to foretell. */
#define RENORMALISE(state)                                                                  \
    {                                                                                       \
        __global const uchar *from = d->bytes + at;                                         \
        const uint word = from[0] | (uint)from[1] << 8;                                     \
        const uint few = (state) < RENORMALISED;                                            \
        state = (state) << (few << 4) | (word & (0u - few));                                \
        at += few << 1;                                                                     \
    }

INLINE int decode_flag(decoder_t *d, __global work_t *work, const int flag)
{
    const uint zero = work->zero[flag], state = d->state[0], slot = state & (ONE - 1);
    const int value = slot >= zero;
    const uint begin = value ? zero : 0, size = value ? ONE - zero : zero;
    d->state[0] = renormalise(d, size * (state >> PRECISION) + slot - begin);
    learn_flag(work, flag, value);
    return value;
}

INLINE void note_symbol(__global work_t *work, const int context, const int symbol, int *due)
{
    work->count[context * SYMBOLS + symbol]++;
    if (--work->patience[context] == 0)
        work->due[(*due)++] = (ushort)context;
}

/* Where the values of decoded indices go: to a plane, or times weights to each of some sums. */
typedef struct {
    __global float *value;
    __global const float *weight; /* of this plane, for each sum */
    __global const int *place;    /* of the unit's subband: see units.py */
    size_t plane_size;
    int pitch, sums;
} sink_t;

enum { PLACES = 6, RUN = 32 /* samples that a word of `kept` is of */ };

INLINE void put(const sink_t *sink, const int y, const int x, const int index)
{
    const int row = sink->place[0] + y, column = sink->place[1] + x;
    if (row < sink->place[2] || row >= sink->place[3] || column < sink->place[4] || column >= sink->place[5])
        return;
    __global float *to = sink->value + (size_t)row * sink->pitch + column;
    const float value = (float)index;
    if (sink->sums == 3) { /* of one light */
        __global float *green = to + sink->plane_size, *blue = green + sink->plane_size;
        const float r = *to + sink->weight[0] * value, g = *green + sink->weight[1] * value;
        const float b = *blue + sink->weight[2] * value;
        *to = r;
        *green = g;
        *blue = b;
    } else if (sink->sums)
        for (int c = 0; c < sink->sums; ++c)
            to[c * sink->plane_size] += sink->weight[c] * value;
    else
        *to = value;
}

/* What of a plane the units of finer levels ask for: sizes of all levels but the finest. */
typedef struct {
    __global uchar *size;
    size_t plane_size;
    int pitch;
    int coarse; /* bits of them that the next finer level's contexts do not look at */
} known_t;

/* Compilers would make vectors of what is faster as it is: of a number that an instruction may have changed they do not. */
#ifdef __x86_64__
#define ALONE(number) __asm__("" : "+r"(number));
#else
#define ALONE(number)
#endif

/* Symbols of a batch, one lane after another: until it is over, no share moves. */
INLINE void find_symbols(decoder_t *d, __global const work_t *work, __global uchar *symbol, const int samples)
{
    __global const ushort *context = work->context;
    uint a = d->state[0], b = d->state[1], c = d->state[2], e = d->state[3];
    const int whole = samples & ~(LANES - 1);
    int i = 0;
    while (i < whole) {
        uint at = d->at;
        const int steps = (int)((d->end - at) / (2 * LANES)), last = LEAST(whole, i + LANES * LEAST(steps, UNIT * UNIT));
        for (; i < last; i += LANES) {
            DECODE(a, context[i] & 0xfff, symbol[i])
            DECODE(b, context[i + 1] & 0xfff, symbol[i + 1])
            DECODE(c, context[i + 2] & 0xfff, symbol[i + 2])
            DECODE(e, context[i + 3] & 0xfff, symbol[i + 3])
            RENORMALISE(a)
            ALONE(a)
            RENORMALISE(b)
            ALONE(b)
            RENORMALISE(c)
            ALONE(c)
            RENORMALISE(e)
            ALONE(e)
        }
        d->at = at;
        if (i == whole)
            break;
        DECODE(a, context[i] & 0xfff, symbol[i])
        DECODE(b, context[i + 1] & 0xfff, symbol[i + 1])
        DECODE(c, context[i + 2] & 0xfff, symbol[i + 2])
        DECODE(e, context[i + 3] & 0xfff, symbol[i + 3])
        a = renormalise(d, a);
        b = renormalise(d, b);
        c = renormalise(d, c);
        e = renormalise(d, e);
        i += LANES;
    }
    for (; i < samples; ++i) {
        DECODE(a, context[i] & 0xfff, symbol[i])
        a = renormalise(d, a);
    }
    d->state[0] = a;
    d->state[1] = b;
    d->state[2] = c;
    d->state[3] = e;
}

/* Which of 16 numbers are not 0, as bits. */
INLINE uint which_of(const ushort16 value)
{
#ifdef __SSE2__
    return (uint)__builtin_ia32_pmovmskb128(__builtin_convertvector((short16)(value != (ushort)0), char16));
#else
    const ushort16 bits = (ushort16)(1, 2, 4, 8, 16, 32, 64, 128, 256, 512, 1024, 2048, 4096, 8192, 16384, 32768);
    const ushort16 found = as_ushort16(value != (ushort)0) & bits;
    const ushort8 a = found.lo | found.hi;
    const ushort4 b = a.lo | a.hi;
    return (uint)(b.x | b.y | b.z | b.w);
#endif
}

/* Symbols of a batch in place of their contexts, and which of the samples are not 0, or may not be. */
INLINE void decode_symbols(decoder_t *d, __global work_t *work, const int samples)
{
    __global uchar *symbol = (__global uchar *)work->chosen;
    find_symbols(d, work, symbol, samples);
    int due = 0;
    for (int i = 0; i < samples; ++i)
        note_symbol(work, work->context[i] & 0xfff, symbol[i], &due);
    for (int first = 0; first < samples; first += RUN) { /* up to RUN - 1 more, of which nothing is kept */
        uint kept = 0;
        for (int i = 0; i < RUN; i += 16) {
            const ushort16 above = LOAD(ushort16, work->context + first + i) & (ushort)0xf000;
            const ushort16 found = above | WIDE(LOAD(uchar16, symbol + first + i));
            STORE(ushort16, work->context + first + i, found);
            kept |= which_of(found) << i;
        }
        const uint all = 0xffffffffu >> (RUN - LEAST(samples - first, RUN));
        work->kept[first / RUN] = d->coarse ? all : kept & all;
    }
    learn_due(work, due, 0);
}

/* Magnitudes and signs of a batch's samples that are not 0, and where they go. */
INLINE void place_samples(decoder_t *d, __global work_t *work, __global const int *unit, const sink_t *sink,
                          const known_t *known, const int band, const int samples)
{
    __global uchar *own = unit[LEVEL] > 1 ? known->size + unit[OFFSET + band] : 0;
    __global uchar *size = work->size + band * SIZES + PITCH + EDGE;
    for (int first = 0; first < samples && !d->fault; first += RUN)
        for (uint kept = work->kept[first / RUN]; kept && !d->fault; kept &= kept - 1) {
            const int i = first + octave_of(kept & (0u - kept));
            const int symbol = work->context[i] & 0xfff, above = work->context[i] >> 12, shift = above + d->coarse;
            fetch_bits(d);
            int magnitude = symbol == LAST ? LAST + take_large(d, ORDER(above)) : symbol;
            if (magnitude > MAX_MAGNITUDE >> shift) {
                d->fault = 1;
                break;
            }
            if (shift)
                magnitude = magnitude << shift | (int)take_bits(d, shift);
            if (magnitude == 0)
                continue;
            const int negative = (int)take_bits(d, 1), y = work->place[i] >> 6, x = work->place[i] & 63;
            put(sink, y, x, negative ? -magnitude : magnitude);
            size[y * PITCH + x] = (uchar)LEAST(magnitude >> d->coarse, MAX_SIZE);
            if (own)
                own[(size_t)y * known->pitch + x] = (uchar)LEAST(magnitude >> known->coarse, MAX_SIZE);
        }
    return_bits(d);
}

INLINE void decode_band(decoder_t *d, __global work_t *work, __global const int *unit, const sink_t *sink,
                        const known_t *known, const int band, const int plane)
{
    const int rows = unit[ROWS + band], columns = unit[COLUMNS + band];
    if (rows <= 0 || columns <= 0) {
        clear_sizes(work, band, UNIT); /* the next band looks there */
        return;
    }
    __global const uchar *parent = unit[PARENT + band] < 0 ? 0 : known->size + unit[PARENT + band];
    make_hints(work, band, plane, rows, columns, parent, unit[PARENT_ROWS + band], unit[PARENT_COLUMNS + band],
               known->pitch, known->plane_size, 0);
    clear_sizes(work, band, rows);
    const int any = decode_flag(d, work, band_flag(plane, sum_hints(work, rows, columns)));
    if (any) {
        int cells = 0;
        for (int i = 0; i < 100; ++i)
            work->flag[i] = 0;
        for (int row = 0; row * CELL < rows; ++row)
            for (int column = 0; column * CELL < columns; ++column) {
                const int value = decode_flag(d, work, cell_flag(work, row, column));
                work->flag[(row + 1) * 10 + column + 1] = (uchar)value;
                if (value)
                    work->cell[cells++] = (uchar)(row * CELL + column);
            }
        for (int batch = 0; batch < 3 && !d->fault; ++batch) {
            const int samples = gather_batch(work, band, plane, batch, rows, columns, cells);
            decode_symbols(d, work, samples);
            place_samples(d, work, unit, sink, known, band, samples);
        }
    }
    note_before(work, band, plane, rows);
}

/* LL of one plane. */
INLINE void decode_low(decoder_t *d, __global work_t *work, __global const int *unit, const sink_t *sink, const int plane)
{
    const int rows = unit[ROWS], columns = unit[COLUMNS];
    __global int *low = work->low_value;
    begin_low_plane(work);
    for (int y = 0; y < rows && !d->fault; ++y) {
        int due = 0;
        for (int x = 0; x < columns; ++x) {
            const int k = low_context(work, plane, y, x), shift = LOW_SHIFT(k), context = LOW_CONTEXT(k);
            uint state = d->state[0];
            int symbol;
            DECODE(state, context, symbol)
            d->state[0] = renormalise(d, state);
            note_symbol(work, context, symbol, &due);
            int size = symbol == LAST ? LAST + take_large(d, 0) : symbol;
            if (size > MAX_MAGNITUDE >> shift) {
                d->fault = 1;
                size = 0;
            }
            size = size << shift | (shift ? (int)take_bits(d, shift) : 0);
            const int negative = size ? (int)take_bits(d, 1) : 0;
            work->low[(y + 1) * (UNIT + 2) + x + 1] = size;
            const int value = expect_low(low + y * UNIT + x, UNIT, y, x) + (negative ? -size : size);
            if (value > MAX_MAGNITUDE || value < -MAX_MAGNITUDE)
                d->fault = 1;
            low[y * UNIT + x] = d->fault ? 0 : value;
        }
        learn_due(work, due, 0);
    }
    note_low(work, rows, columns);
    for (int y = 0; y < rows && !d->fault; ++y) /* rows that were not reached hold anything */
        for (int x = 0; x < columns; ++x)
            if (low[y * UNIT + x])
                put(sink, y, x, low[y * UNIT + x]);
}

/* Streams of units, one after another.
 *
 *   value_cyx   (C, Y, X) float  zeros at first: a plane each, or `sums` sums of all planes times weight_jn
 *   known_jrk   (J, R, K) uchar  zeros at first: sizes of all levels but the finest, where unit_uf says
 *   coarse_jl   (J, COARSE) int  bits that contexts do not look at, of LL first
 */
__kernel void decode_units(__global float *value_cyx, __global uchar *known_jrk, __global const float *weight_jn,
                           __global const uchar *stream_b, __global const uint *place_t2, __global const int *part_t4,
                           __global const int *unit_uf, __global const int *place_uv, __global const ushort *count_ms,
                           __global const ushort *flag_q2, __global const int *coarse_jl, __global uchar *work_wd,
                           __global int *fault_t, const int begin, const int end, const int sums, const int size_y,
                           const int size_x, const int size_r, const int size_k)
{
    __global work_t *work = (__global work_t *)(work_wd + get_global_id(0) * (size_t)WORK_BYTES);
    sink_t sink = {value_cyx, weight_jn, place_uv, (size_t)size_y * size_x, size_x, sums};
    known_t known = {known_jrk, (size_t)size_r * size_k, size_k, 0};
    for (int t = begin + get_global_id(0); t < end; t += get_global_size(0)) {
        decoder_t d;
        begin_stream(&d, stream_b + place_t2[2 * t], place_t2[2 * t + 1]);
        begin_tables(work, count_ms, flag_q2, 0);
        for (int u = part_t4[4 * t]; u < part_t4[4 * t + 1] && !d.fault; ++u) {
            __global const int *unit = unit_uf + u * UNIT_FIELDS;
            const int level = unit[LEVEL];
            if (level == 0)
                begin_low(work);
            for (int j = part_t4[4 * t + 2], first = j; j < part_t4[4 * t + 3] && !d.fault; ++j) {
                __global const int *coarse = coarse_jl + j * COARSE;
                if (sums)
                    sink.weight = weight_jn + (size_t)j * sums;
                else
                    sink.value = value_cyx + j * sink.plane_size;
                known.size = known_jrk + j * known.plane_size;
                known.coarse = level > 1 ? coarse[level - 1] : 0;
                sink.place = place_uv + u * 3 * PLACES;
                d.coarse = coarse[level];
                if (level == 0)
                    decode_low(&d, work, unit, &sink, j - first);
                else
                    for (int band = 0; band < 3; ++band, sink.place += PLACES)
                        decode_band(&d, work, unit, &sink, &known, band, j - first);
            }
        }
        fault_t[t] = d.fault || !is_spent(&d);
    }
}
