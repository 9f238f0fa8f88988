!> The procedures that C and Python call, with plain arrays. f2py takes the shapes from _core.pyf; granumat.h declares them for C.
module granumat_bindings
  use, intrinsic :: iso_c_binding, only: c_char, c_double, c_int
  use granumat_batch, only: update_batch, update_batch_by_method
  use granumat_convection, only: convection_ranges, convection_stage, swept_volumes, COLUMNS, RANGES_OF_CELL => RANGES
  use granumat_element, only: element_gradients, element_forces, element_stiffness, element_helmholtz, element_coupling
  use granumat_ellipticity, only: response, transverse_modulus, response_of, least_over_normals, EIGENVALUE, DETERMINANT
  use granumat_parameters, only: material_parameters, parameters_from_friction, derive_constants, faulty_constants, &
    are_valid, N_CONSTANTS, NAME_LENGTH, RANGES
  use granumat_kinds, only: LANES
  use granumat_methods, only: scheme
  use granumat_path, only: follow_path
  use granumat_state, only: lane_state, material_state, gather, scatter
  use granumat_starts, only: excess_under, isotropic_state, steady_states
  use granumat_stress, only: evaluate
  use granumat_status, only: status_message, BAD_INITIAL_STATE, MESSAGE_LENGTH
  implicit none (type, external)
  private

contains

  subroutine granumat_parameters_from_friction(mu, closure, contact, calibration, par) bind(c)
    real(c_double), value, intent(in) :: mu
    integer(c_int), value, intent(in) :: closure, contact, calibration
    type(material_parameters), intent(out) :: par
    par = parameters_from_friction(mu, closure, contact, calibration)
  end subroutine granumat_parameters_from_friction

  !> After a change of constants: which of them are faulty (1); if none is, chi, kappa, lambda and the fabric's limit are set anew.
  subroutine granumat_complete_parameters(par, faulty, valid) bind(c)
    type(material_parameters), intent(inout) :: par
    integer(c_int), intent(out) :: faulty(N_CONSTANTS), valid
    faulty = merge(1, 0, faulty_constants(par))
    if (all(faulty == 0)) call derive_constants(par)
    valid = merge(1, 0, are_valid(par))
  end subroutine granumat_complete_parameters

  subroutine granumat_constant_range(i, name, lower_bound, upper_bound, closed_bounds) bind(c)
    integer(c_int), value, intent(in) :: i                    ! 1 ... N_CONSTANTS
    character(kind=c_char), intent(out) :: name(NAME_LENGTH)
    real(c_double), intent(out) :: lower_bound, upper_bound
    integer(c_int), intent(out) :: closed_bounds
    name = transfer(RANGES(i)%name, name)
    lower_bound = RANGES(i)%lower
    upper_bound = RANGES(i)%upper
    closed_bounds = merge(1, 0, RANGES(i)%closed)
  end subroutine granumat_constant_range

  subroutine granumat_status_message(status, message) bind(c)
    integer(c_int), value, intent(in) :: status
    character(kind=c_char), intent(out) :: message(MESSAGE_LENGTH)
    message = transfer(status_message(status), message)
  end subroutine granumat_status_message

  !> The states with their stress replaced by the model's; see evaluate.
  subroutine granumat_evaluate_stress(n, par, states, eta) bind(c)
    integer(c_int), value, intent(in) :: n
    type(material_parameters), intent(in) :: par
    type(material_state), intent(inout) :: states(n)
    real(c_double), intent(out) :: eta(n)
    type(lane_state) :: x
    real(c_double) :: lane_eta(LANES)
    integer :: first, last
    do first = 1, n, LANES
      last = min(first + LANES - 1, n)
      call gather(states(first:last), x)
      call evaluate(par, x, lane_eta)
      call scatter(x, states(first:last))
      eta(first:last) = lane_eta(:last - first + 1)
    end do
  end subroutine granumat_evaluate_stress

  !> The state of an isotropic packing under a pressure.
  subroutine granumat_isotropic_state(par, volume_fraction, pressure, state, status) bind(c)
    type(material_parameters), intent(in) :: par
    real(c_double), value, intent(in) :: volume_fraction, pressure
    type(material_state), intent(out) :: state
    integer(c_int), intent(out) :: status
    status = BAD_INITIAL_STATE
    if (pressure >= 0) call isotropic_state(par, volume_fraction, excess_under(par, pressure), state, status)
  end subroutine granumat_isotropic_state

  subroutine granumat_steady_states(n, par, volume_fractions, states, status) bind(c)
    integer(c_int), value, intent(in) :: n
    type(material_parameters), intent(in) :: par
    real(c_double), intent(in) :: volume_fractions(n)
    type(material_state), intent(out) :: states(n)
    integer(c_int), intent(out) :: status(n)
    integer :: first, last
    do first = 1, n, LANES
      last = min(first + LANES - 1, n)
      call steady_states(par, volume_fractions(first:last), states(first:last), status(first:last))
    end do
  end subroutine granumat_steady_states

  subroutine granumat_transverse_modulus(n, par, states, eta_t) bind(c)
    integer(c_int), value, intent(in) :: n
    type(material_parameters), intent(in) :: par
    type(material_state), intent(in) :: states(n)
    real(c_double), intent(out) :: eta_t(n)
    type(lane_state) :: x
    real(c_double) :: found(LANES)
    integer :: first, last
    do first = 1, n, LANES
      last = min(first + LANES - 1, n)
      call gather(states(first:last), x)
      found = transverse_modulus(par, x)
      eta_t(first:last) = found(:last - first + 1)
    end do
  end subroutine granumat_transverse_modulus

  !> Response matrices, transposed: Python's (n, 6, 6) has the stress components' index before the strains'.
  subroutine granumat_response(n, par, states, matrix) bind(c)
    integer(c_int), value, intent(in) :: n
    type(material_parameters), intent(in) :: par
    type(material_state), intent(in) :: states(n)
    real(c_double), intent(out) :: matrix(6, 6, n)
    type(lane_state) :: x
    type(response) :: law
    integer :: first, last, i
    do first = 1, n, LANES
      last = min(first + LANES - 1, n)
      call gather(states(first:last), x)
      law = response_of(par, x)
      do i = first, last
        matrix(:, :, i) = transpose(law%C(i - first + 1, :, :))
      end do
    end do
  end subroutine granumat_response

  !> The smallest eigenvalue (1) and the smallest determinant (2) of the acoustic tensor, and their normals.
  subroutine granumat_least_acoustic(n, threads, par, states, least, normal) bind(c)
    integer(c_int), value, intent(in) :: n, threads
    type(material_parameters), intent(in) :: par
    type(material_state), intent(in) :: states(n)
    real(c_double), intent(out) :: least(2, n), normal(3, 2, n)
    type(lane_state) :: x
    type(response) :: law
    real(c_double) :: found(LANES, EIGENVALUE:DETERMINANT), where_found(LANES, 3, EIGENVALUE:DETERMINANT)
    integer :: first, last, i, kind
    !$omp parallel do num_threads(threads) if(threads > 1) private(x, law, found, where_found, last, i, kind)
    do first = 1, n, LANES
      last = min(first + LANES - 1, n)
      call gather(states(first:last), x)
      law = response_of(par, x)
      do kind = EIGENVALUE, DETERMINANT
        call least_over_normals(law, kind, found(:, kind), where_found(:, :, kind))
      end do
      do i = first, last
        least(:, i) = found(i - first + 1, :)
        normal(:, :, i) = where_found(i - first + 1, :, :)
      end do
    end do
  end subroutine granumat_least_acoustic

  subroutine granumat_update_states(n, threads, par, old, gradient, new, status) bind(c)
    integer(c_int), value, intent(in) :: n, threads
    type(material_parameters), intent(in) :: par
    type(material_state), intent(in) :: old(n)
    real(c_double), intent(in) :: gradient(3, 3, n)
    type(material_state), intent(out) :: new(n)
    integer(c_int), intent(out) :: status(n)
    call update_batch(par, old, gradient, threads, new, status)
  end subroutine granumat_update_states

  !> With the tangent: 6 rows, columns 6 for the strain, 9 for strain and spin; in plane strain 4 rows, columns 3 and 4.
  subroutine granumat_update_states_with_tangent(n, threads, rows, columns, par, old, gradient, new, status, tangent) bind(c)
    integer(c_int), value, intent(in) :: n, threads, rows, columns
    type(material_parameters), intent(in) :: par
    type(material_state), intent(in) :: old(n)
    real(c_double), intent(in) :: gradient(3, 3, n)
    type(material_state), intent(out) :: new(n)
    integer(c_int), intent(out) :: status(n)
    real(c_double), intent(out) :: tangent(columns, rows, n)
    call update_batch(par, old, gradient, threads, new, status, tangent)
  end subroutine granumat_update_states_with_tangent

  !> With a length: the increment's nonlocal strains are given.
  subroutine granumat_update_nonlocal_states(n, threads, par, old, gradient, nonlocal, new, status) bind(c)
    integer(c_int), value, intent(in) :: n, threads
    type(material_parameters), intent(in) :: par
    type(material_state), intent(in) :: old(n)
    real(c_double), intent(in) :: gradient(3, 3, n), nonlocal(n)
    type(material_state), intent(out) :: new(n)
    integer(c_int), intent(out) :: status(n)
    call update_batch(par, old, gradient, threads, new, status, nonlocal=nonlocal)
  end subroutine granumat_update_nonlocal_states

  !> The same with the tangent, and the derivative of the stress by the nonlocal strain.
  subroutine granumat_update_nonlocal_states_with_tangent(n, threads, rows, columns, par, old, gradient, nonlocal, new, status, &
      tangent, by_nonlocal) bind(c)
    integer(c_int), value, intent(in) :: n, threads, rows, columns
    type(material_parameters), intent(in) :: par
    type(material_state), intent(in) :: old(n)
    real(c_double), intent(in) :: gradient(3, 3, n), nonlocal(n)
    type(material_state), intent(out) :: new(n)
    integer(c_int), intent(out) :: status(n)
    real(c_double), intent(out) :: tangent(columns, rows, n), by_nonlocal(rows, n)
    call update_batch(par, old, gradient, threads, new, status, tangent, nonlocal, by_nonlocal)
  end subroutine granumat_update_nonlocal_states_with_tangent

  !> By a method that is compared with the exact update: numbers of the method and of the spin as in granumat_methods.
  subroutine granumat_update_states_by_method(n, threads, method, spin, tolerance, par, old, gradient, new, status) bind(c)
    integer(c_int), value, intent(in) :: n, threads, method, spin
    real(c_double), value, intent(in) :: tolerance
    type(material_parameters), intent(in) :: par
    type(material_state), intent(in) :: old(n)
    real(c_double), intent(in) :: gradient(3, 3, n)
    type(material_state), intent(out) :: new(n)
    integer(c_int), intent(out) :: status(n)
    call update_batch_by_method(par, scheme(method, spin, tolerance), old, gradient, threads, new, status)
  end subroutine granumat_update_states_by_method

  !> m free modes, in arrays of at least one row (f2py takes no empty ones).
  subroutine granumat_follow_path(n, m, rows, method, spin, method_tolerance, par, start, gradient, mode, functional, target, &
      tolerance, states, amplitude, done, status) bind(c)
    integer(c_int), value, intent(in) :: n, m, rows, method, spin
    real(c_double), value, intent(in) :: method_tolerance
    type(material_parameters), intent(in) :: par
    type(material_state), intent(in) :: start
    real(c_double), intent(in) :: gradient(3, 3, n), mode(3, 3, rows), functional(6, rows), target(rows, 0:n)
    real(c_double), value, intent(in) :: tolerance
    type(material_state), intent(out) :: states(n)
    real(c_double), intent(out) :: amplitude(rows, n)
    integer(c_int), intent(out) :: done, status
    call follow_path(par, scheme(method, spin, method_tolerance), start, gradient, mode(:, :, :m), functional(:, :m), &
      target(:m, :), tolerance, states, amplitude(:m, :), done, status)
  end subroutine granumat_follow_path

  !> Multiplies and adds 2 * 12 * LANES * rounds times in registers: what the arithmetic of a benchmark is measured against.
  subroutine granumat_arithmetic(rounds, total) bind(c)
    integer(c_int), value, intent(in) :: rounds
    real(c_double), intent(out) :: total
    real(c_double) :: x(LANES, 12)
    integer :: k
    x = 1
    do k = 1, rounds
      x = x * 0.5_c_double + 0.25_c_double
    end do
    total = sum(x)
  end subroutine granumat_arithmetic

  subroutine granumat_element_gradients(d, nodes, points, cells, mean_dilatation, shape_gradients, weights, x, u, L, volume, &
      status) bind(c)
    integer(c_int), value, intent(in) :: d, nodes, points, cells, mean_dilatation
    real(c_double), intent(in) :: shape_gradients(nodes, d, points), weights(points), x(d, nodes, cells), u(d, nodes, cells)
    real(c_double), intent(out) :: L(3, 3, points, cells), volume(points, cells)
    integer(c_int), intent(out) :: status(cells)
    call element_gradients(shape_gradients, weights, x, u, mean_dilatation /= 0, L, volume, status)
  end subroutine granumat_element_gradients

  subroutine granumat_element_forces(d, nodes, points, cells, mean_dilatation, shape_gradients, x_new, volume, stress, forces) &
      bind(c)
    integer(c_int), value, intent(in) :: d, nodes, points, cells, mean_dilatation
    real(c_double), intent(in) :: shape_gradients(nodes, d, points), x_new(d, nodes, cells), volume(points, cells)
    real(c_double), intent(in) :: stress(6, points, cells)
    real(c_double), intent(out) :: forces(d, nodes, cells)
    call element_forces(shape_gradients, x_new, volume, stress, mean_dilatation /= 0, forces)
  end subroutine granumat_element_forces

  subroutine granumat_element_stiffness(d, nodes, points, cells, unknowns, mean_dilatation, shape_gradients, x_new, volume, L, &
      stress, tangent, K) bind(c)
    integer(c_int), value, intent(in) :: d, nodes, points, cells, unknowns, mean_dilatation
    real(c_double), intent(in) :: shape_gradients(nodes, d, points), x_new(d, nodes, cells), volume(points, cells)
    real(c_double), intent(in) :: L(3, 3, points, cells), stress(6, points, cells)
    real(c_double), intent(in) :: tangent(5 * d - 6, 2 * d, points, cells)
    real(c_double), intent(inout) :: K(unknowns * nodes, unknowns * nodes, cells)
    call element_stiffness(shape_gradients, x_new, volume, L, stress, tangent, mean_dilatation /= 0, K)
  end subroutine granumat_element_stiffness

  subroutine granumat_element_helmholtz(d, nodes, vertices, points, cells, shape_gradients, vertex_values, vertex_gradients, &
      weights, x, length, matrix, volume) bind(c)
    integer(c_int), value, intent(in) :: d, nodes, vertices, points, cells
    real(c_double), intent(in) :: shape_gradients(nodes, d, points), vertex_values(vertices, points)
    real(c_double), intent(in) :: vertex_gradients(vertices, d, points), weights(points), x(d, nodes, cells)
    real(c_double), value, intent(in) :: length
    real(c_double), intent(out) :: matrix(vertices, vertices, cells), volume(points, cells)
    call element_helmholtz(shape_gradients, vertex_values, vertex_gradients, weights, x, length, matrix, volume)
  end subroutine granumat_element_helmholtz

  subroutine granumat_element_coupling(d, nodes, vertices, points, cells, mean_dilatation, shape_gradients, vertex_values, x_new, &
      volume, old_volume, L, by_nonlocal, matrix, scale, K) bind(c)
    integer(c_int), value, intent(in) :: d, nodes, vertices, points, cells, mean_dilatation
    real(c_double), intent(in) :: shape_gradients(nodes, d, points), vertex_values(vertices, points), x_new(d, nodes, cells)
    real(c_double), intent(in) :: volume(points, cells), old_volume(points, cells), L(3, 3, points, cells)
    real(c_double), intent(in) :: by_nonlocal(2 * d, points, cells), matrix(vertices, vertices, cells)
    real(c_double), value, intent(in) :: scale
    real(c_double), intent(inout) :: K((d + 1) * nodes, (d + 1) * nodes, cells)
    call element_coupling(shape_gradients, vertex_values, x_new, volume, old_volume, L, by_nonlocal, matrix, scale, &
      mean_dilatation /= 0, K)
  end subroutine granumat_element_coupling

  subroutine granumat_convection_ranges(d, nodes, cells, all_cells, x, neighbour, values, range) bind(c)
    integer(c_int), value, intent(in) :: d, nodes, cells, all_cells
    real(c_double), intent(in) :: x(d, nodes, cells), values(COLUMNS, nodes, all_cells)
    integer(c_int), intent(in) :: neighbour(2 * d, cells)
    real(c_double), intent(out) :: range(RANGES_OF_CELL, cells)
    call convection_ranges(x, neighbour, values, range)
  end subroutine granumat_convection_ranges

  subroutine granumat_convection_stage(d, nodes, cells, all_cells, share, fabric_limit, x_start, x_end, neighbour, opposite, wall, &
      range, start, stage, out) bind(c)
    integer(c_int), value, intent(in) :: d, nodes, cells, all_cells
    real(c_double), value, intent(in) :: share, fabric_limit
    real(c_double), intent(in) :: x_start(d, nodes, cells), x_end(d, nodes, cells), range(RANGES_OF_CELL, cells)
    integer(c_int), intent(in) :: neighbour(2 * d, cells), opposite(2, nodes, 2 * d, cells), wall(2 * d, cells)
    real(c_double), intent(in) :: start(COLUMNS, nodes, all_cells), stage(COLUMNS, nodes, all_cells)
    real(c_double), intent(out) :: out(COLUMNS, nodes, cells)
    call convection_stage(x_start, x_end, share, neighbour, opposite, wall, range, fabric_limit, start, stage, out)
  end subroutine granumat_convection_stage

  subroutine granumat_swept_volumes(d, nodes, cells, x_start, x_end, swept) bind(c)
    integer(c_int), value, intent(in) :: d, nodes, cells
    real(c_double), intent(in) :: x_start(d, nodes, cells), x_end(d, nodes, cells)
    real(c_double), intent(out) :: swept(cells)
    call swept_volumes(x_start, x_end, swept)
  end subroutine granumat_swept_volumes

end module granumat_bindings
