/* Encode units, choosing indices by what they cost: see units.clh, and units.py for what the arrays hold. */
#define PARENT_T int
#include "codec/units.clh"

/* What a stream will say, until its end is known: rANS goes backward. */
typedef struct {
    __global uint *item; /* begin, size << 14, lane << 29 */
    uint items, room;
    __global uchar *raw; /* bits as they are */
    uint raw_size, raw_room;
    ulong bits;
    int held;
    float multiplier, scale;
    int coarse; /* bits of every magnitude that contexts do not look at */
    int full;
    int kept; /* whether anybody looks at the unit's indices */
} encoder_t;

INLINE void put_item(encoder_t *e, const uint begin, const uint size, const uint lane)
{
    if (e->items >= e->room) {
        e->full = 1;
        return;
    }
    e->item[e->items++] = begin | size << PRECISION | lane << 29;
}

INLINE void put_bits(encoder_t *e, const uint value, const int count)
{
    e->bits |= (ulong)value << e->held;
    e->held += count;
    while (e->held >= 8) {
        if (e->raw_size >= e->raw_room)
            e->full = 1;
        else
            e->raw[e->raw_size++] = (uchar)e->bits;
        e->bits >>= 8;
        e->held -= 8;
    }
}

/* Exp-Golomb of an order; returns the bits. */
INLINE int put_large(encoder_t *e, const int excess, const int order)
{
    const uint value = (uint)excess + (1u << order);
    const int octave = octave_of(value);
    for (int i = order; i < octave; ++i)
        put_bits(e, 0, 1);
    put_bits(e, 1, 1);
    if (octave)
        put_bits(e, value & ((1u << octave) - 1u), octave);
    return 2 * octave + 1 - order;
}

INLINE void encode_flag(encoder_t *e, __global work_t *work, const int flag, const int value, __global uint *seen)
{
    const uint zero = work->zero[flag];
    put_item(e, value ? zero : 0, value ? ONE - zero : zero, 0);
    if (seen)
        seen[CONTEXTS * SYMBOLS + 2 * flag + value]++;
    learn_flag(work, flag, value);
}

INLINE float flag_bits(__global const work_t *work, const int flag, const int value)
{
    const int zero = work->zero[flag];
    return PRECISION - native_log2((float)(value ? ONE - zero : zero));
}

INLINE void encode_symbol(encoder_t *e, __global work_t *work, const int context, const int symbol, const int lane,
                          int *due, __global uint *seen)
{
    __global const ushort *left = work->left + context * SYMBOLS;
    const uint begin = left[symbol], right = symbol < LAST ? left[symbol + 1] : ONE;
    put_item(e, begin, right - begin, (uint)lane);
    if (seen)
        seen[context * SYMBOLS + symbol]++;
    work->count[context * SYMBOLS + symbol]++;
    if (--work->patience[context] == 0)
        work->due[(*due)++] = (ushort)context;
}

#define EACH(from, at) \
    (from)[at.s0], (from)[at.s1], (from)[at.s2], (from)[at.s3], (from)[at.s4], (from)[at.s5], (from)[at.s6], (from)[at.s7]

/* What is lost at best of samples of sizes `a`, in squared steps: their error, and their bits at their multiplier. Where
 * the costs of each sample's symbols begin, and those of its 0. */
INLINE float8 least_losses(__global const float *cost, const int8 begin, const float8 cost_0, const float multiplier,
                           const float8 a, int8 *chosen)
{
    const float8 largest = (float)(LAST - 1);
    const int8 nearest = __builtin_convertvector((a < largest ? a : largest) + 0.5f, int8);
    const int8 lower = nearest > 2 ? nearest - 1 : 1, at_lower = begin + lower, at_nearest = begin + nearest;
    const float8 less = a - __builtin_convertvector(lower, float8), off = a - __builtin_convertvector(nearest, float8);
    const float8 of_lower = less * less + multiplier * ((float8)(EACH(cost, at_lower)) + 1.0f);
    const float8 of_nearest = off * off + multiplier * ((float8)(EACH(cost, at_nearest)) + 1.0f);
    const float8 of_0 = a * a + multiplier * cost_0;
    const int8 any = nearest > 0;
    const int8 is_lower = any & (of_lower < of_0);
    const float8 least = is_lower ? of_lower : of_0;
    const int8 is_nearest = any & (of_nearest < least);
    *chosen = is_nearest ? nearest : is_lower ? lower : 0;
    return is_nearest ? of_nearest : least;
}

INLINE int any_of(const int8 mask)
{
    const int4 four = mask.lo | mask.hi;
    return four.x | four.y | four.z | four.w;
}

INLINE float8 size_of(const float8 value) { return as_float8(as_int8(value) & 0x7fffffff); }

/* A row of a cell: 0 beyond the band. */
INLINE float8 load_row(__global const float *value, const int columns, const float scale)
{
    if (columns >= CELL)
        return LOAD(float8, value) * scale;
    float8 row = 0.0f;
    for (int x = 0; x < columns; ++x)
        ((float *)&row)[x] = value[x] * scale;
    return row;
}

INLINE void clear_row(__global int *index, const int columns)
{
    if (columns >= CELL)
        STORE(int8, index, 0);
    else
        for (int x = 0; x < columns; ++x)
            index[x] = 0;
}

INLINE float sum_of(const float8 value)
{
    const float4 four = value.lo + value.hi;
    return (four.x + four.y) + (four.z + four.w);
}

/* What a cell saves in squared error less the multiplier of its bits: judged by hints, and by what the samples to the left
 * and above would be. */
INLINE float find_gain(const encoder_t *e, __global const work_t *work, __global const float *value, const int plane,
                       const int top, const int left, const int rows, const int columns, const int pitch)
{
    const int base = context_base(plane);
    float8 gains = 0.0f;
    int8 up = 0;
    for (int y = top; y < rows; ++y) {
        const float8 a = size_of(load_row(value + (size_t)y * pitch + left, columns - left, e->scale));
        const int8 nearest = __builtin_convertvector(a + 0.4f, int8), before = (int8)(0, nearest.s0123, nearest.s45, nearest.s6);
        const int8 hint = __builtin_convertvector(LOAD(ushort8, work->hint + y * UNIT + left), int8);
        const int8 context = base + classes_of(2 * (before + up), NEAR - 2) * HINT + classes_of(hint, HINT - 1);
        up = nearest;
        const int8 begin = context * SYMBOLS;
        const float8 cost_0 = (float8)(EACH(work->cost, begin)), of_0 = e->multiplier * cost_0;
        const int8 inside = (int8)(0, 1, 2, 3, 4, 5, 6, 7) < columns - left, any = a >= 0.5f;
        float8 saved = -of_0;
        if (any_of(any)) {
            int8 chosen;
            saved = a * a - least_losses(work->cost, begin, cost_0, e->multiplier, a, &chosen);
        }
        gains += inside ? saved : 0.0f;
    }
    return sum_of(gains);
}

/* Which cells are worth their bits. */
INLINE int choose_cells(encoder_t *e, __global work_t *work, __global const float *value, __global int *index,
                        const int plane, const int rows, const int columns, const int pitch, const size_t plane_size, float *error)
{
    int cells = 0;
    for (int i = 0; i < 100; ++i)
        work->flag[i] = 0;
    for (int top = 0; top < rows; top += CELL)
        for (int left = 0; left < columns; left += CELL) {
            const int bottom = LEAST(top + CELL, rows);
            float8 most = 0.0f, squares = 0.0f;
            for (int y = top; y < bottom; ++y) {
                __builtin_prefetch(value + plane_size + (size_t)y * pitch + left);
                const float8 a = size_of(load_row(value + (size_t)y * pitch + left, columns - left, e->scale));
                most = a > most ? a : most;
                squares += a * a;
            }
            const float4 four = most.lo > most.hi ? most.lo : most.hi;
            const float largest = MOST(MOST(four.x, four.y), MOST(four.z, four.w));
            const int row = top / CELL, column = left / CELL;
            int kept = largest >= 0.55f;
            if (kept && largest < 12.0f && e->multiplier > 0.0f && !e->coarse) {
                const int flag = cell_flag(work, row, column);
                kept = find_gain(e, work, value, plane, top, left, bottom, columns, pitch) >
                       e->multiplier * (flag_bits(work, flag, 1) - flag_bits(work, flag, 0));
            }
            work->flag[(row + 1) * 10 + column + 1] = (uchar)kept;
            if (kept)
                work->cell[cells++] = (uchar)(row * CELL + column);
            else {
                *error += sum_of(squares);
                for (int y = top; e->kept && y < bottom; ++y)
                    clear_row(index + (size_t)y * pitch + left, columns - left);
            }
        }
    return cells;
}

/* Choose the magnitudes of a batch's samples, which hang on none of each other: symbols go where contexts were, behind
 * them, and magnitudes to `chosen`, below 0 where the value is. Returns whether any needs more than a symbol and a sign. */
INLINE int choose_sizes(const encoder_t *e, __global work_t *work, __global const float *value, const int pitch,
                        const int samples, float *error, float *taken)
{
    const int8 lanes = (int8)(0, 1, 2, 3, 4, 5, 6, 7);
    float8 errors = 0.0f, bits = 0.0f;
    int8 rare = 0;
    STORE(ushort8, work->context + samples, 0); /* of samples that fill up the last eight */
    STORE(ushort8, work->place + samples, work->place[0]);
    for (int i = 0; i < samples; i += 8) {
        const int8 place = __builtin_convertvector(LOAD(ushort8, work->place + i), int8);
        const int8 context = __builtin_convertvector(LOAD(ushort8, work->context + i), int8);
        const int8 begin = (context & 0xfff) * SYMBOLS, shift = (context >> 12) + e->coarse;
        const int8 at = (place >> 6) * pitch + (place & 63), valid = lanes < samples - i;
        const float8 v = (float8)(EACH(value, at)) * e->scale, a = size_of(v);
        const float8 most = (float)(MAX_MAGNITUDE >> 1), half_up = a + 0.5f;
        int8 magnitude = __builtin_convertvector(half_up < most ? half_up : most, int8);
        int8 chosen;
        least_losses(work->cost, begin, (float8)(EACH(work->cost, begin)), e->multiplier, a, &chosen);
        magnitude = (magnitude < LAST & shift == 0) ? chosen : magnitude;
        const int8 above = magnitude >> shift, symbol = above < LAST ? above : LAST, where = begin + symbol;
        const float8 off = a - __builtin_convertvector(magnitude, float8);
        errors += valid ? off * off : 0.0f;
        const float8 taken_by = (float8)(EACH(work->cost, where)) + (magnitude > 0 ? 1.0f : 0.0f);
        bits += valid ? taken_by : 0.0f;
        rare |= valid & (shift > 0 | above >= LAST);
        STORE(ushort8, work->context + i, __builtin_convertvector(where, ushort8));
        STORE(ushort8, work->place + i, __builtin_convertvector(place | (context >> 12) << 12, ushort8));
        STORE(int8, work->chosen + i, v < 0.0f ? -magnitude : magnitude);
    }
    *error += sum_of(errors);
    *taken += sum_of(bits);
    return any_of(rare);
}

/* Put the symbols of a batch, and its magnitudes where others look for them. */
INLINE void put_batch(encoder_t *e, __global work_t *work, const int band, __global int *index, const int pitch,
                      const int samples, __global uint *seen)
{
    __global uchar *size = work->size + band * SIZES + PITCH + EDGE;
    __global uint *item = e->item + e->items;
    const uint in_lanes = samples & ~(LANES - 1);
    const int kept = e->kept;
    int due = 0;
    if (e->items + (uint)samples > e->room) {
        e->full = 1;
        return;
    }
    for (uint i = 0; i < (uint)samples; ++i) {
        const uint at = work->context[i], context = at / SYMBOLS, place = work->place[i] & 0xfff, y = place >> 6, x = place & 63;
        const uint begin = work->left[at], width = (work->left[at + 1] - begin) & (ONE - 1);
        const int found = work->chosen[i], magnitude = (found < 0 ? -found : found) >> e->coarse;
        item[i] = begin | width << PRECISION | (i < in_lanes ? i & (LANES - 1) : 0) << 29;
        if (kept)
            index[(size_t)y * pitch + x] = found;
        size[y * PITCH + x] = (uchar)LEAST(magnitude, MAX_SIZE);
        if (seen)
            seen[at]++;
        work->count[at]++;
        if (--work->patience[context] == 0)
            work->due[due++] = (ushort)context;
    }
    e->items += samples;
    learn_due(work, due, 1);
}

/* Put the signs of what is not 0. */
INLINE void put_signs(encoder_t *e, __global const work_t *work, const int samples)
{
    ulong bits = e->bits;
    int held = e->held;
    __global uchar *raw = e->raw + e->raw_size;
    if (e->raw_size + (uint)samples / 8 + 8 > e->raw_room) {
        e->full = 1;
        return;
    }
    for (int i = 0; i < samples; ++i) {
        const int found = work->chosen[i];
        bits |= (ulong)(found < 0) << held;
        held += found != 0;
        if (held >= 32) {
            STORE(uint, raw, (uint)bits);
            raw += 4;
            bits >>= 32;
            held -= 32;
        }
    }
    e->raw_size = raw - e->raw;
    e->bits = bits;
    e->held = held;
    put_bits(e, 0, 0);
}

/* The same where some are larger than symbols tell; returns the bits beside symbols and signs. */
INLINE float put_rare(encoder_t *e, __global const work_t *work, const int samples)
{
    float taken = 0.0f;
    for (int i = 0; i < samples; ++i) {
        const int found = work->chosen[i], magnitude = found < 0 ? -found : found;
        const int above = work->place[i] >> 12, shift = above + e->coarse;
        if (!magnitude && !shift)
            continue;
        if (magnitude >> shift >= LAST)
            taken += put_large(e, (magnitude >> shift) - LAST, ORDER(above));
        if (shift) {
            put_bits(e, (uint)magnitude & ((1u << shift) - 1u), shift);
            taken += shift;
        }
        if (magnitude)
            put_bits(e, found < 0, 1);
    }
    return taken;
}

INLINE void encode_band(encoder_t *e, __global work_t *work, __global const int *unit, __global const float *values,
                        __global int *indices, const int band, const int plane, const int pitch, __global uint *seen,
                        __global float *bits, __global float *errors, const size_t plane_size)
{
    const int rows = unit[ROWS + band], columns = unit[COLUMNS + band];
    if (rows <= 0 || columns <= 0) {
        clear_sizes(work, band, UNIT); /* the next band looks there */
        return;
    }
    __global const int *parent = unit[PARENT + band] < 0 ? 0 : indices + unit[PARENT + band];
    __global const float *value = values + unit[OFFSET + band];
    __global int *index = indices + unit[OFFSET + band];
    make_hints(work, band, plane, rows, columns, parent, unit[PARENT_ROWS + band], unit[PARENT_COLUMNS + band], pitch,
               plane_size, e->coarse);
    clear_sizes(work, band, rows);
    float error = 0.0f;
    const int hinted = band_flag(plane, sum_hints(work, rows, columns));
    const int cells = choose_cells(e, work, value, index, plane, rows, columns, pitch, plane_size, &error), any = cells > 0;
    float taken = flag_bits(work, hinted, any);
    encode_flag(e, work, hinted, any, seen);
    if (any) {
        uchar kept[100];
        for (int i = 0; i < 100; ++i) {
            kept[i] = work->flag[i];
            work->flag[i] = 0;
        }
        for (int row = 0; row * CELL < rows; ++row)
            for (int column = 0; column * CELL < columns; ++column) {
                const int flag = cell_flag(work, row, column), held = kept[(row + 1) * 10 + column + 1];
                taken += flag_bits(work, flag, held);
                encode_flag(e, work, flag, held, seen);
                work->flag[(row + 1) * 10 + column + 1] = (uchar)held;
            }
        for (int batch = 0; batch < 3; ++batch) {
            const int samples = gather_batch(work, band, plane, batch, rows, columns, cells);
            const int rare = choose_sizes(e, work, value, pitch, samples, &error, &taken);
            put_batch(e, work, band, index, pitch, samples, seen);
            if (rare)
                taken += put_rare(e, work, samples);
            else
                put_signs(e, work, samples);
        }
    }
    *errors += error;
    *bits += taken;
    note_before(work, band, plane, rows);
}

INLINE void encode_low(encoder_t *e, __global work_t *work, __global const int *unit, __global const float *values,
                       __global int *indices, const int plane, const int pitch, __global uint *seen, __global float *bits,
                       __global float *errors)
{
    const int rows = unit[ROWS], columns = unit[COLUMNS];
    __global const float *value = values + unit[OFFSET];
    __global int *low = indices + unit[OFFSET];
    float taken = 0.0f, error = 0.0f;
    begin_low_plane(work);
    for (int y = 0; y < rows; ++y) {
        int due = 0;
        for (int x = 0; x < columns; ++x) {
            const int k = low_context(work, plane, y, x), shift = LOW_SHIFT(k), context = LOW_CONTEXT(k);
            const float v = value[(size_t)y * pitch + x] * e->scale;
            const int magnitude = (int)LEAST((v < 0.0f ? -v : v) + 0.5f, (float)(MAX_MAGNITUDE >> 1)), found = v < 0.0f ? -magnitude : magnitude;
            const int residual = found - expect_low(low + (size_t)y * pitch + x, pitch, y, x);
            const int size = residual < 0 ? -residual : residual, symbol = LEAST(size >> shift, LAST);
            low[(size_t)y * pitch + x] = found;
            taken += work->cost[context * SYMBOLS + symbol] + shift + (size != 0);
            encode_symbol(e, work, context, symbol, 0, &due, seen);
            if (symbol == LAST)
                taken += put_large(e, (size >> shift) - LAST, 0);
            if (shift)
                put_bits(e, (uint)size & ((1u << shift) - 1u), shift);
            if (size)
                put_bits(e, residual < 0, 1);
            work->low[(y + 1) * (UNIT + 2) + x + 1] = size;
            error += (v - found) * (v - found);
        }
        learn_due(work, due, 1);
    }
    note_low(work, rows, columns);
    *bits += taken;
    *errors += error;
}

/* Write a stream where room is left: states, words, raw bytes from the last to the first. */
INLINE void finish_stream(encoder_t *e, __global uchar *stream_b, volatile __global uint *taken, const uint room,
                          __global uint *place)
{
    if (e->held)
        put_bits(e, 0, 8 - e->held);
    uint state[LANES] = {RENORMALISED, RENORMALISED, RENORMALISED, RENORMALISED};
    __global ushort *end = (__global ushort *)(e->item + e->items), *word = end;
    for (uint i = e->items; i > 0; --i) {
        const uint item = e->item[i - 1], begin = item & (ONE - 1), size = (item >> PRECISION) & (2 * ONE - 1), lane = item >> 29;
        uint x = state[lane];
        if ((ulong)x >= ((ulong)size << (32 - PRECISION))) {
            *--word = (ushort)x;
            x >>= 16;
        }
        const uint times = x / size;
        state[lane] = (times << PRECISION) + (x - times * size) + begin;
    }
    const uint words = (uint)(end - word), bytes = 4 * LANES + 2 * words + e->raw_size;
    const uint at = atomic_add(taken, bytes);
    place[0] = at;
    place[1] = bytes;
    if (at > room || bytes > room - at)
        return;
    __global uchar *to = stream_b + at;
    for (int lane = 0; lane < LANES; ++lane)
        for (int b = 0; b < 4; ++b)
            *to++ = (uchar)(state[lane] >> 8 * b);
    for (uint i = 0; i < words; ++i) {
        *to++ = (uchar)word[i];
        *to++ = (uchar)(word[i] >> 8);
    }
    for (uint i = e->raw_size; i > 0; --i)
        *to++ = e->raw[i - 1];
}

/* Put planes less their offsets where a window's transform takes them. Global size (rows of the part, planes). */
__kernel void place_planes(__global float *value_jyx, __global const float *part_jp, __global const float *offset_j,
                           const int first, const int size_p, const int size_y, const int size_x, const int columns)
{
    const int y = get_global_id(0), j = get_global_id(1);
    const float offset = offset_j[j];
    __global const float *from = part_jp + (size_t)j * size_p + (size_t)y * size_x;
    __global float *to = value_jyx + ((size_t)j * size_y + first + y) * size_x;
    for (int x = 0; x < columns; ++x)
        to[x] = from[x] - offset;
}

/* Streams of units; global size: workers, of which each takes the next stream of `order_t` from begin to end, until
 * `next_a[batch]` has counted all. Indices may take the place of values: of a band, all values that are needed are read
 * before. Those of level 1, at which no other unit looks, are written if `finest`. */
__kernel void encode_units(__global int *index_jyx, __global const float *value_jyx, __global uchar *stream_b,
                           __global uint *taken_o, __global uint *place_t2, __global float *error_tj,
                           __global float *bits_tj, __global const int *part_t4, __global const int *unit_uf,
                           __global const ushort *count_ms, __global const ushort *flag_q2, __global uchar *work_wd,
                           __global uint *item_wi, __global uchar *raw_wr, __global uint *seen_wn,
                           __global const float *scale_j, __global const int *coarse_jl, __global const int *order_t, volatile __global uint *next_a,
                           const float multiplier, const int finest, const int batch, const int begin, const int end, const ulong size_b, const int size_i, const int size_r,
                           const int size_n, const int size_j, const int size_y, const int size_x)
{
    const int worker = get_global_id(0);
    __global work_t *work = (__global work_t *)(work_wd + worker * (size_t)WORK_BYTES);
    __global uint *seen = size_n > 1 ? seen_wn + (size_t)worker * size_n : 0;
    const size_t plane_size = (size_t)size_y * size_x;
    for (int n; (n = begin + (int)atomic_inc(next_a + batch)) < end;) {
        const int t = order_t[n];
        encoder_t e = {item_wi + (size_t)worker * size_i, 0, size_i, raw_wr + (size_t)worker * size_r, 0, size_r, 0, 0, multiplier,
                       0.0f, 0, 0, 1};
        begin_tables(work, count_ms, flag_q2, 1);
        for (int u = part_t4[4 * t]; u < part_t4[4 * t + 1]; ++u) {
            __global const int *unit = unit_uf + u * UNIT_FIELDS;
            e.kept = finest || unit[LEVEL] != 1;
            if (unit[LEVEL] == 0)
                begin_low(work);
            for (int j = part_t4[4 * t + 2], first = j; j < part_t4[4 * t + 3]; ++j) {
                e.scale = scale_j[j];
                e.coarse = coarse_jl[j * COARSE + unit[LEVEL]];
                __global int *index = index_jyx + j * plane_size;
                __global const float *value = value_jyx + j * plane_size;
                __global float *bits = bits_tj + (size_t)t * size_j + j, *errors = error_tj + (size_t)t * size_j + j;
                if (unit[LEVEL] == 0)
                    encode_low(&e, work, unit, value, index, j - first, size_x, seen, bits, errors);
                else
                    for (int band = 0; band < 3; ++band)
                        encode_band(&e, work, unit, value, index, band, j - first, size_x, seen, bits, errors, plane_size);
            }
        }
        if (e.full)
            place_t2[2 * t + 1] = 0;
        else
            finish_stream(&e, stream_b, taken_o, (uint)size_b, place_t2 + 2 * t);
    }
}
