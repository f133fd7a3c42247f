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
