!> A strain increment: a deformation with a velocity gradient that is constant over it, 0 <= t <= 1.
module granumat_increment
  use granumat_kinds, only: dp, LANES
  use granumat_tensors, only: deviator, rotate, rotation, safe_magnitude, trace
  implicit none (type, external)
  private
  public :: to_increment, make_nonlocal, without_spin

  ! The arrays of this type and of the types built on it come before single lanes, so that all start where vectors load fast.
  type, public :: increment
    real(dp) :: direction(LANES, 6)    !! D^ = D/|D|
    real(dp) :: S_hat(LANES, 5)        !! S^ = S/|D|
    real(dp) :: tr_direction(LANES)    !! tr D^; with a length tr D/m
    real(dp) :: mod_D(LANES)           !! |D|
    real(dp) :: tr_D(LANES)            !! tr D
    real(dp) :: spin(LANES, 3)         !! W12 W13 W23
    real(dp) :: nonlocal(LANES)        !! m, the nonlocal strain; without a length |D|
    real(dp) :: R(LANES)               !! |D|/m, 1 without a length
    logical :: has_length              !! whether m was given
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
    inc%nonlocal = inc%mod_D
    inc%R = 1
    inc%has_length = .false.
  end subroutine to_increment

  !> Gives an increment its nonlocal strain. Where D = 0 and m > 0, D^ is the last direction, turned by the spin.
  pure subroutine make_nonlocal(nonlocal, last_direction, inc)
    real(dp), intent(in) :: nonlocal(LANES)             ! m, above 0 where D is not 0
    real(dp), intent(in) :: last_direction(LANES, 6)    ! of any magnitude
    type(increment), intent(inout) :: inc
    real(dp) :: inverse(LANES), turned(LANES, 6)
    integer :: k

    inverse = 1 / max(nonlocal, tiny(1.0_dp))
    inc%nonlocal = nonlocal
    inc%R = inverse * inc%mod_D
    inc%tr_direction = inverse * inc%tr_D
    inc%has_length = .true.
    if (all(inc%mod_D > 0)) return
    turned = rotate(rotation(inc%spin), last_direction)
    inverse = 1 / max(safe_magnitude(turned), tiny(1.0_dp))
    do k = 1, 6
      inc%direction(:, k) = merge(inc%direction(:, k), inverse * turned(:, k), inc%mod_D > 0)
    end do
    inc%S_hat = deviator(inc%direction)
  end subroutine make_nonlocal

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
