!> The fabric equation (4.7) under a constant velocity gradient, solved exactly.
!!
!! With A = B/y it is linear: B' = c1 S y + c2 |D| B + W B - B W, y' = -c3 B:S, B(0) = A, y(0) = 1.
!! The Taylor series of the exponential's action on (A, 1) gives B and y anywhere in the increment, and A:S = -y'/(c3 y).
module granumat_fabric
  use granumat_kinds, only: dp
  use granumat_coordination, only: N_NODES
  use granumat_parameters, only: material_parameters
  use granumat_tensors, only: LANES, corotate, times
  implicit none (type, external)
  private
  public :: solve_fabric, vary_fabric, fabric_rate, fabric_at, projections_at, sum_series

  integer, parameter, public :: MAX_TERMS = 20
  real(dp), parameter :: SERIES_REST = 1.0e-17_dp   ! first neglected term over the solution: below round-off

  !> The matrix of the linear equation over an increment.
  type :: fabric_matrix
    real(dp) :: source(LANES, 6)               ! c1 S
    real(dp) :: sink(LANES, 6)                 ! -c3 S, the shear components twice
    real(dp) :: decay(LANES)                   ! c2 |D|
    real(dp) :: spin(LANES, 3), twice_spin(LANES, 3)
  end type fabric_matrix

  !> The derivatives of B and y at t = 0, 0 <= t <= 1 over the increment.
  type, public :: fabric_solution
    integer :: terms
    type(fabric_matrix) :: matrix
    real(dp) :: B(LANES, 6, 0:MAX_TERMS), y(LANES, 0:MAX_TERMS)
    real(dp) :: bound(LANES, 0:MAX_TERMS)      ! of the terms of their series over the solution, at t = 1
    real(dp) :: weight(LANES, 0:MAX_TERMS)     ! 1/k!, 0 from where a lane needs no more
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
    real(dp) :: rate(LANES), inverse_factorial
    integer :: k

    rate = fabric_rate(par, mod_D, w)
    solution%matrix%source = par%c1 * S
    solution%matrix%sink(:, :3) = -par%c3 * S(:, :3)
    solution%matrix%sink(:, 4:) = -2 * par%c3 * S(:, 4:)
    solution%matrix%decay = par%c2 * mod_D
    solution%matrix%spin = w
    solution%matrix%twice_spin = 2 * w
    solution%B(:, :, 0) = A
    solution%y(:, 0) = 1
    solution%bound(:, 0) = 1
    solution%weight(:, 0) = 1
    inverse_factorial = 1
    do k = 1, MAX_TERMS
      call differentiate(solution%matrix, solution%B(:, :, k - 1), solution%y(:, k - 1), solution%B(:, :, k), solution%y(:, k))
      inverse_factorial = inverse_factorial / k
      solution%weight(:, k) = merge(inverse_factorial, 0.0_dp, solution%bound(:, k - 1) >= SERIES_REST)
      solution%bound(:, k) = solution%bound(:, k - 1) * (rate / k)
      solution%terms = k
      if (all(solution%bound(:, k) < SERIES_REST)) exit
    end do
  end subroutine solve_fabric

  !> The derivative of (B, y), in one fused loop: the hottest of all.
  pure subroutine differentiate(matrix, B, y, dot_B, dot_y)
    type(fabric_matrix), intent(in) :: matrix
    real(dp), intent(in) :: B(LANES, 6), y(LANES)
    real(dp), intent(out) :: dot_B(LANES, 6), dot_y(LANES)
    real(dp) :: decay, w1, w2, w3, B1, B2, B3, B4, B5, B6
    integer :: i

    do i = 1, LANES
      decay = matrix%decay(i)
      w1 = matrix%spin(i, 1)
      w2 = matrix%spin(i, 2)
      w3 = matrix%spin(i, 3)
      B1 = B(i, 1)
      B2 = B(i, 2)
      B3 = B(i, 3)
      B4 = B(i, 4)
      B5 = B(i, 5)
      B6 = B(i, 6)
      dot_y(i) = matrix%sink(i, 1) * B1 + matrix%sink(i, 2) * B2 + matrix%sink(i, 3) * B3 &
        + matrix%sink(i, 4) * B4 + matrix%sink(i, 5) * B5 + matrix%sink(i, 6) * B6
      dot_B(i, 1) = matrix%source(i, 1) * y(i) + decay * B1 + matrix%twice_spin(i, 1) * B4 + matrix%twice_spin(i, 2) * B5
      dot_B(i, 2) = matrix%source(i, 2) * y(i) + decay * B2 + matrix%twice_spin(i, 3) * B6 - matrix%twice_spin(i, 1) * B4
      dot_B(i, 3) = matrix%source(i, 3) * y(i) + decay * B3 - matrix%twice_spin(i, 2) * B5 - matrix%twice_spin(i, 3) * B6
      dot_B(i, 4) = matrix%source(i, 4) * y(i) + decay * B4 + w1 * (B2 - B1) + w2 * B6 + w3 * B5
      dot_B(i, 5) = matrix%source(i, 5) * y(i) + decay * B5 + w2 * (B3 - B1) + w1 * B6 - w3 * B4
      dot_B(i, 6) = matrix%source(i, 6) * y(i) + decay * B6 + w3 * (B3 - B2) - w1 * B5 - w2 * B4
    end do
  end subroutine differentiate

  !> y (positive as long as the fabric has not blown up) and A:S = -y'/(c3 y) at the nodes.
  pure subroutine projections_at(par, solution, t, y, A_S)
    type(material_parameters), intent(in) :: par
    type(fabric_solution), intent(in) :: solution
    real(dp), intent(in) :: t(LANES, N_NODES)
    real(dp), intent(out) :: y(LANES, N_NODES), A_S(LANES, N_NODES)
    real(dp) :: y_i(N_NODES), dot_y(N_NODES), term
    integer :: i, j, k

    do i = 1, LANES                            ! vectorised, as the loop over the terms surely runs: see sum_series
      y_i = 0
      dot_y = 0
      k = solution%terms
      do
        term = solution%weight(i, k) * solution%y(i, k)
        do j = 1, N_NODES
          dot_y(j) = dot_y(j) * t(i, j) + y_i(j)
          y_i(j) = y_i(j) * t(i, j) + term
        end do
        k = k - 1
        if (k < 0) exit
      end do
      y(i, :) = y_i
      A_S(i, :) = -dot_y / (par%c3 * y_i)
    end do
  end subroutine projections_at

  !> A and y at t.
  pure subroutine fabric_at(solution, t, A, y)
    type(fabric_solution), intent(in) :: solution
    real(dp), intent(in) :: t(LANES)
    real(dp), intent(out) :: A(LANES, 6), y(LANES)
    real(dp) :: weight(LANES, 0:MAX_TERMS), power(LANES)
    integer :: k

    power = 1
    do k = 0, solution%terms
      weight(:, k) = solution%weight(:, k) * power
      power = power * t
    end do
    call sum_series(solution%terms, weight, solution%B, solution%y, A, y)
    A = times(1 / y, A)
  end subroutine fabric_at

  !> Weighted sums of the terms of B and y.
  pure subroutine sum_series(terms, weight, B, y, B_sum, y_sum)
    integer, intent(in) :: terms
    real(dp), intent(in), dimension(LANES, 0:MAX_TERMS) :: weight, y
    real(dp), intent(in) :: B(LANES, 6, 0:MAX_TERMS)
    real(dp), intent(out) :: B_sum(LANES, 6), y_sum(LANES)
    real(dp) :: total(7)
    integer :: i, j, k

    do i = 1, LANES                            ! vectorised with the sums in registers, as the inner loop surely runs
      total = 0
      k = 0
      do
        do j = 1, 6
          total(j) = total(j) + weight(i, k) * B(i, j, k)
        end do
        total(7) = total(7) + weight(i, k) * y(i, k)
        k = k + 1
        if (k > terms) exit
      end do
      B_sum(i, :) = total(:6)
      y_sum(i) = total(7)
    end do
  end subroutine sum_series

  !> The change of a solution, up to a number of terms, with changes of the initial fabric and, times share, of the increment.
  pure subroutine vary_fabric(par, solution, terms, share, d_A, d_S, d_mod_D, d_w, d_B, d_y)
    type(material_parameters), intent(in) :: par
    type(fabric_solution), intent(in) :: solution
    integer, intent(in) :: terms
    real(dp), intent(in) :: share(LANES), d_A(LANES, 6)
    real(dp), intent(in) :: d_S(6), d_mod_D, d_w(3)        ! the same in all lanes
    real(dp), intent(out) :: d_B(LANES, 6, 0:MAX_TERMS), d_y(LANES, 0:MAX_TERMS)
    real(dp) :: d_source(LANES, 6), d_sink(LANES, 6), d_decay(LANES), d_spin(LANES, 3)
    integer :: changed(6), n, i, j, k
    logical :: decays, spins

    n = 0
    do j = 1, 6
      if (.not. abs(d_S(j)) > 0) cycle
      n = n + 1
      changed(n) = j
      d_source(:, n) = par%c1 * d_S(j) * share
      d_sink(:, n) = -par%c3 * merge(1, 2, j <= 3) * d_S(j) * share
    end do
    decays = abs(d_mod_D) > 0
    d_decay = par%c2 * d_mod_D * share
    spins = any(abs(d_w) > 0)
    do j = 1, 3
      d_spin(:, j) = d_w(j) * share
    end do
    d_B(:, :, 0) = d_A
    d_y(:, 0) = 0
    do k = 1, terms
      call differentiate(solution%matrix, d_B(:, :, k - 1), d_y(:, k - 1), d_B(:, :, k), d_y(:, k))
      do i = 1, n
        j = changed(i)
        d_B(:, j, k) = d_B(:, j, k) + d_source(:, i) * solution%y(:, k - 1)
        d_y(:, k) = d_y(:, k) + d_sink(:, i) * solution%B(:, j, k - 1)
      end do
      if (decays) d_B(:, :, k) = d_B(:, :, k) + times(d_decay, solution%B(:, :, k - 1))
      if (spins) d_B(:, :, k) = d_B(:, :, k) + corotate(d_spin, solution%B(:, :, k - 1))
    end do
  end subroutine vary_fabric

end module granumat_fabric
