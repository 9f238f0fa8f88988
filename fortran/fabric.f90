!> The fabric equation (4.7) under a constant velocity gradient, solved exactly.
!!
!! With A = B/y it is linear: B' = c1 S y + c2 |D| B + W B - B W, y' = -c3 B:S, B(0) = A, y(0) = 1.
!! The Taylor series of the exponential's action on (A, 1) gives B and y anywhere in the increment, and A:S = -y'/(c3 y).
module granumat_fabric
  use granumat_kinds, only: dp
  use granumat_coordination, only: N_NODES
  use granumat_parameters, only: material_parameters
  use granumat_tensors, only: LANES, SQRT_3, times
  implicit none (type, external)
  private
  public :: solve_fabric, pull_fabric, fabric_rate, fabric_at, projections_at

  integer, parameter, public :: MAX_TERMS = 20
  real(dp), parameter :: SERIES_REST = 1.0e-17_dp   ! first neglected term over the solution: below round-off

  !> The matrix of the linear equation over an increment.
  type :: fabric_matrix
    real(dp) :: S(LANES, 5)
    real(dp) :: source, sink                   ! c1, -c3
    real(dp) :: decay(LANES)                   ! c2 |D|
    real(dp) :: spin(LANES, 3)
  end type fabric_matrix

  !> The derivatives of B and y at t = 0, 0 <= t <= 1 over the increment.
  type, public :: fabric_solution
    integer :: terms
    type(fabric_matrix) :: matrix
    real(dp) :: B(LANES, 5, 0:MAX_TERMS), y(LANES, 0:MAX_TERMS)
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
    real(dp), intent(in) :: A(LANES, 5)      ! fabric at t = 0
    real(dp), intent(in) :: S(LANES, 5)      ! deviatoric strain increment
    real(dp), intent(in) :: mod_D(LANES)     ! |D| of the strain increment
    real(dp), intent(in) :: w(LANES, 3)      ! spin increment
    type(fabric_solution), intent(out) :: solution
    real(dp) :: rate(LANES), inverse_factorial
    integer :: k

    rate = fabric_rate(par, mod_D, w)
    solution%matrix = fabric_matrix(S, par%c1, -par%c3, par%c2 * mod_D, w)
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
    real(dp), intent(in) :: B(LANES, 5), y(LANES)
    real(dp), intent(out) :: dot_B(LANES, 5), dot_y(LANES)
    real(dp) :: decay, source, w1, w2, w3, B1, B2, B3, B4, B5
    integer :: i

    do i = 1, LANES
      decay = matrix%decay(i)
      source = matrix%source * y(i)
      w1 = matrix%spin(i, 1)
      w2 = matrix%spin(i, 2)
      w3 = matrix%spin(i, 3)
      B1 = B(i, 1)
      B2 = B(i, 2)
      B3 = B(i, 3)
      B4 = B(i, 4)
      B5 = B(i, 5)
      dot_y(i) = matrix%sink * (matrix%S(i, 1) * B1 + matrix%S(i, 2) * B2 + matrix%S(i, 3) * B3 + matrix%S(i, 4) * B4 &
        + matrix%S(i, 5) * B5)
      dot_B(i, 1) = source * matrix%S(i, 1) + decay * B1 + 2 * w1 * B3 + w2 * B4 - w3 * B5
      dot_B(i, 2) = source * matrix%S(i, 2) + decay * B2 - SQRT_3 * (w2 * B4 + w3 * B5)
      dot_B(i, 3) = source * matrix%S(i, 3) + decay * B3 - 2 * w1 * B1 + w2 * B5 + w3 * B4
      dot_B(i, 4) = source * matrix%S(i, 4) + decay * B4 + w2 * (SQRT_3 * B2 - B1) + w1 * B5 - w3 * B3
      dot_B(i, 5) = source * matrix%S(i, 5) + decay * B5 + w3 * (SQRT_3 * B2 + B1) - w1 * B4 - w2 * B3
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
    real(dp), intent(out) :: A(LANES, 5), y(LANES)
    real(dp) :: total(6), term
    integer :: i, j, k

    do i = 1, LANES                            ! vectorised with the sums in registers, as the loop over the terms surely runs
      total = 0
      k = solution%terms
      do
        term = solution%weight(i, k)
        do j = 1, 5
          total(j) = total(j) * t(i) + term * solution%B(i, j, k)
        end do
        total(6) = total(6) * t(i) + term * solution%y(i, k)
        k = k - 1
        if (k < 0) exit
      end do
      A(i, :) = total(:5)
      y(i) = total(6)
    end do
    A = times(1 / y, A)
  end subroutine fabric_at

  !> A sum over the terms k of g_B : B(k) + g_y y(k), by what it depends on: pulled back through the series, whose transposed
  !! matrix is that of the spin reversed and of source and sink exchanged.
  pure subroutine pull_fabric(solution, terms, g_B, g_y, by_A, by_S, by_decay, by_spin)
    type(fabric_solution), intent(in) :: solution
    integer, intent(in) :: terms
    real(dp), intent(in) :: g_B(LANES, 5, 0:MAX_TERMS), g_y(LANES, 0:MAX_TERMS)
    real(dp), intent(out) :: by_A(LANES, 5), by_S(LANES, 5), by_decay(LANES), by_spin(LANES, 3)
    real(dp) :: q1, q2, q3, q4, q5, q_y, n1, n2, n3, n4, B1, B2, B3, B4, B5, S1, S2, S3, S4, S5, y, decay, w1, w2, w3, sink
    real(dp) :: source1, source2, source3, source4, source5, sink1, sink2, sink3, sink4, sink5, total, turn1, turn2, turn3
    integer :: i, k

    do i = 1, LANES                            ! vectorised as above
      decay = solution%matrix%decay(i)
      w1 = solution%matrix%spin(i, 1)
      w2 = solution%matrix%spin(i, 2)
      w3 = solution%matrix%spin(i, 3)
      S1 = solution%matrix%S(i, 1)
      S2 = solution%matrix%S(i, 2)
      S3 = solution%matrix%S(i, 3)
      S4 = solution%matrix%S(i, 4)
      S5 = solution%matrix%S(i, 5)
      q1 = g_B(i, 1, terms)
      q2 = g_B(i, 2, terms)
      q3 = g_B(i, 3, terms)
      q4 = g_B(i, 4, terms)
      q5 = g_B(i, 5, terms)
      q_y = g_y(i, terms)
      source1 = 0
      source2 = 0
      source3 = 0
      source4 = 0
      source5 = 0
      sink1 = 0
      sink2 = 0
      sink3 = 0
      sink4 = 0
      sink5 = 0
      total = 0
      turn1 = 0
      turn2 = 0
      turn3 = 0
      k = terms - 1
      do
        B1 = solution%B(i, 1, k)
        B2 = solution%B(i, 2, k)
        B3 = solution%B(i, 3, k)
        B4 = solution%B(i, 4, k)
        B5 = solution%B(i, 5, k)
        y = solution%y(i, k)
        source1 = source1 + y * q1
        source2 = source2 + y * q2
        source3 = source3 + y * q3
        source4 = source4 + y * q4
        source5 = source5 + y * q5
        sink1 = sink1 + q_y * B1
        sink2 = sink2 + q_y * B2
        sink3 = sink3 + q_y * B3
        sink4 = sink4 + q_y * B4
        sink5 = sink5 + q_y * B5
        total = total + q1 * B1 + q2 * B2 + q3 * B3 + q4 * B4 + q5 * B5
        turn1 = turn1 + 2 * (q1 * B3 - q3 * B1) + q4 * B5 - q5 * B4
        turn2 = turn2 + (q1 - SQRT_3 * q2) * B4 + q3 * B5 + q4 * (SQRT_3 * B2 - B1) - q5 * B3
        turn3 = turn3 - (q1 + SQRT_3 * q2) * B5 + q3 * B4 - q4 * B3 + q5 * (SQRT_3 * B2 + B1)
        sink = solution%matrix%sink * q_y
        q_y = solution%matrix%source * (S1 * q1 + S2 * q2 + S3 * q3 + S4 * q4 + S5 * q5) + g_y(i, k)
        n1 = sink * S1 + decay * q1 - 2 * w1 * q3 - w2 * q4 + w3 * q5 + g_B(i, 1, k)
        n2 = sink * S2 + decay * q2 + SQRT_3 * (w2 * q4 + w3 * q5) + g_B(i, 2, k)
        n3 = sink * S3 + decay * q3 + 2 * w1 * q1 - w2 * q5 - w3 * q4 + g_B(i, 3, k)
        n4 = sink * S4 + decay * q4 - w2 * (SQRT_3 * q2 - q1) - w1 * q5 + w3 * q3 + g_B(i, 4, k)
        q5 = sink * S5 + decay * q5 - w3 * (SQRT_3 * q2 + q1) + w1 * q4 + w2 * q3 + g_B(i, 5, k)
        q1 = n1
        q2 = n2
        q3 = n3
        q4 = n4
        k = k - 1
        if (k < 0) exit
      end do
      by_A(i, 1) = q1
      by_A(i, 2) = q2
      by_A(i, 3) = q3
      by_A(i, 4) = q4
      by_A(i, 5) = q5
      by_S(i, 1) = solution%matrix%source * source1 + solution%matrix%sink * sink1
      by_S(i, 2) = solution%matrix%source * source2 + solution%matrix%sink * sink2
      by_S(i, 3) = solution%matrix%source * source3 + solution%matrix%sink * sink3
      by_S(i, 4) = solution%matrix%source * source4 + solution%matrix%sink * sink4
      by_S(i, 5) = solution%matrix%source * source5 + solution%matrix%sink * sink5
      by_decay(i) = total
      by_spin(i, 1) = turn1
      by_spin(i, 2) = turn2
      by_spin(i, 3) = turn3
    end do
  end subroutine pull_fabric

end module granumat_fabric
