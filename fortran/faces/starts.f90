!> States to start from: isotropic packings, and steady simple shear.
module granumat_starts
  use granumat_kinds, only: dp, LANES
  use granumat_law, only: volume_fraction_of
  use granumat_parameters, only: material_parameters, CRITICAL, HERTZIAN, friction_turns
  use granumat_state, only: lane_state, material_state, gather, scatter
  use granumat_status, only: OK, BAD_INITIAL_STATE
  use granumat_stress, only: evaluate
  use granumat_update, only: update
  implicit none (type, external)
  private
  public :: excess_under, isotropic_state, steady_states

  real(dp), parameter :: LARGEST_COORDINATION = 12    ! spheres that fit around one; beyond, the pressure is in other units
  real(dp), parameter :: STEADY_DECAYS = 39           ! exp(-39) is below round-off: Z2 decays by exp(-d2 |D|), A faster
  real(dp), parameter :: SLOWEST_DECAY = 1            ! smallest d2 for which the strain that leads to a steady state grows as 1/d2
  real(dp), parameter :: LONGEST_PART = 1000            ! of that strain over e_r, where substeps grow in number with this ratio

contains

  !> Z2 - Zc of an isotropic packing under a pressure: the inverse of (4.2), (4.4), in the critical-state closure of (A 11).
  pure function excess_under(par, p) result(excess)
    type(material_parameters), intent(in) :: par
    real(dp), intent(in) :: p                         ! not negative, in k/d
    real(dp) :: excess, factor

    factor = par%a1
    if (par%closure == CRITICAL) factor = par%a1 + par%a2 * par%kappa
    excess = sqrt(merge(p**(2.0_dp / 3), p, par%contact == HERTZIAN) / factor)
  end function excess_under

  !> An isotropic packing, A = 0, with its stress. In the critical-state closure, where Z2 = f(phi), phi follows from Z2.
  pure subroutine isotropic_state(par, phi, excess, x, status)
    type(material_parameters), intent(in) :: par
    real(dp), intent(in) :: phi, excess               ! excess = Z2 - Zc
    type(material_state), intent(out) :: x
    integer, intent(out) :: status                    ! OK or BAD_INITIAL_STATE
    type(lane_state) :: lanes_x
    type(material_state) :: started(1)
    real(dp) :: eta(LANES)

    x = material_state(stress=0, fabric=0, direction=0, coordination_number=par%Zc + excess, volume_fraction=phi)
    if (par%closure == CRITICAL) then
      x%volume_fraction = min(phi, par%phic)
      if (excess > 0) x%volume_fraction = volume_fraction_of(par, excess)
    end if
    status = BAD_INITIAL_STATE
    if (.not. (x%volume_fraction > 0 .and. x%volume_fraction < 1 .and. x%coordination_number <= LARGEST_COORDINATION)) return
    status = OK
    call gather([x], lanes_x)
    call evaluate(par, lanes_x, eta)
    call scatter(lanes_x, started)
    x = started(1)
  end subroutine isotropic_state

  !> Steady simple shear at constant volume, du_x/dz > 0: A and Z2 at which (4.7) and (4.8) vanish.
  pure subroutine steady_states(par, phi, points, status)
    type(material_parameters), intent(in) :: par
    real(dp), intent(in) :: phi(:)                    ! at most LANES of them
    type(material_state), intent(out) :: points(:)
    integer, intent(out) :: status(:)
    type(lane_state) :: start, end
    real(dp) :: gamma, strain(LANES, 6), spin(LANES, 3)
    integer :: lane_status(LANES), i, part, parts

    points = [(material_state(stress=0, fabric=0, direction=0, coordination_number=par%Zc, volume_fraction=phi(i)), &
      i = 1, size(phi))]
    gamma = 2 * STEADY_DECAYS / max(par%d2, SLOWEST_DECAY)
    parts = 1
    if (friction_turns(par)) parts = ceiling(gamma / (LONGEST_PART * par%elastic_strain))
    strain = 0
    strain(:, 5) = gamma / parts
    spin = 0
    spin(:, 2) = gamma / parts / 2
    call gather(points, end)
    do part = 1, parts
      start = end
      call update(par, start, strain, spin, end, lane_status)
    end do
    call scatter(end, points)
    status = lane_status(:size(phi))
  end subroutine steady_states

end module granumat_starts
