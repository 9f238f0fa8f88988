!> Well-posedness of the law at a state: transverse modulus, and acoustic tensor over all normals (docs/theory.md, section 8).
!!
!! The microstructure A, Z2, phi is frozen (A = lambda S^ of the critical closure is not), D is the state's D^ with |D| = 1,
!! and everything is in units of p. The response C is
!!   e_r = 0: the change of the stress with D;
!!   e_r > 0: the change with D of the rates d sigma'/dt = |D| (sigma'_model - sigma')/e_r (its spin apart) and dp/dt, the latter
!!            of (4.2) with (4.7), (4.8); where friction turns, d sigma'/dt is that of the stress of A, M and Z2.
!! Q(n) takes v to the traction on n when grad v changes by v n: Q_il = n_j C_ijkl n_k, and for e_r > 0 that of the spin,
!! ((n . sigma n) I - sigma + (sigma n) n - n (sigma n))/2. For e_r = 0 the pressure is free (the volume is kept by a bulk stiffness
!! of some 90 p), so v is normal to n and Q is a 2 x 2 matrix.
module granumat_ellipticity
  use, intrinsic :: ieee_arithmetic, only: ieee_quiet_nan, ieee_value
  use granumat_kinds, only: dp, LANES
  use granumat_law, only: coordination_rate, evolving_target, excess_target_slope, fabric_rate, mobilised_share, relaxation_rate
  use granumat_matrices, only: determinant_of => determinant
  use granumat_parameters, only: material_parameters, CRITICAL, friction_turns
  use granumat_state, only: lane_state
  use granumat_stress, only: evaluate, friction, pressure_derivative, pressure_slopes, deviator_slopes, stress_deviator, &
    mobilised_deviator, mobilised_slopes, to_evolving
  use granumat_tensors, only: VOIGT, add_identity, contract, deviator, magnitude, product_matrix, safe_magnitude, times, to_voigt, &
    trace
  implicit none (type, external)
  private
  public :: transverse_modulus, response_of, least_over_normals

  integer, parameter, public :: EIGENVALUE = 1, DETERMINANT = 2   ! of Q: of its symmetric part, the smallest; of Q itself

  integer, parameter :: N_GRID = 300                    ! normals on the hemisphere, 8 degrees apart
  integer, parameter :: N_STARTS = 5                    ! of the local searches: the best of the grid that are not neighbours
  integer, parameter :: N_RING = 8, N_ITERATIONS = 18   ! of a local search: directions around a normal; rings
  integer, parameter :: N_SWEEPS = 5                    ! of Jacobi's method: 3 x 3 matrices are then diagonal to round-off
  real(dp), parameter :: NEIGHBOURS = 0.965_dp          ! cosine of the angle, 15 degrees, within which normals are neighbours
  real(dp), parameter :: FIRST_RADIUS = 0.1_dp          ! of a ring, in radians
  real(dp), parameter :: LAST_RADIUS = 1.0e-6_dp        ! where differences of values are below round-off
  real(dp), parameter :: SHRINK = 0.25_dp               ! of the radius, at most, from one ring to the next
  real(dp), parameter :: LONGEST_STEP = 4               ! of Newton's method, in radii
  real(dp), parameter :: PI = acos(-1.0_dp)
  real(dp), parameter :: GOLDEN_ANGLE = PI * (3 - sqrt(5.0_dp))

  !> The response of the stress to a change of the velocity gradient.
  type, public :: response
    real(dp) :: C(LANES, 6, 6)      ! (:, i, k): stress component i to the k-th strain, engineering shears
    real(dp) :: corotating(LANES, 6)  ! the stress that rotates with the spin; 0 for e_r = 0
    logical :: isochoric            ! whether v is normal to n
  end type response

contains

  !> eta_t = b1 + (b2 + a4/2) x + b3 x^2, x = A : S^ (critical closure: b1 + b2 chi + b3 chi^2).
  !!
  !! A change T of S^ with T : S^ = 0 changes the stress (A 4), tension positive, by
  !!   p eta_t T + p (b2 + 2 b3 x + a4/2) (A : T) S^ - a3 p (A T + T A - (2/3) (A : T) I),
  !! so that T : d sigma = 2 p eta_t |T|^2 but for a3: a negative eta_t is a negative modulus.
  pure function transverse_modulus(par, x) result(eta_t)
    type(material_parameters), intent(in) :: par
    type(lane_state), intent(in) :: x
    real(dp) :: eta_t(LANES), S_hat(LANES, 5), A(LANES, 5)
    S_hat = deviator(x%direction)
    A = deviator(x%fabric)
    eta_t = friction(par, A, S_hat) + par%a4 * contract(A, S_hat) / 2
  end function transverse_modulus

  !> The response of states. NaN where there is none: before any strain, and for e_r > 0 where p = 0.
  pure function response_of(par, x) result(law)
    type(material_parameters), intent(in) :: par
    type(lane_state), intent(in) :: x
    type(response) :: law
    type(lane_state) :: model
    real(dp) :: E(LANES, 6), p(LANES)
    logical :: undefined(LANES)
    integer :: i, k

    model = x
    call evaluate(par, model, p)
    if (friction_turns(par)) model%direction = spread(1 / max(safe_magnitude(x%direction), tiny(p)), 2, 6) * x%direction
    p = -trace(model%stress) / 3
    law%isochoric = .not. par%elastic_strain > 0
    law%corotating = 0
    if (.not. law%isochoric) law%corotating = to_voigt(times(1 / max(p, tiny(p)), deviator(x%stress)))
    undefined = .not. sum(abs(x%direction), 2) > 0 .or. (.not. law%isochoric .and. .not. p > 0)
    do k = 1, 6
      E = 0
      E(:, k) = merge(1.0_dp, 0.5_dp, k <= 3)
      if (friction_turns(par)) then
        law%C(:, :, k) = change_where_friction_turns(par, model, deviator(x%direction), E)
      else
        law%C(:, :, k) = change(par, model, deviator(x%stress), E)
      end if
      do i = 1, 6
        where (undefined) law%C(:, i, k) = ieee_value(1.0_dp, ieee_quiet_nan)
      end do
    end do
  end function response_of

  !> C : E
  pure function change(par, model, dev, E) result(d_stress)
    type(material_parameters), intent(in) :: par
    type(lane_state), intent(in) :: model            ! with the model's stress
    real(dp), intent(in) :: dev(LANES, 5)            ! the state's deviatoric stress
    real(dp), intent(in) :: E(LANES, 6)
    real(dp) :: d_stress(LANES, 6), d_direction(LANES, 6)
    real(dp), dimension(LANES, 5) :: A, S_hat, d_A, d_S_hat, d_dev
    real(dp), dimension(LANES, 5, 5) :: by_A, by_S_hat
    real(dp), dimension(LANES) :: p, d_p, d_mod, one
    type(pressure_derivative) :: by
    integer :: k

    p = -trace(model%stress) / 3
    one = 1
    d_mod = (sum(model%direction(:, :3) * E(:, :3), 2) + 2 * sum(model%direction(:, 4:) * E(:, 4:), 2)) / 2         ! of |D|
    do k = 1, 6
      d_direction(:, k) = E(:, k) - d_mod * model%direction(:, k)
    end do
    A = deviator(model%fabric)
    S_hat = deviator(model%direction)
    d_S_hat = deviator(d_direction)
    d_A = 0
    if (par%closure == CRITICAL) d_A = par%lambda * d_S_hat
    by = pressure_slopes(par, A, trace(model%direction), model%coordination_number - par%Zc)
    d_p = by%trace * trace(d_direction) / max(p, tiny(p))
    call deviator_slopes(par, A, S_hat, product_matrix(S_hat), one, by_A, by_S_hat)
    d_dev = times(d_p, stress_deviator(par, A, S_hat, one))
    do k = 1, 5
      d_dev = d_dev + times(d_A(:, k), by_A(:, :, k)) + times(d_S_hat(:, k), by_S_hat(:, :, k))
    end do
    if (par%elastic_strain > 0) then
      d_dev = (d_dev + times(d_mod / max(p, tiny(p)), deviator(model%stress) - dev)) / par%elastic_strain
      d_p = pressure_rate_change(par, model, S_hat, d_mod, E) / max(p, tiny(p))
    end if
    d_stress = add_identity(to_voigt(d_dev), -d_p)
  end function change

  !> C : E in the closure where friction has a direction M of its own: of the rate of p mobilised_deviator(A, M).
  pure function change_where_friction_turns(par, model, M, E) result(d_stress)
    type(material_parameters), intent(in) :: par
    type(lane_state), intent(in) :: model            ! with the model's stress, and M made a direction of magnitude 1
    real(dp), intent(in) :: M(LANES, 5), E(LANES, 6)
    real(dp) :: d_stress(LANES, 6), by_A(LANES, 5, 5), no_spin(LANES, 3)
    real(dp), dimension(LANES, 5) :: A, d_A, d_dev
    real(dp), dimension(LANES) :: d_mod, d_p, one
    integer :: k

    one = 1
    no_spin = 0
    A = deviator(model%fabric)
    d_mod = (sum(model%direction(:, :3) * E(:, :3), 2) + 2 * sum(model%direction(:, 4:) * E(:, 4:), 2)) / 2         ! of |D|
    d_p = pressure_rate_change(par, model, M, d_mod, E) / max(-trace(model%stress) / 3, tiny(one))
    d_A = fabric_rate(par, A, deviator(E), d_mod, no_spin)
    d_dev = times(d_p, mobilised_deviator(par, A, M)) &
      + par%b1 * relaxation_rate(par, times(d_mod, M), deviator(E), one, no_spin)
    by_A = mobilised_slopes(par, A)
    do k = 1, 5
      d_dev = d_dev + times(d_A(:, k), by_A(:, :, k))
    end do
    d_stress = add_identity(to_voigt(d_dev), -d_p)
  end function change_where_friction_turns

  !> Change of dp/dt when D changes by E, from (4.2), (4.7), (4.8); g's part, a jump of p and not a rate, is left out.
  pure function pressure_rate_change(par, model, M, d_mod, E) result(d_dot_p)
    type(material_parameters), intent(in) :: par
    type(lane_state), intent(in) :: model
    real(dp), intent(in) :: M(LANES, 5), d_mod(LANES), E(LANES, 6)
    real(dp), dimension(LANES) :: d_dot_p, distance, evolving, missing, mod_S, d_mod_S, d_dot_Z2, share
    real(dp), dimension(LANES, 5) :: A, S_hat, d_S, d_dot_A
    real(dp) :: no_spin(LANES, 3)
    type(pressure_derivative) :: by

    distance = model%volume_fraction - par%phic
    A = deviator(model%fabric)
    evolving = to_evolving(par, A, model%coordination_number - par%Zc)
    if (par%closure == CRITICAL) then
      d_dot_A = 0
      d_dot_Z2 = -excess_target_slope(par, distance) * model%volume_fraction * trace(E)
    else
      S_hat = deviator(model%direction)
      d_S = deviator(E)
      no_spin = 0
      d_dot_A = fabric_rate(par, A, d_S, d_mod, no_spin)                 ! the rates are linear in S, |S|, |D| and tr D
      mod_S = magnitude(S_hat)
      d_mod_S = contract(S_hat, d_S) / (2 * max(mod_S, tiny(d_mod)))
      if (friction_turns(par)) then               ! of share |S| = (M : S) |S|/(2 |D|), where that is positive
        share = mobilised_share(contract(M, S_hat))
        d_mod_S = merge(contract(M, d_S) / 2 * mod_S + share * (d_mod_S - mod_S * d_mod), 0.0_dp, share > 0)
      end if
      missing = evolving_target(par, distance) - evolving
      d_dot_Z2 = coordination_rate(par, contract(A, d_S), d_mod_S, d_mod, missing, trace(E))
    end if
    by = pressure_slopes(par, A, trace(model%direction), evolving)
    d_dot_p = by%A * contract(A, d_dot_A) + by%excess * d_dot_Z2
  end function pressure_rate_change

  !> The smallest value of a measure of Q(n) over all normals n, and where: a grid, then local searches from its best.
  pure subroutine least_over_normals(law, kind, least, normal)
    type(response), intent(in) :: law
    integer, intent(in) :: kind                ! EIGENVALUE or DETERMINANT
    real(dp), intent(out) :: least(LANES), normal(LANES, 3)
    real(dp) :: values(LANES, N_GRID), grid(3, N_GRID), value(LANES), n(LANES, 3)
    integer :: i, j, k, best

    do j = 1, N_GRID
      grid(:, j) = grid_normal(j)
      values(:, j) = measure(law, kind, spread(grid(:, j), 1, LANES))
    end do
    least = huge(least)
    normal = 0
    do k = 1, N_STARTS
      do i = 1, LANES
        best = minloc(values(i, :), 1)
        n(i, :) = grid(:, max(best, 1))
        where (abs(matmul(n(i, :), grid)) > NEIGHBOURS) values(i, :) = huge(least)
      end do
      call refine(law, kind, n, value)
      do i = 1, 3
        normal(:, i) = merge(n(:, i), normal(:, i), value < least)
      end do
      least = min(value, least)
    end do
    where (.not. sum(sum(abs(law%C), 3), 2) <= huge(least)) least = ieee_value(1.0_dp, ieee_quiet_nan)
    do i = 1, 3
      where (.not. abs(least) <= huge(least)) normal(:, i) = ieee_value(1.0_dp, ieee_quiet_nan)
    end do
  end subroutine least_over_normals

  !> The j-th of N_GRID normals, evenly spread over a hemisphere on Fibonacci's spiral.
  pure function grid_normal(j) result(n)
    integer, intent(in) :: j
    real(dp) :: n(3), z
    z = (j - 0.5_dp) / N_GRID
    n = [sqrt(1 - z**2) * cos(j * GOLDEN_ANGLE), sqrt(1 - z**2) * sin(j * GOLDEN_ANGLE), z]
  end function grid_normal

  !> The local minimum next to n: Newton's method on the quadratic fitted to a ring around n; the best of all seen is kept.
  pure subroutine refine(law, kind, n, least)
    type(response), intent(in) :: law
    integer, intent(in) :: kind
    real(dp), intent(inout) :: n(LANES, 3)
    real(dp), intent(out) :: least(LANES)
    real(dp), dimension(LANES, 3) :: centre, first, second
    real(dp) :: value(LANES, N_RING), radius(LANES), x(LANES), y(LANES), angle(LANES)
    integer :: iteration, i

    least = measure(law, kind, n)
    radius = FIRST_RADIUS
    do iteration = 1, N_ITERATIONS
      centre = n
      call transverse(centre, first, second)
      do i = 1, N_RING
        angle = 2 * PI * i / N_RING
        value(:, i) = measure(law, kind, moved(centre, first, second, radius * cos(angle), radius * sin(angle)))
      end do
      call newton_step(radius, least, value, x, y)
      angle = 2 * PI * minloc(value, 2) / N_RING
      call prefer(law, kind, moved(centre, first, second, x, y), n, least)
      call prefer(law, kind, moved(centre, first, second, radius * cos(angle), radius * sin(angle)), n, least)
      radius = max(SHRINK * radius, min(LONGEST_STEP * radius, sqrt(sum((n - centre)**2, 2))), LAST_RADIUS)
    end do
  end subroutine refine

  !> Puts a normal in place of n where it is better.
  pure subroutine prefer(law, kind, there, n, least)
    type(response), intent(in) :: law
    real(dp), intent(in) :: there(LANES, 3)
    integer, intent(in) :: kind
    real(dp), intent(inout) :: n(LANES, 3), least(LANES)
    real(dp) :: value(LANES)
    integer :: k

    value = measure(law, kind, there)
    do k = 1, 3
      n(:, k) = merge(there(:, k), n(:, k), value < least)
    end do
    least = merge(value, least, value < least)
  end subroutine prefer

  !> Where the quadratic through the centre and N_RING values on a ring around it is least; 0 where it has no minimum.
  pure subroutine newton_step(radius, centre, ring, x, y)
    real(dp), intent(in) :: radius(LANES), centre(LANES), ring(LANES, N_RING)
    real(dp), intent(out) :: x(LANES), y(LANES)
    real(dp), dimension(LANES) :: mean, slope_x, slope_y, even, odd, xx, yy, xy, determinant, length
    real(dp) :: angle
    integer :: i

    mean = sum(ring, 2) / N_RING - centre               ! Fourier coefficients on the ring
    slope_x = 0
    slope_y = 0
    even = 0
    odd = 0
    do i = 1, N_RING
      angle = 2 * PI * i / N_RING
      slope_x = slope_x + ring(:, i) * cos(angle) * 2 / N_RING
      slope_y = slope_y + ring(:, i) * sin(angle) * 2 / N_RING
      even = even + ring(:, i) * cos(2 * angle) * 2 / N_RING
      odd = odd + ring(:, i) * sin(2 * angle) * 2 / N_RING
    end do
    xx = 2 * (mean + even)                              ! second derivatives, in units of the radius
    yy = 2 * (mean - even)
    xy = 2 * odd
    determinant = xx * yy - xy**2
    x = 0
    y = 0
    where (mean > 0 .and. determinant > 0)
      x = -(yy * slope_x - xy * slope_y) / determinant
      y = -(xx * slope_y - xy * slope_x) / determinant
    end where
    length = sqrt(x**2 + y**2)
    x = x * radius * min(1.0_dp, LONGEST_STEP / max(length, 1.0_dp))
    y = y * radius * min(1.0_dp, LONGEST_STEP / max(length, 1.0_dp))
  end subroutine newton_step

  !> Two unit vectors that make a basis with n (Duff et al. 2017).
  pure subroutine transverse(n, first, second)
    real(dp), intent(in) :: n(LANES, 3)
    real(dp), intent(out) :: first(LANES, 3), second(LANES, 3)
    real(dp) :: s(LANES), a(LANES), b(LANES)

    s = sign(1.0_dp, n(:, 3))
    a = -1 / (s + n(:, 3))
    b = n(:, 1) * n(:, 2) * a
    first(:, 1) = 1 + s * n(:, 1)**2 * a
    first(:, 2) = s * b
    first(:, 3) = -s * n(:, 1)
    second(:, 1) = b
    second(:, 2) = s + n(:, 2)**2 * a
    second(:, 3) = -n(:, 2)
  end subroutine transverse

  !> The unit normal that differs from n by x and y along two vectors normal to it.
  pure function moved(n, first, second, x, y) result(there)
    real(dp), intent(in) :: n(LANES, 3), first(LANES, 3), second(LANES, 3), x(LANES), y(LANES)
    real(dp) :: there(LANES, 3)
    integer :: k
    do k = 1, 3
      there(:, k) = (n(:, k) + x * first(:, k) + y * second(:, k)) / sqrt(1 + x**2 + y**2)
    end do
  end function moved

  !> A measure of the acoustic tensor.
  pure function measure(law, kind, n) result(value)
    type(response), intent(in) :: law
    real(dp), intent(in) :: n(LANES, 3)
    integer, intent(in) :: kind
    real(dp) :: value(LANES), Q(LANES, 3, 3)

    Q = acoustic_tensor(law, n)
    if (law%isochoric) then
      value = isochoric_measure(kind, n, Q)
    else if (kind == DETERMINANT) then
      value = determinant_of(Q)
    else
      value = smallest_eigenvalue(Q)
    end if
  end function measure

  !> Q(n)
  pure function acoustic_tensor(law, n) result(Q)
    type(response), intent(in) :: law
    real(dp), intent(in) :: n(LANES, 3)
    real(dp) :: Q(LANES, 3, 3), column(LANES, 6), t(LANES, 3), t_n(LANES)
    integer :: i, k

    do k = 1, 3
      do i = 1, 6
        column(:, i) = law%C(:, i, VOIGT(1, k)) * n(:, 1) + law%C(:, i, VOIGT(2, k)) * n(:, 2) + law%C(:, i, VOIGT(3, k)) * n(:, 3)
      end do
      Q(:, :, k) = on_plane(column)
    end do
    if (law%isochoric) return
    t = on_plane(law%corotating)
    t_n = sum(t * n, 2)
    do k = 1, 3
      do i = 1, 3
        Q(:, i, k) = Q(:, i, k) + (t(:, i) * n(:, k) - n(:, i) * t(:, k) - law%corotating(:, VOIGT(i, k))) / 2
      end do
      Q(:, k, k) = Q(:, k, k) + t_n / 2
    end do

  contains

    !> T n
    pure function on_plane(T) result(vector)
      real(dp), intent(in) :: T(LANES, 6)
      real(dp) :: vector(LANES, 3)
      integer :: j
      do j = 1, 3
        vector(:, j) = T(:, VOIGT(1, j)) * n(:, 1) + T(:, VOIGT(2, j)) * n(:, 2) + T(:, VOIGT(3, j)) * n(:, 3)
      end do
    end function on_plane

  end function acoustic_tensor

  !> A measure of the 2 x 2 part of Q between vectors normal to n.
  pure function isochoric_measure(kind, n, Q) result(value)
    integer, intent(in) :: kind
    real(dp), intent(in) :: n(LANES, 3), Q(LANES, 3, 3)
    real(dp) :: value(LANES), t(LANES, 3, 2), block(LANES, 2, 2), mean(LANES), deviation(LANES)
    integer :: i, k

    call transverse(n, t(:, :, 1), t(:, :, 2))
    do k = 1, 2
      do i = 1, 2
        block(:, i, k) = (t(:, 1, i) * Q(:, 1, 1) + t(:, 2, i) * Q(:, 2, 1) + t(:, 3, i) * Q(:, 3, 1)) * t(:, 1, k) &
          + (t(:, 1, i) * Q(:, 1, 2) + t(:, 2, i) * Q(:, 2, 2) + t(:, 3, i) * Q(:, 3, 2)) * t(:, 2, k) &
          + (t(:, 1, i) * Q(:, 1, 3) + t(:, 2, i) * Q(:, 2, 3) + t(:, 3, i) * Q(:, 3, 3)) * t(:, 3, k)
      end do
    end do
    if (kind == DETERMINANT) then
      value = block(:, 1, 1) * block(:, 2, 2) - block(:, 1, 2) * block(:, 2, 1)
    else
      mean = (block(:, 1, 1) + block(:, 2, 2)) / 2
      deviation = sqrt((block(:, 1, 1) - block(:, 2, 2))**2 + (block(:, 1, 2) + block(:, 2, 1))**2) / 2
      value = mean - deviation
    end if
  end function isochoric_measure

  !> Of the symmetric part of Q, by Jacobi's method (the cubic's formula loses half the digits of a double eigenvalue).
  pure function smallest_eigenvalue(Q) result(value)
    real(dp), intent(in) :: Q(LANES, 3, 3)
    real(dp) :: value(LANES)
    real(dp), dimension(LANES) :: xx, yy, zz, xy, xz, yz
    integer :: sweep

    xx = Q(:, 1, 1)
    yy = Q(:, 2, 2)
    zz = Q(:, 3, 3)
    xy = (Q(:, 1, 2) + Q(:, 2, 1)) / 2
    xz = (Q(:, 1, 3) + Q(:, 3, 1)) / 2
    yz = (Q(:, 2, 3) + Q(:, 3, 2)) / 2
    do sweep = 1, N_SWEEPS
      call annihilate(xx, yy, xy, xz, yz)
      call annihilate(xx, zz, xz, xy, yz)
      call annihilate(yy, zz, yz, xy, xz)
    end do
    value = min(xx, yy, zz)
  end function smallest_eigenvalue

  !> A plane rotation of a symmetric matrix by which its element pq vanishes; pr and qr are those of the third axis.
  pure subroutine annihilate(pp, qq, pq, pr, qr)
    real(dp), intent(inout), dimension(LANES) :: pp, qq, pq, pr, qr
    real(dp), dimension(LANES) :: half, t, cosine, sine, old_pr

    half = (qq - pp) / 2
    t = pq / (half + sign(max(sqrt(half**2 + pq**2), tiny(half)), half))     ! the tangent
    cosine = 1 / sqrt(1 + t**2)
    sine = t * cosine
    pp = pp - t * pq
    qq = qq + t * pq
    pq = 0
    old_pr = pr
    pr = cosine * old_pr - sine * qr
    qr = sine * old_pr + cosine * qr
  end subroutine annihilate

end module granumat_ellipticity
