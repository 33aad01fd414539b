/* The formulas; the numbers above are of one surrogate, and all sizes are known here. Slopes are by
 * the scaled inputs, LANES of them, of which the last is not used. */

#define INPUTS 7
#define ONE 7
#define COMPONENTS 4
#define STRETCH 3
#define LANES 8

#define LAYER(weight, bias, columns, rows, source, target)   \
    do {                                                     \
        for (int i = 0; i < rows; i++)                       \
            target[i] = bias[i];                             \
        for (int j = 0; j < columns; j++)                    \
            for (int i = 0; i < rows; i++)                   \
                target[i] += weight[j][i] * source[j];       \
    } while (0)

#define SLOPES(weight, columns, rows, source, target)        \
    do {                                                     \
        memset(target, 0, sizeof target);                    \
        for (int j = 0; j < columns; j++)                    \
            for (int i = 0; i < rows; i++)                   \
                for (int k = 0; k < LANES; k++)              \
                    target[i][k] += weight[j][i] * source[j][k]; \
    } while (0)

#define TANH_SLOPES(tanh, rows, slopes)                      \
    do {                                                     \
        for (int i = 0; i < rows; i++)                       \
            for (int k = 0; k < LANES; k++)                  \
                slopes[i][k] *= 1.0 - tanh[i] * tanh[i];     \
    } while (0)

/* 1 - 2/(e^2y + 1), with e^2y = 2^n e^r, n an integer and |r| <= ln 2/2: e^r is a polynomial, 2^n is
 * written into the exponent bits, so that the loop becomes vector instructions. Do not compile this
 * with -ffast-math, which would take the rounding to an integer away. */
static inline void tanh_of(double *y, int n)
{
    for (int i = 0; i < n; i++) {
        const double magic = 6755399441055744.0, ln2 = 0.6931471805599453;
        double z = 2.0 * y[i], q = 2.510038549551032e-08, scale;
        uint64_t bits;
        z = z > 40.0 ? 40.0 : z;
        z = z < -40.0 ? -40.0 : z;
        const double shifted = z * 1.4426950408889634 + magic, r = z - (shifted - magic) * ln2;
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
        y[i] = 1.0 - 2.0 / (((q * r + 1.0) * r + 1.0) * scale + 1.0);
    }
}

@FORWARD@
/* rows of products behind the inputs, and the polynomials of them */
#define POLYNOMIALS(name, inputs, count, rows, y)                                             \
    do {                                                                                      \
        for (int k = 0; k < name##_PRODUCTS; k++)                                             \
            rows[inputs + k] = rows[name##_products[k][0]] * rows[name##_products[k][1]];     \
        for (int j = 0; j < count; j++) {                                                     \
            y[j] = 0.0;                                                                       \
            for (int g = name##_begins[j]; g < name##_begins[j + 1]; g++) {                   \
                double inner = 0.0;                                                           \
                for (int k = name##_group_begins[g]; k < name##_group_begins[g + 1]; k++)     \
                    inner += name##_coefficients[k] * rows[name##_rows[k]];                   \
                y[j] += inner * rows[name##_heads[g]];                                        \
            }                                                                                 \
        }                                                                                     \
    } while (0)

/* the slopes of the same, from the rows */
static void baseline_slopes(const double *rows, double slopes[][LANES], double y[][LANES])
{
    memset(slopes, 0, (ONE + 1) * sizeof *slopes);
    for (int k = 0; k < INPUTS; k++)
        slopes[k][k] = 1.0;
    for (int m = 0; m < baseline_PRODUCTS; m++) {
        const int i = baseline_products[m][0], j = baseline_products[m][1];
        for (int k = 0; k < LANES; k++)
            slopes[ONE + 1 + m][k] = slopes[i][k] * rows[j];
        slopes[ONE + 1 + m][j] += rows[i];
    }
    memset(y, 0, COMPONENTS * sizeof *y);
    for (int c = 0; c < COMPONENTS; c++)
        for (int g = baseline_begins[c]; g < baseline_begins[c + 1]; g++) {
            const int head = baseline_heads[g];
            double inner[LANES] = {0.0}, value = 0.0;
            for (int n = baseline_group_begins[g]; n < baseline_group_begins[g + 1]; n++) {
                const double *slope = slopes[baseline_rows[n]];
                for (int k = 0; k < LANES; k++)
                    inner[k] += baseline_coefficients[n] * slope[k];
                value += baseline_coefficients[n] * rows[baseline_rows[n]];
            }
            for (int k = 0; k < LANES; k++)
                y[c][k] += inner[k] * rows[head];
            y[c][head] += value;
        }
}

/* Components of R'P at the scaled inputs rows[0] to rows[6], and their slopes if these are wanted. */
static void network(double *rows, double *y, double slopes[][LANES])
{
    double units[READ], factors[TERMS], row_slopes[ONE + 1 + baseline_PRODUCTS][LANES];
    double unit_slopes[READ][LANES], factor_slopes[TERMS][LANES];
    POLYNOMIALS(baseline, (ONE + 1), COMPONENTS, rows, y);
    for (int i = 0; i < INVARIANTS; i++)
        units[i] = rows[kept[TERMS + i]];
    if (slopes) {
        baseline_slopes(rows, row_slopes, slopes);
        for (int i = 0; i < INVARIANTS; i++)
            memcpy(unit_slopes[i], row_slopes[kept[TERMS + i]], sizeof unit_slopes[i]);
        memset(unit_slopes[INVARIANTS], 0, STRETCH * sizeof unit_slopes[0]);
    }
    for (int k = 0; k < STRETCH; k++) { /* x^p / sqrt(BEND^2 + x^2) tells states near rest apart */
        const double x = rows[k], square = BEND * BEND + x * x, inverse = 1.0 / sqrt(square);
        const double raised = powers[k] == 2 ? x : 1.0, value = raised * x * inverse;
        units[INVARIANTS + k] = value;
        if (slopes)
            unit_slopes[INVARIANTS + k][k] =
                raised * powers[k] * inverse - value * x * inverse * inverse;
    }
    if (slopes)
        factors_and_slopes(units, unit_slopes, factors, factor_slopes);
    else
        factors_of(units, factors);
    for (int t = 0; t < TERMS; t++) {
        const int c = components_of[t];
        const double scale = output_factor[c], product = rows[kept[t]] * scale;
        const double factor = (factors[t] - at_rest[t]) * scale;
        y[c] += factor * rows[kept[t]];
        for (int k = 0; slopes && k < LANES; k++)
            slopes[c][k] += factor_slopes[t][k] * product + factor * row_slopes[kept[t]][k];
    }
}

/* Whether a point is short of the failure boundary, and the bound of the error, in uN/um. */
static int domain_and_bound(const double *inputs, double tolerance, double *bound)
{
    double x[ALL_INPUTS + bound_PRODUCTS], y[3], mean = 0.0, size = 0.0;
    for (int k = 0; k < INPUTS; k++) {
        const double scaled = inputs[k] * domain_factor[k], square = scaled * scaled;
        x[k] = scaled;
        x[SQUARES + k] = square;
        mean += square / INPUTS;
        size += near[k] * square;
    }
    const double low = x[0] < 0.0 ? x[0] : 0.0;
    x[ONE] = 1.0;
    x[COMPRESSION] = low * low;
    x[NORM] = mean;
    x[NEAR] = size / (size + REACH);
    POLYNOMIALS(bound, ALL_INPUTS, 3, x, y);
    if (!(y[0] <= 0.0))
        return SURROFE2_OUT_OF_RANGE;
    *bound = y[1];
    return *bound <= tolerance ? SURROFE2_OK : SURROFE2_NOT_TRUSTED;
}

static void components(const double *T, double *c)
{
    c[0] = T[0] + T[3];
    c[1] = T[0] - T[3];
    c[2] = T[1] + T[2];
    c[3] = T[2] - T[1];
}

static void from_components(const double *c, double *T)
{
    T[0] = 0.5 * (c[0] + c[1]);
    T[1] = 0.5 * (c[2] - c[3]);
    T[2] = 0.5 * (c[2] + c[3]);
    T[3] = 0.5 * (c[0] - c[1]);
}

/* E T, E the turn by 90 degrees, times a */
static void turned(double a, const double *T, double *ET)
{
    ET[0] = -a * T[2];
    ET[1] = -a * T[3];
    ET[2] = a * T[0];
    ET[3] = a * T[1];
}

/* R T of the rotation with this cosine and sine */
static void rotated(double c, double s, const double *T, double *RT)
{
    const double a = T[0], b = T[1];
    RT[0] = c * a - s * T[2];
    RT[1] = c * b - s * T[3];
    RT[2] = s * a + c * T[2];
    RT[3] = s * b + c * T[3];
}

/* dP/dF and dP/dF' from the components of R'P and their slopes by the inputs */
static void tangents(double c, double s, const double *U, const double *A, const double *P_hat,
                     double slopes[][LANES], double *by_F, double *by_rate)
{
    double P[4];
    from_components(P_hat, P);
    for (int k = 0; k < 4; k++) {
        double unit[4] = {0.0}, B[4], EU[4], EA[4], EP[4], change[8], sum[4], all[4], along[4];
        unit[k] = 1.0;
        rotated(c, -s, unit, B);
        const double angle = (B[2] - B[1]) / (U[0] + U[3]);
        turned(-angle, U, EU);
        turned(-angle, A, EA);
        turned(angle, P, EP);
        for (int i = 0; i < 4; i++)
            EU[i] += B[i];
        components(EU, change);
        components(EA, change + 3);
        for (int i = 0; i < 4; i++) {
            sum[i] = 0.0;
            for (int j = 0; j < INPUTS; j++)
                sum[i] += slopes[i][j] * change[j];
        }
        from_components(sum, all);
        for (int i = 0; i < 4; i++)
            all[i] += EP[i];
        rotated(c, s, all, along);
        for (int i = 0; i < 4; i++)
            by_F[4 * i + k] = along[i];
        components(B, change);
        for (int i = 0; i < 4; i++) {
            sum[i] = 0.0;
            for (int j = 0; j < 4; j++)
                sum[i] += slopes[i][3 + j] * change[j];
        }
        from_components(sum, all);
        rotated(c, s, all, along);
        for (int i = 0; i < 4; i++)
            by_rate[4 * i + k] = along[i];
    }
}

int @NAME@_stress(const double *F, const double *F_rate, double tolerance, double *stress,
    double *bound, double *P_by_F, double *P_by_F_rate)
{
    const int with_slopes = P_by_F && P_by_F_rate;
    const double cosine = F[0] + F[3], sine = F[2] - F[1];
    const double length = sqrt(cosine * cosine + sine * sine);
    const double c = cosine / length, s = sine / length, J = F[0] * F[3] - F[1] * F[2];
    double U[4], A[4], inputs[INPUTS + 1], P_hat[4], P[4], slopes[COMPONENTS][LANES];
    double rows[ONE + 1 + baseline_PRODUCTS];

    *bound = HUGE_VAL;
    for (int k = 0; k < 4; k++)
        stress[k] = NAN;
    rotated(c, -s, F, U);
    rotated(c, -s, F_rate, A);
    int within = range[0] < U[0] && U[0] < range[1] && range[0] < U[3] && U[3] < range[1]
                 && fabs(U[1]) < range[2];
    for (int k = 0; k < 4; k++)
        within = within && fabs(A[k]) < range[3];
    if (!within || !(J > 0.0))
        return SURROFE2_OUT_OF_RANGE;
    components(U, inputs);
    inputs[0] = (U[0] - 1.0) + (U[3] - 1.0);
    components(A, inputs + 3);
    const int status = domain_and_bound(inputs, tolerance, bound);
    if (status != SURROFE2_OK)
        return status;

    for (int k = 0; k < INPUTS; k++)
        rows[k] = inputs[k] * input_factor[k];
    rows[ONE] = 1.0;
    network(rows, P_hat, with_slopes ? slopes : NULL);
    from_components(P_hat, P);
    rotated(c, s, P, P);
    const double sigma[4] = {
        (P[0] * F[0] + P[1] * F[1]) / J, (P[0] * F[2] + P[1] * F[3]) / J,
        (P[2] * F[0] + P[3] * F[1]) / J, (P[2] * F[2] + P[3] * F[3]) / J,
    };
    for (int k = 0; k < 4; k++)
        if (!isfinite(sigma[k])) {
            *bound = HUGE_VAL;
            return SURROFE2_NOT_FINITE;
        }
    memcpy(stress, sigma, sizeof sigma);
    if (with_slopes) {
        for (int i = 0; i < COMPONENTS; i++)
            for (int k = 0; k < INPUTS; k++)
                slopes[i][k] *= input_factor[k];
        tangents(c, s, U, A, P_hat, slopes, P_by_F, P_by_F_rate);
    }
    return SURROFE2_OK;
}

size_t @NAME@_stress_of(size_t count, const double *F, const double *F_rate, double tolerance,
    double *stress, double *bound, double *P_by_F, double *P_by_F_rate, int *status)
{
    size_t lost = 0;
    const int with_slopes = P_by_F && P_by_F_rate;
    for (size_t n = 0; n < count; n++) {
        status[n] = @NAME@_stress(F + 4 * n, F_rate + 4 * n, tolerance, stress + 4 * n, bound + n,
                                  with_slopes ? P_by_F + 16 * n : NULL,
                                  with_slopes ? P_by_F_rate + 16 * n : NULL);
        lost += status[n] != SURROFE2_OK;
    }
    return lost;
}
