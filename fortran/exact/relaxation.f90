!> The elastic strain e_r: weights of the exponential integration of granumat_law's relaxation_rate (docs/theory.md, section 4).
!!
!! With ratio = |D|/e_r and u = 1 - t, the deviator at the end of an increment, rotations apart, is
!!   sigma'(1) = exp(-ratio) sigma'(0) + integral of ratio exp(-ratio u) sigma'_model du.
!! sigma'_model is interpolated in t by the polynomial through given places and the product with the kernel is integrated exactly.
!! So every ratio is stable, and the limit e_r -> 0 is sigma'_model itself.
module granumat_relaxation
  use granumat_kinds, only: dp, LANES
  implicit none (type, external)
  private
  public :: relaxation_weights, relaxation_weights_slope

  real(dp), parameter :: MOMENT_TOLERANCE = 1.0e-17_dp      ! last term of the series over the sum: below round-off
  real(dp), parameter :: FORWARD_RECURRENCE_FROM = 5       ! ratio from which the forward recurrence is exact to round-off

contains

  !> Weights of sigma'_model at distinct places u = 1 - t.
  pure function relaxation_weights(ratio, u) result(weights)
    real(dp), intent(in) :: ratio(LANES)      ! |D|/e_r
    real(dp), intent(in) :: u(:, :)           ! (LANES, n)
    real(dp) :: weights(LANES, size(u, 2))

    weights = moments(ratio, size(u, 2))
    call solve_moments(u, weights)
  end function relaxation_weights

  !> The derivative of the weights by the ratio, from that of the moments: exp(-ratio) - (j - 1) moment_j/ratio.
  pure function relaxation_weights_slope(ratio, u) result(slope)
    real(dp), intent(in) :: ratio(LANES)
    real(dp), intent(in) :: u(:, :)
    real(dp) :: slope(LANES, size(u, 2))
    integer :: j

    slope = moments(ratio, size(u, 2))
    do j = 1, size(u, 2)
      slope(:, j) = exp(-ratio) - (j - 1) * slope(:, j) / max(ratio, tiny(1.0_dp))
    end do
    call solve_moments(u, slope)
  end function relaxation_weights_slope

  !> Solves the Vandermonde system sum_i w_i u_i^(j-1) = moment_j in place: A. Bjorck, V. Pereyra, Math. Comput. 24 (1970) 893-903.
  pure subroutine solve_moments(u, weights)
    real(dp), intent(in) :: u(:, :)
    real(dp), intent(inout) :: weights(:, :)
    integer :: n, i, k

    n = size(u, 2)
    do k = 1, n - 1
      do i = n, k + 1, -1
        weights(:, i) = weights(:, i) - u(:, k) * weights(:, i - 1)
      end do
    end do
    do k = n - 1, 1, -1
      do i = k + 1, n
        weights(:, i) = weights(:, i) / (u(:, i) - u(:, i - k))
      end do
      do i = k, n - 1
        weights(:, i) = weights(:, i) - weights(:, i + 1)
      end do
    end do
  end subroutine solve_moments

  !> The moments of the kernel: integral of ratio exp(-ratio u) u^(j-1) over 0 <= u <= 1, j = 1 ... n.
  !!
  !! Up to FORWARD_RECURRENCE_FROM the last moment comes from its series, all terms of which are positive, and the others by the
  !! recurrence backward, which is stable there; above it the recurrence runs forward.
  pure function moments(ratio, n) result(moment)
    real(dp), intent(in) :: ratio(LANES)
    integer, intent(in) :: n
    real(dp) :: moment(LANES, n), small(LANES), large(LANES), edge(LANES), term(LANES), forward(LANES)
    integer :: j

    small = min(ratio, FORWARD_RECURRENCE_FROM)
    edge = exp(-small)
    term = edge * small / n
    moment(:, n) = term
    j = n
    do while (any(term > MOMENT_TOLERANCE * moment(:, n)))
      j = j + 1
      term = term * small * (1.0_dp / j)
      moment(:, n) = moment(:, n) + term
    end do
    do j = n, 2, -1
      moment(:, j - 1) = small * (1.0_dp / (j - 1)) * (moment(:, j) + edge)
    end do
    if (all(ratio <= FORWARD_RECURRENCE_FROM)) return

    large = max(ratio, FORWARD_RECURRENCE_FROM)
    edge = exp(-large)
    forward = 1 - edge
    do j = 1, n
      if (j > 1) forward = (j - 1) / large * forward - edge
      moment(:, j) = merge(forward, moment(:, j), ratio > FORWARD_RECURRENCE_FROM)
    end do
  end function moments

end module granumat_relaxation
