!> The rate form: what an increment with constant velocity gradient does per unit of t, 0 <= t <= 1 over it.
!!
!! The one right-hand side of all methods but the exact one, whose competitors they are.
module granumat_rates
  use granumat_kinds, only: dp
  use granumat_parameters, only: material_parameters, CRITICAL
  use granumat_coordination, only: excess_coordination
  use granumat_increment, only: increment
  use granumat_stress, only: pressure, pressure_modulus, stress_deviator
  use granumat_tensors, only: LANES, contract, corotate, modulus, times
  implicit none (type, external)
  private
  public :: rates, imply, model_deviator

  ! What evolves, side by side: A in 1 ... 5, and from I_DEV on the deviatoric stress (constant for e_r = 0), tension positive.
  integer, parameter, public :: I_EXCESS = 6, I_PHI = 7, I_DEV = 8, N_EVOLVING = 12

contains

  !> dy/dt
  pure function rates(par, inc, y) result(dot_y)
    type(material_parameters), intent(in) :: par
    type(increment), intent(in) :: inc
    real(dp), intent(in) :: y(LANES, N_EVOLVING)
    real(dp) :: dot_y(LANES, N_EVOLVING), A(LANES, 5), S(LANES, 5), dev(LANES, 5)
    real(dp), dimension(LANES) :: excess, A_S, f

    A = y(:, :5)
    excess = y(:, I_EXCESS)
    dot_y = 0
    dot_y(:, I_PHI) = -y(:, I_PHI) * inc%tr_D
    if (par%closure == CRITICAL) then
      call imply(par, inc, y(:, I_PHI), A, excess)
    else
      S = times(inc%mod_D, inc%S_hat)
      A_S = contract(A, S)
      f = excess_coordination(par, y(:, I_PHI) - par%phic)
      dot_y(:, :5) = corotate(inc%spin, A) + par%c1 * S + times(par%c2 * inc%mod_D + par%c3 * A_S, A)             ! (4.7)
      dot_y(:, I_EXCESS) = par%d1 * (A_S - par%chi * modulus(S)) + par%d2 * inc%mod_D * (f - excess) + par%d3 * inc%tr_D   ! (4.8)
    end if
    if (par%elastic_strain > 0) then
      dev = y(:, I_DEV:)
      dot_y(:, I_DEV:) = corotate(inc%spin, dev) + times(inc%mod_D / par%elastic_strain, model_deviator(par, inc, A, excess) - dev)
    end if
  end function rates

  !> What the critical closure implies.
  pure subroutine imply(par, inc, phi, A, excess)
    type(material_parameters), intent(in) :: par
    type(increment), intent(in) :: inc
    real(dp), intent(in) :: phi(LANES)
    real(dp), intent(inout) :: A(LANES, 5), excess(LANES)       ! excess: Z2 - Zc
    A = par%lambda * inc%S_hat                                  ! (A 9)
    excess = excess_coordination(par, phi - par%phic)
  end subroutine imply

  !> The model's stress deviator, tension positive.
  pure function model_deviator(par, inc, A, excess) result(dev)
    type(material_parameters), intent(in) :: par
    type(increment), intent(in) :: inc
    real(dp), intent(in) :: A(LANES, 5), excess(LANES)
    real(dp) :: dev(LANES, 5)
    dev = stress_deviator(par, A, inc%S_hat, pressure(par, pressure_modulus(par, A, inc%tr_direction), excess))
  end function model_deviator

end module granumat_rates
