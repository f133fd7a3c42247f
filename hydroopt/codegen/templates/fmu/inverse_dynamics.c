#include "{{ p }}.h"
#include "{{ p }}_params.h"

typedef {{ p }}_constants_t made_t;

static const char *said({{ p }}_status_t status)
{
    switch (status) {
    case {{ P }}_OK:
        return NULL;
{% for name, text in statuses.items() if name != "OK" %}
    case {{ P }}_{{ name }}:
        return "{{ name }}: {{ text }}";
{% endfor %}
    }
    return "a status that is none";
}

/* Constants of the parameters. */
static const char *prepare(made_t *made, const double *v)
{
    {{ p }}_params_t parameters = {{ p }}_values;
{% for name in fmu.parameters %}
    memcpy(parameters.{{ name }}, &v[{{ name | upper }}], sizeof(parameters.{{ name }}));
{% endfor %}
    return said({{ p }}_prepare(&parameters, made));
}

/* Outputs of the inputs. */
static const char *compute(const made_t *made, double *v)
{
    {{ p }}_{{ routine.takes }}_t in;
    {{ p }}_{{ routine.gives }}_t out;
    const char *why;
{% for name in routine.reads %}
    memcpy(in.{{ name }}, &v[{{ name | upper }}], sizeof(in.{{ name }}));
{% endfor %}
    why = said({{ p }}_{{ routine.name }}(made, &in, &out));
    if (why == NULL) {
{% for name in routine.outputs %}
        memcpy(&v[{{ name | upper }}], out.{{ name }}, sizeof(out.{{ name }}));
{% endfor %}
    }
    return why;
}

static const char *advance(const made_t *made, double *v, double seconds, double tolerance)
{
    (void)made;
    (void)v;
    (void)seconds;
    (void)tolerance;
    return NULL; /* forces depend on the motion of this instant alone */
}
