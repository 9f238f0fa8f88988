!> The interface module: a steady state and an isotropic one, each sheared on, with the tangent.
program interface
  use, intrinsic :: iso_c_binding, only: c_double, c_int
  use granumat_c, only: granumat_parameters, granumat_state, granumat_parameters_from_friction, granumat_complete_parameters, &
    granumat_isotropic_state, granumat_steady_states, granumat_update_states_with_tangent, GRANUMAT_CONSTANTS, GRANUMAT_FULL, &
    GRANUMAT_HOOKEAN, GRANUMAT_TABLE_1
  implicit none (type, external)
  type(granumat_parameters) :: par
  type(granumat_state) :: old(2), new(2)
  real(c_double) :: gradient(3, 3, 2), tangent(6, 6, 2)
  integer(c_int) :: faulty(GRANUMAT_CONSTANTS), valid, status(2)
  integer :: i

  call granumat_parameters_from_friction(0.5_c_double, GRANUMAT_FULL, GRANUMAT_HOOKEAN, GRANUMAT_TABLE_1, par)
  par%elastic_strain = 0.01_c_double
  call granumat_complete_parameters(par, faulty, valid)
  if (valid == 0) error stop "not a material"
  call granumat_steady_states(1, par, [0.60_c_double], old(:1), status(:1))
  call granumat_isotropic_state(par, 0.60_c_double, 0.005_c_double, old(2), status(2))
  if (any(status /= 0)) error stop "no state to start from"
  gradient = 0
  gradient(3, 1, :) = 0.01_c_double                       ! du_x/dz
  call granumat_update_states_with_tangent(2, 1, 6, 6, par, old, gradient, new, status, tangent)
  do i = 1, 2
    print "(i0, 7es25.16e3)", status(i), new(i)%stress, tangent(5, 1, i)
  end do
end program interface
