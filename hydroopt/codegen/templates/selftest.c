/* Self-test of {{ p }}: what hydroopt's model in Python says of some states, held against this code.
 * {{ p }}_selftest returns the number of values that differ. Define {{ P }}_NO_MAIN to call it from a program of yours.
 */
#include "{{ p }}_internal.h"
#include "{{ p }}_params.h"

#define STATES {{ states }}
#define TOLERANCE {{ (2e-5 if f else 1e-11) | number }}

int {{ p }}_selftest(void);

{% for name, values in inputs.items() %}
static const {{ type }} in_{{ name }}[STATES][{{ values.shape[1] }}] = {
{% for row in values %}
    {
{{ row | numbers }}
    }{{ "," if not loop.last }}
{% endfor %}
};
{% endfor %}
{% for (routine, key), values in outputs.items() if not key.startswith(":") and routine != "payload_update" %}
static const {{ type }} {{ routine }}_{{ key }}[STATES][{{ values[0].size }}] = {
{% for row in values %}
    {
{{ row | numbers }}
    }{{ "," if not loop.last }}
{% endfor %}
};
{% endfor %}
{% if load is defined %}
{% for name, values in load.items() %}
static const {{ type }} load_{{ name }}[{{ values.size }}] = {
{{ values | numbers }}
};
{% endfor %}
{% endif %}

/* How many of n values differ by more than the tolerance, of the greatest one. */
static int differing(const {{ type }} *got, const {{ type }} *want, size_t n)
{
    {{ type }} greatest = {{ 0 | number }};
    int count = 0;
    for (size_t i = 0U; i < n; i++) {
        greatest = (fabs{{ f }}(want[i]) > greatest) ? fabs{{ f }}(want[i]) : greatest;
    }
    for (size_t i = 0U; i < n; i++) {
        if (!(fabs{{ f }}(got[i] - want[i]) <= (TOLERANCE * greatest))) {
            count++;
        }
    }
    return count;
}

static void copy({{ type }} *to, const {{ type }} *from, size_t n)
{
    for (size_t i = 0U; i < n; i++) {
        to[i] = from[i];
    }
}

int {{ p }}_selftest(void)
{
    int wrong = 0;
    {{ p }}_constants_t constants;
    if ({{ p }}_prepare(&{{ p }}_values, &constants) != {{ P }}_OK) {
        return 1;
    }
    for (size_t s = 0U; s < (size_t)STATES; s++) {
{% for routine in code.routines.values() if routine.name != "payload_update" %}
        {
            {{ p }}_{{ routine.takes }}_t in;
            {{ p }}_{{ routine.gives }}_t out;
{% for name in routine.reads %}
            copy(in.{{ name }}, in_{{ name }}[s], sizeof(in.{{ name }}) / sizeof(in.{{ name }}[0]));
{% endfor %}
            if ({{ p }}_{{ routine.name }}(&constants, &in, &out) > {{ P }}_OUT_OF_STROKE) {
                wrong++;
            }
{% for key in routine.outputs %}
{% set rank = code.interface.structs[routine.gives].fields | selectattr("name", "equalto", key) | map(attribute="shape") | first | length %}
            wrong += differing(&out.{{ key }}{{ "[0]" * rank }}, {{ routine.name }}_{{ key }}[s], sizeof({{ routine.name }}_{{ key }}[s]) / sizeof({{ type }}));
{% endfor %}
        }
{% endfor %}
    }
{% if load is defined %}
    {
        {{ p }}_load_t load;
        {{ p }}_load_sample_t in;
        if ({{ p }}_payload_start(load_prior, &load) != {{ P }}_OK) {
            wrong++;
        }
        load.forgetting = load_forgetting[0];
{% for name in code.routines.payload_update.reads %}
        copy(in.{{ name }}, in_{{ name }}[0], sizeof(in.{{ name }}) / sizeof(in.{{ name }}[0]));
{% endfor %}
        copy(in.force, load_force, (size_t){{ P }}_ACTUATOR_COUNT);
        copy(in.std, load_std, (size_t){{ P }}_ACTUATOR_COUNT);
        if ({{ p }}_payload_update(&constants, &in, &load) != {{ P }}_OK) {
            wrong++;
        }
        wrong += differing(load.phi, load_phi, (size_t){{ P }}_BODY_COUNT);
        wrong += differing(&load.covariance[0][0], load_covariance, sizeof(load_covariance) / sizeof({{ type }}));
    }
{% endif %}
    return wrong;
}

#ifndef {{ P }}_NO_MAIN
#include <stdio.h>

int main(void)
{
    const int wrong = {{ p }}_selftest();
    if (wrong == 0) {
        (void)printf("{{ p }}: self-test passed\n");
    } else {
        (void)printf("{{ p }}: self-test failed, %d values differ\n", wrong);
    }
    return (wrong == 0) ? 0 : 1;
}
#endif
