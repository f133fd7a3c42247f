/* Rows of WIDTH numbers v, that of sample i from column first[i] on, which does not decrease: splines at times in order.
   What a column sums up is complete once a row begins behind it. */
#define WIDTH 6
#ifdef _WIN32
#define EXPORT __declspec(dllexport)
#else
#define EXPORT
#endif

/* Products of columns with themselves and the next ones, WIDTH for each of them, from zeros. */
EXPORT void gram(long rows, const double *v, const int *first, double *made)
{
    double sum[WIDTH + 1][WIDTH] = {0};
    long at = rows ? first[0] : 0;
    for (long i = 0; i <= rows; i++, v += WIDTH) {
        for (const long end = i < rows ? first[i] : at + WIDTH; at < end; at++) {
            for (int b = 0; b < WIDTH; b++) made[at * WIDTH + b] = sum[0][b];
            for (int a = 0; a < WIDTH; a++)
                for (int b = 0; b < WIDTH - a; b++) sum[a][b] = sum[a + 1][b];
        }
        if (i < rows)
            for (int a = 0; a < WIDTH; a++)
                for (int b = 0; b < WIDTH - a; b++) sum[a][b] += v[a] * v[a + b];
    }
}

/* Products of columns with samples x, from zeros. */
EXPORT void gathered(long rows, const double *v, const int *first, const double *x, double *made)
{
    double sum[WIDTH + 1] = {0};
    long at = rows ? first[0] : 0;
    for (long i = 0; i <= rows; i++, v += WIDTH) {
        for (const long end = i < rows ? first[i] : at + WIDTH; at < end; at++) {
            made[at] = sum[0];
            for (int a = 0; a < WIDTH; a++) sum[a] = sum[a + 1];
        }
        if (i < rows)
            for (int a = 0; a < WIDTH; a++) sum[a] += v[a] * x[i];
    }
}

/* Products of rows with coefficients c of the columns. */
EXPORT void product(long rows, const double *v, const int *first, const double *c, double *made)
{
    for (long i = 0; i < rows; i++, v += WIDTH) {
        const double *own = c + first[i];
        made[i] = v[0] * own[0] + v[1] * own[1] + v[2] * own[2] + (v[3] * own[3] + v[4] * own[4] + v[5] * own[5]);
    }
}

/* The rows of splines at the places x, of which cell[i] is the whole part: sums of u^k·powers[k][a] over `count` powers of
   the place u in it. */
EXPORT void weights(long rows, const double *x, const int *cell, long count, const double *powers, double *made)
{
    typedef double wide __attribute__((vector_size(64), aligned(8), may_alias)); /* WIDTH numbers and two that are lost */
    wide p[WIDTH] = {0};
    for (long k = 0; k < count; k++)
        for (int a = 0; a < WIDTH; a++) p[k][a] = powers[k * WIDTH + a];
    for (long i = 0; i < rows; i++, made += WIDTH) {
        const double u = x[i] - cell[i];
        double power = 1;
        wide v = p[0];
        for (long k = 1; k < count; k++) power *= u, v += power * p[k];
        if (i + 1 < rows) *(wide *)made = v;
        else for (int a = 0; a < WIDTH; a++) made[a] = v[a];
    }
}

/* As many systems as a vector has lanes, side by side. */
#define LANES 4
typedef double real __attribute__((vector_size(8 * LANES), aligned(8), may_alias));

static inline real root(real a)
{
    for (int l = 0; l < LANES; l++) a[l] = sqrt(a[l]);
    return a;
}

/* L of L·Lᵀ = G + weight·P, of each of the weights. G and P hold the diagonal and the numbers below it column by column,
   WIDTH for each; so does L, with the diagonal's inverse, after WIDTH columns of zeros. */
EXPORT void factors(long columns, const double *G, const double *P, const real *weight, real *L)
{
    real *own = L + WIDTH * WIDTH;
    for (long j = 0; j < columns; j++, own += WIDTH, G += WIDTH, P += WIDTH) {
        for (int b = 0; b < WIDTH; b++) own[b] = G[b] + *weight * P[b];
        for (int a = WIDTH - 1; a > 0; a--)
            for (int b = 0; a + b < WIDTH; b++) own[b] -= own[a - a * WIDTH] * own[a + b - a * WIDTH];
        own[0] = 1 / root(own[0]);
        for (int b = 1; b < WIDTH; b++) own[b] *= own[0];
    }
}

/* x of L·Lᵀ·x = x in place, between WIDTH zeros before and behind. */
EXPORT void solved(long columns, const real *L, real *x)
{
    const real *own = L + WIDTH * WIDTH;
    x += WIDTH;
    for (long j = 0; j < columns; j++, own += WIDTH) {
        real y = x[j];
        for (int a = WIDTH - 1; a > 0; a--) y -= own[a - a * WIDTH] * x[j - a];
        x[j] = y * own[0];
    }
    for (long j = columns - 1; j >= 0; j--) {
        own -= WIDTH;
        real y = x[j];
        for (int a = WIDTH - 1; a > 0; a--) y -= own[a] * x[j + a];
        x[j] = y * own[0];
    }
}

/* Value and first two derivatives of a curve at the places x, of which cell[i] is the whole part, `step` numbers from one
   sample to the next and `apart` from one derivative to the next. In a cell the curve is the sum of u^k·powers[k][a]·c[a]
   over WIDTH powers of the place u in it and as many coefficients from that of the cell on; the derivatives are times
   `scale` and its square. */
EXPORT void curve(long rows, const double *x, const int *cell, const double *powers, const double *c, double scale,
                  double *made, long step, long apart)
{
    double p[WIDTH];
    for (long i = 0; i < rows; i++, made += step) {
        if (!i || cell[i] != cell[i - 1])
            for (int k = 0; k < WIDTH; k++) {
                p[k] = 0;
                for (int a = 0; a < WIDTH; a++) p[k] += powers[k * WIDTH + a] * c[cell[i] + a];
            }
        const double u = x[i] - cell[i];
        double value = 0, first = 0, second = 0;
        for (int k = WIDTH - 1; k >= 0; k--) {
            value = value * u + p[k];
            if (k > 0) first = first * u + k * p[k];
            if (k > 1) second = second * u + k * (k - 1) * p[k];
        }
        made[0] = value, made[apart] = scale * first, made[2 * apart] = scale * scale * second;
    }
}
