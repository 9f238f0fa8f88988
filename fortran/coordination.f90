!> The coordination number (4.8), (4.9) on the exact fabric: integrating factor and Gauss quadrature.
!!
!! f(phi) has infinite slope at phic. With e = ln(phi/phic), linear in t, and tau = sqrt(e) as variable of integration
!! the integrand is analytic up to phic itself (for beta2 = 1/2), so the quadrature keeps its order there.
module granumat_coordination
  use granumat_kinds, only: dp
  use granumat_parameters, only: material_parameters
  implicit none (type, external)
  private
  public :: excess_coordination, nodes, integrate_coordination

  integer, parameter, public :: N_NODES = 5

  ! Gauss-Legendre points and weights on [0, 1]; INTEGRAL(j, i): the j-th Lagrange polynomial integrated up to point i.
  real(dp), parameter :: POINT(N_NODES) = [ &
    0.0469100770306680036_dp, 0.230765344947158454_dp, 0.5_dp, 0.769234655052841546_dp, 0.953089922969331996_dp]
  real(dp), parameter :: WEIGHT(N_NODES) = [ &
    0.118463442528094544_dp, 0.239314335249683234_dp, 0.284444444444444444_dp, 0.239314335249683234_dp, 0.118463442528094544_dp]
  real(dp), parameter :: INTEGRAL(N_NODES, N_NODES) = transpose(reshape([ &
    0.0592317212640472719_dp, 0.128151005670045283_dp, 0.113776288004224603_dp, 0.121232436926864147_dp, &
    0.116875329560228545_dp, &
    -0.0195703643590760375_dp, 0.119657167624841617_dp, 0.260004651680641519_dp, 0.228996054578999877_dp, &
    0.244908128910495419_dp, &
    0.0112544008186429556_dp, -0.0245921146196422004_dp, 0.142222222222222222_dp, 0.309036559064086645_dp, &
    0.273190043625801489_dp, &
    -0.00559379366081218488_dp, 0.0103182806706833574_dp, -0.0206903164309582846_dp, 0.119657167624841617_dp, &
    0.258884699608759272_dp, &
    0.00158811296786599854_dp, -0.00276899439876960304_dp, 0.00468715452386994123_dp, -0.00968756314195073974_dp, &
    0.0592317212640472719_dp], [N_NODES, N_NODES]))

contains

  !> f(phi) - Zc (4.9), from e = ln(phi/phic).
  pure function excess_coordination(par, e) result(excess)
    type(material_parameters), intent(in) :: par
    real(dp), intent(in) :: e
    real(dp) :: excess
    excess = 0
    if (e > 0) excess = par%beta1 * (par%phic * 2 * sinh(e / 2) * exp(e / 2))**par%beta2   ! phi - phic = phic (exp(e) - 1)
  end function excess_coordination

  !> Gauss points over 0 <= t <= 1 while e goes from e_start to e_end, both of one sign: t, dt/dxi and e there.
  pure subroutine nodes(e_start, e_end, t, dt, e)
    real(dp), intent(in) :: e_start, e_end
    real(dp), intent(out) :: t(N_NODES), dt(N_NODES), e(N_NODES)
    real(dp) :: tau_start, tau_end, tau(N_NODES)

    t = POINT
    dt = 1
    e = e_start + t * (e_end - e_start)
    if (e_start > 0 .or. e_end > 0) then
      tau_start = sqrt(max(e_start, 0.0_dp))
      tau_end = sqrt(max(e_end, 0.0_dp))
      tau = tau_start + POINT * (tau_end - tau_start)
      t = POINT * (tau_start + tau) / (tau_start + tau_end)
      dt = 2 * tau / (tau_start + tau_end)
      e = tau**2
    end if
  end subroutine nodes

  !> Z2 - Zc at the nodes and at the end, from its value at t = 0.
  pure subroutine integrate_coordination(par, excess, A_S, mod_S, mod_D, tr_D, t, dt, e, excess_nodes, excess_end)
    type(material_parameters), intent(in) :: par
    real(dp), intent(in) :: excess                      ! Z2 - Zc at t = 0
    real(dp), intent(in) :: A_S(N_NODES)                ! A:S at the nodes
    real(dp), intent(in) :: mod_S, mod_D, tr_D          ! |S|, |D|, tr D of the increment
    real(dp), intent(in) :: t(N_NODES), dt(N_NODES), e(N_NODES)
    real(dp), intent(out) :: excess_nodes(N_NODES), excess_end
    real(dp) :: decay, growth(N_NODES), integrand(N_NODES)
    integer :: i

    decay = par%d2 * mod_D
    growth = exp(decay * t)
    do i = 1, N_NODES
      integrand(i) = par%d1 * (A_S(i) - par%chi * mod_S) + decay * excess_coordination(par, e(i)) + par%d3 * tr_D   ! (4.8)
    end do
    integrand = growth * integrand * dt
    excess_nodes = (excess + matmul(integrand, INTEGRAL)) / growth
    excess_end = (excess + sum(WEIGHT * integrand)) * exp(-decay)
  end subroutine integrate_coordination

end module granumat_coordination
