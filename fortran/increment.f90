!> A strain increment and what evolves in it, LANES points side by side.
!!
!! Components of the types are a multiple of a vector's length, but for the last ones: so all lie where vectors load fast.
module granumat_increment
  use granumat_kinds, only: dp
  use granumat_coordination, only: N_NODES
  use granumat_fabric, only: fabric_solution
  use granumat_tensors, only: LANES, deviator, safe_modulus, trace
  implicit none (type, external)
  private
  public :: to_increment, add_step

  integer, parameter, public :: AT_END = N_NODES + 1       ! behind the nodes of an inner step

  !> A deformation with constant velocity gradient, and its invariants.
  type, public :: increment
    real(dp) :: direction(LANES, 6)    ! D^ = D/|D|
    real(dp) :: S_hat(LANES, 5)        ! S/|D|
    real(dp) :: tr_direction(LANES)    ! tr D/|D|
    real(dp) :: mod_D(LANES)           ! |D|
    real(dp) :: tr_D(LANES)
    real(dp) :: spin(LANES, 3)         ! W12 W13 W23
  end type increment

  !> What evolves inside an increment, and how far it has come.
  type, public :: internal
    real(dp) :: A(LANES, 5)            ! fabric
    real(dp) :: excess(LANES)          ! Z2 - Zc
    real(dp) :: phi(LANES)
    real(dp) :: e(LANES)               ! ln(phi/phic)
    real(dp) :: dev(LANES, 5)          ! deviatoric stress, tension positive
  end type internal

  !> An inner step, a share of the increment, 0 <= t <= 1: its fabric, and what is met at the nodes and (last) at the end;
  !! with e_r > 0 the model's pressure and deviator (at p = 1) there, the rotation from there to the end, what it turns the deviator
  !! into, and its weight. With 0: the rotation of all, what is left of the deviator before, and its weight.
  type, public :: inner_solution
    real(dp) :: share(LANES), mod_D(LANES), tr_D(LANES), phi_end(LANES), S(LANES, 5), w(LANES, 3)
    real(dp), dimension(LANES, N_NODES) :: t, dt, phi, y, A_S, growth, integrand
    real(dp) :: y_end(LANES)
    real(dp) :: A(LANES, 5, AT_END), excess(LANES, AT_END)              ! at the nodes only with e_r > 0
    real(dp), dimension(LANES, 5, 0:AT_END) :: turned
    real(dp) :: p(LANES, AT_END), unit(LANES, 5, AT_END), weights(LANES, 0:AT_END), R(LANES, 5, 5, 0:N_NODES)
    type(fabric_solution) :: fabric
  end type inner_solution

  !> An inner step before it is taken.
  type, public :: inner_start
    type(internal) :: x
    real(dp) :: share(LANES), e_end(LANES)           ! of the increment; ln(phi/phic) at the end
  end type inner_start

  !> The inner steps of an increment: the last one solved, and if they are wanted all.
  type, public :: trail
    type(inner_start) :: last
    type(inner_solution) :: solution
    type(inner_start), allocatable :: earlier(:)     ! has steps - 1, and room for more
    integer :: steps = 0
    logical :: whole                                 ! whether all are wanted
  end type trail

contains

  !> Adds an inner step.
  pure subroutine add_step(steps, start)
    type(trail), intent(inout) :: steps
    type(inner_start), intent(in) :: start
    type(inner_start), allocatable :: longer(:)
    integer :: n

    n = steps%steps
    if (n > 0) then
      if (.not. allocated(steps%earlier)) allocate (steps%earlier(4))
      if (n > size(steps%earlier)) then
        allocate (longer(2 * n))
        longer(:n - 1) = steps%earlier(:n - 1)
        call move_alloc(longer, steps%earlier)
      end if
      steps%earlier(n) = steps%last
    end if
    steps%last = start
    steps%steps = n + 1
  end subroutine add_step

  !> The increment of engineering strains and a spin; none in lanes that are not wanted.
  pure subroutine to_increment(strain, spin, wanted, inc)
    real(dp), intent(in) :: strain(LANES, 6), spin(LANES, 3)
    logical, intent(in) :: wanted(LANES)
    type(increment), intent(out) :: inc
    real(dp) :: D(LANES, 6), inverse(LANES)      ! D with tensor shear components
    integer :: i, k

    D(:, :3) = strain(:, :3)
    D(:, 4:) = strain(:, 4:) / 2
    inc%spin = spin
    do i = 1, LANES
      if (wanted(i)) cycle
      D(i, :) = 0
      inc%spin(i, :) = 0
    end do
    inc%mod_D = safe_modulus(D)
    inverse = 1 / max(inc%mod_D, tiny(1.0_dp))
    do k = 1, 6
      inc%direction(:, k) = inverse * D(:, k)
    end do
    inc%S_hat = deviator(inc%direction)
    inc%tr_D = trace(D)
    inc%tr_direction = trace(inc%direction)
  end subroutine to_increment

end module granumat_increment
