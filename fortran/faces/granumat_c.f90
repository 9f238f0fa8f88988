!> granumat.h for Fortran: types and interfaces of the procedures in libgranumat_core.
!! Compile it with the code that uses it, for a module file fits one compiler only. granumat.h says what the arguments are.
module granumat_c
  use, intrinsic :: iso_c_binding, only: c_char, c_double, c_int
  implicit none (type, external)
  private
  public :: granumat_parameters_from_friction, granumat_complete_parameters, granumat_constant_range, granumat_status_message, &
    granumat_isotropic_state, granumat_steady_states, granumat_evaluate_stress, granumat_update_states, &
    granumat_update_states_with_tangent, granumat_update_nonlocal_states, granumat_update_nonlocal_states_with_tangent, &
    granumat_update_states_by_method, granumat_follow_path, granumat_transverse_modulus, granumat_response, &
    granumat_least_acoustic, granumat_element_gradients, granumat_element_forces, granumat_element_stiffness, &
    granumat_element_helmholtz, granumat_element_coupling, granumat_convection_ranges, granumat_convection_stage, &
    granumat_swept_volumes, granumat_arithmetic

  integer(c_int), parameter, public :: GRANUMAT_CRITICAL = 0, GRANUMAT_BASIC = 1, GRANUMAT_N2 = 2, GRANUMAT_FULL = 3, &
    GRANUMAT_KINEMATIC = 4, GRANUMAT_MOBILISED = 5, GRANUMAT_MOBILISED_PRESSURE = 6
  integer(c_int), parameter, public :: GRANUMAT_HOOKEAN = 0, GRANUMAT_HERTZIAN = 1
  integer(c_int), parameter, public :: GRANUMAT_TABLE_1 = 0, GRANUMAT_TEXT = 1, GRANUMAT_FIGURE_16 = 2
  integer, parameter, public :: GRANUMAT_CONSTANTS = 20, GRANUMAT_NAME = 16, GRANUMAT_MESSAGE = 120

  type, public, bind(c) :: granumat_parameters
    real(c_double) :: mu, a1, a2, a3, a4, b1, b2, b3, Zc, phic, c1, c2, c3, d1, d2, d3, beta1, beta2, g, elastic_strain
    real(c_double) :: chi, kappa, lambda, fabric_limit
    integer(c_int) :: closure, contact
  end type granumat_parameters

  type, public, bind(c) :: granumat_state
    real(c_double) :: stress(6), fabric(6), direction(6), coordination_number, volume_fraction
  end type granumat_state

  interface

    subroutine granumat_parameters_from_friction(mu, closure, contact, calibration, par) bind(c)
      import :: c_double, c_int, granumat_parameters
      implicit none (type, external)
      real(c_double), value, intent(in) :: mu
      integer(c_int), value, intent(in) :: closure, contact, calibration
      type(granumat_parameters), intent(out) :: par
    end subroutine granumat_parameters_from_friction

    subroutine granumat_complete_parameters(par, faulty, valid) bind(c)
      import :: c_int, granumat_parameters, GRANUMAT_CONSTANTS
      implicit none (type, external)
      type(granumat_parameters), intent(inout) :: par
      integer(c_int), intent(out) :: faulty(GRANUMAT_CONSTANTS), valid
    end subroutine granumat_complete_parameters

    subroutine granumat_constant_range(number, name, lower, upper, closed) bind(c)
      import :: c_char, c_double, c_int, GRANUMAT_NAME
      implicit none (type, external)
      integer(c_int), value, intent(in) :: number
      character(kind=c_char), intent(out) :: name(GRANUMAT_NAME)
      real(c_double), intent(out) :: lower, upper
      integer(c_int), intent(out) :: closed
    end subroutine granumat_constant_range

    subroutine granumat_status_message(status, message) bind(c)
      import :: c_char, c_int, GRANUMAT_MESSAGE
      implicit none (type, external)
      integer(c_int), value, intent(in) :: status
      character(kind=c_char), intent(out) :: message(GRANUMAT_MESSAGE)
    end subroutine granumat_status_message

    subroutine granumat_isotropic_state(par, phi, pressure, state, status) bind(c)
      import :: c_double, c_int, granumat_parameters, granumat_state
      implicit none (type, external)
      type(granumat_parameters), intent(in) :: par
      real(c_double), value, intent(in) :: phi, pressure
      type(granumat_state), intent(out) :: state
      integer(c_int), intent(out) :: status
    end subroutine granumat_isotropic_state

    subroutine granumat_steady_states(n, par, phi, states, status) bind(c)
      import :: c_double, c_int, granumat_parameters, granumat_state
      implicit none (type, external)
      integer(c_int), value, intent(in) :: n
      type(granumat_parameters), intent(in) :: par
      real(c_double), intent(in) :: phi(n)
      type(granumat_state), intent(out) :: states(n)
      integer(c_int), intent(out) :: status(n)
    end subroutine granumat_steady_states

    subroutine granumat_evaluate_stress(n, par, states, eta) bind(c)
      import :: c_double, c_int, granumat_parameters, granumat_state
      implicit none (type, external)
      integer(c_int), value, intent(in) :: n
      type(granumat_parameters), intent(in) :: par
      type(granumat_state), intent(inout) :: states(n)
      real(c_double), intent(out) :: eta(n)
    end subroutine granumat_evaluate_stress

    subroutine granumat_update_states(n, threads, par, old, gradient, new, status) bind(c)
      import :: c_double, c_int, granumat_parameters, granumat_state
      implicit none (type, external)
      integer(c_int), value, intent(in) :: n, threads
      type(granumat_parameters), intent(in) :: par
      type(granumat_state), intent(in) :: old(n)
      real(c_double), intent(in) :: gradient(3, 3, n)                 ! (k, j) = du_j/dx_k
      type(granumat_state), intent(out) :: new(n)
      integer(c_int), intent(out) :: status(n)
    end subroutine granumat_update_states

    subroutine granumat_update_states_with_tangent(n, threads, rows, columns, par, old, gradient, new, status, tangent) bind(c)
      import :: c_double, c_int, granumat_parameters, granumat_state
      implicit none (type, external)
      integer(c_int), value, intent(in) :: n, threads, rows, columns
      type(granumat_parameters), intent(in) :: par
      type(granumat_state), intent(in) :: old(n)
      real(c_double), intent(in) :: gradient(3, 3, n)                 ! (k, j) = du_j/dx_k
      type(granumat_state), intent(out) :: new(n)
      integer(c_int), intent(out) :: status(n)
      real(c_double), intent(out) :: tangent(columns, rows, n)        ! (k, j) = d stress_j/d strain_k
    end subroutine granumat_update_states_with_tangent

    subroutine granumat_update_nonlocal_states(n, threads, par, old, gradient, nonlocal, new, status) bind(c)
      import :: c_double, c_int, granumat_parameters, granumat_state
      implicit none (type, external)
      integer(c_int), value, intent(in) :: n, threads
      type(granumat_parameters), intent(in) :: par
      type(granumat_state), intent(in) :: old(n)
      real(c_double), intent(in) :: gradient(3, 3, n)                 ! (k, j) = du_j/dx_k
      real(c_double), intent(in) :: nonlocal(n)
      type(granumat_state), intent(out) :: new(n)
      integer(c_int), intent(out) :: status(n)
    end subroutine granumat_update_nonlocal_states

    subroutine granumat_update_nonlocal_states_with_tangent(n, threads, rows, columns, par, old, gradient, nonlocal, new, status, &
        tangent, by_nonlocal) bind(c)
      import :: c_double, c_int, granumat_parameters, granumat_state
      implicit none (type, external)
      integer(c_int), value, intent(in) :: n, threads, rows, columns
      type(granumat_parameters), intent(in) :: par
      type(granumat_state), intent(in) :: old(n)
      real(c_double), intent(in) :: gradient(3, 3, n)                 ! (k, j) = du_j/dx_k
      real(c_double), intent(in) :: nonlocal(n)
      type(granumat_state), intent(out) :: new(n)
      integer(c_int), intent(out) :: status(n)
      real(c_double), intent(out) :: tangent(columns, rows, n)        ! (k, j) = d stress_j/d strain_k
      real(c_double), intent(out) :: by_nonlocal(rows, n)             ! (j) = d stress_j/d nonlocal
    end subroutine granumat_update_nonlocal_states_with_tangent

    subroutine granumat_update_states_by_method(n, threads, method, spin, tolerance, par, old, gradient, new, status) bind(c)
      import :: c_double, c_int, granumat_parameters, granumat_state
      implicit none (type, external)
      integer(c_int), value, intent(in) :: n, threads, method, spin
      real(c_double), value, intent(in) :: tolerance
      type(granumat_parameters), intent(in) :: par
      type(granumat_state), intent(in) :: old(n)
      real(c_double), intent(in) :: gradient(3, 3, n)
      type(granumat_state), intent(out) :: new(n)
      integer(c_int), intent(out) :: status(n)
    end subroutine granumat_update_states_by_method

    subroutine granumat_follow_path(n, m, rows, method, spin, method_tolerance, par, start, gradient, mode, functional, target, &
        tolerance, states, amplitude, done, status) bind(c)
      import :: c_double, c_int, granumat_parameters, granumat_state
      implicit none (type, external)
      integer(c_int), value, intent(in) :: n, m, rows, method, spin
      real(c_double), value, intent(in) :: method_tolerance
      type(granumat_parameters), intent(in) :: par
      type(granumat_state), intent(in) :: start
      real(c_double), intent(in) :: gradient(3, 3, n), mode(3, 3, rows), functional(6, rows), target(rows, 0:n)
      real(c_double), value, intent(in) :: tolerance
      type(granumat_state), intent(out) :: states(n)
      real(c_double), intent(out) :: amplitude(rows, n)
      integer(c_int), intent(out) :: done, status
    end subroutine granumat_follow_path

    subroutine granumat_transverse_modulus(n, par, states, eta_t) bind(c)
      import :: c_double, c_int, granumat_parameters, granumat_state
      implicit none (type, external)
      integer(c_int), value, intent(in) :: n
      type(granumat_parameters), intent(in) :: par
      type(granumat_state), intent(in) :: states(n)
      real(c_double), intent(out) :: eta_t(n)
    end subroutine granumat_transverse_modulus

    subroutine granumat_response(n, par, states, matrix) bind(c)
      import :: c_double, c_int, granumat_parameters, granumat_state
      implicit none (type, external)
      integer(c_int), value, intent(in) :: n
      type(granumat_parameters), intent(in) :: par
      type(granumat_state), intent(in) :: states(n)
      real(c_double), intent(out) :: matrix(6, 6, n)
    end subroutine granumat_response

    subroutine granumat_least_acoustic(n, threads, par, states, least, normal) bind(c)
      import :: c_double, c_int, granumat_parameters, granumat_state
      implicit none (type, external)
      integer(c_int), value, intent(in) :: n, threads
      type(granumat_parameters), intent(in) :: par
      type(granumat_state), intent(in) :: states(n)
      real(c_double), intent(out) :: least(2, n), normal(3, 2, n)
    end subroutine granumat_least_acoustic

    subroutine granumat_element_gradients(d, nodes, points, cells, mean_dilatation, shape_gradients, weights, x, u, L, volume, &
        status) bind(c)
      import :: c_double, c_int
      implicit none (type, external)
      integer(c_int), value, intent(in) :: d, nodes, points, cells, mean_dilatation
      real(c_double), intent(in) :: shape_gradients(nodes, d, points), weights(points), x(d, nodes, cells), u(d, nodes, cells)
      real(c_double), intent(out) :: L(3, 3, points, cells), volume(points, cells)
      integer(c_int), intent(out) :: status(cells)
    end subroutine granumat_element_gradients

    subroutine granumat_element_forces(d, nodes, points, cells, mean_dilatation, shape_gradients, x_new, volume, stress, forces) &
        bind(c)
      import :: c_double, c_int
      implicit none (type, external)
      integer(c_int), value, intent(in) :: d, nodes, points, cells, mean_dilatation
      real(c_double), intent(in) :: shape_gradients(nodes, d, points), x_new(d, nodes, cells), volume(points, cells)
      real(c_double), intent(in) :: stress(6, points, cells)
      real(c_double), intent(out) :: forces(d, nodes, cells)
    end subroutine granumat_element_forces

    subroutine granumat_element_stiffness(d, nodes, points, cells, unknowns, mean_dilatation, shape_gradients, x_new, volume, L, &
        stress, tangent, K) bind(c)
      import :: c_double, c_int
      implicit none (type, external)
      integer(c_int), value, intent(in) :: d, nodes, points, cells, unknowns, mean_dilatation
      real(c_double), intent(in) :: shape_gradients(nodes, d, points), x_new(d, nodes, cells), volume(points, cells)
      real(c_double), intent(in) :: L(3, 3, points, cells), stress(6, points, cells)
      real(c_double), intent(in) :: tangent(5 * d - 6, 2 * d, points, cells)
      real(c_double), intent(inout) :: K(unknowns * nodes, unknowns * nodes, cells)
    end subroutine granumat_element_stiffness

    subroutine granumat_element_helmholtz(d, nodes, vertices, points, cells, shape_gradients, vertex_values, vertex_gradients, &
        weights, x, length, matrix, volume) bind(c)
      import :: c_double, c_int
      implicit none (type, external)
      integer(c_int), value, intent(in) :: d, nodes, vertices, points, cells
      real(c_double), intent(in) :: shape_gradients(nodes, d, points), vertex_values(vertices, points)
      real(c_double), intent(in) :: vertex_gradients(vertices, d, points), weights(points), x(d, nodes, cells)
      real(c_double), value, intent(in) :: length
      real(c_double), intent(out) :: matrix(vertices, vertices, cells), volume(points, cells)
    end subroutine granumat_element_helmholtz

    subroutine granumat_element_coupling(d, nodes, vertices, points, cells, mean_dilatation, shape_gradients, vertex_values, &
        x_new, volume, old_volume, L, by_nonlocal, matrix, scale, K) bind(c)
      import :: c_double, c_int
      implicit none (type, external)
      integer(c_int), value, intent(in) :: d, nodes, vertices, points, cells, mean_dilatation
      real(c_double), intent(in) :: shape_gradients(nodes, d, points), vertex_values(vertices, points), x_new(d, nodes, cells)
      real(c_double), intent(in) :: volume(points, cells), old_volume(points, cells), L(3, 3, points, cells)
      real(c_double), intent(in) :: by_nonlocal(2 * d, points, cells), matrix(vertices, vertices, cells)
      real(c_double), value, intent(in) :: scale
      real(c_double), intent(inout) :: K((d + 1) * nodes, (d + 1) * nodes, cells)
    end subroutine granumat_element_coupling

    subroutine granumat_convection_ranges(d, nodes, cells, all_cells, x, neighbour, values, range) bind(c)
      import :: c_double, c_int
      implicit none (type, external)
      integer(c_int), value, intent(in) :: d, nodes, cells, all_cells
      real(c_double), intent(in) :: x(d, nodes, cells), values(24, nodes, all_cells)
      integer(c_int), intent(in) :: neighbour(2 * d, cells)
      real(c_double), intent(out) :: range(76, cells)
    end subroutine granumat_convection_ranges

    subroutine granumat_convection_stage(d, nodes, cells, all_cells, share, fabric_limit, x_start, x_end, neighbour, opposite, &
        wall, range, start, stage, out) bind(c)
      import :: c_double, c_int
      implicit none (type, external)
      integer(c_int), value, intent(in) :: d, nodes, cells, all_cells
      real(c_double), value, intent(in) :: share, fabric_limit
      real(c_double), intent(in) :: x_start(d, nodes, cells), x_end(d, nodes, cells), range(76, cells)
      integer(c_int), intent(in) :: neighbour(2 * d, cells), opposite(2, nodes, 2 * d, cells), wall(2 * d, cells)
      real(c_double), intent(in) :: start(24, nodes, all_cells), stage(24, nodes, all_cells)
      real(c_double), intent(out) :: out(24, nodes, cells)
    end subroutine granumat_convection_stage

    subroutine granumat_swept_volumes(d, nodes, cells, x_start, x_end, swept) bind(c)
      import :: c_double, c_int
      implicit none (type, external)
      integer(c_int), value, intent(in) :: d, nodes, cells
      real(c_double), intent(in) :: x_start(d, nodes, cells), x_end(d, nodes, cells)
      real(c_double), intent(out) :: swept(cells)
    end subroutine granumat_swept_volumes

    subroutine granumat_arithmetic(rounds, total) bind(c)
      import :: c_double, c_int
      implicit none (type, external)
      integer(c_int), value, intent(in) :: rounds
      real(c_double), intent(out) :: total
    end subroutine granumat_arithmetic

  end interface

end module granumat_c
