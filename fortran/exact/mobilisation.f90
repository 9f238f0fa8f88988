!> The mobilised direction of friction under a constant velocity gradient, solved exactly (docs/theory.md, section 11).
!!
!! M' = W M - M W + |D|/e_r (S^ - M), or with a length m/e_r (S/m - M), is linear with constant coefficients. The Taylor series of
!! its solution, M = sum_k M_k t^k, gives M anywhere in the increment, 0 <= t <= 1.
module granumat_mobilisation
  use granumat_kinds, only: dp, LANES
  use granumat_law, only: mobilised_share, relaxation_rate
  use granumat_parameters, only: material_parameters
  use granumat_quadrature, only: N_NODES, NODE
  use granumat_tensors, only: contract, corotate, rotation_angle, spin_derivative, times
  implicit none (type, external)
  private
  public :: solve_mobilisation, adjoint_mobilisation, direction_at_end, shares_at, share_to_kink

  integer, parameter, public :: MAX_POWER = 20
  real(dp), parameter :: SERIES_TOLERANCE = 1.0e-17_dp   ! bound of the first neglected term: below round-off, as |M| <= 1
  real(dp), parameter :: AT_KINK = 1.0e-7_dp             ! |projection| up to which a substep starts where the one before was cut
  integer, parameter :: BISECTIONS = 24                  ! to 2e-8: the integral over a kink errs by the square of its distance

  !> The coefficients of M.
  type, public :: mobilisation_solution
    real(dp) :: M(LANES, 5, 0:MAX_POWER)
    real(dp) :: factor(LANES, MAX_POWER)       !! 1/k; 0 from the term on that a lane does not need
    integer :: terms
  end type mobilisation_solution

contains

  !> Solves for M over one increment, to round-off for m/e_r and twice the angle of the spin of at most 1 together.
  pure subroutine solve_mobilisation(par, M, S_hat, R, nonlocal, w, solution)
    type(material_parameters), intent(in) :: par
    real(dp), intent(in) :: M(LANES, 5)      ! at t = 0
    real(dp), intent(in) :: S_hat(LANES, 5)
    real(dp), intent(in) :: R(LANES)         ! |D|/m; S/m = R S^
    real(dp), intent(in) :: nonlocal(LANES)  ! m; without a length |D|
    real(dp), intent(in) :: w(LANES, 3)      ! spin increment
    type(mobilisation_solution), intent(out) :: solution
    real(dp) :: rate(LANES), bound(LANES), target(LANES, 5)
    integer :: k

    rate = nonlocal / par%elastic_strain + 2 * rotation_angle(w)
    bound = 1
    target = times(R, S_hat)
    solution%M(:, :, 0) = M
    do k = 1, MAX_POWER
      solution%factor(:, k) = merge(1.0_dp / k, 0.0_dp, bound >= SERIES_TOLERANCE)
      solution%M(:, :, k) = times(solution%factor(:, k), relaxation_rate(par, solution%M(:, :, k - 1), target, nonlocal, w))
      solution%terms = k
      bound = bound * (rate / k)
      if (all(bound < SERIES_TOLERANCE)) exit
      target = 0                             ! S/m is constant: it drives the first term only
    end do
  end subroutine solve_mobilisation

  !> M at t = 1.
  pure function direction_at_end(solution) result(M)
    type(mobilisation_solution), intent(in) :: solution
    real(dp) :: M(LANES, 5)
    integer :: k

    M = solution%M(:, :, solution%terms)
    do k = solution%terms - 1, 0, -1
      M = M + solution%M(:, :, k)
    end do
  end function direction_at_end

  !> The coefficients of (M + S^ - S/m) : S^, of which the mobilised share is half; without a length they are those of M : S^.
  pure function projections_of(solution, S_hat, R) result(projection)
    type(mobilisation_solution), intent(in) :: solution
    real(dp), intent(in) :: S_hat(LANES, 5), R(LANES)
    real(dp) :: projection(LANES, 0:MAX_POWER)
    integer :: k

    projection(:, 0) = contract(solution%M(:, :, 0), S_hat) + (1 - R) * contract(S_hat, S_hat)
    do k = 1, solution%terms
      projection(:, k) = contract(solution%M(:, :, k), S_hat)
    end do
  end function projections_of

  !> The mobilised share at the quadrature nodes, by Horner's scheme.
  pure function shares_at(solution, S_hat, R, t) result(share)
    type(mobilisation_solution), intent(in) :: solution
    real(dp), intent(in) :: S_hat(LANES, 5), R(LANES), t(LANES, N_NODES)
    real(dp) :: share(LANES, N_NODES), projection(LANES, 0:MAX_POWER)
    integer :: i, k

    share = 0
    projection = projections_of(solution, S_hat, R)
    do k = solution%terms, 0, -1
      do i = 1, N_NODES
        share(:, i) = share(:, i) * t(:, i) + projection(:, k)
      end do
    end do
    do i = 1, N_NODES
      share(:, i) = mobilised_share(share(:, i))
    end do
  end function shares_at

  !> The part of a substep up to the first change of sign of the projection, where the mobilised share has a kink; 1 if there is
  !! none.
  pure function share_to_kink(solution, S_hat, R) result(share)
    type(mobilisation_solution), intent(in) :: solution
    real(dp), intent(in) :: S_hat(LANES, 5), R(LANES)
    real(dp), dimension(LANES) :: share, low, middle, start, before, after
    real(dp), parameter :: UNTIL(0:N_NODES + 1) = [0.0_dp, NODE, 1.0_dp]
    real(dp) :: projection(LANES, 0:MAX_POWER)
    logical :: changes(LANES)
    integer :: j, k

    projection = projections_of(solution, S_hat, R)
    low = 1
    share = 1
    start = 0
    after = value_at(projection(:, :solution%terms), share)
    do j = N_NODES, 0, -1
      before = value_at(projection(:, :solution%terms), spread(UNTIL(j), 1, LANES))
      changes = abs(before) > AT_KINK .and. before * after < 0
      low = merge(UNTIL(j), low, changes)
      share = merge(UNTIL(j + 1), share, changes)
      start = merge(before, start, changes)
      after = before
    end do
    if (all(low >= 1)) return
    do k = 1, BISECTIONS
      middle = (low + share) / 2
      changes = start * value_at(projection(:, :solution%terms), middle) <= 0
      low = merge(low, middle, changes)
      share = merge(middle, share, changes)
    end do
  end function share_to_kink

  !> A polynomial by its coefficients.
  pure function value_at(coefficient, t) result(v)
    real(dp), intent(in) :: coefficient(:, 0:)         ! (LANES, terms)
    real(dp), intent(in) :: t(LANES)
    real(dp) :: v(LANES)
    integer :: k

    v = 0
    do k = ubound(coefficient, 2), 0, -1
      v = v * t + coefficient(:, k)
    end do
  end function value_at

  !> The adjoint of the series: derivatives of a sum over k of g_k : M_k by M at the start, S^ (over R), R, m and W.
  !!
  !! The adjoint q of M_k runs backward, q_(k-1) = (-(W q_k - q_k W) - m/e_r q_k)/k + g_(k-1).
  pure subroutine adjoint_mobilisation(par, solution, S_hat, R, nonlocal, w, g, by_M, by_S_hat, by_R, by_nonlocal, by_spin)
    type(material_parameters), intent(in) :: par
    type(mobilisation_solution), intent(in) :: solution
    real(dp), intent(in) :: S_hat(LANES, 5), R(LANES), nonlocal(LANES), w(LANES, 3)
    real(dp), intent(in) :: g(LANES, 5, 0:MAX_POWER)
    real(dp), intent(out) :: by_M(LANES, 5), by_S_hat(LANES, 5), by_R(LANES), by_nonlocal(LANES), by_spin(LANES, 3)
    real(dp) :: ratio(LANES), q(LANES, 5), q_S(LANES)
    integer :: k

    ratio = nonlocal / par%elastic_strain
    by_nonlocal = 0
    by_spin = 0
    by_M = g(:, :, solution%terms)
    do k = solution%terms, 1, -1
      q = times(solution%factor(:, k), by_M)
      by_nonlocal = by_nonlocal - contract(q, solution%M(:, :, k - 1))
      by_spin = by_spin + spin_derivative(q, solution%M(:, :, k - 1))
      by_M = g(:, :, k - 1) - corotate(w, q) - times(ratio, q)
    end do
    q_S = contract(q, S_hat)
    by_nonlocal = (by_nonlocal + R * q_S) / par%elastic_strain
    by_R = ratio * q_S
    by_S_hat = times(ratio, q)
  end subroutine adjoint_mobilisation

end module granumat_mobilisation
