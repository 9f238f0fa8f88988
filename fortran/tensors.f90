!> Symmetric tensors as six components 11 22 33 12 13 23 (tensor shear components), spins as W12 W13 W23.
module granumat_tensors
  use granumat_kinds, only: dp
  implicit none (type, external)
  private
  public :: trace, deviator, contract, modulus, product_symmetric, rotation, rotate, corotate, strain_and_spin

  real(dp), parameter, public :: IDENTITY(6) = [1, 1, 1, 0, 0, 0]

contains

  pure function trace(T) result(tr)
    real(dp), intent(in) :: T(6)
    real(dp) :: tr
    tr = T(1) + T(2) + T(3)
  end function trace

  pure function deviator(T) result(dev)
    real(dp), intent(in) :: T(6)
    real(dp) :: dev(6)
    dev = T - trace(T) / 3 * IDENTITY
  end function deviator

  !> X : Y
  pure function contract(X, Y) result(c)
    real(dp), intent(in) :: X(6), Y(6)
    real(dp) :: c
    c = X(1) * Y(1) + X(2) * Y(2) + X(3) * Y(3) + 2 * (X(4) * Y(4) + X(5) * Y(5) + X(6) * Y(6))
  end function contract

  !> |T| = sqrt(T : T / 2), the paper's modulus; safe from underflow and overflow.
  pure function modulus(T) result(m)
    real(dp), intent(in) :: T(6)
    real(dp) :: m, scale
    scale = maxval(abs(T))
    m = 0
    if (scale > 0) m = scale * sqrt(contract(T / scale, T / scale) / 2)
  end function modulus

  !> X Y + Y X
  pure function product_symmetric(X, Y) result(P)
    real(dp), intent(in) :: X(6), Y(6)
    real(dp) :: P(6)
    P(1) = 2 * (X(1) * Y(1) + X(4) * Y(4) + X(5) * Y(5))
    P(2) = 2 * (X(4) * Y(4) + X(2) * Y(2) + X(6) * Y(6))
    P(3) = 2 * (X(5) * Y(5) + X(6) * Y(6) + X(3) * Y(3))
    P(4) = X(1) * Y(4) + X(4) * Y(2) + X(5) * Y(6) + Y(1) * X(4) + Y(4) * X(2) + Y(5) * X(6)
    P(5) = X(1) * Y(5) + X(4) * Y(6) + X(5) * Y(3) + Y(1) * X(5) + Y(4) * X(6) + Y(5) * X(3)
    P(6) = X(4) * Y(5) + X(2) * Y(6) + X(6) * Y(3) + Y(4) * X(5) + Y(2) * X(6) + Y(6) * X(3)
  end function product_symmetric

  !> W T - T W, the rate of a tensor carried along by the spin w.
  pure function corotate(w, T) result(dot_T)
    real(dp), intent(in) :: w(3), T(6)
    real(dp) :: dot_T(6)
    dot_T(1) = 2 * (w(1) * T(4) + w(2) * T(5))
    dot_T(2) = 2 * (w(3) * T(6) - w(1) * T(4))
    dot_T(3) = -2 * (w(2) * T(5) + w(3) * T(6))
    dot_T(4) = w(1) * (T(2) - T(1)) + w(2) * T(6) + w(3) * T(5)
    dot_T(5) = w(2) * (T(3) - T(1)) + w(1) * T(6) - w(3) * T(4)
    dot_T(6) = w(3) * (T(3) - T(2)) - w(1) * T(5) - w(2) * T(4)
  end function corotate

  !> exp(W) by Rodrigues' formula.
  pure function rotation(w) result(R)
    real(dp), intent(in) :: w(3)
    real(dp) :: R(3, 3), W1(3, 3), angle, first, second

    W1 = reshape([0.0_dp, -w(1), -w(2), w(1), 0.0_dp, -w(3), w(2), w(3), 0.0_dp], [3, 3])
    angle = norm2(w)
    first = 1
    second = 0.5_dp
    if (angle > 0) then
      first = sin(angle) / angle
      second = (sin(angle / 2) / (angle / 2))**2 / 2
    end if
    R = first * W1 + second * matmul(W1, W1)
    R(1, 1) = R(1, 1) + 1
    R(2, 2) = R(2, 2) + 1
    R(3, 3) = R(3, 3) + 1
  end function rotation

  !> R T R^T
  pure function rotate(R, T) result(rotated)
    real(dp), intent(in) :: R(3, 3), T(6)
    real(dp) :: rotated(6), full(3, 3)
    full = reshape([T(1), T(4), T(5), T(4), T(2), T(6), T(5), T(6), T(3)], [3, 3])
    full = matmul(R, matmul(full, transpose(R)))
    rotated = [full(1, 1), full(2, 2), full(3, 3), full(1, 2), full(1, 3), full(2, 3)]
  end function rotate

  !> Strain (engineering shears) and spin of a displacement gradient G(j, i) = du_i/dx_j, laid out as C and numpy have it.
  pure subroutine strain_and_spin(G, strain, spin)
    real(dp), intent(in) :: G(3, 3)
    real(dp), intent(out) :: strain(6), spin(3)
    strain = [G(1, 1), G(2, 2), G(3, 3), G(1, 2) + G(2, 1), G(1, 3) + G(3, 1), G(2, 3) + G(3, 2)]
    spin = [G(2, 1) - G(1, 2), G(3, 1) - G(1, 3), G(3, 2) - G(2, 3)] / 2
  end subroutine strain_and_spin

end module granumat_tensors
