!> The fabric equation (4.7) under a constant velocity gradient, solved exactly.
!!
!! With A = B/y it is linear: B' = c1 S y + c2 |D| B + W B - B W, y' = -c3 B:S, B(0) = A, y(0) = 1.
!! The Taylor series of the exponential's action on (A, 1) gives B and y anywhere in the increment, and A:S = -y'/(c3 y).
module granumat_fabric
  use granumat_kinds, only: dp
  use granumat_parameters, only: material_parameters
  use granumat_tensors, only: contract, corotate
  implicit none (type, external)
  private
  public :: solve_fabric, fabric_at, y_at, projection_at, fabric_rate

  integer, parameter :: MAX_TERMS = 20
  real(dp), parameter :: SERIES_REST = 1.0e-17_dp   ! first neglected term over the solution: below round-off

  !> Taylor coefficients of B and y in t, 0 <= t <= 1 over the increment.
  type, public :: fabric_solution
    integer :: terms
    real(dp) :: c3
    real(dp) :: B(6, 0:MAX_TERMS), y(0:MAX_TERMS)
  end type fabric_solution

contains

  !> Bound of the exponential's argument per increment: how fast anything in (4.7) can change.
  pure function fabric_rate(par, mod_D, w) result(rate)
    type(material_parameters), intent(in) :: par
    real(dp), intent(in) :: mod_D, w(3)
    real(dp) :: rate
    rate = (abs(par%c2) + sqrt(-2 * par%c1 * par%c3)) * mod_D + 2 * norm2(w)
  end function fabric_rate

  !> Solves (4.7) over one increment; accurate to round-off for fabric_rate <= 1.
  pure function solve_fabric(par, A, S, mod_D, w) result(solution)
    type(material_parameters), intent(in) :: par
    real(dp), intent(in) :: A(6)      ! fabric at t = 0
    real(dp), intent(in) :: S(6)      ! deviatoric strain increment
    real(dp), intent(in) :: mod_D     ! |D| of the strain increment
    real(dp), intent(in) :: w(3)      ! spin increment
    type(fabric_solution) :: solution
    real(dp) :: rate, rest
    integer :: k

    rate = fabric_rate(par, mod_D, w)
    solution%c3 = par%c3
    solution%B(:, 0) = A
    solution%y(0) = 1
    rest = 1
    do k = 1, MAX_TERMS
      associate (B => solution%B(:, k - 1), y => solution%y(k - 1))
        solution%B(:, k) = (par%c1 * y * S + par%c2 * mod_D * B + corotate(w, B)) / k
        solution%y(k) = -par%c3 * contract(B, S) / k
      end associate
      solution%terms = k
      rest = rest * rate / k
      if (rest < SERIES_REST) exit
    end do
  end function solve_fabric

  !> A at t.
  pure function fabric_at(solution, t) result(A)
    type(fabric_solution), intent(in) :: solution
    real(dp), intent(in) :: t
    real(dp) :: A(6)
    integer :: k

    A = solution%B(:, solution%terms)
    do k = solution%terms - 1, 0, -1
      A = A * t + solution%B(:, k)
    end do
    A = A / y_at(solution, t)
  end function fabric_at

  !> y at t: positive as long as the fabric has not blown up.
  pure function y_at(solution, t) result(y)
    type(fabric_solution), intent(in) :: solution
    real(dp), intent(in) :: t
    real(dp) :: y
    integer :: k

    y = solution%y(solution%terms)
    do k = solution%terms - 1, 0, -1
      y = y * t + solution%y(k)
    end do
  end function y_at

  !> A:S = -y'/(c3 y) at t.
  pure function projection_at(solution, t) result(A_S)
    type(fabric_solution), intent(in) :: solution
    real(dp), intent(in) :: t
    real(dp) :: A_S, dot_y
    integer :: k

    dot_y = solution%terms * solution%y(solution%terms)
    do k = solution%terms - 1, 1, -1
      dot_y = dot_y * t + k * solution%y(k)
    end do
    A_S = -dot_y / (solution%c3 * y_at(solution, t))
  end function projection_at

end module granumat_fabric
