/* What numpy can only do in several passes, or not for half a matrix: see kernels.h, and native/__init__.py,
which loads this where it was built. Without it the same is done in numpy. */

#include <math.h>
#include <string.h>

enum { LANES = 16, MOST_ELEMENTS = 64, MOST_VECTORS = MOST_ELEMENTS / LANES, WIDE = 8 };

typedef float Reals __attribute__((vector_size(4 * LANES)));
typedef int Places __attribute__((vector_size(4 * LANES)));
typedef double Doubles __attribute__((vector_size(8 * WIDE)));

static const Places EVEN = {0, 2, 4, 6, 8, 10, 12, 14, 16, 18, 20, 22, 24, 26, 28, 30};
static const Places ODD = {1, 3, 5, 7, 9, 11, 13, 15, 17, 19, 21, 23, 25, 27, 29, 31};
static const Places FIRST = {0, 16, 1, 17, 2, 18, 3, 19, 4, 20, 5, 21, 6, 22, 7, 23};
static const Places SECOND = {8, 24, 9, 25, 10, 26, 11, 27, 12, 28, 13, 29, 14, 30, 15, 31};

/* How two rows, and two blocks within them, change places: of blocks of 8 x 8, 4 x 4, 2 x 2 and 1. */
static const Places UPPER[] = {
    {0, 1, 2, 3, 4, 5, 6, 7, 16, 17, 18, 19, 20, 21, 22, 23},
    {0, 1, 2, 3, 16, 17, 18, 19, 8, 9, 10, 11, 24, 25, 26, 27},
    {0, 1, 16, 17, 4, 5, 20, 21, 8, 9, 24, 25, 12, 13, 28, 29},
    {0, 16, 2, 18, 4, 20, 6, 22, 8, 24, 10, 26, 12, 28, 14, 30},
};
static const Places LOWER[] = {
    {8, 9, 10, 11, 12, 13, 14, 15, 24, 25, 26, 27, 28, 29, 30, 31},
    {4, 5, 6, 7, 20, 21, 22, 23, 12, 13, 14, 15, 28, 29, 30, 31},
    {2, 3, 18, 19, 6, 7, 22, 23, 10, 11, 26, 27, 14, 15, 30, 31},
    {1, 17, 3, 19, 5, 21, 7, 23, 9, 25, 11, 27, 13, 29, 15, 31},
};

static inline long least(long count)
{
    return count < LANES ? count : LANES;
}

#define TARGET __attribute__((target("avx512f,avx512vl,avx512dq,avx512bw,fma")))
#define NAME(f) f##_avx512
#include "kernels.h"
#undef TARGET
#undef NAME

#define TARGET __attribute__((target("avx2,fma")))
#define NAME(f) f##_avx2
#include "kernels.h"

/* Which set of instructions this machine has: 0 where numpy is the better choice. */
int chachart_level(void)
{
    __builtin_cpu_init();
    if (__builtin_cpu_supports("avx512f") && __builtin_cpu_supports("avx512vl") &&
        __builtin_cpu_supports("avx512dq") && __builtin_cpu_supports("avx512bw") && __builtin_cpu_supports("fma"))
        return 2;
    return __builtin_cpu_supports("avx2") && __builtin_cpu_supports("fma");
}

void chachart_lag_sums(const float *x, long count, long elements, long snapshots, long by_frame, long by_element,
                       long by_snapshot, float *lags)
{
    (chachart_level() == 2 ? lag_sums_avx512 : lag_sums_avx2)(x, count, elements, snapshots, by_frame, by_element,
                                                              by_snapshot, lags);
}

void chachart_covariances(const float *x, long count, long elements, long snapshots, long by_frame,
                          long by_element, long by_snapshot, float *out)
{
    (chachart_level() == 2 ? covariances_avx512 : covariances_avx2)(x, count, elements, snapshots, by_frame,
                                                                    by_element, by_snapshot, out);
}

void chachart_inverse_cholesky(const float *r, long count, long n, float *out)
{
    (chachart_level() == 2 ? inverse_cholesky_avx512 : inverse_cholesky_avx2)(r, count, n, out);
}

void chachart_extremum(const float *values, const float *c, long count, long points, long lags, const double *grid,
                       const long *before, const long *after, const double *low, const double *high, long largest,
                       long steps, double converged, double *found, double *height)
{
    (chachart_level() == 2 ? extremum_avx512 : extremum_avx2)(values, c, count, points, lags, grid, before, after,
                                                              low, high, largest, steps, converged, found, height);
}
