/* What harnesses share: bytes of an input, memory that is exactly as large as a launcher's, and failures. */
#include <signal.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/time.h>
#include <unistd.h>

typedef struct {
    const uint8_t *bytes;
    size_t size;
} input_t;

/* The next byte of an input, of so many choices; 0 behind its end. */
static inline unsigned choose(input_t *input, unsigned choices)
{
    if (input->size == 0)
        return 0;
    input->size--;
    return *input->bytes++ % choices;
}

static inline void require(int holds, const char *what)
{
    if (holds)
        return;
    fprintf(stderr, "harness: %s\n", what);
    abort();
}

static inline void *room_of(size_t size)
{
    void *room = malloc(size ? size : 1);
    require(room != NULL, "no memory");
    return room;
}

static inline void *copy_of(const void *from, size_t size)
{
    void *room = room_of(size);
    memcpy(room, from, size);
    return room;
}

static void end_hang(int signal_number)
{
    static const char what[] = "harness: an input takes more than 2 seconds\n";
    (void)!write(2, what, sizeof what - 1);
    abort();
}

/* Before every input: end it after 2 s of this process's own time, whatever else the machine does. */
static inline void watch(void)
{
    static int watches;
    if (!watches)
        signal(SIGVTALRM, end_hang);
    watches = 1;
    const struct itimerval most = {{0, 0}, {2, 0}};
    setitimer(ITIMER_VIRTUAL, &most, NULL);
}
