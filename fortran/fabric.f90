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
    real(dp) :: decay(LANES)                   ! c2 |D|
    real(dp) :: spin(LANES, 3)
    real(dp) :: source, sink                   ! c1, -c3
  end type fabric_matrix

  !> The coefficients of B and y as power series in t, 0 <= t <= 1 over the increment.
  type, public :: fabric_solution
    real(dp) :: B(LANES, 5, 0:MAX_TERMS), y(LANES, 0:MAX_TERMS)
    real(dp) :: bound(LANES, 0:MAX_TERMS)      ! of the terms of their series over the solution, at t = 1
    real(dp) :: factor(LANES, MAX_TERMS)       ! 1/k, 0 from where a lane needs no more
    type(fabric_matrix) :: matrix
    integer :: terms
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
    real(dp) :: rate(LANES)
    integer :: k

    rate = fabric_rate(par, mod_D, w)
    solution%matrix = fabric_matrix(S, par%c2 * mod_D, w, par%c1, -par%c3)
    solution%B(:, :, 0) = A
    solution%y(:, 0) = 1
    solution%bound(:, 0) = 1
    do k = 1, MAX_TERMS
      solution%factor(:, k) = merge(1.0_dp / k, 0.0_dp, solution%bound(:, k - 1) >= SERIES_REST)
      call next_term(solution%matrix, solution%factor(:, k), solution%B(:, :, k - 1), solution%y(:, k - 1), &
        solution%B(:, :, k), solution%y(:, k))
      solution%bound(:, k) = solution%bound(:, k - 1) * (rate / k)
      solution%terms = k
      if (all(solution%bound(:, k) < SERIES_REST)) exit
    end do
  end subroutine solve_fabric

  !> The matrix times (B, y), times a factor, in one fused loop: hot.
  pure subroutine next_term(matrix, factor, B, y, next_B, next_y)
    type(fabric_matrix), intent(in) :: matrix
    real(dp), intent(in) :: factor(LANES), B(LANES, 5), y(LANES)
    real(dp), intent(out) :: next_B(LANES, 5), next_y(LANES)
    real(dp) :: decay, source, w1, w2, w3, B1, B2, B3, B4, B5
    integer :: i

    do i = 1, LANES
      B1 = factor(i) * B(i, 1)
      B2 = factor(i) * B(i, 2)
      B3 = factor(i) * B(i, 3)
      B4 = factor(i) * B(i, 4)
      B5 = factor(i) * B(i, 5)
      source = matrix%source * factor(i) * y(i)
      decay = matrix%decay(i)
      w1 = matrix%spin(i, 1)
      w2 = matrix%spin(i, 2)
      w3 = matrix%spin(i, 3)
      next_y(i) = matrix%sink * (matrix%S(i, 1) * B1 + matrix%S(i, 2) * B2 + matrix%S(i, 3) * B3 + matrix%S(i, 4) * B4 &
        + matrix%S(i, 5) * B5)
      next_B(i, 1) = source * matrix%S(i, 1) + decay * B1 + 2 * w1 * B3 + w2 * B4 - w3 * B5
      next_B(i, 2) = source * matrix%S(i, 2) + decay * B2 - SQRT_3 * (w2 * B4 + w3 * B5)
      next_B(i, 3) = source * matrix%S(i, 3) + decay * B3 - 2 * w1 * B1 + w2 * B5 + w3 * B4
      next_B(i, 4) = source * matrix%S(i, 4) + decay * B4 + w2 * (SQRT_3 * B2 - B1) + w1 * B5 - w3 * B3
      next_B(i, 5) = source * matrix%S(i, 5) + decay * B5 + w3 * (SQRT_3 * B2 + B1) - w1 * B4 - w2 * B3
    end do
  end subroutine next_term

  !> y (positive as long as the fabric has not blown up) and A:S = -y'/(c3 y) at the nodes.
  pure subroutine projections_at(par, solution, t, y, A_S)
    type(material_parameters), intent(in) :: par
    type(fabric_solution), intent(in) :: solution
    real(dp), intent(in) :: t(LANES, N_NODES)
    real(dp), intent(out) :: y(LANES, N_NODES), A_S(LANES, N_NODES)
    real(dp) :: y_i(N_NODES), dot_y(N_NODES), term
    integer :: i, j, k

    do i = 1, LANES                            ! vectorised, with the sums in registers, as the loop over the terms surely runs
      y_i = 0
      dot_y = 0
      k = solution%terms
      do
        term = solution%y(i, k)
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
    real(dp) :: total(6)
    integer :: i, j, k

    do i = 1, LANES                            ! vectorised as above
      total = 0
      k = solution%terms
      do
        do j = 1, 5
          total(j) = total(j) * t(i) + solution%B(i, j, k)
        end do
        total(6) = total(6) * t(i) + solution%y(i, k)
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
    real(dp) :: q1, q2, q3, q4, q5, q_y, x1, x2, x3, x4, x5, x_y, B1, B2, B3, B4, B5, S1, S2, S3, S4, S5
    real(dp) :: decay, w1, w2, w3, source, sink, from_S1, from_S2, from_S3, from_S4, from_S5, from_decay, turn1, turn2, turn3
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
      from_S1 = 0
      from_S2 = 0
      from_S3 = 0
      from_S4 = 0
      from_S5 = 0
      from_decay = 0
      turn1 = 0
      turn2 = 0
      turn3 = 0
      k = terms
      do
        x1 = solution%factor(i, k) * q1
        x2 = solution%factor(i, k) * q2
        x3 = solution%factor(i, k) * q3
        x4 = solution%factor(i, k) * q4
        x5 = solution%factor(i, k) * q5
        x_y = solution%factor(i, k) * q_y
        k = k - 1
        B1 = solution%B(i, 1, k)
        B2 = solution%B(i, 2, k)
        B3 = solution%B(i, 3, k)
        B4 = solution%B(i, 4, k)
        B5 = solution%B(i, 5, k)
        source = solution%matrix%source * solution%y(i, k)
        sink = solution%matrix%sink * x_y
        from_S1 = from_S1 + source * x1 + sink * B1
        from_S2 = from_S2 + source * x2 + sink * B2
        from_S3 = from_S3 + source * x3 + sink * B3
        from_S4 = from_S4 + source * x4 + sink * B4
        from_S5 = from_S5 + source * x5 + sink * B5
        from_decay = from_decay + x1 * B1 + x2 * B2 + x3 * B3 + x4 * B4 + x5 * B5
        turn1 = turn1 + 2 * (x1 * B3 - x3 * B1) + x4 * B5 - x5 * B4
        turn2 = turn2 + (x1 - SQRT_3 * x2) * B4 + x3 * B5 + x4 * (SQRT_3 * B2 - B1) - x5 * B3
        turn3 = turn3 - (x1 + SQRT_3 * x2) * B5 + x3 * B4 - x4 * B3 + x5 * (SQRT_3 * B2 + B1)
        q_y = solution%matrix%source * (S1 * x1 + S2 * x2 + S3 * x3 + S4 * x4 + S5 * x5) + g_y(i, k)
        q1 = g_B(i, 1, k) + sink * S1 + decay * x1 - 2 * w1 * x3 - w2 * x4 + w3 * x5
        q2 = g_B(i, 2, k) + sink * S2 + decay * x2 + SQRT_3 * (w2 * x4 + w3 * x5)
        q3 = g_B(i, 3, k) + sink * S3 + decay * x3 + 2 * w1 * x1 - w2 * x5 - w3 * x4
        q4 = g_B(i, 4, k) + sink * S4 + decay * x4 - w2 * (SQRT_3 * x2 - x1) - w1 * x5 + w3 * x3
        q5 = g_B(i, 5, k) + sink * S5 + decay * x5 - w3 * (SQRT_3 * x2 + x1) + w1 * x4 + w2 * x3
        if (k <= 0) exit
      end do
      by_A(i, 1) = q1
      by_A(i, 2) = q2
      by_A(i, 3) = q3
      by_A(i, 4) = q4
      by_A(i, 5) = q5
      by_S(i, 1) = from_S1
      by_S(i, 2) = from_S2
      by_S(i, 3) = from_S3
      by_S(i, 4) = from_S4
      by_S(i, 5) = from_S5
      by_decay(i) = from_decay
      by_spin(i, 1) = turn1
      by_spin(i, 2) = turn2
      by_spin(i, 3) = turn3
    end do
  end subroutine pull_fabric

end module granumat_fabric
