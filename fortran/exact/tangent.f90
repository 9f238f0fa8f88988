!> The consistent tangent of the exact update in closed form, by adjoint (reverse-mode) differentiation: docs/theory.md, section 7.
!!
!! The functions that are differentiated are six, however many derivatives are wanted: the components of the stress deviator and the
!! pressure at the end of the increment. An adjoint holds the derivatives of one of them by what evolves and by the increment. It
!! starts at the end (seed_adjoints), goes through the substeps in reverse order (adjoint_substep), and gives the derivatives by
!! strain and spin at the start (tangent_from_adjoints).
!!
!! S, |S|, tr D, W, m, S^, R and tr D^ are differentiated as if they were independent, where m is |D| and R = |D|/m is 1 without a
!! length; tangent_from_adjoints brings them together.
module granumat_tangent
  use granumat_kinds, only: dp, LANES
  use granumat_fabric, only: MAX_TERMS, adjoint_fabric
  use granumat_increment, only: increment
  use granumat_law, only: evolving_target, evolving_target_slope, excess_target_slope
  use granumat_mobilisation, only: MAX_POWER, adjoint_mobilisation
  use granumat_parameters, only: material_parameters, CRITICAL, deviator_relaxes, friction_turns
  use granumat_quadrature, only: AT_END, AT_START, MAX_DEGREE, N_NODES
  use granumat_relaxation, only: relaxation_weights_slope
  use granumat_status, only: OK
  use granumat_stress, only: pressure, pressure_factor, pressure_derivative, pressure_slopes, stress_deviator, deviator_slopes, &
    nonlocal_deviator, nonlocal_slopes, mobilised_deviator, mobilised_slopes, to_excess
  use granumat_substeps, only: internal_state, substep_record, substep_solution, take_substep
  use granumat_tensors, only: add_identity, commutator_of_spins, contract, magnitude, matrix_times, product_matrix, &
    rotation_series, spin_derivative, times, times_spin, to_voigt, transposed_times
  implicit none (type, external)
  private
  public :: consistent_tangent

  integer, parameter, public :: N_COLUMNS = 9                 ! strains 11 22 33, engineering shears 12 13 23, spins 12 13 23
  integer, parameter, public :: PLANE_COLUMNS(4) = [1, 2, 4, 7]
  integer, parameter, public :: N_ADJOINTS_3D = 6             ! five components of the deviator and the pressure
  integer, parameter, public :: N_ADJOINTS_PLANE = 4          ! the first three components and the pressure: plane strain in 1 and 2
  ! bound of the first neglected term of the adjoint of the fabric's series over its first one
  real(dp), parameter :: ADJOINT_SERIES_TOLERANCE = 1.0e-9_dp

  !> The derivatives of one function of the stress at the end: by what evolves, at the start of the substeps passed so far, and by
  !! the increment.
  type :: adjoint
    real(dp) :: A(LANES, 5), excess(LANES), log_phi(LANES)
    real(dp) :: dev(LANES, 5)             !! the relaxing deviator, or the mobilised direction, of which a closure has one at most
    real(dp) :: S(LANES, 5), w(LANES, 3)
    real(dp) :: S_hat(LANES, 5)           !! by S^ at constant R, over R, which may be 0
    real(dp), dimension(LANES) :: mod_S, tr_D, nonlocal, tr_direction
    real(dp) :: R(LANES)                  !! by R at constant S^, counted where there is a length
  end type adjoint

  !> The derivatives of one function by A and Z2 - Zc at the places in a substep.
  type :: place_adjoint
    real(dp) :: A(LANES, 5, 0:MAX_DEGREE), excess(LANES, 0:MAX_DEGREE)
  end type place_adjoint

  !> What the adjoints of all functions share in a substep, at the end and, with e_r > 0, at the places inside.
  type :: shared_derivatives
    real(dp) :: weight(LANES, 0:MAX_TERMS, MAX_DEGREE)        !! t^k, 0 where a lane needs no such term
    real(dp) :: by_y(LANES, 0:MAX_TERMS, MAX_DEGREE)          !! of Z2 - Zc there by y_k of the fabric
    real(dp), dimension(LANES, MAX_DEGREE) :: inverse_y       !! 1/y
    real(dp), dimension(LANES, MAX_DEGREE) :: by_nonlocal, by_mod_S, by_tr_D, by_log_phi   !! of Z2 - Zc there
    real(dp) :: by_mobilised(LANES, N_NODES)                  !! of Z2 - Zc at the end by the mobilised share at the nodes, over R
    integer :: terms
  end type shared_derivatives

contains

  !> The derivative of the stress at the end by strain and spin, and by the nonlocal strain; of the substeps all but the last are
  !! taken again.
  pure subroutine consistent_tangent(par, inc, x, record, n, tangent, by_nonlocal)
    type(material_parameters), intent(in) :: par
    type(increment), intent(in) :: inc
    type(internal_state), intent(in) :: x                     ! at the end
    type(substep_record), intent(inout) :: record             ! of all substeps
    integer, intent(in) :: n                                  ! functions: the first n - 1 components of the deviator, the pressure
    real(dp), intent(out) :: tangent(LANES, 6, N_COLUMNS)
    real(dp), intent(out), optional :: by_nonlocal(LANES, 6)  ! of an increment with a length
    type(adjoint) :: f(N_ADJOINTS_3D)
    type(internal_state) :: again
    integer :: i, status(LANES)

    call seed_adjoints(par, inc, x, f(:n))
    do i = record%steps, 1, -1
      if (i < record%steps) then
        again = record%earlier(i)%x
        status = OK
        call take_substep(par, inc, record%earlier(i)%share, record%earlier(i)%log_phi_end, record%earlier(i)%degree, again, &
          record%solution, status)
      end if
      call adjoint_substep(par, inc, record%solution, f(:n))
    end do
    call tangent_from_adjoints(inc, f(:n), tangent, by_nonlocal)
  end subroutine consistent_tangent

  !> The adjoints at the end of the increment: the last function is the pressure, the others are components of the deviator.
  pure subroutine seed_adjoints(par, inc, x, f)
    type(material_parameters), intent(in) :: par
    type(increment), intent(in) :: inc
    type(internal_state), intent(in) :: x
    type(adjoint), intent(out) :: f(:)
    type(pressure_derivative) :: by
    real(dp) :: one(LANES), p(LANES), by_A(LANES, 5, 5), by_S_hat(LANES, 5, 5)
    real(dp), dimension(LANES, 5) :: dev_over_p, by_R
    integer :: i, n

    n = size(f)
    by = pressure_slopes(par, x%A, inc%tr_direction, x%excess)
    do i = 1, n
      call clear(f(i))
    end do
    f(n)%A = times(by%A, x%A)
    f(n)%excess = by%excess
    f(n)%tr_direction = by%trace
    if (deviator_relaxes(par)) then
      do i = 1, n - 1
        f(i)%dev(:, i) = 1
      end do
    else if (friction_turns(par)) then
      dev_over_p = mobilised_deviator(par, x%A, x%dev)
      p = pressure(par, pressure_factor(par, x%A, inc%tr_direction), to_excess(par, x%A, x%excess))
      by_A = mobilised_slopes(par, x%A)
      do i = 1, n - 1
        f(i)%A = times(p, by_A(:, :, i)) + times(dev_over_p(:, i), f(n)%A)
        f(i)%dev(:, i) = p * par%b1
        f(i)%excess = dev_over_p(:, i) * by%excess
        f(i)%tr_direction = dev_over_p(:, i) * by%trace
      end do
    else
      one = 1
      dev_over_p = stress_deviator(par, x%A, inc%S_hat, one)
      p = pressure(par, pressure_factor(par, x%A, inc%tr_direction), x%excess)
      call deviator_slopes(par, x%A, inc%S_hat, product_matrix(inc%S_hat), p, by_A, by_S_hat)
      if (inc%has_length) then
        by_R = times(p, dev_over_p + par%a4 * x%A)
        do i = 1, n - 1
          f(i)%R = by_R(:, i)
        end do
        if (par%closure /= CRITICAL) call nonlocal_slopes(par, inc%R, p, by_A)     ! CRITICAL: A = lambda S^, so over R, too
        dev_over_p = nonlocal_deviator(par, x%A, inc%R, one, dev_over_p)
      end if
      do i = 1, n - 1
        f(i)%A = by_A(:, :, i) + times(dev_over_p(:, i), f(n)%A)
        f(i)%excess = dev_over_p(:, i) * by%excess
        f(i)%tr_direction = dev_over_p(:, i) * by%trace
        f(i)%S_hat = by_S_hat(:, i, :)
      end do
    end if
  end subroutine seed_adjoints

  pure subroutine clear(f)
    type(adjoint), intent(out) :: f
    f%A = 0
    f%dev = 0
    f%excess = 0
    f%log_phi = 0
    f%S = 0
    f%S_hat = 0
    f%w = 0
    f%mod_S = 0
    f%tr_D = 0
    f%nonlocal = 0
    f%R = 0
    f%tr_direction = 0
  end subroutine clear

  !> Takes adjoints from the end of a substep to its start.
  pure subroutine adjoint_substep(par, inc, step, f)
    type(material_parameters), intent(in) :: par
    type(increment), intent(in) :: inc
    type(substep_solution), intent(in) :: step
    type(adjoint), intent(inout) :: f(:)
    type(shared_derivatives) :: shared
    type(place_adjoint) :: at(N_ADJOINTS_3D)
    logical :: relaxes
    integer :: i, n

    n = size(f)
    do i = 1, n
      at(i)%A(:, :, AT_END) = f(i)%A
      at(i)%excess(:, AT_END) = f(i)%excess
      f(i)%tr_D = f(i)%tr_D - step%share * f(i)%log_phi
    end do
    if (deviator_relaxes(par)) call adjoint_relaxation(par, inc, step, f(:n - 1), at(:n - 1))
    if (par%closure == CRITICAL) then
      do i = 1, n
        relaxes = deviator_relaxes(par) .and. i < n
        call adjoint_critical_state(par, step, merge(AT_START, AT_END, relaxes), merge(step%last, AT_END, relaxes), at(i), f(i))
      end do
    else
      call share_derivatives(par, step, shared)
      if (friction_turns(par)) call share_friction(par, inc, step, shared)
      do i = 1, n
        relaxes = deviator_relaxes(par) .and. i < n
        call adjoint_coordination(par, step, shared, merge(step%last, AT_END, relaxes), at(i), f(i))
        if (relaxes) f(i)%A = f(i)%A + at(i)%A(:, :, AT_START)
        if (relaxes) f(i)%excess = f(i)%excess + at(i)%excess(:, AT_START)
        if (friction_turns(par)) call adjoint_friction(par, inc, step, shared, at(i)%excess(:, AT_END), f(i))
      end do
    end if
  end subroutine adjoint_substep

  !> The derivatives of Z2 - Zc at the end and the places inside, m, which all adjoints share (docs/theory.md, section 7.6), from
  !!   (Z2 - Zc)_m = decay_m [(Z2 - Zc)_0 + sum_i integrals(i, m) growth_i dt_i forcing_i],  decay_m = exp(-d2 m t_m).
  pure subroutine share_derivatives(par, step, shared)
    type(material_parameters), intent(in) :: par
    type(substep_solution), intent(in) :: step
    type(shared_derivatives), intent(out) :: shared
    real(dp), dimension(LANES, N_NODES) :: f, f_slope, kernel, before, inverse_y
    real(dp), dimension(LANES) :: t, decay, power
    real(dp) :: needed(LANES, 0:MAX_TERMS)               ! 1 where a lane needs the term, else 0
    real(dp) :: by_y(LANES, N_NODES, 0:MAX_TERMS)        ! of d1 A : S = -d1 y'/(c3 y) by y_k
    integer :: i, k, m

    shared%terms = count([(any(step%fabric%bound(:, i) >= ADJOINT_SERIES_TOLERANCE), i = 0, step%fabric%terms - 1)])
    do i = 1, N_NODES
      f(:, i) = evolving_target(par, step%phi(:, i) - par%phic)
      f_slope(:, i) = par%d2 * step%nonlocal * step%phi(:, i) * evolving_target_slope(par, step%phi(:, i) - par%phic)
    end do
    inverse_y = 1 / step%y
    before = 1
    needed(:, 0) = 1
    by_y(:, :, 0) = 0
    do k = 1, shared%terms                              ! by lane: a point's tangent does not depend on its neighbours
      needed(:, k) = merge(1.0_dp, 0.0_dp, step%fabric%bound(:, k - 1) >= ADJOINT_SERIES_TOLERANCE)
      do i = 1, N_NODES
        by_y(:, i, k) = -par%d1 * needed(:, k) * before(:, i) * (k / par%c3 + step%t(:, i) * step%A_S(:, i)) &
          * inverse_y(:, i)
        before(:, i) = before(:, i) * step%t(:, i)
      end do
    end do
    do m = AT_END, step%last
      t = step%t_place(:, m)
      decay = step%decay_place(:, m)
      shared%inverse_y(:, m) = 1 / step%y_place(:, m)
      do i = 1, N_NODES
        kernel(:, i) = step%integrals(:, i, m) * step%growth(:, i) * step%dt(:, i) * decay
      end do
      shared%by_mod_S(:, m) = 0
      shared%by_nonlocal(:, m) = -t * step%excess(:, m)
      shared%by_tr_D(:, m) = 0
      shared%by_log_phi(:, m) = 0
      do i = 1, N_NODES
        shared%by_mod_S(:, m) = shared%by_mod_S(:, m) + kernel(:, i)
        shared%by_nonlocal(:, m) = shared%by_nonlocal(:, m) &
          + step%integrals(:, i, m) * decay * step%t(:, i) * step%integrand(:, i) + kernel(:, i) * f(:, i)
        shared%by_tr_D(:, m) = shared%by_tr_D(:, m) - kernel(:, i) * f_slope(:, i) * step%t(:, i)
        shared%by_log_phi(:, m) = shared%by_log_phi(:, m) + kernel(:, i) * f_slope(:, i)
      end do
      shared%by_tr_D(:, m) = step%share * (shared%by_tr_D(:, m) + par%d3 * shared%by_mod_S(:, m))
      shared%by_mod_S(:, m) = -par%d1 * (par%chi * (step%share * shared%by_mod_S(:, m)))
      shared%by_nonlocal(:, m) = par%d2 * step%share * shared%by_nonlocal(:, m)
      power = 1
      do k = 0, shared%terms
        shared%weight(:, k, m) = needed(:, k) * power
        shared%by_y(:, k, m) = kernel(:, 1) * by_y(:, 1, k) + kernel(:, 2) * by_y(:, 2, k) + kernel(:, 3) * by_y(:, 3, k) &
          + kernel(:, 4) * by_y(:, 4, k)
        power = power * t
      end do
    end do
  end subroutine share_derivatives

  !> Those of them in which the mobilised share of friction appears, at the end of the substep.
  pure subroutine share_friction(par, inc, step, shared)
    type(material_parameters), intent(in) :: par
    type(increment), intent(in) :: inc
    type(substep_solution), intent(in) :: step
    type(shared_derivatives), intent(inout) :: shared
    real(dp) :: by_loss(LANES)                           ! of Z2 - Zc by share |S| at a node
    real(dp) :: over_R(LANES)                            ! |S|/R
    integer :: i

    over_R = magnitude(times(step%nonlocal, inc%S_hat))
    do i = 1, N_NODES
      by_loss = -par%d1 * par%chi * step%integrals(:, i, AT_END) * step%growth(:, i) * step%dt(:, i) * step%decay_place(:, AT_END)
      shared%by_mod_S(:, AT_END) = shared%by_mod_S(:, AT_END) - step%share * (1 - step%mobilised(:, i)) * by_loss
      shared%by_mobilised(:, i) = merge(over_R * by_loss, 0.0_dp, step%mobilised(:, i) > 0)
    end do
  end subroutine share_friction

  !> The adjoints of the coordination number and the fabric: to A and Z2 - Zc at the start.
  pure subroutine adjoint_coordination(par, step, shared, last, at, f)
    type(material_parameters), intent(in) :: par
    type(substep_solution), intent(in) :: step
    type(shared_derivatives), intent(in) :: shared
    integer, intent(in) :: last                          ! of the places at which the function depends on A and Z2
    type(place_adjoint), intent(in) :: at
    type(adjoint), intent(inout) :: f
    real(dp) :: g_B(LANES, 5, 0:MAX_TERMS), g_y(LANES, 0:MAX_TERMS), by_B(LANES, 5, MAX_DEGREE), by_y(LANES, MAX_DEGREE)
    real(dp) :: by_S(LANES, 5), by_decay(LANES), by_spin(LANES, 3)
    integer :: j, k, m

    f%excess = 0
    do m = AT_END, last
      f%excess = f%excess + at%excess(:, m) * step%decay_place(:, m)
      f%nonlocal = f%nonlocal + at%excess(:, m) * shared%by_nonlocal(:, m)
      f%mod_S = f%mod_S + at%excess(:, m) * shared%by_mod_S(:, m)
      f%tr_D = f%tr_D + at%excess(:, m) * shared%by_tr_D(:, m)
      f%log_phi = f%log_phi + at%excess(:, m) * shared%by_log_phi(:, m)
      by_B(:, :, m) = times(shared%inverse_y(:, m), at%A(:, :, m))
      by_y(:, m) = -contract(by_B(:, :, m), step%A(:, :, m))
    end do
    do k = 0, shared%terms
      g_y(:, k) = shared%weight(:, k, AT_END) * by_y(:, AT_END) + shared%by_y(:, k, AT_END) * at%excess(:, AT_END)
      do j = 1, 5
        g_B(:, j, k) = shared%weight(:, k, AT_END) * by_B(:, j, AT_END)
      end do
    end do
    do m = AT_END + 1, last
      do k = 0, shared%terms
        g_y(:, k) = g_y(:, k) + shared%weight(:, k, m) * by_y(:, m) + shared%by_y(:, k, m) * at%excess(:, m)
        do j = 1, 5
          g_B(:, j, k) = g_B(:, j, k) + shared%weight(:, k, m) * by_B(:, j, m)
        end do
      end do
    end do
    call adjoint_fabric(step%fabric, shared%terms, g_B, g_y, f%A, by_S, by_decay, by_spin)
    f%S = f%S + times(step%share, by_S)
    f%nonlocal = f%nonlocal + par%c2 * step%share * by_decay
    f%w = f%w + times_spin(step%share, by_spin)
  end subroutine adjoint_coordination

  !> The adjoint of the mobilised direction of friction, on which Z2 - Zc depends at the nodes and the stress at the end.
  pure subroutine adjoint_friction(par, inc, step, shared, by_excess, f)
    type(material_parameters), intent(in) :: par
    type(increment), intent(in) :: inc
    type(substep_solution), intent(in) :: step
    type(shared_derivatives), intent(in) :: shared
    real(dp), intent(in) :: by_excess(LANES)             ! of the function by Z2 - Zc at the end
    type(adjoint), intent(inout) :: f
    real(dp) :: g(LANES, 5, 0:MAX_POWER), by_S_hat(LANES, 5), weight(LANES, N_NODES)
    real(dp) :: by_R(LANES), by_nonlocal(LANES), by_spin(LANES, 3)
    integer :: i, k

    do i = 1, N_NODES
      weight(:, i) = by_excess * shared%by_mobilised(:, i) / 2       ! of the projection at the node, over R; then times t^k
    end do
    if (inc%has_length) then                                         ! S^ - S/m in the projection, (1 - R) S^
      f%S_hat = f%S_hat + times(2 * sum(weight, 2), times(1 - inc%R, inc%S_hat))
      f%R = f%R - inc%R * sum(weight, 2) * contract(inc%S_hat, inc%S_hat)
    end if
    do k = 0, step%mobilisation%terms
      g(:, :, k) = f%dev + times(inc%R * sum(weight, 2), inc%S_hat)
      f%S_hat = f%S_hat + times(sum(weight, 2), step%mobilisation%M(:, :, k))
      weight = weight * step%t
    end do
    call adjoint_mobilisation(par, step%mobilisation, inc%S_hat, inc%R, step%nonlocal, step%w, g, f%dev, by_S_hat, by_R, &
      by_nonlocal, by_spin)
    f%S_hat = f%S_hat + by_S_hat
    if (inc%has_length) f%R = f%R + by_R
    f%nonlocal = f%nonlocal + step%share * by_nonlocal
    f%w = f%w + times_spin(step%share, by_spin)
  end subroutine adjoint_friction

  !> The adjoint of the critical-state closure, A = lambda S^ and Z2 = f(phi).
  pure subroutine adjoint_critical_state(par, step, first, last, at, f)
    type(material_parameters), intent(in) :: par
    type(substep_solution), intent(in) :: step
    integer, intent(in) :: first, last                   ! of the places at which the function depends on A and Z2
    type(place_adjoint), intent(in) :: at
    type(adjoint), intent(inout) :: f
    real(dp), dimension(LANES) :: phi, by_log_phi
    integer :: m

    do m = first, last
      phi = step%phi_place(:, m)
      by_log_phi = at%excess(:, m) * excess_target_slope(par, phi - par%phic) * phi
      f%log_phi = f%log_phi + by_log_phi
      f%tr_D = f%tr_D - step%t_place(:, m) * step%share * by_log_phi
      f%S_hat = f%S_hat + par%lambda * at%A(:, :, m)
    end do
    f%A = 0
    f%excess = 0
  end subroutine adjoint_critical_state

  !> The adjoint of the relaxing deviator: to the deviator at the start, to the spin and m, and to A and Z2 - Zc at the
  !! places through the model's stress there.
  pure subroutine adjoint_relaxation(par, inc, step, f, at)
    type(material_parameters), intent(in) :: par
    type(increment), intent(in) :: inc
    type(substep_solution), intent(in) :: step
    type(adjoint), intent(inout) :: f(:)                  ! components of the deviator
    type(place_adjoint), intent(inout) :: at(:)
    real(dp) :: by_nonlocal(LANES, 5), rotated(LANES, 5, 0:2), twice(LANES, 3), q(LANES, 5), by_p(LANES)
    real(dp), dimension(LANES, 5, 5) :: S_matrix, by_A, by_S_hat
    type(pressure_derivative) :: by
    integer :: i, m

    if (inc%has_length) call adjoint_ratio(par, inc, step, f)
    call share_rotations(par, step, by_nonlocal, rotated)
    do i = 1, size(f)
      f(i)%nonlocal = f(i)%nonlocal + contract(f(i)%dev, by_nonlocal)
      twice = commutator_of_spins(step%w, spin_derivative(f(i)%dev, rotated(:, :, 2)))
      f(i)%w = f(i)%w + times_spin(step%share, spin_derivative(f(i)%dev, rotated(:, :, 0)) &
        + commutator_of_spins(step%w, twice - spin_derivative(f(i)%dev, rotated(:, :, 1))))
    end do
    S_matrix = product_matrix(inc%S_hat)
    do m = step%last, AT_START, -1
      by = pressure_slopes(par, step%A(:, :, m), inc%tr_direction, step%excess(:, m))
      call deviator_slopes(par, step%A(:, :, m), inc%S_hat, S_matrix, step%p(:, m), by_A, by_S_hat)
      if (inc%has_length .and. par%closure /= CRITICAL) call nonlocal_slopes(par, inc%R, step%p(:, m), by_A)
      do i = 1, size(f)
        q = f(i)%dev
        if (m /= AT_END) q = transposed_times(step%R(:, :, :, m), q)
        if (m == AT_START) f(i)%dev = times(step%decay, q)
        q = times(step%weights(:, m), q)
        by_p = contract(q, step%dev_over_p(:, :, m))
        f(i)%tr_direction = f(i)%tr_direction + by_p * by%trace
        f(i)%S_hat = f(i)%S_hat + transposed_times(by_S_hat, q)
        q = transposed_times(by_A, q) + times(by_p * by%A, step%A(:, :, m))
        by_p = by_p * by%excess
        if (m == AT_END) q = q + f(i)%A
        if (m == AT_END) by_p = by_p + f(i)%excess
        at(i)%A(:, :, m) = q
        at(i)%excess(:, m) = by_p
      end do
    end do
  end subroutine adjoint_relaxation

  !> The adjoint of R = |D|/m at constant S^, to which the model's deviator but for -a4 p A is proportional.
  pure subroutine adjoint_ratio(par, inc, step, f)
    type(material_parameters), intent(in) :: par
    type(increment), intent(in) :: inc
    type(substep_solution), intent(in) :: step
    type(adjoint), intent(inout) :: f(:)                  ! components of the deviator
    real(dp), dimension(LANES, 5) :: by_R, dev
    real(dp) :: one(LANES)
    integer :: i, m

    one = 1
    by_R = 0
    do m = AT_START, step%last
      dev = times(step%p(:, m), stress_deviator(par, step%A(:, :, m), inc%S_hat, one) + par%a4 * step%A(:, :, m))
      if (m /= AT_END) dev = matrix_times(step%R(:, :, :, m), dev)
      by_R = by_R + times(step%weights(:, m), dev)
    end do
    do i = 1, size(f)
      f(i)%R = f(i)%R + contract(f(i)%dev, by_R)
    end do
  end subroutine adjoint_ratio

  !> The derivative of the relaxing deviator by m, and sums from which follows that by the spin.
  !!
  !! With V a change of the spin w, a rotation exp(w u) changes by the spin
  !!   u V + u^2 second [w, V] + u^3 third [w, [w, V]],  second = (1 - cos(a))/a^2, third = (a - sin(a))/a^3, a the angle of w u.
  !! rotated(:, :, 0:2) are the deviators rotated to the end, weighted and summed with the factors of these three terms.
  pure subroutine share_rotations(par, step, by_nonlocal, rotated)
    type(material_parameters), intent(in) :: par
    type(substep_solution), intent(in) :: step
    real(dp), intent(out) :: by_nonlocal(LANES, 5), rotated(LANES, 5, 0:2)
    real(dp) :: u(LANES, 0:MAX_DEGREE), slopes(LANES, 0:MAX_DEGREE), second(LANES), third(LANES), weight(LANES)
    integer :: m

    do m = AT_START, step%last
      u(:, m) = 1 - step%t_place(:, m)
    end do
    slopes = relaxation_weights_slope(step%nonlocal / par%elastic_strain, step%decay, u, step%degree, step%last)
    call rotation_series(step%w, second, third)
    by_nonlocal = -step%decayed
    rotated(:, :, 0) = step%decayed
    rotated(:, :, 1) = times(second, step%decayed)
    rotated(:, :, 2) = times(third, step%decayed)
    do m = AT_START, step%last
      by_nonlocal = by_nonlocal + times(slopes(:, m), step%rotated(:, :, m))
      call rotation_series(times_spin(u(:, m), step%w), second, third)
      weight = step%weights(:, m) * u(:, m)
      rotated(:, :, 0) = rotated(:, :, 0) + times(weight, step%rotated(:, :, m))
      rotated(:, :, 1) = rotated(:, :, 1) + times(weight * u(:, m) * second, step%rotated(:, :, m))
      rotated(:, :, 2) = rotated(:, :, 2) + times(weight * u(:, m)**2 * third, step%rotated(:, :, m))
    end do
    by_nonlocal = times(step%share / par%elastic_strain, by_nonlocal)
  end subroutine share_rotations

  !> The derivatives of the stress at the end, tension positive, by strain and spin, and by m, from adjoints at the start of the
  !! increment.
  pure subroutine tangent_from_adjoints(inc, f, tangent, by_nonlocal)
    type(increment), intent(in) :: inc
    type(adjoint), intent(in) :: f(:)
    real(dp), intent(out) :: tangent(LANES, 6, N_COLUMNS)
    real(dp), intent(out), optional :: by_nonlocal(LANES, 6)
    real(dp) :: rows(LANES, N_COLUMNS, N_ADJOINTS_3D), by_m(LANES, N_ADJOINTS_3D), strain(LANES, 6)
    real(dp), dimension(LANES) :: inverse, inverse_S, by_mod_D, by_trace, by_tr_D
    integer :: i, j, n, row

    n = size(f)
    inverse = 1 / max(inc%nonlocal, tiny(1.0_dp))
    inverse_S = 1 / max(2 * magnitude(inc%S_hat), tiny(1.0_dp))          ! of |S|/|D|
    rows(:, :, n:) = 0
    by_m(:, n:) = 0
    do i = 1, n
      row = merge(i, N_ADJOINTS_3D, i < n)
      by_mod_D = f(i)%nonlocal
      by_trace = f(i)%tr_direction
      if (inc%has_length) then                                           ! |D| is in S^ and R only
        by_m(:, row) = f(i)%nonlocal - inverse * (inc%R * f(i)%R + f(i)%tr_direction * inc%tr_direction)
        by_mod_D = inverse * f(i)%R
        by_trace = 0
      end if
      by_mod_D = (by_mod_D - inverse * (contract(f(i)%S_hat, inc%S_hat) + by_trace * inc%tr_direction)) / 2
      by_tr_D = f(i)%tr_D + inverse * f(i)%tr_direction
      strain = to_voigt(f(i)%S + times(inverse, f(i)%S_hat) + times(inverse_S * f(i)%mod_S, inc%S_hat))
      do j = 1, 6
        strain(:, j) = strain(:, j) + by_mod_D * inc%direction(:, j)
      end do
      do j = 1, 3
        strain(:, j) = strain(:, j) + by_tr_D
      end do
      rows(:, :6, row) = strain
      rows(:, 7:, row) = f(i)%w
    end do
    do j = 1, N_COLUMNS
      tangent(:, :, j) = add_identity(to_voigt(rows(:, j, :5)), -rows(:, j, 6))
    end do
    if (present(by_nonlocal)) by_nonlocal = add_identity(to_voigt(by_m(:, :5)), -by_m(:, 6))
  end subroutine tangent_from_adjoints

end module granumat_tangent
