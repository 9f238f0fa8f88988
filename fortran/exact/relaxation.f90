!> The elastic strain e_r: weights of the exponential integration of granumat_law's relaxation_rate (docs/theory.md, section 4).
!!
!! With ratio = |D|/e_r and u = 1 - t, the deviator at the end of an increment, rotations apart, is
!!   sigma'(1) = exp(-ratio) sigma'(0) + integral of ratio exp(-ratio u) sigma'_model du.
!! sigma'_model is interpolated in t by the polynomial through given places and the product with the kernel is integrated exactly.
!! So every ratio is stable, and the limit e_r -> 0 is sigma'_model itself.
module granumat_relaxation
  use granumat_kinds, only: dp, LANES
  use granumat_quadrature, only: N_NODES
  implicit none (type, external)
  private
  public :: relaxation_weights, relaxation_weights_slope

  real(dp), parameter :: MOMENT_TOLERANCE = 1.0e-17_dp      ! last term of the series over the sum: below round-off
  real(dp), parameter :: FORWARD_RECURRENCE_FROM = 5       ! ratio from which the forward recurrence is exact to round-off

contains

  !> Weights of sigma'_model at distinct places u = 1 - t: the first is the end, u = 0, quadrature nodes follow.
  pure function relaxation_weights(ratio, u, nodes, n) result(weights)
    real(dp), intent(in) :: ratio(LANES)             ! |D|/e_r
    real(dp), intent(in) :: u(LANES, 0:N_NODES)
    integer, intent(in) :: nodes(LANES), n           ! nodes in use, and the most of them; what follows has no weight
    real(dp) :: weights(LANES, 0:N_NODES)

    weights = moments(ratio)
    call solve_moments(u, nodes, n, weights)
  end function relaxation_weights

  !> The derivative of the weights by the ratio, from that of the moments: exp(-ratio) - (j - 1) moment_j/ratio.
  pure function relaxation_weights_slope(ratio, u, nodes, n) result(slope)
    real(dp), intent(in) :: ratio(LANES), u(LANES, 0:N_NODES)
    integer, intent(in) :: nodes(LANES), n
    real(dp) :: slope(LANES, 0:N_NODES)
    integer :: j

    slope = moments(ratio)
    do j = 0, n
      slope(:, j) = exp(-ratio) - j * slope(:, j) / max(ratio, tiny(1.0_dp))
    end do
    call solve_moments(u, nodes, n, slope)
  end function relaxation_weights_slope

  !> Solves the Vandermonde system sum_i w_i u_i^j = moment_j in place: A. Bjorck, V. Pereyra, Math. Comput. 24 (1970) 893-903.
  !!
  !! Its first stage makes moments of Newton's polynomials, the j-th of which knows the places before j only. Those that a lane
  !! does not use are left out there, and their weights come out as 0.
  pure subroutine solve_moments(u, nodes, n, weights)
    real(dp), intent(in) :: u(LANES, 0:N_NODES)
    integer, intent(in) :: nodes(LANES), n
    real(dp), intent(inout) :: weights(LANES, 0:N_NODES)
    integer :: i, k

    do k = 1, n - 1                            ! u_0 = 0
      do i = n, k + 1, -1
        weights(:, i) = weights(:, i) - u(:, k) * weights(:, i - 1)
      end do
    end do
    do i = 2, n
      weights(:, i) = merge(weights(:, i), 0.0_dp, i <= nodes)
    end do
    do k = n - 1, 0, -1
      do i = k + 1, n
        weights(:, i) = weights(:, i) / (u(:, i) - u(:, i - k - 1))
      end do
      do i = k, n - 1
        weights(:, i) = weights(:, i) - weights(:, i + 1)
      end do
    end do
  end subroutine solve_moments

  !> The moments of the kernel: integral of ratio exp(-ratio u) u^j over 0 <= u <= 1, j = 0 ... N_NODES.
  !!
  !! Up to FORWARD_RECURRENCE_FROM the last moment comes from its series, all terms of which are positive, and the others by the
  !! recurrence backward, which is stable there; above it the recurrence runs forward.
  pure function moments(ratio) result(moment)
    real(dp), intent(in) :: ratio(LANES)
    real(dp) :: moment(LANES, 0:N_NODES), small(LANES), large(LANES), edge(LANES), term(LANES), forward(LANES)
    integer :: j

    small = min(ratio, FORWARD_RECURRENCE_FROM)
    edge = exp(-small)
    term = edge * small / (N_NODES + 1)
    moment(:, N_NODES) = term
    j = N_NODES + 1
    do while (any(term > MOMENT_TOLERANCE * moment(:, N_NODES)))
      j = j + 1
      term = term * small * (1.0_dp / j)
      moment(:, N_NODES) = moment(:, N_NODES) + term
    end do
    do j = N_NODES, 1, -1
      moment(:, j - 1) = small * (1.0_dp / j) * (moment(:, j) + edge)
    end do
    if (all(ratio <= FORWARD_RECURRENCE_FROM)) return

    large = max(ratio, FORWARD_RECURRENCE_FROM)
    edge = exp(-large)
    forward = 1 - edge
    do j = 0, N_NODES
      if (j > 0) forward = j / large * forward - edge
      moment(:, j) = merge(forward, moment(:, j), ratio > FORWARD_RECURRENCE_FROM)
    end do
  end function moments

end module granumat_relaxation
