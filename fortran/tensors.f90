!> Tensors of LANES points at once, the points innermost, so that every formula is a vector instruction.
!!
!! Symmetric tensors are six components 11 22 33 12 13 23 (tensor shear components), spins three: W12 W13 W23.
module granumat_tensors
  use granumat_kinds, only: dp
  implicit none (type, external)
  private
  public :: trace, deviator, contract, modulus, safe_modulus, times, product_symmetric, rotation, small_rotation, rotation_change, &
    rotate, corotate, add_identity, strain_and_spin, times_spin

  integer, parameter, public :: LANES = 8     ! one vector of AVX-512, two of AVX2, four of SSE2

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

  pure function deviator(T) result(dev)
    real(dp), intent(in) :: T(LANES, 6)
    real(dp) :: dev(LANES, 6)
    dev = add_identity(T, -trace(T) / 3)
  end function deviator

  !> X : Y
  pure function contract(X, Y) result(c)
    real(dp), intent(in) :: X(LANES, 6), Y(LANES, 6)
    real(dp) :: c(LANES)
    c = X(:, 1) * Y(:, 1) + X(:, 2) * Y(:, 2) + X(:, 3) * Y(:, 3) &
      + 2 * (X(:, 4) * Y(:, 4) + X(:, 5) * Y(:, 5) + X(:, 6) * Y(:, 6))
  end function contract

  !> |T| = sqrt(T : T / 2), the paper's modulus.
  pure function modulus(T) result(m)
    real(dp), intent(in) :: T(LANES, 6)
    real(dp) :: m(LANES)
    m = sqrt(contract(T, T) / 2)
  end function modulus

  !> |T|, safe from underflow and overflow.
  pure function safe_modulus(T) result(m)
    real(dp), intent(in) :: T(LANES, 6)
    real(dp) :: m(LANES), size(LANES)
    integer :: k
    size = abs(T(:, 1))
    do k = 2, 6
      size = max(size, abs(T(:, k)))
    end do
    m = size * modulus(times(1 / max(size, tiny(1.0_dp)), T))
  end function safe_modulus

  !> s T
  pure function times(s, T) result(P)
    real(dp), intent(in) :: s(LANES), T(LANES, 6)
    real(dp) :: P(LANES, 6)
    integer :: k
    do k = 1, 6
      P(:, k) = s * T(:, k)
    end do
  end function times

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

  !> W T - T W, the rate of a tensor carried along by the spin w.
  pure function corotate(w, T) result(dot_T)
    real(dp), intent(in) :: w(LANES, 3), T(LANES, 6)
    real(dp) :: dot_T(LANES, 6)
    dot_T(:, 1) = 2 * (w(:, 1) * T(:, 4) + w(:, 2) * T(:, 5))
    dot_T(:, 2) = 2 * (w(:, 3) * T(:, 6) - w(:, 1) * T(:, 4))
    dot_T(:, 3) = -2 * (w(:, 2) * T(:, 5) + w(:, 3) * T(:, 6))
    dot_T(:, 4) = w(:, 1) * (T(:, 2) - T(:, 1)) + w(:, 2) * T(:, 6) + w(:, 3) * T(:, 5)
    dot_T(:, 5) = w(:, 2) * (T(:, 3) - T(:, 1)) + w(:, 1) * T(:, 6) - w(:, 3) * T(:, 4)
    dot_T(:, 6) = w(:, 3) * (T(:, 3) - T(:, 2)) - w(:, 1) * T(:, 5) - w(:, 2) * T(:, 4)
  end function corotate

  !> exp(W)
  pure function rotation(w) result(R)
    real(dp), intent(in) :: w(LANES, 3)
    real(dp) :: R(LANES, 3, 3), angle(LANES), first(LANES), second(LANES)

    angle = sqrt(w(:, 1)**2 + w(:, 2)**2 + w(:, 3)**2)
    first = 1
    second = 0.5_dp
    where (angle > 0)
      first = sin(angle) / angle
      second = (sin(angle / 2) / (angle / 2))**2 / 2
    end where
    R = rotation_of(w, first, second)
  end function rotation

  !> The same for |w| <= 0.2, in vector instructions.
  pure function small_rotation(w) result(R)
    real(dp), intent(in) :: w(LANES, 3)
    real(dp) :: R(LANES, 3, 3), second(LANES), third(LANES)
    call spin_series(w, second, third)
    R = rotation_of(w, 1 - third * (w(:, 1)**2 + w(:, 2)**2 + w(:, 3)**2), second)
  end function small_rotation

  !> Rodrigues' formula: I + first W + second W W, first = sin(a)/a and second = (1 - cos(a))/a^2 of the angle a.
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

  !> The spin v with dR = V R for R = small_rotation(w) and a change d_w.
  pure function rotation_change(w, d_w) result(v)
    real(dp), intent(in) :: w(LANES, 3), d_w(LANES, 3)
    real(dp) :: v(LANES, 3), second(LANES), third(LANES), once(LANES, 3)

    call spin_series(w, second, third)
    once = commute(w, d_w)
    v = d_w + times_spin(second, once) + times_spin(third, commute(w, once))
  end function rotation_change

  !> (1 - cos(a))/a^2 and (a - sin(a))/a^3 for the angle a of w, to round-off for a <= 0.2.
  pure subroutine spin_series(w, second, third)
    real(dp), intent(in) :: w(LANES, 3)
    real(dp), intent(out) :: second(LANES), third(LANES)
    real(dp) :: square(LANES)
    square = w(:, 1)**2 + w(:, 2)**2 + w(:, 3)**2
    second = (1 - square / 12 * (1 - square / 30 * (1 - square / 56 * (1 - square / 90)))) / 2
    third = (1 - square / 20 * (1 - square / 42 * (1 - square / 72 * (1 - square / 110)))) / 6
  end subroutine spin_series

  !> s W
  pure function times_spin(s, w) result(p)
    real(dp), intent(in) :: s(LANES), w(LANES, 3)
    real(dp) :: p(LANES, 3)
    integer :: k
    do k = 1, 3
      p(:, k) = s * w(:, k)
    end do
  end function times_spin

  !> V W - W V of two spins, as a spin.
  pure function commute(v, w) result(c)
    real(dp), intent(in) :: v(LANES, 3), w(LANES, 3)
    real(dp) :: c(LANES, 3)
    c(:, 1) = v(:, 3) * w(:, 2) - v(:, 2) * w(:, 3)
    c(:, 2) = v(:, 1) * w(:, 3) - v(:, 3) * w(:, 1)
    c(:, 3) = v(:, 2) * w(:, 1) - v(:, 1) * w(:, 2)
  end function commute

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

  !> Strain (engineering shears) and spin of displacement gradients G(j, i) = du_i/dx_j, laid out as C and numpy have them.
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
