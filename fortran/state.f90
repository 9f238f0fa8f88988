!> What a material point remembers: 20 numbers, 160 bytes, the same in Fortran, C and numpy.
module granumat_state
  use, intrinsic :: iso_c_binding, only: c_double
  use, intrinsic :: ieee_arithmetic, only: ieee_is_finite
  use granumat_kinds, only: dp
  use granumat_status, only: OK, NOT_FINITE, BAD_VOLUME_FRACTION, BAD_FABRIC
  use granumat_tensors, only: trace
  implicit none (type, external)
  private
  public :: check_state, is_finite, is_realisable

  type, public, bind(c) :: material_state
    real(c_double) :: stress(6)             !! Cauchy stress, tension positive, in units of k/d (or k_Hz)
    real(c_double) :: fabric(6)             !! A (3.1)
    real(c_double) :: direction(6)          !! D^ = D/|D| of the last strain, 0 before any
    real(c_double) :: coordination_number   !! Z2
    real(c_double) :: volume_fraction       !! phi
  end type material_state

  real(dp), parameter :: ROUND_OFF = 1.0e-12_dp   ! in fabrics of order one: far above what a long path gathers

contains

  !> Status of a state that is to be updated.
  pure function check_state(state) result(status)
    type(material_state), intent(in) :: state
    integer :: status

    status = OK
    if (.not. is_finite(state)) then
      status = NOT_FINITE
    else if (.not. (state%volume_fraction > 0 .and. state%volume_fraction < 1)) then
      status = BAD_VOLUME_FRACTION
    else if (.not. is_realisable(state%fabric)) then
      status = BAD_FABRIC
    end if
  end function check_state

  pure function is_finite(state) result(finite)
    type(material_state), intent(in) :: state
    logical :: finite
    finite = all(ieee_is_finite(state%stress)) .and. all(ieee_is_finite(state%fabric)) &
      .and. all(ieee_is_finite(state%direction)) .and. ieee_is_finite(state%coordination_number) &
      .and. ieee_is_finite(state%volume_fraction)
  end function is_finite

  !> Whether A is traceless and A + I/3, a mean of n n, is positive semidefinite (its eigenvalues then lie in [0, 1]).
  pure function is_realisable(A) result(realisable)
    real(dp), intent(in) :: A(6)
    logical :: realisable
    real(dp) :: F(6), minor(3), determinant

    realisable = .false.
    if (any(abs(A) > 1)) return
    if (abs(trace(A)) > ROUND_OFF) return
    F = A
    F(1:3) = A(1:3) + 1.0_dp / 3
    minor = [F(1) * F(2) - F(4)**2, F(1) * F(3) - F(5)**2, F(2) * F(3) - F(6)**2]
    determinant = F(1) * minor(3) - F(4) * (F(4) * F(3) - F(5) * F(6)) + F(5) * (F(4) * F(6) - F(5) * F(2))
    realisable = minval([F(1:3), minor, determinant]) >= -ROUND_OFF
  end function is_realisable

end module granumat_state
