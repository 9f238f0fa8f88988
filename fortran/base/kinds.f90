!> The floating-point kind, and how many points are computed side by side.
module granumat_kinds
  use, intrinsic :: iso_fortran_env, only: real64
  implicit none (type, external)
  private

  integer, parameter, public :: dp = real64

  !> Points side by side ("lanes"): the first index of every array of the core, so that each formula becomes vector instructions.
  integer, parameter, public :: LANES = 8     ! one vector of AVX-512, two of AVX2, four of SSE2

end module granumat_kinds
