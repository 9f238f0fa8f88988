!> One material point driven through umat as a host does: simple shear at constant volume, then reversed.
program shear
  use, intrinsic :: iso_fortran_env, only: dp => real64
  implicit none (type, external)
  external :: umat
  integer, parameter :: NTENS = 6, NSTATV = 23, INCREMENTS = 100
  ! mu, stiffness, closure, contact, elastic_strain, phi, pressure, spin, calibration, order
  real(dp), parameter :: PROPS(10) = [0.5_dp, 1.0e6_dp, 3.0_dp, 0.0_dp, 0.01_dp, 0.60_dp, 5.0e3_dp, 2.0_dp, 0.0_dp, 0.0_dp]
  real(dp) :: stress(NTENS), statev(NSTATV), ddsdde(NTENS, NTENS), dstran(NTENS), drot(3, 3), dfgrd0(3, 3), dfgrd1(3, 3)
  real(dp) :: unused(NTENS), time(2), energies(3), zero, pnewdt, gamma
  integer :: k

  stress = 0
  statev = 0                                  ! the state starts itself from PROPS
  unused = 0
  zero = 0
  time = 0
  energies = 0
  drot = identity()
  dfgrd1 = identity()
  gamma = 0
  do k = 1, 2 * INCREMENTS
    dfgrd0 = dfgrd1
    dstran = 0
    dstran(5) = merge(0.01_dp, -0.01_dp, k <= INCREMENTS)
    gamma = gamma + dstran(5)
    dfgrd1(1, 3) = gamma                      ! du_x/dz
    pnewdt = 1
    call umat(stress, statev, ddsdde, energies(1), energies(2), energies(3), zero, unused, unused, zero, unused, dstran, time, &
      1.0_dp, zero, zero, unused, unused, "GRANUMAT", 3, 3, NTENS, NSTATV, PROPS, size(PROPS), unused, drot, pnewdt, 1.0_dp, &
      dfgrd0, dfgrd1, 1, 1, 1, 1, 1, k)
    if (pnewdt < 1) error stop "umat asks for a smaller increment"
    if (mod(k, 25) == 0) print "(3(a,f9.3))", "gamma ", gamma, "  p ", -sum(stress(:3)) / 3, "  sigma_xz ", stress(5)
  end do

contains

  pure function identity() result(eye)
    real(dp) :: eye(3, 3)
    eye = reshape([1, 0, 0, 0, 1, 0, 0, 0, 1], [3, 3])
  end function identity

end program shear
