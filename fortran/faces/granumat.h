/* The granumat material for C and C++: the procedures of fortran/faces/bindings.f90, in libgranumat_core.
 *
 * Stresses are in units of k/d (k_Hz for Hertzian contacts), tension positive; six components are 11 22 33 12 13 23, strains with
 * engineering shears. Arrays lie point by point. n is a number of points, threads how many share them; where one point fails, it
 * keeps its old state, its status says why, and the others are done.
 * Nothing is kept between calls; every procedure may be called from several threads at once. */
#ifndef GRANUMAT_H
#define GRANUMAT_H

#ifdef __cplusplus
extern "C" {
#endif

enum granumat_closure {
    GRANUMAT_CRITICAL, GRANUMAT_BASIC, GRANUMAT_N2, GRANUMAT_FULL, GRANUMAT_KINEMATIC, GRANUMAT_MOBILISED,
    GRANUMAT_MOBILISED_PRESSURE
};
enum granumat_contact { GRANUMAT_HOOKEAN, GRANUMAT_HERTZIAN };
enum granumat_calibration { GRANUMAT_TABLE_1, GRANUMAT_TEXT, GRANUMAT_FIGURE_16 };

/* What a status says; granumat_status_message has the words. From GRANUMAT_BAD_LAYOUT on they are the UMAT's,
 * but for GRANUMAT_BAD_INITIAL_STATE and GRANUMAT_BAD_NONLOCAL_STRAIN. */
enum granumat_status {
    GRANUMAT_OK,
    GRANUMAT_NOT_FINITE,
    GRANUMAT_BAD_PARAMETERS,
    GRANUMAT_BAD_VOLUME_FRACTION,
    GRANUMAT_BAD_FABRIC,
    GRANUMAT_INCREMENT_TOO_LARGE,
    GRANUMAT_FABRIC_BLOWS_UP,
    GRANUMAT_TENSILE_PRESSURE,
    GRANUMAT_RESULT_NOT_FINITE,
    GRANUMAT_TARGET_NOT_REACHED,
    GRANUMAT_NOT_CONVERGED,
    GRANUMAT_BAD_LAYOUT,
    GRANUMAT_BAD_SENTINEL,
    GRANUMAT_BAD_INITIAL_STATE,
    GRANUMAT_BAD_DEFORMATION,
    GRANUMAT_PLANE_STRESS,
    GRANUMAT_STRAIN_TOO_LARGE,
    GRANUMAT_BAD_NONLOCAL_STRAIN
};

/* How increments are integrated, by those procedures that compare methods, and where the spin is. */
enum granumat_method {
    GRANUMAT_EXACT,
    GRANUMAT_FORWARD_EULER,
    GRANUMAT_MIDPOINT,
    GRANUMAT_RK4,
    GRANUMAT_BOGACKI_SHAMPINE,
    GRANUMAT_BACKWARD_EULER
};
enum granumat_spin { GRANUMAT_INSIDE, GRANUMAT_BEFORE };

#define GRANUMAT_CONSTANTS 20
#define GRANUMAT_NAME 16
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
    double direction[6];                  /* D/abs(D) of the last strain, 0 before any; MOBILISED*: followed over e_r */
    double coordination_number;           /* Z2 */
    double volume_fraction;               /* phi */
};

/* ---- The material ---- */

/* The paper's constants for an interparticle friction coefficient. */
void granumat_parameters_from_friction(double mu, int closure, int contact, int calibration, struct granumat_parameters *par);

/* After a change: which of the first constants are out of range (1), and whether the material is valid (1). */
void granumat_complete_parameters(struct granumat_parameters *par, int faulty[GRANUMAT_CONSTANTS], int *valid);

/* Name, blank padded, and bounds of constant number 1 ... GRANUMAT_CONSTANTS; closed: 1 if the bounds themselves are allowed. */
void granumat_constant_range(int number, char name[GRANUMAT_NAME], double *lower, double *upper, int *closed);

/* The words for a status, blank padded, without a terminating 0. */
void granumat_status_message(int status, char message[GRANUMAT_MESSAGE]);

/* ---- States to start from ---- */

/* An isotropic packing of volume fraction phi under a pressure of at least 0. In the critical closure phi follows from the
 * pressure. status: GRANUMAT_OK or GRANUMAT_BAD_INITIAL_STATE. */
void granumat_isotropic_state(const struct granumat_parameters *par, double phi, double pressure, struct granumat_state *state,
                              int *status);

/* Steady simple shear du_1/dx_3 > 0 at n volume fractions phi. */
void granumat_steady_states(int n, const struct granumat_parameters *par, const double *phi, struct granumat_state *states,
                            int *status);

/* The states' stress becomes the model's; eta receives the friction coefficient. */
void granumat_evaluate_stress(int n, const struct granumat_parameters *par, struct granumat_state *states, double *eta);

/* ---- Increments ---- */

/* States after increments with displacement gradients gradient[i][j][k] = du_j/dx_k of point i. status: 0, or why a point keeps
 * its old state. old and new may not overlap. */
void granumat_update_states(int n, int threads, const struct granumat_parameters *par, const struct granumat_state *old,
                            const double (*gradient)[3][3], struct granumat_state *new_states, int *status);

/* The same with the consistent tangent: tangent[i][j][k] = d stress_j / d strain_k of point i (engineering shears), j < rows = 6,
 * k < columns = 6, or 9 with the spins 12 13 23 in k = 6 ... 8; in plane strain rows = 4, stresses 11 22 33 12, and columns is 3
 * for the strains 11 22 12, 4 for the spin 12 too. */
void granumat_update_states_with_tangent(int n, int threads, int rows, int columns, const struct granumat_parameters *par,
                                         const struct granumat_state *old, const double (*gradient)[3][3],
                                         struct granumat_state *new_states, int *status, double *tangent);

/* The two with a length (docs/theory.md, section 12): nonlocal[i] is the nonlocal strain m of point i's increment, positive where
 * the point strains, and by_nonlocal[i][j] = d stress_j / d m, j < rows. nonlocal[i] = abs(D) is the update without a length. */
void granumat_update_nonlocal_states(int n, int threads, const struct granumat_parameters *par, const struct granumat_state *old,
                                     const double (*gradient)[3][3], const double *nonlocal, struct granumat_state *new_states,
                                     int *status);
void granumat_update_nonlocal_states_with_tangent(int n, int threads, int rows, int columns, const struct granumat_parameters *par,
                                                  const struct granumat_state *old, const double (*gradient)[3][3],
                                                  const double *nonlocal, struct granumat_state *new_states, int *status,
                                                  double *tangent, double *by_nonlocal);

/* As granumat_update_states by another method, to compare with; tolerance, in (0, 1), is that of GRANUMAT_BOGACKI_SHAMPINE. */
void granumat_update_states_by_method(int n, int threads, int method, int spin, double tolerance,
                                      const struct granumat_parameters *par, const struct granumat_state *old,
                                      const double (*gradient)[3][3], struct granumat_state *new_states, int *status);

/* n increments of one point, one after the other, with m <= 6 stresses held: amplitudes q_a of modes are found so that
 * sum_b functional[a][b] stress_b = target[i][a] under gradient[i] + sum_a q_a mode[a], target[0] before the first increment and
 * target[i + 1] after increment i. tolerance is on what evolves, in every substep. The arrays have rows = max(m, 1) rows:
 * mode[rows][3][3], functional[rows][6], target[n + 1][rows], amplitude[n][rows]. done: how many increments were done; status: 0,
 * or why they are fewer than n. method, spin, method_tolerance: as above. */
void granumat_follow_path(int n, int m, int rows, int method, int spin, double method_tolerance,
                          const struct granumat_parameters *par, const struct granumat_state *start,
                          const double (*gradient)[3][3], const double (*mode)[3][3], const double (*functional)[6],
                          const double *target, double tolerance, struct granumat_state *states, double *amplitude, int *done,
                          int *status);

/* ---- Well-posedness (docs/theory.md, section 8) ---- */

/* eta_t, whose sign is that of the modulus of a change of the direction of shear. */
void granumat_transverse_modulus(int n, const struct granumat_parameters *par, const struct granumat_state *states, double *eta_t);

/* matrix[i][j][k]: response of stress j to strain k of state i, in units of p. */
void granumat_response(int n, const struct granumat_parameters *par, const struct granumat_state *states, double (*matrix)[6][6]);

/* Over all normals: the smallest eigenvalue of the acoustic tensor's symmetric part, least[i][0], and its smallest determinant,
 * least[i][1]; normal[i][0], normal[i][1] are where they are found. */
void granumat_least_acoustic(int n, int threads, const struct granumat_parameters *par, const struct granumat_state *states,
                             double (*least)[2], double (*normal)[2][3]);

/* ---- Finite elements in d = 2 (plane strain) or 3 dimensions ----
 *
 * shape_gradients[q][k][a]: derivative of shape function a by reference coordinate k at integration point q. Coordinates,
 * displacement increments and forces are [cell][node][d]; L[cell][q][j][k] = du_j/dx_k. mean_dilatation: 1 replaces the volume
 * strain of each point by the cell's mean (B-bar). */

/* Velocity gradients of the increment u, and the points' volumes after it. status of a cell: 0, 1 where it turns inside out, 2
 * where the increment is too large. */
void granumat_element_gradients(int d, int nodes, int points, int cells, int mean_dilatation, const double *shape_gradients,
                                const double *weights, const double *x, const double *u, double *L, double *volume, int *status);

/* Nodal forces of stress[cell][q][6] at the coordinates x_new after the increment. */
void granumat_element_forces(int d, int nodes, int points, int cells, int mean_dilatation, const double *shape_gradients,
                             const double *x_new, const double *volume, const double *stress, double *forces);

/* Their derivative by u, K[cell][row][column] with rows and columns over (node, unknown): each node has so many unknowns, of which
 * the first d are displacements, and the others are left alone. tangent[cell][q] is 6 x 9, in the plane 4 x 4. */
void granumat_element_stiffness(int d, int nodes, int points, int cells, int unknowns, int mean_dilatation,
                                const double *shape_gradients, const double *x_new, const double *volume, const double *L,
                                const double *stress, const double *tangent, double *K);

/* With a length the nonlocal strain m is one unknown more a node, of degree 1 between the cells' vertices, which come first among
 * the nodes: m - length^2 div grad m = abs(D) over the body at the start of the increment, at x. vertex_values[q][a] and
 * vertex_gradients[q][k][a] are the shape functions of degree 1. matrix[cell][a][b] is that of the left side, volume[cell][q] the
 * points' volume at x. */
void granumat_element_helmholtz(int d, int nodes, int vertices, int points, int cells, const double *shape_gradients,
                                const double *vertex_values, const double *vertex_gradients, const double *weights,
                                const double *x, double length, double *matrix, double *volume);

/* Writes what K has to do with m: the derivative of the forces by m, with by_nonlocal[cell][q][i] = d stress_i / d m, i < 2 d, and
 * scale times the derivatives of matrix m - (sum over points of old_volume N abs(D)). K is as above, with d + 1 unknowns a node. */
void granumat_element_coupling(int d, int nodes, int vertices, int points, int cells, int mean_dilatation,
                               const double *shape_gradients, const double *vertex_values, const double *x_new,
                               const double *volume, const double *old_volume, const double *L, const double *by_nonlocal,
                               const double *matrix, double scale, double *K);

/* ---- State on a mesh that does not follow the material ---- */

/* Cells of `nodes` = 2^d nodes and as many Gauss points, both in tensor order: bit k of a node's number, from 0, is its reference
 * coordinate along k. Face 2 k is where coordinate k is 0, face 2 k + 1 where it is 1. A point has 24 numbers: the 20 of
 * granumat_state in their order, of which phi is convected as the density of the solid and all others by its mass, and four more.
 * neighbour[cell][face] is the cell beyond, counted from 1, 0 where the body ends; those above `cells`, up to all_cells, have values
 * only. opposite[cell][face][q][0 and 1] are the neighbour's near and far point, counted from 1, at point q of the face.
 * wall[cell][face] is 1 where no solid passes. */

/* The ranges (76 numbers a cell) that granumat_convection_stage keeps values within, from values[cell][q][24] before the step. */
void granumat_convection_ranges(int d, int nodes, int cells, int all_cells, const double *x, const int *neighbour,
                                const double *values, double *range);

/* A stage of the step from a mesh at x_start[cell][node][k] to one at x_end. First with share 0 and stage = start, then with share
 * 0.5 and stage what came out, which together are of second order: out = share start + (1 - share) (stage + what the step brings).
 * fabric_limit is what A : A may become at least. A step sweeps at most 0.15 of a cell; see granumat_swept_volumes. */
void granumat_convection_stage(int d, int nodes, int cells, int all_cells, double share, double fabric_limit,
                               const double *x_start, const double *x_end, const int *neighbour, const int *opposite,
                               const int *wall, const double *range, const double *start, const double *stage, double *out);

/* Of each cell the larger of the volumes that it gains and loses between x_start and x_end, over its volume; huge where it is
 * inverted. */
void granumat_swept_volumes(int d, int nodes, int cells, const double *x_start, const double *x_end, double *swept);

/* ---- What this machine can do ---- */

/* Does 192 additions and multiplications a round in registers, to measure other arithmetic against. */
void granumat_arithmetic(int rounds, double *total);

#ifdef __cplusplus
}
#endif
#endif
