/* Decoders of codecs whose bodies have a fixed layout, as their Python modules launch them. An input: three bytes that
 * choose sides and maps, then blocks, halves or codes. TARGET, CHANNELS and BITS come from the command line. */
#include "host.h"

extern size_t work_item[3], work_items[3];

enum { BC6H, S3TC, HALF, UNIFORM };

typedef struct {
    int k, h, w, groups, rows, columns;
} shape_t;

/* So many bytes, which begin as an input does. */
static void *filled(const input_t *input, size_t size)
{
    uint8_t *room = room_of(size);
    for (size_t i = 0; i < size; ++i)
        room[i] = i < input->size ? input->bytes[i] : input->size ? (uint8_t)(input->bytes[i % input->size] + i) : 0;
    return room;
}

#if TARGET == 0
void decode_bc6h_khwc(float *, uint8_t *, const uint64_t *, int, int, int);
static void decode(const input_t *input, const shape_t *of)
{
    const size_t blocks = (size_t)of->rows * of->columns;
    float *coeffs = room_of(sizeof(float) * of->k * of->h * of->w * CHANNELS);
    uint8_t *refused = room_of(of->groups * blocks);
    uint64_t *given = filled(input, 16 * of->groups * blocks);
    for (work_item[1] = 0; work_item[1] < (size_t)of->groups; ++work_item[1])
        for (work_item[0] = 0; work_item[0] < (blocks + 63) / 64 * 64; ++work_item[0])
            decode_bc6h_khwc(coeffs, refused, given, of->k, of->h, of->w);
    int sound = 1;
    for (size_t i = 0; i < of->groups * blocks; ++i)
        sound &= !refused[i];
    for (size_t i = 0; sound && i < (size_t)of->k * of->h * of->w * CHANNELS; ++i)
        require(coeffs[i] - coeffs[i] == 0.0f, "no finite number");
    free(coeffs), free(refused), free(given);
}
#elif TARGET == 1
void decode_s3tc_khwc(float *, const uint32_t *, int, int, int);
static void decode(const input_t *input, const shape_t *of)
{
    float *coeffs = room_of(sizeof(float) * of->k * of->h * of->w * CHANNELS);
    uint32_t *given = filled(input, sizeof(uint32_t) * 7 * of->groups * of->rows * of->columns);
    for (work_item[1] = 0; work_item[1] < (size_t)of->groups * of->rows; ++work_item[1])
        decode_s3tc_khwc(coeffs, given, of->k, of->h, of->w);
    free(coeffs), free(given);
}
#elif TARGET == 2
void decode_half_p(float *, uint8_t *, const uint16_t *, uint64_t);
static void decode(const input_t *input, const shape_t *of)
{
    const size_t count = (size_t)of->k * of->h * of->w, stretches = (count + 8 * VECTORS - 1) / (8 * VECTORS);
    float *coeffs = room_of(sizeof(float) * count);
    uint8_t *refused = room_of(stretches);
    uint16_t *given = filled(input, sizeof(uint16_t) * count);
    for (work_item[0] = 0; work_item[0] < stretches; ++work_item[0])
        decode_half_p(coeffs, refused, given, count);
    for (size_t i = 0; i < count; ++i)
        require(refused[i / (8 * VECTORS)] || coeffs[i] - coeffs[i] == 0.0f, "no finite number");
    free(coeffs), free(refused), free(given);
}
#else
void unpack_uniform_p(uint16_t *, const uint8_t *, uint64_t, uint64_t);
void dequantise_uniform_kp(float *, const uint16_t *, const float *, const float *, const float *, uint64_t);
static void decode(const input_t *input, const shape_t *of)
{
    const size_t pixels = (size_t)of->h * of->w, count = of->k * pixels, size = (count * BITS + 7) / 8;
    uint8_t *given = filled(input, size);
    float *tables[3], *coeffs = room_of(sizeof(float) * count);
    uint16_t *codes = room_of(sizeof(uint16_t) * count);
    for (int i = 0; i < 3; ++i)
        tables[i] = filled(input, sizeof(float) * of->k);
    for (work_item[0] = 0; work_item[0] < (count + STRETCH - 1) / STRETCH; ++work_item[0])
        unpack_uniform_p(codes, given, size, count);
    for (size_t i = 0; i < count; ++i)
        require(codes[i] >> BITS == 0, "a code");
    for (work_item[1] = 0; work_item[1] < (size_t)of->k; ++work_item[1])
        for (work_item[0] = 0; work_item[0] < (pixels + STRETCH - 1) / STRETCH; ++work_item[0])
            dequantise_uniform_kp(coeffs, codes, tables[0], tables[1], tables[2], pixels);
    for (int i = 0; i < 3; ++i)
        free(tables[i]);
    free(given), free(codes), free(coeffs);
}
#endif

int LLVMFuzzerTestOneInput(const uint8_t *bytes, size_t size)
{
    input_t input = {bytes, size};
    watch();
    shape_t of = {0};
    of.k = 1 + (int)choose(&input, 7);
    of.h = 1 + (int)choose(&input, 40);
    of.w = 1 + (int)choose(&input, 80);
    of.groups = CHANNELS == 3 ? of.k : (of.k + 2) / 3;
    of.rows = (of.h + 3) / 4;
    of.columns = (of.w + 3) / 4;
    work_item[0] = work_item[1] = 0;
    decode(&input, &of);
    return 0;
}
