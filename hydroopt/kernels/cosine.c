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
typedef double real __attribute__((vector_size(8 * LANES), aligned(64)));
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

static inline void put(double *const *row, long k, real value)
{
    for (int l = 0; l < LANES; l++) row[l][k] = value[l];
}

/* Coefficients k and SIZE - k from the Fourier transform V of place k. */
static inline void keep(double *const *row, long k, pair V, const number *twist)
{
    const pair turned = times(V, twist[k]);
    put(row, k, turned.re);
    if (k && k < HALF) put(row, SIZE - k, -turned.im);
}

/* `rows` rows of SIZE numbers, `step` from one to the next, in place. `work`, on a multiple of 64 bytes,
   has room for a square of pairs, and for a row that lanes share for which none is left. */
#ifdef _WIN32
__declspec(dllexport)
#endif
void cosine(long rows, double *first, long step, const double *table, double *work)
{
    const number *w = (const number *)table, *turn = w + SIDE, *apart = turn + HALF, *twist = apart + HALF / 2 + 1;
    pair *z = (pair *)work;
    for (long at = 0; at < rows; at += LANES) {
        double *row[LANES];
        for (long l = 0; l < LANES; l++) row[l] = at + l < rows ? first + (at + l) * step : work + 2 * APART * SIDE * LANES;
        for (long j = 0; j < HALF / 2; j++)
            for (int l = 0; l < LANES; l++) {
                z[AT(j)].re[l] = row[l][4 * j], z[AT(j)].im[l] = row[l][4 * j + 2];
                z[AT(HALF - 1 - j)].re[l] = row[l][4 * j + 3], z[AT(HALF - 1 - j)].im[l] = row[l][4 * j + 1];
            }
        for (long b = 0; b < SIDE; b++) sixty_four(z + b, APART, w, turn + SIDE * b);
        for (long c = 0; c < SIDE; c++) sixty_four(z + APART * c, 1, w, 0);
        for (long k = 0; k <= HALF / 2; k++) {
            /* place c + 64 d of the transform is at 64 c + d */
            const long m = (HALF - k) % HALF;
            const pair a = z[APART * (k % SIDE) + k / SIDE], b = z[APART * (m % SIDE) + m / SIDE];
            const pair even = {0.5 * (a.re + b.re), 0.5 * (a.im - b.im)};
            const pair odd = times((pair){0.5 * (a.im + b.im), 0.5 * (b.re - a.re)}, apart[k]);
            const pair other = minus(even, odd);
            keep(row, k, plus(even, odd), twist);
            if (k < HALF / 2) keep(row, HALF - k, (pair){other.re, -other.im}, twist);
        }
    }
}
