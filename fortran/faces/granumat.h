/* Many points of the granumat material in one call; the procedures of fortran/faces/bindings.f90, in libgranumat_core.
 *
 * Stresses are in units of k/d (k_Hz for Hertzian contacts), tension positive; six components are 11 22 33 12 13 23.
 * Nothing is kept between calls; every procedure may be called from several threads at once. */
#ifndef GRANUMAT_H
#define GRANUMAT_H

#ifdef __cplusplus
extern "C" {
#endif

enum granumat_closure { GRANUMAT_CRITICAL, GRANUMAT_BASIC, GRANUMAT_N2, GRANUMAT_FULL, GRANUMAT_KINEMATIC };
enum granumat_contact { GRANUMAT_HOOKEAN, GRANUMAT_HERTZIAN };
enum granumat_calibration { GRANUMAT_TABLE_1, GRANUMAT_TEXT, GRANUMAT_FIGURE_16 };

#define GRANUMAT_CONSTANTS 20
#define GRANUMAT_MESSAGE 120

/* The numbers of a material; up to elastic_strain yours to change, followed by granumat_complete_parameters. */
struct granumat_parameters {
    double mu;                            /* interparticle friction coefficient */
    double a1, a2;                        /* pressure (4.2) */
    double a3, a4;                        /* normal stress differences (A 1), (A 4) */
    double b1, b2, b3;                    /* friction (4.5), (4.6) */
    double Zc, phic;                      /* critical coordination number and volume fraction */
    double c1, c2, c3;                    /* fabric (4.7) */
    double d1, d2, d3;                    /* coordination number (4.8) */
    double beta1, beta2;                  /* f(phi) (4.9) */
    double g;                             /* isotropic compression (B 1) */
    double elastic_strain;                /* e_r; 0: the paper */
    double chi, kappa, lambda;            /* (A 7)-(A 9) */
    double fabric_limit;
    int closure, contact;
};

/* What a point remembers: 160 bytes. */
struct granumat_state {
    double stress[6];
    double fabric[6];                     /* A (3.1) */
    double direction[6];                  /* D/abs(D) of the last strain, 0 before any */
    double coordination_number;           /* Z2 */
    double volume_fraction;               /* phi */
};

/* The paper's constants for an interparticle friction coefficient. */
void granumat_parameters_from_friction(double mu, int closure, int contact, int calibration, struct granumat_parameters *par);

/* After a change: which of the first constants are out of range (1), and whether the material is valid (1). */
void granumat_complete_parameters(struct granumat_parameters *par, int faulty[GRANUMAT_CONSTANTS], int *valid);

/* The states' stress becomes the model's; eta receives the friction coefficient. */
void granumat_evaluate_stress(int n, const struct granumat_parameters *par, struct granumat_state *states, double *eta);

/* States after increments with displacement gradients gradient[i][j][k] = du_j/dx_k of point i. status: 0, or why a point keeps
 * its old state. old and new may not overlap. */
void granumat_update_states(int n, int threads, const struct granumat_parameters *par, const struct granumat_state *old,
                 const double (*gradient)[3][3], struct granumat_state *new_states, int *status);

/* The same with the consistent tangent: tangent[i][j][k] = d stress_j / d strain_k of point i (engineering shears), j < rows = 6,
 * k < columns = 6, or 9 with the spins 12 13 23 in k = 6 ... 8; in plane strain rows = 4, stresses 11 22 33 12, and columns is 3
 * for the strains 11 22 12, 4 for the spin 12 too. */
void granumat_update_states_with_tangent(int n, int threads, int rows, int columns, const struct granumat_parameters *par,
                  const struct granumat_state *old,
                  const double (*gradient)[3][3], struct granumat_state *new_states, int *status, double *tangent);

/* The words for a status, blank padded, without a terminating 0. */
void granumat_status_message(int status, char message[GRANUMAT_MESSAGE]);

#ifdef __cplusplus
}
#endif
#endif
