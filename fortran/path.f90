!> A path at one point: displacement gradient increments, some amplitudes of which are found so that stresses follow targets.
!!
!! An increment without free amplitudes is exact and taken at once. With them, the gradient is constant over inner steps that
!! are cut until one step and its two halves agree (the free amplitudes are then piecewise linear: second order).
module granumat_path
  use granumat_batch, only: update_batch
  use granumat_kinds, only: dp
  use granumat_parameters, only: material_parameters, are_valid
  use granumat_state, only: lane_state, material_state, gather, scatter
  use granumat_status, only: OK, BAD_PARAMETERS, TARGET_NOT_REACHED
  use granumat_tangent, only: N_COLUMNS
  use granumat_tensors, only: LANES, strain_and_spin
  use granumat_update, only: update
  implicit none (type, external)
  private
  public :: follow_path

  integer, parameter :: MAX_ITERATIONS = 30, MAX_HALVINGS = 12
  real(dp), parameter :: STRESS_TOLERANCE = 1.0e-10_dp     ! of the largest stress at hand
  real(dp), parameter :: STRESS_FLOOR = 1.0e-9_dp          ! k/d: below it a granular solid is at rest for every purpose
  real(dp), parameter :: SMALLEST_STEP = 1.0e-9_dp         ! of an increment, before the target counts as out of reach
  real(dp), parameter :: SAFETY = 0.9_dp, SHRINK = 0.2_dp, GROWTH = 4.0_dp

  !> What is sought in every step: amplitudes q so that functional(:, k) . stress = target(k) under G + sum_k q_k mode(:, :, k).
  type :: control
    type(material_parameters) :: par
    real(dp), allocatable :: mode(:, :, :)       ! (3, 3, m)
    real(dp), allocatable :: columns(:, :)       ! (N_COLUMNS, m): strain and spin of each mode
    real(dp), allocatable :: functional(:, :)    ! (6, m): weights of stress 11 22 33 12 13 23
    integer :: n_pulled                          ! what the functionals need of the tangent, see update
  end type control

  integer, parameter :: MAX_MODES = 6

  !> A step tried with amplitudes q(:m).
  type :: trial
    real(dp) :: q(MAX_MODES), residual(MAX_MODES), jacobian(MAX_MODES, MAX_MODES)
    type(material_state) :: state
    integer :: status
  end type trial

contains

  !> Follows n increments; what is computed before a failure stays valid.
  subroutine follow_path(par, start, gradient, mode, functional, target, tolerance, states, amplitude, done, status)
    type(material_parameters), intent(in) :: par
    type(material_state), intent(in) :: start
    real(dp), intent(in) :: gradient(:, :, :)      ! (3, 3, n): (j, i) = du_i/dx_j of each increment
    real(dp), intent(in) :: mode(:, :, :)          ! (3, 3, m), m <= MAX_MODES
    real(dp), intent(in) :: functional(:, :)       ! (6, m)
    real(dp), intent(in) :: target(:, 0:)          ! (m, 0:n): at the start and after each increment, linear between
    real(dp), intent(in) :: tolerance              ! on fabric/kappa, Z2 and phi in every inner step
    type(material_state), intent(out) :: states(:) ! (n): after each increment
    real(dp), intent(out) :: amplitude(:, :)       ! (m, n): found in each increment
    integer, intent(out) :: done, status           ! increments done; OK or why there are fewer than n
    type(control) :: law
    type(material_state) :: state
    real(dp) :: step, rates(size(mode, 3))
    integer :: i, point_status(1)

    law = control(par, mode, columns_of(mode), functional, pulled_for(functional))
    state = start
    step = 1
    rates = 0
    done = 0
    status = OK
    if (.not. are_valid(par)) status = BAD_PARAMETERS
    if (status /= OK) return
    do i = 1, size(gradient, 3)
      if (size(mode, 3) == 0) then
        call update_batch(par, [state], gradient(:, :, i:i), 1, states(i:i), point_status)
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

  !> The pressure, and the components of the deviator up to the last that has a weight.
  pure function pulled_for(functional) result(n_pulled)
    real(dp), intent(in) :: functional(:, :)
    integer :: n_pulled
    real(dp) :: weights(5, size(functional, 2))
    weights(1, :) = functional(1, :) - functional(2, :)
    weights(2, :) = 2 * functional(3, :) - functional(1, :) - functional(2, :)
    weights(3:, :) = functional(4:, :)
    n_pulled = 1 + findloc(any(abs(weights) > 0, 2), .true., 1, back=.true.)
  end function pulled_for

  pure function columns_of(mode) result(columns)
    real(dp), intent(in) :: mode(:, :, :)
    real(dp) :: columns(N_COLUMNS, size(mode, 3)), strain(LANES, 6), spin(LANES, 3)
    integer :: k

    do k = 1, size(mode, 3)
      call strain_and_spin(mode(:, :, k:k), strain, spin)
      columns(:, k) = [strain(1, :), spin(1, :)]
    end do
  end function columns_of

  !> One increment in as many inner steps as the tolerance asks for.
  pure subroutine controlled_increment(law, old, G, target_start, target_end, tolerance, step, rates, new, amplitude, status)
    type(control), intent(in) :: law
    type(material_state), intent(in) :: old
    real(dp), intent(in) :: G(3, 3), target_start(:), target_end(:), tolerance
    real(dp), intent(inout) :: step, rates(:)       ! inner step and amplitudes per increment: kept as the next first guess
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

  pure function distance(par, x, y) result(difference)
    type(material_parameters), intent(in) :: par
    type(material_state), intent(in) :: x, y
    real(dp) :: difference
    difference = max(maxval(abs(x%fabric - y%fabric)) / par%kappa, &
      abs(x%coordination_number - y%coordination_number), abs(x%volume_fraction - y%volume_fraction))
  end function distance

  !> Newton's method with line search for the amplitudes of one step, given and found as rates per increment.
  pure subroutine solve_step(law, old, step, G, target, rates, new, status)
    type(control), intent(in) :: law
    type(material_state), intent(in) :: old
    real(dp), intent(in) :: step, G(3, 3), target(:)
    real(dp), intent(inout) :: rates(:)
    type(material_state), intent(out) :: new
    integer, intent(out) :: status
    type(trial) :: now, next
    real(dp) :: change(size(rates)), scale, length
    integer :: iteration, halving, m
    logical :: regular

    m = size(rates)
    scale = max(maxval(abs(target)), maxval(abs(old%stress)), STRESS_FLOOR)
    call try(law, old, step, G, target, step * rates, now)
    if (now%status /= OK) call try(law, old, step, G, target, 0 * rates, now)     ! the guess leads astray: start from none
    do iteration = 1, MAX_ITERATIONS
      status = now%status
      if (status /= OK) return
      if (maxval(abs(now%residual(:m))) <= STRESS_TOLERANCE * scale) then
        rates = now%q(:m) / step
        new = now%state
        return
      end if
      change = -now%residual(:m)
      call solve_linear(now%jacobian(:m, :m), change, regular)
      if (.not. regular) exit
      length = 1
      do halving = 1, MAX_HALVINGS
        call try(law, old, step, G, target, now%q(:m) + length * change, next)
        if (next%status == OK .and. maxval(abs(next%residual(:m))) < maxval(abs(now%residual(:m)))) exit
        length = length / 2
      end do
      if (halving > MAX_HALVINGS) exit
      now = next
    end do
    status = TARGET_NOT_REACHED
  end subroutine solve_step

  !> A step with amplitudes q: residual and, from the consistent tangent, Jacobian.
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
    call update(law%par, x, strain, spin, x_new, status, law%n_pulled, tangent)
    call scatter(x_new, state)
    found%q(:m) = q
    found%status = status(1)
    found%state = state(1)
    found%residual(:m) = matmul(state(1)%stress, law%functional) - target
    do k = 1, m
      found%jacobian(:m, k) = matmul(matmul(tangent(1, :, :), law%columns(:, k)), law%functional)
    end do
  end subroutine try

  !> Gaussian elimination with row pivoting; the solution replaces b.
  pure subroutine solve_linear(matrix, b, regular)
    real(dp), intent(inout) :: matrix(:, :), b(:)
    logical, intent(out) :: regular
    real(dp) :: factor
    integer :: i, k, pivot, n

    n = size(b)
    regular = .false.
    do k = 1, n
      pivot = k - 1 + maxloc(abs(matrix(k:, k)), 1)
      if (.not. abs(matrix(pivot, k)) > 0) return
      matrix([k, pivot], :) = matrix([pivot, k], :)
      b([k, pivot]) = b([pivot, k])
      do i = k + 1, n
        factor = matrix(i, k) / matrix(k, k)
        matrix(i, k:) = matrix(i, k:) - factor * matrix(k, k:)
        b(i) = b(i) - factor * b(k)
      end do
    end do
    do k = n, 1, -1
      b(k) = (b(k) - dot_product(matrix(k, k + 1:), b(k + 1:))) / matrix(k, k)
    end do
    regular = .true.
  end subroutine solve_linear

end module granumat_path
