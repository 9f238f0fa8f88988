!> The stress of the microstructure as printed, (4.1)-(4.6) and (A 1)-(A 12), and its slopes (docs/theory.md, section 6).
!!
!! The paper counts compression positive. Its signs end here: stresses that leave this module are tension positive.
module granumat_stress
  use granumat_kinds, only: dp, LANES
  use granumat_law, only: critical_state
  use granumat_parameters, only: material_parameters, CRITICAL, HERTZIAN, friction_turns, pressure_evolves
  use granumat_state, only: lane_state
  use granumat_tensors, only: add_identity, contract, deviator, magnitude, product_deviator, product_matrix, times, to_voigt, trace
  implicit none (type, external)
  private
  public :: evaluate, pressure_factor, pressure, pressure_slopes, friction, stress_deviator, model_deviator, deviator_slopes, &
    nonlocal_deviator, nonlocal_slopes, mobilised_deviator, mobilised_slopes, to_evolving, to_excess

  !> Slopes of the pressure: dp = A (A : dA) + trace d(tr D^) + excess d(Z2 - Zc), or what evolves in place of Z2 - Zc.
  type, public :: pressure_derivative
    real(dp), dimension(LANES) :: A, trace, excess
  end type pressure_derivative

contains

  !> The factor of (4.2) with (B 1): a1 + a2 |A| + g tr D^, with kappa for |A| in the critical-state closure (A 11).
  pure function pressure_factor(par, A, tr_direction) result(factor)
    type(material_parameters), intent(in) :: par
    real(dp), intent(in) :: A(LANES, 5), tr_direction(LANES)
    real(dp) :: factor(LANES), mod_A(LANES)
    mod_A = par%kappa
    if (par%closure /= CRITICAL) mod_A = magnitude(A)
    factor = par%a1 + par%a2 * mod_A + par%g * tr_direction
  end function pressure_factor

  !> (4.2): p d/k = factor (Z2 - Zc)^2, or (4.4): p/k_Hz = factor^(3/2) (Z2 - Zc)^3; 0 where unjammed, Z2 <= Zc.
  pure function pressure(par, factor, excess) result(p)
    type(material_parameters), intent(in) :: par
    real(dp), intent(in) :: factor(LANES)     ! of pressure_factor
    real(dp), intent(in) :: excess(LANES)     ! Z2 - Zc
    real(dp) :: p(LANES)
    p = factor * max(excess, 0.0_dp)**2
    if (par%contact == HERTZIAN) p = sqrt(p)**3
  end function pressure

  !> What evolves by (4.8): Z2 - Zc; or, where that is the pressure, v = p d/k/(2 (a1 + a2 kappa)), with (4.2) and the sign of
  !! Z2 - Zc (docs/theory.md, section 11.4).
  pure function to_evolving(par, A, excess) result(evolving)
    type(material_parameters), intent(in) :: par
    real(dp), intent(in) :: A(LANES, 5), excess(LANES)        ! excess = Z2 - Zc
    real(dp) :: evolving(LANES)
    evolving = excess
    if (pressure_evolves(par)) then
      evolving = excess * abs(excess) / 2 * (par%a1 + par%a2 * magnitude(A)) / (par%a1 + par%a2 * par%kappa)
    end if
  end function to_evolving

  !> Z2 - Zc: the inverse of to_evolving.
  pure function to_excess(par, A, evolving) result(excess)
    type(material_parameters), intent(in) :: par
    real(dp), intent(in) :: A(LANES, 5), evolving(LANES)
    real(dp) :: excess(LANES), factor(LANES)
    excess = evolving
    if (pressure_evolves(par)) then
      factor = max(par%a1 + par%a2 * magnitude(A), tiny(1.0_dp))
      excess = sign(sqrt(2 * abs(evolving) * (par%a1 + par%a2 * par%kappa) / factor), evolving)
    end if
  end function to_excess

  !> (4.5), (4.6): eta = b1 + b2 x + b3 x^2, x = A : S^, which is chi in the critical-state closure (A 12).
  pure function friction(par, A, S_hat) result(eta)
    type(material_parameters), intent(in) :: par
    real(dp), intent(in) :: A(LANES, 5), S_hat(LANES, 5)
    real(dp) :: eta(LANES), x(LANES)
    x = par%chi
    if (par%closure /= CRITICAL) x = contract(A, S_hat)
    eta = par%b1 + x * (par%b2 + x * par%b3)
  end function friction

  !> The deviatoric stress, tension positive, from (A 4):
  !!   -sigma' = p [-eta S^ + a3 (A S^ + S^ A - (2/3) (A : S^) I) + a4 (A - (A : S^) S^/2)].
  !! (4.1) is the case a3 = a4 = 0, (A 1) the case a4 = 0, and (A 10) is (A 1) with A = lambda S^.
  !! Departs from the paper: chi/3 in (A 10) is kept as (lambda/3) S^ : S^, which is its value at tr D = 0, so that the term
  !! stays traceless when the volume changes.
  pure function stress_deviator(par, A, S_hat, p) result(dev)
    type(material_parameters), intent(in) :: par
    real(dp), intent(in) :: A(LANES, 5), S_hat(LANES, 5), p(LANES)
    real(dp) :: dev(LANES, 5)

    dev = times(-friction(par, A, S_hat) - par%a4 * contract(A, S_hat) / 2, S_hat) + par%a4 * A
    dev = dev + par%a3 * product_deviator(A, S_hat)
    dev = times(-p, dev)
  end function stress_deviator

  !> The stress deviator of the model at its own pressure, tension positive.
  pure function model_deviator(par, A, S_hat, tr_direction, excess) result(dev)
    type(material_parameters), intent(in) :: par
    real(dp), intent(in) :: A(LANES, 5), S_hat(LANES, 5), tr_direction(LANES), excess(LANES)
    real(dp) :: dev(LANES, 5)
    dev = stress_deviator(par, A, S_hat, pressure(par, pressure_factor(par, A, tr_direction), excess))
  end function model_deviator

  !> The derivatives of the pressure.
  pure function pressure_slopes(par, A, tr_direction, evolving) result(by)
    type(material_parameters), intent(in) :: par
    real(dp), intent(in) :: A(LANES, 5), tr_direction(LANES), evolving(LANES)     ! of to_evolving
    type(pressure_derivative) :: by
    real(dp), dimension(LANES) :: factor, z, outer

    z = max(to_excess(par, A, evolving), 0.0_dp)
    factor = pressure_factor(par, A, tr_direction)
    outer = 1
    if (par%contact == HERTZIAN) outer = 1.5_dp * sqrt(max(factor, 0.0_dp)) * z
    by%A = 0
    if (par%closure /= CRITICAL) by%A = outer * z**2 * par%a2 / (2 * max(magnitude(A), tiny(1.0_dp)))
    by%trace = outer * z**2 * par%g
    by%excess = 2 * outer * factor * z
    if (pressure_evolves(par)) then
      by%A = 0
      by%excess = merge(2 * outer * (par%a1 + par%a2 * par%kappa), 0.0_dp, evolving > 0)
    end if
  end function pressure_slopes

  !> The derivatives of the stress deviator by A and by S^ at constant pressure; the first is symmetric.
  pure subroutine deviator_slopes(par, A, S_hat, S_matrix, p, by_A, by_S_hat)
    type(material_parameters), intent(in) :: par
    real(dp), intent(in) :: A(LANES, 5), S_hat(LANES, 5), S_matrix(LANES, 5, 5), p(LANES)    ! S_matrix = product_matrix(S^)
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

  !> The stress deviator with a length, from that without one: S/m = R S^, R = |D|/m, takes the place of S^ everywhere but in the
  !! projections A : S^, so all of it but -a4 p A is multiplied by R (docs/theory.md, section 12).
  pure function nonlocal_deviator(par, A, R, p, dev) result(nonlocal)
    type(material_parameters), intent(in) :: par
    real(dp), intent(in) :: A(LANES, 5), R(LANES), p(LANES)
    real(dp), intent(in) :: dev(LANES, 5)         ! of stress_deviator
    real(dp) :: nonlocal(LANES, 5)
    nonlocal = times(R, dev) + times((R - 1) * par%a4 * p, A)
  end function nonlocal_deviator

  !> The derivatives of nonlocal_deviator by A, from those of stress_deviator; those by S^ are just multiplied by R.
  pure subroutine nonlocal_slopes(par, R, p, by_A)
    type(material_parameters), intent(in) :: par
    real(dp), intent(in) :: R(LANES), p(LANES)
    real(dp), intent(inout) :: by_A(LANES, 5, 5)
    integer :: i, j

    do j = 1, 5
      do i = 1, 5
        by_A(:, i, j) = R * by_A(:, i, j)
      end do
      by_A(:, j, j) = by_A(:, j, j) + (R - 1) * par%a4 * p
    end do
  end subroutine nonlocal_slopes

  !> The deviatoric stress over the pressure where friction has a direction M of its own, tension positive:
  !!   -sigma' = p [-b1 M - 2 b2 A + (2 a3/lambda) (A A - (2/3) |A|^2 I)].
  !! Departs from the paper: docs/theory.md, section 11.
  pure function mobilised_deviator(par, A, M) result(dev_over_p)
    type(material_parameters), intent(in) :: par
    real(dp), intent(in) :: A(LANES, 5), M(LANES, 5)
    real(dp) :: dev_over_p(LANES, 5)
    dev_over_p = par%b1 * M + 2 * par%b2 * A - par%a3 / par%lambda * product_deviator(A, A)
  end function mobilised_deviator

  !> The derivatives of mobilised_deviator by A, a symmetric matrix; that by M is b1.
  pure function mobilised_slopes(par, A) result(by_A)
    type(material_parameters), intent(in) :: par
    real(dp), intent(in) :: A(LANES, 5)
    real(dp) :: by_A(LANES, 5, 5)
    integer :: i

    by_A = -2 * par%a3 / par%lambda * product_matrix(A)
    do i = 1, 5
      by_A(:, i, i) = by_A(:, i, i) + 2 * par%b2
    end do
  end function mobilised_slopes

  !> Gives states the stress of the model in their direction of strain, or of friction where that is a state, and eta; in the
  !! critical-state closure also A and Z2.
  pure subroutine evaluate(par, x, eta)
    type(material_parameters), intent(in) :: par
    type(lane_state), intent(inout) :: x
    real(dp), intent(out) :: eta(LANES)
    real(dp), dimension(LANES, 5) :: S_hat, A
    real(dp) :: p(LANES), excess(LANES)

    S_hat = deviator(x%direction)
    A = deviator(x%fabric)
    excess = x%coordination_number - par%Zc
    if (par%closure == CRITICAL) then
      call critical_state(par, S_hat, x%volume_fraction, A, excess)
      x%fabric = to_voigt(A)
      x%coordination_number = par%Zc + excess
    end if
    eta = friction(par, A, S_hat)
    p = pressure(par, pressure_factor(par, A, trace(x%direction)), excess)
    if (friction_turns(par)) then
      x%stress = add_identity(to_voigt(times(p, mobilised_deviator(par, A, S_hat))), -p)
    else
      x%stress = add_identity(to_voigt(stress_deviator(par, A, S_hat, p)), -p)
    end if
  end subroutine evaluate

end module granumat_stress
