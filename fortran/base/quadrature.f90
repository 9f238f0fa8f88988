!> Gauss-Legendre quadrature on [0, 1], places to interpolate at, and exponentials of small arguments in vector instructions.
module granumat_quadrature
  use granumat_kinds, only: dp, LANES
  implicit none (type, external)
  private
  public :: choose_places, exponential

  integer, parameter, public :: N_NODES = 4

  !> Gauss-Legendre points on [0, 1].
  real(dp), parameter, public :: NODE(N_NODES) = [ &
    0.0694318442029737124_dp, 0.330009478207571868_dp, 0.669990521792428132_dp, 0.930568155797026288_dp]

  !> Places on [0, 1] for polynomials of degree 1 (the start, the end), 2 (also the first place inside), 4 (also the others).
  integer, parameter, public :: AT_START = 0, AT_END = 1, MAX_DEGREE = 4

  !> The places inside: Lobatto's points, and points that crowd at the end (docs/theory.md, section 4.2).
  integer, parameter :: LOBATTO = 1, CROWDED = 2
  real(dp), parameter :: PLACE(AT_END + 1:MAX_DEGREE, 2) = reshape([ &
    0.5_dp, 0.172673164646011428_dp, 0.827326835353988572_dp, &
    0.93_dp, 0.69_dp, 0.29_dp], [MAX_DEGREE - AT_END, 2])

  !> The Lagrange polynomials of the Gauss points, integrated from 0 to 1, which are the weights of Gauss and Legendre, ...
  real(dp), parameter :: WEIGHT(N_NODES) = [ &
    0.173927422568726929_dp, 0.326072577431273071_dp, 0.326072577431273071_dp, 0.173927422568726929_dp]
  !> ... and from 0 to the places inside.
  real(dp), parameter :: INTEGRAL(N_NODES, AT_END + 1:MAX_DEGREE, 2) = reshape([ &
    0.176105937938662021_dp, 0.304915939483862153_dp, 0.0211566379474109187_dp, -0.00217851536993509254_dp, &
    0.159167129490034536_dp, 0.0156555154181018999_dp, -0.00264993183062231949_dp, 0.000500451568497311878_dp, &
    0.17342697100022962_dp, 0.32872250926189539_dp, 0.310417062013171117_dp, 0.0147602930787923928_dp, &
    0.177482385217620637_dp, 0.313445794170539138_dp, 0.352675190332570333_dp, 0.0863966302792698918_dp, &
    0.167321655049453875_dp, 0.353381997976062273_dp, 0.183164796221856894_dp, -0.0138684492473730424_dp, &
    0.186751699305224169_dp, 0.122696334431071533_dp, -0.0256747004363560092_dp, 0.00622666670006030699_dp], &
    [N_NODES, MAX_DEGREE - AT_END, 2])

  real(dp), parameter, public :: INVERSE_FACTORIAL(2:11) = &
    1 / real([2, 6, 24, 120, 720, 5040, 40320, 362880, 3628800, 39916800], dp)

contains

  !> The places up to the last one wanted, and the integrals of the Gauss points' Lagrange polynomials from 0 to each of them.
  pure subroutine choose_places(steepness, last, places, integrals)
    real(dp), intent(in) :: steepness(LANES)      ! from 1 on the places crowd at the end
    integer, intent(in) :: last
    real(dp), intent(out) :: places(LANES, 0:MAX_DEGREE), integrals(LANES, N_NODES, AT_END:MAX_DEGREE)
    integer :: i, m

    places(:, AT_START) = 0
    places(:, AT_END) = 1
    do i = 1, N_NODES
      integrals(:, i, AT_END) = WEIGHT(i)
    end do
    do m = AT_END + 1, last
      places(:, m) = merge(PLACE(m, CROWDED), PLACE(m, LOBATTO), steepness >= 1)
      do i = 1, N_NODES
        integrals(:, i, m) = merge(INTEGRAL(i, m, CROWDED), INTEGRAL(i, m, LOBATTO), steepness >= 1)
      end do
    end do
  end subroutine choose_places

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
