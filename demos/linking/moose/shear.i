# One element in simple shear of 1 in x-z at constant volume, then reversed. Not run by this project.
[GlobalParams]
  displacements = 'disp_x disp_y disp_z'
  decomposition_method = HughesWinget
[]

[Mesh]
  [cube]
    type = GeneratedMeshGenerator
    dim = 3
  []
[]

[Functions]
  [shear]
    type = PiecewiseLinear
    x = '0 1 2'
    y = '0 1 0'
  []
[]

[Physics/SolidMechanics/QuasiStatic]
  [all]
    add_variables = true
    strain = FINITE
    generate_output = 'stress_xx stress_yy stress_zz stress_xz'
  []
[]

[BCs]
  [held_x]
    type = DirichletBC
    variable = disp_x
    boundary = back
    value = 0
  []
  [moved_x]
    type = FunctionDirichletBC
    variable = disp_x
    boundary = front
    function = shear
  []
  [held_y]
    type = DirichletBC
    variable = disp_y
    boundary = 'back front'
    value = 0
  []
  [held_z]
    type = DirichletBC
    variable = disp_z
    boundary = 'back front'
    value = 0
  []
[]

[Materials]
  [sand]
    type = AbaqusUMATStress
    plugin = './granumat'
    # mu, stiffness, closure, contact, elastic_strain, phi, pressure, spin, calibration, order
    constant_properties = '0.5 1e6 3 0 0.01 0.60 5e3 2 0 0'
    num_state_vars = 23
    use_one_based_indexing = true
    use_displaced_mesh = true
  []
[]

[Preconditioning]
  [all]
    type = SMP
    full = true
  []
[]

[Executioner]
  type = Transient
  solve_type = NEWTON
  dt = 0.01
  end_time = 2
[]

[Postprocessors]
  [stress_xz]
    type = ElementAverageValue
    variable = stress_xz
  []
  [stress_zz]
    type = ElementAverageValue
    variable = stress_zz
  []
[]

[Outputs]
  csv = true
[]
