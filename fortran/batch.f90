!> Many points in one call; every point is computed as it would be alone.
module granumat_batch
  use granumat_kinds, only: dp
  use granumat_parameters, only: material_parameters, are_valid
  use granumat_state, only: lane_state, material_state, gather, scatter
  use granumat_status, only: BAD_PARAMETERS
  use granumat_tangent, only: N_COLUMNS, PULLED_IN_SPACE, PULLED_IN_PLANE, PLANE_COLUMNS
  use granumat_tensors, only: LANES, strain_and_spin
  use granumat_update, only: update
  implicit none (type, external)
  private
  public :: update_batch

contains

  subroutine update_batch(par, old, gradient, threads, new, status, tangent)
    type(material_parameters), intent(in) :: par
    type(material_state), intent(in) :: old(:)
    real(dp), intent(in) :: gradient(:, :, :)      ! (3, 3, n): (j, i) = du_i/dx_j of each increment
    integer, intent(in) :: threads                 ! OpenMP threads to share the points among
    type(material_state), intent(out) :: new(:)
    integer, intent(out) :: status(:)
    real(dp), intent(out), optional :: tangent(:, :, :)   ! (j, i) = d stress_i / d (strain_j, spin_j):
      ! (6 or 9, 6, n) by the strains, and spins; (3 or 4, 4, n) stress 11 22 33 12 by PLANE_COLUMNS
    type(lane_state) :: x, x_new
    real(dp) :: strain(LANES, 6), spin(LANES, 3), lane_tangent(LANES, 6, N_COLUMNS)
    integer :: lane_status(LANES), first, last, i, j, columns(N_COLUMNS), n, n_pulled

    if (.not. are_valid(par)) then
      new = old
      status = BAD_PARAMETERS
      if (present(tangent)) tangent = 0
      return
    end if
    n = 0
    if (present(tangent)) n = size(tangent, 1)
    columns = [(j, j = 1, N_COLUMNS)]
    if (n < 6) columns(:4) = PLANE_COLUMNS
    n_pulled = merge(PULLED_IN_PLANE, PULLED_IN_SPACE, n < 6)
    !$omp parallel do num_threads(threads) if(threads > 1) &
    !$omp private(x, x_new, strain, spin, lane_tangent, lane_status, last, i, j)
    do first = 1, size(old), LANES
      last = min(first + LANES - 1, size(old))
      call gather(old(first:last), x)
      call strain_and_spin(gradient(:, :, first:last), strain, spin)
      if (n > 0) then
        call update(par, x, strain, spin, x_new, lane_status, n_pulled, lane_tangent)
        do i = first, last
          do j = 1, n
            tangent(j, :, i) = lane_tangent(i - first + 1, :size(tangent, 2), columns(j))
          end do
        end do
      else
        call update(par, x, strain, spin, x_new, lane_status)
      end if
      call scatter(x_new, new(first:last))
      status(first:last) = lane_status(:last - first + 1)
    end do
  end subroutine update_batch

end module granumat_batch
