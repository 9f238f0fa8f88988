!> The states at the end of a strain increment: exact for a velocity gradient that is constant over it, unless a
!! competing method is asked for.
!!
!! LANES points go side by side; each takes the inner steps that it needs by itself, those that are done wait with zero strain.
module granumat_update
  use granumat_kinds, only: dp
  use granumat_status, only: OK, NOT_FINITE, BAD_VOLUME_FRACTION, INCREMENT_TOO_LARGE, FABRIC_BLOWS_UP, &
    TENSILE_PRESSURE, RESULT_NOT_FINITE
  use granumat_tensors, only: LANES, add_identity, deviator, matrix_times, modulus, rotate, rotation, rotation_of_deviators, six, &
    small_rotation, times, times_spin
  use granumat_parameters, only: material_parameters, BEFORE, CRITICAL, EXACT
  use granumat_state, only: lane_state, check_state, is_finite, is_realisable, REALISABLE
  use granumat_fabric, only: fabric_at, fabric_rate, projections_at, solve_fabric
  use granumat_coordination, only: N_NODES, exponential, integrate_coordination, nodes
  use granumat_stress, only: pressure, pressure_modulus, stress_deviator
  use granumat_relaxation, only: relaxation_weights
  use granumat_increment, only: AT_END, add_step, increment, inner_solution, inner_start, internal, to_increment, trail
  use granumat_rates, only: imply, model_deviator, I_DEV, I_EXCESS, I_PHI, N_EVOLVING
  use granumat_methods, only: integrate_by_method, MAX_STEPS
  use granumat_tangent, only: N_COLUMNS, PULLED_IN_SPACE, pulled, pull_inner_step, start_pulling, tangent_of
  implicit none (type, external)
  private
  public :: update

  real(dp), parameter :: STEP_RATE = 0.4_dp      ! rate times inner step: 4 Gauss points then err by 1e-13 (tests/test_exact.py)
  real(dp), parameter :: FINER = 1.5_dp          ! with e_r > 0: interpolation in the kernel has half the order of Gauss's rule
  real(dp), parameter :: NO_FABRIC = 1.0e-12_dp              ! below it A is 0
  real(dp), parameter :: SMALL_FABRIC = 1.0e-5_dp, SMALL_EXCESS = 1.0e-3_dp, SMALL_E = 1.0e-6_dp   ! kinks are stepped over below
  real(dp), parameter :: REFERENCE_STRAIN = 1.0e-4_dp   ! |D| of the tangent at D = 0
  real(dp), parameter :: LARGEST_TRACE = 2.45_dp   ! of D^: sqrt(6)

contains

  !> Brings states over their strain increments. Where the status is not OK, the new state is the old one, the tangent 0.
  pure subroutine update(par, old, strain, spin, new, status, n_pulled, tangent)
    type(material_parameters), intent(in) :: par
    type(lane_state), intent(in) :: old
    real(dp), intent(in) :: strain(LANES, 6)    ! increments: 11 22 33 and engineering shears 12 13 23
    real(dp), intent(in) :: spin(LANES, 3)      ! increments of W12 W13 W23, W_ij = (du_i/dx_j - du_j/dx_i)/2
    type(lane_state), intent(out) :: new
    integer, intent(out) :: status(LANES)
    integer, intent(in), optional :: n_pulled              ! 1 ... 6: of the pressure, and the deviator's first components
    real(dp), intent(out), optional :: tangent(LANES, 6, N_COLUMNS)    ! change of the stress with each strain and spin, as above
    type(increment) :: inc
    logical :: moves(LANES)

    status = check_state(old)
    where (status == OK .and. .not. (sum(abs(strain), 2) + sum(abs(spin), 2) <= huge(1.0_dp))) status = NOT_FINITE
    call to_increment(strain, spin, status == OK, inc)
    moves = inc%mod_D > 0
    if (present(tangent)) then
      if (.not. all(moves)) call to_increment(merge_strain(old, strain, moves), spin, status == OK, inc)
      call deform_with_tangent(par, old, inc, new, status, n_pulled, tangent)
    else if (par%spin == BEFORE) then
      call deform(par, turned(old, inc%spin), without_spin(inc, inc%mod_D >= 0), new, status)
    else
      call deform(par, old, inc, new, status)
    end if
    if (.not. all(moves)) call turn(old, inc%spin, moves, new)
    where (status == OK .and. .not. is_finite(new)) status = RESULT_NOT_FINITE
    if (any(status /= OK)) call restore(status /= OK, old, new)
  end subroutine update

  !> The tangent is that of the exact update, whatever the method; of a small strain at D = 0.
  pure subroutine deform_with_tangent(par, old, inc, new, status, n_pulled, tangent)
    type(material_parameters), intent(in) :: par
    type(lane_state), intent(in) :: old
    type(increment), intent(in) :: inc
    type(lane_state), intent(out) :: new
    integer, intent(inout) :: status(LANES)
    integer, intent(in) :: n_pulled
    real(dp), intent(out) :: tangent(LANES, 6, N_COLUMNS)
    type(material_parameters) :: exactly
    integer :: exact_status(LANES), i

    exactly = par
    exactly%method = EXACT
    exact_status = status
    call deform(exactly, old, inc, new, exact_status, n_pulled, tangent)
    do i = 1, LANES
      if (exact_status(i) /= OK) tangent(i, :, :) = 0
    end do
    if (par%spin == BEFORE) then
      call deform(par, turned(old, inc%spin), without_spin(inc, inc%mod_D >= 0), new, status)
    else if (par%method /= EXACT) then
      call deform(par, old, inc, new, status)
    else
      status = exact_status
    end if
  end subroutine deform_with_tangent

  !> The strain; where there is none, a small one along the last direction, or isotropic compression before any.
  pure function merge_strain(old, strain, moves) result(merged)
    type(lane_state), intent(in) :: old
    real(dp), intent(in) :: strain(LANES, 6)
    logical, intent(in) :: moves(LANES)
    real(dp) :: merged(LANES, 6), direction(LANES)
    logical :: fresh(LANES)
    integer :: k

    fresh = sum(abs(old%direction), 2) <= 0
    do k = 1, 6
      direction = old%direction(:, k)
      if (k <= 3) direction = merge(-sqrt(2.0_dp / 3), direction, fresh)
      if (k > 3) direction = 2 * direction                             ! engineering shears
      merged(:, k) = merge(strain(:, k), REFERENCE_STRAIN * direction, moves)
    end do
  end function merge_strain

  pure subroutine restore(lane, old, new)
    logical, intent(in) :: lane(LANES)
    type(lane_state), intent(in) :: old
    type(lane_state), intent(inout) :: new
    integer :: k

    do k = 1, 6
      new%stress(:, k) = merge(old%stress(:, k), new%stress(:, k), lane)
      new%fabric(:, k) = merge(old%fabric(:, k), new%fabric(:, k), lane)
      new%direction(:, k) = merge(old%direction(:, k), new%direction(:, k), lane)
    end do
    new%coordination_number = merge(old%coordination_number, new%coordination_number, lane)
    new%volume_fraction = merge(old%volume_fraction, new%volume_fraction, lane)
  end subroutine restore

  !> D = 0: everything turns with the body, the stress holds.
  pure subroutine turn(old, spin, moves, new)
    type(lane_state), intent(in) :: old
    real(dp), intent(in) :: spin(LANES, 3)
    logical, intent(in) :: moves(LANES)
    type(lane_state), intent(inout) :: new

    if (any(.not. moves .and. maxval(abs(spin), 2) > 0)) then
      call restore(.not. moves, turned(old, spin), new)
    else
      call restore(.not. moves, old, new)
    end if
  end subroutine turn

  !> States turned by exp(W).
  pure function turned(old, spin) result(new)
    type(lane_state), intent(in) :: old
    real(dp), intent(in) :: spin(LANES, 3)
    type(lane_state) :: new
    real(dp) :: R(LANES, 3, 3)

    new = old
    R = rotation(spin)
    new%stress = rotate(R, old%stress)
    new%fabric = rotate(R, old%fabric)
    new%direction = rotate(R, old%direction)
  end function turned

  pure function without_spin(inc, lane) result(straight)
    type(increment), intent(in) :: inc
    logical, intent(in) :: lane(LANES)
    type(increment) :: straight
    integer :: k

    straight = inc
    do k = 1, 3
      straight%spin(:, k) = merge(0.0_dp, inc%spin(:, k), lane)
    end do
  end function without_spin

  !> D /= 0.
  pure subroutine deform(par, old, inc, new, status, n_pulled, tangent)
    type(material_parameters), intent(in) :: par
    type(lane_state), intent(in) :: old
    type(increment), intent(in) :: inc
    type(lane_state), intent(out) :: new
    integer, intent(inout) :: status(LANES)
    integer, intent(in), optional :: n_pulled
    real(dp), intent(out), optional :: tangent(LANES, 6, N_COLUMNS)
    type(internal) :: x
    type(trail) :: steps
    real(dp) :: factor(LANES)

    x%A = deviator(old%fabric)
    x%excess = old%coordination_number - par%Zc
    x%phi = old%volume_fraction
    x%dev = deviator(old%stress)
    if (par%method == EXACT) then
      new%volume_fraction = old%volume_fraction * exp(-inc%tr_D)
      where (status == OK .and. .not. (new%volume_fraction > 0 .and. new%volume_fraction < 1)) status = BAD_VOLUME_FRACTION
      steps%whole = present(tangent)
      call integrate_exactly(par, inc, x, status, steps)
      if (present(tangent)) call pull_back(par, inc, x, steps, n_pulled, tangent)
    else
      call integrate_otherwise(par, inc, x, status)
      new%volume_fraction = x%phi
    end if
    factor = pressure_modulus(par, x%A, inc%tr_direction)
    new%fabric = six(x%A)
    where (status == OK .and. factor < 0) status = TENSILE_PRESSURE
    where (status == OK .and. .not. is_realisable(new%fabric)) status = FABRIC_BLOWS_UP
    new%coordination_number = par%Zc + x%excess
    new%direction = inc%direction
    new%stress = add_identity(six(x%dev), -pressure(par, factor, x%excess))
  end subroutine deform

  !> The tangent, from the inner steps: all but the last are solved again.
  pure subroutine pull_back(par, inc, x, steps, n_pulled, tangent)
    type(material_parameters), intent(in) :: par
    type(increment), intent(in) :: inc
    type(internal), intent(in) :: x                  ! at the end
    type(trail), intent(inout) :: steps
    integer, intent(in) :: n_pulled
    real(dp), intent(out) :: tangent(LANES, 6, N_COLUMNS)
    type(pulled) :: f(PULLED_IN_SPACE)
    type(internal) :: again
    integer :: i, status(LANES)

    call start_pulling(par, inc, x, f(:n_pulled))
    do i = steps%steps, 1, -1
      if (i < steps%steps) then
        again = steps%earlier(i)%x
        status = OK
        call inner_step(par, inc, steps%earlier(i)%share, steps%earlier(i)%e_end, again, steps%solution, status)
      end if
      call pull_inner_step(par, inc, steps%solution, f(:n_pulled))
    end do
    call tangent_of(inc, f(:n_pulled), tangent)
  end subroutine pull_back

  !> By the method of the parameters.
  pure subroutine integrate_otherwise(par, inc, x, status)
    type(material_parameters), intent(in) :: par
    type(increment), intent(in) :: inc
    type(internal), intent(inout) :: x
    integer, intent(inout) :: status(LANES)
    real(dp) :: y(LANES, N_EVOLVING)

    y(:, :5) = x%A
    y(:, I_EXCESS) = x%excess
    y(:, I_PHI) = x%phi
    y(:, I_DEV:) = x%dev
    call integrate_by_method(par, without_spin(inc, .not. inc%mod_D > 0), y, status)      ! see turn
    x%A = y(:, :5)
    x%excess = y(:, I_EXCESS)
    x%phi = y(:, I_PHI)
    x%dev = y(:, I_DEV:)
    if (.not. par%elastic_strain > 0) x%dev = model_deviator(par, inc, x%A, x%excess)
  end subroutine integrate_otherwise

  !> Splits the increment where phi crosses phic, and each part into inner steps.
  pure subroutine integrate_exactly(par, inc, x, status, steps)
    type(material_parameters), intent(in) :: par
    type(increment), intent(in) :: inc
    type(internal), intent(inout) :: x
    integer, intent(inout) :: status(LANES)
    type(trail), intent(inout) :: steps
    real(dp), dimension(LANES) :: e_end, crossing

    x%e = log(merge(x%phi / par%phic, 2.0_dp, status == OK))
    e_end = x%e - inc%tr_D
    crossing = 1
    where (x%e * e_end < 0) crossing = x%e / inc%tr_D
    call integrate(par, inc, crossing, merge(0.0_dp, e_end, crossing < 1), x, status, steps)
    if (any(crossing < 1)) call integrate(par, inc, 1 - crossing, e_end, x, status, steps)
  end subroutine integrate_exactly

  !> Inner steps over the given share of the increment; phi stays on one side of phic.
  pure subroutine integrate(par, inc, share, e_end, x, status, trodden)
    type(material_parameters), intent(in) :: par
    type(increment), intent(in) :: inc
    real(dp), intent(in) :: share(LANES), e_end(LANES)
    type(internal), intent(inout) :: x
    integer, intent(inout) :: status(LANES)
    type(trail), intent(inout) :: trodden
    real(dp), dimension(LANES) :: rest, next_rest, rate, steps, e_start, e_next, mod_A
    integer :: step

    mod_A = modulus(x%A)
    rate = smooth_rate(par, inc, mod_A)
    where (status == OK .and. .not. share * rate < STEP_RATE * MAX_STEPS) status = INCREMENT_TOO_LARGE
    rest = merge(share, 0.0_dp, status == OK)
    e_start = x%e
    do step = 1, MAX_STEPS
      if (all(rest <= 0)) return
      if (any(mod_A > par%fabric_limit)) rate = merge(smooth_rate(par, inc, mod_A), rate, mod_A > par%fabric_limit)    ! may grow
      steps = rest * graded_rate(par, inc, x, mod_A, rate, e_end) / STEP_RATE
      next_rest = rest - rest / aint(1 + min(steps, real(MAX_STEPS, dp)))
      e_next = e_end + next_rest / max(share, tiny(1.0_dp)) * (e_start - e_end)
      if (trodden%whole) call add_step(trodden, inner_start(x, rest - next_rest, e_next))
      call inner_step(par, inc, rest - next_rest, e_next, x, trodden%solution, status)
      rest = merge(next_rest, 0.0_dp, status == OK)
      mod_A = modulus(x%A)
    end do
    where (rest > 0) status = INCREMENT_TOO_LARGE
  end subroutine integrate

  !> How fast A, its growth c3 (A:S) A, Z2 and phi can change, per increment.
  pure function smooth_rate(par, inc, mod_A) result(rate)
    type(material_parameters), intent(in) :: par
    type(increment), intent(in) :: inc
    real(dp), intent(in) :: mod_A(LANES)
    real(dp) :: rate(LANES)
    rate = fabric_rate(par, inc%mod_D, inc%spin) + 2 * (par%c3 * mod_A + max(par%d2, LARGEST_TRACE)) * inc%mod_D
  end function smooth_rate

  !> The same where something is not smooth, approached in graded steps: Z2 in phi = phic (the square root is integrated
  !! exactly there, but the nodes crowd); with e_r > 0 also the model stress, in A = 0, Z2 = Zc and phi = phic.
  pure function graded_rate(par, inc, x, mod_A, smooth, e_end) result(rate)
    type(material_parameters), intent(in) :: par
    type(increment), intent(in) :: inc
    type(internal), intent(in) :: x
    real(dp), intent(in), dimension(LANES) :: mod_A, smooth, e_end     ! |A|; smooth_rate; ln(phi/phic) at the end of the part
    real(dp), dimension(LANES) :: rate, volume_rate, e_next, near_isotropy, near_jamming

    volume_rate = STEP_RATE * inc%tr_D
    e_next = min(x%e, max(e_end, x%e - volume_rate / max(smooth, tiny(1.0_dp))))   ! the smaller at the ends of a smooth step
    rate = smooth
    where (x%e > 0 .or. e_end > 0) rate = max(rate, min(abs(volume_rate) / max(e_next, SMALL_E), 4 * smooth))
    if (par%elastic_strain > 0) then
      rate = FINER * rate
      where (x%e > 0 .or. e_end > 0) rate = max(rate, 4 * abs(volume_rate) / max(x%e, SMALL_E))
      near_isotropy = abs(par%c1) * inc%mod_D / max(mod_A, SMALL_FABRIC)
      where (mod_A < NO_FABRIC) near_isotropy = 0                         ! on the way from A = 0, |A| is smooth
      near_jamming = ((abs(par%d1) * (2 * mod_A - par%chi) + par%d2 * abs(x%excess)) * inc%mod_D + abs(par%d3 * inc%tr_D)) &
        / max(abs(x%excess), SMALL_EXCESS)
      rate = max(rate, STEP_RATE * max(4 * near_isotropy, 2 * near_jamming))
    end if
  end function graded_rate

  !> One inner step.
  pure subroutine inner_step(par, inc, share, e_end, x, step, status)
    type(material_parameters), intent(in) :: par
    type(increment), intent(in) :: inc
    real(dp), intent(in) :: share(LANES)          ! of the increment
    real(dp), intent(in) :: e_end(LANES)          ! ln(phi/phic) at the end
    type(internal), intent(inout) :: x
    type(inner_solution), intent(out) :: step
    integer, intent(inout) :: status(LANES)
    real(dp) :: one(LANES)
    integer :: i

    step%share = share
    step%mod_D = share * inc%mod_D
    step%tr_D = share * inc%tr_D
    step%S = times(step%mod_D, inc%S_hat)
    do i = 1, 3
      step%w(:, i) = share * inc%spin(:, i)
    end do
    call nodes(x%e, e_end, step%t, step%dt)
    do i = 1, N_NODES
      step%phi(:, i) = x%phi * exponential(-step%tr_D * step%t(:, i))
    end do
    x%phi = x%phi * exponential(-step%tr_D)
    step%phi_end = x%phi
    x%e = e_end
    if (par%closure == CRITICAL) then
      do i = 1, N_NODES
        call imply(par, inc, step%phi(:, i), step%A(:, :, i), step%excess(:, i))
      end do
      call imply(par, inc, x%phi, step%A(:, :, AT_END), step%excess(:, AT_END))
    else
      call solve_fabric(par, x%A, step%S, step%mod_D, step%w, step%fabric)
      call projections_at(par, step%fabric, step%t, step%y, step%A_S)
      if (par%elastic_strain > 0) then
        do i = 1, N_NODES
          call fabric_at(step%fabric, step%t(:, i), step%A(:, :, i), step%y(:, i))
        end do
      end if
      one = 1
      call fabric_at(step%fabric, one, step%A(:, :, AT_END), step%y_end)
      where (status == OK .and. .not. (step%y_end > 0 .and. modulus(step%A(:, :, AT_END)) < REALISABLE)) &
        status = FABRIC_BLOWS_UP
      call integrate_coordination(par, x%excess, step%A_S, modulus(step%S), step%mod_D, step%tr_D, step%phi, step%t, step%dt, &
        par%elastic_strain > 0, step%growth, step%integrand, step%excess)
    end if
    x%A = step%A(:, :, AT_END)
    x%excess = step%excess(:, AT_END)
    if (par%elastic_strain > 0) then
      call relax(par, inc, step, x%dev)
    else
      x%dev = model_deviator(par, inc, x%A, x%excess)
    end if
  end subroutine inner_step

  !> The deviatoric stress after an inner step with e_r > 0.
  pure subroutine relax(par, inc, step, dev)
    type(material_parameters), intent(in) :: par
    type(increment), intent(in) :: inc
    type(inner_solution), intent(inout) :: step
    real(dp), intent(inout) :: dev(LANES, 5)
    real(dp) :: ratio(LANES), u(LANES, AT_END), one(LANES)
    integer :: i

    one = 1
    ratio = step%mod_D / par%elastic_strain
    u(:, :N_NODES) = 1 - step%t
    u(:, AT_END) = 0
    step%weights(:, 0) = exp(-ratio)
    step%weights(:, 1:) = relaxation_weights(ratio, u)
    step%R(:, :, :, 0) = rotation_of_deviators(small_rotation(step%w))
    dev = times(step%weights(:, 0), matrix_times(step%R(:, :, :, 0), dev))
    step%turned(:, :, 0) = dev
    do i = 1, AT_END
      step%p(:, i) = pressure(par, pressure_modulus(par, step%A(:, :, i), inc%tr_direction), step%excess(:, i))
      step%unit(:, :, i) = stress_deviator(par, step%A(:, :, i), inc%S_hat, one)
      step%turned(:, :, i) = times(step%p(:, i), step%unit(:, :, i))
      if (i < AT_END) then
        step%R(:, :, :, i) = rotation_of_deviators(small_rotation(times_spin(u(:, i), step%w)))
        step%turned(:, :, i) = matrix_times(step%R(:, :, :, i), step%turned(:, :, i))
      end if
      dev = dev + times(step%weights(:, i), step%turned(:, :, i))
    end do
  end subroutine relax

end module granumat_update
