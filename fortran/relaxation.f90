!> The elastic strain scale: d sigma'/ds = (sigma'_model - sigma')/e_r, s the integral of |D|, carried along by the spin.
!!
!! Integrated by its own exponential: sigma'_model is interpolated in t, its product with the kernel integrated exactly,
!! so any ratio of increment and scale is stable and the limit e_r -> 0 is the model itself.
module granumat_relaxation
  use granumat_kinds, only: dp
  use granumat_tensors, only: LANES
  implicit none (type, external)
  private
  public :: relaxation_weights, relaxation_weights_slope

  real(dp), parameter :: SERIES_END = 1.0e-17_dp
  real(dp), parameter :: FORWARD_FROM = 12   ! above it the forward recurrence of the moments loses less than two digits

contains

  !> Weights of sigma'_model at the places u = 1 - t (distinct), for the kernel ratio exp(-ratio u).
  pure function relaxation_weights(ratio, u) result(weights)
    real(dp), intent(in) :: ratio(LANES)      ! strain increment over e_r
    real(dp), intent(in) :: u(:, :)           ! (LANES, n)
    real(dp) :: weights(LANES, size(u, 2))

    weights = moments(ratio, size(u, 2))
    call solve_moments(u, weights)
  end function relaxation_weights

  !> Their derivative by the ratio; that of moment_j is exp(-ratio) - (j - 1) moment_j / ratio.
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

  !> Bjorck & Pereyra (1970): the Vandermonde system sum_i w_i u_i^(j-1) = moment_j, solved in place.
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

  !> moment_j = integral of ratio exp(-ratio u) u^(j-1) over 0 <= u <= 1, j = 1 ... n.
  pure function moments(ratio, n) result(moment)
    real(dp), intent(in) :: ratio(LANES)
    integer, intent(in) :: n
    real(dp) :: moment(LANES, n), small(LANES), large(LANES), edge(LANES), term(LANES), forward(LANES)
    integer :: j

    small = min(ratio, FORWARD_FROM)
    edge = exp(-small)
    term = edge * small / n            ! series of the last moment, all terms positive; the rest by backward recurrence
    moment(:, n) = term
    j = n
    do while (any(term > SERIES_END * moment(:, n)))
      j = j + 1
      term = term * small * (1.0_dp / j)
      moment(:, n) = moment(:, n) + term
    end do
    do j = n, 2, -1
      moment(:, j - 1) = small * (1.0_dp / (j - 1)) * (moment(:, j) + edge)
    end do
    if (all(ratio <= FORWARD_FROM)) return

    large = max(ratio, FORWARD_FROM)
    edge = exp(-large)
    forward = 1 - edge
    do j = 1, n
      if (j > 1) forward = (j - 1) / large * forward - edge
      moment(:, j) = merge(forward, moment(:, j), ratio > FORWARD_FROM)
    end do
  end function moments

end module granumat_relaxation
