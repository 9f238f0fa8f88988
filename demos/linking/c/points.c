/* Many points in one call: packings of several volume fractions are sheared, on two threads. */
#include <granumat.h>
#include <stdio.h>
#include <string.h>

enum { POINTS = 5, INCREMENTS = 100 };

int main(void)
{
    struct granumat_parameters par;
    granumat_parameters_from_friction(0.5, GRANUMAT_FULL, GRANUMAT_HOOKEAN, GRANUMAT_TABLE_1, &par);
    par.elastic_strain = 0.01;
    int faulty[GRANUMAT_CONSTANTS], valid;
    granumat_complete_parameters(&par, faulty, &valid);
    if (!valid)
        return 1;

    struct granumat_state old[POINTS], new_states[POINTS];
    double gradient[POINTS][3][3], tangent[POINTS][6][6];
    int status[POINTS];
    memset(gradient, 0, sizeof gradient);
    for (int i = 0; i < POINTS; i++) {
        granumat_isotropic_state(&par, 0.59 + 0.005 * i, 0.005, &old[i], &status[i]);
        if (status[i])
            return 1;
        gradient[i][0][2] = 0.01;                          /* du_x/dz */
    }

    for (int k = 0; k < INCREMENTS; k++) {
        granumat_update_states_with_tangent(POINTS, 2, 6, 6, &par, old, gradient, new_states, status, &tangent[0][0][0]);
        for (int i = 0; i < POINTS; i++)
            if (status[i]) {
                char message[GRANUMAT_MESSAGE];
                granumat_status_message(status[i], message);
                fprintf(stderr, "point %d: %.*s\n", i, GRANUMAT_MESSAGE, message);
                return 1;
            }
        memcpy(old, new_states, sizeof old);
    }
    for (int i = 0; i < POINTS; i++) {
        const double *s = old[i].stress;
        double p = -(s[0] + s[1] + s[2]) / 3;
        printf("phi %.3f  p %.6f  sigma_xz/p %.6f  d sigma_xz/d gamma %.6f\n", old[i].volume_fraction, p, s[4] / p,
               tangent[i][4][4]);
    }
    return 0;
}
