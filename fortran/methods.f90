!> Usual ways to integrate the rate form, to compare the exact update with: one step over the whole increment, except
!! Bogacki & Shampine's embedded pair, which cuts it until its error estimate is below a tolerance.
module granumat_methods
  use granumat_kinds, only: dp
  use granumat_parameters, only: material_parameters, CRITICAL, FORWARD_EULER, MIDPOINT, RK4, BOGACKI_SHAMPINE, BACKWARD_EULER
  use granumat_state, only: REALISABLE
  use granumat_status, only: OK, BAD_VOLUME_FRACTION, FABRIC_BLOWS_UP, INCREMENT_TOO_LARGE, NOT_CONVERGED, RESULT_NOT_FINITE
  use granumat_coordination, only: excess_coordination
  use granumat_stress, only: pressure, pressure_modulus
  use granumat_increment, only: increment
  use granumat_rates, only: rates, imply, model_deviator, I_EXCESS, I_PHI, I_DEV, N_EVOLVING
  use granumat_tensors, only: LANES, contract, corotate, modulus, times
  implicit none (type, external)
  private
  public :: integrate_by_method

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
  integer, parameter, public :: MAX_STEPS = 10000

  integer, parameter :: MAX_ITERATIONS = 20
  real(dp), parameter :: LAST_CHANGE = 1.0e-8_dp    ! of A, over kappa: Newton's next one would be its square

contains

  !> Brings y over the increment.
  pure subroutine integrate_by_method(par, inc, y, status)
    type(material_parameters), intent(in) :: par
    type(increment), intent(in) :: inc
    real(dp), intent(inout) :: y(LANES, N_EVOLVING)
    integer, intent(inout) :: status(LANES)
    real(dp) :: mod_A_old(LANES), mod_A(LANES), A(LANES, 5), excess(LANES)

    A = y(:, :5)
    excess = y(:, I_EXCESS)
    mod_A_old = modulus(A)
    select case (par%method)
    case (FORWARD_EULER)
      call one_step(par, inc, NO_NODE, EULER_WEIGHT, y, status)
    case (MIDPOINT)
      call one_step(par, inc, MIDPOINT_NODE, MIDPOINT_WEIGHT, y, status)
    case (RK4)
      call one_step(par, inc, RK4_NODE, RK4_WEIGHT, y, status)
    case (BOGACKI_SHAMPINE)
      call embedded_pair(par, inc, y, status)
    case (BACKWARD_EULER)
      call implicit_step(par, inc, y, status)
    end select
    where (status == OK) status = status_of(y)
    if (par%closure == CRITICAL) then
      call imply(par, inc, y(:, I_PHI), A, excess)
      y(:, :5) = A
      y(:, I_EXCESS) = excess
    else      ! below the limit |A| cannot come above it (derived): only a method can bring it there
      mod_A = modulus(y(:, :5))
      where (status == OK .and. mod_A > par%fabric_limit .and. mod_A > mod_A_old) status = FABRIC_BLOWS_UP
    end if
  end subroutine integrate_by_method

  !> Whether y is a state of a granular solid.
  pure function status_of(y) result(status)
    real(dp), intent(in) :: y(LANES, N_EVOLVING)
    integer :: status(LANES)
    status = OK
    where (.not. (y(:, I_PHI) > 0 .and. y(:, I_PHI) < 1)) status = BAD_VOLUME_FRACTION
    where (.not. modulus(y(:, :5)) < REALISABLE) status = FABRIC_BLOWS_UP
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
  pure subroutine embedded_pair(par, inc, y, status)
    type(material_parameters), intent(in) :: par
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
    do attempt = 1, MAX_STEPS
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
      accepted = active .and. tried == OK .and. error <= par%method_tolerance
      do i = 1, N_EVOLVING
        y(:, i) = merge(y_new(:, i), y(:, i), accepted)
        k(:, i, 1) = merge(k(:, i, 4), k(:, i, 1), accepted)          ! the last stage is the next step's first
      end do
      done = merge(merge(1.0_dp, done + h, h >= 1 - done), done, accepted)
      where (active .and. .not. accepted .and. h < SMALLEST_STEP) status = merge(tried, INCREMENT_TOO_LARGE, tried /= OK)
      factor = SHRINK
      where (tried == OK) factor = max(SHRINK, min(largest_factor, &
        SAFETY * (par%method_tolerance / max(error, tiny(1.0_dp)))**(1.0_dp / 3)))
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

    error = max(modulus(estimate(:, :5)) / max(modulus(y(:, :5)), par%kappa), &
      abs(estimate(:, I_EXCESS)) / max(par%Zc + y(:, I_EXCESS), par%Zc), abs(estimate(:, I_PHI)) / y(:, I_PHI))
    if (par%elastic_strain > 0) then
      p = pressure(par, pressure_modulus(par, y(:, :5), inc%tr_direction), y(:, I_EXCESS))
      error = max(error, modulus(estimate(:, I_DEV:)) &
        / max(modulus(y_old(:, I_DEV:)), modulus(y(:, I_DEV:)), p, tiny(1.0_dp)))
    end if
  end function relative_error

  !> Backward Euler: phi, Z2 and sigma' follow one after the other, from A, for which Newton's method is needed.
  pure subroutine implicit_step(par, inc, y, status)
    type(material_parameters), intent(in) :: par
    type(increment), intent(in) :: inc
    real(dp), intent(inout) :: y(LANES, N_EVOLVING)
    integer, intent(inout) :: status(LANES)
    real(dp), dimension(LANES, 5) :: A, S, dev
    real(dp), dimension(LANES) :: ratio, decay, forcing, excess, determinant_sign

    y(:, I_PHI) = y(:, I_PHI) / (1 + inc%tr_D)
    A = y(:, :5)
    excess = y(:, I_EXCESS)
    if (par%closure == CRITICAL) then
      call imply(par, inc, y(:, I_PHI), A, excess)
    else
      S = times(inc%mod_D, inc%S_hat)
      call implicit_fabric(par, inc, S, A, status)
      decay = par%d2 * inc%mod_D
      forcing = par%d1 * (contract(A, S) - par%chi * modulus(S)) + par%d3 * inc%tr_D
      excess = (excess + forcing + decay * excess_coordination(par, y(:, I_PHI) - par%phic)) / (1 + decay)      ! (4.8)
    end if
    y(:, :5) = A
    y(:, I_EXCESS) = excess
    if (par%elastic_strain > 0) then
      ratio = inc%mod_D / par%elastic_strain
      S = 0
      dev = y(:, I_DEV:) + times(ratio, model_deviator(par, inc, A, excess))
      call solve_linear(implicit_matrix(1 + ratio, inc%spin, S, S), dev, determinant_sign)
      y(:, I_DEV:) = dev
    end if
  end subroutine implicit_step

  !> (4.7) by backward Euler. Newton's method starts from lambda S^, the attractor without spin (A 9): from there it finds the
  !! root that belongs to small increments, whatever the increment. Not so where the fabric can blow up: started from A it
  !! grows, or finds a root beyond the singularity, where the determinant or the factor of A is no longer positive.
  pure subroutine implicit_fabric(par, inc, S, A, status)
    type(material_parameters), intent(in) :: par
    type(increment), intent(in) :: inc
    real(dp), intent(in) :: S(LANES, 5)
    real(dp), intent(inout) :: A(LANES, 5)
    integer, intent(inout) :: status(LANES)
    real(dp) :: start(LANES, 5), change(LANES, 5), factor(LANES), determinant_sign(LANES)
    logical, dimension(LANES) :: active, converged, tame
    integer :: iteration, j

    start = A + par%c1 * S
    tame = modulus(A) <= par%fabric_limit
    do j = 1, 5
      A(:, j) = merge(par%lambda * inc%S_hat(:, j), A(:, j), tame)
    end do
    active = status == OK
    do iteration = 1, MAX_ITERATIONS
      factor = 1 - par%c2 * inc%mod_D - par%c3 * contract(A, S)
      change = start + corotate(inc%spin, A) - times(factor, A)
      call solve_linear(implicit_matrix(factor, inc%spin, par%c3 * A, S), change, determinant_sign)
      do j = 1, 5
        A(:, j) = merge(A(:, j) + change(:, j), A(:, j), active)
      end do
      converged = active .and. modulus(change) <= LAST_CHANGE * par%kappa
      where (converged .and. .not. (factor > 0 .and. determinant_sign > 0)) status = FABRIC_BLOWS_UP
      active = active .and. .not. converged
      if (.not. any(active)) return
    end do
    where (active) status = NOT_CONVERGED
  end subroutine implicit_fabric

  !> The matrix of T -> factor T - (W T - T W) - (S:T) A.
  pure function implicit_matrix(factor, w, A, S) result(matrix)
    real(dp), intent(in) :: factor(LANES), w(LANES, 3), A(LANES, 5), S(LANES, 5)
    real(dp) :: matrix(LANES, 5, 5), unit(LANES, 5)
    integer :: j

    do j = 1, 5
      unit = 0
      unit(:, j) = 1
      matrix(:, :, j) = times(factor, unit) - corotate(w, unit) - times(contract(S, unit), A)
    end do
  end function implicit_matrix

  !> Gaussian elimination; the solution replaces x. Rows are not exchanged: where the increment is not too large for the
  !! method, the matrix has a symmetric part that dominates.
  pure subroutine solve_linear(matrix, x, determinant_sign)
    real(dp), intent(in) :: matrix(LANES, 5, 5)
    real(dp), intent(inout) :: x(LANES, 5)
    real(dp), intent(out) :: determinant_sign(LANES)
    real(dp) :: m(LANES, 5, 5), factor(LANES)
    integer :: i, j, k

    m = matrix
    determinant_sign = 1
    do k = 1, 5
      determinant_sign = determinant_sign * sign(1.0_dp, m(:, k, k))
      do i = k + 1, 5
        factor = m(:, i, k) / m(:, k, k)
        do j = k + 1, 5
          m(:, i, j) = m(:, i, j) - factor * m(:, k, j)
        end do
        x(:, i) = x(:, i) - factor * x(:, k)
      end do
    end do
    do k = 5, 1, -1
      do j = k + 1, 5
        x(:, k) = x(:, k) - m(:, k, j) * x(:, j)
      end do
      x(:, k) = x(:, k) / m(:, k, k)
    end do
  end subroutine solve_linear

end module granumat_methods
