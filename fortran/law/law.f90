!> The evolution equations of the law as printed: Sun & Sundaresan (2011), (4.7)-(4.9) and (A 9), doi:10.1017/jfm.2011.251.
!!
!! Everything else integrates, linearises or compares what stands here; the stress (4.1)-(4.6) is in granumat_stress. Rates are per
!! unit of t, 0 <= t <= 1 over a strain increment, so S, |D|, W and tr D are those of the increment. All are linear in S, |S|, |D|,
!! W and tr D. With a length the nonlocal strain m takes the place of |D| here (docs/theory.md, section 12). Section 1 there has the
!! conventions and where this departs from the print.
module granumat_law
  use granumat_kinds, only: dp, LANES
  use granumat_parameters, only: material_parameters, pressure_evolves
  use granumat_tensors, only: contract, corotate, times
  implicit none (type, external)
  private
  public :: fabric_rate, linear_fabric_rate, coordination_rate, excess_target, excess_target_slope, &
    evolving_target, evolving_target_slope, volume_fraction_of, relaxation_rate, mobilised_share, critical_state

contains

  !> (4.7): dA/dt = W A - A W + c1 S + c2 |D| A + c3 (A : S) A.
  pure function fabric_rate(par, A, S, mod_D, w) result(dot_A)
    type(material_parameters), intent(in) :: par
    real(dp), intent(in) :: A(LANES, 5), S(LANES, 5), mod_D(LANES), w(LANES, 3)
    real(dp) :: dot_A(LANES, 5), one(LANES)
    one = 1
    dot_A = linear_fabric_rate(par, A, one, S, mod_D, w) + times(par%c3 * contract(A, S), A)
  end function fabric_rate

  !> (4.7) without its last term, linear in the pair (B, y): W B - B W + c1 y S + c2 |D| B.
  pure function linear_fabric_rate(par, B, y, S, mod_D, w) result(dot_B)
    type(material_parameters), intent(in) :: par
    real(dp), intent(in) :: B(LANES, 5), y(LANES), S(LANES, 5), mod_D(LANES), w(LANES, 3)
    real(dp) :: dot_B(LANES, 5)
    dot_B = corotate(w, B) + times(par%c1 * y, S) + times(par%c2 * mod_D, B)
  end function linear_fabric_rate

  !> (4.8): dZ2/dt = d1 (A : S - chi |S|) + d2 |D| (f - Z2) + d3 tr D, with f - Z2 as `missing`; share |S| for |S| where
  !! friction turns, and the same for what evolves in place of Z2 - Zc where that is the pressure.
  pure function coordination_rate(par, A_S, mod_S, mod_D, missing, tr_D) result(dot_Z2)
    type(material_parameters), intent(in) :: par
    real(dp), intent(in), dimension(LANES) :: A_S, mod_S, mod_D, missing, tr_D
    real(dp) :: dot_Z2(LANES)
    dot_Z2 = par%d1 * (A_S - par%chi * mod_S) + par%d2 * mod_D * missing + par%d3 * tr_D
  end function coordination_rate

  !> (4.9): f(phi) - Zc = beta1 (phi - phic)^beta2 above phic, 0 below; distance = phi - phic.
  pure function excess_target(par, distance) result(excess)
    type(material_parameters), intent(in) :: par
    real(dp), intent(in) :: distance(LANES)
    real(dp) :: excess(LANES)
    excess = sqrt(max(distance, 0.0_dp))
    if (abs(par%beta2 - 0.5_dp) > 0) excess = excess**(2 * par%beta2)
    excess = par%beta1 * excess
  end function excess_target

  !> df/dphi of (4.9).
  pure function excess_target_slope(par, distance) result(slope)
    type(material_parameters), intent(in) :: par
    real(dp), intent(in) :: distance(LANES)
    real(dp) :: slope(LANES)
    slope = merge(par%beta2 * excess_target(par, distance) / max(distance, tiny(1.0_dp)), 0.0_dp, distance > 0)
  end function excess_target_slope

  !> What Z2 - Zc in (4.8) decays to; where the pressure evolves, what it decays to, beta1^2 (phi - phic)/2 on both sides of phic.
  pure function evolving_target(par, distance) result(target)
    type(material_parameters), intent(in) :: par
    real(dp), intent(in) :: distance(LANES)
    real(dp) :: target(LANES)
    if (pressure_evolves(par)) then
      target = par%beta1 * (par%beta1 * (distance / 2))        ! vector instructions throughout
    else
      target = excess_target(par, distance)
    end if
  end function evolving_target

  !> Its derivative by phi.
  pure function evolving_target_slope(par, distance) result(slope)
    type(material_parameters), intent(in) :: par
    real(dp), intent(in) :: distance(LANES)
    real(dp) :: slope(LANES)
    if (pressure_evolves(par)) then
      slope = par%beta1**2 / 2
    else
      slope = excess_target_slope(par, distance)
    end if
  end function evolving_target_slope

  !> The volume fraction whose f(phi) - Zc is a given excess above 0: the inverse of (4.9).
  pure function volume_fraction_of(par, excess) result(phi)
    type(material_parameters), intent(in) :: par
    real(dp), intent(in) :: excess
    real(dp) :: phi
    phi = par%phic + (excess / par%beta1)**(1 / par%beta2)
  end function volume_fraction_of

  !> The elastic strain e_r > 0: d sigma'/dt = W sigma' - sigma' W + |D| (sigma'_model - sigma')/e_r. With e_r = 0, the paper,
  !! sigma' is sigma'_model. The mobilised direction M of friction follows S^, with a length S/m, in the same way.
  pure function relaxation_rate(par, dev, model, mod_D, w) result(dot_dev)
    type(material_parameters), intent(in) :: par
    real(dp), intent(in) :: dev(LANES, 5), model(LANES, 5), mod_D(LANES), w(LANES, 3)
    real(dp) :: dot_dev(LANES, 5)
    dot_dev = corotate(w, dev) + times(mod_D / par%elastic_strain, model - dev)
  end function relaxation_rate

  !> The mobilised share of friction, max(0, M : S^/2); with a length M + S^ - S/m stands for M.
  pure function mobilised_share(M_S) result(share)
    real(dp), intent(in) :: M_S(LANES)        ! M : S^
    real(dp) :: share(LANES)
    share = max(0.0_dp, M_S / 2)
  end function mobilised_share

  !> The critical-state closure's microstructure: A = lambda S^ (A 9), Z2 = f(phi).
  pure subroutine critical_state(par, S_hat, phi, A, excess)
    type(material_parameters), intent(in) :: par
    real(dp), intent(in) :: S_hat(LANES, 5), phi(LANES)
    real(dp), intent(inout) :: A(LANES, 5), excess(LANES)       ! excess = Z2 - Zc
    A = par%lambda * S_hat
    excess = excess_target(par, phi - par%phic)
  end subroutine critical_state

end module granumat_law
