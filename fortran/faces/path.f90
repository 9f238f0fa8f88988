!> A load path at one point: displacement gradient increments, some amplitudes of which are found so that stresses meet targets.
!!
!! An increment without free amplitudes is taken at once. With them, the gradient is constant over substeps of the increment, which
!! are cut until one substep and its two halves agree; the free amplitudes are then piecewise linear in time, which is second order
!! (docs/theory.md, section 9.6).
module granumat_path
  use granumat_kinds, only: dp, LANES
  use granumat_batch, only: update_batch, update_batch_by_method
  use granumat_matrices, only: solve_linear
  use granumat_methods, only: is_exact, scheme, update_by_method
  use granumat_parameters, only: material_parameters, are_valid, CRITICAL
  use granumat_state, only: lane_state, material_state, gather, scatter
  use granumat_status, only: OK, BAD_PARAMETERS, TARGET_NOT_REACHED
  use granumat_tangent, only: N_COLUMNS
  use granumat_tensors, only: strain_and_spin
  use granumat_update, only: update
  implicit none (type, external)
  private
  public :: follow_path

  integer, parameter :: MAX_ITERATIONS = 30, MAX_HALVINGS = 12
  real(dp), parameter :: STRESS_TOLERANCE = 1.0e-10_dp     ! of the largest stress at hand
  real(dp), parameter :: STRESS_FLOOR = 1.0e-9_dp          ! k/d: stresses below it count as zero
  real(dp), parameter :: SMALLEST_STEP = 1.0e-9_dp         ! of an increment, before the target counts as out of reach
  real(dp), parameter :: SAFETY = 0.9_dp, SHRINK = 0.2_dp, GROWTH = 4.0_dp

  !> What is sought in every substep: amplitudes q so that functional(:, k) . stress = target(k) under G + sum_k q_k mode(:, :, k).
  type :: control
    type(material_parameters) :: par
    type(scheme) :: by
    real(dp), allocatable :: mode(:, :, :)       ! (3, 3, m)
    real(dp), allocatable :: columns(:, :)       ! (N_COLUMNS, m): strain and spin of each mode
    real(dp), allocatable :: functional(:, :)    ! (6, m): weights of stress 11 22 33 12 13 23
    integer :: n_adjoints                        ! what the functionals need of the tangent, see update
  end type control

  integer, parameter :: MAX_MODES = 6

  !> A substep tried with amplitudes q(:m).
  type :: trial
    real(dp) :: q(MAX_MODES), residual(MAX_MODES), jacobian(MAX_MODES, MAX_MODES)
    type(material_state) :: state
    integer :: status
  end type trial

contains

  !> Follows n increments; what is computed before a failure stays valid.
  subroutine follow_path(par, by, start, gradient, mode, functional, target, tolerance, states, amplitude, done, status)
    type(material_parameters), intent(in) :: par
    type(scheme), intent(in) :: by
    type(material_state), intent(in) :: start
    real(dp), intent(in) :: gradient(:, :, :)      ! (3, 3, n): (j, i) = du_i/dx_j of each increment
    real(dp), intent(in) :: mode(:, :, :)          ! (3, 3, m), m <= MAX_MODES
    real(dp), intent(in) :: functional(:, :)       ! (6, m)
    real(dp), intent(in) :: target(:, 0:)          ! (m, 0:n): at the start and after each increment, linear between
    real(dp), intent(in) :: tolerance              ! on what evolves, see distance, in every substep
    type(material_state), intent(out) :: states(:) ! (n): after each increment
    real(dp), intent(out) :: amplitude(:, :)       ! (m, n): found in each increment
    integer, intent(out) :: done, status           ! increments done; OK or why there are fewer than n
    type(control) :: law
    type(material_state) :: state
    real(dp) :: step, rates(size(mode, 3))
    integer :: i, point_status(1)

    law = control(par, by, mode, columns_of(mode), functional, adjoints_for(functional))
    state = start
    step = 1
    rates = 0
    done = 0
    status = OK
    if (.not. are_valid(par)) status = BAD_PARAMETERS
    if (status /= OK) return
    do i = 1, size(gradient, 3)
      if (size(mode, 3) == 0) then
        if (is_exact(by)) then
          call update_batch(par, [state], gradient(:, :, i:i), 1, states(i:i), point_status)
        else
          call update_batch_by_method(par, by, [state], gradient(:, :, i:i), 1, states(i:i), point_status)
        end if
        status = point_status(1)
      else
        call controlled_increment(law, state, gradient(:, :, i), target(:, i - 1), target(:, i), tolerance, &
          step, rates, states(i), amplitude(:, i), status)
      end if
      if (status /= OK) return
      state = states(i)
      done = i
    end do
  end subroutine follow_path

  !> How many adjoints functionals need: those of the pressure and of the deviator's components up to the last with a weight.
  pure function adjoints_for(functional) result(n_adjoints)
    real(dp), intent(in) :: functional(:, :)
    integer :: n_adjoints
    real(dp) :: weights(5, size(functional, 2))
    weights(1, :) = functional(1, :) - functional(2, :)
    weights(2, :) = 2 * functional(3, :) - functional(1, :) - functional(2, :)
    weights(3:, :) = functional(4:, :)
    n_adjoints = 1 + findloc(any(abs(weights) > 0, 2), .true., 1, back=.true.)
  end function adjoints_for

  !> Strains and spins of modes.
  pure function columns_of(mode) result(columns)
    real(dp), intent(in) :: mode(:, :, :)
    real(dp) :: columns(N_COLUMNS, size(mode, 3)), strain(LANES, 6), spin(LANES, 3)
    integer :: k

    do k = 1, size(mode, 3)
      call strain_and_spin(mode(:, :, k:k), strain, spin)
      columns(:, k) = [strain(1, :), spin(1, :)]
    end do
  end function columns_of

  !> One increment in as many substeps as the tolerance asks for.
  pure subroutine controlled_increment(law, old, G, target_start, target_end, tolerance, step, rates, new, amplitude, status)
    type(control), intent(in) :: law
    type(material_state), intent(in) :: old
    real(dp), intent(in) :: G(3, 3), target_start(:), target_end(:), tolerance
    real(dp), intent(inout) :: step, rates(:)       ! substep, amplitudes per increment: kept as the next first guess
    type(material_state), intent(out) :: new
    real(dp), intent(out) :: amplitude(:)
    integer, intent(out) :: status
    type(material_state) :: state, whole, middle
    real(dp) :: t, t_end, error, rates_middle(size(rates)), rates_end(size(rates))

    state = old
    amplitude = 0
    t = 0
    do while (t < 1)
      t_end = min(1.0_dp, t + step)
      if (1 - t_end < step / 100) t_end = 1
      step = t_end - t
      rates_end = rates
      call solve_step(law, state, step, G, at(t_end), rates_end, whole, status)
      rates_middle = rates_end
      if (status == OK) call solve_step(law, state, step / 2, G, at(t + step / 2), rates_middle, middle, status)
      rates_end = 2 * rates_end - rates_middle           ! those of the whole are about the mean of the halves'
      if (status == OK) call solve_step(law, middle, step / 2, G, at(t_end), rates_end, new, status)
      if (status /= OK) then
        if (step < SMALLEST_STEP) return
        step = step / 4
        cycle
      end if
      error = distance(law%par, whole, new) / 3          ! second order: the halves err by a third of the difference
      if (error <= tolerance) then
        state = new
        amplitude = amplitude + step / 2 * (rates_middle + rates_end)
        rates = rates_end
        t = t_end
      end if
      step = step * min(GROWTH, max(SHRINK, SAFETY * (tolerance / max(error, tiny(error)))**(1.0_dp / 3)))
    end do
    step = min(step, 1.0_dp)

  contains

    pure function at(time) result(target)
      real(dp), intent(in) :: time
      real(dp) :: target(size(target_end))
      target = target_start + time * (target_end - target_start)
    end function at

  end subroutine controlled_increment

  !> The largest difference of states in what evolves: phi, fabric/kappa and Z2; in the critical-state closure, where A and Z2
  !! follow from D^ and phi, phi and, with e_r > 0, the stress over its largest component.
  pure function distance(par, x, y) result(difference)
    type(material_parameters), intent(in) :: par
    type(material_state), intent(in) :: x, y
    real(dp) :: difference

    difference = abs(x%volume_fraction - y%volume_fraction)
    if (par%closure /= CRITICAL) then
      difference = max(difference, maxval(abs(x%fabric - y%fabric)) / par%kappa, &
        abs(x%coordination_number - y%coordination_number))
    else if (par%elastic_strain > 0) then
      difference = max(difference, maxval(abs(x%stress - y%stress)) / max(maxval(abs(y%stress)), STRESS_FLOOR))
    end if
  end function distance

  !> Newton's method with line search for the amplitudes of one substep, given and found as rates per increment.
  pure subroutine solve_step(law, old, step, G, target, rates, new, status)
    type(control), intent(in) :: law
    type(material_state), intent(in) :: old
    real(dp), intent(in) :: step, G(3, 3), target(:)
    real(dp), intent(inout) :: rates(:)
    type(material_state), intent(out) :: new
    integer, intent(out) :: status
    type(trial) :: now, next
    real(dp) :: change(LANES, size(rates)), determinant_sign(LANES), scale, length
    integer :: iteration, halving, m

    m = size(rates)
    scale = max(maxval(abs(target)), maxval(abs(old%stress)), STRESS_FLOOR)
    call try(law, old, step, G, target, step * rates, now)
    if (now%status /= OK) call try(law, old, step, G, target, 0 * rates, now)     ! the guess failed: start from zero
    do iteration = 1, MAX_ITERATIONS
      status = now%status
      if (status /= OK) return
      if (maxval(abs(now%residual(:m))) <= STRESS_TOLERANCE * scale) then
        rates = now%q(:m) / step
        new = now%state
        return
      end if
      change = -spread(now%residual(:m), 1, LANES)
      call solve_linear(spread(now%jacobian(:m, :m), 1, LANES), change, determinant_sign)
      if (.not. abs(determinant_sign(1)) > 0) exit
      length = 1
      do halving = 1, MAX_HALVINGS
        call try(law, old, step, G, target, now%q(:m) + length * change(1, :), next)
        if (next%status == OK .and. maxval(abs(next%residual(:m))) < maxval(abs(now%residual(:m)))) exit
        length = length / 2
      end do
      if (halving > MAX_HALVINGS) exit
      now = next
    end do
    status = TARGET_NOT_REACHED
  end subroutine solve_step

  !> A substep with amplitudes q: its residual and, from the consistent tangent of the exact update, its Jacobian.
  pure subroutine try(law, old, step, G, target, q, found)
    type(control), intent(in) :: law
    type(material_state), intent(in) :: old
    real(dp), intent(in) :: step, G(3, 3), target(:), q(:)
    type(trial), intent(out) :: found
    type(lane_state) :: x, x_new
    type(material_state) :: state(1)
    real(dp) :: total(3, 3, 1), strain(LANES, 6), spin(LANES, 3), tangent(LANES, 6, N_COLUMNS)
    integer :: status(LANES), k, m

    m = size(q)
    total(:, :, 1) = step * G
    do k = 1, m
      total(:, :, 1) = total(:, :, 1) + q(k) * law%mode(:, :, k)
    end do
    call gather([old], x)
    call strain_and_spin(total, strain, spin)
    call update(law%par, x, strain, spin, x_new, status, law%n_adjoints, tangent)
    if (.not. is_exact(law%by)) call update_by_method(law%par, law%by, x, strain, spin, x_new, status)
    call scatter(x_new, state)
    found%q(:m) = q
    found%status = status(1)
    found%state = state(1)
    found%residual(:m) = matmul(state(1)%stress, law%functional) - target
    do k = 1, m
      found%jacobian(:m, k) = matmul(matmul(tangent(1, :, :), law%columns(:, k)), law%functional)
    end do
  end subroutine try

end module granumat_path
