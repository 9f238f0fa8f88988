!> Tensors of LANES points side by side.
!!
!! Symmetric tensors are stored as Voigt components 11 22 33 12 13 23, with tensor (not engineering) shear components. Spins, skew
!! tensors, have the components W12 W13 W23. Deviators have five components in an orthonormal basis: (11 - 22)/sqrt(2),
!! (2 33 - 11 - 22)/sqrt(6), and sqrt(2) times 12, 13, 23. The double contraction X : Y of two deviators is then the dot product
!! of their components.
module granumat_tensors
  use granumat_kinds, only: dp, LANES
  use granumat_quadrature, only: INVERSE_FACTORIAL
  implicit none (type, external)
  private
  public :: trace, deviator, to_voigt, contract, magnitude, safe_magnitude, times, times_spin, add_identity, &
    product_symmetric, product_deviator, product_matrix, corotate, spin_derivative, commutator_of_spins, &
    rotation, rotation_angle, small_rotation, rotation_series, rotate, rotation_of_deviators, matrix_times, transposed_times, &
    strain_and_spin

  !> Voigt component of the tensor component i, j.
  integer, parameter, public :: VOIGT(3, 3) = reshape([1, 4, 5, 4, 2, 6, 5, 6, 3], [3, 3])

  real(dp), parameter, public :: SQRT_3 = sqrt(3.0_dp)
  real(dp), parameter :: HALF_ROOT = sqrt(0.5_dp), SIXTH_ROOT = sqrt(1 / 6.0_dp)

contains

  pure function trace(T) result(tr)
    real(dp), intent(in) :: T(LANES, 6)
    real(dp) :: tr(LANES)
    tr = T(:, 1) + T(:, 2) + T(:, 3)
  end function trace

  !> T + s I
  pure function add_identity(T, s) result(R)
    real(dp), intent(in) :: T(LANES, 6), s(LANES)
    real(dp) :: R(LANES, 6)
    integer :: k
    do k = 1, 3
      R(:, k) = T(:, k) + s
    end do
    R(:, 4:6) = T(:, 4:6)
  end function add_identity

  !> The five components of T - (tr T / 3) I.
  pure function deviator(T) result(dev)
    real(dp), intent(in) :: T(LANES, 6)
    real(dp) :: dev(LANES, 5)
    dev(:, 1) = HALF_ROOT * (T(:, 1) - T(:, 2))
    dev(:, 2) = SIXTH_ROOT * (2 * T(:, 3) - T(:, 1) - T(:, 2))
    dev(:, 3:) = 2 * HALF_ROOT * T(:, 4:)
  end function deviator

  !> The Voigt components of a deviator.
  pure function to_voigt(X) result(T)
    real(dp), intent(in) :: X(LANES, 5)
    real(dp) :: T(LANES, 6)
    T(:, 1) = HALF_ROOT * X(:, 1) - SIXTH_ROOT * X(:, 2)
    T(:, 2) = -HALF_ROOT * X(:, 1) - SIXTH_ROOT * X(:, 2)
    T(:, 3) = 2 * SIXTH_ROOT * X(:, 2)
    T(:, 4:) = HALF_ROOT * X(:, 3:)
  end function to_voigt

  !> X : Y of deviators
  pure function contract(X, Y) result(c)
    real(dp), intent(in) :: X(LANES, 5), Y(LANES, 5)
    real(dp) :: c(LANES)
    c = X(:, 1) * Y(:, 1) + X(:, 2) * Y(:, 2) + X(:, 3) * Y(:, 3) + X(:, 4) * Y(:, 4) + X(:, 5) * Y(:, 5)
  end function contract

  !> |X| = sqrt(X : X / 2) of a deviator, which the paper calls its modulus.
  pure function magnitude(X) result(m)
    real(dp), intent(in) :: X(LANES, 5)
    real(dp) :: m(LANES)
    m = sqrt(contract(X, X) / 2)
  end function magnitude

  !> |T| of a symmetric tensor, without underflow or overflow of the squares.
  pure function safe_magnitude(T) result(m)
    real(dp), intent(in) :: T(LANES, 6)
    real(dp) :: m(LANES), size(LANES), inverse(LANES), total(LANES)
    integer :: k
    size = abs(T(:, 1))
    do k = 2, 6
      size = max(size, abs(T(:, k)))
    end do
    inverse = 1 / max(size, tiny(1.0_dp))
    total = 0
    do k = 1, 6
      total = total + merge(1, 2, k <= 3) * (inverse * T(:, k))**2
    end do
    m = size * sqrt(total / 2)
  end function safe_magnitude

  !> s X of a deviator
  pure function times(s, X) result(P)
    real(dp), intent(in) :: s(LANES), X(LANES, 5)
    real(dp) :: P(LANES, 5)
    integer :: k
    do k = 1, 5
      P(:, k) = s * X(:, k)
    end do
  end function times

  !> The deviator of X Y + Y X.
  pure function product_deviator(X, Y) result(P)
    real(dp), intent(in) :: X(LANES, 5), Y(LANES, 5)
    real(dp) :: P(LANES, 5)
    P(:, 1) = HALF_ROOT * (X(:, 4) * Y(:, 4) - X(:, 5) * Y(:, 5)) - 2 * SIXTH_ROOT * (X(:, 1) * Y(:, 2) + X(:, 2) * Y(:, 1))
    P(:, 2) = SIXTH_ROOT * (X(:, 4) * Y(:, 4) + X(:, 5) * Y(:, 5) &
      + 2 * (X(:, 2) * Y(:, 2) - X(:, 1) * Y(:, 1) - X(:, 3) * Y(:, 3)))
    P(:, 3) = HALF_ROOT * (X(:, 4) * Y(:, 5) + X(:, 5) * Y(:, 4)) - 2 * SIXTH_ROOT * (X(:, 2) * Y(:, 3) + X(:, 3) * Y(:, 2))
    P(:, 4) = HALF_ROOT * (X(:, 1) * Y(:, 4) + X(:, 4) * Y(:, 1) + X(:, 3) * Y(:, 5) + X(:, 5) * Y(:, 3)) &
      + SIXTH_ROOT * (X(:, 2) * Y(:, 4) + X(:, 4) * Y(:, 2))
    P(:, 5) = HALF_ROOT * (X(:, 3) * Y(:, 4) + X(:, 4) * Y(:, 3) - X(:, 1) * Y(:, 5) - X(:, 5) * Y(:, 1)) &
      + SIXTH_ROOT * (X(:, 2) * Y(:, 5) + X(:, 5) * Y(:, 2))
  end function product_deviator

  !> The symmetric 5 x 5 matrix that takes a deviator Y to the deviator of X Y + Y X.
  pure function product_matrix(X) result(M)
    real(dp), intent(in) :: X(LANES, 5)
    real(dp) :: M(LANES, 5, 5)
    M(:, 1, 1) = -2 * SIXTH_ROOT * X(:, 2)
    M(:, 2, 1) = -2 * SIXTH_ROOT * X(:, 1)
    M(:, 3, 1) = 0
    M(:, 4, 1) = HALF_ROOT * X(:, 4)
    M(:, 5, 1) = -HALF_ROOT * X(:, 5)
    M(:, 1, 2) = M(:, 2, 1)
    M(:, 2, 2) = 2 * SIXTH_ROOT * X(:, 2)
    M(:, 3, 2) = -2 * SIXTH_ROOT * X(:, 3)
    M(:, 4, 2) = SIXTH_ROOT * X(:, 4)
    M(:, 5, 2) = SIXTH_ROOT * X(:, 5)
    M(:, 1, 3) = 0
    M(:, 2, 3) = M(:, 3, 2)
    M(:, 3, 3) = M(:, 1, 1)
    M(:, 4, 3) = HALF_ROOT * X(:, 5)
    M(:, 5, 3) = HALF_ROOT * X(:, 4)
    M(:, 1, 4) = M(:, 4, 1)
    M(:, 2, 4) = M(:, 4, 2)
    M(:, 3, 4) = M(:, 4, 3)
    M(:, 4, 4) = HALF_ROOT * X(:, 1) + SIXTH_ROOT * X(:, 2)
    M(:, 5, 4) = HALF_ROOT * X(:, 3)
    M(:, 1, 5) = M(:, 5, 1)
    M(:, 2, 5) = M(:, 5, 2)
    M(:, 3, 5) = M(:, 5, 3)
    M(:, 4, 5) = M(:, 5, 4)
    M(:, 5, 5) = -HALF_ROOT * X(:, 1) + SIXTH_ROOT * X(:, 2)
  end function product_matrix

  !> X Y + Y X
  pure function product_symmetric(X, Y) result(P)
    real(dp), intent(in) :: X(LANES, 6), Y(LANES, 6)
    real(dp) :: P(LANES, 6)
    P(:, 1) = 2 * (X(:, 1) * Y(:, 1) + X(:, 4) * Y(:, 4) + X(:, 5) * Y(:, 5))
    P(:, 2) = 2 * (X(:, 4) * Y(:, 4) + X(:, 2) * Y(:, 2) + X(:, 6) * Y(:, 6))
    P(:, 3) = 2 * (X(:, 5) * Y(:, 5) + X(:, 6) * Y(:, 6) + X(:, 3) * Y(:, 3))
    P(:, 4) = X(:, 1) * Y(:, 4) + X(:, 4) * Y(:, 2) + X(:, 5) * Y(:, 6) + Y(:, 1) * X(:, 4) + Y(:, 4) * X(:, 2) + Y(:, 5) * X(:, 6)
    P(:, 5) = X(:, 1) * Y(:, 5) + X(:, 4) * Y(:, 6) + X(:, 5) * Y(:, 3) + Y(:, 1) * X(:, 5) + Y(:, 4) * X(:, 6) + Y(:, 5) * X(:, 3)
    P(:, 6) = X(:, 4) * Y(:, 5) + X(:, 2) * Y(:, 6) + X(:, 6) * Y(:, 3) + Y(:, 4) * X(:, 5) + Y(:, 2) * X(:, 6) + Y(:, 6) * X(:, 3)
  end function product_symmetric

  !> W X - X W, the rate of change of a deviator that rotates with the spin W.
  pure function corotate(w, X) result(dot_X)
    real(dp), intent(in) :: w(LANES, 3), X(LANES, 5)
    real(dp) :: dot_X(LANES, 5)
    dot_X(:, 1) = 2 * w(:, 1) * X(:, 3) + w(:, 2) * X(:, 4) - w(:, 3) * X(:, 5)
    dot_X(:, 2) = -SQRT_3 * (w(:, 2) * X(:, 4) + w(:, 3) * X(:, 5))
    dot_X(:, 3) = -2 * w(:, 1) * X(:, 1) + w(:, 2) * X(:, 5) + w(:, 3) * X(:, 4)
    dot_X(:, 4) = w(:, 2) * (SQRT_3 * X(:, 2) - X(:, 1)) + w(:, 1) * X(:, 5) - w(:, 3) * X(:, 3)
    dot_X(:, 5) = w(:, 3) * (SQRT_3 * X(:, 2) + X(:, 1)) - w(:, 1) * X(:, 4) - w(:, 2) * X(:, 3)
  end function corotate

  !> The derivative of Y : (W X - X W) by the components of the spin W.
  pure function spin_derivative(Y, X) result(m)
    real(dp), intent(in) :: Y(LANES, 5), X(LANES, 5)
    real(dp) :: m(LANES, 3)
    m(:, 1) = 2 * (Y(:, 1) * X(:, 3) - Y(:, 3) * X(:, 1)) + Y(:, 4) * X(:, 5) - Y(:, 5) * X(:, 4)
    m(:, 2) = (Y(:, 1) - SQRT_3 * Y(:, 2)) * X(:, 4) + Y(:, 3) * X(:, 5) &
      + Y(:, 4) * (SQRT_3 * X(:, 2) - X(:, 1)) - Y(:, 5) * X(:, 3)
    m(:, 3) = Y(:, 3) * X(:, 4) - (Y(:, 1) + SQRT_3 * Y(:, 2)) * X(:, 5) &
      + Y(:, 5) * (SQRT_3 * X(:, 2) + X(:, 1)) - Y(:, 4) * X(:, 3)
  end function spin_derivative

  !> The rotation exp(W).
  pure function rotation(w) result(R)
    real(dp), intent(in) :: w(LANES, 3)
    real(dp) :: R(LANES, 3, 3), angle(LANES), first(LANES), second(LANES)

    angle = max(rotation_angle(w), 1.0e-100_dp)       ! where both factors are 1 and 1/2
    first = sin(angle) / angle
    second = (sin(angle / 2) / (angle / 2))**2 / 2
    R = rotation_of(w, first, second)
  end function rotation

  !> The angle of the rotation exp(W).
  pure function rotation_angle(w) result(angle)
    real(dp), intent(in) :: w(LANES, 3)
    real(dp) :: angle(LANES)
    angle = sqrt(w(:, 1)**2 + w(:, 2)**2 + w(:, 3)**2)
  end function rotation_angle

  !> The rotation exp(W) for angles up to 0.2, in vector instructions.
  pure function small_rotation(w) result(R)
    real(dp), intent(in) :: w(LANES, 3)
    real(dp) :: R(LANES, 3, 3), second(LANES), third(LANES)
    call rotation_series(w, second, third)
    R = rotation_of(w, 1 - third * (w(:, 1)**2 + w(:, 2)**2 + w(:, 3)**2), second)
  end function small_rotation

  !> Rodrigues' formula I + first W + second W W with first = sin(a)/a and second = (1 - cos(a))/a^2, a the angle of W.
  pure function rotation_of(w, first, second) result(R)
    real(dp), intent(in) :: w(LANES, 3), first(LANES), second(LANES)
    real(dp) :: R(LANES, 3, 3), x(LANES), y(LANES), z(LANES)

    x = -w(:, 3)                                    ! axial vector
    y = w(:, 2)
    z = -w(:, 1)
    R(:, 1, 1) = 1 - second * (y**2 + z**2)
    R(:, 2, 2) = 1 - second * (x**2 + z**2)
    R(:, 3, 3) = 1 - second * (x**2 + y**2)
    R(:, 1, 2) = second * x * y - first * z
    R(:, 2, 1) = second * x * y + first * z
    R(:, 1, 3) = second * x * z + first * y
    R(:, 3, 1) = second * x * z - first * y
    R(:, 2, 3) = second * y * z - first * x
    R(:, 3, 2) = second * y * z + first * x
  end function rotation_of

  !> second = (1 - cos(a))/a^2 and third = (a - sin(a))/a^3 of the angle a of W, to round-off for a <= 0.2.
  pure subroutine rotation_series(w, second, third)
    real(dp), intent(in) :: w(LANES, 3)
    real(dp), intent(out) :: second(LANES), third(LANES)
    real(dp) :: square(LANES)
    square = w(:, 1)**2 + w(:, 2)**2 + w(:, 3)**2
    associate (c => INVERSE_FACTORIAL)
      second = c(2) - square * (c(4) - square * (c(6) - square * (c(8) - square * c(10))))
      third = c(3) - square * (c(5) - square * (c(7) - square * (c(9) - square * c(11))))
    end associate
  end subroutine rotation_series

  !> s W
  pure function times_spin(s, w) result(p)
    real(dp), intent(in) :: s(LANES), w(LANES, 3)
    real(dp) :: p(LANES, 3)
    integer :: k
    do k = 1, 3
      p(:, k) = s * w(:, k)
    end do
  end function times_spin

  !> The spin V W - W V.
  pure function commutator_of_spins(v, w) result(c)
    real(dp), intent(in) :: v(LANES, 3), w(LANES, 3)
    real(dp) :: c(LANES, 3)
    c(:, 1) = v(:, 3) * w(:, 2) - v(:, 2) * w(:, 3)
    c(:, 2) = v(:, 1) * w(:, 3) - v(:, 3) * w(:, 1)
    c(:, 3) = v(:, 2) * w(:, 1) - v(:, 1) * w(:, 2)
  end function commutator_of_spins

  !> R T R^T
  pure function rotate(R, T) result(rotated)
    real(dp), intent(in) :: R(LANES, 3, 3), T(LANES, 6)
    real(dp) :: rotated(LANES, 6), RT(LANES, 3, 3)
    integer :: i

    do i = 1, 3
      RT(:, i, 1) = R(:, i, 1) * T(:, 1) + R(:, i, 2) * T(:, 4) + R(:, i, 3) * T(:, 5)
      RT(:, i, 2) = R(:, i, 1) * T(:, 4) + R(:, i, 2) * T(:, 2) + R(:, i, 3) * T(:, 6)
      RT(:, i, 3) = R(:, i, 1) * T(:, 5) + R(:, i, 2) * T(:, 6) + R(:, i, 3) * T(:, 3)
      rotated(:, i) = RT(:, i, 1) * R(:, i, 1) + RT(:, i, 2) * R(:, i, 2) + RT(:, i, 3) * R(:, i, 3)
    end do
    rotated(:, 4) = RT(:, 1, 1) * R(:, 2, 1) + RT(:, 1, 2) * R(:, 2, 2) + RT(:, 1, 3) * R(:, 2, 3)
    rotated(:, 5) = RT(:, 1, 1) * R(:, 3, 1) + RT(:, 1, 2) * R(:, 3, 2) + RT(:, 1, 3) * R(:, 3, 3)
    rotated(:, 6) = RT(:, 2, 1) * R(:, 3, 1) + RT(:, 2, 2) * R(:, 3, 2) + RT(:, 2, 3) * R(:, 3, 3)
  end function rotate

  !> The 5 x 5 matrix of X -> R X R^T for deviators X. Of R = I it is the identity to the last bit.
  pure function rotation_of_deviators(R) result(M)
    real(dp), intent(in) :: R(LANES, 3, 3)
    real(dp) :: M(LANES, 5, 5), dyad(5, 6), xx, yy
    integer, parameter :: AXES(2, 6) = reshape([1, 1, 2, 2, 3, 3, 1, 2, 1, 3, 2, 3], [2, 6])
    real(dp), parameter :: SCALE(5) = [1.0_dp, 1 / SQRT_3, 1.0_dp, 1.0_dp, 1.0_dp]
    real(dp), parameter :: SCALE_2(5) = [1 / SQRT_3, 1 / 3.0_dp, 1 / SQRT_3, 1 / SQRT_3, 1 / SQRT_3]
    integer :: i, k, a, b

    do i = 1, LANES
      do k = 1, 6                             ! the deviator of the symmetric dyad of two columns of R
        a = AXES(1, k)
        b = AXES(2, k)
        xx = R(i, 1, a) * R(i, 1, b)
        yy = R(i, 2, a) * R(i, 2, b)
        dyad(1, k) = xx - yy
        dyad(2, k) = 2 * R(i, 3, a) * R(i, 3, b) - xx - yy
        dyad(3, k) = R(i, 1, a) * R(i, 2, b) + R(i, 2, a) * R(i, 1, b)
        dyad(4, k) = R(i, 1, a) * R(i, 3, b) + R(i, 3, a) * R(i, 1, b)
        dyad(5, k) = R(i, 2, a) * R(i, 3, b) + R(i, 3, a) * R(i, 2, b)
      end do
      do k = 1, 5
        M(i, k, 1) = SCALE(k) / 2 * (dyad(k, 1) - dyad(k, 2))
        M(i, k, 2) = SCALE_2(k) / 2 * (2 * dyad(k, 3) - dyad(k, 1) - dyad(k, 2))
        M(i, k, 3) = SCALE(k) * dyad(k, 4)
        M(i, k, 4) = SCALE(k) * dyad(k, 5)
        M(i, k, 5) = SCALE(k) * dyad(k, 6)
      end do
    end do
  end function rotation_of_deviators

  !> M X
  pure function matrix_times(M, X) result(P)
    real(dp), intent(in) :: M(LANES, 5, 5), X(LANES, 5)
    real(dp) :: P(LANES, 5)
    integer :: i, j
    do i = 1, LANES
      do j = 1, 5
        P(i, j) = M(i, j, 1) * X(i, 1) + M(i, j, 2) * X(i, 2) + M(i, j, 3) * X(i, 3) + M(i, j, 4) * X(i, 4) + M(i, j, 5) * X(i, 5)
      end do
    end do
  end function matrix_times

  !> M^T X
  pure function transposed_times(M, X) result(P)
    real(dp), intent(in) :: M(LANES, 5, 5), X(LANES, 5)
    real(dp) :: P(LANES, 5)
    integer :: i, j
    do i = 1, LANES
      do j = 1, 5
        P(i, j) = M(i, 1, j) * X(i, 1) + M(i, 2, j) * X(i, 2) + M(i, 3, j) * X(i, 3) + M(i, 4, j) * X(i, 4) + M(i, 5, j) * X(i, 5)
      end do
    end do
  end function transposed_times

  !> Strain (engineering shears) and spin of displacement gradients G(j, i) = du_i/dx_j, in the memory order of C and numpy.
  pure subroutine strain_and_spin(G, strain, spin)
    real(dp), intent(in) :: G(:, :, :)                       ! (3, 3, n), n <= LANES; the remaining lanes get zeros
    real(dp), intent(out) :: strain(LANES, 6), spin(LANES, 3)
    integer :: i

    strain = 0
    spin = 0
    do i = 1, size(G, 3)
      strain(i, :) = [G(1, 1, i), G(2, 2, i), G(3, 3, i), G(1, 2, i) + G(2, 1, i), G(1, 3, i) + G(3, 1, i), G(2, 3, i) + G(3, 2, i)]
      spin(i, :) = [G(2, 1, i) - G(1, 2, i), G(3, 1, i) - G(1, 3, i), G(3, 2, i) - G(2, 3, i)] / 2
    end do
  end subroutine strain_and_spin

end module granumat_tensors
