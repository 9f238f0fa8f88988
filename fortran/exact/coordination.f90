!> The coordination number (4.8) on the exact fabric, by integrating factor and Gauss quadrature (docs/theory.md, section 3).
!!
!! With Z2 - Zc as unknown, (4.8) is linear and its forcing, which depends on A : S and phi, is known at every t:
!!   Z2 - Zc = exp(-d2 m t) [(Z2 - Zc)(0) + integral of exp(d2 m t) (d1 (A : S - chi |S|) + d2 m (f - Zc) + d3 tr D) dt],
!! with m = |D|, or the nonlocal strain m where there is a length.
!! f(phi) has infinite slope at phic. With e = ln(phi/phic), which is linear in t, the integration variable tau = sqrt(e) makes the
!! integrand smooth up to phic itself (for beta2 = 1/2), so the quadrature keeps its order there.
module granumat_coordination
  use granumat_kinds, only: dp, LANES
  use granumat_law, only: coordination_rate, evolving_target
  use granumat_parameters, only: material_parameters
  use granumat_quadrature, only: AT_END, AT_START, MAX_DEGREE, N_NODES, NODE, exponential
  implicit none (type, external)
  private
  public :: quadrature_nodes, integrate_coordination

contains

  !> Gauss points in tau over 0 <= t <= 1, while e = ln(phi/phic) goes from e_start to e_end, both of one sign: t there, and dt/dxi
  !! with xi from 0 to 1 as tau goes from start to end; and t at the places up to the last one wanted.
  pure subroutine quadrature_nodes(e_start, e_end, places, last, t, dt, t_place)
    real(dp), intent(in) :: e_start(LANES), e_end(LANES), places(LANES, 0:MAX_DEGREE)
    integer, intent(in) :: last
    real(dp), intent(out) :: t(LANES, N_NODES), dt(LANES, N_NODES), t_place(LANES, 0:MAX_DEGREE)
    real(dp), dimension(LANES) :: tau_start, tau_end, tau, inverse
    integer :: i

    tau_start = sqrt(max(e_start, 0.0_dp))
    tau_end = sqrt(max(e_end, 0.0_dp))
    where (max(tau_start, tau_end) <= 0)            ! phi stays below phic, where f is constant: points in t itself
      tau_start = 1
      tau_end = 1
    end where
    inverse = 1 / (tau_start + tau_end)
    do i = 1, N_NODES
      tau = tau_start + NODE(i) * (tau_end - tau_start)
      t(:, i) = NODE(i) * (tau_start + tau) * inverse
      dt(:, i) = 2 * tau * inverse
    end do
    t_place(:, AT_START) = 0
    t_place(:, AT_END) = 1
    do i = AT_END + 1, last
      tau = tau_start + places(:, i) * (tau_end - tau_start)
      t_place(:, i) = places(:, i) * (tau_start + tau) * inverse
    end do
  end subroutine quadrature_nodes

  !> Z2 - Zc at the end and at the places inside up to the last one wanted, from its value at t = 0.
  pure subroutine integrate_coordination(par, A_S, mod_S, nonlocal, tr_D, phi, t, dt, integrals, t_place, last, &
      growth, integrand, decay, excess)
    type(material_parameters), intent(in) :: par
    real(dp), intent(in) :: A_S(LANES, N_NODES)                       ! A : S at the nodes
    real(dp), intent(in), dimension(LANES) :: mod_S, nonlocal, tr_D   ! |S|, m, tr D of the increment
    real(dp), intent(in) :: phi(LANES, N_NODES)                       ! phi at the nodes
    real(dp), intent(in) :: t(LANES, N_NODES), dt(LANES, N_NODES)     ! of quadrature_nodes
    real(dp), intent(in) :: integrals(LANES, N_NODES, AT_END:MAX_DEGREE), t_place(LANES, 0:MAX_DEGREE)
    integer, intent(in) :: last
    real(dp), intent(out) :: growth(LANES, N_NODES)                   ! exp(d2 m t)
    real(dp), intent(out) :: integrand(LANES, N_NODES)                ! growth times forcing times dt/dxi
    real(dp), intent(out) :: decay(LANES, AT_END:MAX_DEGREE)          ! exp(-d2 m t) at the places
    real(dp), intent(inout) :: excess(LANES, 0:MAX_DEGREE)            ! Z2 - Zc at the places, given at the start
    real(dp) :: rate(LANES)
    integer :: i, m

    rate = par%d2 * nonlocal
    ! Where LANES = 1, GCC would otherwise take the nodes in pairs and raise each pair to beta2, which beta2 = 1/2 need not.
    !GCC$ unroll 4
    do i = 1, N_NODES
      growth(:, i) = exponential(rate * t(:, i))
      integrand(:, i) = growth(:, i) * dt(:, i) &
        * coordination_rate(par, A_S(:, i), mod_S, nonlocal, evolving_target(par, phi(:, i) - par%phic), tr_D)
    end do
    do m = AT_END, last
      decay(:, m) = exponential(-rate * t_place(:, m))
      excess(:, m) = excess(:, AT_START)
      do i = 1, N_NODES
        excess(:, m) = excess(:, m) + integrals(:, i, m) * integrand(:, i)
      end do
      excess(:, m) = excess(:, m) * decay(:, m)
    end do
  end subroutine integrate_coordination

end module granumat_coordination
