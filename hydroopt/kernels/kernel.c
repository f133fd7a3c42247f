#include <math.h>
#if defined(__AVX512F__)
#include <immintrin.h>
#define LANES 8
#define PAST(at, value) _mm512_stream_pd(at, (__m512d)(value))
#elif defined(__AVX__)
#include <immintrin.h>
#define LANES 4
#define PAST(at, value) _mm256_stream_pd(at, (__m256d)(value))
#else
#define LANES 2
#define PAST(at, value) (*(slot *)(at) = (value))
#endif
typedef double real __attribute__((vector_size(8 * LANES)));
typedef double slot __attribute__((vector_size(8 * LANES), aligned(8), may_alias));
#ifdef VECTOR_LIBRARY
__attribute__((simd("notinbranch"))) extern double sin(double);
__attribute__((simd("notinbranch"))) extern double cos(double);
#endif
#define EACH(name, value) \
    static inline real each_##name(real x) { real y; for (int l = 0; l < LANES; l++) y[l] = value; return y; }
{% for name in unary %}
EACH({{ name }}, {{ name }}(x[l]))
{% endfor %}
EACH(sign, (double)((x[l] > 0) - (x[l] < 0)) + (x[l] - x[l]))
static inline real each_pow(real x, double p) { real y; for (int l = 0; l < LANES; l++) y[l] = pow(x[l], p); return y; }
static inline real each_atan2(real x, real z) { real y; for (int l = 0; l < LANES; l++) y[l] = atan2(x[l], z[l]); return y; }
static inline real each_fmin(real x, real z) { real y; for (int l = 0; l < LANES; l++) y[l] = fmin(x[l], z[l]); return y; }
static inline real each_fmax(real x, real z) { real y; for (int l = 0; l < LANES; l++) y[l] = fmax(x[l], z[l]); return y; }

/* Entries of an output from `first` on, up to `end`. */
typedef struct { long first, end; } span;
{% for output in outputs %}
{% set number = loop.index0 %}
static const span written{{ number }}[] = { {%- for start, stop in runs[number] %}{ {{- start }}, {{ stop -}} }, {% endfor %}{0, 0}};
static const span zero{{ number }}[] = { {%- for start, stop in gaps[number] %}{ {{- start }}, {{ stop -}} }, {% endfor %}{0, 0}};
{% endfor %}

/* Entry k of sample s of an output is at out[k * step + s]; results `past` the caches fetch no line that they overwrite. */
static void keep(const span *some, const real *y, double *out, long step, long left, long past)
{
    for (; some->end; some++)
        for (long k = some->first; k < some->end; k++, y++) {
            double *const at = out + k * step;
            if (left >= LANES && past) PAST(at, *y);
            else if (left >= LANES) *(slot *)at = *y;
            else for (long l = 0; l < left; l++) at[l] = (*y)[l];
        }
}

static void blank(const span *some, double *out, long step, long n, long past)
{
    const real nothing = {0};
    for (; some->end; some++)
        for (long k = some->first; k < some->end; k++)
            for (long s = 0; s < n; s += LANES) keep((const span[]){ {0, 1}, {0, 0} }, &nothing, out + k * step + s, step, n - s, past);
}

static void kernel({% for given in inputs %}const real *restrict x{{ loop.index0 }}, {% endfor %}real *restrict y)
{
{% for line in lines %}
    {{ line }}
{% endfor %}
}

/* What is always zero is written only if `whole`. */
#ifdef _WIN32
__declspec(dllexport)
#endif
void over(long n, const double *const *in, const long *stride, double *const *out, const long *step, long past, long whole)
{
    for (long s = 0; s < n; s += LANES) {
{% for given in inputs %}
        real x{{ loop.index0 }}[{{ given.size or 1 }}];
{% endfor %}
        real y[{{ entries or 1 }}];
        for (int l = 0; l < LANES; l++) {
            const long at = s + l < n ? s + l : n - 1;
{% for given in inputs %}
            for (int k = 0; k < {{ given.size }}; k++) x{{ loop.index0 }}[k][l] = in[{{ loop.index0 }}][at * stride[{{ loop.index0 }}] + k];
{% endfor %}
        }
        kernel({% for given in inputs %}x{{ loop.index0 }}, {% endfor %}y);
{% for output in outputs %}
        keep(written{{ loop.index0 }}, y + {{ firsts[loop.index0] }}, out[{{ loop.index0 }}] + s, step[{{ loop.index0 }}], n - s, past);
{% endfor %}
    }
{% for output in outputs %}
    if (whole) blank(zero{{ loop.index0 }}, out[{{ loop.index0 }}], step[{{ loop.index0 }}], n, past);
{% endfor %}
#ifdef __AVX__
    if (past) _mm_sfence();
#endif
}
