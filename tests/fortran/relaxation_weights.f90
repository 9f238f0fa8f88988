!> Reads a degree and places u, then ratios, and prints the weights of the relaxation for each ratio.
program print_weights
  use granumat_kinds, only: dp, LANES
  use granumat_quadrature, only: MAX_DEGREE
  use granumat_relaxation, only: relaxation_weights
  implicit none (type, external)
  real(dp) :: degree, places(0:MAX_DEGREE), ratio(LANES), weights(LANES, 0:MAX_DEGREE)
  integer :: status

  read (*, *) degree, places
  do
    read (*, *, iostat=status) ratio(1)
    if (status /= 0) exit
    ratio = ratio(1)
    weights = relaxation_weights(ratio, exp(-ratio), spread(places, 1, LANES), spread(degree, 1, LANES), MAX_DEGREE)
    print "(*(es25.16e3, 1x))", weights(1, :)
  end do
end program print_weights
