/* R of a QR of many rows: as many of them as the second cache holds at a time are reflected into the triangle of all
   before, PANEL reflections together (Schreiber and Van Loan 1989). */
#include <math.h>
#include <string.h>
#if defined(__AVX512F__)
#define LANES 8
#elif defined(__AVX__)
#define LANES 4
#else
#define LANES 2
#endif
#if defined(__AVX512F__)
#define HOLD(x) __asm__("" : "+v"(x))
#elif defined(__AVX__)
#define HOLD(x) __asm__("" : "+x"(x))
#else
#define HOLD(x)
#endif
/* HOLD(x) keeps x in a register: gcc would read it again from memory for each product. */
#ifdef __has_builtin
#if __has_builtin(__builtin_shufflevector)
#define PICK(a, b, ...) __builtin_shufflevector(a, b, __VA_ARGS__)
#endif
#endif
#if LANES == 8
#define EVEN 0, 8, 2, 10, 4, 12, 6, 14
#define ODD 1, 9, 3, 11, 5, 13, 7, 15
#elif LANES == 4
#define EVEN 0, 4, 2, 6
#define ODD 1, 5, 3, 7
#else
#define EVEN 0, 2
#define ODD 1, 3
#endif
#define PANEL 4
#define ROWS 376 /* at a time, an odd number of cache lines: powers of two would share few places in the caches */
#define TRIANGLE (-1)
typedef double real __attribute__((vector_size(8 * LANES), may_alias));
typedef double four __attribute__((vector_size(8 * PANEL), aligned(8), may_alias));

/* Sums of PANEL vectors. */
static inline four sums(const real *a)
{
#ifdef PICK
    real x = PICK(a[0], a[1], EVEN) + PICK(a[0], a[1], ODD), y = PICK(a[2], a[3], EVEN) + PICK(a[2], a[3], ODD);
#if LANES == 8
    const four u = PICK(x, x, 0, 1, 2, 3) + PICK(x, x, 4, 5, 6, 7), v = PICK(y, y, 0, 1, 2, 3) + PICK(y, y, 4, 5, 6, 7);
    return PICK(u, v, 0, 1, 4, 5) + PICK(u, v, 2, 3, 6, 7);
#elif LANES == 4
    return PICK(x, y, 0, 1, 4, 5) + PICK(x, y, 2, 3, 6, 7);
#else
    return PICK(x, y, 0, 1, 2, 3);
#endif
#else
    four made = {0};
    for (int c = 0; c < PANEL; c++)
        for (int l = 0; l < LANES; l++) made[c] += a[c][l];
    return made;
#endif
}

/* Reflects `m` vectors of rows of each column, one column ROWS / LANES vectors after the other, into the triangle R,
   row by row; they are written over. */
static void reflected(long width, double *R, long m, real *columns)
{
    enum { NEXT = ROWS / LANES };
    for (long j = 0; j < width; j += PANEL) {
        real *v = columns + j * NEXT;
        double size[PANEL], scale[PANEL], product[PANEL][PANEL];
        real s[PANEL] = {0};
        for (long i = 0; i < m; i++)
            for (int q = 0; q < PANEL; q++) s[q] += v[i] * v[q * NEXT + i];
#pragma GCC unroll 4
        for (int p = 0; p < PANEL; p++) {
            double *row = R + (j + p) * width + j;
            const four with = sums(s);
            const double below = with[p], head = row[p];
            const double norm = head > 0 ? -sqrt(head * head + below) : sqrt(head * head + below);
            scale[p] = below != 0 ? 1 / (head - norm) : 0, size[p] = below != 0 ? (norm - head) / norm : 0;
            for (int q = 0; q < p; q++) product[q][p] = scale[q] * scale[p] * with[q];
            double w[PANEL] = {0};
            for (int q = p + 1; q < PANEL; q++) w[q] = size[p] * (row[q] + scale[p] * with[q]), row[q] -= w[q];
            if (below != 0) row[p] = norm;
            if (p + 1 == PANEL) break;
            for (int q = 0; q < PANEL; q++) w[q] *= scale[p], s[q] = (real){0};
            for (long i = 0; i < m; i++) {
                real a[PANEL];
                for (int q = 0; q < PANEL; q++) a[q] = v[q * NEXT + i];
                for (int q = p + 1; q < PANEL; q++) v[q * NEXT + i] = a[q] -= w[q] * a[p];
                for (int q = 0; q < PANEL; q++) s[q] += a[p + 1] * a[q];
            }
        }
        for (long l = j + PANEL; l < width; l += PANEL) {
            real *a = columns + l * NEXT, s[PANEL][PANEL] = {0};
            four y[PANEL];
            for (long i = 0; i < m; i++) {
                real b[PANEL];
                for (int c = 0; c < PANEL; c++) {
                    b[c] = a[c * NEXT + i];
                    HOLD(b[c]);
                }
                for (int p = 0; p < PANEL; p++) {
                    real w = v[p * NEXT + i];
                    HOLD(w);
                    for (int c = 0; c < PANEL; c++) s[p][c] += w * b[c];
                }
            }
            for (int p = 0; p < PANEL; p++) {
                four *at = (four *)(R + (j + p) * width + l);
                y[p] = *at + scale[p] * sums(s[p]);
                for (int q = 0; q < p; q++) y[p] -= product[q][p] * y[q];
                y[p] *= size[p], *at -= y[p];
            }
            for (int p = 0; p < PANEL; p++) y[p] *= scale[p];
            for (long i = 0; i < m; i++) {
                real left[PANEL];
                for (int c = 0; c < PANEL; c++) left[c] = a[c * NEXT + i];
                for (int p = 0; p < PANEL; p++) {
                    real w = v[p * NEXT + i];
                    HOLD(w);
                    for (int c = 0; c < PANEL; c++) left[c] -= y[p][c] * w;
                }
                for (int c = 0; c < PANEL; c++) a[c * NEXT + i] = left[c];
            }
        }
    }
}

/* Folds rows of `given` numbers, `across` from one to the next, of which `width`, a multiple of PANEL, is no less: those
   at `places`, or where there are none all, `down` numbers from one to the next, from edges[b] to edges[b + 1] into the
   b-th square. A square holds as many rows as are waiting there, or where that is TRIANGLE their triangle. `work`, on a
   multiple of 64 bytes, has room for `width` times ROWS numbers. */
#ifdef _WIN32
__declspec(dllexport)
#endif
void triangles(long width, long given, long bands, double *squares, long *waiting, const long *edges, const long *places,
               const double *x, long down, long across, double *work)
{
    memset(work, 0, sizeof(double) * width * ROWS);
    for (long b = 0; b < bands; b++, squares += width * width) {
        const long rows = edges[b + 1] - edges[b];
        if (waiting[b] != TRIANGLE && waiting[b] + rows > given) {
            const long m = (waiting[b] + LANES - 1) / LANES;
            for (long c = 0; c < given; c++)
                for (long i = 0; i < m * LANES; i++) work[c * ROWS + i] = i < waiting[b] ? squares[i * width + c] : 0;
            memset(squares, 0, sizeof(double) * width * width);
            if (m) reflected(width, squares, m, (real *)work);
            waiting[b] = TRIANGLE;
        }
        const long parts = (rows + ROWS - 1) / ROWS, each = parts ? ((rows + parts - 1) / parts + LANES - 1) / LANES * LANES : 1;
        for (long at = edges[b]; at < edges[b + 1]; at += each) {
            const long some = edges[b + 1] - at < each ? edges[b + 1] - at : each, m = (some + LANES - 1) / LANES;
            const int wait = waiting[b] != TRIANGLE;
            double *const into = wait ? squares + waiting[b] * width : work;
            const long next = wait ? width : 1, apart = wait ? 1 : ROWS;
            for (long c = 0; c < given; c++) {
                const double *from = x + c * across;
                double *to = into + c * apart;
                if (places) for (long i = 0; i < some; i++) to[i * next] = from[places[at + i] * down];
                else if (down == 1 && !wait) memcpy(to, from + at, sizeof(double) * some);
                else for (long i = 0; i < some; i++) to[i * next] = from[(at + i) * down];
                if (!wait) for (long i = some; i < m * LANES; i++) to[i] = 0;
            }
            if (wait) waiting[b] += some;
            else reflected(width, squares, m, (real *)work);
        }
    }
}
