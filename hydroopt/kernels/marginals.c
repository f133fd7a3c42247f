/* Marginal distributions of linear sums of standard normal coordinates that conditions cut off, from samples of them.

   Along one direction the conditional distribution of a sum, all else as in a sample, is a normal one between the ends
   of a chord. Its mean over the samples is the marginal distribution. */
#include <math.h>
#ifndef M_SQRT1_2
#define M_SQRT1_2 0.70710678118654752440
#endif
#ifdef __AVX512F__  /* samples at a time: as many as a vector holds */
#define TILE 8
#elif defined __AVX__
#define TILE 4
#else
#define TILE 2
#endif
#define QUEUE 64
#define FAR 100.0
#define STEPS 30
#define NARROW 1e-4
#define MINORS 42
#define ROUND 6755399441055744.0  /* added to a number, its last bits are the nearest whole number */

typedef double real __attribute__((vector_size(8 * TILE), aligned(8), may_alias));
typedef long long whole __attribute__((vector_size(8 * TILE)));

/* Places of the entries of a symmetric matrix, and of pairs of rows with pairs of columns, in their upper triangles; the
   pairs, of which the last is the complement of the first, the number of each; and the rows beside one. */
static const long ENTRY[4][4] = {{0, 1, 2, 3}, {1, 4, 5, 6}, {2, 5, 7, 8}, {3, 6, 8, 9}};
static const long MINOR[6][6] = {{0, 1, 2, 3, 4, 5}, {1, 6, 7, 8, 9, 10}, {2, 7, 11, 12, 13, 14}, {3, 8, 12, 15, 16, 17},
                                 {4, 9, 13, 16, 18, 19}, {5, 10, 14, 17, 19, 20}};
static const long PAIR[6][2] = {{0, 1}, {0, 2}, {0, 3}, {1, 2}, {1, 3}, {2, 3}};
static const long NUMBER[4][4] = {{0, 0, 1, 2}, {0, 0, 3, 4}, {1, 3, 0, 5}, {2, 4, 5, 0}};
static const long OTHERS[4][3] = {{1, 2, 3}, {0, 2, 3}, {0, 1, 3}, {0, 1, 2}};

/* Taylor's coefficients of exp(u), of which what is left out is below 1e-17 where |u| < log(2)/2. */
static const double EXP[] = {1, 1, 1. / 2, 1. / 6, 1. / 24, 1. / 120, 1. / 720, 1. / 5040, 1. / 40320, 1. / 362880,
                             1. / 3628800, 1. / 39916800, 1. / 479001600, 1. / 6227020800};

/* Chebyshev's coefficients of (1 + 2*z)*exp(z^2)*erfc(z) in (z - 3.75)/(z + 3.75), from zero to infinity (Shepherd and
   Laframboise 1981): what is left out is below 1e-16. */
static const double ERFC[] = {
    1.1775789345674017, -0.004590054580646478, -0.08424913336651792, 0.05920993999819189, -0.026658668435305753,
    0.009074997670705265, -0.002413163540417608, 0.0004907758365258086, -6.916973302501207e-05,
    4.13902798607301e-06, 7.74038306619849e-07, -2.1886401049234397e-07, 1.076499946567091e-08,
    4.521959811218287e-09, -7.754400208831351e-10, -6.318088340886684e-11, 2.86879501093067e-11,
    1.9455868545777347e-13, -9.65469674843344e-13, 3.25254814814874e-14, 3.3478119482868056e-14,
    -1.864562880419313e-15, -1.2507950530688648e-15, 7.418235256624044e-17};

/* Polynomials 1 + a*t + b*t^2 + c*t^3 + d*t^4 of which all roots are real, and the ends of chords that begin at zero
   and do not pass their first positive root. */
typedef struct {
    long count;
    double a[QUEUE], b[QUEUE], c[QUEUE], d[QUEUE], *end[QUEUE];
} queue;

/* Find these roots, where they are nearer than the ends: by Laguerre's steps, which do not pass a root. */
static void nearest_roots(queue *of)
{
    double t[QUEUE] = {0}, most[QUEUE];
    for (long k = of->count; k < QUEUE; k++) of->a[k] = of->b[k] = of->c[k] = of->d[k] = 0;
    for (long k = 0; k < QUEUE; k++) most[k] = k < of->count ? *of->end[k] : 0;
    long moved = 1;
    for (long n = 0; n < STEPS && moved; n++) {
        moved = 0;
        for (long k = 0; k < QUEUE; k++) {
            double x = t[k], e = of->a[k], f = of->b[k], g = of->c[k], h = of->d[k];
            double value = 1 + x * (e + x * (f + x * (g + x * h)));
            double slope = e + x * (2 * f + x * (3 * g + x * 4 * h)), bend = 2 * f + x * (6 * g + x * 12 * h);
            double square = 9 * slope * slope - 12 * value * bend;
            double below = sqrt(square > 0 ? square : 0) - slope, step = 4 * value / below;
            step = below > 0 ? step : FAR;
            double next = x + (value > 0 ? step : 0);
            next = next < most[k] ? next : most[k];
            moved |= next - x > 1e-7 * next;
            t[k] = next;
        }
    }
    for (long k = 0; k < of->count; k++) *of->end[k] = t[k] < *of->end[k] ? t[k] : *of->end[k];
    of->count = 0;
}

/* The inverse (10), row by row, of the Cholesky factor of a matrix given by its upper triangle (10). */
static void inverse(const double *u, double *made)
{
    double l00 = sqrt(u[0]), l10 = u[1] / l00, l20 = u[2] / l00, l30 = u[3] / l00;
    double l11 = sqrt(u[4] - l10 * l10), l21 = (u[5] - l20 * l10) / l11, l31 = (u[6] - l30 * l10) / l11;
    double l22 = sqrt(u[7] - l20 * l20 - l21 * l21), l32 = (u[8] - l30 * l20 - l31 * l21) / l22;
    double l33 = sqrt(u[9] - l30 * l30 - l31 * l31 - l32 * l32);
    double m00 = 1 / l00, m11 = 1 / l11, m22 = 1 / l22, m33 = 1 / l33;
    double m10 = -l10 * m00 * m11, m21 = -l21 * m11 * m22, m32 = -l32 * m22 * m33;
    double m20 = -(l20 * m00 + l21 * m10) * m22, m31 = -(l31 * m11 + l32 * m21) * m33;
    double m30 = -(l30 * m00 + l31 * m10 + l32 * m20) * m33;
    const double all[10] = {m00, m10, m11, m20, m21, m22, m30, m31, m32, m33};
    for (long e = 0; e < 10; e++) made[e] = all[e];
}

/* What the determinants of sums of symmetric matrices with other ones need, in coordinates of the lower triangles M (10):
   entries of A = M*U*M' (10), cofactors (10) and minors of two rows and columns (21), upper triangles row by row, and the
   determinant. */
static void minors(const double *m, const real *u, real *made)
{
    real x00 = m[0] * u[0], x10 = m[1] * u[0] + m[2] * u[1], x11 = m[1] * u[1] + m[2] * u[4];
    real x20 = m[3] * u[0] + m[4] * u[1] + m[5] * u[2], x21 = m[3] * u[1] + m[4] * u[4] + m[5] * u[5];
    real x22 = m[3] * u[2] + m[4] * u[5] + m[5] * u[7];
    real x30 = m[6] * u[0] + m[7] * u[1] + m[8] * u[2] + m[9] * u[3];
    real x31 = m[6] * u[1] + m[7] * u[4] + m[8] * u[5] + m[9] * u[6];
    real x32 = m[6] * u[2] + m[7] * u[5] + m[8] * u[7] + m[9] * u[8];
    real x33 = m[6] * u[3] + m[7] * u[6] + m[8] * u[8] + m[9] * u[9];
    made[0] = x00 * m[0], made[1] = x10 * m[0], made[2] = x20 * m[0], made[3] = x30 * m[0];
    made[4] = x10 * m[1] + x11 * m[2], made[5] = x20 * m[1] + x21 * m[2], made[6] = x30 * m[1] + x31 * m[2];
    made[7] = x20 * m[3] + x21 * m[4] + x22 * m[5], made[8] = x30 * m[3] + x31 * m[4] + x32 * m[5];
    made[9] = x30 * m[6] + x31 * m[7] + x32 * m[8] + x33 * m[9];
    real *const of_two = made + 20;
    for (long i = 0, n = 0; i < 6; i++)
        for (long j = i; j < 6; j++, n++)
            of_two[n] = made[ENTRY[PAIR[i][0]][PAIR[j][0]]] * made[ENTRY[PAIR[i][1]][PAIR[j][1]]]
                - made[ENTRY[PAIR[i][0]][PAIR[j][1]]] * made[ENTRY[PAIR[i][1]][PAIR[j][0]]];
    for (long i = 0; i < 4; i++)
        for (long j = i; j < 4; j++) {
            const long *r = OTHERS[i], *c = OTHERS[j], rows = NUMBER[r[1]][r[2]];
            const double sign = (i + j) % 2 ? -1 : 1;
            made[10 + ENTRY[i][j]] = sign * (made[ENTRY[r[0]][c[0]]] * of_two[MINOR[rows][NUMBER[c[1]][c[2]]]]
                                             - made[ENTRY[r[0]][c[1]]] * of_two[MINOR[rows][NUMBER[c[0]][c[2]]]]
                                             + made[ENTRY[r[0]][c[2]]] * of_two[MINOR[rows][NUMBER[c[0]][c[1]]]]);
        }
    made[41] = made[0] * made[10] + made[1] * made[11] + made[2] * made[12] + made[3] * made[13];
}

/* Factors (42) of the minors of matrices U in the coefficients of det(U + t*D), from the minors of D: the determinant of
   a sum is the sum over all choices of rows and columns of minors of one times complementary minors of the other. */
static void factors(const real *of, long lane, double *made)
{
    for (long e = 0; e < 10; e++) {
        const double twice = e == 0 || e == 4 || e == 7 || e == 9 ? 1 : 2;
        made[e] = twice * of[10 + e][lane], made[10 + e] = twice * of[e][lane];
    }
    for (long i = 0; i < 6; i++)
        for (long j = i; j < 6; j++) {
            const double sign = (PAIR[i][0] + PAIR[i][1] + PAIR[j][0] + PAIR[j][1]) % 2 ? -1 : 1;
            made[20 + MINOR[5 - i][5 - j]] = (i == j ? 1 : 2) * sign * of[20 + MINOR[i][j]][lane];
        }
    made[41] = of[41][lane];
}

/* Queue the polynomials of matrices 1 + t*X that are not positive definite at the ends of their chords, of which a to e
   are the coefficients of the determinant: they are where all elementary symmetric functions of their eigenvalues are
   positive. */
static void put(queue *in, real a, real b, real c, real e, double *end)
{
    const real x = *(const real *)end, p = x * a, q = x * x * b, r = x * x * x * c, s = x * x * x * x * e;
    const whole hold = (4 + p > 0) & (6 + 3 * p + q > 0) & (4 + 3 * p + 2 * q + r > 0) & (1 + p + q + r + s > 0);
    long all = -1;
    for (long k = 0; k < TILE; k++) all &= hold[k];
    if (all) return;
    if (in->count > QUEUE - TILE) nearest_roots(in);
    for (long k = 0; k < TILE; k++) {
        const long at = in->count;
        in->a[at] = a[k], in->b[at] = b[k], in->c[at] = c[k], in->d[at] = e[k], in->end[at] = end + k;
        in->count += !hold[k];
    }
}

/* Bring ends nearer to where values that fall by 1/`times` a step are zero. */
static void nearer(const double *restrict value, double times, double *restrict end)
{
    for (long k = 0; k < TILE; k++) {
        const double t = value[k] * times;
        end[k] = t < end[k] ? t : end[k];
    }
}

/* Distances (sums, samples) to both ends of the chords through samples.

   slack (10*matrices + single, samples): first entries of all matrices, second ones, ..., then single conditions.
   along (sums, 10*matrices + single): what a step of length 1 changes them by.
   work: MINORS*matrices*(sums + TILE) + 10*matrices numbers. */
static void chords(long samples, long matrices, long single, long sums, const double *slack, const double *along,
                   double *work, double *back, double *forth)
{
    const long rows = 10 * matrices + single;
    real *const own = (real *)work, u[10], all[MINORS];
    double *const changed = work + MINORS * matrices * TILE, *const typical = changed + MINORS * matrices * sums;
    for (long i = 0; i < matrices; i++) {
        double mean[10] = {0};
        for (long e = 0; e < 10; e++)
            for (long k = 0; k < samples; k++) mean[e] += slack[(e * matrices + i) * samples + k] / samples;
        inverse(mean, typical + 10 * i);
        for (long n = 0; n < sums; n += TILE) {
            for (long e = 0; e < 10; e++)
                for (long k = 0; k < TILE; k++) u[e][k] = n + k < sums ? along[(n + k) * rows + e * matrices + i] : 0;
            minors(typical + 10 * i, u, all);
            for (long k = 0; k < TILE && n + k < sums; k++) factors(all, k, changed + MINORS * ((n + k) * matrices + i));
        }
    }
    queue waiting = {0};
    for (long first = 0; first < samples; first += TILE) {
        for (long i = 0; i < matrices; i++) {
            for (long e = 0; e < 10; e++) u[e] = *(const real *)(slack + (e * matrices + i) * samples + first);
            minors(typical + 10 * i, u, own + MINORS * i);
            own[MINORS * i + 41] = 1 / own[MINORS * i + 41];
        }
        for (long n = 0; n < sums; n++) {
            const double *by = along + n * rows;
            double *less = back + n * samples + first, *more = forth + n * samples + first;
            for (long k = 0; k < TILE; k++) less[k] = more[k] = FAR;
            for (long i = 10 * matrices; i < rows; i++)
                if (by[i] > 0)
                    nearer(slack + i * samples + first, 1 / by[i], less);
                else if (by[i] < 0)
                    nearer(slack + i * samples + first, -1 / by[i], more);
            for (long i = 0; i < matrices; i++) {
                const real *of = own + MINORS * i;
                const double *d = changed + MINORS * (n * matrices + i);
                real a = {0}, b[3] = {{0}}, c = {0};  /* three sums, since each waits for itself */
                for (long e = 0; e < 10; e++) a += d[10 + e] * of[10 + e], c += d[e] * of[e];
                for (long e = 20; e < 41; e += 3)
                    for (long part = 0; part < 3; part++) b[part] += d[e + part] * of[e + part];
                a *= of[41], c *= of[41];
                const real second = (b[0] + b[1] + b[2]) * of[41], last = d[41] * of[41];
                put(&waiting, a, second, c, last, more);
                put(&waiting, -a, second, -c, last, less);
            }
        }
    }
    nearest_roots(&waiting);
}

/* Density and distribution function of the standard normal distribution. */
static void normal(const double *x, double *density, double *below)
{
    real size;
    for (long k = 0; k < TILE; k++) size[k] = fabs(x[k]) < 37 ? fabs(x[k]) : 37;  /* where the tail is 1e-300 */
    const real power = -0.5 * size * size, times = power * 1.4426950408889634 + ROUND, rest = times - ROUND;
    const real u = power - rest * 0.693147180369123816490 - rest * 1.90821492927058770002e-10;
    real made = {0}, first = {0}, second = {0};
    for (long j = sizeof EXP / sizeof *EXP - 1; j >= 0; j--) made = made * u + EXP[j];
    made = (real)((whole)made + ((whole)times << 52));
    const real z = size * M_SQRT1_2, t = (z - 3.75) / (z + 3.75);
    for (long j = sizeof ERFC / sizeof *ERFC - 1; j > 0; j--) {
        const real next = 2 * t * first - second + ERFC[j];
        second = first, first = next;
    }
    const real tail = 0.5 * made * (t * first - second + ERFC[0]) / (1 + 2 * z);
    for (long k = 0; k < TILE; k++) density[k] = 0.3989422804014327 * made[k], below[k] = x[k] < 0 ? tail[k] : 1 - tail[k];
}

/* Mean over the samples of the distribution function at x. */
static double distribution(long samples, const double *from, const double *weight, double x)
{
    double at = 0.5 * erfc(-x * M_SQRT1_2), sum[TILE] = {0}, total = 0;
    for (long i = 0; i < samples; i += TILE)
        for (long k = 0; k < TILE; k++) {
            double part = (at - from[i + k]) * weight[i + k];
            part = part < 1 ? part : 1;
            sum[k] += part > 0 ? part : 0;
        }
    for (long k = 0; k < TILE; k++) total += sum[k];
    return total / samples;
}

/* Where that is as wanted, between two places: halves until it is nearly straight, then false positions. */
static double quantile(long samples, const double *from, const double *weight, double wanted, double less, double more)
{
    double below = -wanted, above = 1 - wanted, x = less;
    for (long n = 0, side = 0; n < 60 && more - less > 1e-9; n++) {
        x = more - less > 0.5 ? (less + more) / 2 : less + (more - less) * below / (below - above);
        double found = distribution(samples, from, weight, x) - wanted;
        if (fabs(found) < 1e-13) return x;
        if (found < 0) {
            less = x, below = found, above *= side < 0 ? 0.5 : 1, side = -1;
        } else {
            more = x, above = found, below *= side > 0 ? 0.5 : 1, side = 1;
        }
    }
    return x;
}

/* Mean, mean square and quantiles (4 numbers a sum) of sums whose values at the samples are at (sums, samples).

   The number of samples is a multiple of TILE; tail is the probability beyond each quantile; work holds
   2*sums*samples + MINORS*matrices*(sums + TILE) + 10*matrices numbers. */
void marginals(long samples, long matrices, long single, long sums, double tail, const double *slack,
               const double *along, const double *at, double *work, double *found)
{
    double *back = work, *forth = back + sums * samples;
    chords(samples, matrices, single, sums, slack, along, forth + sums * samples, back, forth);
    for (long n = 0; n < sums; n++) {
        const double *t = at + n * samples;
        double *from = back + n * samples, *weight = forth + n * samples, *made = found + 4 * n;
        double centre = 0, low = INFINITY, high = -INFINITY, mean = 0, square = 0;
        for (long i = 0; i < samples; i++) centre += t[i];
        double sign = centre > 0 ? -1 : 1;  /* the tail at hand is that of small numbers, which are exact */
        for (long first = 0; first < samples; first += TILE) {
            double a[TILE], b[TILE], c[TILE], d[TILE], begin[TILE], end[TILE];
            for (long k = 0; k < TILE; k++) {
                double less = from[first + k], more = weight[first + k], here = sign * t[first + k];
                a[k] = here - (sign > 0 ? less : more), b[k] = here + (sign > 0 ? more : less);
            }
            normal(a, c, begin), normal(b, d, end);
            for (long k = 0; k < TILE; k++) {
                double width = end[k] - begin[k], middle = (a[k] + b[k]) / 2, size = b[k] - a[k];
                long wide = (size > NARROW) & (width > 0);
                mean += wide ? (c[k] - d[k]) / width : middle;
                square += wide ? 1 + (a[k] * c[k] - b[k] * d[k]) / width : middle * middle + size * size / 12;
                from[first + k] = begin[k], weight[first + k] = width > 0 ? 1 / width : 1e300;
                low = a[k] < low ? a[k] : low, high = b[k] > high ? b[k] : high;
            }
        }
        made[0] = sign * mean / samples, made[1] = square / samples;
        for (long q = 0; q < 2; q++)
            made[2 + (sign > 0 ? q : 1 - q)] = sign * quantile(samples, from, weight, q ? 1 - tail : tail,
                                                               low > -FAR ? low : -FAR, high < FAR ? high : FAR);
    }
}
