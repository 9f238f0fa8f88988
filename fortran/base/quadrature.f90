!> Gauss-Legendre quadrature on [0, 1], and exponentials of small arguments in vector instructions.
module granumat_quadrature
  use granumat_kinds, only: dp, LANES
  implicit none (type, external)
  private
  public :: exponential

  integer, parameter, public :: N_NODES = 4

  !> Gauss-Legendre points on [0, 1].
  real(dp), parameter, public :: NODE(N_NODES) = [ &
    0.0694318442029737124_dp, 0.330009478207571868_dp, 0.669990521792428132_dp, 0.930568155797026288_dp]

  !> INTEGRAL(j, i): the j-th Lagrange polynomial of the points, integrated from 0 to point i; in the last column from 0 to 1,
  !! which are the weights of Gauss and Legendre.
  real(dp), parameter, public :: INTEGRAL(N_NODES, N_NODES + 1) = transpose(reshape([ &
    0.0869637112843634643_dp, 0.188118117499868072_dp, 0.167191921974188773_dp, 0.177482572254522612_dp, 0.173927422568726929_dp, &
    -0.0266041800849987933_dp, 0.163036288715636536_dp, 0.353953006033743967_dp, 0.313445114741868347_dp, &
    0.326072577431273071_dp, &
    0.0126274626894047245_dp, -0.0278804286024708952_dp, 0.163036288715636536_dp, 0.352676757516271865_dp, &
    0.326072577431273071_dp, &
    -0.00355514968579568316_dp, 0.00673550059453815552_dp, -0.014190694931141143_dp, 0.0869637112843634643_dp, &
    0.173927422568726929_dp], [N_NODES + 1, N_NODES]))

  real(dp), parameter, public :: INVERSE_FACTORIAL(2:11) = &
    1 / real([2, 6, 24, 120, 720, 5040, 40320, 362880, 3628800, 39916800], dp)

contains

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
