/* Orthonormal cosine transforms, type II, of rows of 2 * 64 * 64 numbers, as many rows side by side as the processor's
   registers hold: a complex Fourier transform of half the length (Makhoul 1980), by 64 * 64 and these by 8 * 8. */
#include <math.h>
#if defined(__AVX512F__)
#define LANES 8
#elif defined(__AVX__)
#define LANES 4
#else
#define LANES 2
#endif
#define SIDE 64
#define HALF (SIDE * SIDE)
#define SIZE (2 * HALF)
#define AT(j) ((j) / SIDE * APART + (j) % SIDE)
#define APART (SIDE + 1) /* from one row of a square to the next: powers of two would share few places in the caches */
typedef double real __attribute__((vector_size(8 * LANES)));
typedef double loose __attribute__((vector_size(8 * LANES), aligned(8), may_alias));
typedef struct { real re, im; } pair;
typedef struct { double re, im; } number;

static inline pair plus(pair a, pair b) { return (pair){a.re + b.re, a.im + b.im}; }
static inline pair minus(pair a, pair b) { return (pair){a.re - b.re, a.im - b.im}; }
static inline pair times(pair a, number w) { return (pair){a.re * w.re - a.im * w.im, a.re * w.im + a.im * w.re}; }
static inline pair back(pair a) { return (pair){a.im, -a.re}; } /* times -i */

static inline void four(pair *y, pair a, pair b, pair c, pair d)
{
    const pair s = plus(a, c), t = minus(a, c), u = plus(b, d), v = back(minus(b, d));
    y[0] = plus(s, u), y[2] = minus(s, u), y[1] = plus(t, v), y[3] = minus(t, v);
}

/* The Fourier transform of eight numbers at x[0], x[step], ... */
static inline void eight(const pair *x, long step, pair *y)
{
    const double r = 0.70710678118654752440;
    pair even[4], odd[4];
    const pair a = minus(x[0], x[4 * step]), b = minus(x[step], x[5 * step]);
    const pair c = minus(x[2 * step], x[6 * step]), d = minus(x[3 * step], x[7 * step]);
    four(even, plus(x[0], x[4 * step]), plus(x[step], x[5 * step]), plus(x[2 * step], x[6 * step]),
         plus(x[3 * step], x[7 * step]));
    four(odd, a, (pair){r * (b.re + b.im), r * (b.im - b.re)}, back(c), (pair){r * (d.im - d.re), -r * (d.re + d.im)});
    for (int k = 0; k < 4; k++) y[2 * k] = even[k], y[2 * k + 1] = odd[k];
}

/* The same of 64 numbers at x[0], x[step], ... in place, times turn[k] where there are any. w: the 64th roots of 1. */
static void sixty_four(pair *x, long step, const number *w, const number *turn)
{
    pair part[SIDE], y[8];
    for (int p = 0; p < 8; p++) {
        eight(x + p * step, 8 * step, y);
        part[p] = y[0];
        for (int q = 1; q < 8; q++) part[8 * q + p] = times(y[q], w[p * q]);
    }
    for (int q = 0; q < 8; q++) {
        eight(part + 8 * q, 1, y);
        for (int r = 0; r < 8; r++) x[(q + 8 * r) * step] = turn ? times(y[r], turn[q + 8 * r]) : y[r];
    }
}

/* Numbers that all transforms share: 64th roots of 1, those of the first step by place, then those that take the
   transform of half the length to the cosine transform. */
#ifdef _WIN32
__declspec(dllexport)
#endif
long cosine_table(double *made)
{
    const double pi = 3.14159265358979323846;
    number *w = (number *)made, *turn = w + SIDE, *apart = turn + HALF, *twist = apart + HALF / 2 + 1;
    if (made) {
        for (long k = 0; k < SIDE; k++) w[k] = (number){cos(2 * pi * k / SIDE), -sin(2 * pi * k / SIDE)};
        for (long b = 0; b < SIDE; b++)
            for (long c = 0; c < SIDE; c++)
                turn[SIDE * b + c] = (number){cos(2 * pi * b * c / HALF), -sin(2 * pi * b * c / HALF)};
        for (long k = 0; k <= HALF / 2; k++) apart[k] = (number){cos(2 * pi * k / SIZE), -sin(2 * pi * k / SIZE)};
        for (long k = 0; k <= HALF; k++) {
            const double size = sqrt((k ? 2.0 : 1.0) / SIZE);
            twist[k] = (number){size * cos(pi * k / (2 * SIZE)), -size * sin(pi * k / (2 * SIZE))};
        }
    }
    return 2 * (SIDE + HALF + HALF / 2 + 1 + HALF + 1);
}

#ifdef __has_builtin
#if __has_builtin(__builtin_shufflevector)
#define SWAPPED(a, b, first, second) { const real low = first(a, b); b = second(a, b), a = low; }
#define PICK(a, b, ...) __builtin_shufflevector(a, b, __VA_ARGS__)
#endif
#endif
#if LANES == 8
#define EVEN(a, b) PICK(a, b, 0, 8, 2, 10, 4, 12, 6, 14)
#define ODD(a, b) PICK(a, b, 1, 9, 3, 11, 5, 13, 7, 15)
#define PAIRS(a, b) PICK(a, b, 0, 1, 8, 9, 4, 5, 12, 13)
#define OTHERS(a, b) PICK(a, b, 2, 3, 10, 11, 6, 7, 14, 15)
#define FIRST(a, b) PICK(a, b, 0, 1, 2, 3, 8, 9, 10, 11)
#define SECOND(a, b) PICK(a, b, 4, 5, 6, 7, 12, 13, 14, 15)
#elif LANES == 4
#define EVEN(a, b) PICK(a, b, 0, 4, 2, 6)
#define ODD(a, b) PICK(a, b, 1, 5, 3, 7)
#define PAIRS(a, b) PICK(a, b, 0, 1, 4, 5)
#define OTHERS(a, b) PICK(a, b, 2, 3, 6, 7)
#else
#define EVEN(a, b) PICK(a, b, 0, 2)
#define ODD(a, b) PICK(a, b, 1, 3)
#endif

/* Rows of a square as its columns, in place. */
static inline void turned(real *a)
{
#ifdef SWAPPED
    for (int i = 0; i < LANES; i += 2) SWAPPED(a[i], a[i + 1], EVEN, ODD)
#if LANES > 2
    for (int i = 0; i < LANES; i++) if (!(i & 2)) SWAPPED(a[i], a[i + 2], PAIRS, OTHERS)
#endif
#if LANES > 4
    for (int i = 0; i < 4; i++) SWAPPED(a[i], a[i + 4], FIRST, SECOND)
#endif
#else
    for (int i = 0; i < LANES; i++)
        for (int j = 0; j < i; j++) {
            const double x = a[i][j];
            a[i][j] = a[j][i], a[j][i] = x;
        }
#endif
}

static inline void put(double *const *row, long k, real value)
{
    for (int l = 0; l < LANES; l++) row[l][k] = value[l];
}

/* Coefficients k and, negative, SIZE - k; and the same of HALF - k. Place c + 64 d of the Fourier transform is at
   64 c + d. */
static inline void coefficients(const pair *z, long k, const number *apart, const number *twist, pair *own, pair *other)
{
    const long m = (HALF - k) % HALF;
    const pair a = z[APART * (k % SIDE) + k / SIDE], b = z[APART * (m % SIDE) + m / SIDE];
    const pair even = {0.5 * (a.re + b.re), 0.5 * (a.im - b.im)};
    const pair odd = times((pair){0.5 * (a.im + b.im), 0.5 * (b.re - a.re)}, apart[k]);
    const pair rest = minus(even, odd);
    *own = times(plus(even, odd), twist[k]), *other = times((pair){rest.re, -rest.im}, twist[HALF - k]);
}

/* `rows` rows of SIZE numbers, `step` from one to the next, in place; those that are not `taken` count as 0, where it is
   stated. `work`, on a multiple of 64 bytes, has room for a square of pairs, and for a row that lanes share for which
   none is left. */
#ifdef _WIN32
__declspec(dllexport)
#endif
void cosine(long rows, double *first, long step, const char *taken, const double *table, double *work)
{
    enum { TOGETHER = LANES > 4 ? LANES : 4 };
    const number *w = (const number *)table, *turn = w + SIDE, *apart = turn + HALF, *twist = apart + HALF / 2 + 1;
    pair *z = (pair *)work, own, other;
    for (long at = 0; at < rows; at += LANES) {
        double *row[LANES];
        for (long l = 0; l < LANES; l++) row[l] = at + l < rows ? first + (at + l) * step : work + 2 * APART * SIDE * LANES;
        for (long i = 0; i < SIZE; i += TOGETHER) {
            real x[TOGETHER];
            for (int c = 0; c < TOGETHER; c += LANES) {
                for (int l = 0; l < LANES; l++) x[c + l] = *(const loose *)(row[l] + i + c);
                turned(x + c);
            }
            for (int c = 0; c < TOGETHER; c++) if (taken && !taken[i + c]) x[c] = (real){0};
            for (int c = 0; c < TOGETHER; c += 4) {
                const long j = (i + c) / 4, k = HALF - 1 - j;
                z[AT(j)] = (pair){x[c], x[c + 2]}, z[AT(k)] = (pair){x[c + 3], x[c + 1]};
            }
        }
        for (long b = 0; b < SIDE; b++) sixty_four(z + b, APART, w, turn + SIDE * b);
        for (long c = 0; c < SIDE; c++) sixty_four(z + APART * c, 1, w, 0);
        for (long k = LANES; k < HALF / 2; k += LANES) {
            real up[4][LANES];
            const long begin[] = {k, HALF - k - LANES + 1, HALF + k, SIZE - k - LANES + 1};
            for (int c = 0; c < LANES; c++) {
                coefficients(z, k + c, apart, twist, &own, &other);
                up[0][c] = own.re, up[1][LANES - 1 - c] = other.re, up[2][c] = -other.im, up[3][LANES - 1 - c] = -own.im;
            }
            for (int part = 0; part < 4; part++) {
                turned(up[part]);
                for (int l = 0; l < LANES; l++) *(loose *)(row[l] + begin[part]) = up[part][l];
            }
        }
        for (long n = 0; n <= LANES; n++) { /* those at the ends */
            const long k = n < LANES ? n : HALF / 2;
            coefficients(z, k, apart, twist, &own, &other);
            put(row, k, own.re);
            if (k) put(row, SIZE - k, -own.im);
            if (k < HALF / 2) put(row, HALF - k, other.re);
            if (k && k < HALF / 2) put(row, HALF + k, -other.im);
        }
    }
}
