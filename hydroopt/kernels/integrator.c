#include <math.h>
#define NX {{ states }}
#define NW {{ held }}
#define PIECE 100000L /* steps in which a piece has to succeed */
#define BOUND 3.25 /* h*|lambda| beyond which Dormand and Prince's method is unstable (Hairer and Wanner 1996, IV.2) */
#define SUSPICIOUS 15 /* steps beyond it that count as stiff */
#define MANY 40 /* steps in a piece, limited by stability alone, from which on implicit ones are tried */
#define COST 6 /* explicit steps that take as long as an implicit one */
{% for name in unary %}
static inline double each_{{ name }}(double x) { return {{ name }}(x); }
{% endfor %}
#define each_pow pow
#define each_atan2 atan2
/* Rates have a kink where one of these takes another side: `*sides` differs, in all likelihood, when a side does. */
#define each_fabs(x) side_fabs(x, sides)
#define each_sign(x) side_sign(x, sides)
#define each_corner(root, x) side_corner(root, x, sides)
#define each_fmin(x, y) side_fmin(x, y, sides)
#define each_fmax(x, y) side_fmax(x, y, sides)
static inline void side(int which, unsigned long long *sides) { *sides = *sides * 3 + (unsigned)which; }
static inline double side_fabs(double x, unsigned long long *sides) { side(x < 0, sides); return fabs(x); }
static inline double side_corner(double root, double x, unsigned long long *sides) { side(x < 0, sides); return root; }
static inline double side_fmin(double x, double y, unsigned long long *sides) { side(x < y, sides); return fmin(x, y); }
static inline double side_fmax(double x, double y, unsigned long long *sides) { side(x < y, sides); return fmax(x, y); }
static inline double side_sign(double x, unsigned long long *sides)
{
    side((x > 0) - (x < 0) + 1, sides);
    return (double)((x > 0) - (x < 0)) + (x - x);
}

int constant_count(void) { return {{ count }}; }

void constants({% for name in parameters %}const double *restrict {{ name }}, {% endfor %}double *restrict c)
{
    unsigned long long of_constants = 0, *const sides = &of_constants;
    (void)sides;
{% for line in constants %}
    {{ line }}
{% endfor %}
}

{% for name, lines in computed %}
static void {{ name }}(const double *restrict x, const double *restrict w, const double *restrict c, double *restrict y,
                  unsigned long long *restrict sides)
{
{% for line in lines %}
    {{ line }}
{% endfor %}
}

{% endfor %}
/* What one piece leaves to the next. */
struct memory { double step, error, radius, whole, direction[NX]; long implicit, suspicious, calm, steps, refused; };

/* A call: inputs of a piece and their slopes, results that depend on the parameters alone, and what errors are weighed by. */
struct call { const double *w, *slopes, *c, *scale; double relative, absolute; };

/* Rates y, and the sides that its branches take. */
static unsigned long long slope(const struct call *by, double t, const double *x, double *y)
{
    double w[NW + 1];
    unsigned long long sides = 0;
    for (int i = 0; i < NW; i++) w[i] = by->slopes ? by->w[i] + t * by->slopes[i] : by->w[i];
    rates(x, w, by->c, y, &sides);
    return sides;
}

/* Root mean square of a vector in units of the admissible error between the states x and z. */
static double weighed(const struct call *by, const double *x, const double *z, const double *vector)
{
    double sum = 0;
    for (int i = 0; i < NX; i++) {
        double part = vector[i] / (by->absolute * by->scale[i] + by->relative * fmax(fabs(x[i]), fabs(z[i])));
        sum += part * part;
    }
    return sqrt(sum / NX);
}

/* Rates and the sides of their branches in one place. */
struct slope { double of[NX]; unsigned long long sides; };

/* Dormand and Prince 5(4) from x over h to z: its error as a part of the admissible one. `start` holds the slope at x,
   `end` gets that at z; `stability` gets an estimate of h*|lambda|; `kink` whether rates have one on the way.

   A kink at u*h adds h^2*((1 - u)^2/2 - sum of b_i*(c_i - u)^+) times its size to the error, and with the embedded
   weights only a thirtieth of that to their estimate, a hundredth and less for some u. Where rates have a kink the
   estimate therefore is the norm of all combinations of slopes that meet the conditions of order three, whose
   orthonormal weights are `low` (that of k2 is zero): of what a kink adds it is .49 at least, of a jump 1.2. */
static double dormand_prince(const struct call *by, double t, double h, const double *x, const struct slope *start,
                             double *z, struct slope *end, double *stability, int *kink)
{
    static const double low[3][6] = {
        {0, 0, 0, 0, 0.7071067811865475, -0.7071067811865475},
        {-0.1837131733257392, 0.4303457310141945, -0.7929829716046822, 0.3696098034306554, 0.08837030524278557, 0.08837030524278584},
        {-0.1845177248105718, 0.3995620916529339, -0.03895975967381697, -0.786454086705469, 0.305184739768462, 0.3051847397684618}};
    double k2[NX], k3[NX], k4[NX], k5[NX], k6[NX], y[NX], error[NX], *last = end->of;
    const double *first = start->of;
    unsigned long long sides[6];
    for (int i = 0; i < NX; i++) y[i] = x[i] + h * (first[i] / 5);
    sides[0] = slope(by, t + h / 5, y, k2);
    for (int i = 0; i < NX; i++) y[i] = x[i] + h * (3.0 / 40 * first[i] + 9.0 / 40 * k2[i]);
    sides[1] = slope(by, t + 3 * h / 10, y, k3);
    for (int i = 0; i < NX; i++) y[i] = x[i] + h * (44.0 / 45 * first[i] - 56.0 / 15 * k2[i] + 32.0 / 9 * k3[i]);
    sides[2] = slope(by, t + 4 * h / 5, y, k4);
    for (int i = 0; i < NX; i++)
        y[i] = x[i] + h * (19372.0 / 6561 * first[i] - 25360.0 / 2187 * k2[i] + 64448.0 / 6561 * k3[i] - 212.0 / 729 * k4[i]);
    sides[3] = slope(by, t + 8 * h / 9, y, k5);
    for (int i = 0; i < NX; i++)
        y[i] = x[i] + h * (9017.0 / 3168 * first[i] - 355.0 / 33 * k2[i] + 46732.0 / 5247 * k3[i] + 49.0 / 176 * k4[i]
                           - 5103.0 / 18656 * k5[i]);
    sides[4] = slope(by, t + h, y, k6);
    for (int i = 0; i < NX; i++)
        z[i] = x[i] + h * (35.0 / 384 * first[i] + 500.0 / 1113 * k3[i] + 125.0 / 192 * k4[i] - 2187.0 / 6784 * k5[i]
                           + 11.0 / 84 * k6[i]);
    sides[5] = end->sides = slope(by, t + h, z, last);
    double change = 0, apart = 0;
    for (int i = 0; i < NX; i++) {
        error[i] = h * (71.0 / 57600 * first[i] - 71.0 / 16695 * k3[i] + 71.0 / 1920 * k4[i] - 17253.0 / 339200 * k5[i]
                        + 22.0 / 525 * k6[i] - last[i] / 40);
        double of_rates = (last[i] - k6[i]) / by->scale[i], of_states = (z[i] - y[i]) / by->scale[i];
        change += of_rates * of_rates;
        apart += of_states * of_states;
    }
    *stability = apart > 0 ? h * sqrt(change / apart) : 0;
    *kink = 0;
    for (int s = 0; s < 6; s++) *kink |= sides[s] != start->sides;
    if (*kink) for (int i = 0; i < NX; i++) {
        const double slopes[6] = {first[i], k3[i], k4[i], k5[i], k6[i], last[i]};
        double sum = 0;
        for (int j = 0; j < 3; j++) {
            double part = 0;
            for (int s = 0; s < 6; s++) part += low[j][s] * slopes[s];
            sum += part * part;
        }
        error[i] = h * sqrt(sum);
    }
    return weighed(by, x, z, error);
}

/* J by forward differences from the rates at x: exact enough for the order of `rodas` (as in Hairer and Wanner's code). */
static void jacobian(const struct call *by, double t, const double *x, const double *first, double *J)
{
    double moved[NX], there[NX];
    for (int i = 0; i < NX; i++) moved[i] = x[i];
    for (int j = 0; j < NX; j++) {
        moved[j] = x[j] + 1e-8 * fmax(fabs(x[j]), 1e-3 * by->scale[j]);
        const double by_what = moved[j] - x[j];
        slope(by, t, moved, there);
        for (int i = 0; i < NX; i++) J[i * NX + j] = (there[i] - first[i]) / by_what;
        moved[j] = x[j];
    }
}

static int factorise(double *a, int *pivots)
{
    for (int k = 0; k < NX; k++) {
        int best = k;
        for (int i = k + 1; i < NX; i++) if (fabs(a[i * NX + k]) > fabs(a[best * NX + k])) best = i;
        pivots[k] = best;
        if (!(fabs(a[best * NX + k]) > 0)) return 0;
        if (best != k) for (int j = 0; j < NX; j++) { double held = a[k * NX + j]; a[k * NX + j] = a[best * NX + j]; a[best * NX + j] = held; }
        for (int i = k + 1; i < NX; i++) {
            double part = a[i * NX + k] /= a[k * NX + k];
            for (int j = k + 1; j < NX; j++) a[i * NX + j] -= part * a[k * NX + j];
        }
    }
    return 1;
}

static void solve(const double *a, const int *pivots, double *b)
{
    for (int k = 0; k < NX; k++) { double held = b[k]; b[k] = b[pivots[k]]; b[pivots[k]] = held; }
    for (int k = 0; k < NX; k++) for (int i = k + 1; i < NX; i++) b[i] -= a[i * NX + k] * b[k];
    for (int k = NX - 1; k >= 0; k--) {
        for (int j = k + 1; j < NX; j++) b[k] -= a[k * NX + j] * b[j];
        b[k] /= a[k * NX + k];
    }
}

/* Hairer and Wanner's RODAS 4(3), L-stable, from x over h to z: its error as a part of the admissible one. `first` holds
   the rates at x and J their derivatives by the states. */
static double rodas(const struct call *by, double t, double h, const double *x, const double *first, const double *J,
                    double *z)
{
    static const double place[6] = {0, 0.386, 0.21, 0.63, 1, 1}, along[6] = {0.25, -0.1043, 0.1035, -0.0362, 0, 0};
    static const double A[6][5] = { {0},
        {1.544},
        {0.9466785280815826, 0.2557011698983284},
        {3.314825187068521, 2.896124015972201, 0.9986419139977817},
        {1.221224509226641, 6.019134481288629, 12.53708332932087, -0.6878860361058950},
        {1.221224509226641, 6.019134481288629, 12.53708332932087, -0.6878860361058950, 1}};
    static const double C[6][5] = { {0},
        {-5.6688},
        {-2.430093356833875, -0.2063599157091915},
        {-0.1073529058151375, -9.594562251023355, -20.47028614809616},
        {7.496443313967647, -10.24680431464352, -33.99990352819905, 11.70890893206160},
        {8.083246795921522, -7.981132988064893, -31.52159432874371, 16.31930543123136, -6.058818238834054}};
    double E[NX * NX], k[6][NX], by_time[NX] = {0}, after[NX];
    int pivots[NX];
    for (int i = 0; i < NX * NX; i++) E[i] = -J[i];
    for (int i = 0; i < NX; i++) E[i * NX + i] += 4 / h;
    if (!factorise(E, pivots)) return INFINITY;
    if (by->slopes) { /* inputs are linear in time: a central difference is exact but for what is not linear in them */
        double tiny = 1e-3 * h;
        slope(by, t + tiny, x, by_time);
        slope(by, t - tiny, x, after);
        for (int i = 0; i < NX; i++) by_time[i] = (by_time[i] - after[i]) / (2 * tiny);
    }
    for (int s = 0; s < 6; s++) {
        for (int i = 0; i < NX; i++) {
            z[i] = x[i];
            for (int j = 0; j < s; j++) z[i] += A[s][j] * k[j][i];
        }
        if (s) slope(by, t + place[s] * h, z, k[s]);
        else for (int i = 0; i < NX; i++) k[0][i] = first[i];
        for (int i = 0; i < NX; i++) {
            double sum = 0;
            for (int j = 0; j < s; j++) sum += C[s][j] * k[j][i];
            k[s][i] += sum / h + along[s] * h * by_time[i];
        }
        solve(E, pivots, k[s]);
    }
    for (int i = 0; i < NX; i++) z[i] += k[5][i];
    return weighed(by, x, z, k[5]);
}

/* Spectral radius of J by the power method, which goes on from one step to the next. */
static double radius(struct memory *m, const double *J, const double *scale)
{
    double length = 0;
    for (int round = 0; round < 8; round++) {
        double image[NX];
        length = 0;
        for (int i = 0; i < NX; i++) {
            image[i] = 0;
            for (int j = 0; j < NX; j++) image[i] += J[i * NX + j] * scale[j] * m->direction[j];
            image[i] /= scale[i];
            length += image[i] * image[i];
        }
        length = sqrt(length);
        if (!(length > 0)) break;
        for (int i = 0; i < NX; i++) m->direction[i] = image[i] / length;
    }
    return length;
}

/* Integrates x over pieces of `seconds`, each with its own inputs; `states` gets x behind each of them. Returns how many
   pieces succeeded. */
#ifdef _WIN32
__declspec(dllexport)
#endif
long along(struct memory *m, long pieces, const double *seconds, const double *w, const double *slopes, const double *c,
           const double *scale, double relative, double absolute, double *restrict x, double *restrict states)
{
    for (long piece = 0; piece < pieces; piece++) {
        const struct call by = {w + piece * NW, slopes ? slopes + piece * NW : 0, c, scale, relative, absolute};
        struct slope first, last;
        double z[NX], held[NX], elapsed = 0;
        long here = 0;
        int refused = 0;
        first.sides = slope(&by, elapsed, x, first.of);
        if (!(m->step > 0)) {
            for (int i = 0; i < NX; i++) held[i] = 0;
            double fast = weighed(&by, x, x, first.of), size = weighed(&by, held, x, x);
            m->step = fast > 0 && size > 0 ? 0.01 * size / fast : seconds[piece];
        }
        while (elapsed < seconds[piece]) {
            double left = seconds[piece] - elapsed, h = m->step, stability = 0, error, factor;
            int kink = 0, final = h >= left * (1 - 1e-12);
            if (final) h = left;
            if (++here > PIECE || !(h > 1e-15 * seconds[piece])) return piece;
            if (m->implicit) {
                double J[NX * NX];
                jacobian(&by, elapsed, x, first.of, J);
                m->radius = radius(m, J, scale);
                error = rodas(&by, elapsed, h, x, first.of, J, z);
                if (error <= 1) last.sides = slope(&by, elapsed + h, z, last.of);
                factor = 0.9 * pow(fmax(error, 1e-8), -0.25);
                factor = fmax(0.2, fmin(factor, refused ? 1 : 6));
            } else
            {
                error = dormand_prince(&by, elapsed, h, x, &first, z, &last, &stability, &kink);
                factor = 0.9 * pow(fmax(error, 1e-8), -0.17);
                if (error <= 1) factor *= pow(m->error, 0.04);
                factor = fmax(0.2, fmin(factor, refused ? 1 : 10));
            }
            m->steps++;
            if (!(error <= 1)) { /* also where it is not a number */
                m->refused++;
                if (kink && isfinite(error)) { /* halved until the kink adds little, and behind it as long as before */
                    if (!(m->whole > 0)) m->whole = h;
                    m->step = h / 2;
                } else m->step = h * (error > 1 && isfinite(error) ? fmin(factor, 0.9) : 0.1);
                refused = 1;
                continue;
            }
            refused = 0;
            m->error = fmax(error, 1e-4);
            m->step = final ? fmax(m->step, h * factor) : h * factor;
            if (kink && m->whole > 0) { m->step = m->whole; m->whole = 0; }
            elapsed = final ? seconds[piece] : elapsed + h;
            for (int i = 0; i < NX; i++) { x[i] = z[i]; }
            first = last;
            if (m->implicit) {
                /* back, where explicit steps would be long enough */
                m->calm = h * m->radius < COST * BOUND ? m->calm + 1 : 0;
                if (m->calm > SUSPICIOUS) { m->implicit = m->calm = m->suspicious = 0; m->error = 1e-4; m->step = fmin(m->step, BOUND / m->radius); }
            } else if (stability > BOUND) {
                m->calm = 0;
                if (++m->suspicious >= SUSPICIOUS && here > MANY) {
                    m->suspicious = 0;
                    m->implicit = 1;
                    for (int i = 0; i < NX; i++) m->direction[i] = 1 + 0.1 * i;
                }
            } else if (++m->calm >= 6) m->suspicious = m->calm = 0;
        }
        for (int i = 0; i < NX; i++) states[piece * NX + i] = x[i];
    }
    return pieces;
}
