!> Many points in one call, shared among threads; every point is computed as it would be alone.
module granumat_batch
  use granumat_kinds, only: dp, LANES
  use granumat_methods, only: scheme, update_by_method
  use granumat_parameters, only: material_parameters, are_valid
  use granumat_state, only: lane_state, material_state, gather, scatter
  use granumat_status, only: BAD_PARAMETERS
  use granumat_tangent, only: N_COLUMNS, N_ADJOINTS_3D, N_ADJOINTS_PLANE, PLANE_COLUMNS
  use granumat_tensors, only: strain_and_spin
  use granumat_update, only: update
  implicit none (type, external)
  private
  public :: update_batch, update_batch_by_method

contains

  !> The exact update of many points, if wanted with its tangent.
  subroutine update_batch(par, old, gradient, threads, new, status, tangent, nonlocal, by_nonlocal)
    type(material_parameters), intent(in) :: par
    type(material_state), intent(in) :: old(:)
    real(dp), intent(in) :: gradient(:, :, :)      ! (3, 3, n): (j, i) = du_i/dx_j of each increment
    integer, intent(in) :: threads                 ! OpenMP threads to share the points among
    type(material_state), intent(out) :: new(:)
    integer, intent(out) :: status(:)
    real(dp), intent(out), optional :: tangent(:, :, :)   ! (j, i) = d stress_i / d (strain_j, spin_j):
      ! (6 or 9, 6, n) by the strains, and spins; (3 or 4, 4, n) stress 11 22 33 12 by PLANE_COLUMNS
    real(dp), intent(in), optional :: nonlocal(:)         ! the nonlocal strains of a material with a length
    real(dp), intent(out), optional :: by_nonlocal(:, :)  ! with the tangent (6 or 4, n): d stress_i / d nonlocal
    type(lane_state) :: x, x_new
    real(dp) :: strain(LANES, 6), spin(LANES, 3), lane_tangent(LANES, 6, N_COLUMNS), m(LANES), lane_by_nonlocal(LANES, 6)
    integer :: lane_status(LANES), first, last, i, j, columns(N_COLUMNS), n, n_adjoints

    if (.not. are_valid(par)) then
      new = old
      status = BAD_PARAMETERS
      if (present(tangent)) tangent = 0
      if (present(by_nonlocal)) by_nonlocal = 0
      return
    end if
    n = 0
    if (present(tangent)) n = size(tangent, 1)
    columns = [(j, j = 1, N_COLUMNS)]
    if (n < 6) columns(:4) = PLANE_COLUMNS
    n_adjoints = merge(N_ADJOINTS_PLANE, N_ADJOINTS_3D, n < 6)
    !$omp parallel do num_threads(threads) if(threads > 1) &
    !$omp private(x, x_new, strain, spin, lane_tangent, m, lane_by_nonlocal, lane_status, last, i, j)
    do first = 1, size(old), LANES
      last = min(first + LANES - 1, size(old))
      call gather(old(first:last), x)
      call strain_and_spin(gradient(:, :, first:last), strain, spin)
      if (present(nonlocal)) then
        m = 0
        m(:last - first + 1) = nonlocal(first:last)
      end if
      if (n > 0 .and. present(nonlocal)) then
        call update(par, x, strain, spin, x_new, lane_status, n_adjoints, lane_tangent, nonlocal=m, by_nonlocal=lane_by_nonlocal)
        by_nonlocal(:, first:last) = transpose(lane_by_nonlocal(:last - first + 1, :size(by_nonlocal, 1)))
      else if (n > 0) then
        call update(par, x, strain, spin, x_new, lane_status, n_adjoints, lane_tangent)
      else if (present(nonlocal)) then
        call update(par, x, strain, spin, x_new, lane_status, nonlocal=m)
      else
        call update(par, x, strain, spin, x_new, lane_status)
      end if
      if (n > 0) then
        do i = first, last
          do j = 1, n
            tangent(j, :, i) = lane_tangent(i - first + 1, :size(tangent, 2), columns(j))
          end do
        end do
      end if
      call scatter(x_new, new(first:last))
      status(first:last) = lane_status(:last - first + 1)
    end do
  end subroutine update_batch

  !> The update of many points by a method that is compared with the exact one; arguments as in update_batch.
  subroutine update_batch_by_method(par, by, old, gradient, threads, new, status)
    type(material_parameters), intent(in) :: par
    type(scheme), intent(in) :: by
    type(material_state), intent(in) :: old(:)
    real(dp), intent(in) :: gradient(:, :, :)
    integer, intent(in) :: threads
    type(material_state), intent(out) :: new(:)
    integer, intent(out) :: status(:)
    type(lane_state) :: x, x_new
    real(dp) :: strain(LANES, 6), spin(LANES, 3)
    integer :: lane_status(LANES), first, last

    new = old
    status = BAD_PARAMETERS
    if (.not. are_valid(par)) return
    !$omp parallel do num_threads(threads) if(threads > 1) private(x, x_new, strain, spin, lane_status, last)
    do first = 1, size(old), LANES
      last = min(first + LANES - 1, size(old))
      call gather(old(first:last), x)
      call strain_and_spin(gradient(:, :, first:last), strain, spin)
      call update_by_method(par, by, x, strain, spin, x_new, lane_status)
      call scatter(x_new, new(first:last))
      status(first:last) = lane_status(:last - first + 1)
    end do
  end subroutine update_batch_by_method

end module granumat_batch
