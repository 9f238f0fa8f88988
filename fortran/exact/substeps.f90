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
  use granumat_parameters, only: material_parameters, CRITICAL
  use granumat_quadrature, only: choose_rules, gauss_rules, N_NODES, exponential
  use granumat_relaxation, only: relaxation_weights
  use granumat_state, only: REALISABLE
  use granumat_stress, only: model_deviator, pressure, pressure_factor, stress_deviator
  use granumat_tensors, only: magnitude, matrix_times, rotation_angle, rotation_of_deviators, &
    small_rotation, times, times_spin
  implicit none (type, external)
  private
  public :: integrate, take_substep

  integer, parameter, public :: AT_END = 0     ! index of the end of a substep, before its quadrature nodes
  integer, parameter, public :: MAX_SUBSTEPS = 10000

  ! rate bound times substep: with it the four Gauss points err by 1e-13 (tests/test_exact.py)
  real(dp), parameter :: SUBSTEP_RATE = 0.4_dp
  real(dp), parameter :: QUADRATURE_ERROR = 1.0e-12_dp   ! bound of what one to three nodes may err by
  ! of the rule's error over rate^(2 n + 1): 2 (n!)^4/((2 n + 1) ((2 n)!)^2), for n = 1 ... N_NODES - 1
  real(dp), parameter :: RULE_ERROR(N_NODES - 1) = [1 / 6.0_dp, 1 / 90.0_dp, 1 / 1400.0_dp]
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
    real(dp) :: excess(LANES)          !! Z2 - Zc
    real(dp) :: phi(LANES)
    real(dp) :: log_phi(LANES)         !! ln(phi/phic)
    real(dp) :: dev(LANES, 5)          !! deviatoric stress, tension positive
  end type internal_state

  !> A substep before it is taken: where it starts, its share of the increment, and ln(phi/phic) at its end.
  type, public :: substep_start
    type(internal_state) :: x
    real(dp) :: share(LANES), log_phi_end(LANES)
    integer :: nodes(LANES)            !! of the quadrature
  end type substep_start

  !> A substep, 0 <= t <= 1, with everything that its adjoint needs; the end, with the index AT_END, comes before the nodes.
  type, public :: substep_solution
    real(dp) :: share(LANES), mod_D(LANES), tr_D(LANES), phi_end(LANES), S(LANES, 5), w(LANES, 3)
    real(dp), dimension(LANES, N_NODES) :: t, dt, phi, y, A_S, growth, integrand
    real(dp) :: y_end(LANES)
    real(dp) :: A(LANES, 5, 0:N_NODES), excess(LANES, 0:N_NODES)       !! at the nodes only with e_r > 0
    ! with e_r > 0
    real(dp) :: decay(LANES), old(LANES, 5)                            !! exp(-ratio), and the old deviator decayed and rotated
    real(dp) :: p(LANES, 0:N_NODES), dev_over_p(LANES, 5, 0:N_NODES)   !! the model's pressure, and its deviator over pressure
    real(dp) :: rotated(LANES, 5, 0:N_NODES)                           !! the model's deviators rotated to the end
    real(dp) :: u(LANES, 0:N_NODES), weights(LANES, 0:N_NODES)         !! 1 - t, and weights of granumat_relaxation
    real(dp) :: R(LANES, 5, 5, N_NODES), R_old(LANES, 5, 5)            !! rotations of deviators to the end
    type(gauss_rules) :: rules
    type(fabric_solution) :: fabric
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
      x%dev = model_deviator(par, x%A, inc%S_hat, inc%tr_direction, x%excess)
      record%solution%share = 1
      record%solution%phi_end = phi_end
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
    real(dp), dimension(LANES) :: remainder, next_remainder, rate, graded_rate, taken, log_phi_start, log_phi_next, mod_A
    integer :: step, nodes(LANES)

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
      taken = remainder / aint(1 + min(remainder * graded_rate / SUBSTEP_RATE, real(MAX_SUBSTEPS, dp)))
      next_remainder = remainder - taken
      nodes = N_NODES
      if (par%elastic_strain > 0) nodes = nodes_needed(par, remainder > 0, taken * graded_rate, taken * inc%mod_D)
      log_phi_next = log_phi_end + next_remainder / max(share, tiny(1.0_dp)) * (log_phi_start - log_phi_end)
      if (record%all_wanted) call add_start(record, substep_start(x, remainder - next_remainder, log_phi_next, nodes))
      call take_substep(par, inc, remainder - next_remainder, log_phi_next, nodes, x, record%solution, status)
      remainder = merge(next_remainder, 0.0_dp, status == OK)
      mod_A = magnitude(x%A)
    end do
    where (remainder > 0) status = INCREMENT_TOO_LARGE
  end subroutine integrate_part

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

  !> A bound, per increment, of how fast A, its growth c3 (A : S) A, Z2 and phi can change where the law is smooth; in the
  !! critical-state closure, of the model's stress in a frame that rotates with the spin.
  !!
  !! The factor 2 keeps d2 |D|, |tr D| and the angle of a substep at or below SUBSTEP_RATE/2 = 0.2, up to where `exponential` and
  !! `rotation_series` are exact to round-off.
  pure function rate_bound(par, inc, mod_A) result(rate)
    type(material_parameters), intent(in) :: par
    type(increment), intent(in) :: inc
    real(dp), intent(in) :: mod_A(LANES)
    real(dp) :: rate(LANES)
    if (par%closure == CRITICAL) then
      rate = CRITICAL_REFINEMENT * 2 * (rotation_angle(inc%spin) + abs(inc%tr_D))
    else
      rate = fabric_rate_bound(par, inc%mod_D, inc%spin) + 2 * (par%c3 * mod_A + max(par%d2, LARGEST_TRACE)) * inc%mod_D
    end if
  end function rate_bound

  !> Gauss points of a substep with e_r > 0: as few as keep the error below QUADRATURE_ERROR, the most in a substep of usual size
  !! (docs/theory.md, section 5.5).
  pure function nodes_needed(par, moves, rate, mod_D) result(nodes)
    type(material_parameters), intent(in) :: par
    logical, intent(in) :: moves(LANES)     ! where a substep is taken; elsewhere any number will do
    real(dp), intent(in) :: rate(LANES)     ! rate bound times share
    real(dp), intent(in) :: mod_D(LANES)    ! |D| of the substep
    integer :: nodes(LANES), n
    real(dp), dimension(LANES) :: kernel_rate, power

    kernel_rate = max(rate, min(mod_D / par%elastic_strain, 1.0_dp))
    power = rate
    nodes = 1
    do n = 1, N_NODES - 1
      power = power * rate * kernel_rate
      nodes = merge(n + 1, nodes, RULE_ERROR(n) * power > QUADRATURE_ERROR)
    end do
    nodes = merge(nodes, 1, moves)
    nodes = merge(nodes, maxval(nodes), moves)
  end function nodes_needed

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
    if (par%elastic_strain > 0) then
      rate = RELAXATION_REFINEMENT * rate
      where (x%log_phi > 0 .or. log_phi_end > 0) rate = max(rate, 4 * abs(volume_rate) / max(x%log_phi, SMALLEST_LOG_PHI))
      if (par%closure == CRITICAL) return
      near_isotropy = abs(par%c1) * inc%mod_D / max(mod_A, SMALLEST_FABRIC)
      where (mod_A < ISOTROPIC_BELOW) near_isotropy = 0
      near_jamming = ((abs(par%d1) * (2 * mod_A - par%chi) + par%d2 * abs(x%excess)) * inc%mod_D + abs(par%d3 * inc%tr_D)) &
        / max(abs(x%excess), SMALLEST_EXCESS)
      rate = max(rate, SUBSTEP_RATE * max(4 * near_isotropy, 2 * near_jamming))
    end if
  end function kink_rate_bound

  !> Takes one substep: phi, then the fabric, then the coordination number, then the stress.
  pure subroutine take_substep(par, inc, share, log_phi_end, nodes, x, step, status)
    type(material_parameters), intent(in) :: par
    type(increment), intent(in) :: inc
    real(dp), intent(in) :: share(LANES)          ! of the increment
    real(dp), intent(in) :: log_phi_end(LANES)    ! ln(phi/phic) at the end
    integer, intent(in) :: nodes(LANES)           ! of the quadrature
    type(internal_state), intent(inout) :: x
    type(substep_solution), intent(out) :: step
    integer, intent(inout) :: status(LANES)
    real(dp) :: one(LANES)

    step%share = share
    step%mod_D = share * inc%mod_D
    step%tr_D = share * inc%tr_D
    step%S = times(step%mod_D, inc%S_hat)
    step%w = times_spin(share, inc%spin)
    if (par%closure /= CRITICAL) then
      call solve_fabric(par, x%A, step%S, step%mod_D, step%w, step%fabric)
      one = 1
      call fabric_at(step%fabric, one, step%A(:, :, AT_END), step%y_end)
      where (status == OK .and. .not. (step%y_end > 0 .and. magnitude(step%A(:, :, AT_END)) < REALISABLE)) &
        status = FABRIC_BLOWS_UP
    end if
    call choose_rules(nodes, par%elastic_strain > 0, step%rules)
    select case (step%rules%n)         ! numbers that the compiler knows: loops over nodes are unrolled
    case (1)
      call integrate_at_nodes(1, par, inc, log_phi_end, x, step)
    case (2)
      call integrate_at_nodes(2, par, inc, log_phi_end, x, step)
    case (3)
      call integrate_at_nodes(3, par, inc, log_phi_end, x, step)
    case default
      call integrate_at_nodes(N_NODES, par, inc, log_phi_end, x, step)
    end select
    x%A = step%A(:, :, AT_END)
    x%excess = step%excess(:, AT_END)
    if (.not. par%elastic_strain > 0) x%dev = model_deviator(par, x%A, inc%S_hat, inc%tr_direction, x%excess)
  end subroutine take_substep

  !> What a substep integrates by quadrature with at most n nodes: the coordination number, and with e_r > 0 the stress.
  pure subroutine integrate_at_nodes(n, par, inc, log_phi_end, x, step)
    integer, intent(in) :: n
    type(material_parameters), intent(in) :: par
    type(increment), intent(in) :: inc
    real(dp), intent(in) :: log_phi_end(LANES)
    type(internal_state), intent(inout) :: x      ! phi goes to the end, and with e_r > 0 the deviator
    type(substep_solution), intent(inout) :: step
    integer :: i

    call quadrature_nodes(step%rules, x%log_phi, log_phi_end, step%t, step%dt)
    do i = 1, n
      step%phi(:, i) = x%phi * exponential(-step%tr_D * step%t(:, i))
    end do
    x%phi = x%phi * exponential(-step%tr_D)
    step%phi_end = x%phi
    x%log_phi = log_phi_end
    if (par%closure == CRITICAL) then
      do i = 1, n
        call critical_state(par, inc%S_hat, step%phi(:, i), step%A(:, :, i), step%excess(:, i))
      end do
      call critical_state(par, inc%S_hat, x%phi, step%A(:, :, AT_END), step%excess(:, AT_END))
    else
      call projections_at(par, step%fabric, step%t, step%y, step%A_S)
      if (par%elastic_strain > 0) then
        do i = 1, n
          call fabric_at(step%fabric, step%t(:, i), step%A(:, :, i), step%y(:, i))
        end do
      end if
      call integrate_coordination(par, n, step%rules, x%excess, step%A_S, magnitude(step%S), step%mod_D, step%tr_D, step%phi, &
        step%t, step%dt, par%elastic_strain > 0, step%growth, step%integrand, step%excess)
    end if
    if (par%elastic_strain > 0) call relax(n, par, inc, step, x%dev)
  end subroutine integrate_at_nodes

  !> The deviatoric stress after a substep with e_r > 0: what is left of the old one, and the model's at the nodes and the end by
  !! their weights, all rotated to the end.
  pure subroutine relax(n, par, inc, step, dev)
    integer, intent(in) :: n
    type(material_parameters), intent(in) :: par
    type(increment), intent(in) :: inc
    type(substep_solution), intent(inout) :: step
    real(dp), intent(inout) :: dev(LANES, 5)
    real(dp) :: ratio(LANES), one(LANES)
    integer :: i

    one = 1
    ratio = step%mod_D / par%elastic_strain
    step%u(:, AT_END) = 0
    step%u(:, 1:) = 1 - step%t
    step%decay = exp(-ratio)
    step%weights = relaxation_weights(ratio, step%u, step%rules%nodes, n)
    step%R_old = rotation_of_deviators(small_rotation(step%w))
    dev = times(step%decay, matrix_times(step%R_old, dev))
    step%old = dev
    do i = 0, n
      step%p(:, i) = pressure(par, pressure_factor(par, step%A(:, :, i), inc%tr_direction), step%excess(:, i))
      step%dev_over_p(:, :, i) = stress_deviator(par, step%A(:, :, i), inc%S_hat, one)
      step%rotated(:, :, i) = times(step%p(:, i), step%dev_over_p(:, :, i))
      if (i /= AT_END) then
        step%R(:, :, :, i) = rotation_of_deviators(small_rotation(times_spin(step%u(:, i), step%w)))
        step%rotated(:, :, i) = matrix_times(step%R(:, :, :, i), step%rotated(:, :, i))
      end if
      dev = dev + times(step%weights(:, i), step%rotated(:, :, i))
    end do
  end subroutine relax

end module granumat_substeps
