!> The model as PLAXIS and others call a user-defined soil model: User_Mod with its IDTASK, and what their dialogs ask for.
!!
!! A thin shell over the update of the UMAT. Stress and strain are xx yy zz xy yz zx, tension positive. A state starts itself at the
!! first call with its STVAR0 still 0, from the stress at hand or from the parameters, as in the UMAT.
module granumat_user_mod
  use granumat_kinds, only: dp
  use granumat_umat, only: N_PROPS, N_STATEV, ORDER_KRATOS, P_ORDER, advance, speak
  use granumat_status, only: OK
  implicit none (type, external)
  private
  public :: entry_of, evaluate, written

  ! Parameters are the UMAT's PROPS without those that describe a host: `spin`, which is none, and `order`.
  integer, parameter, public :: PARAMETERS(8) = [1, 2, 3, 4, 5, 6, 7, 9]

  integer, parameter, public :: INITIALISE = 1, STRESS = 2, TANGENT = 3, COUNT_STATES = 4, ATTRIBUTES = 5, ELASTIC = 6    ! IDTASK
  ! Of water over that of the grains' skeleton, in hosts that take water's from here: it makes Poisson's ratio about 0.495.
  real(dp), parameter, public :: BULK_OF_WATER = 100

  character(len=*), parameter, public :: STATES(N_STATEV) = [character(len=7) :: &
    "started", "A_xx", "A_yy", "A_zz", "A_xy", "A_xz", "A_yz", "Z2", "phi", &
    "D_xx", "D_yy", "D_zz", "D_xy", "D_xz", "D_yz", &
    "sig_xx", "sig_yy", "sig_zz", "sig_xy", "sig_xz", "sig_yz", "work", "status"]

contains

  !> Stress, states and tangent after a strain increment.
  subroutine evaluate(props, sig0, stvar0, deps, sig, stvar, D, failed)
    real(dp), intent(in) :: props(:)                     ! (size(PARAMETERS))
    real(dp), intent(in) :: sig0(6), stvar0(N_STATEV), deps(6)
    real(dp), intent(out) :: sig(6), stvar(N_STATEV), D(6, 6)
    logical, intent(out) :: failed
    real(dp) :: given(N_PROPS)
    integer :: status

    given = 0
    given(PARAMETERS) = props
    given(P_ORDER) = ORDER_KRATOS
    sig = sig0
    stvar = stvar0
    call advance(given, deps, stress=sig, statev=stvar, ddsdde=D, status=status)
    failed = status /= OK
    if (failed) call speak("User_Mod", status, given, size(sig), N_STATEV)
  end subroutine evaluate

  !> A text as hosts expect it: its length in the first character.
  pure function written(text) result(name)
    character(len=*), intent(in) :: text
    character(len=:), allocatable :: name
    name = char(len_trim(text)) // trim(text)
  end function written

  !> One of several texts, blank where there is none of this number.
  pure function entry_of(texts, number) result(name)
    character(len=*), intent(in) :: texts(:)
    integer, intent(in) :: number
    character(len=:), allocatable :: name
    name = written("")
    if (number >= 1 .and. number <= size(texts)) name = written(texts(number))
  end function entry_of

end module granumat_user_mod

subroutine user_mod(idtask, imod, isundr, istep, iter, iel, int, x, y, z, time0, dtime, props, sig0, swp0, stvar0, deps, d, bulkw, &
    sig, swp, stvar, ipl, nstat, nonsym, istrsdep, itimedep, itang, iprjdir, iprjlen, iabort)
  use granumat_kinds, only: dp
  use granumat_umat, only: N_STATEV
  use granumat_user_mod, only: evaluate, ATTRIBUTES, BULK_OF_WATER, COUNT_STATES, ELASTIC, INITIALISE, PARAMETERS, STRESS, TANGENT
  implicit none (type, external)
  integer, intent(in) :: idtask, imod, isundr, istep, iter, iel, int, iprjdir(*), iprjlen
  real(dp), intent(in) :: x, y, z, time0, dtime, props(*), sig0(*), swp0, stvar0(*), deps(*)
  real(dp), intent(inout) :: d(6, 6), bulkw, sig(*), swp, stvar(*)
  integer, intent(inout) :: ipl, nstat, nonsym, istrsdep, itimedep, itang, iabort
  real(dp) :: new_sig(6), new_stvar(N_STATEV), not_asked(6, 6)
  logical :: failed

  failed = imod /= 1
  select case (merge(0, idtask, failed))
  case (INITIALISE)                  ! states start themselves
  case (STRESS)
    call evaluate(props(:size(PARAMETERS)), sig0(:6), stvar0(:N_STATEV), deps(:6), new_sig, new_stvar, not_asked, failed)
    sig(:6) = new_sig
    stvar(:N_STATEV) = new_stvar
    swp = swp0
    if (isundr == 1) swp = swp0 + bulkw * sum(deps(:3))
    ipl = 0
  case (TANGENT, ELASTIC)            ! at no strain it is that of unloading
    call evaluate(props(:size(PARAMETERS)), sig0(:6), stvar0(:N_STATEV), merge(0.0_dp, deps(:6), idtask == ELASTIC), new_sig, &
      new_stvar, d, failed)
    if (isundr == 1) bulkw = BULK_OF_WATER * sum(d(:3, :3)) / 9
  case (COUNT_STATES)
    nstat = N_STATEV
  case (ATTRIBUTES)
    nonsym = 1
    istrsdep = 1
    itimedep = 0
    itang = 1
  case default
    failed = .true.
  end select
  iabort = merge(1, 0, failed)
end subroutine user_mod

subroutine getmodelcount(number)
  implicit none (type, external)
  integer, intent(out) :: number
  number = 1
end subroutine getmodelcount

subroutine getmodelname(imod, name)
  use granumat_user_mod, only: written
  implicit none (type, external)
  integer, intent(in) :: imod
  character(len=*), intent(out) :: name
  name = written("granumat")
end subroutine getmodelname

subroutine getparamcount(imod, number)
  use granumat_user_mod, only: PARAMETERS
  implicit none (type, external)
  integer, intent(in) :: imod
  integer, intent(out) :: number
  number = size(PARAMETERS)
end subroutine getparamcount

subroutine getparamname(imod, iparam, name)
  use granumat_umat, only: PROPERTIES
  use granumat_user_mod, only: PARAMETERS, entry_of
  implicit none (type, external)
  integer, intent(in) :: imod, iparam
  character(len=*), intent(out) :: name
  name = entry_of(PROPERTIES(PARAMETERS)%name, iparam)
end subroutine getparamname

subroutine getparamunit(imod, iparam, unit)
  use granumat_umat, only: PROPERTIES
  use granumat_user_mod, only: PARAMETERS, entry_of
  implicit none (type, external)
  integer, intent(in) :: imod, iparam
  character(len=*), intent(out) :: unit
  unit = entry_of(PROPERTIES(PARAMETERS)%unit, iparam)
end subroutine getparamunit

subroutine getstatevarcount(imod, number)
  use granumat_user_mod, only: STATES
  implicit none (type, external)
  integer, intent(in) :: imod
  integer, intent(out) :: number
  number = size(STATES)
end subroutine getstatevarcount

subroutine getstatevarname(imod, ivar, name)
  use granumat_user_mod, only: STATES, entry_of
  implicit none (type, external)
  integer, intent(in) :: imod, ivar
  character(len=*), intent(out) :: name
  name = entry_of(STATES, ivar)
end subroutine getstatevarname

subroutine getstatevarunit(imod, ivar, unit)
  use granumat_user_mod, only: STATES, written
  implicit none (type, external)
  integer, intent(in) :: imod, ivar
  character(len=*), intent(out) :: unit
  unit = written("-")
  if (ivar >= 1 .and. ivar <= size(STATES)) then
    if (STATES(ivar) == "work") unit = written("F/L^2#")
  end if
end subroutine getstatevarunit
