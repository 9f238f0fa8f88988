!> Reads places u and ratios, and prints the weights of the relaxation for each ratio.
program print_weights
  use granumat_kinds, only: dp, LANES
  use granumat_relaxation, only: relaxation_weights
  implicit none (type, external)
  integer, parameter :: N = 4                    ! nodes, after the end
  real(dp) :: places(0:N), ratio, weights(LANES, 0:N)
  integer :: status

  read (*, *) places
  do
    read (*, *, iostat=status) ratio
    if (status /= 0) exit
    weights = relaxation_weights(spread(ratio, 1, LANES), spread(places, 1, LANES), spread(N, 1, LANES), N)
    print "(*(es25.16e3, 1x))", weights(1, :)
  end do
end program print_weights
