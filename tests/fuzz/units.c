/* decode_units of klt 4 and wavelet 6, as unit_streams.decode_streams launches it; streams are those of an input, whose checksums nobody
 * looks at. An input: 10 bytes that choose, see below, then the bytes of streams.
 *
 * Found by ASan: what passes an array, or a member of work_t, between which gaps are poisoned. Found here: a fault that is
 * neither 0 nor 1, an index or a sum that no decoder may write, and what hangs on memory that nobody wrote. */
#include "host.h"
#include "units_world.h"

void decode_units(float *, uint8_t *, const float *, const uint8_t *, const uint32_t *, const int *, const int *, const int *,
                  const uint16_t *, const uint16_t *, const int *, uint8_t *, int *, int, int, int, int, int, int, int);
void set_gaps(void *work, int poisoned);

enum { MOST_STREAMS = 3, MOST_SUMS = 3, LEVELS = 5, MOST_COARSE = 12, LARGEST = 1 << 29 };

typedef struct {
    int planes, sums, first, streams, parents, coarse, groups;
    uint32_t place[2 * MOST_STREAMS];
} choice_t;

typedef struct {
    float *value;
    int *fault;
    size_t values;
} result_t;

static uint8_t *work;

/* Sizes that units decoded before may have left. */
static void leave_parents(uint8_t *size, size_t count, int kind)
{
    uint32_t state = 2463534242u + (uint32_t)kind;
    for (size_t i = 0; i < count; ++i) {
        state ^= state << 13;
        state ^= state >> 17;
        state ^= state << 5;
        size[i] = (uint8_t)(state >> 3 & ((1u << (kind % 9)) - 1u));
    }
}

/* Units and planes of streams; each is of all planes, or of some. */
static int *parts_of(const layout_t *layout, const choice_t *choice)
{
    int *part = room_of(4 * layout->streams * sizeof(int));
    for (int t = 0; t < layout->streams; ++t) {
        const int group = t % choice->groups;
        part[4 * t] = layout->first[2 * t];
        part[4 * t + 1] = layout->first[2 * t + 1];
        part[4 * t + 2] = group * choice->planes / choice->groups;
        part[4 * t + 3] = (group + 1) * choice->planes / choice->groups;
    }
    return part;
}

static result_t decode(const layout_t *layout, const choice_t *choice, const uint8_t *bytes, size_t size, int fill)
{
    result_t result;
    const int columns = choice->sums ? choice->sums : 1;
    const size_t known_size = (size_t)choice->planes * layout->known_rows * layout->known_pitch;
    result.values = (size_t)layout->rows * layout->pitch * (choice->sums ? choice->sums : choice->planes);
    result.value = calloc(result.values, sizeof(float));
    result.fault = calloc(layout->streams, sizeof(int));
    uint8_t *known = calloc(known_size, 1);
    require(result.value && result.fault && known, "no memory");
    if (choice->parents)
        leave_parents(known, known_size, choice->parents);
    float *weight = room_of(sizeof(float) * columns * choice->planes);
    for (int i = 0; i < columns * choice->planes; ++i)
        weight[i] = choice->sums ? 0.5f * (float)(i % 5 - 2) : 0.0f;
    uint8_t *stream = copy_of(bytes, size);
    uint32_t *place = calloc(2 * layout->streams, sizeof(uint32_t));
    memcpy(place + 2 * choice->first, choice->place, 2 * choice->streams * sizeof(uint32_t));
    int *part = parts_of(layout, choice), *unit = copy_of(layout->unit, UNIT_FIELDS * layout->units * sizeof(int));
    int *placed = copy_of(layout->placed, 18 * layout->units * sizeof(int));
    int *coarse = calloc(choice->planes * (LEVELS + 1), sizeof(int));
    for (int i = 0; i < choice->planes * (LEVELS + 1); ++i)
        coarse[i] = i % (LEVELS + 1) ? choice->coarse * (1 + i) % (MOST_COARSE + 1) : 0;
    set_gaps(work, 0);
    memset(work, fill, WORK_SIZE);
    set_gaps(work, 1);
    uint16_t *count = copy_of(start_counts, sizeof start_counts), *flag = copy_of(start_flags, sizeof start_flags);
    decode_units(result.value, known, weight, stream, place, part, unit, placed, count, flag, coarse, work, result.fault,
                 choice->first, choice->first + choice->streams, choice->sums, layout->rows, layout->pitch,
                 layout->known_rows, layout->known_pitch);
    free(known), free(weight), free(stream), free(place), free(part), free(unit), free(placed), free(coarse);
    free(count), free(flag);
    return result;
}

static void drop(result_t *result) { free(result->value), free(result->fault); }

/* A plain loop, which compilers vectorise. */
__attribute__((no_sanitize("address", "undefined"))) static int are_within(const float *values, size_t count, float most)
{
    int others = 0;
    for (size_t i = 0; i < count; ++i)
        others |= !(values[i] <= most && values[i] >= -most);
    return !others;
}

static void check(const result_t *result, const layout_t *layout, const choice_t *choice)
{
    for (int t = 0; t < layout->streams; ++t)
        require(result->fault[t] == 0 || (result->fault[t] == 1 && t >= choice->first && t < choice->first + choice->streams),
                "a fault of a stream");
    /* Streams of a place may add to the same sums. */
    const float most = choice->sums ? (float)LARGEST * (float)(choice->planes * choice->streams) : (float)LARGEST;
    require(are_within(result->value, result->values, most), choice->sums ? "a sum" : "an index");
}

int LLVMFuzzerInitialize(int *argc, char ***argv)
{
    work = room_of(WORK_SIZE);
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
    choice.coarse = (int)choose(&input, 64);
    choice.groups = 1 + (int)choose(&input, (unsigned)choice.planes);
    const uint32_t share = (uint32_t)(input.size / choice.streams);
    for (int t = 0; t < choice.streams; ++t) {
        choice.place[2 * t] = t * share;
        choice.place[2 * t + 1] = t + 1 < choice.streams ? share : (uint32_t)input.size - t * share;
    }
    result_t result = decode(layout, &choice, input.bytes, input.size, fill);
    check(&result, layout, &choice);
    if (again) {
        result_t other = decode(layout, &choice, input.bytes, input.size, ~fill & 255);
        require(memcmp(result.value, other.value, result.values * sizeof(float)) == 0 &&
                    memcmp(result.fault, other.fault, layout->streams * sizeof(int)) == 0,
                "what was decoded hangs on memory that nobody wrote");
        drop(&other);
    }
    drop(&result);
    return 0;
}
