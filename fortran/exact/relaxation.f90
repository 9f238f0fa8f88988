!> The elastic strain e_r: weights of the exponential integration of granumat_law's relaxation_rate (docs/theory.md, section 4).
!!
!! With ratio = |D|/e_r, with a length m/e_r, and u = 1 - t, the deviator at the end of an increment, rotations apart, is
!!   sigma'(1) = exp(-ratio) sigma'(0) + integral of ratio exp(-ratio u) sigma'_model du.
!! sigma'_model is interpolated in t by the polynomial through given places and the product with the kernel is integrated exactly.
!! So every ratio is stable, and the limit e_r -> 0 is sigma'_model itself.
module granumat_relaxation
  use granumat_kinds, only: dp, LANES
  use granumat_quadrature, only: MAX_DEGREE
  implicit none (type, external)
  private
  public :: relaxation_weights, relaxation_weights_slope

  real(dp), parameter :: MOMENT_TOLERANCE = 1.0e-17_dp      ! last term of the series over the sum: below round-off
  real(dp), parameter :: FORWARD_RECURRENCE_FROM = 5       ! ratio from which the forward recurrence is exact to round-off

contains

  !> Weights of sigma'_model at distinct places u = 1 - t.
  pure function relaxation_weights(ratio, decay, u, degree, n) result(weights)
    real(dp), intent(in) :: ratio(LANES), decay(LANES)       ! |D|/e_r or m/e_r, and exp(-ratio)
    real(dp), intent(in) :: u(LANES, 0:MAX_DEGREE)
    real(dp), intent(in) :: degree(LANES)                    ! of the polynomial; places after so many have no weight
    integer, intent(in) :: n                                 ! the highest degree
    real(dp) :: weights(LANES, 0:MAX_DEGREE)

    weights = moments(ratio, decay)
    call solve_moments(u, degree, n, weights)
  end function relaxation_weights

  !> The derivative of the weights by the ratio, from that of the moments: exp(-ratio) - j moment_j/ratio.
  pure function relaxation_weights_slope(ratio, decay, u, degree, n) result(slope)
    real(dp), intent(in) :: ratio(LANES), decay(LANES), u(LANES, 0:MAX_DEGREE), degree(LANES)
    integer, intent(in) :: n
    real(dp) :: slope(LANES, 0:MAX_DEGREE), inverse(LANES)
    integer :: j

    inverse = 1 / max(ratio, tiny(1.0_dp))
    slope = moments(ratio, decay)
    do j = 0, MAX_DEGREE
      slope(:, j) = decay - j * slope(:, j) * inverse
    end do
    call solve_moments(u, degree, n, slope)
  end function relaxation_weights_slope

  !> Solves the Vandermonde system sum_i w_i u_i^j = moment_j in place: A. Bjorck, V. Pereyra, Math. Comput. 24 (1970) 893-903.
  !!
  !! The first stage makes moments of Newton's polynomials. Those above a lane's degree are left out, and the weights of the places
  !! that they would need come out as 0.
  pure subroutine solve_moments(u, degree, n, weights)
    real(dp), intent(in) :: u(LANES, 0:MAX_DEGREE), degree(LANES)
    integer, intent(in) :: n
    real(dp), intent(inout) :: weights(LANES, 0:MAX_DEGREE)
    integer :: i, k

    do k = 0, n - 1
      do i = n, k + 1, -1
        weights(:, i) = weights(:, i) - u(:, k) * weights(:, i - 1)
      end do
    end do
    do i = 2, n
      weights(:, i) = merge(weights(:, i), 0.0_dp, degree >= i)
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

  !> The moments of the kernel: integral of ratio exp(-ratio u) u^j over 0 <= u <= 1, j = 0 ... MAX_DEGREE.
  !!
  !! Up to FORWARD_RECURRENCE_FROM the last moment comes from its series, all terms of which are positive, and the others by the
  !! recurrence backward, which is stable there; above it the recurrence runs forward.
  pure function moments(ratio, decay) result(moment)
    real(dp), intent(in) :: ratio(LANES), decay(LANES)
    real(dp) :: moment(LANES, 0:MAX_DEGREE), small(LANES), large(LANES), edge(LANES), term(LANES), forward(LANES)
    integer :: j

    small = min(ratio, FORWARD_RECURRENCE_FROM)
    edge = max(decay, exp(-FORWARD_RECURRENCE_FROM))
    term = edge * small / (MAX_DEGREE + 1)
    moment(:, MAX_DEGREE) = term
    j = MAX_DEGREE + 1
    do while (any(term > MOMENT_TOLERANCE * moment(:, MAX_DEGREE)))
      j = j + 1
      term = term * small * (1.0_dp / j)
      moment(:, MAX_DEGREE) = moment(:, MAX_DEGREE) + term
    end do
    do j = MAX_DEGREE, 1, -1
      moment(:, j - 1) = small * (1.0_dp / j) * (moment(:, j) + edge)
    end do
    if (all(ratio <= FORWARD_RECURRENCE_FROM)) return

    large = max(ratio, FORWARD_RECURRENCE_FROM)
    forward = 1 - decay
    do j = 0, MAX_DEGREE
      if (j > 0) forward = j / large * forward - decay
      moment(:, j) = merge(forward, moment(:, j), ratio > FORWARD_RECURRENCE_FROM)
    end do
  end function moments

end module granumat_relaxation
