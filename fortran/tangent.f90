!> The consistent tangent of the exact update, in closed form: the stress at the end as a function of what came before, pulled back
!! through the inner steps, the last one first, to the strain and spin of the increment. There are six such functions whatever the
!! number of derivatives: the stress deviator's components and the pressure (adjoint, or reverse, differentiation).
!!
!! S, |S|, tr D, W, |D|, S^ and tr D^ change as if they were independent, until the end.
module granumat_tangent
  use granumat_kinds, only: dp
  use granumat_coordination, only: INTEGRAL, N_NODES, excess_coordination, excess_slope, exponential
  use granumat_fabric, only: MAX_TERMS, pull_fabric
  use granumat_increment, only: AT_END, increment, inner_solution, internal
  use granumat_parameters, only: material_parameters, CRITICAL
  use granumat_relaxation, only: relaxation_weights_slope
  use granumat_stress, only: pressure, pressure_modulus, pressure_change, pressure_slopes, stress_deviator, deviator_slopes
  use granumat_tensors, only: LANES, add_identity, commute, contract, modulus, product_matrix, six, spin_moments, spin_series, &
    times, times_spin, transposed_times
  implicit none (type, external)
  private
  public :: start_pulling, pull_inner_step, tangent_of

  integer, parameter, public :: N_COLUMNS = 9                 ! strains 11 22 33, engineering shears 12 13 23, spins 12 13 23
  integer, parameter, public :: PLANE_COLUMNS(4) = [1, 2, 4, 7]
  integer, parameter, public :: PULLED_IN_SPACE = 6, PULLED_IN_PLANE = 4   ! the deviator's components, or its first 3; pressure
  real(dp), parameter :: TANGENT_REST = 1.0e-9_dp  ! first neglected term of the fabric's change over the first one

  !> What a component of the stress at the end changes by: with what was there before the inner steps that it has been pulled
  !! through, and with the increment.
  type, public :: pulled
    real(dp) :: A(LANES, 5), dev(LANES, 5), excess(LANES), log_phi(LANES)
    real(dp) :: S(LANES, 5), S_hat(LANES, 5), w(LANES, 3)
    real(dp), dimension(LANES) :: mod_S, tr_D, mod_D, tr_direction
  end type pulled

  !> What the functions share in an inner step, at the nodes (only with e_r > 0) and the end: t^k, 1/y, and what Z2 - Zc there
  !! changes by, with the fabric's y_k and with other things.
  type :: shared_factors
    real(dp) :: weight(LANES, 0:MAX_TERMS, AT_END), by_y(LANES, 0:MAX_TERMS, AT_END)
    real(dp), dimension(LANES, AT_END) :: inverse_y, by_excess, by_mod_D, by_mod_S, by_tr_D, by_log_phi
    integer :: first, terms
  end type shared_factors

  !> What a function changes by with A and Z2 - Zc at the nodes and the end.
  type :: met
    real(dp) :: A(LANES, 5, AT_END), excess(LANES, AT_END)
  end type met

contains

  !> The functions at the end of the increment: the last is the pressure, the others components of the deviator.
  pure subroutine start_pulling(par, inc, x, f)
    type(material_parameters), intent(in) :: par
    type(increment), intent(in) :: inc
    type(internal), intent(in) :: x
    type(pulled), intent(out) :: f(:)
    type(pressure_change) :: by
    real(dp) :: one(LANES), p(LANES), unit(LANES, 5), by_A(LANES, 5, 5), by_S_hat(LANES, 5, 5)
    integer :: i, n

    n = size(f)
    by = pressure_slopes(par, x%A, inc%tr_direction, x%excess)
    do i = 1, n
      call clear(f(i))
    end do
    f(n)%A = times(by%A, x%A)
    f(n)%excess = by%excess
    f(n)%tr_direction = by%trace
    if (par%elastic_strain > 0) then
      do i = 1, n - 1
        f(i)%dev(:, i) = 1
      end do
    else
      one = 1
      unit = stress_deviator(par, x%A, inc%S_hat, one)
      p = pressure(par, pressure_modulus(par, x%A, inc%tr_direction), x%excess)
      call deviator_slopes(par, x%A, inc%S_hat, product_matrix(inc%S_hat), p, by_A, by_S_hat)
      do i = 1, n - 1
        f(i)%A = by_A(:, :, i) + times(unit(:, i), f(n)%A)
        f(i)%excess = unit(:, i) * by%excess
        f(i)%tr_direction = unit(:, i) * by%trace
        f(i)%S_hat = by_S_hat(:, i, :)
      end do
    end if
  end subroutine start_pulling

  pure subroutine clear(f)
    type(pulled), intent(out) :: f
    f%A = 0
    f%dev = 0
    f%excess = 0
    f%log_phi = 0
    f%S = 0
    f%S_hat = 0
    f%w = 0
    f%mod_S = 0
    f%tr_D = 0
    f%mod_D = 0
    f%tr_direction = 0
  end subroutine clear

  !> Pulls functions of what an inner step leads to back to what it starts from.
  pure subroutine pull_inner_step(par, inc, step, f)
    type(material_parameters), intent(in) :: par
    type(increment), intent(in) :: inc
    type(inner_solution), intent(in) :: step
    type(pulled), intent(inout) :: f(:)
    type(shared_factors) :: factors
    type(met) :: at(PULLED_IN_SPACE)
    integer :: i, n

    n = size(f)
    do i = 1, n
      at(i)%A(:, :, AT_END) = f(i)%A
      at(i)%excess(:, AT_END) = f(i)%excess
      f(i)%tr_D = f(i)%tr_D - step%share * f(i)%log_phi
    end do
    if (par%elastic_strain > 0) call pull_relaxation(par, inc, step, f(:n - 1), at(:n - 1))
    if (par%closure == CRITICAL) then
      do i = 1, n
        call pull_implied(par, step, merge(1, AT_END, par%elastic_strain > 0 .and. i < n), at(i), f(i))
      end do
    else
      call share_factors(par, step, factors)
      do i = 1, n
        call pull_microstructure(par, step, factors, merge(factors%first, AT_END, i < n), at(i), f(i))
      end do
    end if
  end subroutine pull_inner_step

  pure subroutine share_factors(par, step, factors)
    type(material_parameters), intent(in) :: par
    type(inner_solution), intent(in) :: step
    type(shared_factors), intent(out) :: factors
    real(dp), dimension(LANES, N_NODES) :: f, f_slope, kernel, before
    real(dp), dimension(LANES) :: t, decay, power, needed(LANES, 0:MAX_TERMS)
    real(dp) :: by_y(LANES, N_NODES, 0:MAX_TERMS)        ! of d1 A:S = -d1 y'/(c3 y)
    integer :: i, k, m

    factors%first = merge(1, AT_END, par%elastic_strain > 0)
    factors%terms = count([(any(step%fabric%bound(:, i) >= TANGENT_REST), i = 0, step%fabric%terms - 1)])
    do i = 1, N_NODES
      f(:, i) = excess_coordination(par, step%phi(:, i) - par%phic)
      f_slope(:, i) = par%d2 * step%mod_D * step%phi(:, i) * excess_slope(par, step%phi(:, i) - par%phic)
    end do
    factors%inverse_y(:, :N_NODES) = 1 / step%y
    factors%inverse_y(:, AT_END) = 1 / step%y_end
    before = 1
    needed(:, 0) = 1
    by_y(:, :, 0) = 0
    do k = 1, factors%terms                              ! by the lane, whatever others need
      needed(:, k) = merge(1.0_dp, 0.0_dp, step%fabric%bound(:, k - 1) >= TANGENT_REST)
      do i = 1, N_NODES
        by_y(:, i, k) = -par%d1 * needed(:, k) * before(:, i) * (k / par%c3 + step%t(:, i) * step%A_S(:, i)) &
          * factors%inverse_y(:, i)
        before(:, i) = before(:, i) * step%t(:, i)
      end do
    end do
    do m = factors%first, AT_END
      t = 1
      decay = exponential(-par%d2 * step%mod_D)
      if (m < AT_END) t = step%t(:, m)
      if (m < AT_END) decay = 1 / step%growth(:, m)
      do i = 1, N_NODES
        kernel(:, i) = INTEGRAL(i, m) * step%growth(:, i) * step%dt(:, i) * decay
      end do
      factors%by_excess(:, m) = decay
      factors%by_mod_S(:, m) = 0
      factors%by_mod_D(:, m) = -t * step%excess(:, m)
      factors%by_tr_D(:, m) = 0
      factors%by_log_phi(:, m) = 0
      do i = 1, N_NODES
        factors%by_mod_S(:, m) = factors%by_mod_S(:, m) + kernel(:, i)
        factors%by_mod_D(:, m) = factors%by_mod_D(:, m) + INTEGRAL(i, m) * decay * step%t(:, i) * step%integrand(:, i) &
          + kernel(:, i) * f(:, i)
        factors%by_tr_D(:, m) = factors%by_tr_D(:, m) - kernel(:, i) * f_slope(:, i) * step%t(:, i)
        factors%by_log_phi(:, m) = factors%by_log_phi(:, m) + kernel(:, i) * f_slope(:, i)
      end do
      factors%by_tr_D(:, m) = step%share * (factors%by_tr_D(:, m) + par%d3 * factors%by_mod_S(:, m))
      factors%by_mod_S(:, m) = -par%d1 * par%chi * step%share * factors%by_mod_S(:, m)
      factors%by_mod_D(:, m) = par%d2 * step%share * factors%by_mod_D(:, m)
      power = 1
      do k = 0, factors%terms
        factors%weight(:, k, m) = needed(:, k) * power
        factors%by_y(:, k, m) = kernel(:, 1) * by_y(:, 1, k) + kernel(:, 2) * by_y(:, 2, k) + kernel(:, 3) * by_y(:, 3, k) &
          + kernel(:, 4) * by_y(:, 4, k)
        power = power * t
      end do
    end do
  end subroutine share_factors

  !> To the fabric and Z2 - Zc before the step.
  pure subroutine pull_microstructure(par, step, factors, first, at, f)
    type(material_parameters), intent(in) :: par
    type(inner_solution), intent(in) :: step
    type(shared_factors), intent(in) :: factors
    integer, intent(in) :: first                         ! of the nodes where something is met
    type(met), intent(in) :: at
    type(pulled), intent(inout) :: f
    real(dp) :: g_B(LANES, 5, 0:MAX_TERMS), g_y(LANES, 0:MAX_TERMS), by_B(LANES, 5, AT_END), by_y(LANES, AT_END)
    real(dp) :: by_S(LANES, 5), by_decay(LANES), by_spin(LANES, 3), total, more
    integer :: i, j, k, m

    f%excess = 0
    do m = first, AT_END
      f%excess = f%excess + at%excess(:, m) * factors%by_excess(:, m)
      f%mod_D = f%mod_D + at%excess(:, m) * factors%by_mod_D(:, m)
      f%mod_S = f%mod_S + at%excess(:, m) * factors%by_mod_S(:, m)
      f%tr_D = f%tr_D + at%excess(:, m) * factors%by_tr_D(:, m)
      f%log_phi = f%log_phi + at%excess(:, m) * factors%by_log_phi(:, m)
      by_B(:, :, m) = times(factors%inverse_y(:, m), at%A(:, :, m))
      by_y(:, m) = -contract(by_B(:, :, m), step%A(:, :, m))
    end do
    if (first == AT_END) then
      do k = 0, factors%terms
        g_y(:, k) = factors%weight(:, k, AT_END) * by_y(:, AT_END) + factors%by_y(:, k, AT_END) * at%excess(:, AT_END)
        do j = 1, 5
          g_B(:, j, k) = factors%weight(:, k, AT_END) * by_B(:, j, AT_END)
        end do
      end do
    else
      do k = 0, factors%terms
        do i = 1, LANES
          total = 0
          more = 0
          do m = 1, AT_END
            total = total + factors%weight(i, k, m) * by_y(i, m)
            more = more + factors%by_y(i, k, m) * at%excess(i, m)
          end do
          g_y(i, k) = total + more
          do j = 1, 5
            total = 0
            do m = 1, AT_END
              total = total + factors%weight(i, k, m) * by_B(i, j, m)
            end do
            g_B(i, j, k) = total
          end do
        end do
      end do
    end if
    call pull_fabric(step%fabric, factors%terms, g_B, g_y, f%A, by_S, by_decay, by_spin)
    f%S = f%S + times(step%share, by_S)
    f%mod_D = f%mod_D + par%c2 * step%share * by_decay
    f%w = f%w + times_spin(step%share, by_spin)
  end subroutine pull_microstructure

  !> To what the critical closure implies them from: A = lambda S^, Z2 = f(phi).
  pure subroutine pull_implied(par, step, first, at, f)
    type(material_parameters), intent(in) :: par
    type(inner_solution), intent(in) :: step
    integer, intent(in) :: first
    type(met), intent(in) :: at
    type(pulled), intent(inout) :: f
    real(dp), dimension(LANES) :: t, phi, by_log_phi
    integer :: m

    do m = first, AT_END
      t = 1
      phi = step%phi_end
      if (m < AT_END) t = step%t(:, m)
      if (m < AT_END) phi = step%phi(:, m)
      by_log_phi = at%excess(:, m) * excess_slope(par, phi - par%phic) * phi
      f%log_phi = f%log_phi + by_log_phi
      f%tr_D = f%tr_D - t * step%share * by_log_phi
      f%S_hat = f%S_hat + par%lambda * at%A(:, :, m)
    end do
    f%A = 0
    f%excess = 0
  end subroutine pull_implied

  !> The relaxing deviator: to that before the step, to its rotation and decay, and to the model's at the nodes and the end.
  pure subroutine pull_relaxation(par, inc, step, f, at)
    type(material_parameters), intent(in) :: par
    type(increment), intent(in) :: inc
    type(inner_solution), intent(in) :: step
    type(pulled), intent(inout) :: f(:)                  ! components of the deviator
    type(met), intent(inout) :: at(:)
    real(dp) :: by_mod_D(LANES, 5), turned(LANES, 5, 0:2), twice(LANES, 3), q(LANES, 5), by_p(LANES)
    real(dp), dimension(LANES, 5, 5) :: S_matrix, by_A, by_S_hat
    type(pressure_change) :: by
    integer :: i, m

    call share_rotation(par, step, by_mod_D, turned)
    S_matrix = product_matrix(inc%S_hat)
    do m = 1, AT_END
      by = pressure_slopes(par, step%A(:, :, m), inc%tr_direction, step%excess(:, m))
      call deviator_slopes(par, step%A(:, :, m), inc%S_hat, S_matrix, step%p(:, m), by_A, by_S_hat)
      do i = 1, size(f)
        q = f(i)%dev
        if (m < AT_END) q = transposed_times(step%R(:, :, :, m), q)
        q = times(step%weights(:, m), q)
        by_p = contract(q, step%unit(:, :, m))
        f(i)%tr_direction = f(i)%tr_direction + by_p * by%trace
        f(i)%S_hat = f(i)%S_hat + transposed_times(by_S_hat, q)
        q = transposed_times(by_A, q) + times(by_p * by%A, step%A(:, :, m))
        by_p = by_p * by%excess
        if (m == AT_END) q = q + f(i)%A
        if (m == AT_END) by_p = by_p + f(i)%excess
        at(i)%A(:, :, m) = q
        at(i)%excess(:, m) = by_p
      end do
    end do
    do i = 1, size(f)
      f(i)%mod_D = f(i)%mod_D + contract(f(i)%dev, by_mod_D)
      twice = commute(step%w, spin_moments(f(i)%dev, turned(:, :, 2)))
      f(i)%w = f(i)%w + times_spin(step%share, spin_moments(f(i)%dev, turned(:, :, 0)) &
        + commute(step%w, twice - spin_moments(f(i)%dev, turned(:, :, 1))))
      f(i)%dev = times(step%weights(:, 0), transposed_times(step%R(:, :, :, 0), f(i)%dev))
    end do
  end subroutine pull_relaxation

  !> What the relaxing deviator changes by with |D|; and with the spin: the change V of a rotation by w u is that of w, to which
  !! come commutators with w, once and twice, times u^2 (1 - cos(a))/a^2 and u^3 (a - sin(a))/a^3.
  pure subroutine share_rotation(par, step, by_mod_D, turned)
    type(material_parameters), intent(in) :: par
    type(inner_solution), intent(in) :: step
    real(dp), intent(out) :: by_mod_D(LANES, 5), turned(LANES, 5, 0:2)
    real(dp) :: u(LANES, AT_END), slopes(LANES, AT_END), second(LANES), third(LANES), weight(LANES)
    integer :: m

    u(:, :N_NODES) = 1 - step%t
    u(:, AT_END) = 0
    slopes = relaxation_weights_slope(step%mod_D / par%elastic_strain, u)
    call spin_series(step%w, second, third)
    by_mod_D = -step%turned(:, :, 0)
    turned(:, :, 0) = step%turned(:, :, 0)
    turned(:, :, 1) = times(second, step%turned(:, :, 0))
    turned(:, :, 2) = times(third, step%turned(:, :, 0))
    do m = 1, AT_END
      by_mod_D = by_mod_D + times(slopes(:, m), step%turned(:, :, m))
      call spin_series(times_spin(u(:, m), step%w), second, third)
      weight = step%weights(:, m) * u(:, m)
      turned(:, :, 0) = turned(:, :, 0) + times(weight, step%turned(:, :, m))
      turned(:, :, 1) = turned(:, :, 1) + times(weight * u(:, m) * second, step%turned(:, :, m))
      turned(:, :, 2) = turned(:, :, 2) + times(weight * u(:, m)**2 * third, step%turned(:, :, m))
    end do
    by_mod_D = times(step%share / par%elastic_strain, by_mod_D)
  end subroutine share_rotation

  !> Change of the stress at the end of the increment, tension positive, with the strain and the spin.
  pure subroutine tangent_of(inc, f, tangent)
    type(increment), intent(in) :: inc
    type(pulled), intent(in) :: f(:)                     ! pulled back to the start of the increment
    real(dp), intent(out) :: tangent(LANES, 6, N_COLUMNS)
    real(dp) :: rows(LANES, N_COLUMNS, PULLED_IN_SPACE), strain(LANES, 6)
    real(dp), dimension(LANES) :: inverse, inverse_S, by_mod_D, by_tr_D
    integer :: i, j, n

    n = size(f)
    inverse = 1 / max(inc%mod_D, tiny(1.0_dp))
    inverse_S = 1 / max(2 * modulus(inc%S_hat), tiny(1.0_dp))          ! of |S| over |D|
    rows(:, :, n:) = 0
    do i = 1, n
      by_mod_D = (f(i)%mod_D - inverse * (contract(f(i)%S_hat, inc%S_hat) + f(i)%tr_direction * inc%tr_direction)) / 2
      by_tr_D = f(i)%tr_D + inverse * f(i)%tr_direction
      strain = six(f(i)%S + times(inverse, f(i)%S_hat) + times(inverse_S * f(i)%mod_S, inc%S_hat))
      do j = 1, 6
        strain(:, j) = strain(:, j) + by_mod_D * inc%direction(:, j)
      end do
      do j = 1, 3
        strain(:, j) = strain(:, j) + by_tr_D
      end do
      j = merge(i, PULLED_IN_SPACE, i < n)
      rows(:, :6, j) = strain
      rows(:, 7:, j) = f(i)%w
    end do
    do j = 1, N_COLUMNS
      tangent(:, :, j) = add_identity(six(rows(:, j, :5)), -rows(:, j, 6))
    end do
  end subroutine tangent_of

end module granumat_tangent
