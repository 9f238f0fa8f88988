!> The material constants: as functions of the interparticle friction coefficient, and what is allowed for each.
!!
!! Source of every number: J. Sun and S. Sundaresan, J. Fluid Mech. 682 (2011) 590-616, tables 1 and 2,
!! doi:10.1017/jfm.2011.251. Departs from the paper: a2 = +0.1 mu (table 1 prints -0.1; its text says that shear raises p).
module granumat_parameters
  use, intrinsic :: iso_c_binding, only: c_double, c_int
  use granumat_kinds, only: dp
  implicit none (type, external)
  private
  public :: parameters_from_friction, derive_constants, faulty_constants, are_valid, deviator_relaxes, friction_turns, &
    pressure_evolves

  !> The numbers of a material; the first N_CONSTANTS are the user's to override, the rest follows from them.
  type, public, bind(c) :: material_parameters
    real(c_double) :: mu              !! interparticle friction coefficient
    real(c_double) :: a1, a2          !! pressure (4.2)
    real(c_double) :: a3, a4          !! normal stress differences (A 1), (A 4)
    real(c_double) :: b1, b2, b3      !! friction (4.5), (4.6)
    real(c_double) :: Zc              !! critical coordination number
    real(c_double) :: phic            !! critical volume fraction
    real(c_double) :: c1, c2, c3      !! fabric (4.7)
    real(c_double) :: d1, d2, d3      !! coordination number (4.8)
    real(c_double) :: beta1, beta2    !! f(phi) (4.9)
    real(c_double) :: g               !! isotropic compression (B 1); the paper prints no value
    real(c_double) :: elastic_strain  !! e_r, strain over which the deviatoric stress relaxes, or friction turns; 0: the paper
    real(c_double) :: chi, kappa, lambda   !! steady values (A 7)-(A 9)
    real(c_double) :: fabric_limit    !! |A| below it decays in every flow; above it some flows blow it up
    integer(c_int) :: closure, contact
  end type material_parameters

  integer, parameter, public :: CRITICAL = 0, BASIC = 1, N2 = 2, FULL = 3, KINEMATIC = 4, MOBILISED = 5, &
    MOBILISED_PRESSURE = 6                                                                    ! closures
  integer, parameter, public :: HOOKEAN = 0, HERTZIAN = 1                                     ! contacts
  integer, parameter, public :: TABLE_1 = 0, TEXT = 1, FIGURE_16 = 2                          ! calibrations

  integer, parameter, public :: N_CONSTANTS = 20, NAME_LENGTH = 16

  !> The allowed values of a constant: those between the bounds, and the bounds themselves where the range is closed.
  type, public :: constant_range
    character(len=NAME_LENGTH) :: name
    real(dp) :: lower, upper
    logical :: closed
  end type constant_range

  real(dp), parameter :: UNBOUNDED = huge(1.0_dp)
  !> c3 = 0 is taken as this one, whose term in (4.7) is below round-off: the solution divides by c3.
  real(dp), parameter :: LEAST_C3 = 1.0e-30_dp
  type(constant_range), parameter, public :: RANGES(N_CONSTANTS) = [ &
    constant_range("mu",             0.0_dp,     1.0_dp,     .true.), &
    constant_range("a1",             0.0_dp,     UNBOUNDED,  .false.), &
    constant_range("a2",             -UNBOUNDED, UNBOUNDED,  .false.), &
    constant_range("a3",             -UNBOUNDED, UNBOUNDED,  .false.), &
    constant_range("a4",             -UNBOUNDED, UNBOUNDED,  .false.), &
    constant_range("b1",             -UNBOUNDED, UNBOUNDED,  .false.), &
    constant_range("b2",             -UNBOUNDED, UNBOUNDED,  .false.), &
    constant_range("b3",             -UNBOUNDED, UNBOUNDED,  .false.), &
    constant_range("Zc",             0.0_dp,     UNBOUNDED,  .false.), &
    constant_range("phic",           0.0_dp,     1.0_dp,     .false.), &
    constant_range("c1",             -UNBOUNDED, 0.0_dp,     .false.), &
    constant_range("c2",             -UNBOUNDED, 0.0_dp,     .true.), &
    constant_range("c3",             0.0_dp,     UNBOUNDED,  .true.), &
    constant_range("d1",             -UNBOUNDED, UNBOUNDED,  .false.), &
    constant_range("d2",             0.0_dp,     UNBOUNDED,  .true.), &
    constant_range("d3",             -UNBOUNDED, UNBOUNDED,  .false.), &
    constant_range("beta1",          0.0_dp,     UNBOUNDED,  .true.), &
    constant_range("beta2",          0.0_dp,     UNBOUNDED,  .false.), &
    constant_range("g",              -UNBOUNDED, UNBOUNDED,  .false.), &
    constant_range("elastic_strain", 0.0_dp,     UNBOUNDED,  .true.)]

contains

  !> The paper's constants for a friction coefficient; constants that the closure does not use are set to 0.
  pure function parameters_from_friction(mu, closure, contact, calibration) result(par)
    real(dp), intent(in) :: mu
    integer, intent(in) :: closure, contact, calibration
    type(material_parameters) :: par

    par%mu = mu
    par%a1 = 0.0073_dp
    par%a2 = 0.1_dp * mu
    par%a3 = fit(1.57_dp, -4.5_dp, -1.7_dp)
    par%b1 = fit(-0.16_dp, -6.0_dp, 0.16_dp)
    par%b2 = fit(1.6_dp, -6.0_dp, -2.9_dp)
    par%b3 = 0
    par%Zc = fit(1.85_dp, -5.0_dp, 4.15_dp)
    par%phic = fit(0.058_dp, -5.0_dp, 0.582_dp)
    par%c1 = -0.52_dp
    par%c2 = -2.8_dp
    par%c3 = 100
    par%d1 = -45
    par%d2 = 5.6_dp
    par%d3 = -40
    par%beta1 = 7.5_dp
    par%beta2 = 0.5_dp
    par%g = 0
    par%elastic_strain = 0
    par%closure = int(closure, c_int)
    par%contact = int(contact, c_int)

    select case (calibration)
    case (TEXT)                                 ! the sentence about figure 16
      par%a4 = fit(-6.5_dp, -2.0_dp, 6.5_dp)
    case (FIGURE_16)                            ! its caption
      par%a4 = fit(-3.7_dp, -1.2_dp, 4.0_dp)
    case default                                ! table 1
      par%a4 = fit(-6.0_dp, -2.0_dp, 6.0_dp)
    end select
    if (closure == BASIC) par%a3 = 0
    if (closure >= KINEMATIC) par%a4 = -2 * par%b2
    if (closure < FULL) par%a4 = 0
    call derive_constants(par)

  contains

    pure function fit(x1, x2, x3) result(constant)
      real(dp), intent(in) :: x1, x2, x3
      real(dp) :: constant
      constant = x1 * exp(x2 * mu) + x3
    end function fit

  end function parameters_from_friction

  !> Sets chi, kappa, lambda (A 7)-(A 9) and the fabric's limit from c1, c2, c3; (A 7) with its root in the denominator, since
  !! -(c2 + root)/(2 c3) cancels as c3 goes to 0, where chi = -2 c1/c2. Where the pressure evolves, also g and beta2, which have no
  !! role there.
  pure subroutine derive_constants(par)
    type(material_parameters), intent(inout) :: par
    real(dp) :: root

    par%c3 = max(par%c3, LEAST_C3)
    root = sqrt(par%c2**2 - 8 * par%c1 * par%c3)
    par%chi = 4 * par%c1 / (root - par%c2)
    par%kappa = sqrt(-par%c1 * par%chi / (2 * (par%c2 + par%c3 * par%chi)))
    par%lambda = -par%c1 / (par%c2 + par%c3 * par%chi)
    par%fabric_limit = (root - par%c2) / (4 * par%c3)
    if (pressure_evolves(par)) then
      par%g = 0
      par%beta2 = 0.5_dp
    end if
  end subroutine derive_constants

  !> Which constants are not finite or outside their range.
  pure function faulty_constants(par) result(faulty)
    type(material_parameters), intent(in) :: par
    logical :: faulty(N_CONSTANTS), inside(N_CONSTANTS)
    real(dp) :: constants(N_CONSTANTS)

    constants = [real(dp) :: par%mu, par%a1, par%a2, par%a3, par%a4, par%b1, par%b2, par%b3, par%Zc, par%phic, par%c1, par%c2, &
      par%c3, par%d1, par%d2, par%d3, par%beta1, par%beta2, par%g, par%elastic_strain]
    inside = abs(constants) <= huge(constants)
    where (inside) inside = (constants > RANGES%lower .and. constants < RANGES%upper) &
      .or. (RANGES%closed .and. constants >= RANGES%lower .and. constants <= RANGES%upper)
    faulty = .not. inside
  end function faulty_constants

  !> Whether the deviatoric stress is a state that relaxes to the model's; otherwise it is a function of the microstructure.
  pure function deviator_relaxes(par) result(relaxes)
    type(material_parameters), intent(in) :: par
    logical :: relaxes
    relaxes = par%elastic_strain > 0 .and. .not. friction_turns(par)
  end function deviator_relaxes

  !> Whether friction has a direction M of its own, which follows S^ over e_r.
  pure function friction_turns(par) result(turns)
    type(material_parameters), intent(in) :: par
    logical :: turns
    turns = par%closure >= MOBILISED
  end function friction_turns

  !> Whether (4.8) gives the rate of the pressure, and Z2 follows from it.
  pure function pressure_evolves(par) result(evolves)
    type(material_parameters), intent(in) :: par
    logical :: evolves
    evolves = par%closure == MOBILISED_PRESSURE
  end function pressure_evolves

  !> Whether all constants are in range, what follows from them is finite, kappa is positive, and so is e_r where friction turns.
  pure function are_valid(par) result(valid)
    type(material_parameters), intent(in) :: par
    logical :: valid
    valid = .not. any(faulty_constants(par)) .and. all(abs([par%chi, par%kappa, par%lambda, par%fabric_limit]) <= huge(1.0_dp))
    if (valid) valid = par%kappa > 0 .and. (.not. friction_turns(par) .or. par%elastic_strain > 0)
  end function are_valid

end module granumat_parameters
