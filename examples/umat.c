/* A surrogate as the material of a finite-element program written in C or Fortran.
 *
 *   surrofe2 export training/bending-bar.h5 --out bending-bar.c
 *   cc -O2 -o umat examples/umat.c bending-bar.c -lm && ./umat
 *
 * `material` is called in the manner of a UMAT: with the deformation gradients at the begin and
 * the end of a step it gives the stress at the end and its slope by that gradient. `main` stretches
 * a piece of tissue by 2 % within 20 us, holds it, and prints its stress.
 */

#include <math.h>
#include <stdio.h>

int surrofe2_stress(const double *F, const double *F_rate, double tolerance, double *stress,
                    double *bound, double *P_by_F, double *P_by_F_rate);

/* F0, F1: F11 F12 F21 F22 at the begin and the end of a step of `dt` us. stress: Cauchy, uN/um.
 * slope: 16 numbers, of the first Piola-Kirchhoff stress by F1. Returns 0, or why there is none. */
static int material(const double *F0, const double *F1, double dt, double *stress, double *slope)
{
    double rate[4], bound, by_rate[16];
    for (int k = 0; k < 4; k++)
        rate[k] = (F1[k] - F0[k]) / dt;
    const int status = surrofe2_stress(F1, rate, HUGE_VAL, stress, &bound, slope, by_rate);
    for (int k = 0; k < 16; k++)
        slope[k] += by_rate[k] / dt;
    return status;
}

int main(void)
{
    const double dt = 2.0, stretched = 20.0, end = 40.0, most = 0.02;
    double F0[4] = {1.0, 0.0, 0.0, 1.0}, F1[4] = {1.0, 0.0, 0.0, 1.0}, stress[4], slope[16];
    printf("t_us,F11,sigma_xx_uN_per_um,sigma_yy_uN_per_um,dP11_by_dF11_uN_per_um\n");
    for (double t = dt; t <= end; t += dt) {
        F1[0] = 1.0 + most * fmin(t / stretched, 1.0);
        const int status = material(F0, F1, dt, stress, slope);
        if (status) {
            fprintf(stderr, "no stress at %g us: status %d\n", t, status);
            return 1;
        }
        printf("%.17g,%.17g,%.17g,%.17g,%.17g\n", t, F1[0], stress[0], stress[3], slope[0]);
        F0[0] = F1[0];
    }
    return 0;
}
