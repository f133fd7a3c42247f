/* Sweeps of elliptical slice sampling (Murray, Adams, MacKay 2010), one chain after the other. */
#include <math.h>
#define TURN 6.283185307179586

/* The density of standard normal coordinates z (k) times exp(square*z^2 + linear*z), where linear functions (m) of z
   are positive: the upper triangles of symmetric 4-by-4 matrices entry by entry, whose pivots are, then single ones.
   Matrices of a positive weight have log-det distances from spread*1. `freedoms` are those of the Student-t about which
   blocks move; 0 of a Gaussian. */
struct density { long coordinates, functions, matrices; const double *slope, *square, *linear, *weight, *spread; double freedoms; };

static int single_hold(const struct density *of, const double *slack)
{
    int hold = 1;
    for (long i = 10 * of->matrices; i < of->functions; i++) hold &= slack[i] >= 0;
    return hold;
}

/* The pivots (4, matrices) of all matrices: whether all are positive. */
static int pivots(long n, const double *restrict u, double *restrict p)
{
    int hold = 1;
    for (long i = 0; i < n; i++) {
        double a = u[i], b = u[n + i], c = u[2 * n + i], d = u[3 * n + i];
        double e = u[4 * n + i] - b * b / a, f = u[5 * n + i] - b * c / a, g = u[6 * n + i] - b * d / a;
        double h = u[7 * n + i] - c * c / a - f * f / e, r = u[8 * n + i] - c * d / a - f * g / e;
        double j = u[9 * n + i] - d * d / a - g * g / e - r * r / h;
        p[i] = a, p[n + i] = e, p[2 * n + i] = h, p[3 * n + i] = j;
        hold &= (a > 0) & (e > 0) & (h > 0) & (j > 0);
    }
    return hold;
}

/* What log-det distances weigh beyond the Gaussian that stands in for them. */
static double distances(const struct density *of, const double *u, const double *p)
{
    long n = of->matrices;
    double sum = 0;
    for (long i = 0; i < n; i++) {
        if (!(of->weight[i] > 0)) continue;
        double trace = u[i] + u[4 * n + i] + u[7 * n + i] + u[9 * n + i], square = 0, mean = of->spread[i];
        for (long e = 0; e < 10; e++) {
            int diagonal = e == 0 || e == 4 || e == 7 || e == 9;
            double off = u[e * n + i] - (diagonal ? mean : 0);
            square += (diagonal ? 1 : 2) * off * off;
        }
        double determinants = log(p[i]) + log(p[n + i]) + log(p[2 * n + i]) + log(p[3 * n + i]);
        sum += of->weight[i] * (square / mean / 4 - (trace - determinants) / 2);
    }
    return sum;
}

static double over_t(double freedoms, long size, double square)
{
    return freedoms > 0 ? (freedoms + size) / 2 * log1p(square / freedoms) - square / 2 : 0;
}

/* Move every block of every chain once along its ellipse; see `moved` in elliptical_moves.py, which says what is drawn.

   state (k, c), slack (m, c) and log_density (c) change in place; work holds 2*k + 4*m + 4*matrices numbers. */
void sweep(const struct density *of, long chains, long tries, long size, const long *order, const double *other,
           const double *square, const double *chance, const double *level, double *state, double *slack,
           double *log_density, double *work)
{
    long k = of->coordinates, m = of->functions;
    double *z = work, *to = z + k, *here = to + k, *along = here + m, *across = along + m, *there = across + m, *p = there + m;
    for (long c = 0; c < chains; c++) {
        for (long j = 0; j < k; j++) z[j] = state[j * chains + c];
        for (long i = 0; i < m; i++) here[i] = slack[i * chains + c];
        double density = log_density[c];
        for (long first = 0, b = 0; first < k; first += size, b++) {
            long last = first + size < k ? first + size : k;
            double rest = 0, before = 0, wide = 1;
            for (long j = 0; j < k; j++) rest += (of->square[j] * z[j] + of->linear[j]) * z[j];
            for (long n = first; n < last; n++) {
                double now = z[order[n]];
                rest -= (of->square[order[n]] * now + of->linear[order[n]]) * now;
                before += now * now;
            }
            if (of->freedoms > 0) wide = sqrt((of->freedoms + before) / square[b * chains + c]);
            for (long i = 0; i < m; i++) along[i] = across[i] = 0;
            for (long n = first; n < last; n++) {
                const double *restrict s = of->slope + order[n] * m;
                double now = z[order[n]];
                to[n] = wide * other[n * chains + c];
                for (long i = 0; i < m; i++) along[i] += now * s[i], across[i] += to[n] * s[i];
            }
            double threshold = density - level[b * chains + c] + over_t(of->freedoms, last - first, before);
            double angle = 0, low = 0, high = 0;
            for (long t = 0; t < tries; t++) {
                double drawn = chance[(b * tries + t) * chains + c];
                angle = t ? low + (high - low) * drawn : TURN * drawn;
                if (t) *(angle < 0 ? &low : &high) = angle;
                else high = angle, low = angle - TURN;
                double less = cos(angle) - 1, sine = sin(angle), ratio = rest, after = 0;
                for (long i = 0; i < m; i++) there[i] = here[i] + less * along[i] + sine * across[i];
                if (!single_hold(of, there) || !pivots(of->matrices, there, p)) continue;
                for (long n = first; n < last; n++) {
                    long j = order[n];
                    double then = z[j] + (z[j] * less + to[n] * sine);
                    ratio += (of->square[j] * then + of->linear[j]) * then;
                    after += then * then;
                }
                double found = ratio + distances(of, there, p);
                if (!(found + over_t(of->freedoms, last - first, after) > threshold)) continue;
                for (long n = first; n < last; n++) z[order[n]] += z[order[n]] * less + to[n] * sine;
                for (long i = 0; i < m; i++) here[i] = there[i];
                density = found;
                break;
            }
        }
        for (long j = 0; j < k; j++) state[j * chains + c] = z[j];
        for (long i = 0; i < m; i++) slack[i * chains + c] = here[i];
        log_density[c] = density;
    }
}
