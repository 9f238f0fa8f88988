!> Many points in one call; every point is computed as it would be alone.
module granumat_batch
  use granumat_kinds, only: dp
  use granumat_parameters, only: material_parameters, are_valid
  use granumat_state, only: lane_state, material_state, gather, scatter
  use granumat_status, only: BAD_PARAMETERS
  use granumat_tensors, only: LANES, strain_and_spin
  use granumat_update, only: update
  implicit none (type, external)
  private
  public :: update_batch

contains

  subroutine update_batch(par, old, gradient, threads, new, status)
    type(material_parameters), intent(in) :: par
    type(material_state), intent(in) :: old(:)
    real(dp), intent(in) :: gradient(:, :, :)      ! (3, 3, n): (j, i) = du_i/dx_j of each increment
    integer, intent(in) :: threads                 ! OpenMP threads to share the points among
    type(material_state), intent(out) :: new(:)
    integer, intent(out) :: status(:)
    type(lane_state) :: x, x_new
    real(dp) :: strain(LANES, 6), spin(LANES, 3)
    integer :: lane_status(LANES), first, last

    if (.not. are_valid(par)) then
      new = old
      status = BAD_PARAMETERS
      return
    end if
    !$omp parallel do num_threads(threads) if(threads > 1) private(x, x_new, strain, spin, lane_status, last)
    do first = 1, size(old), LANES
      last = min(first + LANES - 1, size(old))
      call gather(old(first:last), x)
      call strain_and_spin(gradient(:, :, first:last), strain, spin)
      call update(par, x, strain, spin, x_new, lane_status)
      call scatter(x_new, new(first:last))
      status(first:last) = lane_status(:last - first + 1)
    end do
  end subroutine update_batch

end module granumat_batch
