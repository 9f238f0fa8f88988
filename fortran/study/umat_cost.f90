!> What one UMAT call costs beside an elastic UMAT's: prints the nanoseconds of both, processor time, the median of repetitions.
!!
!! Both are called as a host does, with all 37 arguments, at points near steady shear and increments of shear strain up to 0.01.
program umat_cost
  use, intrinsic :: iso_fortran_env, only: dp => real64
  implicit none (type, external)
  external :: umat, elastic
  integer, parameter :: N_POINTS = 256, N_CALLS = 10, N_REPEATS = 9, N_STATEV = 23
  real(dp), parameter :: PROPS(9) = [0.5_dp, 1.0e6_dp, 3.0_dp, 0.0_dp, 0.0_dp, 0.60_dp, 0.0_dp, 1.0_dp, 0.0_dp]
  real(dp) :: stress(6, N_POINTS), statev(N_STATEV, N_POINTS), strain(6, N_POINTS), drot(3, 3, N_POINTS)
  real(dp) :: seconds(N_REPEATS, 2)
  integer :: k

  call prepare()
  do k = 1, N_REPEATS
    seconds(k, 1) = timed(elastic)
    seconds(k, 2) = timed(umat)
  end do
  print "(2f12.1)", median(seconds(:, 1)) * 1.0e9_dp, median(seconds(:, 2)) * 1.0e9_dp

contains

  !> States sheared to near steadiness, each its own way, and increments in other directions.
  subroutine prepare()
    real(dp) :: u(7), angle
    integer :: i, step

    stress = 0
    statev = 0
    do i = 1, N_POINTS
      call random_number(u)
      strain(:, i) = 0.1_dp * (u(:6) - 0.5_dp)
      strain(3, i) = -strain(1, i) - strain(2, i)
      angle = 0.005_dp * u(7)
      drot(:, :, i) = reshape([cos(angle), sin(angle), 0.0_dp, -sin(angle), cos(angle), 0.0_dp, 0.0_dp, 0.0_dp, 1.0_dp], [3, 3])
    end do
    do step = 1, 10
      call call_all(umat, stress, statev)
    end do
    strain = strain(:, N_POINTS:1:-1) * 0.1_dp
  end subroutine prepare

  function timed(routine) result(seconds_per_call)
    external :: routine
    real(dp) :: seconds_per_call
    real(dp) :: new_stress(6, N_POINTS), new_statev(N_STATEV, N_POINTS)
    real(dp) :: start, finish
    integer :: call

    call cpu_time(start)
    do call = 1, N_CALLS
      new_stress = stress
      new_statev = statev
      call call_all(routine, new_stress, new_statev)
    end do
    call cpu_time(finish)
    seconds_per_call = (finish - start) / (N_CALLS * N_POINTS)
  end function timed

  subroutine call_all(routine, stress, statev)
    external :: routine
    real(dp), intent(inout) :: stress(6, N_POINTS), statev(N_STATEV, N_POINTS)
    real(dp) :: ddsdde(6, 6), six(6), time(2), one, pnewdt, eye(3, 3)
    integer :: i

    six = 0
    time = 0
    one = 1
    pnewdt = 1
    eye = reshape([1, 0, 0, 0, 1, 0, 0, 0, 1], [3, 3])
    do i = 1, N_POINTS
      call routine(stress(:, i), statev(:, i), ddsdde, one, one, one, one, six, six, one, six, strain(:, i), time, one, one, one, &
        six, six, "GRANUMAT", 3, 3, 6, N_STATEV, PROPS, size(PROPS), six, drot(:, :, i), pnewdt, one, eye, eye, i, 1, 1, 1, 1, 1)
      if (pnewdt < 1) error stop "the call failed"
    end do
  end subroutine call_all

  function median(values)
    real(dp), intent(in) :: values(N_REPEATS)
    real(dp) :: median, sorted(N_REPEATS), smallest
    integer :: i, j

    sorted = values
    do i = 1, N_REPEATS
      j = i - 1 + minloc(sorted(i:), 1)
      smallest = sorted(j)
      sorted(j) = sorted(i)
      sorted(i) = smallest
    end do
    median = sorted((N_REPEATS + 1) / 2)
  end function median

end program umat_cost

!> Isotropic elasticity, total stiffness formed in each call as hosts' examples do.
subroutine elastic(stress, statev, ddsdde, sse, spd, scd, rpl, ddsddt, drplde, drpldt, stran, dstran, time, dtime, temp, dtemp, &
    predef, dpred, cmname, ndi, nshr, ntens, nstatv, props, nprops, coords, drot, pnewdt, celent, dfgrd0, dfgrd1, noel, npt, &
    layer, kspt, kstep, kinc)
  use, intrinsic :: iso_fortran_env, only: dp => real64
  implicit none (type, external)
  integer, intent(in) :: ndi, nshr, ntens, nstatv, nprops, noel, npt, layer, kspt, kstep, kinc
  real(dp), intent(inout) :: stress(ntens), statev(nstatv), ddsdde(ntens, ntens)
  real(dp), intent(inout) :: sse, spd, scd, rpl, ddsddt(*), drplde(*), drpldt, pnewdt
  real(dp), intent(in) :: stran(*), dstran(ntens), time(*), dtime, temp, dtemp, predef(*), dpred(*), props(nprops), coords(*)
  character(len=*), intent(in) :: cmname
  real(dp), intent(in) :: drot(3, 3), celent, dfgrd0(3, 3), dfgrd1(3, 3)
  integer :: i

  ddsdde = 0
  ddsdde(:ndi, :ndi) = props(2) / 3
  do i = 1, ntens
    ddsdde(i, i) = ddsdde(i, i) + merge(props(2), props(2) / 2, i <= ndi)
  end do
  stress = stress + matmul(ddsdde, dstran)
end subroutine elastic
