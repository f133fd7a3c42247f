/* Marginal distributions of linear sums of standard normal coordinates that conditions cut off, from samples of them.

   Along one direction the conditional distribution of a sum, all else as in a sample, is a normal one between the ends
   of a chord. Its mean over the samples is the marginal distribution. */
#include <math.h>
#ifndef M_SQRT1_2
#define M_SQRT1_2 0.70710678118654752440
#endif
#define TILE 8
#define FAR 100.0
#define STEPS 30
#define NARROW 1e-4

/* The roots of 1 + a*t + b*t^2 + c*t^3 + d*t^4, of which all are real, that are nearest to zero on either side, where
   they are less than `more` and `less` from it: by Laguerre's steps, which do not pass a root. */
static void nearest_roots(const double *a, const double *b, const double *c, const double *d, double *less,
                          double *more)
{
    double t[2 * TILE] = {0}, most[2 * TILE], odd[2 * TILE], even[2 * TILE], third[2 * TILE], last[2 * TILE];
    for (long k = 0; k < TILE; k++) {
        most[k] = more[k], odd[k] = a[k], even[k] = b[k], third[k] = c[k], last[k] = d[k];
        most[TILE + k] = less[k], odd[TILE + k] = -a[k], even[TILE + k] = b[k], third[TILE + k] = -c[k];
        last[TILE + k] = d[k];
    }
    long moved = 1;
    for (long n = 0; n < STEPS && moved; n++) {
        moved = 0;
        for (long k = 0; k < 2 * TILE; k++) {
            double x = t[k], e = odd[k], f = even[k], g = third[k], h = last[k];
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
    for (long k = 0; k < TILE; k++) more[k] = t[k], less[k] = t[TILE + k];
}

/* Inverses (10) of the Cholesky factors of matrices given by their upper triangles (10), row by row. */
static void factors(long count, long samples, const double *slack, double *inverse)
{
    for (long k = 0; k < TILE; k++) {
        double u[10];
        for (long e = 0; e < 10; e++) u[e] = slack[e * count * samples + k];
        double l00 = sqrt(u[0]), l10 = u[1] / l00, l20 = u[2] / l00, l30 = u[3] / l00;
        double l11 = sqrt(u[4] - l10 * l10), l21 = (u[5] - l20 * l10) / l11, l31 = (u[6] - l30 * l10) / l11;
        double l22 = sqrt(u[7] - l20 * l20 - l21 * l21), l32 = (u[8] - l30 * l20 - l31 * l21) / l22;
        double l33 = sqrt(u[9] - l30 * l30 - l31 * l31 - l32 * l32);
        double m00 = 1 / l00, m11 = 1 / l11, m22 = 1 / l22, m33 = 1 / l33;
        double m10 = -l10 * m00 * m11, m21 = -l21 * m11 * m22, m32 = -l32 * m22 * m33;
        double m20 = -(l20 * m00 + l21 * m10) * m22, m31 = -(l31 * m11 + l32 * m21) * m33;
        double m30 = -(l30 * m00 + l31 * m10 + l32 * m20) * m33;
        const double made[10] = {m00, m10, m11, m20, m21, m22, m30, m31, m32, m33};
        for (long e = 0; e < 10; e++) inverse[e * TILE + k] = made[e];
    }
}

/* Coefficients of det(1 + t*M*D*M') for the lower triangles M (10, TILE) and the symmetric D (10). */
static void polynomial(const double *m, const double *d, double *a, double *b, double *c, double *e)
{
    for (long k = 0; k < TILE; k++) {
        double m00 = m[k], m10 = m[TILE + k], m11 = m[2 * TILE + k], m20 = m[3 * TILE + k], m21 = m[4 * TILE + k];
        double m22 = m[5 * TILE + k], m30 = m[6 * TILE + k], m31 = m[7 * TILE + k], m32 = m[8 * TILE + k];
        double m33 = m[9 * TILE + k];
        double x00 = m00 * d[0], x10 = m10 * d[0] + m11 * d[1], x11 = m10 * d[1] + m11 * d[4];
        double x20 = m20 * d[0] + m21 * d[1] + m22 * d[2], x21 = m20 * d[1] + m21 * d[4] + m22 * d[5];
        double x22 = m20 * d[2] + m21 * d[5] + m22 * d[7];
        double x30 = m30 * d[0] + m31 * d[1] + m32 * d[2] + m33 * d[3];
        double x31 = m30 * d[1] + m31 * d[4] + m32 * d[5] + m33 * d[6];
        double x32 = m30 * d[2] + m31 * d[5] + m32 * d[7] + m33 * d[8];
        double x33 = m30 * d[3] + m31 * d[6] + m32 * d[8] + m33 * d[9];
        double p = x00 * m00, q = x10 * m00, r = x20 * m00, s = x30 * m00;
        double t = x10 * m10 + x11 * m11, u = x20 * m10 + x21 * m11, v = x30 * m10 + x31 * m11;
        double w = x20 * m20 + x21 * m21 + x22 * m22, x = x30 * m20 + x31 * m21 + x32 * m22;
        double y = x30 * m30 + x31 * m31 + x32 * m32 + x33 * m33;
        double pt = p * t - q * q, pu = p * u - q * r, pv = p * v - q * s, qu = q * u - t * r, qv = q * v - t * s;
        double rv = r * v - u * s;  /* minors of the first two rows and columns */
        double wy = w * y - x * x;
        double first = p * wy - r * (r * y - s * x) + s * (r * x - s * w);
        double second = t * wy - u * (u * y - v * x) + v * (u * x - v * w);
        a[k] = p + t + w + y;
        b[k] = pt + (p * w - r * r) + (p * y - s * s) + (t * w - u * u) + (t * y - v * v) + wy;
        c[k] = (pt * w - pu * u + qu * r) + (pt * y - pv * v + qv * s) + first + second;
        e[k] = pt * wy - pu * (u * y - v * x) + pv * (u * x - v * w) + qu * (r * y - s * x) - qv * (r * x - s * w)
            + rv * rv;
    }
}

/* Whether all matrices u + sign*t*D are positive definite: then that end of their chords is farther than t. */
static long beyond(long apart, const double *u, const double *d, double sign, const double *t)
{
    long hold = 1;
    for (long k = 0; k < TILE; k++) {
        const double *at = u + k;
        double x = sign * t[k], m0 = at[0] + x * d[0], m1 = at[apart] + x * d[1], m2 = at[2 * apart] + x * d[2];
        double m3 = at[3 * apart] + x * d[3], a = 1 / m0, p = m1 * a, q = m2 * a;
        double e = at[4 * apart] + x * d[4] - m1 * p, f = at[5 * apart] + x * d[5] - m2 * p;
        double g = at[6 * apart] + x * d[6] - m3 * p, b = 1 / e, r = f * b;
        double h = at[7 * apart] + x * d[7] - m2 * q - f * r, i = at[8 * apart] + x * d[8] - m3 * q - g * r;
        double j = (at[9 * apart] + x * d[9] - m3 * m3 * a - g * g * b) * h - i * i;
        hold &= (m0 > 0) & (e > 0) & (h > 0) & (j > 0);
    }
    return hold;
}

/* Distances (sums, samples) to both ends of the chords through samples.

   slack (10*matrices + single, samples): first entries of all matrices, second ones, ..., then single conditions.
   along (sums, 10*matrices + single): what a step of length 1 changes them by. */
static void chords(long samples, long matrices, long single, long sums, const double *slack, const double *along,
                   double *inverse, double *back, double *forth)
{
    long rows = 10 * matrices + single;
    for (long first = 0; first < samples; first += TILE) {
        for (long i = 0; i < matrices; i++)
            factors(matrices, samples, slack + i * samples + first, inverse + 10 * TILE * i);
        for (long n = 0; n < sums; n++) {
            const double *by = along + n * rows;
            double *less = back + n * samples + first, *more = forth + n * samples + first;
            for (long k = 0; k < TILE; k++) less[k] = more[k] = FAR;
            for (long i = 10 * matrices; i < rows; i++) {
                const double *value = slack + i * samples + first;
                double *end = by[i] > 0 ? less : more, slope = fabs(by[i]);
                if (!(slope > 0)) continue;
                for (long k = 0; k < TILE; k++) {
                    double t = value[k] / slope;
                    end[k] = t < end[k] ? t : end[k];
                }
            }
            for (long i = 0; i < matrices; i++) {
                double d[10], a[TILE], b[TILE], c[TILE], e[TILE];
                for (long j = 0; j < 10; j++) d[j] = by[j * matrices + i];
                const double *u = slack + i * samples + first;
                if (beyond(matrices * samples, u, d, 1, more) && beyond(matrices * samples, u, d, -1, less)) continue;
                polynomial(inverse + 10 * TILE * i, d, a, b, c, e);
                nearest_roots(a, b, c, e, less, more);
            }
        }
    }
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

/* Mean, mean square and quantiles (4 numbers a sum) of sums whose values at the samples are at (sums, samples).

   The number of samples is a multiple of TILE; tail is the probability beyond each quantile; work holds
   2*sums*samples + 10*TILE*matrices numbers. */
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
        for (long i = 0; i < samples; i++) {
            double a = sign > 0 ? t[i] - from[i] : -t[i] - weight[i], b = sign > 0 ? t[i] + weight[i] : from[i] - t[i];
            double begin = 0.5 * erfc(-a * M_SQRT1_2), width = 0.5 * erfc(-b * M_SQRT1_2) - begin;
            if (b - a > NARROW && width > 0) {
                double c = 0.3989422804014327 * exp(-a * a / 2) / width, d = 0.3989422804014327 * exp(-b * b / 2) / width;
                mean += c - d, square += 1 + a * c - b * d;
            } else {
                double middle = (a + b) / 2;
                mean += middle, square += middle * middle + (b - a) * (b - a) / 12;
            }
            from[i] = begin, weight[i] = width > 0 ? 1 / width : 1e300;
            low = a < low ? a : low, high = b > high ? b : high;
        }
        made[0] = sign * mean / samples, made[1] = square / samples;
        for (long q = 0; q < 2; q++) {
            double wanted = q ? 1 - tail : tail, less = low > -FAR ? low : -FAR, more = high < FAR ? high : FAR;
            for (long i = 0; i < 50 && more - less > 1e-9; i++) {
                double x = (less + more) / 2;
                *(distribution(samples, from, weight, x) < wanted ? &less : &more) = x;
            }
            made[2 + (sign > 0 ? q : 1 - q)] = sign * (less + more) / 2;
        }
    }
}
