!> What a routine can report, and the words for it: one table for Python and for finite-element hosts.
module granumat_status
  implicit none (type, external)
  private
  public :: status_message

  integer, parameter, public :: OK = 0
  integer, parameter, public :: NOT_FINITE = 1
  integer, parameter, public :: BAD_PARAMETERS = 2
  integer, parameter, public :: BAD_VOLUME_FRACTION = 3
  integer, parameter, public :: BAD_FABRIC = 4
  integer, parameter, public :: INCREMENT_TOO_LARGE = 5
  integer, parameter, public :: FABRIC_BLOWS_UP = 6
  integer, parameter, public :: TENSILE_PRESSURE = 7
  integer, parameter, public :: RESULT_NOT_FINITE = 8
  integer, parameter, public :: TARGET_NOT_REACHED = 9
  integer, parameter, public :: NOT_CONVERGED = 10
  integer, parameter, public :: BAD_LAYOUT = 11
  integer, parameter, public :: BAD_SENTINEL = 12
  integer, parameter, public :: BAD_INITIAL_STATE = 13
  integer, parameter, public :: BAD_DEFORMATION = 14
  integer, parameter, public :: PLANE_STRESS = 15
  integer, parameter, public :: STRAIN_TOO_LARGE = 16
  integer, parameter, public :: BAD_NONLOCAL_STRAIN = 17

  integer, parameter, public :: MESSAGE_LENGTH = 120

contains

  !> The message of a status, blank padded.
  pure function status_message(status) result(message)
    integer, intent(in) :: status
    character(len=MESSAGE_LENGTH) :: message

    select case (status)
    case (OK)
      message = "done"
    case (NOT_FINITE)
      message = "the state or the increment holds a value that is not finite"
    case (BAD_PARAMETERS)
      message = "a material constant is outside its range"
    case (BAD_VOLUME_FRACTION)
      message = "the volume fraction is, or would become, outside (0, 1)"
    case (BAD_FABRIC)
      message = "the fabric is not realisable: eigenvalues of A + I/3 outside [0, 1], or A not traceless"
    case (INCREMENT_TOO_LARGE)
      message = "the increment is beyond what one update integrates: more than 10000 substeps"
    case (FABRIC_BLOWS_UP)
      message = "the fabric equation (4.7), or the method that integrates it, blows up within the increment"
    case (TENSILE_PRESSURE)
      message = "a1 + a2 abs(A) + g tr D^ is negative: the pressure would be tensile"
    case (RESULT_NOT_FINITE)
      message = "the result is not finite"
    case (TARGET_NOT_REACHED)
      message = "the prescribed stress cannot be reached, however small the increment"
    case (NOT_CONVERGED)
      message = "Newton's method does not converge: the increment is too large for it"
    case (BAD_LAYOUT)
      message = "UMAT needs NTENS 6 or 4, NSTATV of at least 23 and NPROPS from 6 to 10"
    case (BAD_SENTINEL)
      message = "STATEV(1) is neither 0 (the state starts) nor 1 (it has): the states are not this material's"
    case (BAD_INITIAL_STATE)
      message = "initial state: the pressure over the stiffness is negative, or so large that Z2 is above 12 or phi above 1"
    case (BAD_DEFORMATION)
      message = "DROT, or DFGRD0 and DFGRD1, that PROPS asks for are missing, no deformation, or turn by more than 3 in one step"
    case (PLANE_STRESS)
      message = "plane stress (NTENS 3): a material without cohesion bears no load with a principal stress of zero"
    case (STRAIN_TOO_LARGE)
      message = "the strain of one call, abs(D), is above 1: the host is to take a smaller increment"
    case (BAD_NONLOCAL_STRAIN)
      message = "the nonlocal strain is negative, not finite, or 0 where the material strains"
    case default
      message = "unknown status"
    end select
  end function status_message

end module granumat_status
