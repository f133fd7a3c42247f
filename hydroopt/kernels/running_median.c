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
typedef double real __attribute__((vector_size(8 * LANES), aligned(8), may_alias));
#ifndef __AVX__
static inline real least(real a, real b) { for (int l = 0; l < LANES; l++) a[l] = a[l] < b[l] ? a[l] : b[l]; return a; }
static inline real most(real a, real b) { for (int l = 0; l < LANES; l++) a[l] = a[l] < b[l] ? b[l] : a[l]; return a; }
#endif

/* Medians y of n windows of {{ width }} of numbers x: those from x[0] on, from x[1] on, ...; n is a multiple of 8. */
#ifdef _WIN32
__declspec(dllexport)
#endif
void running_median(long n, const double *x, double *y)
{
    for (long s = 0; s < n; s += LANES) {
{% for k in range(width) %}
        const real x{{ k }} = *(const real *)(x + s + {{ k }});
{% endfor %}
{% for line in lines %}
        {{ line }}
{% endfor %}
        *(real *)(y + s) = {{ median }};
    }
}

/* Differences x - y in place of y, and how many of them are at least `share` of the one that is furthest from zero. */
#ifdef _WIN32
__declspec(dllexport)
#endif
long residuals(long n, const double *x, double *y, double share, double *worst)
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
