!> The states at the end of a strain increment, exact for a velocity gradient that is constant over it.
!!
!! update -> deform -> integrate (granumat_substeps) -> solve_fabric, integrate_coordination, relax; with the tangent also
!! consistent_tangent (granumat_tangent). LANES points go side by side.
module granumat_update
  use granumat_kinds, only: dp, LANES
  use granumat_status, only: OK, NOT_FINITE, BAD_NONLOCAL_STRAIN, BAD_VOLUME_FRACTION, FABRIC_BLOWS_UP, TENSILE_PRESSURE, &
    RESULT_NOT_FINITE
  use granumat_increment, only: increment, make_nonlocal, to_increment
  use granumat_parameters, only: material_parameters, friction_turns
  use granumat_state, only: lane_state, check_state, is_finite, is_realisable
  use granumat_stress, only: mobilised_deviator, pressure, pressure_factor, to_evolving, to_excess
  use granumat_substeps, only: integrate, internal_state, substep_record
  use granumat_tangent, only: N_COLUMNS, consistent_tangent
  use granumat_tensors, only: add_identity, deviator, rotate, rotation, times, to_voigt, trace
  implicit none (type, external)
  private
  public :: update, status_before, to_internal, to_state, complete, rotated

  real(dp), parameter :: PROBE_STRAIN = 1.0e-4_dp   ! |D| of the strain whose tangent is given at D = 0

contains

  !> Brings states over their strain increments. Where the status is not OK, the new state is the old one and the tangent is 0.
  pure subroutine update(par, old, strain, spin, new, status, n_adjoints, tangent, unloads, nonlocal, by_nonlocal)
    type(material_parameters), intent(in) :: par
    type(lane_state), intent(in) :: old
    real(dp), intent(in) :: strain(LANES, 6)    ! increments: 11 22 33 and engineering shears 12 13 23
    real(dp), intent(in) :: spin(LANES, 3)      ! increments of W12 W13 W23, W_ij = (du_i/dx_j - du_j/dx_i)/2
    type(lane_state), intent(out) :: new
    integer, intent(out) :: status(LANES)
    integer, intent(in), optional :: n_adjoints            ! 1 ... 6: of the pressure, and of the deviator's first components
    real(dp), intent(out), optional :: tangent(LANES, 6, N_COLUMNS)    ! d stress_i / d (strain_j, spin_j)
    logical, intent(in), optional :: unloads               ! the tangent at D = 0 is that of a strain against the last direction
    real(dp), intent(in), optional :: nonlocal(LANES)      ! the nonlocal strain m of a material with a length
    real(dp), intent(out), optional :: by_nonlocal(LANES, 6)           ! with the tangent: d stress_i / d m
    type(increment) :: inc
    logical :: moves(LANES)
    real(dp) :: m(LANES), probe
    integer :: i

    status = status_before(old, strain, spin)
    call to_increment(strain, spin, status == OK, inc)
    moves = inc%mod_D > 0
    if (present(nonlocal)) then
      where (status == OK .and. .not. (nonlocal >= 0 .and. nonlocal <= huge(m) .and. (nonlocal > 0 .or. .not. moves))) &
        status = BAD_NONLOCAL_STRAIN
      m = merge(nonlocal, 0.0_dp, status == OK)
      moves = moves .or. m > 0
    end if
    probe = PROBE_STRAIN
    if (present(unloads)) probe = merge(-PROBE_STRAIN, PROBE_STRAIN, unloads)
    if (present(tangent) .and. .not. all(moves)) then
      call to_increment(strain_or_probe(old, strain, moves, probe), spin, status == OK, inc)
      if (present(nonlocal)) m = merge(m, inc%mod_D, moves)
    end if
    if (present(nonlocal)) call make_nonlocal(m, old%direction, inc)
    if (present(tangent)) then
      call deform(par, old, inc, new, status, n_adjoints, tangent, by_nonlocal)
    else
      call deform(par, old, inc, new, status)
    end if
    call complete(old, inc%spin, moves, new, status)
    if (.not. present(tangent)) return
    do i = 1, LANES
      if (status(i) == OK) cycle
      tangent(i, :, :) = 0
      if (present(by_nonlocal)) by_nonlocal(i, :) = 0
    end do
  end subroutine update

  !> Whether states and increments can be integrated, as a status.
  pure function status_before(old, strain, spin) result(status)
    type(lane_state), intent(in) :: old
    real(dp), intent(in) :: strain(LANES, 6), spin(LANES, 3)
    integer :: status(LANES)
    status = check_state(old)
    where (status == OK .and. .not. (sum(abs(strain), 2) + sum(abs(spin), 2) <= huge(1.0_dp))) status = NOT_FINITE
  end function status_before

  !> The strain; where there is none, a small one along the last direction, or isotropic compression before any strain.
  pure function strain_or_probe(old, strain, moves, probe) result(probed)
    type(lane_state), intent(in) :: old
    real(dp), intent(in) :: strain(LANES, 6)
    logical, intent(in) :: moves(LANES)
    real(dp), intent(in) :: probe                 ! |D| of the small strain, negative for one against the last direction
    real(dp) :: probed(LANES, 6), direction(LANES)
    logical :: fresh(LANES)
    integer :: k

    fresh = sum(abs(old%direction), 2) <= 0
    do k = 1, 6
      direction = old%direction(:, k)
      if (k <= 3) direction = merge(-sign(sqrt(2.0_dp / 3), probe), direction, fresh)
      if (k > 3) direction = 2 * direction                             ! engineering shears
      probed(:, k) = merge(strain(:, k), probe * direction, moves)
    end do
  end function strain_or_probe

  !> The update where D or m is not 0.
  pure subroutine deform(par, old, inc, new, status, n_adjoints, tangent, by_nonlocal)
    type(material_parameters), intent(in) :: par
    type(lane_state), intent(in) :: old
    type(increment), intent(in) :: inc
    type(lane_state), intent(out) :: new
    integer, intent(inout) :: status(LANES)
    integer, intent(in), optional :: n_adjoints
    real(dp), intent(out), optional :: tangent(LANES, 6, N_COLUMNS), by_nonlocal(LANES, 6)
    type(internal_state) :: x
    type(substep_record) :: record

    call to_internal(par, old, x)
    new%volume_fraction = old%volume_fraction * exp(-inc%tr_D)
    where (status == OK .and. .not. (new%volume_fraction > 0 .and. new%volume_fraction < 1)) status = BAD_VOLUME_FRACTION
    record%all_wanted = present(tangent)
    call integrate(par, inc, new%volume_fraction, x, status, record)
    if (present(tangent)) call consistent_tangent(par, inc, x, record, n_adjoints, tangent, by_nonlocal)
    call to_state(par, old, inc, x, new, status)
  end subroutine deform

  !> What evolves, from states.
  pure subroutine to_internal(par, old, x)
    type(material_parameters), intent(in) :: par
    type(lane_state), intent(in) :: old
    type(internal_state), intent(out) :: x
    x%A = deviator(old%fabric)
    x%excess = to_evolving(par, x%A, old%coordination_number - par%Zc)
    x%phi = old%volume_fraction
    if (friction_turns(par)) then
      x%dev = deviator(old%direction)
    else
      x%dev = deviator(old%stress)
    end if
  end subroutine to_internal

  !> States from what has evolved, all but the volume fraction, and whether they are admissible.
  pure subroutine to_state(par, old, inc, x, new, status)
    type(material_parameters), intent(in) :: par
    type(lane_state), intent(in) :: old
    type(increment), intent(in) :: inc
    type(internal_state), intent(in) :: x
    type(lane_state), intent(inout) :: new
    integer, intent(inout) :: status(LANES)
    real(dp) :: factor(LANES), p(LANES), excess(LANES)

    factor = pressure_factor(par, x%A, inc%tr_direction)
    new%fabric = to_voigt(x%A)
    where (status == OK .and. factor < 0) status = TENSILE_PRESSURE
    where (status == OK .and. .not. is_realisable(new%fabric)) status = FABRIC_BLOWS_UP
    excess = to_excess(par, x%A, x%excess)
    new%coordination_number = par%Zc + excess
    p = pressure(par, factor, excess)
    if (friction_turns(par)) then
      new%direction = add_identity(to_voigt(x%dev), followed_trace(par, old, inc) / 3)
      new%stress = add_identity(to_voigt(times(p, mobilised_deviator(par, x%A, x%dev))), -p)
    else
      new%direction = inc%direction
      new%stress = add_identity(to_voigt(x%dev), -p)
    end if
  end subroutine to_state

  !> The trace of the direction where that follows D^, or D/m, over the strain e_r, as its deviator M does.
  pure function followed_trace(par, old, inc) result(tr)
    type(material_parameters), intent(in) :: par
    type(lane_state), intent(in) :: old
    type(increment), intent(in) :: inc
    real(dp) :: tr(LANES)
    tr = inc%tr_direction + exp(-inc%nonlocal / par%elastic_strain) * (trace(old%direction) - inc%tr_direction)
  end function followed_trace

  !> Completes new states: those at rest, and those where the update failed, which stay the old ones.
  pure subroutine complete(old, spin, moves, new, status)
    type(lane_state), intent(in) :: old
    real(dp), intent(in) :: spin(LANES, 3)
    logical, intent(in) :: moves(LANES)
    type(lane_state), intent(inout) :: new
    integer, intent(inout) :: status(LANES)

    if (.not. all(moves)) call rotate_at_rest(old, spin, moves, new)
    where (status == OK .and. .not. is_finite(new)) status = RESULT_NOT_FINITE
    if (any(status /= OK)) call replace(status /= OK, old, new)
  end subroutine complete

  !> Where nothing moves, states rotate with the body and the stress holds; without spin they stay the same to the last bit.
  pure subroutine rotate_at_rest(old, spin, moves, new)
    type(lane_state), intent(in) :: old
    real(dp), intent(in) :: spin(LANES, 3)
    logical, intent(in) :: moves(LANES)
    type(lane_state), intent(inout) :: new

    if (any(.not. moves .and. maxval(abs(spin), 2) > 0)) then
      call replace(.not. moves, rotated(old, spin), new)
    else
      call replace(.not. moves, old, new)
    end if
  end subroutine rotate_at_rest

  !> Replaces states in the lanes named.
  pure subroutine replace(lane, by, states)
    logical, intent(in) :: lane(LANES)
    type(lane_state), intent(in) :: by
    type(lane_state), intent(inout) :: states
    integer :: k

    do k = 1, 6
      states%stress(:, k) = merge(by%stress(:, k), states%stress(:, k), lane)
      states%fabric(:, k) = merge(by%fabric(:, k), states%fabric(:, k), lane)
      states%direction(:, k) = merge(by%direction(:, k), states%direction(:, k), lane)
    end do
    states%coordination_number = merge(by%coordination_number, states%coordination_number, lane)
    states%volume_fraction = merge(by%volume_fraction, states%volume_fraction, lane)
  end subroutine replace

  !> States rotated by exp(W).
  pure function rotated(old, spin) result(new)
    type(lane_state), intent(in) :: old
    real(dp), intent(in) :: spin(LANES, 3)
    type(lane_state) :: new
    real(dp) :: R(LANES, 3, 3)

    new = old
    R = rotation(spin)
    new%stress = rotate(R, old%stress)
    new%fabric = rotate(R, old%fabric)
    new%direction = rotate(R, old%direction)
  end function rotated

end module granumat_update
