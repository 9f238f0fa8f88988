!> Stress from microstructure. The paper's signs (compression positive) end here: what leaves is tension positive.
module granumat_stress
  use granumat_kinds, only: dp
  use granumat_parameters, only: material_parameters, CRITICAL, HERTZIAN
  use granumat_state, only: lane_state
  use granumat_coordination, only: excess_coordination
  use granumat_tensors, only: LANES, add_identity, contract, deviator, modulus, product_symmetric, times, trace
  implicit none (type, external)
  private
  public :: evaluate, pressure_modulus, pressure, pressure_slopes, friction, stress_deviator, change_stress_deviator

  !> What the pressure changes by with A:dA, with tr D^ and with Z2 - Zc.
  type, public :: pressure_change
    real(dp), dimension(LANES) :: A, trace, excess
  end type pressure_change

contains

  !> a1 + a2 |A| + g tr D^, (4.2) with (B 1); kappa for |A| in the critical closure (A 11).
  pure function pressure_modulus(par, A, direction) result(factor)
    type(material_parameters), intent(in) :: par
    real(dp), intent(in) :: A(LANES, 6), direction(LANES, 6)
    real(dp) :: factor(LANES), mod_A(LANES)
    mod_A = par%kappa
    if (par%closure /= CRITICAL) mod_A = modulus(A)
    factor = par%a1 + par%a2 * mod_A + par%g * trace(direction)
  end function pressure_modulus

  !> p d/k (4.2), or p/k_Hz (4.4): its 3/2 power; 0 for the unjammed, Z2 <= Zc.
  pure function pressure(par, factor, excess) result(p)
    type(material_parameters), intent(in) :: par
    real(dp), intent(in) :: factor(LANES)     ! pressure_modulus
    real(dp), intent(in) :: excess(LANES)     ! Z2 - Zc
    real(dp) :: p(LANES)
    p = factor * max(excess, 0.0_dp)**2
    if (par%contact == HERTZIAN) p = sqrt(p)**3
  end function pressure

  !> eta (4.5), (4.6); chi for A:S^ in the critical closure (A 12).
  pure function friction(par, A, S_hat) result(eta)
    type(material_parameters), intent(in) :: par
    real(dp), intent(in) :: A(LANES, 6), S_hat(LANES, 6)
    real(dp) :: eta(LANES), x(LANES)
    x = par%chi
    if (par%closure /= CRITICAL) x = contract(A, S_hat)
    eta = par%b1 + x * (par%b2 + x * par%b3)
  end function friction

  !> Deviatoric stress, tension positive: (A 4), of which (4.1), (A 1) are the cases a3 = a4 = 0 and a4 = 0.
  !!
  !! Critical: (A 10) is (A 1) with A = lambda S^. Departs from the paper: chi/3 is kept as (lambda/3) S^:S^, its value
  !! at tr D = 0, so that the term stays traceless when the volume changes.
  pure function stress_deviator(par, A, S_hat, p) result(dev)
    type(material_parameters), intent(in) :: par
    real(dp), intent(in) :: A(LANES, 6), S_hat(LANES, 6), p(LANES)
    real(dp) :: dev(LANES, 6), x(LANES)

    x = contract(A, S_hat)
    dev = times(-friction(par, A, S_hat) - par%a4 * x / 2, S_hat) + par%a4 * A
    dev = dev + par%a3 * add_identity(product_symmetric(A, S_hat), -2 * x / 3)
    dev = times(-p, dev)
  end function stress_deviator

  pure function pressure_slopes(par, A, direction, excess) result(by)
    type(material_parameters), intent(in) :: par
    real(dp), intent(in) :: A(LANES, 6), direction(LANES, 6), excess(LANES)
    type(pressure_change) :: by
    real(dp), dimension(LANES) :: factor, z, outer

    z = max(excess, 0.0_dp)
    factor = pressure_modulus(par, A, direction)
    outer = 1
    if (par%contact == HERTZIAN) outer = 1.5_dp * sqrt(max(factor, 0.0_dp)) * z
    by%A = 0
    if (par%closure /= CRITICAL) by%A = outer * z**2 * par%a2 / (2 * max(modulus(A), tiny(1.0_dp)))
    by%trace = outer * z**2 * par%g
    by%excess = 2 * outer * factor * z
  end function pressure_slopes

  !> Change of the stress deviator with changes of A, S^ and p; unit is the deviator at p = 1.
  pure subroutine change_stress_deviator(par, A, S, p, unit, d_A, d_S, d_p, d_dev)
    type(material_parameters), intent(in) :: par
    real(dp), intent(in), dimension(LANES, 6) :: A, S, unit, d_A, d_S       ! S, d_S: of S^
    real(dp), intent(in), dimension(LANES) :: p, d_p
    real(dp), intent(out) :: d_dev(LANES, 6)
    real(dp) :: x, d_x, along, across, isotropic, slope(3)
    integer :: i

    slope = [par%b1, par%b2, par%b3]
    if (par%closure == CRITICAL) slope = [par%b1 + par%chi * (par%b2 + par%chi * par%b3), 0.0_dp, 0.0_dp]
    do i = 1, LANES                            ! one fused loop, dA S^ + S^ dA + A dS^ + dS^ A written out: hot in the tangent
      x = A(i, 1) * S(i, 1) + A(i, 2) * S(i, 2) + A(i, 3) * S(i, 3) &
        + 2 * (A(i, 4) * S(i, 4) + A(i, 5) * S(i, 5) + A(i, 6) * S(i, 6))
      d_x = d_A(i, 1) * S(i, 1) + d_A(i, 2) * S(i, 2) + d_A(i, 3) * S(i, 3) &
        + A(i, 1) * d_S(i, 1) + A(i, 2) * d_S(i, 2) + A(i, 3) * d_S(i, 3) &
        + 2 * (d_A(i, 4) * S(i, 4) + d_A(i, 5) * S(i, 5) + d_A(i, 6) * S(i, 6) &
          + A(i, 4) * d_S(i, 4) + A(i, 5) * d_S(i, 5) + A(i, 6) * d_S(i, 6))
      along = -d_x * (slope(2) + 2 * x * slope(3) + par%a4 / 2)
      across = -(slope(1) + x * (slope(2) + x * slope(3)) + par%a4 * x / 2)
      isotropic = -2 * d_x / 3
      d_dev(i, 1) = d_p(i) * unit(i, 1) - p(i) * (along * S(i, 1) + across * d_S(i, 1) + par%a4 * d_A(i, 1) + par%a3 * (isotropic &
        + 2 * (d_A(i, 1) * S(i, 1) + d_A(i, 4) * S(i, 4) + d_A(i, 5) * S(i, 5) &
        + A(i, 1) * d_S(i, 1) + A(i, 4) * d_S(i, 4) + A(i, 5) * d_S(i, 5))))
      d_dev(i, 2) = d_p(i) * unit(i, 2) - p(i) * (along * S(i, 2) + across * d_S(i, 2) + par%a4 * d_A(i, 2) + par%a3 * (isotropic &
        + 2 * (d_A(i, 4) * S(i, 4) + d_A(i, 2) * S(i, 2) + d_A(i, 6) * S(i, 6) &
        + A(i, 4) * d_S(i, 4) + A(i, 2) * d_S(i, 2) + A(i, 6) * d_S(i, 6))))
      d_dev(i, 3) = d_p(i) * unit(i, 3) - p(i) * (along * S(i, 3) + across * d_S(i, 3) + par%a4 * d_A(i, 3) + par%a3 * (isotropic &
        + 2 * (d_A(i, 5) * S(i, 5) + d_A(i, 6) * S(i, 6) + d_A(i, 3) * S(i, 3) &
        + A(i, 5) * d_S(i, 5) + A(i, 6) * d_S(i, 6) + A(i, 3) * d_S(i, 3))))
      d_dev(i, 4) = d_p(i) * unit(i, 4) - p(i) * (along * S(i, 4) + across * d_S(i, 4) + par%a4 * d_A(i, 4) + par%a3 &
        * (d_A(i, 1) * S(i, 4) + d_A(i, 4) * (S(i, 1) + S(i, 2)) + d_A(i, 5) * S(i, 6) &
        + S(i, 4) * d_A(i, 2) + S(i, 5) * d_A(i, 6) &
        + A(i, 1) * d_S(i, 4) + A(i, 4) * (d_S(i, 1) + d_S(i, 2)) + A(i, 5) * d_S(i, 6) &
        + d_S(i, 4) * A(i, 2) + d_S(i, 5) * A(i, 6)))
      d_dev(i, 5) = d_p(i) * unit(i, 5) - p(i) * (along * S(i, 5) + across * d_S(i, 5) + par%a4 * d_A(i, 5) + par%a3 &
        * (d_A(i, 1) * S(i, 5) + d_A(i, 4) * S(i, 6) + d_A(i, 5) * (S(i, 1) + S(i, 3)) &
        + S(i, 4) * d_A(i, 6) + S(i, 5) * d_A(i, 3) &
        + A(i, 1) * d_S(i, 5) + A(i, 4) * d_S(i, 6) + A(i, 5) * (d_S(i, 1) + d_S(i, 3)) &
        + d_S(i, 4) * A(i, 6) + d_S(i, 5) * A(i, 3)))
      d_dev(i, 6) = d_p(i) * unit(i, 6) - p(i) * (along * S(i, 6) + across * d_S(i, 6) + par%a4 * d_A(i, 6) + par%a3 &
        * (d_A(i, 4) * S(i, 5) + d_A(i, 2) * S(i, 6) + d_A(i, 6) * (S(i, 2) + S(i, 3)) &
        + S(i, 4) * d_A(i, 5) + S(i, 6) * d_A(i, 3) &
        + A(i, 4) * d_S(i, 5) + A(i, 2) * d_S(i, 6) + A(i, 6) * (d_S(i, 2) + d_S(i, 3)) &
        + d_S(i, 4) * A(i, 5) + d_S(i, 6) * A(i, 3)))
    end do
  end subroutine change_stress_deviator

  !> The model stress of states' microstructure in their direction, and eta; what the critical closure implies is set.
  pure subroutine evaluate(par, x, eta)
    type(material_parameters), intent(in) :: par
    type(lane_state), intent(inout) :: x
    real(dp), intent(out) :: eta(LANES)
    real(dp) :: S_hat(LANES, 6), p(LANES)

    S_hat = deviator(x%direction)
    if (par%closure == CRITICAL) then
      x%fabric = par%lambda * S_hat                                                            ! (A 9)
      x%coordination_number = par%Zc + excess_coordination(par, x%volume_fraction - par%phic)
    end if
    eta = friction(par, x%fabric, S_hat)
    p = pressure(par, pressure_modulus(par, x%fabric, x%direction), x%coordination_number - par%Zc)
    x%stress = add_identity(stress_deviator(par, x%fabric, S_hat, p), -p)
  end subroutine evaluate

end module granumat_stress
