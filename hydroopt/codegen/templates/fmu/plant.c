{{ equations }}
static const double scale[NX] = {
{{ typical }}
};

/* What the parameters decide, and what the integration remembers from step to step. */
typedef struct {
    double c[{{ constants }} + 1];
    struct memory memory;
} made_t;

static const char *prepare(made_t *made, const double *v)
{
    constants(&v[PSI], &v[THETA], made->c);
    made->memory = (struct memory){.error = 1e-4};
    return NULL;
}

/* Rates of the states and outputs. */
static const char *compute(const made_t *made, double *v)
{
    unsigned long long sides = 0;
    rates(&v[STATE], &v[INPUT], made->c, &v[DERIVATIVE], &sides);
    outputs(&v[STATE], &v[INPUT], made->c, &v[OUTPUT], &sides);
    for (int i = DERIVATIVE; i < VALUES; i++) {
        if (!(fabs(v[i]) <= DBL_MAX)) {
            return "rates or outputs are not finite: a dead point, or a state or parameter that cannot be";
        }
    }
    return NULL;
}

/* Which joint is beyond its range, where this model ends. */
static const char *outside(const double *v)
{
{% for name, (lower, upper) in ranges.items() %}
    if (!((v[STATE + {{ loop.index0 }}] >= {{ lower }}) && (v[STATE + {{ loop.index0 }}] <= {{ upper }}))) {
        return "{{ name }} is out of its range, {{ lower }} to {{ upper }}: ends of strokes are not modelled";
    }
{% endfor %}
    return NULL;
}

static const char *advance(made_t *made, double *v, double seconds, double tolerance)
{
    double x[NX], after[NX];
    memcpy(x, &v[STATE], sizeof(x));
    if ((seconds > 0) && (along(&made->memory, 1, &seconds, &v[INPUT], NULL, made->c, scale, tolerance, tolerance / 100, x, after) < 1)) {
        return "the integration did not converge: give commands that keep the machine within its range";
    }
    memcpy(&v[STATE], x, sizeof(x));
    return outside(v);
}
