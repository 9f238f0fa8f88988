!> What the points of a mesh have, after the mesh has moved while the material stayed: one stage of a discontinuous Galerkin step.
!!
!! Cells are quadrilaterals or hexahedra with d-linear maps and 2^d Gauss points. A cell's nodes are in tensor order: bit k - 1 of
!! (number - 1) is the reference coordinate along k; its points, and the Gauss points of its faces, bear the numbers of the nodes
!! that they are nearest to. Face 2 k - 1 is where coordinate k is 0, face 2 k where it is 1.
!!
!! A point has COLUMNS numbers: tensors of six components, then scalars, of which the second is the volume fraction phi.
!! While the mesh goes from x_start to x_end at the velocity w, in a pseudo-time from 0 to 1, the solid phi and what it carries,
!! phi psi, psi every other column, obey, with the d-linear functions l_q that are 1 at point q and 0 at the others,
!!
!!   d/dtau (m_q U_q) = sum over faces int l_q U w.n dS - sum over points p of w_p det J_p U_p (w.grad l_q)(p),   m_q = w_q det J_q.
!!
!! Areas are means over the step, so that dm_q is met exactly and a constant stays a constant. See docs/theory.md, section 9.
module granumat_convection
  use granumat_kinds, only: dp
  implicit none (type, external)
  private
  public :: convection_stage, convection_ranges, swept_volumes, COLUMNS, RANGES

  integer, parameter :: COLUMNS = 24                 ! a state's 20 numbers and four more: whole vectors of any instruction set
  integer, parameter :: TENSORS = 3                  ! stress, fabric, direction: a state's first 18 numbers
  integer, parameter :: FABRIC = 7                   ! its first column
  integer, parameter :: SCALARS = 6 * TENSORS + 1    ! first column of the scalars
  integer, parameter :: RANGES = 3 * COLUMNS + TENSORS + 1     ! low, high, center by column; radius by tensor; abs(A)^2
  integer, parameter :: POINTS = 8                   ! of a cell, at most
  integer, parameter :: PHI = 6 * TENSORS + 2        ! column of the volume fraction
  real(dp), parameter :: ROOT_3 = sqrt(3.0_dp)
  real(dp), parameter :: GAUSS(0:1) = [0.5_dp - 0.5_dp / ROOT_3, 0.5_dp + 0.5_dp / ROOT_3]
  real(dp), parameter :: BEYOND = (ROOT_3 - 1) / 2   ! on a face, a function is that at the near point + BEYOND (near - far)
  real(dp), parameter :: ALLOWANCE = 4               ! less than 1/0.15 - 1, where at most 0.15 of a cell is swept

  !> The shape functions of a cell's nodes and their derivatives at its points (k = 0) and, k > 0, at the points of its two faces
  !! across the reference coordinate k, together as many. Points that a cell in the plane has not have zeros.
  type :: reference_cell
    integer :: d
    real(dp) :: shape_functions(POINTS, POINTS, 0:3)      ! (point, node, k)
    real(dp) :: slopes(POINTS, POINTS, 3, 0:3)            ! (point, node, reference coordinate, k)
  end type reference_cell

contains

  !> out = share of start + (1 - share) of (stage + what the step brings to it), limited: with share 0 and stage = start the first
  !! stage of the second-order strong-stability-preserving Runge-Kutta scheme, with share 1/2 its second.
  pure subroutine convection_stage(x_start, x_end, share, neighbour, opposite, wall, range, fabric_limit, start, stage, out)
    real(dp), intent(in) :: x_start(:, :, :)         ! (d, nodes, cells)
    real(dp), intent(in) :: x_end(:, :, :)           ! (d, nodes, cells)
    real(dp), intent(in) :: share
    integer, intent(in) :: neighbour(:, :)           ! (2 d, cells): the cell beyond a face, 0 where the body ends
    integer, intent(in) :: opposite(:, :, :, :)      ! (2, nodes, 2 d, cells): the neighbour's near and far point at a face's
    integer, intent(in) :: wall(:, :)                ! (2 d, cells): 1 where no solid passes
    real(dp), intent(in) :: range(:, :)              ! (RANGES, cells): of start
    real(dp), intent(in) :: fabric_limit             ! A : A may become as large, and no larger than it is nearby if that is more
    real(dp), intent(in), contiguous :: start(:, :, :)         ! (COLUMNS, points, cells and further ones that are neighbours)
    real(dp), intent(in), contiguous :: stage(:, :, :)         ! the same
    real(dp), intent(out), contiguous :: out(:, :, :)          ! (COLUMNS, points, cells)
    real(dp), dimension(POINTS) :: mass_start, mass_end, mass_stage
    real(dp) :: sweep(3, POINTS), face_sweep(POINTS, 6), amount(COLUMNS, POINTS), flux(COLUMNS)
    type(reference_cell) :: reference
    integer :: cell, d, k, face, q, far

    d = size(x_start, 1)
    reference = reference_of(d)
    do cell = 1, size(out, 3)
      call measure(reference, x_start(:, :, cell), x_end(:, :, cell), mass_start, mass_end, sweep, face_sweep)
      mass_stage = merge(mass_start, mass_end, share <= 0)
      do q = 1, 2**d
        amount(:, q) = (1 - share) * mass_stage(q) * carried(stage(:, q, cell)) + share * mass_start(q) * carried(start(:, q, cell))
      end do
      do k = 1, d                                    ! grad l_q is -+ sqrt(3) along the line through q, 0 across it
        do q = 1, 2**d
          if (btest(q - 1, k - 1)) cycle
          far = across(q, k)
          flux = (1 - share) * ROOT_3 * (sweep(k, q) * carried(stage(:, q, cell)) + sweep(k, far) * carried(stage(:, far, cell)))
          amount(:, q) = amount(:, q) + flux
          amount(:, far) = amount(:, far) - flux
        end do
      end do
      do face = 1, 2 * d
        call add_face(stage, cell, face, neighbour(face, cell), opposite(:, :, face, cell), wall(face, cell) == 1, &
          (1 - share) * face_sweep(:, face), 2**d, fabric_limit, amount)
      end do
      call divide_and_limit(range(:, cell), fabric_limit, mass_end, amount, 2**d, out(:, :, cell))
    end do
  end subroutine convection_stage

  !> The ranges of the values that a cell's points and its neighbours' have: of scalars the interval; of tensors, in any axes alike,
  !! the radius of the ball about the cell's mean that holds them; and the largest A : A.
  pure subroutine convection_ranges(x, neighbour, values, range)
    real(dp), intent(in) :: x(:, :, :)               ! (d, nodes, cells)
    integer, intent(in) :: neighbour(:, :)           ! (2 d, cells)
    real(dp), intent(in), contiguous :: values(:, :, :)        ! (COLUMNS, points, cells and further ones that are neighbours)
    real(dp), intent(out) :: range(:, :)             ! (RANGES, cells)
    real(dp), dimension(COLUMNS) :: low, high, center
    real(dp) :: radius(TENSORS), magnitude, solid(POINTS), J(POINTS, 3, 3)
    type(reference_cell) :: reference
    integer :: cell, q, k, d

    d = size(x, 1)
    reference = reference_of(d)
    do cell = 1, size(range, 2)
      center = 0
      J = jacobians(reference, 0, in_space(x(:, :, cell)))
      solid = volumes(J)
      do q = 1, 2**d
        solid(q) = solid(q) * values(PHI, q, cell)
        center = center + solid(q) * values(:, q, cell)
      end do
      center = center / sum(solid(:2**d))
      low = values(:, 1, cell)
      high = low
      radius = 0
      magnitude = 0
      call widen(values(:, :, cell), 2**d, center, low, high, radius, magnitude)
      do k = 1, 2 * d
        if (neighbour(k, cell) > 0) call widen(values(:, :, neighbour(k, cell)), 2**d, center, low, high, radius, magnitude)
      end do
      range(:, cell) = [low, high, center, sqrt(radius), magnitude]
    end do
  end subroutine convection_ranges

  !> The larger of the volumes that a cell gains and loses through its faces, over its volume; huge where it is inverted.
  pure subroutine swept_volumes(x_start, x_end, swept)
    real(dp), intent(in) :: x_start(:, :, :)         ! (d, nodes, cells)
    real(dp), intent(in) :: x_end(:, :, :)           ! (d, nodes, cells)
    real(dp), intent(out) :: swept(:)                ! (cells)
    real(dp) :: mass_start(POINTS), mass_end(POINTS), sweep(3, POINTS), face_sweep(POINTS, 6)
    type(reference_cell) :: reference
    integer :: cell, d

    d = size(x_start, 1)
    reference = reference_of(d)
    do cell = 1, size(swept)
      call measure(reference, x_start(:, :, cell), x_end(:, :, cell), mass_start, mass_end, sweep, face_sweep)
      swept(cell) = max(sum(face_sweep, mask=face_sweep > 0), -sum(face_sweep, mask=face_sweep < 0)) &
        / min(sum(mass_start), sum(mass_end))
      if (.not. (min(minval(mass_start(:2**d)), minval(mass_end(:2**d))) > 0)) swept(cell) = huge(1.0_dp)
    end do
  end subroutine swept_volumes

  !> Volumes of a cell's points before and after, and the volumes that they and the points of its faces sweep in between.
  pure subroutine measure(reference, x_start, x_end, mass_start, mass_end, sweep, face_sweep)
    type(reference_cell), intent(in) :: reference
    real(dp), intent(in) :: x_start(:, :)            ! (d, nodes)
    real(dp), intent(in) :: x_end(:, :)              ! (d, nodes)
    real(dp), intent(out), dimension(POINTS) :: mass_start, mass_end
    real(dp), intent(out) :: sweep(3, POINTS)        ! through the coordinate surfaces of a point, towards larger coordinates
    real(dp), intent(out) :: face_sweep(POINTS, 6)   ! outward, at the faces' points
    real(dp), dimension(3, POINTS) :: x, x_new
    real(dp), dimension(POINTS, 3, 3) :: J, J_new
    real(dp) :: w(POINTS, 3), through(POINTS), orientation
    integer :: q, k, side, d

    d = reference%d
    x = in_space(x_start)
    x_new = in_space(x_end)
    J = jacobians(reference, 0, x)
    J_new = jacobians(reference, 0, x_new)
    w = displacements(reference, 0, x, x_new)
    mass_start = volumes(J)
    mass_end = volumes(J_new)
    orientation = sign(1.0_dp, sum(mass_start))      ! of the map from the reference cell
    mass_start = orientation * mass_start / 2**d
    mass_end = orientation * mass_end / 2**d
    sweep = 0
    do k = 1, d
      through = orientation * swept_through(k, w, J, J_new) / 2**d
      sweep(k, :) = through
    end do
    face_sweep = 0
    do k = 1, d
      J = jacobians(reference, k, x)
      J_new = jacobians(reference, k, x_new)
      w = displacements(reference, k, x, x_new)
      through = orientation * swept_through(k, w, J, J_new) / 2**(d - 1)
      do q = 1, 2**d
        side = ibits(q - 1, k - 1, 1)
        face_sweep(q, 2 * k - 1 + side) = (2 * side - 1) * through(q)
      end do
    end do
  end subroutine measure

  !> What points sweep through the surface where the reference coordinate k is constant, whose area is a mean over the step.
  pure function swept_through(k, w, J, J_new) result(sweep)
    integer, intent(in) :: k
    real(dp), intent(in) :: w(POINTS, 3)
    real(dp), intent(in), dimension(POINTS, 3, 3) :: J, J_new
    real(dp), dimension(POINTS, 3) :: a, b, c
    real(dp) :: sweep(POINTS)
    integer :: gauss_point, m, n

    m = mod(k, 3) + 1
    n = mod(k + 1, 3) + 1
    sweep = 0
    do gauss_point = 0, 1                            ! areas are of degree d - 1 in time
      a = (1 - GAUSS(gauss_point)) * J(:, :, m) + GAUSS(gauss_point) * J_new(:, :, m)
      b = (1 - GAUSS(gauss_point)) * J(:, :, n) + GAUSS(gauss_point) * J_new(:, :, n)
      c = cross(a, b)
      sweep = sweep + (w(:, 1) * c(:, 1) + w(:, 2) * c(:, 2) + w(:, 3) * c(:, 3)) / 2
    end do
  end function swept_through

  !> A cell's nodes with three coordinates each.
  pure function in_space(x)
    real(dp), intent(in) :: x(:, :)                  ! (d, nodes)
    real(dp) :: in_space(3, POINTS)
    in_space = 0
    in_space(:size(x, 1), :size(x, 2)) = x
  end function in_space

  !> Adds what passes a face of a cell: the neighbour's where the cell grows, else its own. At a wall no solid passes on the whole.
  pure subroutine add_face(stage, cell, face, neighbour, opposite, is_wall, sweep, count, fabric_limit, amount)
    real(dp), intent(in), contiguous :: stage(:, :, :)         ! (COLUMNS, points, cells)
    integer, intent(in) :: cell, face, neighbour
    integer, intent(in) :: opposite(:, :)            ! (2, points)
    logical, intent(in) :: is_wall
    real(dp), intent(in) :: sweep(POINTS)
    integer, intent(in) :: count                     ! points of the cell
    real(dp), intent(in) :: fabric_limit
    real(dp), intent(inout) :: amount(COLUMNS, POINTS)
    real(dp) :: trace(COLUMNS, POINTS), flux(COLUMNS), net
    real(dp), dimension(COLUMNS) :: low, high, own_mean, mean
    integer :: q, k, far

    k = (face + 1) / 2
    trace(PHI, :) = 0                                ! at points of other faces
    if (neighbour > 0) call bounds_of(stage(:, :, cell), stage(:, :, neighbour), count, low, high, own_mean, mean)
    do q = 1, count
      if (ibits(q - 1, k - 1, 1) /= mod(face + 1, 2)) cycle
      far = across(q, k)
      trace(:, q) = extrapolated(stage(:, q, cell), stage(:, far, cell))
      if (neighbour == 0) cycle
      if (sweep(q) > 0) then
        trace(:, q) = extrapolated(stage(:, opposite(1, q), neighbour), stage(:, opposite(2, q), neighbour))
        trace(SCALARS:, q) = confined(trace(SCALARS:, q), low(SCALARS:), high(SCALARS:), own_mean(SCALARS:))
      else
        trace(SCALARS:, q) = confined(trace(SCALARS:, q), low(SCALARS:), high(SCALARS:), mean(SCALARS:))
      end if
      call confine_fabric(stage(:, :, cell), stage(:, :, neighbour), count, fabric_limit, trace(:, q))
    end do
    net = 0
    if (is_wall) net = dot_product(sweep(:count), trace(PHI, :count)) / sum(trace(PHI, :count))
    do q = 1, count
      if (ibits(q - 1, k - 1, 1) /= mod(face + 1, 2)) cycle
      far = across(q, k)
      flux = (sweep(q) - net) * carried(trace(:, q))
      amount(:, q) = amount(:, q) + (1 + BEYOND) * flux
      amount(:, far) = amount(:, far) - BEYOND * flux
    end do
  end subroutine add_face

  !> The amounts at a cell's points over their volumes, drawn towards the cell's mean as far as they exceed the ranges. Means are
  !! kept: of phi by volume, of others by solid.
  pure subroutine divide_and_limit(range, fabric_limit, mass, amount, count, out)
    real(dp), intent(in) :: range(RANGES)
    real(dp), intent(in) :: fabric_limit
    real(dp), intent(in) :: mass(POINTS)
    real(dp), intent(in) :: amount(COLUMNS, POINTS)
    integer, intent(in) :: count                     ! points of the cell
    real(dp), intent(out), contiguous :: out(:, :)   ! (COLUMNS, points)
    real(dp), dimension(COLUMNS) :: mean, factor, change, total, lowest, highest
    real(dp) :: solid(POINTS)
    integer :: q, t, first

    total = 0
    do q = 1, count
      total = total + amount(:, q)
      out(:, q) = amount(:, q) / amount(PHI, q)
      out(PHI, q) = amount(PHI, q) / mass(q)
    end do
    mean(PHI) = total(PHI) / sum(mass(:count))
    factor(PHI) = interval_factor(minval(out(PHI, :count)), maxval(out(PHI, :count)), mean(PHI), range(PHI), range(COLUMNS + PHI))
    if (factor(PHI) < 1) out(PHI, :count) = mean(PHI) + factor(PHI) * (out(PHI, :count) - mean(PHI))
    change = total                                   ! what the points lack of the amounts, where phi was limited
    do q = 1, count
      solid(q) = mass(q) * out(PHI, q)
      change = change - solid(q) * out(:, q)
    end do
    mean = total / sum(solid(:count))
    change = change / sum(solid(:count))
    change(PHI) = 0
    lowest = huge(1.0_dp)
    highest = -lowest
    do q = 1, count
      out(:, q) = out(:, q) + change
      lowest = min(lowest, out(:, q))
      highest = max(highest, out(:, q))
    end do
    factor = interval_factor(lowest, highest, mean, range(:COLUMNS), range(COLUMNS + 1:2 * COLUMNS))
    factor(PHI) = 1
    do t = 1, TENSORS
      first = 6 * t - 5
      factor(first:6 * t) = ball_factor(out, first, count, mean, range)
    end do
    factor(FABRIC:FABRIC + 5) = min(factor(FABRIC:FABRIC + 5), fabric_factor(out, count, mean, max(fabric_limit, range(RANGES))))
    if (all(factor >= 1)) return
    do q = 1, count
      out(:, q) = merge(mean + factor * (out(:, q) - mean), out(:, q), factor < 1)
    end do
  end subroutine divide_and_limit

  !> Widens ranges by what the points of a cell have: those of the columns, the squares of the tensors' distances from a center, and
  !! A : A.
  pure subroutine widen(values, count, center, low, high, radius, magnitude)
    real(dp), intent(in), contiguous :: values(:, :) ! (COLUMNS, points)
    integer, intent(in) :: count
    real(dp), intent(in) :: center(COLUMNS)
    real(dp), intent(inout) :: low(COLUMNS), high(COLUMNS)
    real(dp), intent(inout) :: radius(TENSORS), magnitude
    integer :: q
    do q = 1, count
      low = min(low, values(:, q))
      high = max(high, values(:, q))
      radius = max(radius, squares(values(:, q) - center))
      magnitude = max(magnitude, fabric_square(values(:, q)))
    end do
  end subroutine widen

  !> The largest factor up to 1 that leaves mean + factor (values - mean) in an interval.
  pure elemental function interval_factor(lowest, highest, mean, low, high) result(factor)
    real(dp), intent(in) :: lowest, highest          ! of the values
    real(dp), intent(in) :: mean, low, high
    real(dp) :: factor, up, down
    up = 1
    if (highest > max(high, mean)) up = max(high - mean, 0.0_dp) / (highest - mean)
    down = 1
    if (lowest < min(low, mean)) down = max(mean - low, 0.0_dp) / (mean - lowest)
    factor = min(up, down)
  end function interval_factor

  !> The largest factor up to 1 for which mean + factor (values - mean) of a tensor is sure to be within the radius of the center.
  pure function ball_factor(values, first, count, mean, range) result(factor)
    real(dp), intent(in), contiguous :: values(:, :) ! (COLUMNS, points)
    integer, intent(in) :: first                     ! of the tensor's columns
    integer, intent(in) :: count
    real(dp), intent(in) :: mean(COLUMNS)
    real(dp), intent(in) :: range(RANGES)
    real(dp) :: factor, largest, room, radius, difference(6)
    integer :: q

    radius = range(3 * COLUMNS + (first + 5) / 6)
    largest = 0
    do q = 1, count
      difference = values(first:first + 5, q) - mean(first:first + 5)
      largest = max(largest, contraction(difference, difference))
    end do
    difference = mean(first:first + 5) - range(2 * COLUMNS + first:2 * COLUMNS + first + 5)
    room = max(radius - sqrt(contraction(difference, difference)), 0.0_dp)
    factor = 1
    if (sqrt(largest) > room) factor = room / sqrt(largest)
  end function ball_factor

  !> The largest factor up to 1 for which A : A of mean + factor (values - mean) is within a limit.
  pure function fabric_factor(values, count, mean, limit) result(factor)
    real(dp), intent(in), contiguous :: values(:, :) ! (COLUMNS, points)
    integer, intent(in) :: count
    real(dp), intent(in) :: mean(COLUMNS)
    real(dp), intent(in) :: limit
    real(dp) :: factor, short, square, product, m(6), A_q(6)
    integer :: q

    m = mean(FABRIC:FABRIC + 5)
    short = max(limit - contraction(m, m), 0.0_dp)
    factor = 1
    do q = 1, count
      A_q = values(FABRIC:FABRIC + 5, q)
      if (contraction(A_q, A_q) <= limit) cycle
      A_q = A_q - m
      square = contraction(A_q, A_q)                 ! square f^2 + 2 product f = short
      product = contraction(m, A_q)
      factor = min(factor, (sqrt(product**2 + square * short) - product) / square)
    end do
  end function fabric_factor

  !> Of the columns of two cells: the interval that holds them all, and the mean of each cell.
  pure subroutine bounds_of(first, second, count, low, high, mean_of_first, mean_of_second)
    real(dp), intent(in), contiguous :: first(:, :), second(:, :)        ! (COLUMNS, points)
    integer, intent(in) :: count
    real(dp), intent(out), dimension(COLUMNS) :: low, high, mean_of_first, mean_of_second
    integer :: q

    low = first(:, 1)
    high = low
    mean_of_first = 0
    mean_of_second = 0
    do q = 1, count                                  ! all columns: whole vectors
      low = min(low, first(:, q), second(:, q))
      high = max(high, first(:, q), second(:, q))
      mean_of_first = mean_of_first + first(:, q)
      mean_of_second = mean_of_second + second(:, q)
    end do
    mean_of_first = mean_of_first / count
    mean_of_second = mean_of_second / count
  end subroutine bounds_of

  !> Bounds a scalar that one cell gives another through a face: it may exceed the interval of the points of both so far only that
  !! the mean of the cell that receives it is sure to stay within.
  pure elemental function confined(trace, low, high, mean)
    real(dp), intent(in) :: trace, low, high
    real(dp), intent(in) :: mean                     ! of the cell that receives
    real(dp) :: confined
    confined = max(low - ALLOWANCE * (mean - low), min(trace, high + ALLOWANCE * (high - mean)))
  end function confined

  !> Scales the fabric that one cell gives another to the largest of both, or the limit if that is more.
  pure subroutine confine_fabric(first, second, count, fabric_limit, trace)
    real(dp), intent(in), contiguous :: first(:, :), second(:, :)        ! (COLUMNS, points)
    integer, intent(in) :: count
    real(dp), intent(in) :: fabric_limit
    real(dp), intent(inout) :: trace(COLUMNS)
    real(dp) :: largest, found
    integer :: q

    found = fabric_square(trace)
    if (found <= fabric_limit) return
    largest = fabric_limit
    do q = 1, count
      largest = max(largest, fabric_square(first(:, q)), fabric_square(second(:, q)))
    end do
    if (found > largest) trace(FABRIC:FABRIC + 5) = sqrt(largest / found) * trace(FABRIC:FABRIC + 5)
  end subroutine confine_fabric

  !> A : A.
  pure function fabric_square(values)
    real(dp), intent(in) :: values(COLUMNS)
    real(dp) :: fabric_square
    fabric_square = contraction(values(FABRIC:FABRIC + 5), values(FABRIC:FABRIC + 5))
  end function fabric_square

  !> A column on a face, from that of the two points on its normal.
  pure elemental function extrapolated(near, far) result(trace)
    real(dp), intent(in) :: near, far
    real(dp) :: trace
    trace = near + BEYOND * (near - far)
  end function extrapolated

  !> What a volume carries: phi psi, phi itself in its own place.
  pure function carried(values) result(amount)
    real(dp), intent(in) :: values(COLUMNS)
    real(dp) :: amount(COLUMNS)
    amount = values(PHI) * values
    amount(PHI) = values(PHI)
  end function carried

  !> T : T of the tensors.
  pure function squares(values)
    real(dp), intent(in) :: values(COLUMNS)
    real(dp) :: squares(TENSORS)
    integer :: t
    do t = 1, TENSORS
      squares(t) = contraction(values(6 * t - 5:6 * t), values(6 * t - 5:6 * t))
    end do
  end function squares

  !> X : Y of symmetric tensors.
  pure function contraction(X, Y) result(product)
    real(dp), intent(in), dimension(6) :: X, Y
    real(dp) :: product
    product = X(1) * Y(1) + X(2) * Y(2) + X(3) * Y(3) + 2 * (X(4) * Y(4) + X(5) * Y(5) + X(6) * Y(6))
  end function contraction

  !> The point on the other side of a cell's middle along reference coordinate k.
  pure integer function across(q, k)
    integer, intent(in) :: q, k
    across = ieor(q - 1, 2**(k - 1)) + 1
  end function across

  pure function reference_of(d) result(reference)
    integer, intent(in) :: d
    type(reference_cell) :: reference
    real(dp) :: xi(3)
    integer :: a, q, k, across_k

    reference%d = d
    reference%shape_functions = 0
    reference%slopes = 0
    do across_k = 0, d
      do q = 1, 2**d
        xi = GAUSS(ibits(q - 1, [0, 1, 2], 1))
        xi = merge(real(ibits(q - 1, [0, 1, 2], 1), dp), xi, [1, 2, 3] == across_k)
        do a = 1, 2**d
          reference%shape_functions(q, a, across_k) = shape_function(a, xi, 0, d)
          do k = 1, d
            reference%slopes(q, a, k, across_k) = shape_function(a, xi, k, d)
          end do
        end do
      end do
    end do
  end function reference_of

  !> Derivatives (point, i, k) of a cell's positions by reference coordinates; in the plane the third axis is as it is.
  pure function jacobians(reference, across_k, x) result(J)
    type(reference_cell), intent(in) :: reference
    integer, intent(in) :: across_k
    real(dp), intent(in) :: x(3, POINTS)
    real(dp) :: J(POINTS, 3, 3)
    integer :: a, i, k
    J = 0
    if (reference%d == 2) J(:, 3, 3) = 1
    do k = 1, reference%d
      do a = 1, 2**reference%d
        do i = 1, reference%d
          J(:, i, k) = J(:, i, k) + reference%slopes(:, a, k, across_k) * x(i, a)
        end do
      end do
    end do
  end function jacobians

  !> How far points of a cell move (point, i).
  pure function displacements(reference, across_k, x, x_new) result(w)
    type(reference_cell), intent(in) :: reference
    integer, intent(in) :: across_k
    real(dp), intent(in), dimension(3, POINTS) :: x, x_new
    real(dp) :: w(POINTS, 3)
    integer :: a, i
    w = 0
    do a = 1, 2**reference%d
      do i = 1, reference%d
        w(:, i) = w(:, i) + reference%shape_functions(:, a, across_k) * (x_new(i, a) - x(i, a))
      end do
    end do
  end function displacements

  !> det J of points.
  pure function volumes(J) result(volume)
    real(dp), intent(in) :: J(POINTS, 3, 3)
    real(dp) :: volume(POINTS), c(POINTS, 3)
    c = cross(J(:, :, 2), J(:, :, 3))
    volume = J(:, 1, 1) * c(:, 1) + J(:, 2, 1) * c(:, 2) + J(:, 3, 1) * c(:, 3)
  end function volumes

  !> a x b of points.
  pure function cross(a, b) result(c)
    real(dp), intent(in), dimension(POINTS, 3) :: a, b
    real(dp) :: c(POINTS, 3)
    c(:, 1) = a(:, 2) * b(:, 3) - a(:, 3) * b(:, 2)
    c(:, 2) = a(:, 3) * b(:, 1) - a(:, 1) * b(:, 3)
    c(:, 3) = a(:, 1) * b(:, 2) - a(:, 2) * b(:, 1)
  end function cross

  !> The shape function of node a, or its derivative by reference coordinate k if that is not 0.
  pure real(dp) function shape_function(a, xi, k, d)
    integer, intent(in) :: a, k, d
    real(dp), intent(in) :: xi(3)
    integer :: i, at_end
    shape_function = 1
    do i = 1, d
      at_end = ibits(a - 1, i - 1, 1)
      if (i == k) then
        shape_function = shape_function * (2 * at_end - 1)
      else
        shape_function = shape_function * merge(xi(i), 1 - xi(i), at_end == 1)
      end if
    end do
  end function shape_function

end module granumat_convection
