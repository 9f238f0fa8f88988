!> The state of a material point, 20 numbers with the same layout in Fortran, C and NumPy; and those of LANES points side by side.
module granumat_state
  use, intrinsic :: iso_c_binding, only: c_double
  use granumat_kinds, only: dp, LANES
  use granumat_status, only: OK, NOT_FINITE, BAD_VOLUME_FRACTION, BAD_FABRIC
  use granumat_tensors, only: trace
  implicit none (type, external)
  private
  public :: gather, scatter, check_state, is_finite, is_realisable

  type, public, bind(c) :: material_state
    real(c_double) :: stress(6)             !! Cauchy stress, tension positive, in units of k/d (or k_Hz)
    real(c_double) :: fabric(6)             !! A (3.1)
    real(c_double) :: direction(6)          !! D^ = D/|D| of the last strain, 0 before any; or followed over e_r
    real(c_double) :: coordination_number   !! Z2
    real(c_double) :: volume_fraction       !! phi
  end type material_state

  type, public :: lane_state
    real(dp) :: stress(LANES, 6), fabric(LANES, 6), direction(LANES, 6), coordination_number(LANES), volume_fraction(LANES)
  end type lane_state

  real(dp), parameter, public :: REALISABLE = 0.578_dp   ! just above 1/sqrt(3), the largest |A| of a realisable fabric
  real(dp), parameter :: ROUND_OFF = 1.0e-12_dp   ! of fabrics of order one, far above what accumulates on a long path

contains

  !> Up to LANES points side by side; lanes that are left over repeat the last point.
  pure subroutine gather(points, x)
    type(material_state), intent(in) :: points(:)
    type(lane_state), intent(out) :: x
    integer :: i, j

    do i = 1, LANES
      j = min(i, size(points))
      x%stress(i, :) = points(j)%stress
      x%fabric(i, :) = points(j)%fabric
      x%direction(i, :) = points(j)%direction
      x%coordination_number(i) = points(j)%coordination_number
      x%volume_fraction(i) = points(j)%volume_fraction
    end do
  end subroutine gather

  !> The inverse of gather.
  pure subroutine scatter(x, points)
    type(lane_state), intent(in) :: x
    type(material_state), intent(out) :: points(:)
    integer :: i

    do i = 1, size(points)
      points(i)%stress = x%stress(i, :)
      points(i)%fabric = x%fabric(i, :)
      points(i)%direction = x%direction(i, :)
      points(i)%coordination_number = x%coordination_number(i)
      points(i)%volume_fraction = x%volume_fraction(i)
    end do
  end subroutine scatter

  !> Whether states can be updated, as a status.
  pure function check_state(x) result(status)
    type(lane_state), intent(in) :: x
    integer :: status(LANES)

    status = OK
    where (.not. is_realisable(x%fabric)) status = BAD_FABRIC
    where (.not. (x%volume_fraction > 0 .and. x%volume_fraction < 1)) status = BAD_VOLUME_FRACTION
    where (.not. is_finite(x)) status = NOT_FINITE
  end function check_state

  pure function is_finite(x) result(finite)
    type(lane_state), intent(in) :: x
    logical :: finite(LANES)
    real(dp) :: largest(LANES)
    integer :: k

    largest = abs(x%coordination_number) + abs(x%volume_fraction)      ! a sum is not finite if one of its terms is not
    do k = 1, 6
      largest = largest + abs(x%stress(:, k)) + abs(x%fabric(:, k)) + abs(x%direction(:, k))
    end do
    finite = largest <= huge(1.0_dp)
  end function is_finite

  !> Whether A is traceless and A + I/3, a mean of n n, is positive semidefinite (its eigenvalues then lie in [0, 1]).
  pure function is_realisable(A) result(realisable)
    real(dp), intent(in) :: A(LANES, 6)
    logical :: realisable(LANES)
    real(dp), dimension(LANES) :: xx, yy, zz, minor_xy, minor_xz, minor_yz, determinant, smallest

    xx = A(:, 1) + 1.0_dp / 3
    yy = A(:, 2) + 1.0_dp / 3
    zz = A(:, 3) + 1.0_dp / 3
    minor_xy = xx * yy - A(:, 4)**2
    minor_xz = xx * zz - A(:, 5)**2
    minor_yz = yy * zz - A(:, 6)**2
    determinant = xx * minor_yz - A(:, 4) * (A(:, 4) * zz - A(:, 5) * A(:, 6)) + A(:, 5) * (A(:, 4) * A(:, 6) - A(:, 5) * yy)
    smallest = min(xx, yy, zz, minor_xy, minor_xz, minor_yz, determinant)
    realisable = smallest >= -ROUND_OFF .and. abs(trace(A)) <= ROUND_OFF
  end function is_realisable

end module granumat_state
