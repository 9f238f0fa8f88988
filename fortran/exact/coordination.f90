!> The coordination number (4.8) on the exact fabric, by integrating factor and Gauss quadrature (docs/theory.md, section 3).
!!
!! With Z2 - Zc as unknown, (4.8) is linear and its forcing, which depends on A : S and phi, is known at every t:
!!   Z2 - Zc = exp(-d2 |D| t) [(Z2 - Zc)(0) + integral of exp(d2 |D| t) (d1 (A : S - chi |S|) + d2 |D| (f - Zc) + d3 tr D) dt].
!! f(phi) has infinite slope at phic. With e = ln(phi/phic), which is linear in t, the integration variable tau = sqrt(e) makes the
!! integrand smooth up to phic itself (for beta2 = 1/2), so the quadrature keeps its order there.
module granumat_coordination
  use granumat_kinds, only: dp, LANES
  use granumat_law, only: coordination_rate, excess_target
  use granumat_parameters, only: material_parameters
  use granumat_quadrature, only: gauss_rules, N_NODES, exponential
  implicit none (type, external)
  private
  public :: quadrature_nodes, integrate_coordination

contains

  !> Gauss points in tau over 0 <= t <= 1, while e = ln(phi/phic) goes from e_start to e_end, both of one sign: t there, and dt/dxi
  !! with xi from 0 to 1 as tau goes from start to end.
  pure subroutine quadrature_nodes(rules, e_start, e_end, t, dt)
    type(gauss_rules), intent(in) :: rules
    real(dp), intent(in) :: e_start(LANES), e_end(LANES)
    real(dp), intent(out) :: t(LANES, N_NODES), dt(LANES, N_NODES)
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
      tau = tau_start + rules%node(:, i) * (tau_end - tau_start)
      t(:, i) = rules%node(:, i) * (tau_start + tau) * inverse
      dt(:, i) = 2 * tau * inverse
    end do
  end subroutine quadrature_nodes

  !> Z2 - Zc at the end, the first of excess_nodes, and if wanted at the nodes, from its value at t = 0.
  pure subroutine integrate_coordination(par, n, rules, excess, A_S, mod_S, mod_D, tr_D, phi, t, dt, at_nodes, &
      growth, integrand, excess_nodes)
    type(material_parameters), intent(in) :: par
    integer, intent(in) :: n                                          ! nodes
    type(gauss_rules), intent(in) :: rules
    real(dp), intent(in) :: excess(LANES)                             ! Z2 - Zc at t = 0
    real(dp), intent(in) :: A_S(LANES, N_NODES)                       ! A : S at the nodes
    real(dp), intent(in), dimension(LANES) :: mod_S, mod_D, tr_D      ! |S|, |D|, tr D of the increment
    real(dp), intent(in) :: phi(LANES, N_NODES)                       ! phi at the nodes
    real(dp), intent(in) :: t(LANES, N_NODES), dt(LANES, N_NODES)     ! of quadrature_nodes
    logical, intent(in) :: at_nodes
    real(dp), intent(out) :: growth(LANES, N_NODES)                   ! exp(d2 |D| t)
    real(dp), intent(out) :: integrand(LANES, N_NODES)                ! growth times forcing times dt/dxi
    real(dp), intent(out) :: excess_nodes(LANES, 0:N_NODES)
    real(dp) :: excess_end(LANES), decay(LANES)
    integer :: i, j

    decay = par%d2 * mod_D
    excess_end = excess
    do i = 1, n
      growth(:, i) = exponential(decay * t(:, i))
      integrand(:, i) = growth(:, i) * dt(:, i) &
        * coordination_rate(par, A_S(:, i), mod_S, mod_D, excess_target(par, phi(:, i) - par%phic), tr_D)
      excess_end = excess_end + rules%integral(:, i, 0) * integrand(:, i)
    end do
    excess_nodes(:, 0) = excess_end * exponential(-decay)
    if (.not. at_nodes) return
    do i = 1, n
      excess_nodes(:, i) = excess
      do j = 1, n
        excess_nodes(:, i) = excess_nodes(:, i) + rules%integral(:, j, i) * integrand(:, j)
      end do
      excess_nodes(:, i) = excess_nodes(:, i) / growth(:, i)
    end do
  end subroutine integrate_coordination

end module granumat_coordination
