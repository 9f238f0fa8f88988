!> A strain increment: a deformation with a velocity gradient that is constant over it, 0 <= t <= 1.
module granumat_increment
  use granumat_kinds, only: dp, LANES
  use granumat_tensors, only: deviator, safe_magnitude, trace
  implicit none (type, external)
  private
  public :: to_increment, without_spin

  ! The arrays of this type and of the types built on it come before single lanes, so that all start where vectors load fast.
  type, public :: increment
    real(dp) :: direction(LANES, 6)    !! D^ = D/|D|
    real(dp) :: S_hat(LANES, 5)        !! S^ = S/|D|
    real(dp) :: tr_direction(LANES)    !! tr D^
    real(dp) :: mod_D(LANES)           !! |D|
    real(dp) :: tr_D(LANES)            !! tr D
    real(dp) :: spin(LANES, 3)         !! W12 W13 W23
  end type increment

contains

  !> The increment of engineering strains and a spin; zero in lanes that are not wanted.
  pure subroutine to_increment(strain, spin, wanted, inc)
    real(dp), intent(in) :: strain(LANES, 6), spin(LANES, 3)
    logical, intent(in) :: wanted(LANES)
    type(increment), intent(out) :: inc
    real(dp) :: D(LANES, 6), inverse(LANES)
    integer :: i, k

    D(:, :3) = strain(:, :3)
    D(:, 4:) = strain(:, 4:) / 2
    inc%spin = spin
    do i = 1, LANES
      if (wanted(i)) cycle
      D(i, :) = 0
      inc%spin(i, :) = 0
    end do
    inc%mod_D = safe_magnitude(D)
    inverse = 1 / max(inc%mod_D, tiny(1.0_dp))
    do k = 1, 6
      inc%direction(:, k) = inverse * D(:, k)
    end do
    inc%S_hat = deviator(inc%direction)
    inc%tr_D = trace(D)
    inc%tr_direction = trace(inc%direction)
  end subroutine to_increment

  !> The increment without its spin in the lanes named.
  pure function without_spin(inc, lane) result(straight)
    type(increment), intent(in) :: inc
    logical, intent(in) :: lane(LANES)
    type(increment) :: straight
    integer :: k

    straight = inc
    do k = 1, 3
      straight%spin(:, k) = merge(0.0_dp, inc%spin(:, k), lane)
    end do
  end function without_spin

end module granumat_increment
