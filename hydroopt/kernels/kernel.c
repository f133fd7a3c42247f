#include <math.h>
#if defined(__AVX512F__)
#define LANES 8
#elif defined(__AVX__)
#define LANES 4
#else
#define LANES 2
#endif
typedef double real __attribute__((vector_size(8 * LANES)));
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

static void kernel({% for given in inputs %}const real *restrict x{{ loop.index0 }}, {% endfor %}real *restrict y)
{
{% for line in lines %}
    {{ line }}
{% endfor %}
}

#ifdef _WIN32
__declspec(dllexport)
#endif
void over(long n, const double *const *in, const long *stride, double *const *out)
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
        for (int l = 0; l < LANES && s + l < n; l++) {
{% for output in outputs %}
            double *restrict o{{ loop.index0 }} = out[{{ loop.index0 }}] + (s + l) * {{ output.rows * output.columns }};
{% set number = loop.index0 %}
{% for start, first, length in runs[number] %}
            for (int k = 0; k < {{ length }}; k++) o{{ number }}[{{ start }} + k] = y[{{ first }} + k][l];
{% endfor %}
{% endfor %}
        }
    }
}
