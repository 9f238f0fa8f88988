!> Gauss-Legendre quadrature on [0, 1], and exponentials of small arguments in vector instructions.
module granumat_quadrature
  use granumat_kinds, only: dp, LANES
  implicit none (type, external)
  private
  public :: choose_rules, exponential

  integer, parameter, public :: N_NODES = 4      ! at most

  !> NODE(j, n): point j of the rule of n points, the last one first. Those for j > n are any others: they have no weight.
  real(dp), parameter :: NODE(N_NODES, N_NODES) = reshape([real(dp) :: &
    0.5_dp, 0.669990521792428132_dp, 0.330009478207571868_dp, 0.0694318442029737124_dp, &
    0.788675134594812882_dp, 0.211324865405187118_dp, 0.330009478207571868_dp, 0.0694318442029737124_dp, &
    0.887298334620741689_dp, 0.5_dp, 0.112701665379258311_dp, 0.0694318442029737124_dp, &
    0.930568155797026288_dp, 0.669990521792428132_dp, 0.330009478207571868_dp, 0.0694318442029737124_dp], &
    [N_NODES, N_NODES])

  !> INTEGRAL(j, i, n): Lagrange polynomial j of the points, integrated from 0 to point i, or to 1 for i = 0, which are the weights
  !! of Gauss and Legendre; 0 for points that have no weight.
  real(dp), parameter :: INTEGRAL(N_NODES, 0:N_NODES, N_NODES) = reshape([real(dp) :: &
    1.0_dp, 0, 0, 0, &
    0.5_dp, 0, 0, 0, &
    0, 0, 0, 0, &
    0, 0, 0, 0, &
    0, 0, 0, 0, &
    0.5_dp, 0.5_dp, 0, 0, &
    0.25_dp, 0.538675134594812882_dp, 0, 0, &
    -0.0386751345948128823_dp, 0.25_dp, 0, 0, &
    0, 0, 0, 0, &
    0, 0, 0, 0, &
    0.277777777777777778_dp, 0.444444444444444444_dp, 0.277777777777777778_dp, 0, &
    0.138888888888888889_dp, 0.480421111969383348_dp, 0.267988333762469452_dp, 0, &
    -0.0224854172030868147_dp, 0.222222222222222222_dp, 0.300263194980864592_dp, 0, &
    0.00978944401530832605_dp, -0.0359766675249389035_dp, 0.138888888888888889_dp, 0, &
    0, 0, 0, 0, &
    0.173927422568726929_dp, 0.326072577431273071_dp, 0.326072577431273071_dp, 0.173927422568726929_dp, &
    0.0869637112843634643_dp, 0.352676757516271865_dp, 0.313445114741868347_dp, 0.177482572254522612_dp, &
    -0.014190694931141143_dp, 0.163036288715636536_dp, 0.353953006033743967_dp, 0.167191921974188773_dp, &
    0.00673550059453815552_dp, -0.0278804286024708952_dp, 0.163036288715636536_dp, 0.188118117499868072_dp, &
    -0.00355514968579568316_dp, 0.0126274626894047245_dp, -0.0266041800849987933_dp, 0.0869637112843634643_dp], &
    [N_NODES, N_NODES + 1, N_NODES])

  !> The rules of LANES points, each with its own number of nodes; n is the largest of them.
  type, public :: gauss_rules
    integer :: nodes(LANES), n
    real(dp) :: node(LANES, N_NODES), integral(LANES, N_NODES, 0:N_NODES)
  end type gauss_rules

  real(dp), parameter, public :: INVERSE_FACTORIAL(2:11) = &
    1 / real([2, 6, 24, 120, 720, 5040, 40320, 362880, 3628800, 39916800], dp)

contains

  !> The rules with so many nodes; integrals up to the nodes, and not only up to 1, if wanted.
  pure subroutine choose_rules(nodes, to_nodes, rules)
    integer, intent(in) :: nodes(LANES)
    logical, intent(in) :: to_nodes
    type(gauss_rules), intent(out) :: rules
    integer :: i, j, n, last

    n = maxval(nodes)
    rules%nodes = nodes
    rules%n = n
    last = merge(n, 0, to_nodes)
    do j = 1, N_NODES
      rules%node(:, j) = NODE(j, n)
      do i = 0, last
        rules%integral(:, j, i) = INTEGRAL(j, i, n)
      end do
    end do
    if (all(nodes == n)) return
    do i = 1, LANES
      rules%node(i, :) = NODE(:, nodes(i))
      rules%integral(i, :, 0:last) = INTEGRAL(:, 0:last, nodes(i))
    end do
  end subroutine choose_rules

  !> exp(x) to round-off for |x| <= 0.2, by its Taylor polynomial of degree 11.
  pure function exponential(x) result(e)
    real(dp), intent(in) :: x(LANES)
    real(dp) :: e(LANES)
    associate (c => INVERSE_FACTORIAL)
      e = c(6) + x * (c(7) + x * (c(8) + x * (c(9) + x * (c(10) + x * c(11)))))
      e = 1 + x * (1 + x * (c(2) + x * (c(3) + x * (c(4) + x * (c(5) + x * e)))))
    end associate
  end function exponential

end module granumat_quadrature
