/* Sweeps of elliptical slice sampling (Murray, Adams, MacKay 2010), TILE chains side by side. */
#include <math.h>
#define TURN 6.283185307179586
#define TILE 4
#define GROUP 6
typedef double tile __attribute__((vector_size(8 * TILE), aligned(8), may_alias));
typedef long long mask __attribute__((vector_size(8 * TILE), aligned(8), may_alias));

/* The density of standard normal coordinates z (k) times exp(square*z^2 + linear*z), where linear functions (m) of z
   are positive: the upper triangles of symmetric 4-by-4 matrices entry by entry, whose pivots are, then single ones.
   Matrices of a positive weight have log-det distances from spread*1. `freedoms` are those of the Student-t about which
   blocks move; 0 of a Gaussian. */
struct density { long coordinates, functions, matrices; const double *slope, *square, *linear, *weight, *spread; double freedoms; };

/* Functions (m) along ellipses: now, and what they change by along both axes. */
struct course { const tile *now, *along, *across; };

static int any(mask which)
{
    long long found = 0;
    for (long c = 0; c < TILE; c++) found |= which[c];
    return found != 0;
}

static tile chosen(mask which, tile one, tile other)
{
    return (tile)(((mask)one & which) | ((mask)other & ~which));
}

/* What the log-det distance from spread*1 of a matrix u with pivots p weighs beyond the Gaussian that stands in for it,
   in one chain of a tile. */
static double distance(double spread, const tile *u, const tile *p, long c)
{
    double trace = u[0][c] + u[4][c] + u[7][c] + u[9][c], square = 0;
    for (long e = 0; e < 10; e++) {
        int diagonal = e == 0 || e == 4 || e == 7 || e == 9;
        double off = u[e][c] - (diagonal ? spread : 0);
        square += (diagonal ? 1 : 2) * off * off;
    }
    return square / spread / 4 - (trace - log(p[0][c]) - log(p[1][c]) - log(p[2][c]) - log(p[3][c])) / 2;
}

/* Which of some chains are possible at a place of their ellipses, and what log-det distances weigh there. */
static mask possible(const struct density *of, struct course f, tile less, tile sine, mask some, tile *distances)
{
    long n = of->matrices;
    tile sum = {0};
    for (long i = 10 * n; i < of->functions; i++) some &= f.now[i] + less * f.along[i] + sine * f.across[i] >= 0;
    for (long i = 0; i < n && any(some); i++) {
        tile u[10], p[4];
        for (long e = 0; e < 10; e++)
            u[e] = f.now[e * n + i] + less * f.along[e * n + i] + sine * f.across[e * n + i];
        tile over = 1 / u[0], by = u[1] * over, c = u[5] - u[2] * by, d = u[6] - u[3] * by;
        p[0] = u[0], p[1] = u[4] - u[1] * by, by = u[2] * over;
        tile g = u[8] - u[3] * by;
        p[2] = u[7] - u[2] * by, p[3] = u[9] - u[3] * u[3] * over;
        over = 1 / p[1], by = c * over, p[2] -= c * by, g -= d * by, p[3] -= d * d * over + g * g / p[2];
        some &= (p[0] > 0) & (p[1] > 0) & (p[2] > 0) & (p[3] > 0);
        if (of->weight[i] > 0)
            for (long l = 0; l < TILE; l++)
                if (some[l]) sum[l] += of->weight[i] * distance(of->spread[i], u, p, l);
    }
    *distances = sum;
    return some;
}

static double over_t(double freedoms, long size, double square)
{
    return (freedoms + size) / 2 * log1p(square / freedoms) - square / 2;
}

/* What functions change by along both axes of ellipses: sums over coordinates stay in registers. */
static void axes(long size, long functions, const double *slope, const tile *now, const tile *to, tile *along,
                 tile *across)
{
    for (long i = 0; i < functions; i += GROUP, slope += GROUP * size) {
        tile a[GROUP] = {{0}}, b[GROUP] = {{0}};
        for (long n = 0; n < size; n++)
            for (long g = 0; g < GROUP; g++) a[g] += slope[GROUP * n + g] * now[n], b[g] += slope[GROUP * n + g] * to[n];
        for (long g = 0; g < GROUP; g++) along[i + g] = a[g], across[i + g] = b[g];
    }
}

/* Move every block of every chain once along its ellipse; see `moved` in elliptical_moves.py, which says what is drawn.

   state (k, chains), slack (m, chains) and log_density (chains), of a multiple of TILE chains, change in place; work
   holds M*k + TILE*(3*k + 3*M) numbers with M the next multiple of GROUP of m. */
void sweep(const struct density *of, long chains, long tries, long size, const long *order, const double *other,
           const double *square, const double *chance, const double *level, double *state, double *slack,
           double *log_density, double *work)
{
    long k = of->coordinates, m = of->functions, filled = (m + GROUP - 1) / GROUP * GROUP;
    double *slope = work;  /* of GROUP functions by each coordinate of a block, side by side */
    tile *z = (tile *)(slope + filled * k), *to = z + k, *at = to + k, *here = at + k, *along = here + filled;
    tile *across = along + filled;
    for (long first = 0; first < k; first += size) {
        long count = first + size < k ? size : k - first;
        for (long i = 0; i < filled; i++)
            for (long n = 0; n < count; n++)
                slope[filled * first + i / GROUP * GROUP * count + GROUP * n + i % GROUP] =
                    i < m ? of->slope[i * k + order[first + n]] : 0;
    }
    for (long c = 0; c < chains; c += TILE) {
        for (long j = 0; j < k; j++) z[j] = *(const tile *)(state + j * chains + c);
        for (long i = 0; i < m; i++) here[i] = *(const tile *)(slack + i * chains + c);
        tile density = *(const tile *)(log_density + c);
        for (long first = 0, b = 0; first < k; first += size, b++) {
            long count = first + size < k ? size : k - first;
            tile rest = {0}, before = {0}, threshold = density - *(const tile *)(level + b * chains + c);
            for (long j = 0; j < k; j++) rest += (of->square[j] * z[j] + of->linear[j]) * z[j];
            for (long n = 0; n < count; n++) {
                long j = order[first + n];
                at[n] = z[j], to[n] = *(const tile *)(other + (first + n) * chains + c);
                rest -= (of->square[j] * at[n] + of->linear[j]) * at[n], before += at[n] * at[n];
            }
            if (of->freedoms > 0) {
                tile wide;
                for (long l = 0; l < TILE; l++) {
                    wide[l] = sqrt((of->freedoms + before[l]) / square[b * chains + c + l]);
                    threshold[l] += over_t(of->freedoms, count, before[l]);
                }
                for (long n = 0; n < count; n++) to[n] *= wide;
            }
            axes(count, filled, slope + filled * first, at, to, along, across);
            tile low = {0}, high = {0}, cosine = {0}, sine = {0}, less = {0}, more = {0};
            mask waiting = low == high;
            for (long t = 0; t < tries && any(waiting); t++) {
                tile drawn = *(const tile *)(chance + (b * tries + t) * chains + c);
                tile angle = t ? low + (high - low) * drawn : TURN * drawn, found = rest, after = {0}, distances;
                if (!t) low = angle - TURN, high = angle;
                mask below = angle < 0;
                low = chosen(below, angle, low), high = chosen(below, high, angle);
                for (long l = 0; l < TILE; l++)
                    if (waiting[l]) cosine[l] = cos(angle[l]) - 1, sine[l] = sin(angle[l]);
                mask good = possible(of, (struct course){here, along, across}, cosine, sine, waiting, &distances);
                if (!any(good)) continue;
                for (long n = 0; n < count; n++) {
                    long j = order[first + n];
                    tile then = at[n] + (at[n] * cosine + to[n] * sine);
                    found += (of->square[j] * then + of->linear[j]) * then, after += then * then;
                }
                found += distances;
                tile reached = found;
                for (long l = 0; l < TILE && of->freedoms > 0; l++) reached[l] += over_t(of->freedoms, count, after[l]);
                good &= reached > threshold, waiting &= ~good;
                less = chosen(good, cosine, less), more = chosen(good, sine, more), density = chosen(good, found, density);
            }
            for (long n = 0; n < count; n++) z[order[first + n]] = at[n] + (at[n] * less + to[n] * more);
            for (long i = 0; i < m; i++) here[i] = here[i] + less * along[i] + more * across[i];
        }
        for (long j = 0; j < k; j++) *(tile *)(state + j * chains + c) = z[j];
        for (long i = 0; i < m; i++) *(tile *)(slack + i * chains + c) = here[i];
        *(tile *)(log_density + c) = density;
    }
}
