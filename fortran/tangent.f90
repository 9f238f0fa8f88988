!> The consistent tangent of the exact update, in closed form: changes of the state with changes of the increment (seeds: strain
!! and spin components, or combinations of them) follow it through the inner steps.
module granumat_tangent
  use granumat_kinds, only: dp
  use granumat_coordination, only: INTEGRAL, N_NODES, WEIGHT, excess_coordination, excess_slope, exponential
  use granumat_fabric, only: fabric_solution, series_at, slopes_at, vary_fabric, y_at
  use granumat_increment, only: increment, inner_solution, internal
  use granumat_parameters, only: material_parameters, CRITICAL
  use granumat_relaxation, only: relaxation_weights, relaxation_weights_slope
  use granumat_stress, only: pressure, pressure_change, pressure_modulus, stress_deviator, change_stress_deviator
  use granumat_tensors, only: LANES, add_identity, contract, corotate, deviator, modulus, rotate, rotation, rotation_change, &
    times, trace
  implicit none (type, external)
  private
  public :: start_variations, vary_inner_step, stress_changes

  integer, parameter, public :: N_SEEDS = 9    ! 11 22 33, engineering shears 12 13 23, spins 12 13 23

  !> Changes with one strain or spin component: of the whole increment, then of what has evolved so far.
  type, public :: variation
    real(dp) :: S(LANES, 6), S_hat(LANES, 6), w(LANES, 3)
    real(dp), dimension(LANES) :: mod_D, mod_S, tr_D, trace_direction
    real(dp) :: A(LANES, 6), dev(LANES, 6), excess(LANES), log_phi(LANES)
  end type variation

  !> What the changes of an inner step share: 1/y, f, d2 |D| phi df/dphi at the nodes (and the end), exp(-d2 |D|).
  type :: shared_factors
    real(dp) :: inverse_y(LANES, N_NODES + 1), decay(LANES)
    real(dp), dimension(LANES, N_NODES) :: f, f_slope
  end type shared_factors

contains

  !> Changes of the increment with each seed: a change of the strains (engineering shears) and of the spins.
  pure subroutine start_variations(inc, seeds, change)
    type(increment), intent(in) :: inc
    real(dp), intent(in) :: seeds(:, :)                  ! (N_SEEDS, n)
    type(variation), intent(out) :: change(:)
    real(dp) :: d_D(LANES, 6), d_direction(LANES, 6), mod_S(LANES)
    integer :: j

    mod_S = modulus(inc%S_hat)                           ! over |D|
    do j = 1, size(change)
      d_D(:, :3) = spread(seeds(1:3, j), 1, LANES)
      d_D(:, 4:) = spread(seeds(4:6, j) / 2, 1, LANES)
      change(j)%w = spread(seeds(7:9, j), 1, LANES)
      change(j)%mod_D = contract(inc%direction, d_D) / 2
      change(j)%tr_D = trace(d_D)
      change(j)%S = deviator(d_D)
      change(j)%mod_S = contract(inc%S_hat, change(j)%S) / (2 * max(mod_S, tiny(1.0_dp)))
      d_direction = times(1 / max(inc%mod_D, tiny(1.0_dp)), d_D - times(change(j)%mod_D, inc%direction))
      change(j)%S_hat = deviator(d_direction)
      change(j)%trace_direction = trace(d_direction)
      change(j)%A = 0
      change(j)%dev = 0
      change(j)%excess = 0
      change(j)%log_phi = 0
    end do
  end subroutine start_variations

  !> Carries the changes over an inner step.
  pure subroutine vary_inner_step(par, inc, before, step, change)
    type(material_parameters), intent(in) :: par
    type(increment), intent(in) :: inc
    type(internal), intent(in) :: before                 ! where the inner step started
    type(inner_solution), intent(in) :: step
    type(variation), intent(inout) :: change(:)
    type(fabric_solution) :: d_fabric
    type(shared_factors) :: factors
    real(dp) :: d_A(LANES, 6, N_NODES + 1), d_excess(LANES, N_NODES + 1)
    integer :: j

    factors = factors_of(par, step)
    do j = 1, size(change)
      if (par%closure == CRITICAL) then
        call vary_implied(par, step, change(j), d_A, d_excess)
      else
        call vary_fabric(par, step%fabric, step%S, step%mod_D, step%w, change(j)%A, times(step%share, change(j)%S), &
          step%share * change(j)%mod_D, spread(step%share, 2, 3) * change(j)%w, d_fabric)
        call vary_microstructure(par, step, factors, d_fabric, change(j), d_A, d_excess)
      end if
      if (par%elastic_strain > 0) call vary_relaxation(par, inc, before%dev, step, d_A, d_excess, change(j))
      change(j)%A = d_A(:, :, N_NODES + 1)
      change(j)%excess = d_excess(:, N_NODES + 1)
      change(j)%log_phi = change(j)%log_phi - step%share * change(j)%tr_D
    end do
  end subroutine vary_inner_step

  pure function factors_of(par, step) result(factors)
    type(material_parameters), intent(in) :: par
    type(inner_solution), intent(in) :: step
    type(shared_factors) :: factors
    real(dp) :: one(LANES)
    integer :: i

    if (par%closure == CRITICAL) return
    one = 1
    do i = 1, N_NODES
      factors%inverse_y(:, i) = 1 / y_at(step%fabric, step%t(:, i))
      factors%f(:, i) = excess_coordination(par, step%phi(:, i) - par%phic)
      factors%f_slope(:, i) = par%d2 * step%mod_D * step%phi(:, i) * excess_slope(par, step%phi(:, i) - par%phic)
    end do
    factors%inverse_y(:, N_NODES + 1) = 1 / y_at(step%fabric, one)
    factors%decay = exponential(-par%d2 * step%mod_D)
  end function factors_of

  !> Changes of A (at the end; with e_r > 0 at the nodes too) and of Z2 - Zc.
  pure subroutine vary_microstructure(par, step, factors, d_fabric, change, d_A, d_excess)
    type(material_parameters), intent(in) :: par
    type(inner_solution), intent(in) :: step
    type(shared_factors), intent(in) :: factors
    type(fabric_solution), intent(in) :: d_fabric
    type(variation), intent(in) :: change
    real(dp), intent(out) :: d_A(LANES, 6, N_NODES + 1), d_excess(LANES, N_NODES + 1)
    real(dp), dimension(LANES) :: d_y_end, d_A_S, d_decay, d_constant, d_tr_D
    real(dp), dimension(LANES, N_NODES) :: d_y, dot_d_y, d_integrand
    integer :: i, j

    d_decay = par%d2 * step%share * change%mod_D
    d_tr_D = step%share * change%tr_D
    d_constant = par%d3 * d_tr_D - par%d1 * par%chi * step%share * change%mod_S
    d_excess(:, N_NODES + 1) = change%excess
    call slopes_at(d_fabric, N_NODES, step%t, d_y, dot_d_y)
    do i = 1, N_NODES
      d_A_S = -(dot_d_y(:, i) / par%c3 + step%A_S(:, i) * d_y(:, i)) * factors%inverse_y(:, i)
      d_integrand(:, i) = d_decay * step%t(:, i) * step%integrand(:, i) + step%growth(:, i) * step%dt(:, i) * (par%d1 * d_A_S &
        + d_constant + d_decay * factors%f(:, i) + factors%f_slope(:, i) * (change%log_phi - step%t(:, i) * d_tr_D))
      d_excess(:, N_NODES + 1) = d_excess(:, N_NODES + 1) + WEIGHT(i) * d_integrand(:, i)
    end do
    d_excess(:, N_NODES + 1) = d_excess(:, N_NODES + 1) * factors%decay - d_decay * step%excess(:, N_NODES + 1)
    d_A(:, :, N_NODES + 1) = d_fabric%B(:, :, 0)
    d_y_end = 0
    do i = 1, d_fabric%terms
      d_A(:, :, N_NODES + 1) = d_A(:, :, N_NODES + 1) + d_fabric%B(:, :, i)
      d_y_end = d_y_end + d_fabric%y(:, i)
    end do
    d_A(:, :, N_NODES + 1) = times(factors%inverse_y(:, N_NODES + 1), &
      d_A(:, :, N_NODES + 1) - times(d_y_end, step%A(:, :, N_NODES + 1)))
    if (.not. par%elastic_strain > 0) return
    do i = 1, N_NODES
      d_A(:, :, i) = times(factors%inverse_y(:, i), &
        series_at(d_fabric, step%t(:, i)) - times(d_y(:, i), step%A(:, :, i)))
      d_excess(:, i) = change%excess
      do j = 1, N_NODES
        d_excess(:, i) = d_excess(:, i) + INTEGRAL(j, i) * d_integrand(:, j)
      end do
      d_excess(:, i) = d_excess(:, i) / step%growth(:, i) - d_decay * step%t(:, i) * step%excess(:, i)
    end do
  end subroutine vary_microstructure

  !> Changes of what the critical closure implies: A = lambda S^, Z2 = f(phi).
  pure subroutine vary_implied(par, step, change, d_A, d_excess)
    type(material_parameters), intent(in) :: par
    type(inner_solution), intent(in) :: step
    type(variation), intent(in) :: change
    real(dp), intent(out) :: d_A(LANES, 6, N_NODES + 1), d_excess(LANES, N_NODES + 1)
    real(dp) :: t(LANES, N_NODES + 1), phi(LANES, N_NODES + 1)
    integer :: i

    t(:, :N_NODES) = step%t
    t(:, N_NODES + 1) = 1
    phi(:, :N_NODES) = step%phi
    phi(:, N_NODES + 1) = step%phi_end
    do i = 1, N_NODES + 1
      d_A(:, :, i) = par%lambda * change%S_hat
      d_excess(:, i) = excess_slope(par, phi(:, i) - par%phic) * phi(:, i) * (change%log_phi - t(:, i) * step%share * change%tr_D)
    end do
  end subroutine vary_implied

  !> Change of the relaxing deviator.
  pure subroutine vary_relaxation(par, inc, dev, step, d_A, d_excess, change)
    type(material_parameters), intent(in) :: par
    type(increment), intent(in) :: inc
    real(dp), intent(in) :: dev(LANES, 6)                ! before the step
    type(inner_solution), intent(in) :: step
    real(dp), intent(in) :: d_A(LANES, 6, N_NODES + 1), d_excess(LANES, N_NODES + 1)
    type(variation), intent(inout) :: change
    real(dp) :: ratio(LANES), d_ratio(LANES), u(LANES, N_NODES + 1), w(LANES, 3), R(LANES, 3, 3)
    real(dp), dimension(LANES, N_NODES + 1) :: weights, slopes
    real(dp), dimension(LANES, 6) :: turned, d_dev, unit, d_model
    real(dp), dimension(LANES) :: p, d_p, one
    integer :: i

    one = 1

    ratio = step%mod_D / par%elastic_strain
    d_ratio = step%share * change%mod_D / par%elastic_strain
    u(:, :N_NODES) = 1 - step%t
    u(:, N_NODES + 1) = 0
    weights = relaxation_weights(ratio, u)
    slopes = relaxation_weights_slope(ratio, u)
    R = rotation(step%w)
    turned = times(exp(-ratio), rotate(R, dev))
    d_dev = times(exp(-ratio), rotate(R, change%dev)) - times(d_ratio, turned) &
      + corotate(rotation_change(step%w, spread(step%share, 2, 3) * change%w), turned)
    do i = 1, N_NODES + 1
      w = spread(u(:, i), 2, 3) * step%w
      R = rotation(w)
      p = pressure(par, pressure_modulus(par, step%A(:, :, i), inc%direction), step%excess(:, i))
      d_p = pressure_change(par, step%A(:, :, i), inc%direction, step%excess(:, i), d_A(:, :, i), change%trace_direction, &
        d_excess(:, i))
      unit = stress_deviator(par, step%A(:, :, i), inc%S_hat, one)
      call change_stress_deviator(par, step%A(:, :, i), inc%S_hat, p, unit, d_A(:, :, i), change%S_hat, d_p, d_model)
      turned = rotate(R, times(p, unit))
      d_dev = d_dev + times(slopes(:, i) * d_ratio, turned) &
        + times(weights(:, i), corotate(rotation_change(w, spread(u(:, i) * step%share, 2, 3) * change%w), turned)) &
        + times(weights(:, i), rotate(R, d_model))
    end do
    change%dev = d_dev
  end subroutine vary_relaxation

  !> Change of the stress at the end of the increment, tension positive, with each seed.
  pure subroutine stress_changes(par, inc, x, change, tangent)
    type(material_parameters), intent(in) :: par
    type(increment), intent(in) :: inc
    type(internal), intent(in) :: x
    type(variation), intent(in) :: change(:)
    real(dp), intent(out) :: tangent(:, :, :)            ! (LANES, 6, size(change))
    real(dp) :: p(LANES), d_p(LANES), unit(LANES, 6), d_dev(LANES, 6)
    integer :: j

    unit = stress_deviator(par, x%A, inc%S_hat, spread(1.0_dp, 1, LANES))
    p = pressure(par, pressure_modulus(par, x%A, inc%direction), x%excess)
    do j = 1, size(change)
      associate (c => change(j))
        d_p = pressure_change(par, x%A, inc%direction, x%excess, c%A, c%trace_direction, c%excess)
        d_dev = c%dev
        if (.not. par%elastic_strain > 0) call change_stress_deviator(par, x%A, inc%S_hat, p, unit, c%A, c%S_hat, d_p, d_dev)
        tangent(:, :, j) = add_identity(d_dev, -d_p)
      end associate
    end do
  end subroutine stress_changes

end module granumat_tangent
