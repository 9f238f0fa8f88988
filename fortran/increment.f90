!> A strain increment and what evolves in it, LANES points side by side.
module granumat_increment
  use granumat_kinds, only: dp
  use granumat_coordination, only: N_NODES
  use granumat_fabric, only: fabric_solution
  use granumat_tensors, only: LANES, deviator, safe_modulus, times, trace
  implicit none (type, external)
  private
  public :: to_increment

  !> A deformation with constant velocity gradient, and its invariants.
  type, public :: increment
    real(dp) :: D(LANES, 6)            ! tensor shear components
    real(dp) :: direction(LANES, 6)    ! D^ = D/|D|
    real(dp) :: S_hat(LANES, 6)        ! S/|D|
    real(dp) :: mod_D(LANES)           ! |D|
    real(dp) :: tr_D(LANES)
    real(dp) :: spin(LANES, 3)         ! W12 W13 W23
  end type increment

  !> What evolves inside an increment, and how far it has come.
  type, public :: internal
    real(dp) :: A(LANES, 6)            ! fabric
    real(dp) :: excess(LANES)          ! Z2 - Zc
    real(dp) :: phi(LANES)
    real(dp) :: e(LANES)               ! ln(phi/phic)
    real(dp) :: dev(LANES, 6)          ! deviatoric stress, tension positive
  end type internal

  !> An inner step, a share of the increment, 0 <= t <= 1: its fabric, and what is met at the nodes and (last) at the end.
  type, public :: inner_solution
    real(dp) :: share(LANES), mod_D(LANES), tr_D(LANES), phi_end(LANES), S(LANES, 6), w(LANES, 3)
    type(fabric_solution) :: fabric
    real(dp), dimension(LANES, N_NODES) :: t, dt, phi, y, A_S, growth, integrand
    real(dp) :: y_end(LANES)
    real(dp) :: A(LANES, 6, N_NODES + 1), excess(LANES, N_NODES + 1)    ! at the nodes only with e_r > 0
  end type inner_solution

contains

  !> The increment of engineering strains and a spin; none in lanes that are not wanted.
  pure subroutine to_increment(strain, spin, wanted, inc)
    real(dp), intent(in) :: strain(LANES, 6), spin(LANES, 3)
    logical, intent(in) :: wanted(LANES)
    type(increment), intent(out) :: inc
    real(dp) :: inverse(LANES)
    integer :: i

    inc%D(:, :3) = strain(:, :3)
    inc%D(:, 4:) = strain(:, 4:) / 2
    inc%spin = spin
    do i = 1, LANES
      if (wanted(i)) cycle
      inc%D(i, :) = 0
      inc%spin(i, :) = 0
    end do
    inc%mod_D = safe_modulus(inc%D)
    inverse = 1 / max(inc%mod_D, tiny(1.0_dp))
    inc%direction = times(inverse, inc%D)
    inc%S_hat = deviator(inc%direction)
    inc%tr_D = trace(inc%D)
  end subroutine to_increment

end module granumat_increment
