!> The fabric equation (4.7) under a constant velocity gradient, solved exactly (docs/theory.md, section 2).
!!
!! With A = B/y, (4.7) is linear: the pair (B, y) follows
!!   B' = W B - B W + c1 y S + c2 m B,   y' = -c3 B : S,   B(0) = A, y(0) = 1,
!! with m = |D|, or the nonlocal strain m where there is a length.
!! The Taylor series of its solution, B = sum_k B_k t^k and y = sum_k y_k t^k, gives A = B/y and A : S = -y'/(c3 y) anywhere in the
!! increment, 0 <= t <= 1. The fabric blows up where y reaches 0.
module granumat_fabric
  use granumat_kinds, only: dp, LANES
  use granumat_law, only: linear_fabric_rate
  use granumat_parameters, only: material_parameters
  use granumat_quadrature, only: N_NODES
  use granumat_tensors, only: SQRT_3, contract, rotation_angle, times
  implicit none (type, external)
  private
  public :: solve_fabric, adjoint_fabric, fabric_rate_bound, fabric_at, projections_at

  integer, parameter, public :: MAX_TERMS = 20
  real(dp), parameter :: SERIES_TOLERANCE = 1.0e-17_dp   ! bound of the first neglected term over the solution: below round-off

  !> The coefficients of B and y, and the increment that they belong to.
  type, public :: fabric_solution
    real(dp) :: B(LANES, 5, 0:MAX_TERMS), y(LANES, 0:MAX_TERMS)
    real(dp) :: bound(LANES, 0:MAX_TERMS)      !! of the terms at t = 1, relative to the solution
    real(dp) :: factor(LANES, MAX_TERMS)       !! 1/k; 0 from the term on that a lane does not need
    real(dp) :: S(LANES, 5)                    !! deviatoric strain increment
    real(dp) :: decay(LANES)                   !! c2 m
    real(dp) :: spin(LANES, 3)
    real(dp) :: source, sink                   !! c1, -c3
    integer :: terms
  end type fabric_solution

contains

  !> A bound of the norm of the linear system's matrix, per increment: how fast anything in (4.7) can change.
  pure function fabric_rate_bound(par, largest, w) result(rate)
    type(material_parameters), intent(in) :: par
    real(dp), intent(in) :: largest(LANES), w(LANES, 3)       ! the larger of |D| and m; the spin
    real(dp) :: rate(LANES)
    rate = (abs(par%c2) + sqrt(-2 * par%c1 * par%c3)) * largest + 2 * rotation_angle(w)
  end function fabric_rate_bound

  !> Solves (4.7) over one increment, to round-off for a fabric_rate_bound of at most 1.
  pure subroutine solve_fabric(par, A, S, mod_D, nonlocal, w, solution)
    type(material_parameters), intent(in) :: par
    real(dp), intent(in) :: A(LANES, 5)      ! fabric at t = 0
    real(dp), intent(in) :: S(LANES, 5)      ! deviatoric strain increment
    real(dp), intent(in) :: mod_D(LANES)     ! |D| of the strain increment
    real(dp), intent(in) :: nonlocal(LANES)  ! m
    real(dp), intent(in) :: w(LANES, 3)      ! spin increment
    type(fabric_solution), intent(out) :: solution
    real(dp) :: rate(LANES)
    integer :: k

    rate = fabric_rate_bound(par, max(mod_D, nonlocal), w)
    solution%S = S
    solution%decay = par%c2 * nonlocal
    solution%spin = w
    solution%source = par%c1
    solution%sink = -par%c3
    solution%B(:, :, 0) = A
    solution%y(:, 0) = 1
    solution%bound(:, 0) = 1
    do k = 1, MAX_TERMS
      solution%factor(:, k) = merge(1.0_dp / k, 0.0_dp, solution%bound(:, k - 1) >= SERIES_TOLERANCE)
      call next_term(par, S, nonlocal, w, solution%factor(:, k), solution%B(:, :, k - 1), solution%y(:, k - 1), &
        solution%B(:, :, k), solution%y(:, k))
      solution%bound(:, k) = solution%bound(:, k - 1) * (rate / k)
      solution%terms = k
      if (all(solution%bound(:, k) < SERIES_TOLERANCE)) exit
    end do
  end subroutine solve_fabric

  !> The next coefficients of the series: factor, which is 1/k, times the right-hand side of the linear system.
  pure subroutine next_term(par, S, nonlocal, w, factor, B, y, next_B, next_y)
    type(material_parameters), intent(in) :: par
    real(dp), intent(in) :: S(LANES, 5), nonlocal(LANES), w(LANES, 3), factor(LANES), B(LANES, 5), y(LANES)
    real(dp), intent(out) :: next_B(LANES, 5), next_y(LANES)

    next_B = times(factor, linear_fabric_rate(par, B, y, S, nonlocal, w))
    next_y = -par%c3 * factor * contract(B, S)
  end subroutine next_term

  !> y, positive as long as the fabric has not blown up, and A : S = -y'/(c3 y) at the quadrature nodes, by Horner's scheme.
  pure subroutine projections_at(par, solution, t, y, A_S)
    type(material_parameters), intent(in) :: par
    type(fabric_solution), intent(in) :: solution
    real(dp), intent(in) :: t(LANES, N_NODES)
    real(dp), intent(out) :: y(LANES, N_NODES), A_S(LANES, N_NODES)
    real(dp) :: y_i(N_NODES), dot_y(N_NODES), term
    integer :: i, j, k

    do i = 1, LANES                            ! the loop over k runs at least once, so that GCC vectorises this one
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

  !> A and y at t, by Horner's scheme.
  pure subroutine fabric_at(solution, t, A, y)
    type(fabric_solution), intent(in) :: solution
    real(dp), intent(in) :: t(LANES)
    real(dp), intent(out) :: A(LANES, 5), y(LANES)
    real(dp) :: total(6)
    integer :: i, j, k

    do i = 1, LANES                            ! vectorised as in projections_at
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

  !> The adjoint of the series: derivatives of a sum over k of g_B_k : B_k + g_y_k y_k by A, S, c2 m and W
  !! (docs/theory.md, section 7.7).
  !!
  !! With M the matrix of the linear system, (B_k, y_k) = M (B_(k-1), y_(k-1))/k, the adjoint q runs backward:
  !!   q_(k-1) = M^T q_k/k + g_(k-1),  M^T (x, x_y) = (-(W x - x W) + c2 m x - c3 x_y S,  c1 S : x),
  !! and what depends on M is summed on the way, with (x, x_y) = q_k/k:
  !!   by_S += c1 y_(k-1) x - c3 x_y B_(k-1),   by_decay += x : B_(k-1),   by_spin += spin_derivative(x, B_(k-1)).
  !! Written out by component: array expressions of LANES x 5 cost 12 to 25 % more here.
  pure subroutine adjoint_fabric(solution, terms, g_B, g_y, by_A, by_S, by_decay, by_spin)
    type(fabric_solution), intent(in) :: solution
    integer, intent(in) :: terms
    real(dp), intent(in) :: g_B(LANES, 5, 0:MAX_TERMS), g_y(LANES, 0:MAX_TERMS)
    real(dp), intent(out) :: by_A(LANES, 5), by_S(LANES, 5), by_decay(LANES), by_spin(LANES, 3)
    real(dp) :: q1, q2, q3, q4, q5, q_y, x1, x2, x3, x4, x5, x_y, B1, B2, B3, B4, B5, S1, S2, S3, S4, S5
    real(dp) :: decay, w1, w2, w3, source, sink, sum_S1, sum_S2, sum_S3, sum_S4, sum_S5, sum_decay, sum_W1, sum_W2, sum_W3
    integer :: i, k

    do i = 1, LANES                            ! vectorised as in projections_at
      decay = solution%decay(i)
      w1 = solution%spin(i, 1)
      w2 = solution%spin(i, 2)
      w3 = solution%spin(i, 3)
      S1 = solution%S(i, 1)
      S2 = solution%S(i, 2)
      S3 = solution%S(i, 3)
      S4 = solution%S(i, 4)
      S5 = solution%S(i, 5)
      q1 = g_B(i, 1, terms)
      q2 = g_B(i, 2, terms)
      q3 = g_B(i, 3, terms)
      q4 = g_B(i, 4, terms)
      q5 = g_B(i, 5, terms)
      q_y = g_y(i, terms)
      sum_S1 = 0
      sum_S2 = 0
      sum_S3 = 0
      sum_S4 = 0
      sum_S5 = 0
      sum_decay = 0
      sum_W1 = 0
      sum_W2 = 0
      sum_W3 = 0
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
        source = solution%source * solution%y(i, k)
        sink = solution%sink * x_y
        sum_S1 = sum_S1 + source * x1 + sink * B1
        sum_S2 = sum_S2 + source * x2 + sink * B2
        sum_S3 = sum_S3 + source * x3 + sink * B3
        sum_S4 = sum_S4 + source * x4 + sink * B4
        sum_S5 = sum_S5 + source * x5 + sink * B5
        sum_decay = sum_decay + x1 * B1 + x2 * B2 + x3 * B3 + x4 * B4 + x5 * B5
        sum_W1 = sum_W1 + 2 * (x1 * B3 - x3 * B1) + x4 * B5 - x5 * B4
        sum_W2 = sum_W2 + (x1 - SQRT_3 * x2) * B4 + x3 * B5 + x4 * (SQRT_3 * B2 - B1) - x5 * B3
        sum_W3 = sum_W3 - (x1 + SQRT_3 * x2) * B5 + x3 * B4 - x4 * B3 + x5 * (SQRT_3 * B2 + B1)
        q_y = solution%source * (S1 * x1 + S2 * x2 + S3 * x3 + S4 * x4 + S5 * x5) + g_y(i, k)
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
      by_S(i, 1) = sum_S1
      by_S(i, 2) = sum_S2
      by_S(i, 3) = sum_S3
      by_S(i, 4) = sum_S4
      by_S(i, 5) = sum_S5
      by_decay(i) = sum_decay
      by_spin(i, 1) = sum_W1
      by_spin(i, 2) = sum_W2
      by_spin(i, 3) = sum_W3
    end do
  end subroutine adjoint_fabric

end module granumat_fabric
