!> Isoparametric elements in the updated Lagrangian frame, for displacement solvers: from nodal displacement increments to the
!> velocity gradients that the material takes, and from its stress and tangent to nodal forces and element stiffness matrices.
!>
!> x is where the nodes were at the start of the increment, u how far they move in it. With F = d(x + u)/dx, the gradient handed
!> to the material is L = log F: a constant velocity gradient over the increment leads exactly to F, so rigid rotation by any
!> angle strains nothing and det F = exp(tr L) exactly.
!>
!> With mean dilatation (B-bar on the moving mesh) every point of a cell gets the cell's volume change, and the pressure that does
!> work on it is the cell's mean: L = log F + (log(V/V_old) - tr log F) I/d, and forces come from tau = sigma + (P - p_q) I,
!> p_q = (tr sigma)/d over the d axes of the plane or space, P its mean over the cell's volume V.
module granumat_element
  use granumat_kinds, only: dp
  implicit none (type, external)
  private
  public :: element_gradients, element_forces, element_stiffness, INVERTED, TOO_LARGE

  integer, parameter :: INVERTED = 1                 ! an integration point's volume vanishes or changes its sign
  integer, parameter :: TOO_LARGE = 2                ! log F does not converge: the increment turns or strains by too much
  integer, parameter :: MAX_TERMS = 40               ! of log F
  integer, parameter :: VOIGT(3, 3) = reshape([1, 4, 5, 4, 2, 6, 5, 6, 3], [3, 3])
  integer, parameter :: SPIN(3, 3) = reshape([0, -7, -8, 7, 0, -9, 8, 9, 0], [3, 3])     ! (k, l): sign and seed of W_kl

contains

  !> Velocity gradients of the increment and volumes after it, of every integration point of every cell.
  subroutine element_gradients(shape_gradients, weights, x, u, mean_dilatation, L, volume, status)
    real(dp), intent(in) :: shape_gradients(:, :, :)      ! (nodes, d, points): by reference coordinates
    real(dp), intent(in) :: weights(:)                    ! (points) of the quadrature on the reference cell
    real(dp), intent(in) :: x(:, :, :)                    ! (d, nodes, cells)
    real(dp), intent(in) :: u(:, :, :)                    ! (d, nodes, cells)
    logical, intent(in) :: mean_dilatation
    real(dp), intent(out) :: L(:, :, :, :)                ! (3, 3, points, cells): (j, i) = du_i/dx_j
    real(dp), intent(out) :: volume(:, :)                 ! (points, cells)
    integer, intent(out) :: status(:)                     ! (cells) 0, INVERTED or TOO_LARGE
    real(dp) :: spatial(size(x, 2), size(x, 1)), old_volume, det_old, det, theta, G(3, 3)
    integer :: cell, q, i, j, d
    logical :: converged

    d = size(x, 1)
    status = 0
    L = 0
    do cell = 1, size(x, 3)
      old_volume = 0
      do q = 1, size(weights)
        call spatial_gradients(shape_gradients(:, :, q), x(:, :, cell), spatial, det_old)
        old_volume = old_volume + weights(q) * abs(det_old)
        call spatial_gradients(shape_gradients(:, :, q), x(:, :, cell) + u(:, :, cell), spatial, det)
        volume(q, cell) = weights(q) * abs(det)
        if (.not. det / det_old > 0) status(cell) = INVERTED
        call spatial_gradients(shape_gradients(:, :, q), x(:, :, cell) + u(:, :, cell) / 2, spatial, det)
        if (.not. det / det_old > 0) status(cell) = INVERTED
        G = 0
        do j = 1, d
          do i = 1, d
            G(i, j) = dot_product(u(i, :, cell), spatial(:, j))
          end do
        end do
        call logarithm(G, converged)
        if (.not. converged .and. status(cell) == 0) status(cell) = TOO_LARGE
        L(:, :, q, cell) = transpose(G)
      end do
      if (status(cell) /= 0) then
        L(:, :, :, cell) = 0
      else if (mean_dilatation) then
        do q = 1, size(weights)
          theta = log(sum(volume(:, cell)) / old_volume) - trace(L(:, :, q, cell), d)
          do i = 1, d
            L(i, i, q, cell) = L(i, i, q, cell) + theta / d
          end do
        end do
      end if
    end do
  end subroutine element_gradients

  !> Nodal forces of the stress: f(:, a) = sum over points of volume tau grad N_a.
  subroutine element_forces(shape_gradients, x_new, volume, stress, mean_dilatation, forces)
    real(dp), intent(in) :: shape_gradients(:, :, :)      ! (nodes, d, points)
    real(dp), intent(in) :: x_new(:, :, :)                ! (d, nodes, cells): after the increment
    real(dp), intent(in) :: volume(:, :)                  ! (points, cells): after the increment
    real(dp), intent(in) :: stress(:, :, :)               ! (6, points, cells)
    logical, intent(in) :: mean_dilatation
    real(dp), intent(out) :: forces(:, :, :)              ! (d, nodes, cells)
    real(dp) :: spatial(size(x_new, 2), size(x_new, 1)), tau(3, 3), det, mean
    integer :: cell, q, i, d

    d = size(x_new, 1)
    do cell = 1, size(x_new, 3)
      mean = mean_pressure(stress(:, :, cell), volume(:, cell), d)
      forces(:, :, cell) = 0
      do q = 1, size(volume, 1)
        call spatial_gradients(shape_gradients(:, :, q), x_new(:, :, cell), spatial, det)
        tau = working_stress(stress(:, q, cell), mean, mean_dilatation, d)
        do i = 1, d
          forces(i, :, cell) = forces(i, :, cell) + volume(q, cell) * matmul(spatial, tau(:d, i))
        end do
      end do
    end do
  end subroutine element_forces

  !> The derivative of element_forces by u, consistent with element_gradients; rows and columns run over (d, nodes), d fastest.
  !>
  !> With h = d(du)/dx of a variation du, the material's gradient varies by dL = h - [L, h]/2 + [L, [L, h]]/12 - ... (the series of
  !> Baker, Campbell and Hausdorff), points' volumes by tr h, grad N by - grad N h. In a cell with mean dilatation, b = tr h is
  !> replaced by its mean m, so that d sigma = E h + e (m - b)/d, and K is a sum over points of G^T X G, and of three rank-one terms.
  subroutine element_stiffness(shape_gradients, x_new, volume, L, stress, tangent, mean_dilatation, K)
    real(dp), intent(in) :: shape_gradients(:, :, :)      ! (nodes, d, points)
    real(dp), intent(in) :: x_new(:, :, :)                ! (d, nodes, cells): after the increment
    real(dp), intent(in) :: volume(:, :)                  ! (points, cells): after the increment
    real(dp), intent(in) :: L(:, :, :, :)                 ! (3, 3, points, cells): (j, i) = du_i/dx_j
    real(dp), intent(in) :: stress(:, :, :)               ! (6, points, cells)
    real(dp), intent(in) :: tangent(:, :, :, :)           ! (9, 6, points, cells): (j, i) = d stress_i / d (strain_j, spin_j)
    logical, intent(in) :: mean_dilatation
    real(dp), intent(out) :: K(:, :, :)                   ! (d nodes, d nodes, cells), transposed: (column, row)
    real(dp) :: spatial(size(x_new, 2), size(x_new, 1)), tau(3, 3), E(3, 3, 6), X(3, 3, 3, 3), slope(3, 3), e_iso(6), det, mean
    real(dp), dimension(size(x_new, 1) * size(x_new, 2)) :: mean_divergence, pressure_column, pressure_row
    real(dp) :: pressure_square, e_mean, cell_volume
    integer :: cell, q, i, j, d

    d = size(x_new, 1)
    do cell = 1, size(x_new, 3)
      K(:, :, cell) = 0
      cell_volume = sum(volume(:, cell))
      mean = mean_pressure(stress(:, :, cell), volume(:, cell), d)
      mean_divergence = 0
      pressure_column = 0
      pressure_row = 0
      pressure_square = 0
      do q = 1, size(volume, 1)
        call spatial_gradients(shape_gradients(:, :, q), x_new(:, :, cell), spatial, det)
        tau = working_stress(stress(:, q, cell), mean, mean_dilatation, d)
        call stress_slopes(tangent(:, :, q, cell), transpose(L(:, :, q, cell)), d, E, e_iso)
        if (mean_dilatation) then
          do i = 1, d                                   ! E - e b^T/d
            E(i, i, :) = E(i, i, :) - e_iso / d
          end do
          slope = 0                                     ! of the mean over the axes
          e_mean = 0
          do i = 1, d
            slope = slope + E(:, :, VOIGT(i, i)) / d
            e_mean = e_mean + e_iso(VOIGT(i, i)) / d
          end do
          do i = 1, d
            E(:, :, VOIGT(i, i)) = E(:, :, VOIGT(i, i)) - slope
            e_iso(VOIGT(i, i)) = e_iso(VOIGT(i, i)) - e_mean
          end do
          do i = 1, d                                   ! what is left of the change of P
            slope(i, i) = slope(i, i) + mean_of(stress(:, q, cell), d) - mean
          end do
          call add_projection(spatial, volume(q, cell) * identity(d) / cell_volume, mean_divergence)
          call add_projection(spatial, volume(q, cell) * slope, pressure_row)
          call add_projection(spatial, volume(q, cell) * to_matrix(e_iso) / d, pressure_column)
          pressure_square = pressure_square + volume(q, cell) * e_mean / d
        end if
        do j = 1, d
          do i = 1, d
            X(:, :, i, j) = E(:, :, VOIGT(i, j)) + tau(i, j) * identity(d)      ! (k, l, i, j): of du_k/dx_l on the weight of N,j
            X(j, :, i, j) = X(j, :, i, j) - tau(i, :)
          end do
        end do
        call add_product(spatial, volume(q, cell) * X(:d, :d, :d, :d), K(:, :, cell))
      end do
      if (mean_dilatation) then
        do i = 1, size(mean_divergence)
          K(:, i, cell) = K(:, i, cell) + mean_divergence * pressure_column(i) &
            + mean_divergence(i) * (pressure_row + pressure_square * mean_divergence)
        end do
      end if
    end do
  end subroutine element_stiffness

  !> E(:, :, i): the derivative of stress i by h, as a matrix to be contracted with it; e_iso: by an isotropic strain of d axes (not by h).
  pure subroutine stress_slopes(tangent, L, d, E, e_iso)
    real(dp), intent(in) :: tangent(9, 6)
    real(dp), intent(in) :: L(3, 3)
    integer, intent(in) :: d
    real(dp), intent(out) :: E(3, 3, 6)
    real(dp), intent(out) :: e_iso(6)
    real(dp) :: slope(3, 3), first(3, 3), second(3, 3), fourth(3, 3)
    integer :: i, k, m

    e_iso = 0
    do i = 1, 6
      do m = 1, 3
        do k = 1, 3
          slope(k, m) = tangent(VOIGT(k, m), i)
          if (k /= m) slope(k, m) = slope(k, m) + sign(0.5_dp, real(SPIN(k, m), dp)) * tangent(abs(SPIN(k, m)), i)
        end do
      end do
      do k = 1, d
        e_iso(i) = e_iso(i) + slope(k, k)
      end do
      first = commutator(L, slope)
      second = commutator(L, first)
      fourth = commutator(L, commutator(L, second))
      E(:, :, i) = slope - first / 2 + second / 12 - fourth / 720
    end do
  end subroutine stress_slopes

  !> R -> L^T R - R L^T, so that (its result) : h = R : [L, h].
  pure function commutator(L, R) result(adjoint)
    real(dp), intent(in) :: L(3, 3)
    real(dp), intent(in) :: R(3, 3)
    real(dp) :: adjoint(3, 3)
    adjoint = matmul(transpose(L), R) - matmul(R, transpose(L))
  end function commutator

  !> K(:, :) += G^T X G for the gradients G of all nodes; (column, row).
  pure subroutine add_product(spatial, X, K)
    real(dp), intent(in) :: spatial(:, :)            ! (nodes, d)
    real(dp), intent(in) :: X(:, :, :, :)            ! (k, l, i, j): column's component and derivative, row's
    real(dp), intent(inout) :: K(:, :)               ! (d nodes, d nodes)
    real(dp) :: T(size(K, 1), size(spatial, 2))
    integer :: a, i, j, k_axis, m, d

    d = size(spatial, 2)
    do i = 1, d
      do j = 1, d
        do k_axis = 1, d
          T(k_axis::d, j) = 0
          do m = 1, d
            T(k_axis::d, j) = T(k_axis::d, j) + X(k_axis, m, i, j) * spatial(:, m)
          end do
        end do
      end do
      do a = 1, size(spatial, 1)
        do j = 1, d
          K(:, (a - 1) * d + i) = K(:, (a - 1) * d + i) + spatial(a, j) * T(:, j)
        end do
      end do
    end do
  end subroutine add_product

  !> v += G^T m: m_ij weighs d(du_i)/dx_j.
  pure subroutine add_projection(spatial, m, v)
    real(dp), intent(in) :: spatial(:, :)            ! (nodes, d)
    real(dp), intent(in) :: m(3, 3)
    real(dp), intent(inout) :: v(:)                  ! (d nodes)
    integer :: i, j, d
    d = size(spatial, 2)
    do i = 1, d
      do j = 1, d
        v(i::d) = v(i::d) + m(i, j) * spatial(:, j)
      end do
    end do
  end subroutine add_projection

  !> The stress that works on the actual gradients: with mean dilatation the cell's mean pressure takes the place of the point's.
  pure function working_stress(stress, mean, mean_dilatation, d) result(tau)
    real(dp), intent(in) :: stress(6)
    real(dp), intent(in) :: mean
    logical, intent(in) :: mean_dilatation
    integer, intent(in) :: d
    real(dp) :: tau(3, 3)
    tau = to_matrix(stress)
    if (mean_dilatation) tau = tau + (mean - mean_of(stress, d)) * identity(d)
  end function working_stress

  pure function mean_pressure(stress, volume, d) result(mean)
    real(dp), intent(in) :: stress(:, :)
    real(dp), intent(in) :: volume(:)
    integer, intent(in) :: d
    real(dp) :: mean
    integer :: q
    mean = 0
    do q = 1, size(volume)
      mean = mean + volume(q) * mean_of(stress(:, q), d)
    end do
    mean = mean / sum(volume)
  end function mean_pressure

  pure real(dp) function mean_of(stress, d)
    real(dp), intent(in) :: stress(6)
    integer, intent(in) :: d
    mean_of = sum(stress(:d)) / d
  end function mean_of

  pure real(dp) function trace(matrix, d)
    real(dp), intent(in) :: matrix(3, 3)
    integer, intent(in) :: d
    integer :: i
    trace = 0
    do i = 1, d
      trace = trace + matrix(i, i)
    end do
  end function trace

  pure function identity(d) result(matrix)
    integer, intent(in) :: d
    real(dp) :: matrix(3, 3)
    integer :: i
    matrix = 0
    do i = 1, d
      matrix(i, i) = 1
    end do
  end function identity

  pure function to_matrix(six) result(matrix)
    real(dp), intent(in) :: six(6)
    real(dp) :: matrix(3, 3)
    integer :: i, j
    do j = 1, 3
      do i = 1, 3
        matrix(i, j) = six(VOIGT(i, j))
      end do
    end do
  end function to_matrix

  !> Derivatives of the shape functions by position, where the nodes are at x; det is that of the map from the reference cell.
  pure subroutine spatial_gradients(reference, x, spatial, det)
    real(dp), intent(in) :: reference(:, :)          ! (nodes, d)
    real(dp), intent(in) :: x(:, :)                  ! (d, nodes)
    real(dp), intent(out) :: spatial(:, :)           ! (nodes, d)
    real(dp), intent(out) :: det
    real(dp) :: jacobian(size(x, 1), size(x, 1)), inverse(size(x, 1), size(x, 1))
    integer :: d

    d = size(x, 1)
    jacobian = matmul(x, reference)
    if (d == 2) then
      inverse = reshape([jacobian(2, 2), -jacobian(2, 1), -jacobian(1, 2), jacobian(1, 1)], [2, 2])
    else
      inverse(1, :) = cross(jacobian(:, 2), jacobian(:, 3))
      inverse(2, :) = cross(jacobian(:, 3), jacobian(:, 1))
      inverse(3, :) = cross(jacobian(:, 1), jacobian(:, 2))
    end if
    det = dot_product(inverse(1, :), jacobian(:, 1))
    spatial = 0
    if (abs(det) > 0) spatial = matmul(reference, inverse / det)
  end subroutine spatial_gradients

  pure function cross(a, b) result(c)
    real(dp), intent(in) :: a(3)
    real(dp), intent(in) :: b(3)
    real(dp) :: c(3)
    c = [a(2) * b(3) - a(3) * b(2), a(3) * b(1) - a(1) * b(3), a(1) * b(2) - a(2) * b(1)]
  end function cross

  !> G = 2 (F - I)(F + I)^-1, the increment's gradient in its middle, becomes log F = 2 artanh(G/2).
  pure subroutine logarithm(G, converged)
    real(dp), intent(inout) :: G(3, 3)
    logical, intent(out) :: converged
    real(dp) :: square(3, 3), power(3, 3), term(3, 3)
    integer :: m

    square = matmul(G, G) / 4
    power = G
    do m = 1, MAX_TERMS
      power = matmul(power, square)
      term = power / (2 * m + 1)
      G = G + term
      converged = maxval(abs(term)) <= epsilon(1.0_dp) * maxval(abs(G)) / 2
      if (converged) exit
    end do
  end subroutine logarithm

end module granumat_element
