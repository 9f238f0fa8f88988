!> A strain increment in substeps, each integrated to round-off (docs/theory.md, section 5).
!!
!! LANES points go side by side. Each takes the substeps that it needs by itself; a point that is done waits with zero strain.
module granumat_substeps
  use granumat_kinds, only: dp, LANES
  use granumat_status, only: OK, INCREMENT_TOO_LARGE, FABRIC_BLOWS_UP
  use granumat_coordination, only: integrate_coordination, quadrature_nodes
  use granumat_fabric, only: fabric_at, fabric_rate_bound, fabric_solution, projections_at, solve_fabric
  use granumat_increment, only: increment
  use granumat_law, only: critical_state
  use granumat_mobilisation, only: direction_at_end, mobilisation_solution, share_to_kink, shares_at, solve_mobilisation
  use granumat_parameters, only: material_parameters, CRITICAL, deviator_relaxes, friction_turns
  use granumat_quadrature, only: AT_END, AT_START, MAX_DEGREE, N_NODES, choose_places, exponential
  use granumat_relaxation, only: relaxation_weights
  use granumat_state, only: REALISABLE
  use granumat_stress, only: nonlocal_deviator, pressure, pressure_factor, stress_deviator
  use granumat_tensors, only: contract, magnitude, matrix_times, rotation_angle, rotation_of_deviators, &
    small_rotation, times, times_spin
  implicit none (type, external)
  private
  public :: integrate, take_substep

  integer, parameter, public :: MAX_SUBSTEPS = 10000

  ! rate bound times substep: with it the four Gauss points err by 1e-13 (tests/test_exact.py)
  real(dp), parameter :: SUBSTEP_RATE = 0.4_dp
  ! bound of the error, over the pressure, of the model's stress interpolated by a line or a parabola instead of MAX_DEGREE
  real(dp), parameter :: INTERPOLATION_ERROR = 1.0e-12_dp
  real(dp), parameter :: LINE = 1 / 6.0_dp, PARABOLA = 1 / 120.0_dp       ! factors of the bound
  real(dp), parameter :: STEEP_FROM = 2                  ! m/e_r of a substep from which the places crowd at its end
  ! with e_r > 0 substeps are smaller by this: the interpolation in the kernel has half the order of Gauss's rule
  real(dp), parameter :: RELAXATION_REFINEMENT = 1.5_dp
  ! in the critical-state closure only spin and volume strain change the model's stress, and these rates are tight
  real(dp), parameter :: CRITICAL_REFINEMENT = 6
  real(dp), parameter :: ISOTROPIC_BELOW = 1.0e-12_dp    ! |A| below which the fabric starts from A = 0, where |A| is smooth in t
  ! distances to a kink below which substeps no longer shrink: |A|, Z2 - Zc, ln(phi/phic)
  real(dp), parameter :: SMALLEST_FABRIC = 1.0e-5_dp, SMALLEST_EXCESS = 1.0e-3_dp, SMALLEST_LOG_PHI = 1.0e-6_dp
  real(dp), parameter :: LARGEST_TRACE = 2.45_dp         ! of D^: sqrt(6), for an isotropic strain

  !> What evolves inside an increment.
  type, public :: internal_state
    real(dp) :: A(LANES, 5)            !! fabric
    real(dp) :: excess(LANES)          !! Z2 - Zc, or what evolves in its place (to_evolving)
    real(dp) :: phi(LANES)
    real(dp) :: log_phi(LANES)         !! ln(phi/phic)
    real(dp) :: dev(LANES, 5)          !! deviatoric stress, tension positive; where friction turns, its mobilised direction M
  end type internal_state

  !> A substep before it is taken: where it starts, its share of the increment, and ln(phi/phic) at its end.
  type, public :: substep_start
    type(internal_state) :: x
    real(dp) :: share(LANES), log_phi_end(LANES)
    real(dp) :: degree(LANES)          !! of the polynomial that interpolates the model's stress with e_r > 0
  end type substep_start

  !> A substep, 0 <= t <= 1, with everything that its adjoint needs: at the quadrature nodes, and at the places of choose_places, of
  !! which e_r = 0 needs the end, and e_r > 0 all up to the last one.
  type, public :: substep_solution
    real(dp) :: share(LANES), mod_D(LANES), nonlocal(LANES), tr_D(LANES), S(LANES, 5), w(LANES, 3)
    real(dp), dimension(LANES, N_NODES) :: t, dt, phi, y, A_S, growth, integrand
    real(dp), dimension(LANES, 0:MAX_DEGREE) :: t_place, phi_place, excess
    real(dp) :: integrals(LANES, N_NODES, AT_END:MAX_DEGREE)     !! of choose_places
    real(dp), dimension(LANES, AT_END:MAX_DEGREE) :: y_place, decay_place    !! decay_place = exp(-d2 m t)
    real(dp) :: A(LANES, 5, 0:MAX_DEGREE)
    ! with e_r > 0
    real(dp) :: degree(LANES), decay(LANES)                                  !! decay = exp(-m/e_r)
    real(dp) :: p(LANES, 0:MAX_DEGREE), dev_over_p(LANES, 5, 0:MAX_DEGREE)   !! the model's pressure, and its deviator over pressure
    real(dp) :: weights(LANES, 0:MAX_DEGREE)                                 !! of granumat_relaxation
    real(dp) :: R(LANES, 5, 5, 0:MAX_DEGREE)                                 !! rotations of deviators to the end
    real(dp) :: rotated(LANES, 5, 0:MAX_DEGREE), decayed(LANES, 5)           !! the model's deviators and the old one there
    real(dp) :: mobilised(LANES, N_NODES)                                    !! share of friction at the nodes, where friction turns
    type(fabric_solution) :: fabric
    type(mobilisation_solution) :: mobilisation                              !! where friction turns
    integer :: last
  end type substep_solution

  !> The substeps of an increment: the last one solved, of the others, where all are wanted, only how they start.
  type, public :: substep_record
    type(substep_start) :: last
    type(substep_solution) :: solution
    type(substep_start), allocatable :: earlier(:)     ! has steps - 1, and room for more
    integer :: steps = 0
    logical :: all_wanted
  end type substep_record

contains

  !> Integrates an increment. It is split where phi crosses phic, and each part is taken in substeps; nothing needs to be
  !! integrated in the critical-state closure with e_r = 0.
  pure subroutine integrate(par, inc, phi_end, x, status, record)
    type(material_parameters), intent(in) :: par
    type(increment), intent(in) :: inc
    real(dp), intent(in) :: phi_end(LANES)
    type(internal_state), intent(inout) :: x
    integer, intent(inout) :: status(LANES)
    type(substep_record), intent(inout) :: record
    real(dp), dimension(LANES) :: log_phi_end, crossing

    if (par%closure == CRITICAL .and. .not. par%elastic_strain > 0) then
      call critical_state(par, inc%S_hat, phi_end, x%A, x%excess)
      x%dev = deviator_at(par, inc, x%A, x%excess)
      record%solution%share = 1
      record%solution%t_place(:, AT_END) = 1
      record%solution%phi_place(:, AT_END) = phi_end
      record%solution%last = AT_END
      record%steps = 1
      return
    end if
    x%log_phi = log(merge(x%phi / par%phic, 2.0_dp, status == OK))
    log_phi_end = x%log_phi - inc%tr_D
    crossing = 1
    where (x%log_phi * log_phi_end < 0) crossing = x%log_phi / inc%tr_D
    call integrate_part(par, inc, crossing, merge(0.0_dp, log_phi_end, crossing < 1), x, status, record)
    if (any(crossing < 1)) call integrate_part(par, inc, 1 - crossing, log_phi_end, x, status, record)
  end subroutine integrate

  !> Takes substeps over a share of the increment in which phi stays on one side of phic.
  pure subroutine integrate_part(par, inc, share, log_phi_end, x, status, record)
    type(material_parameters), intent(in) :: par
    type(increment), intent(in) :: inc
    real(dp), intent(in) :: share(LANES), log_phi_end(LANES)
    type(internal_state), intent(inout) :: x
    integer, intent(inout) :: status(LANES)
    type(substep_record), intent(inout) :: record
    real(dp), dimension(LANES) :: remainder, next_remainder, rate, graded_rate, steps, share_next, log_phi_start, log_phi_next
    real(dp), dimension(LANES) :: mod_A, degree
    integer :: step

    mod_A = magnitude(x%A)
    rate = rate_bound(par, inc, mod_A)
    where (status == OK .and. .not. share * rate < SUBSTEP_RATE * MAX_SUBSTEPS) status = INCREMENT_TOO_LARGE
    remainder = merge(share, 0.0_dp, status == OK)
    log_phi_start = x%log_phi
    do step = 1, MAX_SUBSTEPS
      if (all(remainder <= 0)) return
      if (any(mod_A > par%fabric_limit)) then           ! above the limit |A| can grow, and the bound with it
        rate = merge(rate_bound(par, inc, mod_A), rate, mod_A > par%fabric_limit)
      end if
      graded_rate = kink_rate_bound(par, inc, x, mod_A, rate, log_phi_end)
      steps = remainder * graded_rate / SUBSTEP_RATE
      next_remainder = remainder - remainder / aint(1 + min(steps, real(MAX_SUBSTEPS, dp)))
      share_next = remainder - next_remainder
      if (friction_turns(par)) then
        share_next = up_to_kink(par, inc, x%dev, share_next)
        next_remainder = remainder - share_next
      end if
      log_phi_next = log_phi_end + next_remainder / max(share, tiny(1.0_dp)) * (log_phi_start - log_phi_end)
      degree = 1
      if (deviator_relaxes(par)) degree = degree_needed(par, share_next * graded_rate, share_next * inc%nonlocal)
      if (record%all_wanted) call add_start(record, substep_start(x, share_next, log_phi_next, degree))
      call take_substep(par, inc, share_next, log_phi_next, degree, x, record%solution, status)
      remainder = merge(next_remainder, 0.0_dp, status == OK)
      mod_A = magnitude(x%A)
    end do
    where (remainder > 0) status = INCREMENT_TOO_LARGE
  end subroutine integrate_part

  !> The share of a substep, cut where the mobilised share of friction has a kink.
  pure function up_to_kink(par, inc, M, share) result(cut)
    type(material_parameters), intent(in) :: par
    type(increment), intent(in) :: inc
    real(dp), intent(in) :: M(LANES, 5), share(LANES)
    real(dp) :: cut(LANES), projection(LANES), largest(LANES), distance(LANES)
    type(mobilisation_solution) :: solution

    ! with |M|, |S/m| <= `largest`, |S^| <= 1, the projection falls by the spin alone while it is positive, by 4 times its angle
    cut = share
    projection = contract(M, inc%S_hat) + (1 - inc%R) * contract(inc%S_hat, inc%S_hat)
    largest = 4 * share * max(1.0_dp, inc%R, magnitude(M))
    distance = max(projection, -projection - largest * inc%nonlocal / par%elastic_strain) - largest * rotation_angle(inc%spin)
    if (all(distance > 0 .or. share <= 0)) return
    call solve_mobilisation(par, M, inc%S_hat, inc%R, share * inc%nonlocal, times_spin(share, inc%spin), solution)
    cut = share * share_to_kink(solution, inc%S_hat, inc%R)
  end function up_to_kink

  !> Adds the start of a substep to a record.
  pure subroutine add_start(record, start)
    type(substep_record), intent(inout) :: record
    type(substep_start), intent(in) :: start
    type(substep_start), allocatable :: longer(:)
    integer :: n

    n = record%steps
    if (n > 0) then
      if (.not. allocated(record%earlier)) allocate (record%earlier(4))
      if (n > size(record%earlier)) then
        allocate (longer(2 * n))
        longer(:n - 1) = record%earlier(:n - 1)
        call move_alloc(longer, record%earlier)
      end if
      record%earlier(n) = record%last
    end if
    record%last = start
    record%steps = n + 1
  end subroutine add_start

  !> A bound, per increment, of how fast A, its growth c3 (A : S) A, Z2, phi and M can change where the law is smooth; in the
  !! critical-state closure, of the model's stress in a frame that rotates with the spin.
  !!
  !! The factor 2 keeps d2 m, |tr D| and the angle of a substep at or below SUBSTEP_RATE/2 = 0.2, up to where `exponential` and
  !! `rotation_series` are exact to round-off.
  pure function rate_bound(par, inc, mod_A) result(rate)
    type(material_parameters), intent(in) :: par
    type(increment), intent(in) :: inc
    real(dp), intent(in) :: mod_A(LANES)
    real(dp) :: rate(LANES), largest(LANES)
    if (par%closure == CRITICAL) then
      rate = CRITICAL_REFINEMENT * 2 * (rotation_angle(inc%spin) + abs(inc%tr_D))
    else
      largest = max(inc%mod_D, inc%nonlocal)
      rate = fabric_rate_bound(par, largest, inc%spin) + 2 * (par%c3 * mod_A + max(par%d2, LARGEST_TRACE)) * largest
      if (friction_turns(par)) rate = rate + inc%nonlocal / par%elastic_strain
    end if
  end function rate_bound

  !> The rate bound near kinks, so that substeps shrink with the distance to them.
  !!
  !! Kinks are phi = phic for Z2, where the quadrature in sqrt(ln(phi/phic)) is exact but its nodes crowd, and with e_r > 0, where
  !! the model's stress is interpolated, also A = 0, Z2 = Zc and phi = phic for the stress.
  pure function kink_rate_bound(par, inc, x, mod_A, smooth, log_phi_end) result(rate)
    type(material_parameters), intent(in) :: par
    type(increment), intent(in) :: inc
    type(internal_state), intent(in) :: x
    real(dp), intent(in) :: mod_A(LANES)           ! |A|
    real(dp), intent(in) :: smooth(LANES)          ! rate_bound
    real(dp), intent(in) :: log_phi_end(LANES)     ! ln(phi/phic) at the end of the part
    real(dp), dimension(LANES) :: rate, volume_rate, log_phi_next, near_isotropy, near_jamming

    volume_rate = SUBSTEP_RATE * inc%tr_D
    log_phi_next = min(x%log_phi, max(log_phi_end, x%log_phi - volume_rate / max(smooth, tiny(1.0_dp))))
    rate = smooth
    where (x%log_phi > 0 .or. log_phi_end > 0) &
      rate = max(rate, min(abs(volume_rate) / max(log_phi_next, SMALLEST_LOG_PHI), 4 * smooth))
    if (deviator_relaxes(par)) then
      rate = RELAXATION_REFINEMENT * rate
      where (x%log_phi > 0 .or. log_phi_end > 0) rate = max(rate, 4 * abs(volume_rate) / max(x%log_phi, SMALLEST_LOG_PHI))
      if (par%closure == CRITICAL) return
      near_isotropy = abs(par%c1) * inc%mod_D / max(mod_A, SMALLEST_FABRIC)
      where (mod_A < ISOTROPIC_BELOW) near_isotropy = 0
      near_jamming = ((abs(par%d1) * (2 * mod_A - par%chi) + par%d2 * abs(x%excess)) * max(inc%mod_D, inc%nonlocal) &
        + abs(par%d3 * inc%tr_D)) &
        / max(abs(x%excess), SMALLEST_EXCESS)
      rate = max(rate, SUBSTEP_RATE * max(4 * near_isotropy, 2 * near_jamming))
    end if
  end function kink_rate_bound

  !> The degree of the polynomial that interpolates the model's stress: the lowest that keeps the error of a substep with e_r > 0
  !! below INTERPOLATION_ERROR, the highest in a substep of usual size (docs/theory.md, section 5.5).
  pure function degree_needed(par, rate, nonlocal) result(degree)
    type(material_parameters), intent(in) :: par
    real(dp), intent(in) :: rate(LANES)           ! kink_rate_bound times share
    real(dp), intent(in) :: nonlocal(LANES)       ! m of the substep
    real(dp) :: degree(LANES), ratio(LANES)

    ratio = nonlocal / par%elastic_strain
    degree = MAX_DEGREE
    where (PARABOLA * ratio * rate**3 * (ratio + rate) < INTERPOLATION_ERROR .and. ratio < STEEP_FROM) degree = 2
    where (LINE * ratio * rate**2 < INTERPOLATION_ERROR) degree = 1
  end function degree_needed

  !> Takes one substep: phi, then the fabric, then the coordination number, then the stress.
  pure subroutine take_substep(par, inc, share, log_phi_end, degree, x, step, status)
    type(material_parameters), intent(in) :: par
    type(increment), intent(in) :: inc
    real(dp), intent(in) :: share(LANES)          ! of the increment
    real(dp), intent(in) :: log_phi_end(LANES)    ! ln(phi/phic) at the end
    real(dp), intent(in) :: degree(LANES)         ! of degree_needed
    type(internal_state), intent(inout) :: x
    type(substep_solution), intent(out) :: step
    integer, intent(inout) :: status(LANES)
    real(dp) :: places(LANES, 0:MAX_DEGREE)
    integer :: i

    step%share = share
    step%mod_D = share * inc%mod_D
    step%nonlocal = share * inc%nonlocal
    step%tr_D = share * inc%tr_D
    step%S = times(step%mod_D, inc%S_hat)
    step%w = times_spin(share, inc%spin)
    step%degree = degree
    step%last = nint(maxval(degree))
    call choose_places(step%nonlocal / (STEEP_FROM * max(par%elastic_strain, tiny(1.0_dp))), step%last, places, step%integrals)
    call quadrature_nodes(x%log_phi, log_phi_end, places, step%last, step%t, step%dt, step%t_place)
    if (par%closure == CRITICAL) then
      do i = AT_START, step%last
        step%phi_place(:, i) = x%phi * exponential(-step%tr_D * step%t_place(:, i))
        call critical_state(par, inc%S_hat, step%phi_place(:, i), step%A(:, :, i), step%excess(:, i))
      end do
    else
      call evolve_microstructure(par, x, step, status)
      if (friction_turns(par)) call mobilise(par, inc, x%dev, step)
    end if
    x%phi = x%phi * exponential(-step%tr_D)
    x%log_phi = log_phi_end
    x%A = step%A(:, :, AT_END)
    x%excess = step%excess(:, AT_END)
    if (deviator_relaxes(par)) then
      call relax(par, inc, step, x%dev)
    else if (friction_turns(par)) then
      x%dev = direction_at_end(step%mobilisation)
    else
      x%dev = deviator_at(par, inc, x%A, x%excess)
    end if
  end subroutine take_substep

  !> The stress deviator that the model has in an increment.
  pure function deviator_at(par, inc, A, excess) result(dev)
    type(material_parameters), intent(in) :: par
    type(increment), intent(in) :: inc
    real(dp), intent(in) :: A(LANES, 5), excess(LANES)
    real(dp) :: dev(LANES, 5), p(LANES)

    p = pressure(par, pressure_factor(par, A, inc%tr_direction), excess)
    dev = stress_deviator(par, A, inc%S_hat, p)
    if (inc%has_length) dev = nonlocal_deviator(par, A, inc%R, p, dev)
  end function deviator_at

  !> Fabric and coordination number of a substep.
  pure subroutine evolve_microstructure(par, x, step, status)
    type(material_parameters), intent(in) :: par
    type(internal_state), intent(in) :: x         ! at the start
    type(substep_solution), intent(inout) :: step
    integer, intent(inout) :: status(LANES)
    integer :: i

    do i = 1, N_NODES
      step%phi(:, i) = x%phi * exponential(-step%tr_D * step%t(:, i))
    end do
    call solve_fabric(par, x%A, step%S, step%mod_D, step%nonlocal, step%w, step%fabric)
    call projections_at(par, step%fabric, step%t, step%y, step%A_S)
    step%A(:, :, AT_START) = x%A
    step%excess(:, AT_START) = x%excess
    do i = AT_END, step%last
      call fabric_at(step%fabric, step%t_place(:, i), step%A(:, :, i), step%y_place(:, i))
    end do
    where (status == OK .and. .not. (step%y_place(:, AT_END) > 0 .and. magnitude(step%A(:, :, AT_END)) < REALISABLE)) &
      status = FABRIC_BLOWS_UP
    call integrate_coordination(par, step%A_S, magnitude(step%S), step%nonlocal, step%tr_D, step%phi, step%t, step%dt, &
      step%integrals, step%t_place, step%last, step%growth, step%integrand, step%decay_place, step%excess)
  end subroutine evolve_microstructure

  !> The mobilised direction in a substep, its share at the nodes, and Z2 - Zc at the end with it.
  pure subroutine mobilise(par, inc, M, step)
    type(material_parameters), intent(in) :: par
    type(increment), intent(in) :: inc
    real(dp), intent(in) :: M(LANES, 5)           ! at the start
    type(substep_solution), intent(inout) :: step
    real(dp) :: idle(LANES)                       ! what d1 chi (1 - share) |S|, by which (4.8) differs, adds to the integrand
    integer :: i

    call solve_mobilisation(par, M, inc%S_hat, inc%R, step%nonlocal, step%w, step%mobilisation)
    step%mobilised = shares_at(step%mobilisation, inc%S_hat, inc%R, step%t)
    do i = 1, N_NODES
      idle = step%growth(:, i) * step%dt(:, i) * par%d1 * par%chi * (1 - step%mobilised(:, i)) * magnitude(step%S)
      step%integrand(:, i) = step%integrand(:, i) + idle
      step%excess(:, AT_END) = step%excess(:, AT_END) + step%decay_place(:, AT_END) * step%integrals(:, i, AT_END) * idle
    end do
  end subroutine mobilise

  !> The deviatoric stress after a substep with e_r > 0: what is left of the old one, and the model's at the places by their
  !! weights, all rotated to the end.
  pure subroutine relax(par, inc, step, dev)
    type(material_parameters), intent(in) :: par
    type(increment), intent(in) :: inc
    type(substep_solution), intent(inout) :: step
    real(dp), intent(inout) :: dev(LANES, 5)
    real(dp) :: ratio(LANES), u(LANES, 0:MAX_DEGREE), one(LANES)
    integer :: i

    one = 1
    ratio = step%nonlocal / par%elastic_strain
    do i = AT_START, step%last
      u(:, i) = 1 - step%t_place(:, i)
    end do
    step%decay = exp(-ratio)
    step%weights = relaxation_weights(ratio, step%decay, u, step%degree, step%last)
    step%R(:, :, :, AT_START) = rotation_of_deviators(small_rotation(step%w))
    dev = times(step%decay, matrix_times(step%R(:, :, :, AT_START), dev))
    step%decayed = dev
    do i = AT_START, step%last
      step%p(:, i) = pressure(par, pressure_factor(par, step%A(:, :, i), inc%tr_direction), step%excess(:, i))
      step%dev_over_p(:, :, i) = stress_deviator(par, step%A(:, :, i), inc%S_hat, one)
      if (inc%has_length) step%dev_over_p(:, :, i) = nonlocal_deviator(par, step%A(:, :, i), inc%R, one, step%dev_over_p(:, :, i))
      step%rotated(:, :, i) = times(step%p(:, i), step%dev_over_p(:, :, i))
      if (i > AT_END) step%R(:, :, :, i) = rotation_of_deviators(small_rotation(times_spin(u(:, i), step%w)))
      if (i /= AT_END) step%rotated(:, :, i) = matrix_times(step%R(:, :, :, i), step%rotated(:, :, i))
      dev = dev + times(step%weights(:, i), step%rotated(:, :, i))
    end do
  end subroutine relax

end module granumat_substeps
