/* {{ p }}: what the sources share; not for callers. */
#ifndef {{ P }}_INTERNAL_H
#define {{ P }}_INTERNAL_H

#include <float.h>
#include <math.h>
#include <stddef.h>

#include "{{ p }}.h"

/* 1 if all of n numbers are finite: comparisons with what is not a number are false. */
static inline int {{ p }}_finite(const {{ type }} *x, size_t n)
{
    int finite = 1;
    for (size_t i = 0U; i < n; i++) {
        if (!(fabs{{ f }}(x[i]) <= {{ "FLT_MAX" if f else "DBL_MAX" }})) {
            finite = 0;
        }
    }
    return finite;
}

/* -1, 0 or 1. */
static inline {{ type }} {{ p }}_sign({{ type }} x)
{
    return (x > {{ 0 | number }}) ? {{ 1 | number }} : ((x < {{ 0 | number }}) ? {{ -1 | number }} : {{ 0 | number }});
}

{% if code.interface.machine.cylinders %}
/* Whether all cylinders are as long as they can be, within a micrometre. */
static inline {{ p }}_status_t {{ p }}_stroke(const {{ p }}_constants_t *constants, const {{ type }} length[{{ P }}_CYLINDER_COUNT])
{
    {{ p }}_status_t status = {{ P }}_OK;
    for (size_t i = 0U; i < (size_t){{ P }}_CYLINDER_COUNT; i++) {
        if ((length[i] < (constants->shortest[i] - {{ 1e-6 | number }}))
            || (length[i] > (constants->longest[i] + {{ 1e-6 | number }}))) {
            status = {{ P }}_OUT_OF_STROKE;
        }
    }
    return status;
}

{% endif %}
{% if "payload_update" in code.routines %}
{{ code.used["load_rows"].text | wrap }}
typedef struct {
{% for field in code.used["load_rows"].fields %}
    {{ code.declared(field) }} /* [{{ field.unit }}] {{ field.text }} */
{% endfor %}
} {{ p }}_load_rows_t;

{% endif %}
#endif
