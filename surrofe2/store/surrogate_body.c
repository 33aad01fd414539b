#include <math.h>
#include <stdint.h>
#include <string.h>

#ifdef __cplusplus
#define RESTRICT
#else
#define RESTRICT restrict
#endif
@SPLIT@
/* The formulas. Each is a loop over LANES points, a quantity of which is a row of so many numbers; all
 * sizes are known here, so that compilers make vector instructions of the loops. What is called
 * ..._of_1 is the same for a point alone. Do not compile this with -ffast-math, which takes the
 * rounding to an integer away. */

/* tanh of |y| <= 20, 1 - 2/(e^2y + 1), with e^2y = 2^n e^r, n an integer and |r| <= ln 2/2: e^r is a polynomial, and 2^n
 * is written into the exponent bits. */
static inline double tanh_of(double y)
{
    const double magic = 6755399441055744.0, ln2 = 0.6931471805599453;
    double q = 2.510038549551032e-08, scale;
    uint64_t bits;
    const double z = 2.0 * y, shifted = z * 1.4426950408889634 + magic;
    const double r = z - (shifted - magic) * ln2;
    q = q * r + 2.7620088445409746e-07;
    q = q * r + 2.7557268459997064e-06;
    q = q * r + 2.4801521295954376e-05;
    q = q * r + 0.00019841269863053618;
    q = q * r + 0.0013888888917213717;
    q = q * r + 0.008333333333330062;
    q = q * r + 0.04166666666662413;
    q = q * r + 0.16666666666666669;
    q = q * r + 0.5000000000000001;
    memcpy(&bits, &shifted, sizeof bits);
    bits = (bits + 1023) << 52;
    memcpy(&scale, &bits, sizeof scale);
    return 1.0 - 2.0 / (((q * r + 1.0) * r + 1.0) * scale + 1.0);
}

/* 1/sqrt(x) from an estimate by the exponent bits and four Newton steps: sqrt may set errno, and a
 * loop with it is not made of vector instructions. */
static inline double inverse_root(double x)
{
    uint64_t bits;
    double y;
    memcpy(&bits, &x, sizeof bits);
    bits = UINT64_C(0x5FE6EB50C7B537A9) - (bits >> 1);
    memcpy(&y, &bits, sizeof y);
    y = y * (1.5 - 0.5 * x * y * y);
    y = y * (1.5 - 0.5 * x * y * y);
    y = y * (1.5 - 0.5 * x * y * y);
    return y + 0.5 * y * (1.0 - x * y * y);
}

/* The entries of R S, so many numbers apart, with cosine and sine of R and the components of S: sum,
 * difference, shear and spin. */
static inline void set_turned(double sum, double difference, double shear, double spin, double c,
                              double s, double *entries, int apart)
{
    const double S11 = 0.5 * (sum + difference), S12 = 0.5 * (shear - spin);
    const double S21 = 0.5 * (shear + spin), S22 = 0.5 * (sum - difference);
    entries[0] = c * S11 - s * S21;
    entries[apart] = c * S12 - s * S22;
    entries[2 * apart] = s * S11 + c * S21;
    entries[3 * apart] = s * S12 + c * S22;
}

/* target = weight source + bias; four rows of the matrix at a time stay in registers */
#define LAYER(lanes, weight, bias, rows, target, terms)          \
    do {                                                         \
        for (int i = 0; i < rows; i += 4)                        \
            for (int l = 0; l < lanes; l++) {                    \
                double a = bias[i], b = bias[i + 1];             \
                double c = bias[i + 2], d = bias[i + 3];         \
                terms                                            \
                target[i * lanes + l] = a;                       \
                target[(i + 1) * lanes + l] = b;                 \
                target[(i + 2) * lanes + l] = c;                 \
                target[(i + 3) * lanes + l] = d;                 \
            }                                                    \
    } while (0)
#define TERM(lanes, weight, j, source)                           \
    a += weight[j][i] * source[j * lanes + l];                   \
    b += weight[j][i + 1] * source[j * lanes + l];               \
    c += weight[j][i + 2] * source[j * lanes + l];               \
    d += weight[j][i + 3] * source[j * lanes + l];

/* tanh 20 is 1 to the last bit; in a loop of its own, since a branch before arithmetic, which may
 * trap, would leave no vector instructions */
#define FILL_TANH(units, size)                                   \
    do {                                                         \
        for (int m = 0; m < size; m++) {                         \
            const double y = units[m] > 20.0 ? 20.0 : units[m];  \
            units[m] = y < -20.0 ? -20.0 : y;                    \
        }                                                        \
        for (int m = 0; m < size; m++)                           \
            units[m] = tanh_of(units[m]);                        \
    } while (0)
#define TIMES_TANH_SLOPE(slopes, units, size)                    \
    do {                                                         \
        for (int m = 0; m < size; m++)                           \
            slopes[m] *= 1.0 - units[m] * units[m];              \
    } while (0)
@SPLIT@
/* The answers at @L@ points at once: F, V = F_rate and stress have rows 11, 12, 21, 22 of @L@ numbers,
 * tangents 16 such rows, 4 a + b by the entry b of F. Where status is not 0 the rest is not to be used. */
static void answers_of_@L@(const double *RESTRICT F, const double *RESTRICT V, double tolerance,
                         double *RESTRICT stress, double *RESTRICT bound, int *RESTRICT status,
                         int with_slopes, double *RESTRICT by_F, double *RESTRICT by_rate)
{
    double cosine[@L@], sine[@L@], U[4 * @L@], A[4 * @L@], x[(INPUTS + 1) * @L@], within[@L@];
    double height[@L@], y[COMPONENTS * @L@], slopes[INPUTS * COMPONENTS * @L@], finite[@L@];
    int any = 0;

    for (int l = 0; l < @L@; l++) { /* F = R U, A = R'V */
        const double xx = F[l], xy = F[@L@ + l], yx = F[2 * @L@ + l], yy = F[3 * @L@ + l];
        const double p = V[l], q = V[@L@ + l], r = V[2 * @L@ + l], t = V[3 * @L@ + l];
        const double along = xx + yy, across = yx - xy;
        const double inverse = inverse_root(along * along + across * across);
        const double c = along * inverse, s = across * inverse;
        const double U11 = c * xx + s * yx, U12 = c * xy + s * yy, U22 = c * yy - s * xy;
        const double A11 = c * p + s * r, A12 = c * q + s * t, A21 = c * r - s * p, A22 = c * t - s * q;
        cosine[l] = c;
        sine[l] = s;
        U[l] = U11;
        U[@L@ + l] = U12;
        U[2 * @L@ + l] = U22;
        A[l] = A11;
        A[@L@ + l] = A12;
        A[2 * @L@ + l] = A21;
        A[3 * @L@ + l] = A22;
        x[l] = (U11 - 1.0) + (U22 - 1.0);
        x[@L@ + l] = U11 - U22;
        x[2 * @L@ + l] = 2.0 * U12;
        x[3 * @L@ + l] = A11 + A22;
        x[4 * @L@ + l] = A11 - A22;
        x[5 * @L@ + l] = A12 + A21;
        x[6 * @L@ + l] = A21 - A12;
        within[l] = (range[0] < U11) & (U11 < range[1]) & (range[0] < U22) & (U22 < range[1])
                    & (fabs(U12) < range[2]) & (fabs(A11) < range[3]) & (fabs(A12) < range[3])
                    & (fabs(A21) < range[3]) & (fabs(A22) < range[3])
                    & (xx * yy - xy * yx > 0.0) ? 1.0 : 0.0;
    }
    bound_of_@L@(x, height, bound);
    for (int l = 0; l < @L@; l++) {
        status[l] = SURROFE2_OK;
        if (!(within[l] > 0.0 && height[l] <= 0.0)) {
            status[l] = SURROFE2_OUT_OF_RANGE;
            bound[l] = HUGE_VAL;
        } else if (!(bound[l] <= tolerance)) {
            status[l] = SURROFE2_NOT_TRUSTED;
        }
        any |= status[l] == SURROFE2_OK;
    }
    if (!any)
        return;

    for (int k = 0; k < INPUTS; k++)
        for (int l = 0; l < @L@; l++)
            x[k * @L@ + l] *= input_factor[k];
    network_of_@L@(x, y, with_slopes, slopes);
    for (int l = 0; l < @L@; l++) { /* P = R P_hat, stress = P F'/det F */
        const double xx = F[l], xy = F[@L@ + l], yx = F[2 * @L@ + l], yy = F[3 * @L@ + l];
        const double c = cosine[l], s = sine[l], over_J = 1.0 / (xx * yy - xy * yx);
        double P[4];
        set_turned(y[l], y[@L@ + l], y[2 * @L@ + l], y[3 * @L@ + l], c, s, P, 1);
        const double s11 = (P[0] * xx + P[1] * xy) * over_J, s12 = (P[0] * yx + P[1] * yy) * over_J;
        const double s21 = (P[2] * xx + P[3] * xy) * over_J, s22 = (P[2] * yx + P[3] * yy) * over_J;
        stress[l] = s11;
        stress[@L@ + l] = s12;
        stress[2 * @L@ + l] = s21;
        stress[3 * @L@ + l] = s22;
        finite[l] = (s11 - s11) + (s12 - s12) + (s21 - s21) + (s22 - s22);
    }
    for (int l = 0; l < @L@; l++)
        if (status[l] == SURROFE2_OK && !(finite[l] == 0.0)) {
            status[l] = SURROFE2_NOT_FINITE;
            bound[l] = HUGE_VAL;
        }
    if (!with_slopes)
        return;

    for (int k = 0; k < INPUTS; k++)
        for (int m = 0; m < COMPONENTS * @L@; m++)
            slopes[k * COMPONENTS * @L@ + m] *= input_factor[k];
    /* Along B = R'dF the rotation turns by an angle: dU = B - angle E U, dA = -angle E A and
     * R'dP = dP_hat + angle E P_hat, with E the turn by 90 degrees. */
    for (int k = 0; k < 4; k++) {
        const double by_first = k % 2 == 0, by_second = k % 2, upper = k < 2, lower = k >= 2;
        for (int l = 0; l < @L@; l++) {
            const double c = cosine[l], s = sine[l], U11 = U[l], U12 = U[@L@ + l], U22 = U[2 * @L@ + l];
            const double A11 = A[l], A12 = A[@L@ + l], A21 = A[2 * @L@ + l], A22 = A[3 * @L@ + l];
            const double first = upper * c + lower * s, second = lower * c - upper * s;
            const double B11 = by_first * first, B12 = by_second * first;
            const double B21 = by_first * second, B22 = by_second * second;
            const double angle = (B21 - B12) / (U11 + U22);
            const double d[7] = {
                B11 + B22, B11 - B22 + 2.0 * angle * U12, B12 + B21 + angle * (U22 - U11),
                angle * (A21 - A12), angle * (A12 + A21), angle * (A22 - A11), -angle * (A11 + A22),
            };
            const double e[4] = {B11 + B22, B11 - B22, B12 + B21, B21 - B12};
            double u[4], v[4];
            @SUMS@
            set_turned(u[0] - angle * y[3 * @L@ + l], u[1] - angle * y[2 * @L@ + l],
                       u[2] + angle * y[@L@ + l], u[3] + angle * y[l], c, s, by_F + k * @L@ + l, 4 * @L@);
            set_turned(v[0], v[1], v[2], v[3], c, s, by_rate + k * @L@ + l, 4 * @L@);
        }
    }
}
@SPLIT@
int @NAME@_stress(const double *F, const double *F_rate, double tolerance, double *stress,
    double *bound, double *P_by_F, double *P_by_F_rate)
{
    const int with_slopes = P_by_F && P_by_F_rate;
    int status;
    double sigma[4], by_F[16], by_rate[16];
    answers_of_1(F, F_rate, tolerance, sigma, bound, &status, with_slopes, by_F, by_rate);
    for (int i = 0; i < 4; i++)
        stress[i] = status == SURROFE2_OK ? sigma[i] : NAN;
    if (with_slopes && status == SURROFE2_OK) {
        memcpy(P_by_F, by_F, sizeof by_F);
        memcpy(P_by_F_rate, by_rate, sizeof by_rate);
    }
    return status;
}

size_t @NAME@_stress_of(size_t count, const double *F, const double *F_rate, double tolerance,
    double *stress, double *bound, double *P_by_F, double *P_by_F_rate, int *status)
{
    const int with_slopes = P_by_F && P_by_F_rate;
    double f[4 * 8], v[4 * 8], sigma[4 * 8], bounds[8], by_F[16 * 8], by_rate[16 * 8];
    int statuses[8];
    size_t lost = 0;
    for (size_t n = 0; n < count; n += 8) {
        const size_t here = count - n < 8 ? count - n : 8; /* behind the last point it is repeated */
        for (size_t l = 0; l < 8; l++)
            for (size_t i = 0; i < 4; i++) {
                f[i * 8 + l] = F[4 * (n + (l < here ? l : here - 1)) + i];
                v[i * 8 + l] = F_rate[4 * (n + (l < here ? l : here - 1)) + i];
            }
        answers_of_8(f, v, tolerance, sigma, bounds, statuses, with_slopes, by_F, by_rate);
        for (size_t l = 0; l < here; l++) {
            const int is_known = statuses[l] == SURROFE2_OK;
            for (size_t i = 0; i < 4; i++)
                stress[4 * (n + l) + i] = is_known ? sigma[i * 8 + l] : NAN;
            for (size_t i = 0; with_slopes && is_known && i < 16; i++) {
                P_by_F[16 * (n + l) + i] = by_F[i * 8 + l];
                P_by_F_rate[16 * (n + l) + i] = by_rate[i * 8 + l];
            }
            bound[n + l] = bounds[l];
            status[n + l] = statuses[l];
            lost += !is_known;
        }
    }
    return lost;
}
