/* The forward 9/7 wavelet of planes of which rows come a few at a time: what wavelet.cl makes of the whole image, to the
 * last bit, with no row looked at twice.
 *
 * A level's steps along y (see lifting.clh) need six rows, which stay in memory between calls: the even row 2 n in place
 * n mod 3, the odd row 2 n + 1 in place 3 + n mod 3. Step n runs when row 2 n + 2 has come, and low and high row n - 1
 * come out of it, lifted along x; low ones go to the next level, all others to their places in a window of the image that
 * begins at row `top`, a multiple of 2^levels. After the image's last row the steps that are left run as well.
 *
 *   value_pvx   (p, v, x) float  planes of a window, subbands in place as wavelet.cl leaves them
 *   fresh_prx   (p, r, x) float  the rows that come, of which the first `count` do
 *   state_ps    (p, s) float     levels, coarsest last: 6 rows of the level's columns, padded to 8, + SLACK each
 *   scratch_ab  (a, b) float     a work-items: 4 rows of x + SLACK, then 2 times (r/2 + 3) rows of half of x + SLACK
 */
#include "common/inline.clh"
#include "codec/wavelet_rows.clh"

#define AT_LEVEL(size, level) (((size) + (1 << (level)) - 1) >> (level))
#define PITCH_OF(width) (((width) + 7) / 8 * 8 + SLACK)
/* Low rows that come out of so many, as long as they are not all. */
#define OUT_OF(rows) ((rows) < 3 ? 0 : ((rows) - 3) / 2)

/* A level of a plane. */
typedef struct {
    __global float *rows;          /* that stay */
    __global float *low_to;        /* where low rows of low columns go, the first of them first */
    __global float *high_x, *high_y, *high_xy; /* HL, LH and HH of the window */
    __global float *even, *odd, *row, *halves; /* to work in */
    int height, width;             /* of the image at this level, before it is split */
    int low_pitch, pitch;
    int top;                       /* first row of the window's subbands */
    int count;                     /* low rows that came out */
} level_t;

#define EVEN_ROW(n) (g->rows + (size_t)((n) % 3) * PITCH_OF(g->width))
#define ODD_ROW(n) (g->rows + (size_t)(3 + (n) % 3) * PITCH_OF(g->width))

/* Low row n, or one that has no high one beside it. */
INLINE void put_low(level_t *g, __global const float *row, const int n)
{
    const int n_low = g->width - g->width / 2;
    analyse_row(g->halves, row, g->width, g->even, g->odd);
    copy(g->low_to + (size_t)g->count * g->low_pitch, g->halves, 1.0f, n_low);
    copy(g->high_x + (size_t)(n - g->top) * g->pitch, g->halves + n_low, 1.0f, g->width / 2);
    g->count++;
}

/* Step n of wavelet.cl's analyse_level: its even rows are s, its odd ones d. */
INLINE void step_along_y(level_t *g, const int n)
{
    const int width = g->width, n_high = g->height / 2, n_low = g->height - n_high, inside = n < n_high;
    __global float *s = EVEN_ROW(n), *d = ODD_ROW(n);
    __global float *s_before = EVEN_ROW(n + 2), *d_before = ODD_ROW(n + 2), *d_first = ODD_ROW(n + 1);
    if (inside)
        add(d, ALPHA, s, 2 * n + 2 >= g->height ? s : EVEN_ROW(n + 1), width);
    if (n < n_low)
        add(s, BETA, n > 0 ? d_before : d, inside ? d : d_before, width);
    if (n == 0)
        return;
    if (n <= n_high)
        add(d_before, GAMMA, s_before, n < n_low ? s : s_before, width);
    lift_last(g->row, s_before, LOW_GAIN, DELTA, n > 1 ? d_first : d_before, n <= n_high ? d_before : d_first, width);
    put_low(g, g->row, n - 1);
    if (n > n_high)
        return;
    const int n_left = width - width / 2;
    const size_t at = (size_t)(n - 1 - g->top) * g->pitch;
    copy(g->row, d_before, HIGH_GAIN, width);
    analyse_row(g->halves, g->row, width, g->even, g->odd);
    copy(g->high_y + at, g->halves, 1.0f, n_left);
    copy(g->high_xy + at, g->halves + n_left, 1.0f, width / 2);
}

/* Row y of the image at this level. */
INLINE void take_row(level_t *g, __global const float *from, const int y)
{
    const int n = y / 2, last = y + 1 == g->height;
    copy(y % 2 ? ODD_ROW(n) : EVEN_ROW(n), from, 1.0f, g->width);
    if (g->height == 1) {
        put_low(g, EVEN_ROW(0), 0);
        return;
    }
    if (y % 2 == 0 && n > 0)
        step_along_y(g, n - 1);
    if (last) {
        step_along_y(g, n);
        step_along_y(g, n + 1);
    }
}

/* Rows `fed` and those after it, of an image of size_h rows and size_w columns, into a window of `window` rows. Global
 * size (a): work-item a takes planes a, a + size_a and so on. */
__kernel void analyse_rows(__global float *restrict value_pvx, __global const float *restrict fresh_prx,
                           __global float *restrict state_ps, __global float *restrict scratch_ab, const int levels,
                           const int size_h, const int size_w, const int top, const int window, const int fed,
                           const int count, const int size_a, const int size_b, const int size_p, const int size_v,
                           const int size_r, const int size_s, const int size_x)
{
    __global float *work = scratch_ab + (size_t)get_global_id(0) * size_b + 8;
    const int pitch = size_x + SLACK, narrow = size_x / 2 + SLACK;
    __global float *waiting[2] = {work + 4 * pitch, work + 4 * pitch + (size_t)(size_r / 2 + 3) * narrow};
    for (int p = get_global_id(0); p < size_p; p += size_a) {
        __global float *value = value_pvx + (size_t)p * size_v * size_x, *rows = state_ps + (size_t)p * size_s;
        __global const float *from = fresh_prx + (size_t)p * size_r * size_x;
        int first = fed, came = count, from_pitch = size_x;
        for (int level = 1; level <= levels && came; level++) {
            const int low_h = AT_LEVEL(window, level), low_w = AT_LEVEL(size_w, level), above = top >> level;
            const int known = OUT_OF(first); /* low rows that came before */
            __global float *high_y = value + (size_t)low_h * size_x;
            __global float *low_to = level < levels ? waiting[level % 2] : value + (size_t)(known - above) * size_x;
            level_t g = {rows, low_to, value + low_w, high_y, high_y + low_w,
                         work, work + pitch, work + 2 * pitch, work + 3 * pitch,
                         AT_LEVEL(size_h, level - 1), AT_LEVEL(size_w, level - 1),
                         level < levels ? narrow : size_x, size_x, above, 0};
            for (int r = 0; r < came; r++)
                take_row(&g, from + (size_t)r * from_pitch, first + r);
            rows += 6 * (size_t)PITCH_OF(g.width);
            from = g.low_to;
            from_pitch = g.low_pitch;
            first = known;
            came = g.count;
        }
    }
}

/* Move what is there of the rows of the next window to their places: from `shift` rows of the image on, up to what came
 * out of `fed` rows. No later window has more rows. Coarse subbands go first, and HL before HH: what they are moved to
 * has been moved or coded. Global size (p). */
__kernel void move_rows(__global float *restrict value_pvx, const int levels, const int size_h, const int size_w,
                        const int top, const int window, const int next_window, const int shift, const int fed,
                        const int size_p, const int size_v, const int size_x)
{
    __global float *value = value_pvx + (size_t)get_global_id(0) * size_v * size_x;
    for (int level = levels; level > 0; level--) {
        int came = fed, before = fed;
        for (int above = 0; above < level; above++) {
            before = came;
            came = before == AT_LEVEL(size_h, above) ? AT_LEVEL(size_h, above + 1) : OUT_OF(before);
        }
        const int high = before == AT_LEVEL(size_h, level - 1) ? before - came : came; /* rows of LH and HH */
        const int begin = shift >> level, above = top >> level, low_w = AT_LEVEL(size_w, level);
        const int n_right = AT_LEVEL(size_w, level - 1) - low_w;
        const size_t was = (size_t)AT_LEVEL(window, level) * size_x, is = (size_t)AT_LEVEL(next_window, level) * size_x;
        for (int band = level == levels ? 0 : 1; band < 4; band++) {
            const int lower = band & 2, columns = band & 1 ? n_right : low_w;
            __global float *from = value + (band & 1 ? low_w : 0) + (lower ? was : 0);
            __global float *to = value + (band & 1 ? low_w : 0) + (lower ? is : 0);
            for (int y = begin; y < (lower ? high : came) - above; y++)
                copy(to + (size_t)(y - begin) * size_x, from + (size_t)y * size_x, 1.0f, columns);
        }
    }
}
