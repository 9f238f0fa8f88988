!> Stress from microstructure. The paper's signs (compression positive) end here: what leaves is tension positive.
module granumat_stress
  use granumat_kinds, only: dp
  use granumat_parameters, only: material_parameters, CRITICAL, HERTZIAN
  use granumat_state, only: lane_state
  use granumat_coordination, only: excess_coordination
  use granumat_tensors, only: LANES, add_identity, contract, deviator, modulus, product_deviator, product_matrix, six, times, trace
  implicit none (type, external)
  private
  public :: evaluate, pressure_modulus, pressure, pressure_slopes, friction, stress_deviator, deviator_slopes

  !> What the pressure changes by with A:dA, with tr D^ and with Z2 - Zc.
  type, public :: pressure_change
    real(dp), dimension(LANES) :: A, trace, excess
  end type pressure_change

contains

  !> a1 + a2 |A| + g tr D^, (4.2) with (B 1); kappa for |A| in the critical closure (A 11).
  pure function pressure_modulus(par, A, tr_direction) result(factor)
    type(material_parameters), intent(in) :: par
    real(dp), intent(in) :: A(LANES, 5), tr_direction(LANES)
    real(dp) :: factor(LANES), mod_A(LANES)
    mod_A = par%kappa
    if (par%closure /= CRITICAL) mod_A = modulus(A)
    factor = par%a1 + par%a2 * mod_A + par%g * tr_direction
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
    real(dp), intent(in) :: A(LANES, 5), S_hat(LANES, 5)
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
    real(dp), intent(in) :: A(LANES, 5), S_hat(LANES, 5), p(LANES)
    real(dp) :: dev(LANES, 5)

    dev = times(-friction(par, A, S_hat) - par%a4 * contract(A, S_hat) / 2, S_hat) + par%a4 * A
    dev = dev + par%a3 * product_deviator(A, S_hat)
    dev = times(-p, dev)
  end function stress_deviator

  pure function pressure_slopes(par, A, tr_direction, excess) result(by)
    type(material_parameters), intent(in) :: par
    real(dp), intent(in) :: A(LANES, 5), tr_direction(LANES), excess(LANES)
    type(pressure_change) :: by
    real(dp), dimension(LANES) :: factor, z, outer

    z = max(excess, 0.0_dp)
    factor = pressure_modulus(par, A, tr_direction)
    outer = 1
    if (par%contact == HERTZIAN) outer = 1.5_dp * sqrt(max(factor, 0.0_dp)) * z
    by%A = 0
    if (par%closure /= CRITICAL) by%A = outer * z**2 * par%a2 / (2 * max(modulus(A), tiny(1.0_dp)))
    by%trace = outer * z**2 * par%g
    by%excess = 2 * outer * factor * z
  end function pressure_slopes

  !> What the stress deviator changes by with A and with S^, at constant pressure; the first is symmetric.
  pure subroutine deviator_slopes(par, A, S_hat, S_matrix, p, by_A, by_S_hat)
    type(material_parameters), intent(in) :: par
    real(dp), intent(in) :: A(LANES, 5), S_hat(LANES, 5), S_matrix(LANES, 5, 5), p(LANES)    ! S_matrix: product_matrix of S^
    real(dp), intent(out), dimension(LANES, 5, 5) :: by_A, by_S_hat      ! (:, i, j): component i by component j
    real(dp), dimension(LANES) :: x, by_x, across, along
    real(dp) :: slope(3)
    integer :: i, j

    slope = [par%b1, par%b2, par%b3]
    if (par%closure == CRITICAL) slope = [par%b1 + par%chi * (par%b2 + par%chi * par%b3), 0.0_dp, 0.0_dp]
    x = contract(A, S_hat)
    by_x = p * (slope(2) + 2 * x * slope(3) + par%a4 / 2)
    across = p * (slope(1) + x * (slope(2) + x * slope(3)) + par%a4 * x / 2)
    along = -p * par%a4
    by_S_hat = product_matrix(A)
    do j = 1, 5
      do i = 1, 5
        by_A(:, i, j) = by_x * S_hat(:, i) * S_hat(:, j) - par%a3 * p * S_matrix(:, i, j)
        by_S_hat(:, i, j) = by_x * S_hat(:, i) * A(:, j) - par%a3 * p * by_S_hat(:, i, j)
      end do
      by_A(:, j, j) = by_A(:, j, j) + along
      by_S_hat(:, j, j) = by_S_hat(:, j, j) + across
    end do
  end subroutine deviator_slopes

  !> The model stress of states' microstructure in their direction, and eta; what the critical closure implies is set.
  pure subroutine evaluate(par, x, eta)
    type(material_parameters), intent(in) :: par
    type(lane_state), intent(inout) :: x
    real(dp), intent(out) :: eta(LANES)
    real(dp), dimension(LANES, 5) :: S_hat, A
    real(dp) :: p(LANES)

    S_hat = deviator(x%direction)
    if (par%closure == CRITICAL) then
      x%fabric = six(par%lambda * S_hat)                                                       ! (A 9)
      x%coordination_number = par%Zc + excess_coordination(par, x%volume_fraction - par%phic)
    end if
    A = deviator(x%fabric)
    eta = friction(par, A, S_hat)
    p = pressure(par, pressure_modulus(par, A, trace(x%direction)), x%coordination_number - par%Zc)
    x%stress = add_identity(six(stress_deviator(par, A, S_hat, p)), -p)
  end subroutine evaluate

end module granumat_stress
