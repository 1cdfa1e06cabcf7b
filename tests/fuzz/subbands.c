/* decode_subband, as subband_kernel.SubbandDecoder launches it for every subband of a map. An input: a byte that
 * chooses a layout, one for each channel's slope on the one before, then words. */
#include "host.h"
#include "subbands_world.h"

void decode_subband(int *, int *, const int *, const double *, int64_t *, int64_t *, int64_t *, uint64_t *, const uint32_t *,
                    int *, int, int, int, uint64_t, uint64_t);

enum { LOWER, RANGE, POINT, AT, FAULT, STATE };

static int64_t *counts, *fresh;

int LLVMFuzzerInitialize(int *argc, char ***argv)
{
    fresh = room_of(sizeof(int64_t) * START_COUNTS);
    for (int i = 0; i < START_COUNTS; ++i)
        fresh[i] = start_counts[i];
    counts = room_of(sizeof(int64_t) * START_COUNTS);
    return 0;
}

int LLVMFuzzerTestOneInput(const uint8_t *bytes, size_t size)
{
    input_t input = {bytes, size};
    watch();
    const map_t *map = maps + choose(&input, MAPS);
    double *slope = calloc(map->channels, sizeof(double));
    for (int c = 1; c < map->channels; ++c)
        slope[c] = ((int)choose(&input, 256) - 128) / 32.0; /* a launcher keeps them within 4 */
    input.size -= input.size % 4; /* other bodies are refused before */
    const size_t size_v = input.size / 4, values = (size_t)map->channels * map->height * map->width;
    const size_t size_q = SUBBAND_SCRATCH * map->largest_batch + SUBBAND_TABLES;
    uint32_t *words = copy_of(input.bytes, input.size);
    int *index = calloc(values, sizeof(int)), *sizes = calloc(values, sizeof(int)), *scratch = room_of(size_q * sizeof(int));
    int64_t *found = calloc(3 * map->channels, sizeof(int64_t)), *signs = copy_of(start_signs, sizeof start_signs);
    uint64_t state[STATE] = {0, UINT64_MAX, 0, size_v < 2 ? size_v : 2, 0};
    state[POINT] = (uint64_t)(size_v ? words[0] : 0) << 32 | (size_v > 1 ? words[1] : 0);
    memcpy(counts, fresh, sizeof(int64_t) * START_COUNTS);
    if (size_v == 0)
        words = realloc(words, 4), words[0] = 0;
    for (int b = 0; b < map->bands && state[FAULT] == 0; ++b) {
        int *place = copy_of(map->place[b], map->place_size[b] * sizeof(int));
        memset(scratch, bytes[0], size_q * sizeof(int));
        decode_subband(index, sizes, place, slope, found, counts, signs, state, words, scratch, map->channels, map->height,
                       map->width, size_v ? size_v : 1, size_q);
        free(place);
    }
    require(state[FAULT] <= 2 && state[AT] <= (size_v ? size_v : 1), "the state of the coder");
    for (size_t i = 0; i < values; ++i)
        require(sizes[i] >= 0 && sizes[i] <= 1 << 22, "a size");
    free(words), free(index), free(sizes), free(scratch), free(found), free(signs), free(slope);
    return 0;
}
