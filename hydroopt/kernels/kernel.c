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

/* `past` the caches go results that do not fit there: a store then fetches no line, which is as much work as writing it. */
static inline void put(double *at, real value, long past)
{
    if (past) PAST(at, value);
    else *(slot *)at = value;
}

static void blank(double *at, long n, long past)
{
    long s = 0;
    for (; s + LANES <= n; s += LANES) put(at + s, (real){0}, past);
    for (; s < n; s++) at[s] = 0.0;
}

static void kernel({% for given in inputs %}const real *restrict x{{ loop.index0 }}, {% endfor %}double *const *restrict o, const long *restrict step, long past)
{
{% for line in lines %}
    {{ line }}
{% endfor %}
}

/* Entry k of sample s of an output is at out[k * step + s]; entries that are always zero are written if `whole`. */
#ifdef _WIN32
__declspec(dllexport)
#endif
void over(long n, const double *const *in, const long *stride, double *const *out, const long *step, long past, long whole)
{
    for (long s = 0; s < n; s += LANES) {
{% for given in inputs %}
        real x{{ loop.index0 }}[{{ given.size or 1 }}];
{% endfor %}
        for (int l = 0; l < LANES; l++) {
            const long at = s + l < n ? s + l : n - 1;
{% for given in inputs %}
            for (int k = 0; k < {{ given.size }}; k++) x{{ loop.index0 }}[k][l] = in[{{ loop.index0 }}][at * stride[{{ loop.index0 }}] + k];
{% endfor %}
        }
        if (s + LANES <= n) {
            double *const o[] = { {%- for output in outputs %}out[{{ loop.index0 }}] + s, {% endfor -%} };
            kernel({% for given in inputs %}x{{ loop.index0 }}, {% endfor %}o, step, past);
            continue;
        }
        real last[{{ entries or 1 }}];
        double *const o[] = { {%- for first in firsts %}(double *)(last + {{ first }}), {% endfor -%} };
        const long lanes[] = { {%- for output in outputs %}LANES, {% endfor -%} };
        kernel({% for given in inputs %}x{{ loop.index0 }}, {% endfor %}o, lanes, 0);
{% for output in outputs %}
{% set number = loop.index0 %}
{% for start, length in runs[number] %}
        for (int k = {{ start }}; k < {{ start + length }}; k++)
            for (long l = 0; s + l < n; l++) out[{{ number }}][k * step[{{ number }}] + s + l] = o[{{ number }}][k * LANES + l];
{% endfor %}
{% endfor %}
    }
{% for output in outputs %}
{% set number = loop.index0 %}
{% for start, length in gaps[number] %}
    for (int k = {{ start }}; whole && k < {{ start + length }}; k++) blank(out[{{ number }}] + k * step[{{ number }}], n, past);
{% endfor %}
{% endfor %}
#ifdef __AVX__
    if (past) _mm_sfence();
#endif
}
