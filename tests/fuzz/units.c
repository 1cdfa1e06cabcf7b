/* decode_units of klt 4, as unit_streams.decode_streams launches it; streams are those of an input, whose checksums nobody
 * looks at. An input: 8 bytes that choose, see below, then the bytes of streams.
 *
 * Found by ASan: what passes an array, or a member of work_t, between which gaps are poisoned. Found here: a fault that is
 * neither 0 nor 1, an index or a sum that no decoder may write, and what hangs on memory that nobody wrote. */
#include "host.h"
#include "units_world.h"

extern size_t work_item[3];
void decode_units(int *, float *, const float *, const uint8_t *, const uint32_t *, const int *, const int *,
                  const uint16_t *, const uint16_t *, uint8_t *, int *, int, int, int, int, int, int);
void value_indices(int *, int, int, int);
void set_gaps(void *work, int poisoned);

enum { MOST_STREAMS = 3, MOST_SUMS = 3, LARGEST = 1 << 29 };

typedef struct {
    int planes, sums, first, streams, fill, parents;
    uint32_t place[2 * MOST_STREAMS];
} choice_t;

typedef struct {
    int *index, *fault;
    float *sum;
    size_t values, summed;
} result_t;

static uint8_t *works[MOST_STREAMS];

/* Indices that units decoded before may have left. */
static void leave_parents(int *index, size_t count, int kind)
{
    uint32_t state = 2463534242u + (uint32_t)kind;
    for (size_t i = 0; i < count; ++i) {
        state ^= state << 13;
        state ^= state >> 17;
        state ^= state << 5;
        const int size = (int)(state >> 3 & ((1u << (kind % 30)) - 1u));
        index[i] = state & 1 ? size : -size;
    }
}

static result_t decode(const layout_t *layout, const choice_t *choice, const uint8_t *bytes, size_t size, int fill)
{
    result_t result;
    const size_t plane = (size_t)layout->rows * layout->pitch;
    const int columns = choice->sums ? choice->sums : 1;
    result.values = plane * choice->planes;
    result.summed = plane * columns;
    result.index = calloc(result.values, sizeof(int));
    result.sum = calloc(result.summed, sizeof(float));
    result.fault = calloc(layout->streams, sizeof(int));
    require(result.index && result.sum && result.fault, "no memory");
    if (choice->parents)
        leave_parents(result.index, result.values, choice->parents);
    float *weight = room_of(sizeof(float) * columns * choice->planes);
    for (int i = 0; i < columns * choice->planes; ++i)
        weight[i] = choice->sums ? 0.5f * (float)(i % 5 - 2) : 0.0f;
    uint8_t *stream = copy_of(bytes, size);
    uint32_t *place = calloc(2 * layout->streams, sizeof(uint32_t));
    memcpy(place + 2 * choice->first, choice->place, 2 * choice->streams * sizeof(uint32_t));
    int *first = copy_of(layout->first, 2 * layout->streams * sizeof(int));
    int *unit = copy_of(layout->unit, UNIT_FIELDS * layout->units * sizeof(int));
    for (int t = 0; t < choice->streams; ++t) {
        set_gaps(works[t], 0);
        memset(works[t], fill, WORK_SIZE);
        set_gaps(works[t], 1);
    }
    uint16_t *count = copy_of(start_counts, sizeof start_counts), *flag = copy_of(start_flags, sizeof start_flags);
    for (int t = 0; t < choice->streams; ++t)
        decode_units(result.index, result.sum, weight, stream, place, first, unit, count, flag, works[t], result.fault,
                     choice->first + t, choice->planes, choice->sums, columns, layout->rows, layout->pitch);
    free(weight), free(stream), free(place), free(first), free(unit), free(count), free(flag);
    return result;
}

static void drop(result_t *result) { free(result->index), free(result->sum), free(result->fault); }

/* Plain loops, which compilers vectorise. */
__attribute__((no_sanitize("address", "undefined"))) static int are_small(const int *values, size_t count)
{
    int large = 0;
    for (size_t i = 0; i < count; ++i)
        large |= (values[i] > LARGEST) | (values[i] < -LARGEST);
    return !large;
}

__attribute__((no_sanitize("address", "undefined"))) static int are_finite(const float *values, size_t count)
{
    int others = 0;
    for (size_t i = 0; i < count; ++i)
        others |= values[i] - values[i] != 0.0f;
    return !others;
}

static void check(const result_t *result, const layout_t *layout, const choice_t *choice)
{
    for (int t = 0; t < layout->streams; ++t)
        require(result->fault[t] == 0 || (result->fault[t] == 1 && t >= choice->first && t < choice->first + choice->streams),
                "a fault of a stream");
    require(are_small(result->index, result->values), "an index");
    require(are_finite(result->sum, result->summed), "a sum");
}

int LLVMFuzzerInitialize(int *argc, char ***argv)
{
    for (int t = 0; t < MOST_STREAMS; ++t)
        works[t] = room_of(WORK_SIZE);
    return 0;
}

int LLVMFuzzerTestOneInput(const uint8_t *bytes, size_t size)
{
    input_t input = {bytes, size};
    watch();
    const layout_t *layout = layouts + choose(&input, LAYOUTS);
    choice_t choice = {0};
    choice.planes = 1 + (int)choose(&input, layout->most_planes);
    choice.sums = (int)choose(&input, MOST_SUMS + 1);
    const int fill = (int)choose(&input, 256);
    choice.parents = (int)choose(&input, 256);
    if (layout->streams == 1 || choice.parents < 128)
        choice.parents = 0; /* as before the first unit */
    choice.first = (int)(choose(&input, 256) * 37u % (unsigned)layout->streams);
    choice.streams = 1 + (int)choose(&input, MOST_STREAMS);
    if (choice.streams > layout->streams - choice.first)
        choice.streams = layout->streams - choice.first;
    const int again = choose(&input, 8) == 0;
    const uint32_t share = (uint32_t)(input.size / choice.streams);
    for (int t = 0; t < choice.streams; ++t) {
        choice.place[2 * t] = t * share;
        choice.place[2 * t + 1] = t + 1 < choice.streams ? share : (uint32_t)input.size - t * share;
    }
    result_t result = decode(layout, &choice, input.bytes, input.size, fill);
    check(&result, layout, &choice);
    if (again) {
        result_t other = decode(layout, &choice, input.bytes, input.size, ~fill & 255);
        require(memcmp(result.index, other.index, result.values * sizeof(int)) == 0 &&
                    memcmp(result.sum, other.sum, result.summed * sizeof(float)) == 0 &&
                    memcmp(result.fault, other.fault, layout->streams * sizeof(int)) == 0,
                "what was decoded hangs on memory that nobody wrote");
        drop(&other);
        for (work_item[1] = 0; result.values < 4096 && work_item[1] < (size_t)layout->rows; ++work_item[1])
            for (work_item[0] = 0; work_item[0] < (size_t)layout->pitch; ++work_item[0])
                value_indices(result.index, choice.planes, layout->rows, layout->pitch);
        work_item[0] = work_item[1] = 0;
    }
    drop(&result);
    return 0;
}
