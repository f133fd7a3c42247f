/* Which joints move, are calm or at rest in each sample: windows run along the times, so that each is looked at once. */
#include <math.h>
#define PARTS 4

/* The first sample from p on at or after a time. */
static inline long advanced(long p, long rows, const double *t, double wanted)
{
    while (p < rows && t[p] < wanted) p++;
    return p;
}

/* Parts of the window about each sample at t, not decreasing, begin at t + shift[0], ..., the last one ends before
   t + shift[PARTS]. Column j of `angles` and `speeds` begins `across` numbers behind the one before, and samples are
   `down` numbers apart. `sums` are those of the angles less their mean before each sample, `rows` + 1 for each joint.
   A joint is at rest where means over the parts differ by at most apart[j] times the square root of 2 over the fewest
   samples of a part, or by `least`; it moves if it is faster than slow[j] and not at rest; it is calm where it moves in
   no sample of the window. The marks of one joint stand `rows` behind those of the one before. */
#ifdef _WIN32
__declspec(dllexport)
#endif
void phases(long rows, const double *t, const double *shift, long joints, const double *angles, long down, long across,
            const double *speeds, long speeds_down, long speeds_across, const double *slow, const double *apart,
            double least, double *sums, char *moving, char *calm, char *rest)
{
    for (long j = 0; j < joints; j++) {
        const double *given = angles + j * across;
        double sum = 0, *own = sums + j * (rows + 1);
        for (long i = 0; i < rows; i++) sum += given[i * down];
        const double mean = sum / rows;
        sum = 0;
        for (long i = 0; i < rows; i++) own[i] = sum, sum += given[i * down] - mean;
        own[rows] = sum;
    }
    long at[PARTS + 1] = {0}, many[PARTS] = {-1}, fewest = 0;
    double share[PARTS], spread = 0;
    for (long i = 0; i < rows; i++) {
        int same = 1;
        for (int k = 0; k <= PARTS; k++) at[k] = advanced(at[k], rows, t, t[i] + shift[k]);
        for (int k = 0; k < PARTS; k++) same &= at[k + 1] - at[k] == many[k];
        if (!same) {
            fewest = rows;
            for (int k = 0; k < PARTS; k++) {
                many[k] = at[k + 1] - at[k], share[k] = 1.0 / many[k];
                if (many[k] && many[k] < fewest) fewest = many[k];
            }
            spread = sqrt(2.0 / fewest);
        }
        for (long j = 0; j < joints; j++) {
            const double *own = sums + j * (rows + 1), most = apart[j] * spread;
            double low = INFINITY, high = -INFINITY;
            for (int k = 0; k < PARTS; k++) {
                const double one = (own[at[k + 1]] - own[at[k]]) * share[k];
                low = one < low ? one : low, high = one > high ? one : high; /* a part without samples is no number */
            }
            rest[j * rows + i] = high - low <= (most > least ? most : least);
            moving[j * rows + i] = fabs(speeds[i * speeds_down + j * speeds_across]) > slow[j] && !rest[j * rows + i];
        }
    }
    for (long j = 0; j < joints; j++) {
        const char *own = moving + j * rows;
        long begin = 0, end = 0, fast = 0;
        for (long i = 0; i < rows; i++) {
            for (; end < rows && t[end] < t[i] + shift[PARTS]; end++) fast += own[end];
            for (; begin < rows && t[begin] < t[i] + shift[0]; begin++) fast -= own[begin];
            calm[j * rows + i] = !fast;
        }
    }
}
