!> A job with two materials: its own umat hands sand on to granumat and does steel itself.
program router
  use, intrinsic :: iso_fortran_env, only: dp => real64
  implicit none (type, external)
  external :: umat
  real(dp), parameter :: SAND(6) = [0.5_dp, 1.0e6_dp, 3.0_dp, 0.0_dp, 0.01_dp, 0.60_dp], STEEL(1) = 2.0e11_dp
  real(dp) :: stress(6), statev(23), ddsdde(6, 6), six(6), time(2), one, pnewdt, eye(3, 3), dstran(6)

  six = 0
  time = 0
  one = 1
  pnewdt = 1
  eye = reshape([1, 0, 0, 0, 1, 0, 0, 0, 1], [3, 3])
  dstran = [0.001_dp, -0.002_dp, 0.0005_dp, 0.003_dp, -0.001_dp, 0.002_dp]
  call one_call("SAND", SAND)
  call one_call("STEEL", STEEL)

contains

  subroutine one_call(name, props)
    character(len=*), intent(in) :: name
    real(dp), intent(in) :: props(:)

    stress = 0
    statev = 0
    call umat(stress, statev, ddsdde, one, one, one, one, six, six, one, six, dstran, time, one, one, one, six, six, name, 3, 3, &
      6, 23, props, size(props), six, eye, pnewdt, one, eye, eye, 1, 1, 1, 1, 1, 1)
    print "(6es24.16)", stress
  end subroutine one_call

end program router

subroutine umat(stress, statev, ddsdde, sse, spd, scd, rpl, ddsddt, drplde, drpldt, stran, dstran, time, dtime, temp, dtemp, &
    predef, dpred, cmname, ndi, nshr, ntens, nstatv, props, nprops, coords, drot, pnewdt, celent, dfgrd0, dfgrd1, noel, npt, &
    layer, kspt, kstep, kinc)
  use, intrinsic :: iso_fortran_env, only: dp => real64
  implicit none (type, external)
  external :: granumat
  integer, intent(in) :: ndi, nshr, ntens, nstatv, nprops, noel, npt, layer, kspt, kstep, kinc
  real(dp), intent(inout) :: stress(ntens), statev(nstatv), ddsdde(ntens, ntens)
  real(dp), intent(inout) :: sse, spd, scd, rpl, ddsddt(*), drplde(*), drpldt, pnewdt
  real(dp), intent(in) :: stran(*), dstran(ntens), time(*), dtime, temp, dtemp, predef(*), dpred(*), props(nprops), coords(*)
  character(len=*), intent(in) :: cmname
  real(dp), intent(in) :: drot(3, 3), celent, dfgrd0(3, 3), dfgrd1(3, 3)

  if (cmname(:4) == "SAND") then
    call granumat(stress, statev, ddsdde, sse, spd, scd, rpl, ddsddt, drplde, drpldt, stran, dstran, time, dtime, temp, dtemp, &
      predef, dpred, cmname, ndi, nshr, ntens, nstatv, props, nprops, coords, drot, pnewdt, celent, dfgrd0, dfgrd1, noel, npt, &
      layer, kspt, kstep, kinc)
  else
    stress = stress + props(1) * dstran
  end if
end subroutine umat

subroutine sdvini(statev)
  use, intrinsic :: iso_fortran_env, only: dp => real64
  implicit none (type, external)
  real(dp), intent(out) :: statev(*)
  statev(1) = 0
end subroutine sdvini
