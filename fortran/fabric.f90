!> The fabric equation (4.7) under a constant velocity gradient, solved exactly.
!!
!! With A = B/y it is linear: B' = c1 S y + c2 |D| B + W B - B W, y' = -c3 B:S, B(0) = A, y(0) = 1.
!! The Taylor series of the exponential's action on (A, 1) gives B and y anywhere in the increment, and A:S = -y'/(c3 y).
module granumat_fabric
  use granumat_kinds, only: dp
  use granumat_parameters, only: material_parameters
  use granumat_tensors, only: LANES, corotate, times
  implicit none (type, external)
  private
  public :: solve_fabric, vary_fabric, fabric_at, fabric_rate, projections_at, series_at, slopes_at, y_at

  integer, parameter :: MAX_TERMS = 20
  real(dp), parameter :: SERIES_REST = 1.0e-17_dp   ! first neglected term over the solution: below round-off
  real(dp), parameter :: TANGENT_REST = 1.0e-11_dp  ! the same for its changes

  !> Taylor coefficients of B and y in t, 0 <= t <= 1 over the increment.
  type, public :: fabric_solution
    integer :: terms
    real(dp) :: c3
    real(dp) :: B(LANES, 6, 0:MAX_TERMS), y(LANES, 0:MAX_TERMS)
    real(dp) :: rest(LANES, MAX_TERMS)         ! bound of each term over the solution
  end type fabric_solution

contains

  !> Bound of the exponential's argument per increment: how fast anything in (4.7) can change.
  pure function fabric_rate(par, mod_D, w) result(rate)
    type(material_parameters), intent(in) :: par
    real(dp), intent(in) :: mod_D(LANES), w(LANES, 3)
    real(dp) :: rate(LANES)
    rate = (abs(par%c2) + sqrt(-2 * par%c1 * par%c3)) * mod_D + 2 * sqrt(w(:, 1)**2 + w(:, 2)**2 + w(:, 3)**2)
  end function fabric_rate

  !> Solves (4.7) over one increment; accurate to round-off for fabric_rate <= 1.
  pure subroutine solve_fabric(par, A, S, mod_D, w, solution)
    type(material_parameters), intent(in) :: par
    real(dp), intent(in) :: A(LANES, 6)      ! fabric at t = 0
    real(dp), intent(in) :: S(LANES, 6)      ! deviatoric strain increment
    real(dp), intent(in) :: mod_D(LANES)     ! |D| of the strain increment
    real(dp), intent(in) :: w(LANES, 3)      ! spin increment
    type(fabric_solution), intent(out) :: solution
    real(dp), dimension(LANES) :: rate, rest
    real(dp) :: inverse, factor, decay, source, w1, w2, w3, B1, B2, B3, B4, B5, B6
    integer :: i, k

    rate = fabric_rate(par, mod_D, w)
    solution%c3 = par%c3
    solution%B(:, :, 0) = A
    solution%y(:, 0) = 1
    rest = 1
    do k = 1, MAX_TERMS
      inverse = 1.0_dp / k
      do i = 1, LANES                          ! one fused loop, W B - B W written out: the hottest of all
        factor = merge(inverse, 0.0_dp, rest(i) >= SERIES_REST)     ! a lane's number of terms is its own
        solution%rest(i, k) = rest(i)
        source = factor * par%c1 * solution%y(i, k - 1)
        decay = factor * par%c2 * mod_D(i)
        w1 = factor * w(i, 1)
        w2 = factor * w(i, 2)
        w3 = factor * w(i, 3)
        B1 = solution%B(i, 1, k - 1)
        B2 = solution%B(i, 2, k - 1)
        B3 = solution%B(i, 3, k - 1)
        B4 = solution%B(i, 4, k - 1)
        B5 = solution%B(i, 5, k - 1)
        B6 = solution%B(i, 6, k - 1)
        solution%B(i, 1, k) = source * S(i, 1) + decay * B1 + 2 * (w1 * B4 + w2 * B5)
        solution%B(i, 2, k) = source * S(i, 2) + decay * B2 + 2 * (w3 * B6 - w1 * B4)
        solution%B(i, 3, k) = source * S(i, 3) + decay * B3 - 2 * (w2 * B5 + w3 * B6)
        solution%B(i, 4, k) = source * S(i, 4) + decay * B4 + (w1 * (B2 - B1) + w2 * B6 + w3 * B5)
        solution%B(i, 5, k) = source * S(i, 5) + decay * B5 + (w2 * (B3 - B1) + w1 * B6 - w3 * B4)
        solution%B(i, 6, k) = source * S(i, 6) + decay * B6 + (w3 * (B3 - B2) - w1 * B5 - w2 * B4)
        solution%y(i, k) = -factor * par%c3 * (S(i, 1) * B1 + S(i, 2) * B2 + S(i, 3) * B3 &
          + 2 * (S(i, 4) * B4 + S(i, 5) * B5 + S(i, 6) * B6))
        rest(i) = rest(i) * rate(i) * inverse
      end do
      solution%terms = k
      if (all(rest < SERIES_REST)) exit
    end do
  end subroutine solve_fabric

  !> A at t.
  pure function fabric_at(solution, t) result(A)
    type(fabric_solution), intent(in) :: solution
    real(dp), intent(in) :: t(LANES)
    real(dp) :: A(LANES, 6)
    A = times(1 / y_at(solution, t), series_at(solution, t))
  end function fabric_at

  !> B at t.
  pure function series_at(solution, t) result(B)
    type(fabric_solution), intent(in) :: solution
    real(dp), intent(in) :: t(LANES)
    real(dp) :: B(LANES, 6)
    integer :: k

    B = solution%B(:, :, solution%terms)
    do k = solution%terms - 1, 0, -1
      B = times(t, B) + solution%B(:, :, k)
    end do
  end function series_at

  !> y at t: positive as long as the fabric has not blown up.
  pure function y_at(solution, t) result(y)
    type(fabric_solution), intent(in) :: solution
    real(dp), intent(in) :: t(LANES)
    real(dp) :: y(LANES)
    integer :: k

    y = solution%y(:, solution%terms)
    do k = solution%terms - 1, 0, -1
      y = y * t + solution%y(:, k)
    end do
  end function y_at

  !> y and y' at n places t.
  pure subroutine slopes_at(solution, n, t, y, dot_y)
    type(fabric_solution), intent(in) :: solution
    integer, intent(in) :: n
    real(dp), intent(in) :: t(LANES, n)
    real(dp), intent(out) :: y(LANES, n), dot_y(LANES, n)
    integer :: i, j, k

    y = spread(solution%y(:, solution%terms), 2, n)
    dot_y = 0
    do k = solution%terms - 1, 0, -1
      do j = 1, n
        do i = 1, LANES
          dot_y(i, j) = dot_y(i, j) * t(i, j) + y(i, j)
          y(i, j) = y(i, j) * t(i, j) + solution%y(i, k)
        end do
      end do
    end do
  end subroutine slopes_at

  !> A:S = -y'/(c3 y) at n places t.
  pure subroutine projections_at(solution, n, t, A_S)
    type(fabric_solution), intent(in) :: solution
    integer, intent(in) :: n
    real(dp), intent(in) :: t(LANES, n)
    real(dp), intent(out) :: A_S(LANES, n)
    real(dp) :: y(LANES, n), dot_y(LANES, n)
    call slopes_at(solution, n, t, y, dot_y)
    A_S = -dot_y / (solution%c3 * y)
  end subroutine projections_at

  !> The change of a solution with changes of the initial fabric and of the increment.
  pure subroutine vary_fabric(par, solution, S, mod_D, w, d_A, d_S, d_mod_D, d_w, d_solution)
    type(material_parameters), intent(in) :: par
    type(fabric_solution), intent(in) :: solution
    real(dp), intent(in) :: S(LANES, 6), mod_D(LANES), w(LANES, 3)
    real(dp), intent(in) :: d_A(LANES, 6), d_S(LANES, 6), d_mod_D(LANES), d_w(LANES, 3)
    type(fabric_solution), intent(out) :: d_solution
    real(dp) :: inverse, factor, decay, d_decay, source, d_source, w1, w2, w3, B1, B2, B3, B4, B5, B6
    integer :: i, k
    logical :: spins

    spins = any(abs(d_w) > 0)
    d_solution%c3 = par%c3
    d_solution%B(:, :, 0) = d_A
    d_solution%y(:, 0) = 0
    do k = 1, solution%terms
      inverse = 1.0_dp / k
      do i = 1, LANES                          ! as in solve_fabric
        factor = merge(inverse, 0.0_dp, solution%rest(i, k) >= TANGENT_REST)
        source = factor * par%c1 * solution%y(i, k - 1)
        d_source = factor * par%c1 * d_solution%y(i, k - 1)
        decay = factor * par%c2 * mod_D(i)
        d_decay = factor * par%c2 * d_mod_D(i)
        w1 = factor * w(i, 1)
        w2 = factor * w(i, 2)
        w3 = factor * w(i, 3)
        B1 = d_solution%B(i, 1, k - 1)
        B2 = d_solution%B(i, 2, k - 1)
        B3 = d_solution%B(i, 3, k - 1)
        B4 = d_solution%B(i, 4, k - 1)
        B5 = d_solution%B(i, 5, k - 1)
        B6 = d_solution%B(i, 6, k - 1)
        d_solution%y(i, k) = -factor * par%c3 * (S(i, 1) * B1 + S(i, 2) * B2 + S(i, 3) * B3 &
          + 2 * (S(i, 4) * B4 + S(i, 5) * B5 + S(i, 6) * B6) &
          + d_S(i, 1) * solution%B(i, 1, k - 1) + d_S(i, 2) * solution%B(i, 2, k - 1) + d_S(i, 3) * solution%B(i, 3, k - 1) &
          + 2 * (d_S(i, 4) * solution%B(i, 4, k - 1) + d_S(i, 5) * solution%B(i, 5, k - 1) + d_S(i, 6) * solution%B(i, 6, k - 1)))
        d_solution%B(i, 1, k) = source * d_S(i, 1) + d_source * S(i, 1) + decay * B1 + d_decay * solution%B(i, 1, k - 1) &
          + 2 * (w1 * B4 + w2 * B5)
        d_solution%B(i, 2, k) = source * d_S(i, 2) + d_source * S(i, 2) + decay * B2 + d_decay * solution%B(i, 2, k - 1) &
          + 2 * (w3 * B6 - w1 * B4)
        d_solution%B(i, 3, k) = source * d_S(i, 3) + d_source * S(i, 3) + decay * B3 + d_decay * solution%B(i, 3, k - 1) &
          - 2 * (w2 * B5 + w3 * B6)
        d_solution%B(i, 4, k) = source * d_S(i, 4) + d_source * S(i, 4) + decay * B4 + d_decay * solution%B(i, 4, k - 1) &
          + (w1 * (B2 - B1) + w2 * B6 + w3 * B5)
        d_solution%B(i, 5, k) = source * d_S(i, 5) + d_source * S(i, 5) + decay * B5 + d_decay * solution%B(i, 5, k - 1) &
          + (w2 * (B3 - B1) + w1 * B6 - w3 * B4)
        d_solution%B(i, 6, k) = source * d_S(i, 6) + d_source * S(i, 6) + decay * B6 + d_decay * solution%B(i, 6, k - 1) &
          + (w3 * (B3 - B2) - w1 * B5 - w2 * B4)
      end do
      if (spins) d_solution%B(:, :, k) = d_solution%B(:, :, k) &
        + times(merge(inverse, 0.0_dp, solution%rest(:, k) >= TANGENT_REST), corotate(d_w, solution%B(:, :, k - 1)))
      d_solution%terms = k
      if (all(solution%rest(:, k) < TANGENT_REST)) exit
    end do
  end subroutine vary_fabric

end module granumat_fabric
