/* Sweeps of elliptical slice sampling (Murray, Adams, MacKay 2010), one chain after the other. */
#include <math.h>
#define TURN 6.283185307179586

/* The density of standard normal coordinates z (k) times exp(square*z^2 + linear*z), where linear functions (m) of z
   are positive: the upper triangles of symmetric 4-by-4 matrices entry by entry, whose pivots are, then single ones.
   Matrices of a positive weight have log-det distances from spread*1. `freedoms` are those of the Student-t about which
   blocks move; 0 of a Gaussian. Functions and matrices are filled up to multiples of TILE, which vectors divide: `place`
   says where each of the `own` functions stands. */
struct density { long coordinates, functions, matrices, own; const long *place; const double *slope, *square, *linear, *weight, *spread; double freedoms; };
#define TILE 8
typedef double tile __attribute__((vector_size(8 * TILE), aligned(8), may_alias));

static int single_hold(const struct density *of, const double *slack)
{
    int hold = 1;
    for (long i = 10 * of->matrices; i < of->functions; i++) hold &= slack[i] >= 0;
    return hold;
}

/* The pivots (4, matrices) of all matrices: whether all are positive. */
static int pivots(long n, const double *u, double *p)
{
    int hold = 1;
    for (long i = 0; i < n; i += TILE) {
        const tile *at[10];
        for (long k = 0; k < 10; k++) at[k] = (const tile *)(u + k * n + i);
        tile a = *at[0], b = *at[1], c = *at[2], d = *at[3];
        tile e = *at[4] - b * b / a, f = *at[5] - b * c / a, g = *at[6] - b * d / a;
        tile h = *at[7] - c * c / a - f * f / e, r = *at[8] - c * d / a - f * g / e;
        tile j = *at[9] - d * d / a - g * g / e - r * r / h;
        *(tile *)(p + i) = a, *(tile *)(p + n + i) = e, *(tile *)(p + 2 * n + i) = h, *(tile *)(p + 3 * n + i) = j;
        for (long k = 0; k < TILE; k++) hold &= (a[k] > 0) & (e[k] > 0) & (h[k] > 0) & (j[k] > 0);
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

/* What a tile of functions changes by along both axes of an ellipse: sums over coordinates stay in registers. */
static void axes(long size, const long *order, const double *restrict slope, long m, const double *restrict now,
                 const double *restrict to, double *restrict along, double *restrict across)
{
    tile a = {0}, b = {0};
    for (long n = 0; n < size; n++) {
        tile s = *(const tile *)(slope + order[n] * m);
        a += now[n] * s, b += to[n] * s;
    }
    *(tile *)along = a, *(tile *)across = b;
}

/* Move every block of every chain once along its ellipse; see `moved` in elliptical_moves.py, which says what is drawn.

   state (k, c), slack (own, c) and log_density (c) change in place; work holds 3*k + 4*m + 4*matrices numbers. */
void sweep(const struct density *of, long chains, long tries, long size, const long *order, const double *other,
           const double *square, const double *chance, const double *level, double *state, double *slack,
           double *log_density, double *work)
{
    long k = of->coordinates, m = of->functions;
    double *z = work, *to = z + k, *at = to + k, *here = at + k, *along = here + m, *across = along + m, *there = across + m, *p = there + m;
    for (long i = 0; i < m; i++) here[i] = 0;
    for (long i = 0; i < of->matrices; i++)  /* what fills up: matrices that are always possible */
        here[i] = here[4 * of->matrices + i] = here[7 * of->matrices + i] = here[9 * of->matrices + i] = 1;
    for (long c = 0; c < chains; c++) {
        for (long j = 0; j < k; j++) z[j] = state[j * chains + c];
        for (long i = 0; i < of->own; i++) here[of->place[i]] = slack[i * chains + c];
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
            for (long n = first; n < last; n++) at[n] = z[order[n]], to[n] = wide * other[n * chains + c];
            for (long i = 0; i < m; i += TILE)
                axes(last - first, order + first, of->slope + i, m, at + first, to + first, along + i, across + i);
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
        for (long i = 0; i < of->own; i++) slack[i * chains + c] = here[of->place[i]];
        log_density[c] = density;
    }
}
