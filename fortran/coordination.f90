!> The coordination number (4.8), (4.9) on the exact fabric: integrating factor and Gauss quadrature.
!!
!! f(phi) has infinite slope at phic. With e = ln(phi/phic), linear in t, and tau = sqrt(e) as variable of integration
!! the integrand is analytic up to phic itself (for beta2 = 1/2), so the quadrature keeps its order there.
module granumat_coordination
  use granumat_kinds, only: dp
  use granumat_parameters, only: material_parameters
  use granumat_tensors, only: LANES
  implicit none (type, external)
  private
  public :: excess_coordination, excess_slope, nodes, integrate_coordination, exponential

  integer, parameter, public :: N_NODES = 4

  ! Gauss-Legendre points and weights on [0, 1]; INTEGRAL(j, i): the j-th Lagrange polynomial integrated up to point i.
  real(dp), parameter :: POINT(N_NODES) = [ &
    0.0694318442029737124_dp, 0.330009478207571868_dp, 0.669990521792428132_dp, 0.930568155797026288_dp]
  real(dp), parameter, public :: WEIGHT(N_NODES) = [ &
    0.173927422568726929_dp, 0.326072577431273071_dp, 0.326072577431273071_dp, 0.173927422568726929_dp]
  real(dp), parameter, public :: INTEGRAL(N_NODES, N_NODES) = transpose(reshape([ &
    0.0869637112843634643_dp, 0.188118117499868072_dp, 0.167191921974188773_dp, 0.177482572254522612_dp, &
    -0.0266041800849987933_dp, 0.163036288715636536_dp, 0.353953006033743967_dp, 0.313445114741868347_dp, &
    0.0126274626894047245_dp, -0.0278804286024708952_dp, 0.163036288715636536_dp, 0.352676757516271865_dp, &
    -0.00355514968579568316_dp, 0.00673550059453815552_dp, -0.014190694931141143_dp, 0.0869637112843634643_dp], [N_NODES, N_NODES]))

  real(dp), parameter :: INVERSE_FACTORIAL(0:11) = &
    1 / real([1, 1, 2, 6, 24, 120, 720, 5040, 40320, 362880, 3628800, 39916800], dp)

contains

  !> exp(x) for |x| <= 0.2, to round-off: its Taylor polynomial, in vector instructions.
  pure function exponential(x) result(e)
    real(dp), intent(in) :: x(LANES)
    real(dp) :: e(LANES)
    integer :: k
    e = INVERSE_FACTORIAL(11)
    do k = 10, 0, -1
      e = e * x + INVERSE_FACTORIAL(k)
    end do
  end function exponential

  !> f(phi) - Zc (4.9), from phi - phic.
  pure function excess_coordination(par, distance) result(excess)
    type(material_parameters), intent(in) :: par
    real(dp), intent(in) :: distance(LANES)
    real(dp) :: excess(LANES)
    excess = sqrt(max(distance, 0.0_dp))
    if (abs(par%beta2 - 0.5_dp) > 0) excess = excess**(2 * par%beta2)
    excess = par%beta1 * excess
  end function excess_coordination

  !> df/dphi, from phi - phic.
  pure function excess_slope(par, distance) result(slope)
    type(material_parameters), intent(in) :: par
    real(dp), intent(in) :: distance(LANES)
    real(dp) :: slope(LANES)
    slope = merge(par%beta2 * excess_coordination(par, distance) / max(distance, tiny(1.0_dp)), 0.0_dp, distance > 0)
  end function excess_slope

  !> Gauss points over 0 <= t <= 1 while e = ln(phi/phic) goes from e_start to e_end, both of one sign: t and dt/dxi there.
  pure subroutine nodes(e_start, e_end, t, dt)
    real(dp), intent(in) :: e_start(LANES), e_end(LANES)
    real(dp), intent(out) :: t(LANES, N_NODES), dt(LANES, N_NODES)
    real(dp), dimension(LANES) :: tau_start, tau_end, tau, inverse
    integer :: i

    tau_start = sqrt(max(e_start, 0.0_dp))
    tau_end = sqrt(max(e_end, 0.0_dp))
    where (max(tau_start, tau_end) <= 0)            ! phi stays below phic, where f is constant
      tau_start = 1
      tau_end = 1
    end where
    inverse = 1 / (tau_start + tau_end)
    do i = 1, N_NODES
      tau = tau_start + POINT(i) * (tau_end - tau_start)
      t(:, i) = POINT(i) * (tau_start + tau) * inverse
      dt(:, i) = 2 * tau * inverse
    end do
  end subroutine nodes

  !> Z2 - Zc at the end (the last of excess_nodes) and, if wanted, at the nodes, from its value at t = 0.
  pure subroutine integrate_coordination(par, excess, A_S, mod_S, mod_D, tr_D, phi, t, dt, at_nodes, &
      growth, integrand, excess_nodes)
    type(material_parameters), intent(in) :: par
    real(dp), intent(in) :: excess(LANES)                             ! Z2 - Zc at t = 0
    real(dp), intent(in) :: A_S(LANES, N_NODES)                       ! A:S at the nodes
    real(dp), intent(in), dimension(LANES) :: mod_S, mod_D, tr_D      ! |S|, |D|, tr D of the increment
    real(dp), intent(in) :: phi(LANES, N_NODES)                       ! phi at the nodes
    real(dp), intent(in) :: t(LANES, N_NODES), dt(LANES, N_NODES)
    logical, intent(in) :: at_nodes
    real(dp), intent(out) :: growth(LANES, N_NODES), integrand(LANES, N_NODES)    ! exp(d2 |D| t), and with (4.8) dt/dxi
    real(dp), intent(out) :: excess_nodes(LANES, N_NODES + 1)
    real(dp) :: excess_end(LANES), decay(LANES), constant(LANES)
    integer :: i, j

    decay = par%d2 * mod_D
    constant = par%d3 * tr_D - par%d1 * par%chi * mod_S
    excess_end = excess
    do i = 1, N_NODES
      growth(:, i) = exponential(decay * t(:, i))
      integrand(:, i) = growth(:, i) * dt(:, i) &
        * (par%d1 * A_S(:, i) + decay * excess_coordination(par, phi(:, i) - par%phic) + constant)    ! (4.8)
      excess_end = excess_end + WEIGHT(i) * integrand(:, i)
    end do
    excess_nodes(:, N_NODES + 1) = excess_end * exponential(-decay)
    if (.not. at_nodes) return
    do i = 1, N_NODES
      excess_nodes(:, i) = excess
      do j = 1, N_NODES
        excess_nodes(:, i) = excess_nodes(:, i) + INTEGRAL(j, i) * integrand(:, j)
      end do
      excess_nodes(:, i) = excess_nodes(:, i) / growth(:, i)
    end do
  end subroutine integrate_coordination

end module granumat_coordination
