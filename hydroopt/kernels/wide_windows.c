/* Rows of `width` numbers v, that of sample i from column first[i] on, and lower triangles whose diagonal and numbers
   below it stand column by column, `width` for each. */
#ifdef _WIN32
#define EXPORT __declspec(dllexport)
#else
#define EXPORT
#endif

/* Products of columns with themselves and the next ones, `width` for each of them, added to what is there. */
EXPORT void gram(long rows, long width, const double *v, const long *first, double *restrict made)
{
    for (long i = 0; i < rows; i++, v += width)
        for (long a = 0; a < width; a++) {
            double *own = made + (first[i] + a) * width;
            for (long b = 0; b < width - a; b++) own[b] += v[a] * v[a + b];
        }
}

/* Products of columns with samples x (rows, count), added to what is there. */
EXPORT void gathered(long rows, long width, const double *v, const long *first, long count, const double *x,
                     double *restrict made)
{
    for (long i = 0; i < rows; i++, v += width, x += count)
        for (long a = 0; a < width; a++) {
            double *own = made + (first[i] + a) * count;
            for (long k = 0; k < count; k++) own[k] += v[a] * x[k];
        }
}

/* x (columns, count) of L*x = x in place. */
EXPORT void forward(long columns, long width, const double *L, long count, double *restrict x)
{
    for (long j = 0; j < columns; j++, L += width, x += count) {
        const double scale = 1 / L[0];
        for (long k = 0; k < count; k++) x[k] *= scale;
        for (long b = 1; b < width && j + b < columns; b++) {
            double *below = x + b * count;
            for (long k = 0; k < count; k++) below[k] -= L[b] * x[k];
        }
    }
}
