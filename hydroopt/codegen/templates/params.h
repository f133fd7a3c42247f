/* Values of the parameters of {{ p }}: {{ code.origin.text }},
 * sha256 {{ code.origin.sha256 }}.
 */
#ifndef {{ P }}_PARAMS_H
#define {{ P }}_PARAMS_H

#include "{{ p }}.h"

static const {{ p }}_params_t {{ p }}_values = {
{% for name, values in code.interface.values.items() %}
{% set kind = code.interface.structs.params.fields | selectattr("name", "equalto", name) | map(attribute="shape") | first | first %}
    { /* {{ name }} */
{% for enumerator, text in code.enumerators(kind) %}
        {{ values[loop.index0] | number }}{{ "," if not loop.last }} /* {{ text }} */
{% endfor %}
    }{{ "," if not loop.last }}
{% endfor %}
};

#endif
