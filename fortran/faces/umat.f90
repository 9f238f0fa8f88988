!> The model as finite-element codes call it at a material point: UMAT in the convention of Abaqus, and SDVINI.
!!
!! What hosts hand over differs, so little of it is trusted: NDI, NSHR, CMNAME, the energies, STRAN, TIME and TEMP are never
!! read, DROT and DFGRD only if PROPS asks for them, STRESS only where a state starts. The stress of the last increment is
!! kept in STATEV, where no host rotates anything, so it does not matter whether the STRESS that is handed in has been rotated.
module granumat_umat
  use, intrinsic :: iso_fortran_env, only: output_unit
  use granumat_kinds, only: dp, LANES
  use granumat_status, only: OK, NOT_FINITE, BAD_PARAMETERS, BAD_LAYOUT, BAD_SENTINEL, BAD_INITIAL_STATE, BAD_DEFORMATION, &
    PLANE_STRESS, STRAIN_TOO_LARGE, status_message
  use granumat_law, only: excess_target
  use granumat_matrices, only: gradient_logarithm, polar_rotation, rotation_logarithm
  use granumat_parameters, only: material_parameters, parameters_from_friction, are_valid, friction_turns, FIGURE_16, HERTZIAN, &
    MOBILISED, MOBILISED_PRESSURE
  use granumat_state, only: lane_state, material_state, gather, scatter
  use granumat_starts, only: excess_under, isotropic_state
  use granumat_tangent, only: N_COLUMNS, N_ADJOINTS_3D, N_ADJOINTS_PLANE
  use granumat_tensors, only: product_symmetric, rotate
  use granumat_update, only: update
  implicit none (type, external)
  private
  public :: advance, speak, P_ORDER, ORDER_KRATOS

  ! What each number of PROPS and STATEV is. docs/umat.md and the decks repeat this table, a test compares them.
  integer, parameter :: P_MU = 1                !! interparticle friction coefficient, 0 to 1
  integer, parameter :: P_STIFFNESS = 2         !! stress unit: k/d (Hookean), k_Hz (Hertzian)
  integer, parameter :: P_CLOSURE = 3           !! 0 critical, 1 basic, 2 n2, 3 full, 4 kinematic, 5 mobilised, 6 mobilised-pressure
  integer, parameter :: P_CONTACT = 4           !! 0 Hookean, 1 Hertzian
  integer, parameter :: P_ELASTIC_STRAIN = 5    !! e_r, strain over which the stress, in closures 5, 6 friction, adapts; 0: paper
  integer, parameter :: P_PHI = 6               !! initial volume fraction
  integer, parameter :: P_PRESSURE = 7          !! initial mean pressure; 0: from STRESS where it is not 0, else from phi
  integer, parameter :: P_SPIN = 8              !! 0 none, 1 DROT, 2 DFGRD; 3 as 2, STRESS unrotated; 4 as 3, DDSDDE for CalculiX
  integer, parameter :: P_CALIBRATION = 9       !! source of a4: 0 table 1, 1 text, 2 figure 16
  integer, parameter :: P_ORDER = 10            !! of the last two shears: 0 Abaqus, 13 23; 1 Kratos, 23 13
  integer, parameter, public :: N_PROPS = 10
  integer, parameter :: N_PROPS_NEEDED = 6      ! those left out at the end are 0

  integer, parameter :: SPIN_NONE = 0, SPIN_DROT = 1, SPIN_DFGRD = 2, SPIN_UNROTATED = 3, SPIN_CALCULIX = 4
  integer, parameter :: ORDER_KRATOS = 1

  !> What PROPS may be.
  type, public :: property
    character(len=14) :: name
    real(dp) :: least, most
    logical :: whole
    character(len=32) :: allowed                !! in words
    character(len=6) :: unit                    !! as hosts of user-defined soil models write it
  end type property

  type(property), parameter, public :: PROPERTIES(N_PROPS) = [ &
    property("mu",             0.0_dp,       1.0_dp,                      .false., "0 to 1",                "-"), &
    property("stiffness",      tiny(1.0_dp), huge(1.0_dp),                .false., "above 0",               "F/L^2#"), &
    property("closure",        0.0_dp,       real(MOBILISED_PRESSURE, dp), .true., "0, 1, 2, 3, 4, 5 or 6", "-"), &
    property("contact",        0.0_dp,       real(HERTZIAN, dp),          .true.,  "0 or 1",                "-"), &
    property("elastic_strain", 0.0_dp,       huge(1.0_dp),                .false., "at least 0, in 5, 6 above 0", "-"), &
    property("phi",            tiny(1.0_dp), 1 - epsilon(1.0_dp),         .false., "between 0 and 1",       "-"), &
    property("pressure",       0.0_dp,       huge(1.0_dp),                .false., "at least 0",            "F/L^2#"), &
    property("spin",           0.0_dp,       real(SPIN_CALCULIX, dp),     .true.,  "0, 1, 2, 3 or 4",       "-"), &
    property("calibration",    0.0_dp,       real(FIGURE_16, dp),         .true.,  "0, 1 or 2",             "-"), &
    property("order",          0.0_dp,       real(ORDER_KRATOS, dp),      .true.,  "0 or 1",                "-")]

  integer, parameter :: S_SENTINEL = 1          !! 0: the state starts from PROPS; 1: it has
  integer, parameter :: S_FABRIC = 2            !! A 11 22 33 12 13 23
  integer, parameter :: S_COORDINATION = 8      !! Z2
  integer, parameter :: S_PHI = 9               !! volume fraction
  integer, parameter :: S_DIRECTION = 10        !! D/abs(D) of the last strain, in closure 5 followed over e_r, 11 22 33 12 13 23
  integer, parameter :: S_STRESS = 16           !! stress over the stress unit, 11 22 33 12 13 23
  integer, parameter :: S_WORK = 22             !! integral of stress : strain, in the unit of stress (trapezoidal rule)
  integer, parameter :: S_STATUS = 23           !! 0 done, else why the last call failed
  integer, parameter, public :: N_STATEV = 23

  real(dp), parameter, public :: CUTBACK = 0.25_dp         ! PNEWDT of a failed call
  real(dp), parameter :: NO_STRAIN = 1.0e-13_dp            ! below it a strain has no direction, only the host's round-off
  real(dp), parameter :: LARGEST_ANGLE = 3.0_dp            ! below pi, where the logarithm of a rotation is not unique
  real(dp), parameter :: LARGEST_STRAIN = 1.0_dp           ! abs(D) of one call: more is a host's bad guess, and takes milliseconds

  ! What a host cannot mend by a smaller increment.
  integer, parameter, public :: SET_UP(6) = [BAD_PARAMETERS, BAD_LAYOUT, BAD_SENTINEL, BAD_INITIAL_STATE, BAD_DEFORMATION, &
    PLANE_STRESS]

contains

  !> One call: stress, state and consistent tangent after the increment. Where the status is not OK, stress and state are left
  !! as they are, but for the status among them, and the tangent is the stress unit's identity.
  subroutine advance(props, dstran, drot, dfgrd0, dfgrd1, stress, statev, ddsdde, status)
    real(dp), intent(in) :: props(:)                     ! P_ above
    real(dp), intent(in) :: dstran(:)                    ! (4) 11 22 33 12 or (6), as PROPS order them; engineering shears
    real(dp), intent(in), optional :: drot(3, 3)         ! rotation of the increment
    real(dp), intent(in), optional :: dfgrd0(3, 3), dfgrd1(3, 3)   ! deformation gradients at its start and end
    real(dp), intent(inout) :: stress(:)                 ! as dstran; tension positive
    real(dp), intent(inout) :: statev(:)                 ! S_ above
    real(dp), intent(out) :: ddsdde(:, :)                ! d stress_i / d strain_j
    integer, intent(out) :: status
    type(material_parameters) :: par
    type(material_state) :: old, new(1)
    type(lane_state) :: x, x_new
    real(dp) :: given(N_PROPS), strain(6), spin(3), tangent(LANES, 6, N_COLUMNS), slope(6, 6), basis(6)
    real(dp) :: lanes_R(LANES, 3, 3), R(3, 3), R_T(3, 3)
    real(dp) :: handed_strain(6), handed_stress(6)
    integer :: lane_status(LANES), place(6), n, i, j
    logical :: unloads

    n = size(stress)
    place = [1, 2, 3, 4, 5, 6]
    call read_properties(props, given, par, status)
    if (status == OK) status = layout_status(n, size(statev))
    if (status == OK) then
      if (n == 6 .and. nint(given(P_ORDER)) == ORDER_KRATOS) place(5:) = [6, 5]
      do i = 1, n
        handed_strain(i) = dstran(place(i))
        handed_stress(i) = stress(place(i))
      end do
      call read_increment(nint(given(P_SPIN)), handed_strain(:n), drot, dfgrd0, dfgrd1, strain, spin, status)
    end if
    if (status == OK) call read_state(par, given, handed_stress(:n), statev, old, status)
    if (status == OK) then
      unloads = par%elastic_strain > 0 .and. all(abs(strain) <= 0)
      call gather([old], x)
      call update(par, x, spread(strain, 1, LANES), spread(spin, 1, LANES), x_new, lane_status, &
        merge(N_ADJOINTS_PLANE, N_ADJOINTS_3D, n == 4), tangent, unloads)
      slope = tangent(1, :, :6)
      status = lane_status(1)
    end if
    if (status == OK) then
      call scatter(x_new, new)
      if (.not. statev(S_SENTINEL) > 0) statev(S_WORK) = 0
      statev(S_WORK) = statev(S_WORK) + given(P_STIFFNESS) * dot_product(old%stress + new(1)%stress, strain) / 2
      call write_state(new(1), statev)
      if (nint(given(P_SPIN)) >= SPIN_UNROTATED) then
        lanes_R = polar_rotation(spread(dfgrd1, 1, LANES))
        R = lanes_R(1, :, :)
        R_T = transpose(R)
        new(1)%stress = rotated(R_T, new(1)%stress)
        do j = 1, n
          basis = 0
          basis(j) = 1
          slope(:, j) = rotated(R_T, matmul(tangent(1, :, :6), rotated_strain(R, basis)))
        end do
        if (nint(given(P_SPIN)) == SPIN_CALCULIX) call take_to_reference(dfgrd1, new(1)%stress, slope(:, :n))
      end if
      do j = 1, n
        stress(place(j)) = given(P_STIFFNESS) * new(1)%stress(j)
        do i = 1, n
          ddsdde(place(i), place(j)) = given(P_STIFFNESS) * slope(i, j)
        end do
      end do
    else
      call stiffness_of_failure(props, ddsdde)
    end if
    if (size(statev) > 0) statev(min(S_STATUS, size(statev))) = status
  end subroutine advance

  !> The tangent of a failed call: the stress unit times the strain.
  pure subroutine stiffness_of_failure(props, ddsdde)
    real(dp), intent(in) :: props(:)
    real(dp), intent(out) :: ddsdde(:, :)
    real(dp) :: unit
    integer :: j

    unit = 1
    if (size(props) >= P_STIFFNESS) then
      if (props(P_STIFFNESS) > 0 .and. props(P_STIFFNESS) <= huge(unit)) unit = props(P_STIFFNESS)
    end if
    ddsdde = 0
    do j = 1, size(ddsdde, 1)
      ddsdde(j, j) = merge(unit, unit / 2, j <= 3)
    end do
  end subroutine stiffness_of_failure

  !> What PROPS say, 0 for those left out, and the material they make.
  pure subroutine read_properties(props, given, par, status)
    real(dp), intent(in) :: props(:)
    real(dp), intent(out) :: given(N_PROPS)
    type(material_parameters), intent(out) :: par
    integer, intent(out) :: status

    given = 0
    status = BAD_LAYOUT
    if (size(props) < N_PROPS_NEEDED .or. size(props) > N_PROPS) return
    given(:size(props)) = props
    status = BAD_PARAMETERS
    if (any(at_fault(given))) return
    par = parameters_from_friction(given(P_MU), nint(given(P_CLOSURE)), nint(given(P_CONTACT)), nint(given(P_CALIBRATION)))
    par%elastic_strain = given(P_ELASTIC_STRAIN)
    if (are_valid(par)) status = OK
  end subroutine read_properties

  !> Which of PROPS are not finite, out of their range or not whole where they have to be.
  pure function at_fault(given) result(faulty)
    real(dp), intent(in) :: given(:)
    logical :: faulty(size(given))
    integer :: i
    do i = 1, size(given)
      faulty(i) = .not. (given(i) >= PROPERTIES(i)%least .and. given(i) <= PROPERTIES(i)%most)
      if (.not. faulty(i)) faulty(i) = PROPERTIES(i)%whole .and. abs(given(i) - anint(given(i))) > 0
    end do
    if (given(P_CLOSURE) >= MOBILISED .and. .not. given(P_ELASTIC_STRAIN) > 0) faulty(P_ELASTIC_STRAIN) = .true.
  end function at_fault

  pure function layout_status(ntens, nstatv) result(status)
    integer, intent(in) :: ntens, nstatv
    integer :: status
    status = OK
    if (nstatv < N_STATEV .or. .not. any(ntens == [3, 4, 6])) status = BAD_LAYOUT
    if (ntens == 3) status = PLANE_STRESS
  end function layout_status

  !> Strain and spin of the increment: both are those of a velocity gradient that is constant over it.
  pure subroutine read_increment(spin_from, dstran, drot, dfgrd0, dfgrd1, strain, spin, status)
    integer, intent(in) :: spin_from
    real(dp), intent(in) :: dstran(:)
    real(dp), intent(in), optional :: drot(3, 3), dfgrd0(3, 3), dfgrd1(3, 3)
    real(dp), intent(out) :: strain(6), spin(3)
    integer, intent(inout) :: status
    real(dp) :: lanes_L(LANES, 3, 3), L(3, 3)
    logical :: found(LANES)

    strain = 0
    strain(:size(dstran)) = dstran
    lanes_L = 0
    found = spin_from == SPIN_NONE
    if (spin_from == SPIN_DROT .and. present(drot)) call rotation_logarithm(spread(drot, 1, LANES), lanes_L, found)
    if (spin_from >= SPIN_DFGRD .and. present(dfgrd0) .and. present(dfgrd1)) then
      call gradient_logarithm(spread(dfgrd0, 1, LANES), spread(dfgrd1, 1, LANES), lanes_L, found)
    end if
    L = lanes_L(1, :, :)
    if (spin_from >= SPIN_DFGRD) then
      strain = [L(1, 1), L(2, 2), L(3, 3), L(1, 2) + L(2, 1), L(1, 3) + L(3, 1), L(2, 3) + L(3, 2)]
    end if
    if (all(abs(strain) < NO_STRAIN)) strain = 0
    spin = [L(1, 2) - L(2, 1), L(1, 3) - L(3, 1), L(2, 3) - L(3, 2)] / 2
    if (norm2([strain(:3) / sqrt(2.0_dp), strain(4:) / 2]) > LARGEST_STRAIN) status = STRAIN_TOO_LARGE
    if (.not. (found(1) .and. norm2(spin) < LARGEST_ANGLE)) status = BAD_DEFORMATION
  end subroutine read_increment

  !> Takes the derivative of the unrotated stress to U (dT/dE) U U, from which CalculiX makes the derivative dT/dE of its second
  !! Piola-Kirchhoff stress T = J U^-1 stress U^-1 by Lagrange's strain E, with U^-1 on all four indices. Its column for the unit
  !! strain D is J (tangent + stress tr D - stress D - D stress); what is left out is of the order of the increment
  !! (docs/theory.md, section 10.3).
  pure subroutine take_to_reference(F, stress, tangent)
    real(dp), intent(in) :: F(3, 3), stress(6)
    real(dp), intent(inout) :: tangent(:, :)
    real(dp) :: D(6), products(LANES, 6), cofactor(3)
    integer :: j

    cofactor = [F(2, 2) * F(3, 3) - F(3, 2) * F(2, 3), F(3, 2) * F(1, 3) - F(1, 2) * F(3, 3), F(1, 2) * F(2, 3) - F(2, 2) * F(1, 3)]
    do j = 1, size(tangent, 2)
      D = 0
      D(j) = merge(1.0_dp, 0.5_dp, j <= 3)
      products = product_symmetric(spread(stress, 1, LANES), spread(D, 1, LANES))
      tangent(:, j) = dot_product(F(:, 1), cofactor) * (tangent(:, j) + stress * sum(D(:3)) - products(1, :))
    end do
  end subroutine take_to_reference

  !> R T R^T of one tensor.
  pure function rotated(R, T) result(new)
    real(dp), intent(in) :: R(3, 3), T(6)
    real(dp) :: new(6), lanes_new(LANES, 6)
    lanes_new = rotate(spread(R, 1, LANES), spread(T, 1, LANES))
    new = lanes_new(1, :)
  end function rotated

  !> R E R^T of strains with engineering shears.
  pure function rotated_strain(R, strain) result(new)
    real(dp), intent(in) :: R(3, 3), strain(6)
    real(dp) :: new(6)
    new = rotated(R, [strain(:3), strain(4:) / 2])
    new(4:) = 2 * new(4:)
  end function rotated_strain

  !> The state in STATEV; where its sentinel is 0, the initial one.
  pure subroutine read_state(par, given, stress, statev, x, status)
    type(material_parameters), intent(in) :: par
    real(dp), intent(in) :: given(N_PROPS), stress(:), statev(:)
    type(material_state), intent(out) :: x
    integer, intent(inout) :: status

    if (abs(statev(S_SENTINEL)) <= 0) then
      call start(par, given, stress, x, status)
    else if (abs(statev(S_SENTINEL) - 1) <= 0) then
      x%stress = statev(S_STRESS:S_STRESS + 5)
      x%fabric = statev(S_FABRIC:S_FABRIC + 5)
      x%direction = statev(S_DIRECTION:S_DIRECTION + 5)
      x%coordination_number = statev(S_COORDINATION)
      x%volume_fraction = statev(S_PHI)
    else
      status = BAD_SENTINEL
    end if
  end subroutine read_state

  pure subroutine write_state(x, statev)
    type(material_state), intent(in) :: x
    real(dp), intent(inout) :: statev(:)

    statev(S_SENTINEL) = 1
    statev(S_STRESS:S_STRESS + 5) = x%stress
    statev(S_FABRIC:S_FABRIC + 5) = x%fabric
    statev(S_DIRECTION:S_DIRECTION + 5) = x%direction
    statev(S_COORDINATION) = x%coordination_number
    statev(S_PHI) = x%volume_fraction
  end subroutine write_state

  !> An isotropic packing: Z2 from the pressure (4.2), (4.4), or f(phi) (4.9); the deviator of the STRESS handed in is kept. In the
  !! closure in which it is a function of the state, friction is mobilised so far as it needs and is at hand.
  pure subroutine start(par, given, stress, x, status)
    type(material_parameters), intent(in) :: par
    real(dp), intent(in) :: given(N_PROPS), stress(:)
    type(material_state), intent(out) :: x
    integer, intent(out) :: status
    real(dp) :: p, handed(6), f(LANES)

    handed = 0
    handed(:size(stress)) = stress / given(P_STIFFNESS)
    p = given(P_PRESSURE) / given(P_STIFFNESS)
    if (.not. abs(p) > 0) p = -sum(handed(:3)) / 3
    f = excess_target(par, spread(given(P_PHI) - par%phic, 1, LANES))
    if (p > 0) f = excess_under(par, p)
    call isotropic_state(par, given(P_PHI), f(1), x, status)
    if (p < 0) status = BAD_INITIAL_STATE
    if (.not. all(abs(handed) <= huge(handed))) status = NOT_FINITE
    x%stress = x%stress + handed
    x%stress(:3) = x%stress(:3) - sum(handed(:3)) / 3
    if (friction_turns(par)) call mobilise(par, x)
  end subroutine start

  !> Gives an isotropic packing the direction of friction which its deviatoric stress asks for, of magnitude 1 at most.
  pure subroutine mobilise(par, x)
    type(material_parameters), intent(in) :: par
    type(material_state), intent(inout) :: x
    real(dp) :: p, dev(6), largest

    p = -sum(x%stress(:3)) / 3
    dev = x%stress
    dev(:3) = dev(:3) + p
    largest = max(p * par%b1, norm2([dev(:3) / sqrt(2.0_dp), dev(4:)]))
    if (largest > 0) x%direction = dev / largest
    x%stress = p * par%b1 * x%direction
    x%stress(:3) = x%stress(:3) - p
  end subroutine mobilise

  !> Says on unit 6 why a call failed, each reason once. Threads that fail at the same time may both say it.
  subroutine speak(face, status, props, ntens, nstatv)
    character(len=*), intent(in) :: face              ! who speaks
    integer, intent(in) :: status, ntens, nstatv
    real(dp), intent(in) :: props(:)
    logical, save :: said(STRAIN_TOO_LARGE) = .false.       ! by status, of which this is the last
    logical :: faulty(size(props))
    integer :: i

    if (said(status)) return
    said(status) = .true.
    write (output_unit, "(3a, i0, 2a)") "granumat: ", face, " refuses this call, status ", status, ": ", &
      trim(status_message(status))
    select case (status)
    case (BAD_LAYOUT)
      write (output_unit, "(3(a, i0))") "granumat: NTENS ", ntens, ", NSTATV ", nstatv, ", NPROPS ", size(props)
    case (BAD_PARAMETERS)
      faulty = at_fault(props)
      do i = 1, size(props)
        if (faulty(i)) write (output_unit, "(a, i0, 3a, es11.4, 2a)") "granumat: PROPS(", i, ") ", trim(PROPERTIES(i)%name), " =", &
          props(i), ", allowed: ", trim(PROPERTIES(i)%allowed)
      end do
    case (BAD_INITIAL_STATE)
      write (output_unit, "(2(a, es11.4))") "granumat: PROPS(2) stiffness =", props(P_STIFFNESS), &
        "; the pressure, in the same unit, is that of PROPS(7) or of STRESS; phi =", props(P_PHI)
    case default             ! the message says it all
    end select
  end subroutine speak

end module granumat_umat

!> UMAT. An argument that some hosts pass as a null pointer is declared optional: it arrives as an absent one.
subroutine umat(stress, statev, ddsdde, sse, spd, scd, rpl, ddsddt, drplde, drpldt, stran, dstran, time, dtime, temp, dtemp, &
    predef, dpred, cmname, ndi, nshr, ntens, nstatv, props, nprops, coords, drot, pnewdt, celent, dfgrd0, dfgrd1, noel, npt, &
    layer, kspt, kstep, kinc)
  use granumat_kinds, only: dp
  use granumat_status, only: OK
  use granumat_umat, only: advance, speak, CUTBACK, SET_UP
  implicit none (type, external)
  integer, intent(in) :: ndi, nshr, ntens, nstatv, nprops, noel, npt, layer, kspt, kstep, kinc
  real(dp), intent(inout) :: stress(ntens), statev(nstatv), ddsdde(ntens, ntens)
  real(dp), intent(inout) :: sse, spd, scd, rpl, ddsddt(*), drplde(*), drpldt
  real(dp), intent(in) :: stran(*), dstran(ntens), time(*), dtime, temp, dtemp, predef(*), dpred(*), props(nprops), coords(*)
  character(len=*), intent(in) :: cmname
  real(dp), intent(in), optional :: drot(3, 3), dfgrd0(3, 3), dfgrd1(3, 3)
  real(dp), intent(inout), optional :: pnewdt
  real(dp), intent(in) :: celent
  integer :: status

  call advance(props, dstran, drot, dfgrd0, dfgrd1, stress, statev, ddsdde, status)
  if (status == OK) return
  if (any(status == SET_UP)) call speak("UMAT", status, props, ntens, nstatv)    ! many hosts do not look at PNEWDT
  if (present(pnewdt)) pnewdt = CUTBACK
end subroutine umat

!> SDVINI: every state is to start itself.
subroutine sdvini(statev, coords, nstatv, ncrds, noel, npt, layer, kspt)
  use granumat_kinds, only: dp
  implicit none (type, external)
  integer, intent(in) :: nstatv, ncrds, noel, npt, layer, kspt
  real(dp), intent(out) :: statev(nstatv)
  real(dp), intent(in) :: coords(*)

  statev = 0
end subroutine sdvini
