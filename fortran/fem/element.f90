!> Isoparametric elements in the updated Lagrangian frame, for displacement solvers: from nodal displacement increments to the
!! velocity gradients that the material takes, and from its stress and tangent to nodal forces and element stiffness matrices.
!!
!! x is where the nodes were at the start of the increment, u how far they move in it. With F = d(x + u)/dx, the gradient handed
!! to the material is L = log F: a constant velocity gradient over the increment leads exactly to F, so rigid rotation by any
!! angle strains nothing and det F = exp(tr L) exactly.
!!
!! With mean dilatation (B-bar on the moving mesh) every point of a cell gets the cell's volume change, and the pressure that does
!! work on it is the cell's mean: L = log F + (log(V/V_old) - tr log F) I/d, and forces come from tau = sigma + (P - p_q) I,
!! p_q = (tr sigma)/d over the d axes of the plane or space, P its mean over the cell's volume V.
!!
!! With a length there is a scalar m beside u, of degree 1 between the cells' vertices, which come first among the nodes:
!! m - l^2 div grad m = |D| over the body as it is at the start of the increment, so that it is linear in m. element_helmholtz gives
!! the matrix of its left side, element_coupling all derivatives that have to do with m.
!!
!! LANES cells go side by side, gathered and scattered cell by cell; a last group that is not full repeats its last cell.
!! Gradients have three axes in the plane too, where the derivatives along the third are 0. See docs/theory.md, section 9.
module granumat_element
  use granumat_kinds, only: dp, LANES
  use granumat_matrices, only: determinant, invert, middle_to_logarithm, product_of, to_matrix, trace_of
  use granumat_tangent, only: PLANE_COLUMNS
  use granumat_tensors, only: VOIGT
  implicit none (type, external)
  private
  public :: element_gradients, element_forces, element_stiffness, element_helmholtz, element_coupling

  integer, parameter :: INVERTED = 1                 ! an integration point's volume vanishes or changes its sign
  integer, parameter :: TOO_LARGE = 2                ! log F does not converge: the increment turns or strains by too much
  integer, parameter :: SPIN(3, 3) = reshape([0, -7, -8, 7, 0, -9, 8, 9, 0], [3, 3])     ! (k, l): sign and column of W_kl

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
    real(dp), dimension(LANES, size(x, 1), size(x, 2)) :: x_old, du
    real(dp) :: G(LANES, 3, 3, size(weights)), point_volume(LANES, size(weights))
    real(dp), dimension(LANES, 3, 3) :: J, J_u, inverse
    real(dp), dimension(LANES) :: det_old, det_middle, det, old_volume, new_volume, theta
    integer :: cell(LANES), found(LANES), first, k, q, i, d
    logical :: converged(LANES)

    d = size(x, 1)
    do first = 1, size(x, 3), LANES
      cell = group(first, size(x, 3))
      x_old = nodal(x, cell)
      du = nodal(u, cell)
      found = 0
      old_volume = 0
      new_volume = 0
      do q = 1, size(weights)
        J = jacobian(shape_gradients(:, :, q), x_old)
        if (d == 2) J(:, 3, 3) = 1
        J_u = jacobian(shape_gradients(:, :, q), du)
        det_old = determinant(J)
        det = determinant(J + J_u)
        call invert(J + J_u / 2, inverse, det_middle)
        point_volume(:, q) = weights(q) * abs(det)
        old_volume = old_volume + weights(q) * abs(det_old)
        new_volume = new_volume + point_volume(:, q)
        G(:, :, :, q) = product_of(J_u, inverse)
        call middle_to_logarithm(G(:, :, :, q), converged)
        where (found == 0 .and. .not. converged) found = TOO_LARGE
        where (.not. (det / det_old > 0 .and. det_middle / det_old > 0)) found = INVERTED
      end do
      if (mean_dilatation) then
        do q = 1, size(weights)
          theta = log(new_volume / old_volume) - trace_of(G(:, :, :, q))
          do i = 1, d
            G(:, i, i, q) = G(:, i, i, q) + theta / d
          end do
        end do
      end if
      do k = 1, LANES
        volume(:, cell(k)) = point_volume(k, :)
        status(cell(k)) = found(k)
        do q = 1, size(weights)
          L(:, :, q, cell(k)) = transpose(G(k, :, :, q))
        end do
        if (found(k) /= 0) L(:, :, :, cell(k)) = 0
      end do
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
    real(dp), dimension(LANES, size(x_new, 1), size(x_new, 2)) :: x, f
    real(dp) :: spatial(LANES, 3, size(x_new, 2)), tau(LANES, 3, 3)
    real(dp), dimension(LANES) :: det, mean, dv
    integer :: cell(LANES), first, k, q, a, i

    do first = 1, size(x_new, 3), LANES
      cell = group(first, size(x_new, 3))
      x = nodal(x_new, cell)
      mean = mean_pressure(stress, volume, cell, size(x_new, 1))
      f = 0
      do q = 1, size(volume, 1)
        call spatial_gradients(shape_gradients(:, :, q), x, spatial, det)
        tau = working_stress(stress, q, cell, mean, mean_dilatation, size(x_new, 1))
        dv = volume(q, cell)
        do a = 1, size(f, 3)
          do i = 1, size(f, 2)
            f(:, i, a) = f(:, i, a) + dv * (spatial(:, 1, a) * tau(:, 1, i) + spatial(:, 2, a) * tau(:, 2, i) &
              + spatial(:, 3, a) * tau(:, 3, i))
          end do
        end do
      end do
      do k = 1, LANES
        forces(:, :, cell(k)) = f(k, :, :)
      end do
    end do
  end subroutine element_forces

  !> The derivative of element_forces by u, consistent with element_gradients; rows and columns run over (d, nodes), d fastest.
  !!
  !! With h = d(du)/dx of a variation du, the material's gradient varies by dL = h - [L, h]/2 + [L, [L, h]]/12 - ... (the series of
  !! Baker, Campbell and Hausdorff), points' volumes by tr h, grad N by - grad N h. In a cell with mean dilatation, b = tr h is
  !! replaced by its mean m, so that d sigma = E h + e (m - b)/d, and K is a sum over points of G^T X G and of three rank-one terms.
  subroutine element_stiffness(shape_gradients, x_new, volume, L, stress, tangent, mean_dilatation, K)
    real(dp), intent(in) :: shape_gradients(:, :, :)      ! (nodes, d, points)
    real(dp), intent(in) :: x_new(:, :, :)                ! (d, nodes, cells): after the increment
    real(dp), intent(in) :: volume(:, :)                  ! (points, cells): after the increment
    real(dp), intent(in) :: L(:, :, :, :)                 ! (3, 3, points, cells): (j, i) = du_i/dx_j
    real(dp), intent(in) :: stress(:, :, :)               ! (6, points, cells)
    real(dp), intent(in) :: tangent(:, :, :, :)           ! (9, 6, points, cells): (j, i) = d stress_i / d (strain_j, spin_j);
                                                          ! (4, 4, points, cells) of PLANE_COLUMNS in the plane
    logical, intent(in) :: mean_dilatation
    real(dp), intent(inout) :: K(:, :, :)                 ! (n nodes, n nodes, cells), transposed: (column, row); of the n >= d
                                                          ! unknowns of a node the first d are displacements, the others left alone
    real(dp) :: x(LANES, size(x_new, 1), size(x_new, 2)), spatial(LANES, 3, size(x_new, 2))
    real(dp) :: matrix(LANES, size(x_new, 1) * size(x_new, 2), size(x_new, 1) * size(x_new, 2))
    real(dp), dimension(LANES, size(x_new, 1) * size(x_new, 2)) :: mean_divergence, pressure_column, pressure_row
    real(dp), dimension(LANES, 3, 3) :: tau, slope, isotropic
    real(dp) :: E(LANES, 3, 3, 6), e_iso(LANES, 6), X_ij(LANES, 3, 3, 3, 3)
    real(dp), dimension(LANES) :: det, mean, dv, cell_volume, pressure_square, e_mean, excess
    integer :: cell(LANES), first, lane, q, i, j, d, n, a, b

    d = size(x_new, 1)
    n = size(K, 1) / size(x_new, 2)
    do first = 1, size(x_new, 3), LANES
      cell = group(first, size(x_new, 3))
      x = nodal(x_new, cell)
      mean = mean_pressure(stress, volume, cell, d)
      cell_volume = sum(volume(:, cell), 1)
      matrix = 0
      mean_divergence = 0
      pressure_column = 0
      pressure_row = 0
      pressure_square = 0
      do q = 1, size(volume, 1)
        dv = volume(q, cell)
        call spatial_gradients(shape_gradients(:, :, q), x, spatial, det)
        tau = working_stress(stress, q, cell, mean, mean_dilatation, d)
        call stress_slopes(tangent, L, q, cell, d, E, e_iso)
        if (mean_dilatation) then
          do i = 1, d                                   ! E - e b^T/d
            E(:, i, i, :) = E(:, i, i, :) - e_iso / d
          end do
          slope = 0                                     ! of the mean over the axes
          e_mean = 0
          do i = 1, d
            slope = slope + E(:, :, :, i) / d
            e_mean = e_mean + e_iso(:, i) / d
          end do
          do i = 1, d
            E(:, :, :, i) = E(:, :, :, i) - slope
            e_iso(:, i) = e_iso(:, i) - e_mean
          end do
          excess = axial_mean(stress, q, cell, d) - mean
          isotropic = 0
          do i = 1, d                                   ! what is left of the change of P
            slope(:, i, i) = slope(:, i, i) + excess
            isotropic(:, i, i) = 1 / cell_volume
          end do
          call add_projection(spatial, dv, isotropic, mean_divergence)
          call add_projection(spatial, dv, slope, pressure_row)
          call add_projection(spatial, dv / d, to_matrix(e_iso), pressure_column)
          pressure_square = pressure_square + dv * e_mean / d
        end if
        do j = 1, 3
          do i = 1, 3
            X_ij(:, :, :, i, j) = E(:, :, :, VOIGT(i, j))      ! (k, l, i, j): of du_k/dx_l on the weight of N,j
            X_ij(:, 1, 1, i, j) = X_ij(:, 1, 1, i, j) + tau(:, i, j)
            X_ij(:, 2, 2, i, j) = X_ij(:, 2, 2, i, j) + tau(:, i, j)
            X_ij(:, 3, 3, i, j) = X_ij(:, 3, 3, i, j) + tau(:, i, j)
            X_ij(:, j, :, i, j) = X_ij(:, j, :, i, j) - tau(:, i, :)
          end do
        end do
        call add_product(spatial, dv, X_ij, d, matrix)
      end do
      if (mean_dilatation) then
        do i = 1, size(matrix, 3)
          do j = 1, size(matrix, 2)
            matrix(:, j, i) = matrix(:, j, i) + mean_divergence(:, j) * pressure_column(:, i) &
              + mean_divergence(:, i) * (pressure_row(:, j) + pressure_square * mean_divergence(:, j))
          end do
        end do
      end if
      do lane = 1, LANES
        do a = 1, size(x_new, 2)
          do i = 1, d
            do b = 1, size(x_new, 2)
              K((b - 1) * n + 1:(b - 1) * n + d, (a - 1) * n + i, cell(lane)) = &
                matrix(lane, (b - 1) * d + 1:b * d, (a - 1) * d + i)
            end do
          end do
        end do
      end do
    end do
  end subroutine element_stiffness

  !> The matrices of m - l^2 div grad m, for m of degree 1 between the vertices: sum over points of volume
  !! N_a N_b + l^2 grad N_a . grad N_b, and the points' volumes. Both are where the nodes are at x.
  subroutine element_helmholtz(shape_gradients, vertex_values, vertex_gradients, weights, x, length, matrix, volume)
    real(dp), intent(in) :: shape_gradients(:, :, :)      ! (nodes, d, points)
    real(dp), intent(in) :: vertex_values(:, :)           ! (vertices, points): shape functions of degree 1
    real(dp), intent(in) :: vertex_gradients(:, :, :)     ! (vertices, d, points)
    real(dp), intent(in) :: weights(:)                    ! (points)
    real(dp), intent(in) :: x(:, :, :)                    ! (d, nodes, cells)
    real(dp), intent(in) :: length
    real(dp), intent(out) :: matrix(:, :, :)              ! (vertices, vertices, cells)
    real(dp), intent(out) :: volume(:, :)                 ! (points, cells)
    real(dp) :: at(LANES, size(x, 1), size(x, 2)), spatial(LANES, 3, size(vertex_values, 1)), inverse(LANES, 3, 3)
    real(dp) :: total(LANES, size(vertex_values, 1), size(vertex_values, 1))
    real(dp), dimension(LANES) :: det, dv
    integer :: cell(LANES), first, lane, q, a, b

    do first = 1, size(x, 3), LANES
      cell = group(first, size(x, 3))
      at = nodal(x, cell)
      total = 0
      do q = 1, size(weights)
        call inverse_jacobian(shape_gradients(:, :, q), at, inverse, det)
        call to_spatial(vertex_gradients(:, :, q), inverse, spatial)
        dv = weights(q) * abs(det)
        do lane = 1, LANES
          volume(q, cell(lane)) = dv(lane)
        end do
        do b = 1, size(vertex_values, 1)
          do a = 1, size(vertex_values, 1)
            total(:, a, b) = total(:, a, b) + dv * (vertex_values(a, q) * vertex_values(b, q) + length**2 &
              * (spatial(:, 1, a) * spatial(:, 1, b) + spatial(:, 2, a) * spatial(:, 2, b) + spatial(:, 3, a) * spatial(:, 3, b)))
          end do
        end do
      end do
      do lane = 1, LANES
        matrix(:, :, cell(lane)) = total(lane, :, :)
      end do
    end do
  end subroutine element_helmholtz

  !> What m adds to element_stiffness: the derivative of element_forces by m, and the derivatives by u and m of
  !!   scale (sum_b matrix(a, b) m_b - sum over points of old volume N_a |D|),  |D| = sqrt(D : D/2), D the symmetric part of L.
  !! The variation of D is that of L in element_stiffness. Nodes that are no vertices get the equation m = 0.
  subroutine element_coupling(shape_gradients, vertex_values, x_new, volume, old_volume, L, by_nonlocal, matrix, scale, &
      mean_dilatation, K)
    real(dp), intent(in) :: shape_gradients(:, :, :)      ! (nodes, d, points)
    real(dp), intent(in) :: vertex_values(:, :)           ! (vertices, points)
    real(dp), intent(in) :: x_new(:, :, :)                ! (d, nodes, cells): after the increment
    real(dp), intent(in) :: volume(:, :)                  ! (points, cells): after the increment
    real(dp), intent(in) :: old_volume(:, :)              ! (points, cells): before it, as matrix
    real(dp), intent(in) :: L(:, :, :, :)                 ! (3, 3, points, cells)
    real(dp), intent(in) :: by_nonlocal(:, :, :)          ! (6 or, in the plane, 4, points, cells): d stress/d m
    real(dp), intent(in) :: matrix(:, :, :)               ! (vertices, vertices, cells) of element_helmholtz
    real(dp), intent(in) :: scale
    logical, intent(in) :: mean_dilatation
    real(dp), intent(inout) :: K(:, :, :)                 ! ((d + 1) nodes, (d + 1) nodes, cells): (column, row)
    real(dp) :: x(LANES, size(x_new, 1), size(x_new, 2)), spatial(LANES, 3, size(x_new, 2))
    real(dp), dimension(LANES, size(x_new, 1) * size(x_new, 2), size(vertex_values, 1)) :: forces_by_m, source_by_u
    real(dp), dimension(LANES, size(x_new, 1) * size(x_new, 2)) :: mean_divergence, along_stress, along_strain
    real(dp), dimension(LANES, size(vertex_values, 1)) :: pressure_by_m, source_by_dilatation
    real(dp), dimension(LANES, 3, 3) :: slope, E, stress_slope, isotropic
    real(dp), dimension(LANES) :: det, dv, old_dv, e_mean, s_mean, cell_volume
    real(dp) :: s(LANES, 6)
    integer :: cell(LANES), first, lane, q, i, a, d

    d = size(x_new, 1)
    do first = 1, size(x_new, 3), LANES
      cell = group(first, size(x_new, 3))
      x = nodal(x_new, cell)
      cell_volume = sum(volume(:, cell), 1)
      isotropic = 0
      do i = 1, d
        isotropic(:, i, i) = 1 / cell_volume
      end do
      forces_by_m = 0
      source_by_u = 0
      mean_divergence = 0
      pressure_by_m = 0
      source_by_dilatation = 0
      do q = 1, size(volume, 1)
        dv = volume(q, cell)
        old_dv = old_volume(q, cell)
        call spatial_gradients(shape_gradients(:, :, q), x, spatial, det)
        s = 0
        s(:, :size(by_nonlocal, 1)) = transpose(by_nonlocal(:, q, cell))
        stress_slope = to_matrix(s)
        slope = slope_of_magnitude(L, q, cell)
        E = adjoint_of_logarithm(gradient(L, q, cell), slope)
        if (mean_dilatation) then
          s_mean = 0
          e_mean = 0
          do i = 1, d
            s_mean = s_mean + stress_slope(:, i, i) / d
            e_mean = e_mean + slope(:, i, i) / d
          end do
          do i = 1, d
            stress_slope(:, i, i) = stress_slope(:, i, i) - s_mean
            E(:, i, i) = E(:, i, i) - e_mean
          end do
          call add_projection(spatial, dv, isotropic, mean_divergence)
          do a = 1, size(vertex_values, 1)
            pressure_by_m(:, a) = pressure_by_m(:, a) + dv * vertex_values(a, q) * s_mean
            source_by_dilatation(:, a) = source_by_dilatation(:, a) + old_dv * vertex_values(a, q) * e_mean
          end do
        end if
        along_stress = 0
        along_strain = 0
        call add_projection(spatial, dv, stress_slope, along_stress)
        call add_projection(spatial, old_dv, E, along_strain)
        do a = 1, size(vertex_values, 1)
          forces_by_m(:, :, a) = forces_by_m(:, :, a) + vertex_values(a, q) * along_stress
          source_by_u(:, :, a) = source_by_u(:, :, a) + vertex_values(a, q) * along_strain
        end do
      end do
      if (mean_dilatation) then
        do a = 1, size(vertex_values, 1)
          do i = 1, size(mean_divergence, 2)
            forces_by_m(:, i, a) = forces_by_m(:, i, a) + mean_divergence(:, i) * pressure_by_m(:, a)
            source_by_u(:, i, a) = source_by_u(:, i, a) + mean_divergence(:, i) * source_by_dilatation(:, a)
          end do
        end do
      end if
      do lane = 1, LANES
        call set_coupling(forces_by_m(lane, :, :), -scale * source_by_u(lane, :, :), scale * matrix(:, :, cell(lane)), d, &
          K(:, :, cell(lane)))
      end do
    end do
  end subroutine element_coupling

  !> Writes the rows and columns of m into a cell's matrix.
  pure subroutine set_coupling(forces_by_m, m_by_u, m_by_m, d, K)
    real(dp), intent(in), dimension(:, :) :: forces_by_m, m_by_u     ! (d nodes, vertices)
    real(dp), intent(in) :: m_by_m(:, :)                             ! (vertices, vertices): symmetric
    integer, intent(in) :: d
    real(dp), intent(inout) :: K(:, :)                               ! ((d + 1) nodes, (d + 1) nodes): (column, row)
    integer :: a, b, of_m

    do a = 1, size(m_by_u, 2)
      of_m = a * (d + 1)
      do b = 1, size(m_by_u, 1) / d
        K(of_m, (b - 1) * (d + 1) + 1:b * (d + 1) - 1) = forces_by_m((b - 1) * d + 1:b * d, a)
        K((b - 1) * (d + 1) + 1:b * (d + 1) - 1, of_m) = m_by_u((b - 1) * d + 1:b * d, a)
      end do
      do b = 1, size(m_by_m, 1)
        K(b * (d + 1), of_m) = m_by_m(b, a)
      end do
    end do
    do a = size(m_by_u, 2) + 1, size(m_by_u, 1) / d
      of_m = a * (d + 1)
      K(of_m, :) = 0
      K(:, of_m) = 0
      K(of_m, of_m) = 1
    end do
  end subroutine set_coupling

  !> D/(2 |D|), the derivative of |D| by D; 0 where D = 0.
  pure function slope_of_magnitude(L, q, cell) result(slope)
    real(dp), intent(in) :: L(:, :, :, :)            ! (3, 3, points, cells)
    integer, intent(in) :: q
    integer, intent(in) :: cell(LANES)
    real(dp) :: slope(LANES, 3, 3), square(LANES)
    integer :: i, j
    square = 0
    slope = gradient(L, q, cell)
    do j = 1, 3
      do i = 1, j
        slope(:, i, j) = (slope(:, i, j) + slope(:, j, i)) / 2
        slope(:, j, i) = slope(:, i, j)
        square = square + merge(0.5_dp, 1.0_dp, i == j) * slope(:, i, j)**2
      end do
    end do
    square = 2 * max(sqrt(square), tiny(1.0_dp))
    do j = 1, 3
      do i = 1, 3
        slope(:, i, j) = slope(:, i, j) / square
      end do
    end do
  end function slope_of_magnitude

  !> The velocity gradients, (:, i, j) = du_i/dx_j, of a point of every cell of a group.
  pure function gradient(L, q, cell) result(G)
    real(dp), intent(in) :: L(:, :, :, :)            ! (3, 3, points, cells)
    integer, intent(in) :: q
    integer, intent(in) :: cell(LANES)
    real(dp) :: G(LANES, 3, 3)
    integer :: lane
    do lane = 1, LANES
      G(lane, :, :) = transpose(L(:, :, q, cell(lane)))
    end do
  end function gradient

  !> The cells of the group that begins with the first.
  pure function group(first, cells) result(cell)
    integer, intent(in) :: first
    integer, intent(in) :: cells
    integer :: cell(LANES), k
    cell = min([(first + k, k = 0, LANES - 1)], cells)
  end function group

  !> What the nodes of a group of cells have.
  pure function nodal(field, cell) result(values)
    real(dp), intent(in) :: field(:, :, :)           ! (d, nodes, cells)
    integer, intent(in) :: cell(LANES)
    real(dp) :: values(LANES, size(field, 1), size(field, 2))
    integer :: k
    do k = 1, LANES
      values(k, :, :) = field(:, :, cell(k))
    end do
  end function nodal

  !> E(:, :, :, i): the derivative of stress i by h, as a matrix to be contracted with it; e_iso: by an isotropic strain of d axes
  !! (not by h).
  pure subroutine stress_slopes(tangent, L, q, cell, d, E, e_iso)
    real(dp), intent(in) :: tangent(:, :, :, :)      ! (9, 6, points, cells) or (4, 4, points, cells)
    real(dp), intent(in) :: L(:, :, :, :)            ! (3, 3, points, cells)
    integer, intent(in) :: q
    integer, intent(in) :: cell(LANES)
    integer, intent(in) :: d
    real(dp), intent(out) :: E(LANES, 3, 3, 6)
    real(dp), intent(out) :: e_iso(LANES, 6)
    real(dp), dimension(LANES, 3, 3) :: G, slope
    real(dp) :: by_strain_and_spin(LANES, 9)
    integer :: lane, i, k, m

    G = gradient(L, q, cell)
    e_iso = 0
    E = 0
    by_strain_and_spin = 0
    do i = 1, size(tangent, 2)
      do lane = 1, LANES
        if (d == 2) then
          by_strain_and_spin(lane, PLANE_COLUMNS) = tangent(:, i, q, cell(lane))
        else
          by_strain_and_spin(lane, :) = tangent(:, i, q, cell(lane))
        end if
      end do
      do m = 1, 3
        do k = 1, 3
          slope(:, k, m) = by_strain_and_spin(:, VOIGT(k, m))
          if (k /= m) slope(:, k, m) = slope(:, k, m) &
            + sign(0.5_dp, real(SPIN(k, m), dp)) * by_strain_and_spin(:, abs(SPIN(k, m)))
        end do
      end do
      do k = 1, d
        e_iso(:, i) = e_iso(:, i) + slope(:, k, k)
      end do
      E(:, :, :, i) = adjoint_of_logarithm(G, slope)
    end do
  end subroutine stress_slopes

  !> The weight of h in slope : dL, where L = G varies by dL = h - [L, h]/2 + [L, [L, h]]/12 - ...
  pure function adjoint_of_logarithm(G, slope) result(E)
    real(dp), intent(in), dimension(LANES, 3, 3) :: G, slope
    real(dp), dimension(LANES, 3, 3) :: E, first, second, fourth
    first = commutator(G, slope)
    second = commutator(G, first)
    fourth = commutator(G, commutator(G, second))
    E = slope - first / 2 + second / 12 - fourth / 720
  end function adjoint_of_logarithm

  !> R -> G^T R - R G^T, so that (its result) : h = R : [G, h].
  pure function commutator(G, R) result(adjoint)
    real(dp), intent(in), dimension(LANES, 3, 3) :: G, R
    real(dp) :: adjoint(LANES, 3, 3)
    integer :: i, j
    do j = 1, 3
      do i = 1, 3
        adjoint(:, i, j) = G(:, 1, i) * R(:, 1, j) + G(:, 2, i) * R(:, 2, j) + G(:, 3, i) * R(:, 3, j) &
          - R(:, i, 1) * G(:, j, 1) - R(:, i, 2) * G(:, j, 2) - R(:, i, 3) * G(:, j, 3)
      end do
    end do
  end function commutator

  !> matrix += dv G^T X G for the gradients G of all nodes; (column, row).
  pure subroutine add_product(spatial, dv, X, d, matrix)
    real(dp), intent(in) :: spatial(:, :, :)         ! (LANES, 3, nodes)
    real(dp), intent(in) :: dv(LANES)
    real(dp), intent(in) :: X(LANES, 3, 3, 3, 3)     ! (k, l, i, j): column's component and derivative, row's
    integer, intent(in) :: d
    real(dp), intent(inout) :: matrix(:, :, :)       ! (LANES, d nodes, d nodes)
    real(dp) :: T(LANES, 3, 3)
    integer :: a, b, i, k, m, row, column

    do a = 1, size(spatial, 3)
      do i = 1, d
        row = (a - 1) * d + i
        do m = 1, 3
          do k = 1, d
            T(:, k, m) = dv * (X(:, k, m, i, 1) * spatial(:LANES, 1, a) + X(:, k, m, i, 2) * spatial(:LANES, 2, a) &
              + X(:, k, m, i, 3) * spatial(:LANES, 3, a))
          end do
        end do
        do b = 1, size(spatial, 3)
          do k = 1, d
            column = (b - 1) * d + k
            matrix(:LANES, column, row) = matrix(:LANES, column, row) + T(:, k, 1) * spatial(:LANES, 1, b) &
              + T(:, k, 2) * spatial(:LANES, 2, b) + T(:, k, 3) * spatial(:LANES, 3, b)
          end do
        end do
      end do
    end do
  end subroutine add_product

  !> v += s G^T m: m_ij weighs d(du_i)/dx_j.
  pure subroutine add_projection(spatial, s, m, v)
    real(dp), intent(in) :: spatial(:, :, :)         ! (LANES, 3, nodes)
    real(dp), intent(in) :: s(LANES)
    real(dp), intent(in) :: m(LANES, 3, 3)
    real(dp), intent(inout) :: v(:, :)               ! (LANES, d nodes)
    integer :: a, i, d, row
    d = size(v, 2) / size(spatial, 3)
    do a = 1, size(spatial, 3)
      do i = 1, d
        row = (a - 1) * d + i
        v(:LANES, row) = v(:LANES, row) + s * (m(:, i, 1) * spatial(:LANES, 1, a) + m(:, i, 2) * spatial(:LANES, 2, a) &
          + m(:, i, 3) * spatial(:LANES, 3, a))
      end do
    end do
  end subroutine add_projection

  !> The stress that works on the actual gradients: with mean dilatation the cell's mean pressure takes the place of the point's.
  pure function working_stress(stress, q, cell, mean, mean_dilatation, d) result(tau)
    real(dp), intent(in) :: stress(:, :, :)          ! (6, points, cells)
    integer, intent(in) :: q
    integer, intent(in) :: cell(LANES)
    real(dp), intent(in) :: mean(LANES)
    logical, intent(in) :: mean_dilatation
    integer, intent(in) :: d
    real(dp) :: tau(LANES, 3, 3), excess(LANES)
    integer :: i
    tau = to_matrix(transpose(stress(:, q, cell)))
    if (.not. mean_dilatation) return
    excess = mean - axial_mean(stress, q, cell, d)
    do i = 1, 3
      tau(:, i, i) = tau(:, i, i) + excess
    end do
  end function working_stress

  !> The cells' volume means of the stress's mean over d axes.
  pure function mean_pressure(stress, volume, cell, d) result(mean)
    real(dp), intent(in) :: stress(:, :, :)          ! (6, points, cells)
    real(dp), intent(in) :: volume(:, :)             ! (points, cells)
    integer, intent(in) :: cell(LANES)
    integer, intent(in) :: d
    real(dp) :: mean(LANES)
    integer :: q
    mean = 0
    do q = 1, size(volume, 1)
      mean = mean + volume(q, cell) * axial_mean(stress, q, cell, d)
    end do
    mean = mean / sum(volume(:, cell), 1)
  end function mean_pressure

  pure function axial_mean(stress, q, cell, d) result(mean)
    real(dp), intent(in) :: stress(:, :, :)          ! (6, points, cells)
    integer, intent(in) :: q
    integer, intent(in) :: cell(LANES)
    integer, intent(in) :: d
    real(dp) :: mean(LANES)
    integer :: k
    do k = 1, LANES
      mean(k) = sum(stress(:d, q, cell(k))) / d
    end do
  end function axial_mean

  !> Derivatives of the shape functions by position, where the nodes are at x; det is that of the map from the reference cell.
  pure subroutine spatial_gradients(reference, x, spatial, det)
    real(dp), intent(in) :: reference(:, :)          ! (nodes, d)
    real(dp), intent(in) :: x(:, :, :)               ! (LANES, d, nodes)
    real(dp), intent(out) :: spatial(:, :, :)        ! (LANES, 3, nodes)
    real(dp), intent(out) :: det(LANES)
    real(dp) :: inverse(LANES, 3, 3)
    call inverse_jacobian(reference, x, inverse, det)
    call to_spatial(reference, inverse, spatial)
  end subroutine spatial_gradients

  !> The inverse of the map's derivative from the reference cell, where the nodes are at x, and its determinant before inversion.
  pure subroutine inverse_jacobian(reference, x, inverse, det)
    real(dp), intent(in) :: reference(:, :)          ! (nodes, d)
    real(dp), intent(in) :: x(:, :, :)               ! (LANES, d, nodes)
    real(dp), intent(out) :: inverse(LANES, 3, 3)
    real(dp), intent(out) :: det(LANES)
    real(dp) :: J_x(LANES, 3, 3)
    J_x = jacobian(reference, x)
    if (size(x, 2) == 2) J_x(:, 3, 3) = 1
    call invert(J_x, inverse, det)
  end subroutine inverse_jacobian

  !> Derivatives by position of functions whose derivatives by reference coordinates are given.
  pure subroutine to_spatial(reference, inverse, spatial)
    real(dp), intent(in) :: reference(:, :)          ! (functions, d)
    real(dp), intent(in) :: inverse(LANES, 3, 3)
    real(dp), intent(out) :: spatial(:, :, :)        ! (LANES, 3, functions)
    integer :: a, i, j
    spatial = 0
    do a = 1, size(reference, 1)
      do j = 1, size(reference, 2)
        do i = 1, size(reference, 2)
          spatial(:LANES, j, a) = spatial(:LANES, j, a) + reference(a, i) * inverse(:, i, j)
        end do
      end do
    end do
  end subroutine to_spatial

  !> J(:, i, j): the derivative of component i of what the nodes have by reference coordinate j.
  pure function jacobian(reference, nodal) result(J)
    real(dp), intent(in) :: reference(:, :)          ! (nodes, d)
    real(dp), intent(in) :: nodal(:, :, :)           ! (LANES, d, nodes)
    real(dp) :: J(LANES, 3, 3)
    integer :: a, i, k
    J = 0
    do a = 1, size(reference, 1)
      do k = 1, size(nodal, 2)
        do i = 1, size(nodal, 2)
          J(:, i, k) = J(:, i, k) + nodal(:LANES, i, a) * reference(a, k)
        end do
      end do
    end do
  end function jacobian

end module granumat_element
