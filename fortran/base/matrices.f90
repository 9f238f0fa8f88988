!> Small matrices of LANES points side by side: 3 x 3 algebra, logarithms, polar decomposition, linear equations.
module granumat_matrices
  use granumat_kinds, only: dp, LANES
  use granumat_tensors, only: VOIGT
  implicit none (type, external)
  private
  public :: to_matrix, trace_of, product_of, determinant, invert, middle_to_logarithm, gradient_logarithm, rotation_logarithm, &
    polar_rotation, solve_linear

  integer, parameter :: MAX_TERMS = 40                     ! of the series of the logarithm
  real(dp), parameter :: SERIES_UP_TO = 0.2_dp             ! largest entry of F - I for which gradient_logarithm takes no root first
  integer, parameter :: MAX_ROOTS = 8, MAX_ITERATIONS = 20
  real(dp), parameter :: ITERATION_CONVERGED = 1.0e-8_dp   ! last change; convergence is quadratic, so the next one is its square
  real(dp), parameter :: ROTATION_ERROR = 1.0e-6_dp        ! of R^T R - I: codes that store single precision reach 1e-7

contains

  !> The matrix of a symmetric tensor's Voigt components.
  pure function to_matrix(T) result(M)
    real(dp), intent(in) :: T(LANES, 6)
    real(dp) :: M(LANES, 3, 3)
    integer :: i, j
    do j = 1, 3
      do i = 1, 3
        M(:, i, j) = T(:, VOIGT(i, j))
      end do
    end do
  end function to_matrix

  pure function trace_of(M) result(tr)
    real(dp), intent(in) :: M(LANES, 3, 3)
    real(dp) :: tr(LANES)
    tr = M(:, 1, 1) + M(:, 2, 2) + M(:, 3, 3)
  end function trace_of

  !> A B
  pure function product_of(A, B) result(C)
    real(dp), intent(in), dimension(LANES, 3, 3) :: A, B
    real(dp) :: C(LANES, 3, 3)
    integer :: i, j
    do j = 1, 3
      do i = 1, 3
        C(:, i, j) = A(:, i, 1) * B(:, 1, j) + A(:, i, 2) * B(:, 2, j) + A(:, i, 3) * B(:, 3, j)
      end do
    end do
  end function product_of

  pure function identity() result(I)
    real(dp) :: I(LANES, 3, 3)
    I = spread(reshape([1.0_dp, 0.0_dp, 0.0_dp, 0.0_dp, 1.0_dp, 0.0_dp, 0.0_dp, 0.0_dp, 1.0_dp], [3, 3]), 1, LANES)
  end function identity

  pure function determinant(M) result(det)
    real(dp), intent(in) :: M(LANES, 3, 3)
    real(dp) :: det(LANES)
    det = sum(cross(M(:, :, 2), M(:, :, 3)) * M(:, :, 1), 2)
  end function determinant

  pure function cross(a, b) result(c)
    real(dp), intent(in), dimension(LANES, 3) :: a, b
    real(dp) :: c(LANES, 3)
    c(:, 1) = a(:, 2) * b(:, 3) - a(:, 3) * b(:, 2)
    c(:, 2) = a(:, 3) * b(:, 1) - a(:, 1) * b(:, 3)
    c(:, 3) = a(:, 1) * b(:, 2) - a(:, 2) * b(:, 1)
  end function cross

  !> The inverse, 0 where there is none, and the determinant.
  pure subroutine invert(M, inverse, det)
    real(dp), intent(in) :: M(LANES, 3, 3)
    real(dp), intent(out) :: inverse(LANES, 3, 3), det(LANES)
    real(dp) :: factor(LANES)
    integer :: i, j
    inverse(:, 1, :) = cross(M(:, :, 2), M(:, :, 3))
    inverse(:, 2, :) = cross(M(:, :, 3), M(:, :, 1))
    inverse(:, 3, :) = cross(M(:, :, 1), M(:, :, 2))
    det = inverse(:, 1, 1) * M(:, 1, 1) + inverse(:, 1, 2) * M(:, 2, 1) + inverse(:, 1, 3) * M(:, 3, 1)
    factor = merge(1 / det, 0.0_dp, abs(det) > 0)
    do j = 1, 3
      do i = 1, 3
        inverse(:, i, j) = factor * inverse(:, i, j)
      end do
    end do
  end subroutine invert

  !> G = 2 (F - I)(F + I)^-1, the displacement gradient by the position half way, becomes log F = 2 artanh(G/2).
  pure subroutine middle_to_logarithm(G, converged)
    real(dp), intent(inout) :: G(LANES, 3, 3)
    logical, intent(out) :: converged(LANES)
    real(dp), dimension(LANES, 3, 3) :: square, power, term
    real(dp) :: largest(LANES), last(LANES)
    integer :: i, j, m

    square = product_of(G, G) / 4
    power = G
    converged = .false.
    do m = 1, MAX_TERMS
      power = product_of(power, square)
      term = power / (2 * m + 1)
      largest = 0
      last = 0
      do j = 1, 3
        do i = 1, 3
          G(:, i, j) = G(:, i, j) + merge(0.0_dp, term(:, i, j), converged)
          largest = max(largest, abs(G(:, i, j)))
          last = max(last, abs(term(:, i, j)))
        end do
      end do
      converged = converged .or. last <= epsilon(1.0_dp) * largest / 2
      if (all(converged)) exit
    end do
  end subroutine middle_to_logarithm

  !> The logarithm of F1 F0^-1 for rotations up to pi: by middle_to_logarithm, after as many square roots as its series needs.
  pure subroutine gradient_logarithm(F0, F1, L, found)
    real(dp), intent(in) :: F0(LANES, 3, 3), F1(LANES, 3, 3)
    real(dp), intent(out) :: L(LANES, 3, 3)
    logical, intent(out) :: found(LANES)
    real(dp), dimension(LANES, 3, 3) :: f, change, inverse
    real(dp) :: det_0(LANES), det(LANES)
    logical :: small(LANES), converged(LANES)
    integer :: roots(LANES), attempt

    call invert(F0, inverse, det_0)
    change = product_of(F1 - F0, inverse)                ! f - I, without cancellation
    f = identity() + change
    found = abs(det_0) > 0 .and. determinant(f) > 0
    roots = 0
    do attempt = 0, MAX_ROOTS
      small = maxval(maxval(abs(change), 3), 2) <= SERIES_UP_TO
      if (all(small .or. .not. found) .or. attempt == MAX_ROOTS) exit
      call take_root(.not. small, f, found)
      change = merge(change, f - identity(), spread(spread(small, 2, 3), 3, 3))
      roots = roots + merge(0, 1, small)
    end do
    call invert(f + identity(), inverse, det)
    L = 2 * product_of(change, inverse)
    call middle_to_logarithm(L, converged)
    found = found .and. small .and. converged
    L = L * spread(spread(2.0_dp**roots, 2, 3), 3, 3)
  end subroutine gradient_logarithm

  !> Square roots in the lanes named, not found of half a turn: E. D. Denman, A. N. Beavers, Appl. Math. Comput. 2 (1976) 63-94.
  pure subroutine take_root(lane, f, found)
    logical, intent(in) :: lane(LANES)
    real(dp), intent(inout) :: f(LANES, 3, 3)
    logical, intent(inout) :: found(LANES)
    real(dp), dimension(LANES, 3, 3) :: root, reciprocal, next, inverse
    real(dp) :: det(LANES), change
    integer :: k

    root = f
    reciprocal = identity()
    do k = 1, MAX_ITERATIONS
      call invert(reciprocal, inverse, det)
      found = found .and. (abs(det) > 0 .or. .not. lane)
      next = (root + inverse) / 2
      call invert(root, inverse, det)
      found = found .and. (abs(det) > 0 .or. .not. lane)
      reciprocal = (reciprocal + inverse) / 2
      change = maxval(abs(next - root))
      root = next
      if (change < ITERATION_CONVERGED) exit
    end do
    f = merge(root, f, spread(spread(lane, 2, 3), 3, 3))
  end subroutine take_root

  !> The logarithm of a rotation by less than pi.
  pure subroutine rotation_logarithm(R, W, found)
    real(dp), intent(in) :: R(LANES, 3, 3)
    real(dp), intent(out) :: W(LANES, 3, 3)
    logical, intent(out) :: found(LANES)
    real(dp) :: sine(LANES), cosine(LANES), product(LANES), factor(LANES)
    integer :: i, j

    do j = 1, 3
      do i = 1, 3
        W(:, i, j) = (R(:, i, j) - R(:, j, i)) / 2
      end do
    end do
    sine = sqrt(W(:, 1, 2)**2 + W(:, 1, 3)**2 + W(:, 2, 3)**2)
    cosine = (trace_of(R) - 1) / 2
    found = abs(sine**2 + cosine**2 - 1) < ROTATION_ERROR &    ! false of a reflection
      .and. (sine > 0 .or. cosine > 0)                         ! false of half a turn
    factor = 1
    where (sine > 0) factor = atan2(sine, cosine) / sine
    do j = 1, 3
      do i = 1, 3
        product = R(:, 1, i) * R(:, 1, j) + R(:, 2, i) * R(:, 2, j) + R(:, 3, i) * R(:, 3, j)
        found = found .and. abs(product - merge(1, 0, i == j)) < ROTATION_ERROR
        W(:, i, j) = factor * W(:, i, j)
      end do
    end do
  end subroutine rotation_logarithm

  !> R of F = R U: N. J. Higham, SIAM J. Sci. Stat. Comput. 7 (1986) 1160-1174.
  pure function polar_rotation(F) result(R)
    real(dp), intent(in) :: F(LANES, 3, 3)
    real(dp), dimension(LANES, 3, 3) :: R, next, inverse
    real(dp) :: det(LANES), change
    integer :: i, k

    R = F
    do k = 1, MAX_ITERATIONS
      call invert(R, inverse, det)
      do i = 1, 3
        next(:, :, i) = (R(:, :, i) + inverse(:, i, :)) / 2
      end do
      change = maxval(abs(next - R))
      R = next
      if (change < ITERATION_CONVERGED) exit
    end do
  end function polar_rotation

  !> Solves matrix x = b in place of b by Gaussian elimination, exchanging a row with the pivot's wherever its entry is larger.
  pure subroutine solve_linear(matrix, x, determinant_sign)
    real(dp), intent(in) :: matrix(:, :, :)                  ! (LANES, n, n)
    real(dp), intent(inout) :: x(:, :)                       ! (LANES, n)
    real(dp), intent(out) :: determinant_sign(LANES)         ! 1 or -1; 0 where the matrix is singular
    real(dp) :: m(LANES, size(x, 2), size(x, 2)), factor(LANES), kept(LANES)
    logical :: exchange(LANES)
    integer :: i, j, k, n

    n = size(x, 2)
    m = matrix(:LANES, :, :)
    determinant_sign = 1
    do k = 1, n
      do i = k + 1, n
        exchange = abs(m(:, i, k)) > abs(m(:, k, k))
        determinant_sign = merge(-determinant_sign, determinant_sign, exchange)
        do j = k, n
          kept = m(:, k, j)
          m(:, k, j) = merge(m(:, i, j), kept, exchange)
          m(:, i, j) = merge(kept, m(:, i, j), exchange)
        end do
        kept = x(:LANES, k)
        x(:LANES, k) = merge(x(:LANES, i), kept, exchange)
        x(:LANES, i) = merge(kept, x(:LANES, i), exchange)
        factor = merge(m(:, i, k) / m(:, k, k), 0.0_dp, abs(m(:, k, k)) > 0)
        do j = k + 1, n
          m(:, i, j) = m(:, i, j) - factor * m(:, k, j)
        end do
        x(:LANES, i) = x(:LANES, i) - factor * x(:LANES, k)
      end do
      determinant_sign = merge(sign(determinant_sign, determinant_sign * m(:, k, k)), 0.0_dp, abs(m(:, k, k)) > 0)
    end do
    do k = n, 1, -1
      do j = k + 1, n
        x(:LANES, k) = x(:LANES, k) - m(:, k, j) * x(:LANES, j)
      end do
      x(:LANES, k) = merge(x(:LANES, k) / m(:, k, k), x(:LANES, k), abs(m(:, k, k)) > 0)
    end do
  end subroutine solve_linear

end module granumat_matrices
