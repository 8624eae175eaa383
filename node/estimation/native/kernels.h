/* The kernels, once for each set of instructions: kernels.c includes this with NAME(f) and TARGET defined.

Snapshots are complex64 of any strides, given in complex numbers; results are dense. Vectors hold LANES numbers,
whatever the machine's own registers hold. Every frame is worked out by itself, so that results do not depend
on the frames beside it. */

/* Real and imaginary parts of so many complex numbers that follow each other, zeros behind the last one. */
TARGET static inline void NAME(split)(const float *x, long count, Reals *re, Reals *im)
{
    float few[2 * LANES] = {0};
    Reals first, second;
    if (count < LANES)
        x = memcpy(few, x, 2 * count * sizeof *x);
    memcpy(&first, x, sizeof first);
    memcpy(&second, x + LANES, sizeof second);
    *re = __builtin_shuffle(first, second, EVEN);
    *im = __builtin_shuffle(first, second, ODD);
}

TARGET static inline void NAME(transpose)(Reals *x)
{
    for (int step = 0, width = LANES / 2; width; step++, width /= 2)
        for (int i = 0; i < LANES; i++)
            if (!(i & width)) {
                const Reals above = x[i], below = x[i + width];
                x[i] = __builtin_shuffle(above, below, UPPER[step]);
                x[i + width] = __builtin_shuffle(above, below, LOWER[step]);
            }
}

/* A block of up to LANES rows of up to LANES complex numbers each, with zeros around. */
TARGET static inline void NAME(block)(const float *x, long rows, long columns, long by_row, long by_column,
                                      Reals *re, Reals *im)
{
    const int across = by_column != 1;
    if (across) {
        long swap = rows;
        rows = columns, columns = swap;
        swap = by_row, by_row = by_column, by_column = swap;
    }
    for (long i = 0; i < LANES; i++)
        NAME(split)(x + 2 * (i < rows ? i : 0) * by_row, i < rows ? columns : 0, &re[i], &im[i]);
    if (across) {
        NAME(transpose)(re);
        NAME(transpose)(im);
    }
}

/* The sum of all lanes, as sums of halves. */
#define FOLD(v, ...) ((v) + __builtin_shuffle((v), (Places){__VA_ARGS__}))
TARGET static inline float NAME(sum)(const Reals *v)
{
    const Reals eight = FOLD(*v, 8, 9, 10, 11, 12, 13, 14, 15, 0, 1, 2, 3, 4, 5, 6, 7);
    const Reals four = FOLD(eight, 4, 5, 6, 7, 0, 1, 2, 3, 12, 13, 14, 15, 8, 9, 10, 11);
    const Reals two = FOLD(four, 2, 3, 0, 1, 6, 7, 4, 5, 10, 11, 8, 9, 14, 15, 12, 13);
    return two[0] + two[1];
}

/* Lag polynomials (count, elements) of X X^H: c_k = sum_i sum_s x_is conj(x_(i+k)s), twice that for k > 0. */
TARGET static void NAME(lag_sums)(const float *x, long count, long elements, long snapshots, long by_frame,
                                  long by_element, long by_snapshot, float *lags)
{
    enum { AT_ONCE = 4 };
    Reals x_re[MOST_ELEMENTS], x_im[MOST_ELEMENTS];
    Reals re[MOST_ELEMENTS + AT_ONCE], im[MOST_ELEMENTS + AT_ONCE];
    for (long f = 0; f < count; f++, x += 2 * by_frame, lags += 2 * elements) {
        memset(re, 0, sizeof re);
        memset(im, 0, sizeof im);
        for (long first = 0; first < snapshots; first += LANES) {
            for (long i = 0; i < elements; i += LANES)
                NAME(block)(x + 2 * (i * by_element + first * by_snapshot), least(elements - i),
                            least(snapshots - first), by_element, by_snapshot, &x_re[i], &x_im[i]);
            for (long k = 0; k < elements; k += AT_ONCE) {
                Reals a[AT_ONCE] = {{0}}, b[AT_ONCE] = {{0}};
                long i = 0;
                for (; i + k + AT_ONCE <= elements; i++) {
                    const Reals xr = x_re[i], xi = x_im[i];
                    for (int l = 0; l < AT_ONCE; l++) {
                        const Reals yr = x_re[i + k + l], yi = x_im[i + k + l];
                        a[l] += xr * yr;
                        b[l] += xi * yr;
                        a[l] += xi * yi;
                        b[l] -= xr * yi;
                    }
                }
                for (; i + k < elements; i++)
                    for (int l = 0; i + k + l < elements; l++) {
                        a[l] += x_re[i] * x_re[i + k + l] + x_im[i] * x_im[i + k + l];
                        b[l] += x_im[i] * x_re[i + k + l] - x_re[i] * x_im[i + k + l];
                    }
                for (int l = 0; l < AT_ONCE; l++) {
                    re[k + l] += a[l];
                    im[k + l] += b[l];
                }
            }
        }
        for (long k = 0; k < elements; k++) {
            const float times = k ? 2 : 1;
            lags[2 * k] = times * NAME(sum)(&re[k]);
            lags[2 * k + 1] = k ? times * NAME(sum)(&im[k]) : 0;
        }
    }
}

/* The reverse of `split`. */
TARGET static inline void NAME(join)(const Reals *re, const Reals *im, long count, float *x)
{
    const Reals both[] = {__builtin_shuffle(*re, *im, FIRST), __builtin_shuffle(*re, *im, SECOND)};
    memcpy(x, both, count == LANES ? sizeof both : 2 * count * sizeof *x);
}

/* Covariances (count, elements, elements): X X^H. */
TARGET static void NAME(covariances)(const float *x, long count, long elements, long snapshots, long by_frame,
                                     long by_element, long by_snapshot, float *out)
{
    enum { AT_ONCE = 4 };
    const long vectors = (elements + LANES - 1) / LANES;
    Reals x_re[MOST_VECTORS][LANES], x_im[MOST_VECTORS][LANES];
    Reals re[MOST_VECTORS][MOST_ELEMENTS], im[MOST_VECTORS][MOST_ELEMENTS];
    for (long f = 0; f < count; f++, x += 2 * by_frame, out += 2 * elements * elements) {
        for (long v = 0; v < vectors; v++) {
            memset(re[v], 0, (v + 1) * LANES * sizeof(Reals));
            memset(im[v], 0, (v + 1) * LANES * sizeof(Reals));
        }
        for (long first = 0; first < snapshots; first += LANES) {
            const long there = least(snapshots - first);
            for (long v = 0; v < vectors; v++)
                NAME(block)(x + 2 * (v * LANES * by_element + first * by_snapshot), there,
                            least(elements - v * LANES), by_snapshot, by_element, x_re[v], x_im[v]);
            for (long i = 0; i < elements; i += AT_ONCE)
                for (long v = i / LANES; v < vectors; v++) {
                    const float *row_re = (float *)x_re[i / LANES] + i % LANES;
                    const float *row_im = (float *)x_im[i / LANES] + i % LANES;
                    Reals a[AT_ONCE], b[AT_ONCE];
                    for (int l = 0; l < AT_ONCE; l++)
                        a[l] = re[v][i + l], b[l] = im[v][i + l];
                    for (long s = 0; s < there; s++) {
                        const Reals yr = x_re[v][s], yi = x_im[v][s];
                        for (int l = 0; l < AT_ONCE; l++) {
                            const float xr = row_re[s * LANES + l], xi = row_im[s * LANES + l];
                            a[l] += xr * yr;
                            b[l] += xi * yr;
                            a[l] += xi * yi;
                            b[l] -= xr * yi;
                        }
                    }
                    for (int l = 0; l < AT_ONCE; l++)
                        re[v][i + l] = a[l], im[v][i + l] = b[l];
                }
        }
        /* what is left of the diagonal's blocks mirrors what is right of them */
        for (long w = 0; w < vectors; w++)
            for (long v = w; v < vectors; v++) {
                const long rows = least(elements - w * LANES), columns = least(elements - v * LANES);
                Reals *from_re = &re[v][w * LANES], *from_im = &im[v][w * LANES];
                for (long i = 0; i < rows; i++)
                    NAME(join)(&from_re[i], &from_im[i], columns, out + 2 * ((w * LANES + i) * elements + v * LANES));
                if (v == w)
                    continue;
                NAME(transpose)(from_re);
                NAME(transpose)(from_im);
                for (long i = 0; i < columns; i++) {
                    const Reals mirrored = -from_im[i];
                    NAME(join)(&from_re[i], &mirrored, rows, out + 2 * ((v * LANES + i) * elements + w * LANES));
                }
            }
    }
}

/* L^-1 (count, n, n) where r (count, n, n) = L L^H; NaN for those that are not positive definite. */
TARGET static void NAME(inverse_cholesky)(const float *r, long count, long n, float *out)
{
    const long vectors = (n + LANES - 1) / LANES, width = vectors * LANES;
    Reals upper_re[MOST_ELEMENTS * MOST_VECTORS], upper_im[MOST_ELEMENTS * MOST_VECTORS];
    Reals w_re[MOST_ELEMENTS * MOST_VECTORS], w_im[MOST_ELEMENTS * MOST_VECTORS];
    const float *u_re = (float *)upper_re, *u_im = (float *)upper_im; /* U = L^H */
    for (long f = 0; f < count; f++, r += 2 * n * n, out += 2 * n * n) {
        long k = 0;
        for (long i = 0; i < n; i++)
            for (long v = i / LANES; v < vectors; v++)
                NAME(split)(r + 2 * (i * n + v * LANES), least(n - v * LANES), &upper_re[i * vectors + v],
                            &upper_im[i * vectors + v]);
        for (; k < n; k++) {
            const float pivot = u_re[k * width + k];
            if (!(pivot > 0))
                break;
            const float scale = 1 / sqrtf(pivot);
            const Reals *row_re = &upper_re[k * vectors], *row_im = &upper_im[k * vectors];
            for (long v = k / LANES; v < vectors; v++) {
                upper_re[k * vectors + v] *= scale;
                upper_im[k * vectors + v] *= scale;
            }
            for (long i = k + 1; i < n; i++) {
                const float ur = u_re[k * width + i], ui = u_im[k * width + i];
                for (long v = i / LANES; v < vectors; v++) {
                    Reals a = upper_re[i * vectors + v], b = upper_im[i * vectors + v];
                    a -= ur * row_re[v];
                    b -= ur * row_im[v];
                    a -= ui * row_im[v];
                    b += ui * row_re[v];
                    upper_re[i * vectors + v] = a;
                    upper_im[i * vectors + v] = b;
                }
            }
        }
        if (k < n) {
            for (long i = 0; i < 2 * n * n; i++)
                out[i] = NAN;
            continue;
        }
        memset(out, 0, 2 * n * n * sizeof *out);
        for (long i = 0; i < n; i++) {
            const float scale = 1 / u_re[i * width + i];
            for (long v = 0; v <= i / LANES; v++) {
                Reals a = {0}, b = {0}, c = {0}, d = {0};
                for (long j = v * LANES; j < i; j++) {
                    const float lr = u_re[j * width + i], li = u_im[j * width + i];
                    const Reals yr = w_re[j * vectors + v], yi = w_im[j * vectors + v];
                    a += lr * yr;
                    b += lr * yi;
                    c += li * yi;
                    d += li * yr;
                }
                /* L_ij = conj(U_ji) */
                w_re[i * vectors + v] = -(a + c) * scale;
                w_im[i * vectors + v] = (d - b) * scale;
                if (v == i / LANES)
                    ((float *)w_re)[i * width + i] = scale;
                NAME(join)(&w_re[i * vectors + v], &w_im[i * vectors + v], least(i + 1 - v * LANES),
                           out + 2 * (i * n + v * LANES));
            }
        }
    }
}

/* Where the polynomials c (count, lags) are least, or largest: see `Search.extremum`, which this follows step
for step. `values` (count, points) are those on `grid`; each of its points has its neighbours' numbers, and how
far left and right of it is searched. Single steps are worked out for WIDE polynomials at a time. */
TARGET static void NAME(extremum)(const float *values, const float *c, long count, long points, long lags,
                                  const double *grid, const long *before, const long *after, const double *low,
                                  const double *high, long largest, long steps, double converged, double *found,
                                  double *height)
{
    const double sign = largest ? -1 : 1;
    double c_re[MOST_ELEMENTS * WIDE], c_im[MOST_ELEMENTS * WIDE];
    for (long first = 0; first < count; first += WIDE) {
        double u[WIDE], left[WIDE], right[WIDE], cosine[WIDE], sine[WIDE];
        int done[WIDE], open = 0;
        for (long l = 0; l < WIDE; l++) {
            const long row = first + l < count ? first + l : first;
            const float *value = values + row * points, *from = c + 2 * row * lags;
            long best = 0;
            for (long i = 1; i < points; i++)
                if (largest ? value[i] > value[best] : value[i] < value[best])
                    best = i;
            u[l] = grid[best], left[l] = low[best], right[l] = high[best];
            done[l] = first + l >= count;
            open += !done[l];
            if (before[best] != best && after[best] != best) {
                const double here = value[best], l_wide = u[l] - left[l], r_wide = right[l] - u[l];
                const double a = (value[before[best]] - here) * r_wide, b = (value[after[best]] - here) * l_wide;
                if (a + b != 0)
                    u[l] += 0.5 * (a * r_wide - b * l_wide) / (a + b);
            }
            for (long k = 0; k < lags; k++) {
                c_re[k * WIDE + l] = sign * from[2 * k];
                c_im[k * WIDE + l] = sign * from[2 * k + 1];
            }
        }
        for (long step = 0; step < steps && open; step++) {
            for (long l = 0; l < WIDE; l++)
                cosine[l] = cos(u[l]), sine[l] = sin(u[l]);
            Doubles z_re, z_im, p_re, p_im = {0}, value = {0}, slope = {0}, curvature = {0};
            memcpy(&z_re, cosine, sizeof z_re);
            memcpy(&z_im, sine, sizeof z_im);
            p_re = p_im + 1;
            for (long k = 0; k < lags; k++) {
                Doubles re, im;
                memcpy(&re, c_re + k * WIDE, sizeof re);
                memcpy(&im, c_im + k * WIDE, sizeof im);
                const Doubles t_re = re * p_re - im * p_im, t_im = re * p_im + im * p_re, next = p_re * z_re - p_im * z_im;
                value += t_re;
                slope -= (double)k * t_im;
                curvature -= (double)(k * k) * t_re;
                p_im = p_re * z_im + p_im * z_re;
                p_re = next;
            }
            for (long l = 0; l < WIDE; l++) {
                if (done[l])
                    continue;
                double target = u[l] - slope[l] / curvature[l];
                const int sound = curvature[l] > 0 && target >= left[l] && target <= right[l];
                if (!sound) {
                    if (slope[l] > 0)
                        right[l] = u[l];
                    else
                        left[l] = u[l];
                    target = (left[l] + right[l]) / 2;
                }
                const double change = target - u[l];
                u[l] = target;
                found[first + l] = target;
                height[first + l] = sign * (value[l] + change * (slope[l] + 0.5 * change * curvature[l]));
                done[l] = fabs(change) < converged;
                open -= done[l];
            }
        }
    }
}
