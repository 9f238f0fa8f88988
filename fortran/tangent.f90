!> The consistent tangent of the exact update, in closed form: changes of the state with changes of the increment (seeds: strain
!! and spin components, or combinations of them) follow it through the inner steps.
!!
!! S, tr D, W and |D| change as if they were independent: a seed's changes of the first three are the same in all lanes and mostly
!! zero; the change with |D| is common to all seeds, each takes its share of it at the end.
module granumat_tangent
  use granumat_kinds, only: dp
  use granumat_coordination, only: INTEGRAL, N_NODES, excess_coordination, excess_slope, exponential
  use granumat_fabric, only: MAX_TERMS, sum_series, vary_fabric
  use granumat_increment, only: increment, inner_solution, internal
  use granumat_parameters, only: material_parameters, CRITICAL
  use granumat_relaxation, only: relaxation_weights, relaxation_weights_slope
  use granumat_stress, only: pressure, pressure_modulus, pressure_change, pressure_slopes, stress_deviator, change_stress_deviator
  use granumat_tensors, only: LANES, contract, corotate, modulus, rotate, rotation_change, small_rotation, times, times_spin, &
    trace
  implicit none (type, external)
  private
  public :: basis, by_components, start_variations, vary_inner_step, stress_changes

  integer, parameter, public :: N_SEEDS = 9    ! 11 22 33, engineering shears 12 13 23, spins 12 13 23
  integer, parameter, public :: PLANE_SEEDS(4) = [1, 2, 4, 7]
  integer, parameter :: AT_END = N_NODES + 1   ! behind the nodes of an inner step
  real(dp), parameter :: TANGENT_REST = 1.0e-10_dp  ! first neglected term of the fabric's change over the first one

  !> Changes with one seed, or with |D|: of the whole increment, then of what has evolved so far.
  type, public :: variation
    real(dp) :: S(6), w(3), tr_D, mod_D
    logical :: reaches_fabric
    real(dp) :: S_hat(LANES, 6), mod_S(LANES), trace_direction(LANES)
    real(dp) :: A(LANES, 6), dev(LANES, 6), excess(LANES), log_phi(LANES)
  end type variation

  !> What the changes of an inner step share, at the nodes (only with e_r > 0) and the end: t^k/k!, 1/y, and what a change of Z2 is
  !! made of, by those of the fabric's y_k and of other things.
  type :: shared_factors
    integer :: first, terms
    real(dp) :: weight(LANES, 0:MAX_TERMS, AT_END), by_y(LANES, 0:MAX_TERMS, AT_END)
    real(dp), dimension(LANES, AT_END) :: inverse_y, by_excess, by_mod_D, by_mod_S, by_tr_D, by_log_phi
  end type shared_factors

  !> And what those of a relaxing deviator share: at the start (0), the nodes and the end.
  type :: relaxation_factors
    real(dp), dimension(LANES, AT_END) :: weights, slopes, p
    real(dp) :: decay(LANES), w(LANES, 3, 0:AT_END), R(LANES, 3, 3, 0:AT_END)
    real(dp) :: unit(LANES, 6, AT_END), turned(LANES, 6, 0:AT_END)
    type(pressure_change) :: by(AT_END)
  end type relaxation_factors

contains

  !> The seeds of all changes: of the strain two without volume and one without shape, for the fabric sees no volume; or those
  !! that plane strain has.
  pure function basis(n) result(seeds)
    integer, intent(in) :: n                             ! 6: strains, N_SEEDS: and spins; 3: strains 11 22 12, 4: and spin 12
    real(dp) :: seeds(N_SEEDS, n)
    integer :: j

    seeds = 0
    if (n < 6) then
      do j = 1, n
        seeds(PLANE_SEEDS(j), j) = 1
      end do
      return
    end if
    do j = 4, n
      seeds(j, j) = 1
    end do
    seeds(:3, 1) = [1, -1, 0]
    seeds(:3, 2) = [0, 1, -1]
    seeds(:3, 3) = 1.0_dp / 3
  end function basis

  !> From changes with the basis to changes with the components.
  pure subroutine by_components(tangent)
    real(dp), intent(inout) :: tangent(:, :, :)          ! (LANES, 6, n)
    real(dp), dimension(LANES) :: first, second, volume
    integer :: k

    if (size(tangent, 3) < 6) return
    do k = 1, 6
      first = tangent(:, k, 1)
      second = tangent(:, k, 2)
      volume = tangent(:, k, 3)
      tangent(:, k, 1) = volume + (2 * first + second) / 3
      tangent(:, k, 2) = volume + (second - first) / 3
      tangent(:, k, 3) = volume - (first + 2 * second) / 3
    end do
  end subroutine by_components

  !> Changes of the increment with each seed: a change of the strains (engineering shears) and of the spins; the last, with |D|.
  pure subroutine start_variations(inc, seeds, change)
    type(increment), intent(in) :: inc
    real(dp), intent(in) :: seeds(:, :)                  ! (N_SEEDS, n)
    type(variation), intent(out) :: change(:)            ! (n + 1)
    real(dp), dimension(LANES) :: inverse, inverse_S, trace_direction
    integer :: j, k

    inverse = 1 / max(inc%mod_D, tiny(1.0_dp))
    inverse_S = 1 / max(2 * modulus(inc%S_hat), tiny(1.0_dp))          ! of |S| over |D|
    trace_direction = trace(inc%direction)
    do j = 1, size(change)
      associate (c => change(j))
        c%S = 0
        c%w = 0
        c%tr_D = 0
        c%mod_D = merge(1, 0, j > size(seeds, 2))
        if (j <= size(seeds, 2)) then
          c%tr_D = sum(seeds(:3, j))
          c%S = [seeds(:3, j) - c%tr_D / 3, seeds(4:6, j) / 2]
          c%w = seeds(7:, j)
        end if
        c%reaches_fabric = c%mod_D > 0 .or. any(abs(c%S) > 0) .or. any(abs(c%w) > 0)
        c%mod_S = inverse_S * project(inc%S_hat, c%S)
        do k = 1, 6
          c%S_hat(:, k) = inverse * (c%S(k) - c%mod_D * inc%S_hat(:, k))
        end do
        c%trace_direction = inverse * (c%tr_D - c%mod_D * trace_direction)
        c%A = 0
        c%dev = 0
        c%excess = 0
        c%log_phi = 0
      end associate
    end do
  end subroutine start_variations

  !> T : S with an S that is the same in all lanes.
  pure function project(T, S) result(p)
    real(dp), intent(in) :: T(LANES, 6), S(6)
    real(dp) :: p(LANES)
    p = T(:, 1) * S(1) + T(:, 2) * S(2) + T(:, 3) * S(3) + 2 * (T(:, 4) * S(4) + T(:, 5) * S(5) + T(:, 6) * S(6))
  end function project

  !> Carries the changes over an inner step.
  pure subroutine vary_inner_step(par, inc, dev, step, change)
    type(material_parameters), intent(in) :: par
    type(increment), intent(in) :: inc
    real(dp), intent(in) :: dev(LANES, 6)                ! deviatoric stress before the step
    type(inner_solution), intent(in) :: step
    type(variation), intent(inout) :: change(:)
    type(shared_factors) :: factors
    type(relaxation_factors) :: relaxation
    real(dp) :: d_A(LANES, 6, N_NODES), d_excess(LANES, N_NODES)
    integer :: j

    if (par%closure /= CRITICAL) call share_factors(par, step, factors)
    if (par%elastic_strain > 0) call share_relaxation(par, inc, dev, step, relaxation)
    do j = 1, size(change)
      if (par%closure == CRITICAL) then
        call vary_implied(par, step, change(j), d_A, d_excess)
      else
        call vary_microstructure(par, step, factors, change(j), d_A, d_excess)
      end if
      change(j)%log_phi = change(j)%log_phi - step%share * change(j)%tr_D
      if (par%elastic_strain > 0) call vary_relaxation(par, inc, step, relaxation, d_A, d_excess, change(j))
    end do
  end subroutine vary_inner_step

  pure subroutine share_factors(par, step, factors)
    type(material_parameters), intent(in) :: par
    type(inner_solution), intent(in) :: step
    type(shared_factors), intent(out) :: factors
    real(dp), dimension(LANES, N_NODES) :: f, f_slope, kernel
    real(dp), dimension(LANES) :: t, decay
    integer :: i, m

    factors%first = merge(1, AT_END, par%elastic_strain > 0)
    factors%terms = count([(any(step%fabric%bound(:, i) >= TANGENT_REST), i = 0, step%fabric%terms - 1)])
    do i = 1, N_NODES
      f(:, i) = excess_coordination(par, step%phi(:, i) - par%phic)
      f_slope(:, i) = par%d2 * step%mod_D * step%phi(:, i) * excess_slope(par, step%phi(:, i) - par%phic)
    end do
    do m = factors%first, AT_END
      t = 1
      decay = exponential(-par%d2 * step%mod_D)
      if (m < AT_END) t = step%t(:, m)
      if (m < AT_END) decay = 1 / step%growth(:, m)
      do i = 1, N_NODES
        kernel(:, i) = INTEGRAL(i, m) * step%growth(:, i) * step%dt(:, i) * decay
      end do
      if (m < AT_END) factors%inverse_y(:, m) = 1 / step%y(:, m)
      if (m == AT_END) factors%inverse_y(:, m) = 1 / step%y_end
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
      call weigh_series(par, step, t, kernel, factors%terms, factors%weight(:, :, m), factors%by_y(:, :, m))
    end do
  end subroutine share_factors

  !> t^k/k!, and what the integral of kernel d1 A:S, A:S = -y'/(c3 y), changes by with each y_k.
  pure subroutine weigh_series(par, step, t, kernel, terms, weight, by_y)
    type(material_parameters), intent(in) :: par
    type(inner_solution), intent(in) :: step
    real(dp), intent(in) :: t(LANES), kernel(LANES, N_NODES)
    integer, intent(in) :: terms
    real(dp), intent(out) :: weight(LANES, 0:MAX_TERMS), by_y(LANES, 0:MAX_TERMS)
    real(dp), dimension(LANES, N_NODES) :: before, by_dot_y, by_place
    real(dp), dimension(LANES) :: power, next, needed, total
    integer :: i, k

    do i = 1, N_NODES
      by_dot_y(:, i) = -par%d1 / par%c3 * kernel(:, i) / step%y(:, i)
      by_place(:, i) = par%c3 * step%A_S(:, i) * by_dot_y(:, i)
    end do
    power = 1
    before = 1
    weight(:, 0) = 1
    by_y(:, 0) = 0
    do k = 1, terms
      needed = merge(1.0_dp, 0.0_dp, step%fabric%bound(:, k - 1) >= TANGENT_REST)     ! by the lane, whatever others need
      total = 0
      do i = 1, N_NODES
        next = before(:, i) * step%t(:, i) * (1.0_dp / k)
        total = total + by_dot_y(:, i) * before(:, i) + by_place(:, i) * next
        before(:, i) = next
      end do
      by_y(:, k) = needed * total
      power = power * t * (1.0_dp / k)
      weight(:, k) = needed * power
    end do
  end subroutine weigh_series

  !> Changes of A and of Z2 - Zc: at the end, and with e_r > 0 at the nodes.
  pure subroutine vary_microstructure(par, step, factors, change, d_A, d_excess)
    type(material_parameters), intent(in) :: par
    type(inner_solution), intent(in) :: step
    type(shared_factors), intent(in) :: factors
    type(variation), intent(inout) :: change
    real(dp), intent(out) :: d_A(LANES, 6, N_NODES), d_excess(LANES, N_NODES)
    real(dp) :: B(LANES, 6, 0:MAX_TERMS), y(LANES, 0:MAX_TERMS)
    integer :: m

    if (change%reaches_fabric) then
      call vary_fabric(par, step%fabric, factors%terms, step%share, change%A, change%S, change%mod_D, change%w, B, y)
      do m = factors%first, N_NODES
        call vary_at(m, d_A(:, :, m), d_excess(:, m))
      end do
      call vary_at(AT_END, change%A, change%excess)
    else
      d_A(:, :, factors%first:) = 0
      do m = factors%first, N_NODES
        d_excess(:, m) = vary_excess(m)
      end do
      change%excess = vary_excess(AT_END)
    end if

  contains

    pure subroutine vary_at(m, d_A, d_excess)
      integer, intent(in) :: m
      real(dp), intent(out) :: d_A(LANES, 6), d_excess(LANES)
      real(dp) :: d_y(LANES), total(LANES)
      integer :: k

      total = vary_excess(m)
      do k = 1, factors%terms
        total = total + factors%by_y(:, k, m) * y(:, k)
      end do
      d_excess = total
      call sum_series(factors%terms, factors%weight(:, :, m), B, y, d_A, d_y)
      do k = 1, 6
        d_A(:, k) = factors%inverse_y(:, m) * (d_A(:, k) - d_y * step%A(:, k, m))
      end do
    end subroutine vary_at

    !> What does not come by way of the fabric.
    pure function vary_excess(m) result(d_excess)
      integer, intent(in) :: m
      real(dp) :: d_excess(LANES)
      d_excess = factors%by_excess(:, m) * change%excess + factors%by_mod_D(:, m) * change%mod_D &
        + factors%by_mod_S(:, m) * change%mod_S + factors%by_tr_D(:, m) * change%tr_D + factors%by_log_phi(:, m) * change%log_phi
    end function vary_excess

  end subroutine vary_microstructure

  !> Changes of what the critical closure implies: A = lambda S^, Z2 = f(phi).
  pure subroutine vary_implied(par, step, change, d_A, d_excess)
    type(material_parameters), intent(in) :: par
    type(inner_solution), intent(in) :: step
    type(variation), intent(inout) :: change
    real(dp), intent(out) :: d_A(LANES, 6, N_NODES), d_excess(LANES, N_NODES)
    integer :: i

    do i = 1, N_NODES
      d_A(:, :, i) = par%lambda * change%S_hat
      d_excess(:, i) = excess_slope(par, step%phi(:, i) - par%phic) * step%phi(:, i) &
        * (change%log_phi - step%t(:, i) * step%share * change%tr_D)
    end do
    change%A = par%lambda * change%S_hat
    change%excess = excess_slope(par, step%phi_end - par%phic) * step%phi_end * (change%log_phi - step%share * change%tr_D)
  end subroutine vary_implied

  pure subroutine share_relaxation(par, inc, dev, step, factors)
    type(material_parameters), intent(in) :: par
    type(increment), intent(in) :: inc
    real(dp), intent(in) :: dev(LANES, 6)                ! before the step
    type(inner_solution), intent(in) :: step
    type(relaxation_factors), intent(out) :: factors
    real(dp) :: ratio(LANES), u(LANES, AT_END), one(LANES)
    integer :: i

    one = 1
    ratio = step%mod_D / par%elastic_strain
    u(:, :N_NODES) = 1 - step%t
    u(:, AT_END) = 0
    factors%decay = exp(-ratio)
    factors%weights = relaxation_weights(ratio, u)
    factors%slopes = relaxation_weights_slope(ratio, u)
    factors%w(:, :, 0) = step%w
    factors%R(:, :, :, 0) = small_rotation(step%w)
    factors%turned(:, :, 0) = times(factors%decay, rotate(factors%R(:, :, :, 0), dev))
    do i = 1, AT_END
      factors%w(:, :, i) = times_spin(u(:, i), step%w)
      factors%R(:, :, :, i) = small_rotation(factors%w(:, :, i))
      factors%p(:, i) = pressure(par, pressure_modulus(par, step%A(:, :, i), inc%direction), step%excess(:, i))
      factors%by(i) = pressure_slopes(par, step%A(:, :, i), inc%direction, step%excess(:, i))
      factors%unit(:, :, i) = stress_deviator(par, step%A(:, :, i), inc%S_hat, one)
      factors%turned(:, :, i) = rotate(factors%R(:, :, :, i), times(factors%p(:, i), factors%unit(:, :, i)))
    end do
  end subroutine share_relaxation

  !> Change of the relaxing deviator.
  pure subroutine vary_relaxation(par, inc, step, factors, d_A, d_excess, change)
    type(material_parameters), intent(in) :: par
    type(increment), intent(in) :: inc
    type(inner_solution), intent(in) :: step
    type(relaxation_factors), intent(in) :: factors
    real(dp), intent(in) :: d_A(LANES, 6, N_NODES), d_excess(LANES, N_NODES)     ! at the nodes
    type(variation), intent(inout) :: change
    real(dp), dimension(LANES, 6) :: d_dev, d_model
    real(dp) :: d_ratio(LANES)
    integer :: i

    d_dev = times(factors%decay, rotate(factors%R(:, :, :, 0), change%dev))
    do i = 1, N_NODES
      d_model = vary_model(i, d_A(:, :, i), d_excess(:, i))
      d_dev = d_dev + times(factors%weights(:, i), rotate(factors%R(:, :, :, i), d_model))
    end do
    d_dev = d_dev + times(factors%weights(:, AT_END), vary_model(AT_END, change%A, change%excess))
    if (change%mod_D > 0) then
      d_ratio = step%share * change%mod_D / par%elastic_strain
      d_dev = d_dev - times(d_ratio, factors%turned(:, :, 0))
      do i = 1, AT_END
        d_dev = d_dev + times(factors%slopes(:, i) * d_ratio, factors%turned(:, :, i))
      end do
    end if
    if (any(abs(change%w) > 0)) then
      d_dev = d_dev + turn_change(factors%w(:, :, 0), change%w, step%share, factors%turned(:, :, 0))
      do i = 1, N_NODES
        d_dev = d_dev + times(factors%weights(:, i), &
          turn_change(factors%w(:, :, i), change%w, step%share * (1 - step%t(:, i)), factors%turned(:, :, i)))
      end do
    end if
    change%dev = d_dev

  contains

    pure function vary_model(i, d_A, d_excess) result(d_model)
      integer, intent(in) :: i
      real(dp), intent(in) :: d_A(LANES, 6), d_excess(LANES)
      real(dp) :: d_model(LANES, 6), d_p(LANES)
      associate (by => factors%by(i), A => step%A(:, :, i))
        d_p = by%A * contract(A, d_A) + by%trace * change%trace_direction + by%excess * d_excess
        call change_stress_deviator(par, A, inc%S_hat, factors%p(:, i), factors%unit(:, :, i), d_A, change%S_hat, d_p, d_model)
      end associate
    end function vary_model

  end subroutine vary_relaxation

  !> Change of a tensor turned by w with a change share d_w.
  pure function turn_change(w, d_w, share, turned) result(d_turned)
    real(dp), intent(in) :: w(LANES, 3), d_w(3), share(LANES), turned(LANES, 6)
    real(dp) :: d_turned(LANES, 6), d_spin(LANES, 3)
    integer :: k

    do k = 1, 3
      d_spin(:, k) = share * d_w(k)
    end do
    d_turned = corotate(rotation_change(w, d_spin), turned)
  end function turn_change

  !> Change of the stress at the end of the increment, tension positive, with each seed.
  pure subroutine stress_changes(par, inc, x, change, tangent)
    type(material_parameters), intent(in) :: par
    type(increment), intent(in) :: inc
    type(internal), intent(in) :: x
    type(variation), intent(in) :: change(:)             ! (n + 1), the last with |D|
    real(dp), intent(out) :: tangent(:, :, :)            ! (LANES, 6, n)
    real(dp) :: p(LANES), d_p(LANES), unit(LANES, 6), d_dev(LANES, 6), by_mod_D(LANES, 6), d_mod_D(LANES), one(LANES)
    type(pressure_change) :: by
    integer :: j, k

    one = 1
    by = pressure_slopes(par, x%A, inc%direction, x%excess)
    unit = stress_deviator(par, x%A, inc%S_hat, one)
    p = pressure(par, pressure_modulus(par, x%A, inc%direction), x%excess)
    do j = size(change), 1, -1
      associate (c => change(j))
        d_p = by%A * contract(x%A, c%A) + by%trace * c%trace_direction + by%excess * c%excess
        if (par%elastic_strain > 0) then
          d_dev = c%dev
        else if (c%reaches_fabric) then
          call change_stress_deviator(par, x%A, inc%S_hat, p, unit, c%A, c%S_hat, d_p, d_dev)
        else
          d_dev = times(d_p, unit)
        end if
        do k = 1, 3
          d_dev(:, k) = d_dev(:, k) - d_p
        end do
        if (c%mod_D > 0) then
          by_mod_D = d_dev
        else
          d_mod_D = (project(inc%direction, c%S) + trace(inc%direction) * (c%tr_D / 3)) / 2
          do k = 1, 6
            tangent(:, k, j) = d_dev(:, k) + d_mod_D * by_mod_D(:, k)
          end do
        end if
      end associate
    end do
  end subroutine stress_changes

end module granumat_tangent
