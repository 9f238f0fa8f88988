!> The state at the end of a strain increment: exact for a velocity gradient that is constant over it.
module granumat_update
  use, intrinsic :: ieee_arithmetic, only: ieee_is_finite
  use granumat_kinds, only: dp
  use granumat_status, only: OK, NOT_FINITE, BAD_VOLUME_FRACTION, INCREMENT_TOO_LARGE, FABRIC_BLOWS_UP, &
    TENSILE_PRESSURE, RESULT_NOT_FINITE
  use granumat_tensors, only: IDENTITY, deviator, modulus, rotate, rotation, trace
  use granumat_parameters, only: material_parameters, CRITICAL
  use granumat_state, only: material_state, check_state, is_finite, is_realisable
  use granumat_fabric, only: fabric_solution, fabric_at, fabric_rate, projection_at, solve_fabric, y_at
  use granumat_coordination, only: N_NODES, excess_coordination, integrate_coordination, nodes
  use granumat_stress, only: pressure, pressure_modulus, stress_deviator
  use granumat_relaxation, only: relaxation_weights
  implicit none (type, external)
  private
  public :: update

  real(dp), parameter :: STEP_RATE = 0.6_dp      ! rate times inner step: 5 Gauss points then err by 1e-13 (tests/test_exact.py)
  integer, parameter :: MAX_STEPS = 10000
  real(dp), parameter :: SMALL_FABRIC = 1.0e-5_dp, SMALL_EXCESS = 1.0e-3_dp, SMALL_E = 1.0e-6_dp   ! kinks are stepped over below
  real(dp), parameter :: REALISABLE = 0.578_dp   ! no realisable fabric has a larger |A| than 1/sqrt(3)

  !> A deformation with constant velocity gradient, and its invariants.
  type :: increment
    real(dp) :: direction(6)    ! D^ = D/|D|
    real(dp) :: S_hat(6)        ! S/|D|
    real(dp) :: mod_D           ! |D|
    real(dp) :: spin(3)         ! W12 W13 W23
  end type increment

  !> What evolves inside an increment.
  type :: internal
    real(dp) :: A(6)            ! fabric
    real(dp) :: excess          ! Z2 - Zc
    real(dp) :: e               ! ln(phi/phic)
    real(dp) :: dev(6)          ! deviatoric stress, tension positive
  end type internal

contains

  !> Brings a state over a strain increment. On any status but OK the new state is the old one.
  pure subroutine update(par, old, strain, spin, new, status)
    type(material_parameters), intent(in) :: par
    type(material_state), intent(in) :: old
    real(dp), intent(in) :: strain(6)    ! increment: 11 22 33 and engineering shears 12 13 23
    real(dp), intent(in) :: spin(3)      ! increment of W12 W13 W23, W_ij = (du_i/dx_j - du_j/dx_i)/2
    type(material_state), intent(out) :: new
    integer, intent(out) :: status
    type(increment) :: inc

    new = old
    status = check_state(old)
    if (status == OK .and. .not. (all(ieee_is_finite(strain)) .and. all(ieee_is_finite(spin)))) status = NOT_FINITE
    if (status /= OK .or. maxval(abs([strain, spin])) <= 0) return

    inc = to_increment(strain, spin)
    if (inc%mod_D > 0) then
      call deform(par, old, inc, new, status)
    else
      call turn(old, rotation(spin), new)
    end if
    if (status == OK .and. .not. is_finite(new)) status = RESULT_NOT_FINITE
    if (status /= OK) new = old
  end subroutine update

  pure function to_increment(strain, spin) result(inc)
    real(dp), intent(in) :: strain(6), spin(3)
    type(increment) :: inc
    real(dp) :: D(6)

    D = strain
    D(4:6) = strain(4:6) / 2
    inc%mod_D = modulus(D)
    inc%direction = 0
    if (inc%mod_D > 0) inc%direction = D / inc%mod_D
    inc%S_hat = deviator(inc%direction)
    inc%spin = spin
  end function to_increment

  !> D = 0: everything turns with the body, the stress holds.
  pure subroutine turn(old, R, new)
    type(material_state), intent(in) :: old
    real(dp), intent(in) :: R(3, 3)
    type(material_state), intent(inout) :: new
    new%stress = rotate(R, old%stress)
    new%fabric = rotate(R, old%fabric)
    new%direction = rotate(R, old%direction)
  end subroutine turn

  !> D /= 0: splits the increment where phi crosses phic, and each part into inner steps.
  pure subroutine deform(par, old, inc, new, status)
    type(material_parameters), intent(in) :: par
    type(material_state), intent(in) :: old
    type(increment), intent(in) :: inc
    type(material_state), intent(inout) :: new
    integer, intent(out) :: status
    type(internal) :: x
    real(dp) :: tr_D, e_start, e_end, crossing, factor

    tr_D = inc%mod_D * trace(inc%direction)
    new%volume_fraction = old%volume_fraction * exp(-tr_D)
    status = OK
    if (.not. (new%volume_fraction > 0 .and. new%volume_fraction < 1)) status = BAD_VOLUME_FRACTION
    if (status /= OK) return

    e_start = log(old%volume_fraction / par%phic)
    e_end = e_start - tr_D
    x = internal(old%fabric, old%coordination_number - par%Zc, e_start, deviator(old%stress))
    if (e_start * e_end < 0) then
      crossing = e_start / tr_D
      call integrate(par, inc, crossing, 0.0_dp, x, status)
      if (status == OK) call integrate(par, inc, 1 - crossing, e_end, x, status)
    else
      call integrate(par, inc, 1.0_dp, e_end, x, status)
    end if
    if (status /= OK) return

    factor = pressure_modulus(par, x%A, inc%direction)
    if (factor < 0) status = TENSILE_PRESSURE
    if (.not. is_realisable(x%A)) status = FABRIC_BLOWS_UP
    new%fabric = x%A
    new%coordination_number = par%Zc + x%excess
    new%direction = inc%direction
    new%stress = x%dev - pressure(par, factor, x%excess) * IDENTITY
  end subroutine deform

  !> Inner steps over the given share of the increment; phi stays on one side of phic.
  pure subroutine integrate(par, inc, share, e_end, x, status)
    type(material_parameters), intent(in) :: par
    type(increment), intent(in) :: inc
    real(dp), intent(in) :: share, e_end
    type(internal), intent(inout) :: x
    integer, intent(out) :: status
    real(dp) :: rest, next_rest, rate, e_start
    integer :: step

    status = INCREMENT_TOO_LARGE
    rate = smooth_rate(par, inc, modulus(x%A))
    if (.not. share * rate < STEP_RATE * MAX_STEPS) return
    rest = share
    e_start = x%e
    do step = 1, MAX_STEPS
      if (modulus(x%A) > par%fabric_limit) rate = smooth_rate(par, inc, modulus(x%A))     ! may grow
      next_rest = rest - rest / max(1, ceiling(min(rest * graded_rate(par, inc, x, rate, e_end) / STEP_RATE, real(MAX_STEPS, dp))))
      call inner_step(par, inc, rest - next_rest, e_end + next_rest / share * (e_start - e_end), x, status)
      if (status /= OK .or. next_rest <= 0) return
      rest = next_rest
    end do
    status = INCREMENT_TOO_LARGE
  end subroutine integrate

  !> How fast A, its growth c3 (A:S) A, and Z2 can change, per increment.
  pure function smooth_rate(par, inc, mod_A) result(rate)
    type(material_parameters), intent(in) :: par
    type(increment), intent(in) :: inc
    real(dp), intent(in) :: mod_A
    real(dp) :: rate
    rate = fabric_rate(par, inc%mod_D, inc%spin) + (2 * par%c3 * mod_A + par%d2) * inc%mod_D
  end function smooth_rate

  !> The same where something is not smooth, approached in graded steps: Z2 in phi = phic (the square root is integrated
  !! exactly there, but the nodes crowd); with e_r > 0 also the model stress, in A = 0, Z2 = Zc and phi = phic.
  pure function graded_rate(par, inc, x, smooth, e_end) result(rate)
    type(material_parameters), intent(in) :: par
    type(increment), intent(in) :: inc
    type(internal), intent(in) :: x
    real(dp), intent(in) :: smooth, e_end     ! smooth_rate; ln(phi/phic) at the end of the part
    real(dp) :: rate, volume_rate, e_next, mod_A, near_isotropy, near_jamming

    volume_rate = STEP_RATE * inc%mod_D * trace(inc%direction)
    rate = smooth
    if (x%e > 0 .or. e_end > 0) then
      e_next = min(x%e, max(e_end, x%e - volume_rate / smooth))     ! the smaller at the ends of the next smooth step
      rate = max(rate, min(abs(volume_rate) / max(e_next, SMALL_E), 4 * smooth))
      if (par%elastic_strain > 0) rate = max(rate, 4 * abs(volume_rate) / max(x%e, SMALL_E))
    end if
    if (par%elastic_strain > 0) then
      mod_A = modulus(x%A)
      near_isotropy = 4 * abs(par%c1) / max(mod_A, SMALL_FABRIC)
      near_jamming = (abs(par%d1) * (2 * mod_A - par%chi) + par%d2 * abs(x%excess) + abs(par%d3 * trace(inc%direction))) &
        / max(abs(x%excess), SMALL_EXCESS)
      rate = max(rate, STEP_RATE * inc%mod_D * max(near_isotropy, near_jamming))
    end if
  end function graded_rate

  pure subroutine inner_step(par, inc, share, e_end, x, status)
    type(material_parameters), intent(in) :: par
    type(increment), intent(in) :: inc
    real(dp), intent(in) :: share          ! of the increment
    real(dp), intent(in) :: e_end          ! ln(phi/phic) at the end
    type(internal), intent(inout) :: x
    integer, intent(out) :: status
    type(fabric_solution) :: solution
    real(dp) :: mod_D, w(3), S(6), t(N_NODES), dt(N_NODES), e(N_NODES), A_S(N_NODES), A(6, N_NODES + 1), excess(N_NODES + 1)
    integer :: i

    status = OK
    mod_D = share * inc%mod_D
    S = mod_D * inc%S_hat
    w = share * inc%spin
    call nodes(x%e, e_end, t, dt, e)
    if (par%closure == CRITICAL) then
      A = spread(par%lambda * inc%S_hat, 2, N_NODES + 1)             ! (A 9)
      do i = 1, N_NODES
        excess(i) = excess_coordination(par, e(i))
      end do
      excess(N_NODES + 1) = excess_coordination(par, e_end)
    else
      solution = solve_fabric(par, x%A, S, mod_D, w)
      A(:, N_NODES + 1) = fabric_at(solution, 1.0_dp)
      if (.not. (y_at(solution, 1.0_dp) > 0 .and. modulus(A(:, N_NODES + 1)) < REALISABLE)) then
        status = FABRIC_BLOWS_UP
        return
      end if
      do i = 1, N_NODES
        A_S(i) = projection_at(solution, t(i))
        if (par%elastic_strain > 0) A(:, i) = fabric_at(solution, t(i))
      end do
      call integrate_coordination(par, x%excess, A_S, modulus(S), mod_D, mod_D * trace(inc%direction), t, dt, e, &
        excess(:N_NODES), excess(N_NODES + 1))
    end if
    x%A = A(:, N_NODES + 1)
    x%excess = excess(N_NODES + 1)
    x%e = e_end
    if (par%elastic_strain > 0) then
      call relax(par, inc, mod_D, w, [1 - t, 0.0_dp], A, excess, x%dev)
    else
      x%dev = model_deviator(par, inc, x%A, x%excess)
    end if
  end subroutine inner_step

  !> The deviatoric stress after an inner step with e_r > 0.
  pure subroutine relax(par, inc, mod_D, w, u, A, excess, dev)
    type(material_parameters), intent(in) :: par
    type(increment), intent(in) :: inc
    real(dp), intent(in) :: mod_D, w(3)            ! of the inner step
    real(dp), intent(in) :: u(:)                   ! 1 - t where A and Z2 - Zc are given, 0 last
    real(dp), intent(in) :: A(:, :), excess(:)
    real(dp), intent(inout) :: dev(6)
    real(dp) :: ratio, weights(size(u))
    integer :: i

    ratio = mod_D / par%elastic_strain
    weights = relaxation_weights(ratio, u)
    dev = exp(-ratio) * rotate(rotation(w), dev)
    do i = 1, size(u)
      dev = dev + weights(i) * rotate(rotation(u(i) * w), model_deviator(par, inc, A(:, i), excess(i)))
    end do
  end subroutine relax

  pure function model_deviator(par, inc, A, excess) result(dev)
    type(material_parameters), intent(in) :: par
    type(increment), intent(in) :: inc
    real(dp), intent(in) :: A(6), excess
    real(dp) :: dev(6)
    dev = stress_deviator(par, A, inc%S_hat, pressure(par, pressure_modulus(par, A, inc%direction), excess))
  end function model_deviator

end module granumat_update
