#include <math.h>
/* Compilers' own functions: the header that names them for all takes as long to read as a small kernel to compile. */
#ifdef __has_builtin
#if __has_builtin(__builtin_nontemporal_store)
#define PAST(at, value) __builtin_nontemporal_store((value), (real *)(at))
#endif
#endif
#if defined(__AVX512F__)
#define LANES 8
#ifndef PAST
#define PAST(at, value) __builtin_ia32_movntpd512(at, value)
#endif
#elif defined(__AVX__)
#define LANES 4
#ifndef PAST
#define PAST(at, value) __builtin_ia32_movntpd256(at, value)
#endif
#else
#define LANES 2
#undef PAST
#define PAST(at, value) HERE(at, value)
#endif
#define HERE(at, value) (*(slot *)(at) = (value))
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
static const span written{{ loop.index0 }}[] = { {%- for start, stop in runs[loop.index0] %}{ {{- start }}, {{ stop -}} }, {% endfor %}{0, 0}};
static const span zero{{ loop.index0 }}[] = { {%- for start, stop in gaps[loop.index0] %}{ {{- start }}, {{ stop -}} }, {% endfor %}{0, 0}};
{% endfor %}

static void keep(const span *some, const real *y, double *out, long step, long left)
{
    for (; some->end; some++)
        for (long k = some->first; k < some->end; k++)
            for (long l = 0; l < left; l++) out[k * step + l] = y[k][l];
}

static void blank(const span *some, double *out, long step, long n, long past)
{
    const real nothing = {0};
    for (; some->end; some++)
        for (double *at = out + some->first * step; at < out + some->end * step; at += step)
            for (long s = 0; s < n; s += LANES)
                if (n - s < LANES) for (long l = s; l < n; l++) at[l] = 0;
                else if (past) PAST(at + s, nothing);
                else HERE(at + s, nothing);
}

/* As many samples as there are lanes, entry k of an output at out[k * step]: in the caches, or past them, so that no line
   is fetched that is overwritten. */
{% for name in ways %}
{% for piece in pieces %}
static {{ "__attribute__((noinline)) " if passed }}void {{ name }}{{ loop.index0 }}({% for given in inputs %}const real *restrict x{{ loop.index0 }}, {% endfor %}double *const *out, const long *step, real *restrict passed)
{
{% for output in outputs %}
    double *const y{{ loop.index0 }} = out[{{ loop.index0 }}];
    const long step{{ loop.index0 }} = step[{{ loop.index0 }}];
{% endfor %}
{% for line in piece %}
    {{ line.replace("PUT", name.upper(), 1) }}
{% endfor %}
}

{% endfor %}
static void {{ name }}({% for given in inputs %}const real *restrict x{{ loop.index0 }}, {% endfor %}double *const *out, const long *step)
{
    real passed[{{ passed or 1 }}];
{% for piece in pieces %}
    {{ name }}{{ loop.index0 }}({% for given in inputs %}x{{ loop.index0 }}, {% endfor %}out, step, passed);
{% endfor %}
}

{% endfor %}
/* Entry k of sample s of an output is at out[k * step + s]. What is always zero is written only if `whole`. */
#ifdef _WIN32
__declspec(dllexport)
#endif
void over(long n, const double *const *in, const long *stride, double *const *out, const long *step, long past_caches, long whole)
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
        double *const to[] = { {%- for output in outputs %}out[{{ loop.index0 }}] + s{{ ", " if not loop.last }}{% endfor -%} };
        if (n - s < LANES) {
{% for output in outputs %}
            real last{{ loop.index0 }}[{{ output.entries | length or 1 }}];
{% endfor %}
            here({% for given in inputs %}x{{ loop.index0 }}, {% endfor %}(double *const[]){ {%- for output in outputs %}(double *)last{{ loop.index0 }}{{ ", " if not loop.last }}{% endfor -%} },
                 (const long[]){ {%- for output in outputs %}LANES{{ ", " if not loop.last }}{% endfor -%} });
{% for output in outputs %}
            keep(written{{ loop.index0 }}, last{{ loop.index0 }}, to[{{ loop.index0 }}], step[{{ loop.index0 }}], n - s);
{% endfor %}
        }{% if "past" in ways %} else if (past_caches) past({% for given in inputs %}x{{ loop.index0 }}, {% endfor %}to, step);
        {% endif %}else here({% for given in inputs %}x{{ loop.index0 }}, {% endfor %}to, step);
    }
{% for output in outputs %}
    if (whole) blank(zero{{ loop.index0 }}, out[{{ loop.index0 }}], step[{{ loop.index0 }}], n, past_caches);
{% endfor %}
#ifdef __AVX__
    if (past_caches) __builtin_ia32_sfence();
#endif
}
