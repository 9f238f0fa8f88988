!> Usual methods that integrate the law's rate form, to compare the exact update with. Nothing else uses them.
!!
!! One step over the whole increment, except Bogacki & Shampine's embedded pair, which takes substeps until its error estimate is
!! below a tolerance. The spin is integrated with the rest, or states are rotated before they are strained, as UMATs usually do.
module granumat_methods
  use granumat_kinds, only: dp, LANES
  use granumat_status, only: OK, BAD_PARAMETERS, BAD_VOLUME_FRACTION, FABRIC_BLOWS_UP, INCREMENT_TOO_LARGE, NOT_CONVERGED, &
    RESULT_NOT_FINITE
  use granumat_increment, only: increment, to_increment, without_spin
  use granumat_law, only: coordination_rate, critical_state, excess_target, fabric_rate, relaxation_rate
  use granumat_matrices, only: solve_linear
  use granumat_parameters, only: material_parameters, CRITICAL, friction_turns
  use granumat_state, only: lane_state, REALISABLE
  use granumat_stress, only: model_deviator, pressure, pressure_factor
  use granumat_substeps, only: internal_state, MAX_SUBSTEPS
  use granumat_tensors, only: contract, corotate, magnitude, times
  use granumat_update, only: complete, rotated, status_before, to_internal, to_state, update
  implicit none (type, external)
  private
  public :: update_by_method, is_exact

  integer, parameter :: EXACT = 0, FORWARD_EULER = 1, MIDPOINT = 2, RK4 = 3, BOGACKI_SHAMPINE = 4, BACKWARD_EULER = 5
  integer, parameter :: INSIDE = 0, BEFORE = 1           ! spin integrated with the rest; states rotated before they are strained

  !> How increments are integrated.
  type, public :: scheme
    integer :: method = EXACT
    integer :: spin = INSIDE
    real(dp) :: tolerance = 1.0e-6_dp    !! of the embedded pair's relative error estimate, in (0, 1)
  end type scheme

  ! What evolves, side by side: A in 1 ... 5, and from I_DEV on the deviatoric stress (constant for e_r = 0), tension positive.
  integer, parameter :: I_EXCESS = 6, I_PHI = 7, I_DEV = 8, N_EVOLVING = 12

  ! Explicit methods whose stages need the one before only: stage i starts at y + NODE(i - 1) k(i - 1).
  real(dp), parameter :: NO_NODE(0) = 0, EULER_WEIGHT(1) = 1
  real(dp), parameter :: MIDPOINT_NODE(1) = 0.5_dp, MIDPOINT_WEIGHT(2) = [0, 1]
  real(dp), parameter :: RK4_NODE(3) = [0.5_dp, 0.5_dp, 1.0_dp], RK4_WEIGHT(4) = [1, 2, 2, 1] / 6.0_dp

  ! P. Bogacki, L. F. Shampine, Appl. Math. Lett. 2 (1989) 321-325, doi:10.1016/0893-9659(89)90079-7
  real(dp), parameter :: BS_NODE(2) = [0.5_dp, 0.75_dp], BS_WEIGHT(3) = [2, 3, 4] / 9.0_dp
  real(dp), parameter :: BS_ERROR(4) = [-5, 6, 8, -9] / 72.0_dp      ! third minus second order
  ! Control of the substep: S. W. Sloan, A. J. Abbo, D. Sheng, Eng. Comput. 18 (2001) 121-194, doi:10.1108/02644400110365842
  real(dp), parameter :: SAFETY = 0.9_dp, SHRINK = 0.1_dp, GROWTH = 2.0_dp
  real(dp), parameter :: SMALLEST_STEP = 1.0e-9_dp                   ! of the increment

  integer, parameter :: MAX_ITERATIONS = 20
  real(dp), parameter :: LAST_CHANGE = 1.0e-8_dp    ! of A over kappa; convergence is quadratic, so the next one is its square

contains

  !> Whether a scheme is one of those above.
  pure function is_valid(by) result(valid)
    type(scheme), intent(in) :: by
    logical :: valid
    valid = by%method >= EXACT .and. by%method <= BACKWARD_EULER .and. by%spin >= INSIDE .and. by%spin <= BEFORE &
      .and. by%tolerance > 0 .and. by%tolerance < 1
  end function is_valid

  !> Whether a scheme is the exact update itself.
  pure function is_exact(by) result(exactly)
    type(scheme), intent(in) :: by
    logical :: exactly
    exactly = by%method == EXACT .and. by%spin == INSIDE
  end function is_exact

  !> The states at the end of strain increments by a scheme; arguments as in update.
  pure subroutine update_by_method(par, by, old, strain, spin, new, status)
    type(material_parameters), intent(in) :: par
    type(scheme), intent(in) :: by
    type(lane_state), intent(in) :: old
    real(dp), intent(in) :: strain(LANES, 6), spin(LANES, 3)
    type(lane_state), intent(out) :: new
    integer, intent(out) :: status(LANES)
    type(increment) :: inc
    type(lane_state) :: start
    logical :: moves(LANES)

    new = old
    status = BAD_PARAMETERS
    if (.not. is_valid(by) .or. (friction_turns(par) .and. by%method /= EXACT)) return
    status = status_before(old, strain, spin)
    call to_increment(strain, spin, status == OK, inc)
    moves = inc%mod_D > 0
    start = old
    if (by%spin == BEFORE) start = rotated(old, inc%spin)
    if (by%method == EXACT) then
      call update(par, start, strain, merge(0, 1, by%spin == BEFORE) * inc%spin, new, status)
    else
      call deform(par, by, start, without_spin(inc, by%spin == BEFORE .or. .not. moves), new, status)
    end if
    call complete(old, inc%spin, moves, new, status)
  end subroutine update_by_method

  !> The update where D /= 0 by any method but the exact one.
  pure subroutine deform(par, by, start, inc, new, status)
    type(material_parameters), intent(in) :: par
    type(scheme), intent(in) :: by
    type(lane_state), intent(in) :: start
    type(increment), intent(in) :: inc
    type(lane_state), intent(out) :: new
    integer, intent(inout) :: status(LANES)
    type(internal_state) :: x
    real(dp) :: y(LANES, N_EVOLVING)

    call to_internal(par, start, x)
    y(:, :5) = x%A
    y(:, I_EXCESS) = x%excess
    y(:, I_PHI) = x%phi
    y(:, I_DEV:) = x%dev
    call integrate_by_method(par, by, inc, y, status)
    x%A = y(:, :5)
    x%excess = y(:, I_EXCESS)
    x%phi = y(:, I_PHI)
    x%dev = y(:, I_DEV:)
    if (.not. par%elastic_strain > 0) x%dev = model_deviator(par, x%A, inc%S_hat, inc%tr_direction, x%excess)
    new%volume_fraction = x%phi
    call to_state(par, start, inc, x, new, status)
  end subroutine deform

  !> The rate form: dy/dt.
  pure function rates(par, inc, y) result(dot_y)
    type(material_parameters), intent(in) :: par
    type(increment), intent(in) :: inc
    real(dp), intent(in) :: y(LANES, N_EVOLVING)
    real(dp) :: dot_y(LANES, N_EVOLVING), A(LANES, 5), S(LANES, 5), model(LANES, 5)
    real(dp), dimension(LANES) :: excess, missing

    A = y(:, :5)
    excess = y(:, I_EXCESS)
    dot_y = 0
    dot_y(:, I_PHI) = -y(:, I_PHI) * inc%tr_D
    if (par%closure == CRITICAL) then
      call critical_state(par, inc%S_hat, y(:, I_PHI), A, excess)
    else
      S = times(inc%mod_D, inc%S_hat)
      missing = excess_target(par, y(:, I_PHI) - par%phic) - excess
      dot_y(:, :5) = fabric_rate(par, A, S, inc%mod_D, inc%spin)
      dot_y(:, I_EXCESS) = coordination_rate(par, contract(A, S), magnitude(S), inc%mod_D, missing, inc%tr_D)
    end if
    if (par%elastic_strain > 0) then
      model = model_deviator(par, A, inc%S_hat, inc%tr_direction, excess)
      dot_y(:, I_DEV:) = relaxation_rate(par, y(:, I_DEV:), model, inc%mod_D, inc%spin)
    end if
  end function rates

  !> Brings y over the increment.
  pure subroutine integrate_by_method(par, by, inc, y, status)
    type(material_parameters), intent(in) :: par
    type(scheme), intent(in) :: by
    type(increment), intent(in) :: inc
    real(dp), intent(inout) :: y(LANES, N_EVOLVING)
    integer, intent(inout) :: status(LANES)
    real(dp) :: mod_A_old(LANES), mod_A(LANES), A(LANES, 5), excess(LANES)

    A = y(:, :5)
    excess = y(:, I_EXCESS)
    mod_A_old = magnitude(A)
    select case (by%method)
    case (FORWARD_EULER)
      call one_step(par, inc, NO_NODE, EULER_WEIGHT, y, status)
    case (MIDPOINT)
      call one_step(par, inc, MIDPOINT_NODE, MIDPOINT_WEIGHT, y, status)
    case (RK4)
      call one_step(par, inc, RK4_NODE, RK4_WEIGHT, y, status)
    case (BOGACKI_SHAMPINE)
      call embedded_pair(par, by%tolerance, inc, y, status)
    case default                               ! BACKWARD_EULER
      call implicit_step(par, inc, y, status)
    end select
    where (status == OK) status = status_of(y)
    if (par%closure == CRITICAL) then
      call critical_state(par, inc%S_hat, y(:, I_PHI), A, excess)
      y(:, :5) = A
      y(:, I_EXCESS) = excess
    else      ! below the limit no exact |A| can come above it (docs/theory.md, section 2.7): only a method can bring it there
      mod_A = magnitude(y(:, :5))
      where (status == OK .and. mod_A > par%fabric_limit .and. mod_A > mod_A_old) status = FABRIC_BLOWS_UP
    end if
  end subroutine integrate_by_method

  !> Whether y is a state of a granular solid.
  pure function status_of(y) result(status)
    real(dp), intent(in) :: y(LANES, N_EVOLVING)
    integer :: status(LANES)
    status = OK
    where (.not. (y(:, I_PHI) > 0 .and. y(:, I_PHI) < 1)) status = BAD_VOLUME_FRACTION
    where (.not. magnitude(y(:, :5)) < REALISABLE) status = FABRIC_BLOWS_UP
    where (.not. sum(abs(y), 2) <= huge(1.0_dp)) status = RESULT_NOT_FINITE
  end function status_of

  !> The whole increment at once.
  pure subroutine one_step(par, inc, node, weight, y, status)
    type(material_parameters), intent(in) :: par
    type(increment), intent(in) :: inc
    real(dp), intent(in) :: node(:), weight(:)
    real(dp), intent(inout) :: y(LANES, N_EVOLVING)
    integer, intent(inout) :: status(LANES)
    real(dp) :: k(LANES, N_EVOLVING, size(weight)), y_new(LANES, N_EVOLVING)

    k(:, :, 1) = rates(par, inc, y)
    call explicit_step(par, inc, spread(1.0_dp, 1, LANES), node, weight, y, k, y_new, status)
    y = y_new
  end subroutine one_step

  !> A Runge-Kutta step over shares h of the increment. Stages that are no states show in the status.
  pure subroutine explicit_step(par, inc, h, node, weight, y, k, y_new, status)
    type(material_parameters), intent(in) :: par
    type(increment), intent(in) :: inc
    real(dp), intent(in) :: h(LANES), node(:), weight(:), y(LANES, N_EVOLVING)
    real(dp), intent(inout) :: k(:, :, :)        ! (LANES, N_EVOLVING, stages): rates, the first given
    real(dp), intent(out) :: y_new(LANES, N_EVOLVING)
    integer, intent(inout) :: status(LANES)
    integer :: i

    do i = 1, size(node)
      y_new = y + scaled(node(i) * h, k(:, :, i))
      where (status == OK) status = status_of(y_new)
      k(:, :, i + 1) = rates(par, inc, y_new)
    end do
    y_new = y
    do i = 1, size(weight)
      y_new = y_new + scaled(weight(i) * h, k(:, :, i))
    end do
  end subroutine explicit_step

  pure function scaled(h, k) result(change)
    real(dp), intent(in) :: h(LANES), k(LANES, N_EVOLVING)
    real(dp) :: change(LANES, N_EVOLVING)
    integer :: j
    do j = 1, N_EVOLVING
      change(:, j) = h * k(:, j)
    end do
  end function scaled

  !> Substeps of the embedded pair, as long as the tolerance allows; the first one tried is the whole increment.
  pure subroutine embedded_pair(par, tolerance, inc, y, status)
    type(material_parameters), intent(in) :: par
    real(dp), intent(in) :: tolerance
    type(increment), intent(in) :: inc
    real(dp), intent(inout) :: y(LANES, N_EVOLVING)
    integer, intent(inout) :: status(LANES)
    real(dp) :: k(LANES, N_EVOLVING, 4), y_new(LANES, N_EVOLVING), estimate(LANES, N_EVOLVING)
    real(dp), dimension(LANES) :: done, h, factor, largest_factor, error
    logical, dimension(LANES) :: active, accepted
    integer :: attempt, i, tried(LANES)

    done = 0
    h = 1
    largest_factor = GROWTH
    k(:, :, 1) = rates(par, inc, y)
    do attempt = 1, MAX_SUBSTEPS
      active = status == OK .and. done < 1
      if (.not. any(active)) return
      h = min(h, 1 - done)
      tried = OK
      call explicit_step(par, inc, h, BS_NODE, BS_WEIGHT, y, k(:, :, :3), y_new, tried)
      where (tried == OK) tried = status_of(y_new)
      k(:, :, 4) = rates(par, inc, y_new)
      estimate = 0
      do i = 1, 4
        estimate = estimate + scaled(BS_ERROR(i) * h, k(:, :, i))
      end do
      error = relative_error(par, inc, y, y_new, estimate)
      where (tried == OK .and. .not. error <= huge(1.0_dp)) tried = RESULT_NOT_FINITE
      accepted = active .and. tried == OK .and. error <= tolerance
      do i = 1, N_EVOLVING
        y(:, i) = merge(y_new(:, i), y(:, i), accepted)
        k(:, i, 1) = merge(k(:, i, 4), k(:, i, 1), accepted)          ! the last stage is the next step's first
      end do
      done = merge(merge(1.0_dp, done + h, h >= 1 - done), done, accepted)
      where (active .and. .not. accepted .and. h < SMALLEST_STEP) status = merge(tried, INCREMENT_TOO_LARGE, tried /= OK)
      factor = SHRINK
      where (tried == OK) factor = max(SHRINK, min(largest_factor, &
        SAFETY * (tolerance / max(error, tiny(1.0_dp)))**(1.0_dp / 3)))
      largest_factor = merge(GROWTH, 1.0_dp, accepted)                ! no growth just after a step that failed
      h = factor * h
    end do
    where (status == OK .and. done < 1) status = INCREMENT_TOO_LARGE
  end subroutine embedded_pair

  !> The largest relative error of A, Z2, phi and sigma'; none is taken relative to less than what is usual for it.
  pure function relative_error(par, inc, y_old, y, estimate) result(error)
    type(material_parameters), intent(in) :: par
    type(increment), intent(in) :: inc
    real(dp), intent(in), dimension(LANES, N_EVOLVING) :: y_old, y, estimate
    real(dp) :: error(LANES), p(LANES)

    error = max(magnitude(estimate(:, :5)) / max(magnitude(y(:, :5)), par%kappa), &
      abs(estimate(:, I_EXCESS)) / max(par%Zc + y(:, I_EXCESS), par%Zc), abs(estimate(:, I_PHI)) / y(:, I_PHI))
    if (par%elastic_strain > 0) then
      p = pressure(par, pressure_factor(par, y(:, :5), inc%tr_direction), y(:, I_EXCESS))
      error = max(error, magnitude(estimate(:, I_DEV:)) &
        / max(magnitude(y_old(:, I_DEV:)), magnitude(y(:, I_DEV:)), p, tiny(1.0_dp)))
    end if
  end function relative_error

  !> Backward Euler: phi, Z2 and sigma' follow one after the other, from A, for which Newton's method is needed.
  pure subroutine implicit_step(par, inc, y, status)
    type(material_parameters), intent(in) :: par
    type(increment), intent(in) :: inc
    real(dp), intent(inout) :: y(LANES, N_EVOLVING)
    integer, intent(inout) :: status(LANES)
    real(dp), dimension(LANES, 5) :: A, S, dev
    real(dp), dimension(LANES) :: ratio, target_excess, excess, determinant_sign

    y(:, I_PHI) = y(:, I_PHI) / (1 + inc%tr_D)
    A = y(:, :5)
    excess = y(:, I_EXCESS)
    if (par%closure == CRITICAL) then
      call critical_state(par, inc%S_hat, y(:, I_PHI), A, excess)
    else
      S = times(inc%mod_D, inc%S_hat)
      call implicit_fabric(par, inc, S, A, status)
      target_excess = excess_target(par, y(:, I_PHI) - par%phic)
      excess = (excess + coordination_rate(par, contract(A, S), magnitude(S), inc%mod_D, target_excess, inc%tr_D)) &
        / (1 + par%d2 * inc%mod_D)                               ! (4.8) is linear in Z2
    end if
    y(:, :5) = A
    y(:, I_EXCESS) = excess
    if (par%elastic_strain > 0) then
      ratio = inc%mod_D / par%elastic_strain
      S = 0
      dev = y(:, I_DEV:) + times(ratio, model_deviator(par, A, inc%S_hat, inc%tr_direction, excess))
      call solve_linear(implicit_matrix(1 + ratio, inc%spin, S, S), dev, determinant_sign)
      y(:, I_DEV:) = dev
    end if
  end subroutine implicit_step

  !> (4.7) by backward Euler, with Newton's method.
  !!
  !! It starts from lambda S^, the attractor without spin (A 9): from there it finds the root that belongs to small increments,
  !! whatever the increment. Where the fabric can blow up it starts from the old fabric instead, and either grows without end or
  !! finds a root beyond the singularity, where the determinant or the factor of A is no longer positive.
  pure subroutine implicit_fabric(par, inc, S, A, status)
    type(material_parameters), intent(in) :: par
    type(increment), intent(in) :: inc
    real(dp), intent(in) :: S(LANES, 5)
    real(dp), intent(inout) :: A(LANES, 5)
    integer, intent(inout) :: status(LANES)
    real(dp) :: A_old(LANES, 5), change(LANES, 5), factor(LANES), determinant_sign(LANES)
    logical, dimension(LANES) :: active, converged, tame
    integer :: iteration, j

    A_old = A
    tame = magnitude(A) <= par%fabric_limit
    do j = 1, 5
      A(:, j) = merge(par%lambda * inc%S_hat(:, j), A(:, j), tame)
    end do
    active = status == OK
    do iteration = 1, MAX_ITERATIONS
      factor = 1 - par%c2 * inc%mod_D - par%c3 * contract(A, S)
      change = A_old - A + fabric_rate(par, A, S, inc%mod_D, inc%spin)
      call solve_linear(implicit_matrix(factor, inc%spin, par%c3 * A, S), change, determinant_sign)
      do j = 1, 5
        A(:, j) = merge(A(:, j) + change(:, j), A(:, j), active)
      end do
      converged = active .and. magnitude(change) <= LAST_CHANGE * par%kappa
      where (converged .and. .not. (factor > 0 .and. determinant_sign > 0)) status = FABRIC_BLOWS_UP
      active = active .and. .not. converged
      if (.not. any(active)) return
    end do
    where (active) status = NOT_CONVERGED
  end subroutine implicit_fabric

  !> The matrix of T -> factor T - (W T - T W) - (S : T) A.
  pure function implicit_matrix(factor, w, A, S) result(matrix)
    real(dp), intent(in) :: factor(LANES), w(LANES, 3), A(LANES, 5), S(LANES, 5)
    real(dp) :: matrix(LANES, 5, 5), T(LANES, 5)
    integer :: j

    do j = 1, 5
      T = 0
      T(:, j) = 1
      matrix(:, :, j) = times(factor, T) - corotate(w, T) - times(contract(S, T), A)
    end do
  end function implicit_matrix

end module granumat_methods
