!> The one floating-point kind of granumat.
module granumat_kinds
  use, intrinsic :: iso_fortran_env, only: real64
  implicit none (type, external)
  private

  integer, parameter, public :: dp = real64

end module granumat_kinds
