/* Medians of windows of 25 numbers, at several places at once: eights of neighbours are put in order once, and each
   window merges three of them. */
#include <math.h>
#if defined(__AVX512F__)
#include <immintrin.h>
#define LANES 8
#define LEAST(a, b) ((real)_mm512_min_pd((__m512d)(a), (__m512d)(b)))
#define MOST(a, b) ((real)_mm512_max_pd((__m512d)(a), (__m512d)(b)))
#elif defined(__AVX__)
#include <immintrin.h>
#define LANES 4
#define LEAST(a, b) ((real)_mm256_min_pd((__m256d)(a), (__m256d)(b)))
#define MOST(a, b) ((real)_mm256_max_pd((__m256d)(a), (__m256d)(b)))
#else
#define LANES 2
#define LEAST(a, b) least(a, b)
#define MOST(a, b) most(a, b)
#endif
#ifdef _WIN32
#define EXPORT __declspec(dllexport)
#else
#define EXPORT
#endif
#define EIGHT 8
#define NEXT (EIGHT / LANES) /* as many steps further are the next eight numbers */
#define HELD (4 * NEXT) /* more than two eights further, and a power of 2 */
typedef double real __attribute__((vector_size(8 * LANES), aligned(8), may_alias));
#ifndef __AVX__
static inline real least(real a, real b) { for (int l = 0; l < LANES; l++) a[l] = a[l] < b[l] ? a[l] : b[l]; return a; }
static inline real most(real a, real b) { for (int l = 0; l < LANES; l++) a[l] = a[l] < b[l] ? b[l] : a[l]; return a; }
#endif

static inline void order(real *a, int i, int j)
{
    const real low = LEAST(a[i], a[j]);
    a[j] = MOST(a[i], a[j]), a[i] = low;
}

/* The eights of numbers from x[0] on, from x[1] on, ... in order. */
static inline void ordered(const double *x, real *made)
{
    static const int pairs[][2] = {{0, 2}, {1, 3}, {4, 6}, {5, 7}, {0, 4}, {1, 5}, {2, 6}, {3, 7}, {0, 1}, {2, 3},
                                   {4, 5}, {6, 7}, {2, 4}, {3, 5}, {1, 4}, {3, 6}, {1, 2}, {3, 4}, {5, 6}};
    real a[EIGHT];
    for (int k = 0; k < EIGHT; k++) a[k] = *(const real *)(x + k);
#pragma GCC unroll 19
    for (int k = 0; k < 19; k++) order(a, pairs[k][0], pairs[k][1]);
    for (int k = 0; k < EIGHT; k++) made[k] = a[k];
}

/* Medians y of n windows of numbers x: those from x[0] on, from x[1] on, ...; n is a multiple of 8. */
EXPORT void running_median(long n, const double *x, double *y)
{
    real held[HELD][EIGHT];
    for (long b = 0; b < 2 * NEXT; b++) ordered(x + b * LANES, held[b]);
    for (long b = 0; b < n / LANES; b++, x += LANES, y += LANES) {
        const real *first = held[b % HELD], *second = held[(b + NEXT) % HELD], last = *(const real *)(x + 3 * EIGHT);
        real *third = held[(b + 2 * NEXT) % HELD], m[2 * EIGHT];
        ordered(x + 2 * EIGHT, third);
        for (int k = 0; k < EIGHT; k++) m[k] = LEAST(first[k], second[k]), m[k + EIGHT] = MOST(first[k], second[k]);
        /* Batcher's odd-even merge */
#pragma GCC unroll 4
        for (int k = 4; k < 8; k++) order(m, k, k + 4);
#pragma GCC unroll 3
        for (int k = 2; k < 12; k += 4) order(m, k, k + 2), order(m, k + 1, k + 3);
#pragma GCC unroll 7
        for (int k = 1; k < 14; k += 2) order(m, k, k + 1);
        /* the two in the middle of 24: of so many numbers from both the largest, the least for all such splits */
        real low = m[11], high = m[12];
#pragma GCC unroll 8
        for (int k = 0; k < EIGHT; k++) {
            low = LEAST(low, MOST(m[10 - k], third[k]));
            high = LEAST(high, MOST(m[11 - k], third[k]));
        }
        *(real *)y = MOST(low, LEAST(last, high));
    }
}

/* Differences x - y in place of y, and how many of them are at least `share` of the one that is furthest from zero. */
EXPORT long residuals(long n, const double *x, double *y, double share, double *worst)
{
    const long whole = n / LANES * LANES;
    real most = {0};
    for (long s = 0; s < whole; s += LANES) {
        const real off = *(const real *)(x + s) - *(real *)(y + s);
        *(real *)(y + s) = off, most = MOST(most, MOST(off, -off));
    }
    *worst = 0;
    for (long l = 0; l < LANES; l++) *worst = *worst < most[l] ? most[l] : *worst;
    for (long s = whole; s < n; s++) y[s] = x[s] - y[s], *worst = *worst < fabs(y[s]) ? fabs(y[s]) : *worst;
    const double least = share * *worst;
    long many = 0;
    for (long s = 0; s < n; s++) many += fabs(y[s]) >= least;
    return many;
}
