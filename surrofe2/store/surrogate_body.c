/* The formulas; the numbers above are of one surrogate. Dual numbers carry a value and its
 * derivatives by the scaled inputs, x[0] value, x[1 + k] derivative: 7 of them, or none. */

#define INPUTS 7
#define ONE 7
#define COMPONENTS 4
#define STRETCH 3

typedef double dual[1 + INPUTS];

static void multiply(const double *a, const double *b, double *product, int n)
{
    const double value = a[0] * b[0];
    for (int k = n; k >= 1; k--)
        product[k] = a[k] * b[0] + a[0] * b[k];
    product[0] = value;
}

static void add_times(double factor, const double *a, double *sum, int n)
{
    for (int k = 0; k <= n; k++)
        sum[k] += factor * a[k];
}

/* the product of the three rows that `which` names */
static void product_of_three(dual *rows, const int *which, double *product, int n)
{
    multiply(rows[which[0]], rows[which[1]], product, n);
    multiply(product, rows[which[2]], product, n);
}

/* units of all layers from those of the first; the last has no tanh. Returns where it begins. */
static int forward(dual *units, int n)
{
    const double *weight = weights, *bias = biases;
    int begin = 0;
    for (int layer = 1; layer < LAYERS; layer++) {
        const int rows = sizes[layer], columns = sizes[layer - 1];
        dual *source = units + begin, *target = units + begin + columns;
        for (int i = 0; i < rows; i++) {
            double *unit = target[i];
            for (int k = 0; k <= n; k++)
                unit[k] = 0.0;
            unit[0] = bias[i];
            for (int j = 0; j < columns; j++)
                add_times(weight[i * columns + j], source[j], unit, n);
            if (layer != LAYERS - 1) {
                unit[0] = tanh(unit[0]);
                for (int k = 1; k <= n; k++)
                    unit[k] *= 1.0 - unit[0] * unit[0];
            }
        }
        weight += rows * columns;
        bias += rows;
        begin += columns;
    }
    return begin;
}

static void add_polynomial(dual *x, dual *y, int n)
{
    dual rows[ONE + 1 + PRODUCTS + 1], inner;
    memcpy(rows, x, (ONE + 1) * sizeof(dual));
    for (int k = 0; k < PRODUCTS; k++)
        multiply(rows[products[k][0]], rows[products[k][1]], rows[ONE + 1 + k], n);
    for (int j = 0; j < COMPONENTS; j++)
        for (int group = begins[j]; group < begins[j + 1]; group++) {
            memset(inner, 0, sizeof inner);
            for (int k = group_begins[group]; k < group_begins[group + 1]; k++)
                add_times(coefficients[k], rows[tails[k]], inner, n);
            multiply(inner, rows[heads[group]], inner, n);
            add_times(1.0, inner, y[j], n);
        }
}

/* x^p / sqrt(BEND^2 + x^2), which tells states near rest apart */
static void near_invariant(const dual x, int power, double *invariant, int n)
{
    const double square = BEND * BEND + x[0] * x[0], raised = power == 2 ? x[0] : 1.0;
    invariant[0] = raised * x[0] / sqrt(square);
    const double slope = raised * power / sqrt(square) - invariant[0] * x[0] / square;
    for (int k = 1; k <= n; k++)
        invariant[k] = slope * x[k];
}

static void add_terms(dual *x, dual *y, int n)
{
    dual units[UNITS], product;
    memset(units, 0, sizes[0] * sizeof(dual));
    for (int i = 0; i < INVARIANTS; i++)
        product_of_three(x, invariants[i], units[i], n);
    for (int k = 0; k < STRETCH; k++)
        near_invariant(x[k], powers[k], units[INVARIANTS + k], n);
    dual *factors = units + forward(units, n);
    for (int term = 0; term < TERMS; term++) {
        product_of_three(x, terms[term], product, n);
        factors[term][0] -= at_rest[term];
        multiply(factors[term], product, product, n);
        add_times(output_factor[terms[term][3]], product, y[terms[term][3]], n);
    }
}

static double sum_of_products(const int (*table)[4], const double *coefficients, int count,
                              const double *x)
{
    double total = 0.0;
    for (int k = 0; k < count; k++)
        total += coefficients[k] * (x[table[k][0]] * x[table[k][1]])
                 * (x[table[k][2]] * x[table[k][3]]);
    return total;
}

/* Whether a point is short of the failure boundary, and the bound of the error, in uN/um. */
static int domain_and_bound(const double *inputs, double tolerance, double *bound)
{
    double x[11], mean = 0.0, size = 0.0;
    for (int k = 0; k < INPUTS; k++)
        x[k] = inputs[k] * domain_factor[k];
    x[ONE] = 1.0;
    *bound = HUGE_VAL;
    if (BOUNDARY && !(sum_of_products(boundary_table, boundary, BOUNDARY, x) <= 0.0))
        return SURROFE2_OUT_OF_RANGE;
    const double low = x[0] < 0.0 ? x[0] : 0.0;
    for (int k = 0; k < INPUTS; k++) {
        x[k] *= x[k];
        mean += x[k] / INPUTS;
        size += near[k] * x[k];
    }
    x[8] = low * low;
    x[9] = mean;
    x[10] = size / (size + REACH);
    if (BOUND)
        *bound = sum_of_products(bound_table, bound_coefficients, BOUND, x);
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
                     double slopes[4][INPUTS], double *by_F, double *by_rate)
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

int surrofe2_stress(const double *F, const double *F_rate, double tolerance, double *stress,
                    double *bound, double *P_by_F, double *P_by_F_rate)
{
    const int n = P_by_F && P_by_F_rate ? INPUTS : 0;
    const double cosine = F[0] + F[3], sine = F[2] - F[1];
    const double length = sqrt(cosine * cosine + sine * sine);
    const double c = cosine / length, s = sine / length;
    double U[4], A[4], inputs[INPUTS + 1], P_hat[4], P[4], slopes[4][INPUTS];
    dual x[INPUTS + 1], y[COMPONENTS];

    *bound = HUGE_VAL;
    for (int k = 0; k < 4; k++)
        stress[k] = NAN;
    rotated(c, -s, F, U);
    rotated(c, -s, F_rate, A);
    int within = range[0] < U[0] && U[0] < range[1] && range[0] < U[3] && U[3] < range[1]
                 && fabs(U[1]) < range[2];
    for (int k = 0; k < 4; k++)
        within = within && fabs(A[k]) < range[3];
    if (!within || !(F[0] * F[3] - F[1] * F[2] > 0.0))
        return SURROFE2_OUT_OF_RANGE;
    components(U, inputs);
    inputs[0] = (U[0] - 1.0) + (U[3] - 1.0);
    components(A, inputs + 3);
    const int status = domain_and_bound(inputs, tolerance, bound);
    if (status != SURROFE2_OK)
        return status;

    memset(x, 0, sizeof x);
    memset(y, 0, sizeof y);
    for (int k = 0; k < INPUTS; k++) {
        x[k][0] = inputs[k] * input_factor[k];
        x[k][1 + k] = 1.0;
    }
    x[ONE][0] = 1.0;
    add_terms(x, y, n);
    add_polynomial(x, y, n);
    for (int i = 0; i < 4; i++) {
        P_hat[i] = y[i][0];
        for (int k = 0; k < n; k++)
            slopes[i][k] = y[i][1 + k] * input_factor[k];
    }
    from_components(P_hat, P);
    rotated(c, s, P, P);
    const double J = F[0] * F[3] - F[1] * F[2];
    const double sigma[4] = {
        (P[0] * F[0] + P[1] * F[1]) / J, (P[0] * F[2] + P[1] * F[3]) / J,
        (P[2] * F[0] + P[3] * F[1]) / J, (P[2] * F[2] + P[3] * F[3]) / J,
    };
    for (int k = 0; k < 4; k++)
        if (!isfinite(sigma[k]))
            return SURROFE2_NOT_FINITE;
    memcpy(stress, sigma, sizeof sigma);
    if (n)
        tangents(c, s, U, A, P_hat, slopes, P_by_F, P_by_F_rate);
    return SURROFE2_OK;
}
