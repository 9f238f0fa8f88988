!> Many points in one call; every point is computed as it would be alone.
module granumat_batch
  use granumat_kinds, only: dp
  use granumat_parameters, only: material_parameters, are_valid
  use granumat_state, only: material_state
  use granumat_status, only: BAD_PARAMETERS
  use granumat_tensors, only: strain_and_spin
  use granumat_update, only: update
  implicit none (type, external)
  private
  public :: update_batch

contains

  pure subroutine update_batch(par, old, gradient, new, status)
    type(material_parameters), intent(in) :: par
    type(material_state), intent(in) :: old(:)
    real(dp), intent(in) :: gradient(:, :, :)      ! (3, 3, n): (j, i) = du_i/dx_j of each increment
    type(material_state), intent(out) :: new(:)
    integer, intent(out) :: status(:)
    real(dp) :: strain(6), spin(3)
    integer :: i

    if (.not. are_valid(par)) then
      new = old
      status = BAD_PARAMETERS
      return
    end if
    do i = 1, size(old)
      call strain_and_spin(gradient(:, :, i), strain, spin)
      call update(par, old(i), strain, spin, new(i), status(i))
    end do
  end subroutine update_batch

end module granumat_batch
