
/* Evaluates n samples, STEP at a time, and keeps the results of the last `kept`: it is not the memory that is timed. */
void run(long n, long kept, const double *q, const double *qd, const double *qdd, double *out)
{
    BEFORE
    for (long s = 0, at = 0; s < n; s += STEP, at = at + STEP < kept ? at + STEP : 0) {
        const double *in[] = {q + JOINTS * s, qd + JOINTS * s, qdd + JOINTS * s};
        double *into[] = {out + SIZE * at};
        CALL
    }
}
