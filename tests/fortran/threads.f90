!> Points through umat serially, then in another order by 8 threads: prints how many differ in any bit.
program threads
  use, intrinsic :: iso_fortran_env, only: dp => real64, int64
  use omp_lib, only: omp_get_num_threads
  implicit none (type, external)
  external :: umat
  integer, parameter :: N_POINTS = 1000, N_STEPS = 3, N_THREADS = 8, N_STATEV = 23
  real(dp), parameter :: PROPS(9) = [0.5_dp, 1.0e6_dp, 3.0_dp, 0.0_dp, 0.01_dp, 0.60_dp, 5.0e3_dp, 1.0_dp, 0.0_dp]
  real(dp) :: strain(6, N_STEPS, N_POINTS), angle(N_STEPS, N_POINTS)
  real(dp) :: serial(6 + N_STATEV + 36, N_POINTS), shared(6 + N_STATEV + 36, N_POINTS), u
  integer :: order(N_POINTS), i, j, k, team

  call random_number(strain)
  strain = 0.02_dp * (strain - 0.5_dp)
  strain(3, :, :) = -strain(1, :, :) - strain(2, :, :)
  call random_number(angle)
  order = [(i, i = 1, N_POINTS)]
  do i = N_POINTS, 2, -1
    call random_number(u)
    j = 1 + int(u * i)
    k = order(i)
    order(i) = order(j)
    order(j) = k
  end do
  do i = 1, N_POINTS
    call follow(i, serial(:, i))
  end do
  team = 0
  !$omp parallel do num_threads(N_THREADS) schedule(dynamic, 1)
  do i = 1, N_POINTS
    if (i == 1) team = omp_get_num_threads()
    call follow(order(i), shared(:, order(i)))
  end do
  print "(i0,a,i0,a,i0,a)", team, " threads, ", N_POINTS, " points: ", &
    count([(any(transfer(serial(:, i), [0_int64]) /= transfer(shared(:, i), [0_int64])), i = 1, N_POINTS)]), " differ"

contains

  !> The steps of one point: stress, state and tangent at the end.
  subroutine follow(point, found)
    integer, intent(in) :: point
    real(dp), intent(out) :: found(6 + N_STATEV + 36)
    real(dp) :: stress(6), statev(N_STATEV), ddsdde(6, 6), drot(3, 3), six(6), time(2), zero, pnewdt, a
    integer :: step

    stress = 0
    statev = 0
    six = 0
    time = 0
    zero = 0
    pnewdt = 1
    do step = 1, N_STEPS
      a = 0.1_dp * angle(step, point)
      drot = reshape([cos(a), sin(a), 0.0_dp, -sin(a), cos(a), 0.0_dp, 0.0_dp, 0.0_dp, 1.0_dp], [3, 3])
      call umat(stress, statev, ddsdde, zero, zero, zero, zero, six, six, zero, six, strain(:, step, point), time, zero, zero, &
        zero, six, six, "GRANUMAT", 3, 3, 6, N_STATEV, PROPS, size(PROPS), six, drot, pnewdt, zero, drot, drot, point, 1, 1, 1, &
        1, step)
      if (pnewdt < 1) error stop "a call failed"
    end do
    found = [stress, statev, reshape(ddsdde, [36])]
  end subroutine follow

end program threads
