"""Shear bands of the runs of gradient.toml beside the law with a length: how wide they are, and which length they have.

    python bands.py

In steady shear the law with a length l has one stress ratio mu(R) for each R, so that the nonlocal strain m obeys
l^2 m'' = m (1 - R(tau/sigma_zz)); there is a steady state for one shear stress tau only.
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from collect import read
from gradient import COLLECTED
from profiles import of_layers
from scipy.linalg import eigh_tridiagonal
from scipy.optimize import brentq, minimize_scalar

from granumat import Material
from granumat.tensors import magnitude, symmetric

CELLS = 256                 # over half the height, a multiple of half the layers
RATIOS = np.r_[np.linspace(0.01, 1, 60), np.linspace(1.02, 3, 60)]      # R
CLOCK, INCREMENTS = 0.05, 200           # nonlocal strain of an increment; how many there are to a steady state
LENGTHS = (0.1, 3.0)        # in diameters: where a length is looked for
TAIL = 0.003                # of the largest shear: what is below counts as noise
SHARES = (0.05, 0.95)       # of the slip: between them are 90 %


# ---- the law ---------------------------------------------------------------------------------------------------------------

@dataclass(frozen=True)
class Friction:
    """Stress ratio -sigma_xz/sigma_zz in steady simple shear against R = abs(D)/m.

    Attributes
    ----------
    R, ratio : array
        Both increase.
    """

    R: np.ndarray
    ratio: np.ndarray

    @classmethod
    def of(cls, material, phi=0.60):
        """That of a material, sheared until it is steady."""
        gradients = np.zeros((len(RATIOS), 3, 3))
        gradients[:, 0, 2] = 1
        gradients *= (CLOCK * RATIOS / magnitude(symmetric(gradients)))[:, None, None]
        states = np.repeat(material.steady(phi), len(RATIOS))
        for _ in range(INCREMENTS):
            states = material.update(states, gradients, nonlocal_strain=np.full(len(RATIOS), CLOCK))
        return cls(RATIOS, states.stress[:, 4] / -states.stress[:, 2])

    @property
    def homogeneous(self):
        """The ratio at R = 1."""
        return float(np.interp(1, self.R, self.ratio))

    def R_at(self, ratio):
        """R at stress ratios; below those that are known it is in proportion."""
        return np.interp(ratio, np.r_[0, self.ratio], np.r_[0, self.R])


@dataclass(frozen=True)
class Pressures:
    """sigma_zz = mean (1 - gradient cos(2 pi z/height)), z from the middle."""

    mean: float
    gradient: float
    height: float

    @classmethod
    def of(cls, profile):
        """Those of a measured profile."""
        z, mean = profile["z"], profile["sigma_zz"].mean()
        height = (z[-1] - z[0]) * len(z) / (len(z) - 1)
        return cls(mean, -2 * (profile["sigma_zz"] * np.cos(2 * np.pi * z / height)).mean() / mean, height)

    def at(self, z):
        """sigma_zz at heights."""
        return self.mean * (1 - self.gradient * np.cos(2 * np.pi * z / self.height))


@dataclass(frozen=True)
class Band:
    """A steady band.

    Attributes
    ----------
    z, slip : array
        Heights from the middle, and the displacement there per slip from end to end.
    tau : float
        Shear stress.
    height : float
        Of the box.
    """

    z: np.ndarray
    slip: np.ndarray
    tau: float
    height: float


def steady_band(friction, length, pressures, layers):
    """The steady band of the law with a length, at the middles of layers."""
    step = pressures.height / 2 / CELLS
    sigma = pressures.at((np.arange(CELLS) + 0.5) * step)
    diffusion = (length / step) ** 2
    diagonal = diffusion * np.r_[1, np.full(CELLS - 2, 2), 1]

    def lowest(tau):
        return eigh_tridiagonal(diagonal + 1 - friction.R_at(tau / sigma), np.full(CELLS - 1, -diffusion), select="i",
                                select_range=(0, 0))

    tau = brentq(lambda tau: lowest(tau)[0][0], friction.homogeneous * sigma[0], friction.homogeneous * sigma.mean(),
                 rtol=1e-10)
    shear = friction.R_at(tau / sigma) * abs(lowest(tau)[1][:, 0])
    upper = np.r_[0, np.cumsum(shear)] / shear.sum() / 2                # slip at the edges of the cells
    z = (np.arange(layers) + 0.5) / layers * pressures.height - pressures.height / 2
    slip = np.sign(z) * np.interp(abs(z), np.arange(CELLS + 1) * step, upper)
    return Band(z, slip, tau, pressures.height)


# ---- bands ---------------------------------------------------------------------------------------------------------------

def measured_band(profile):
    """The Band of a measured profile."""
    z = profile["z"]
    return Band(z, profile["slip"], -profile["sigma_xz"].mean(), (z[-1] - z[0]) * len(z) / (len(z) - 1))


def folded_shear(band):
    """Distances from the middle, and the shear per slip there, over two layers, as the mean of both sides."""
    shear = (band.slip[2:] - band.slip[:-2]) / (band.z[2:] - band.z[:-2])
    shear = (shear + shear[::-1]) / 2
    upper = band.z[1:-1] > 0
    return band.z[1:-1][upper], shear[upper]


def width(band):
    """Standard deviation of the band, and the height over which 90 % of the slip is lost; slip in the ends is left out."""
    slip = (band.slip - band.slip[0]) / (band.slip[-1] - band.slip[0])
    middles, parts = (band.z[1:] + band.z[:-1]) / 2, np.diff(slip)
    deviation = np.sqrt((parts * middles**2).sum() - (parts * middles).sum() ** 2)
    lower, upper = np.interp(SHARES, np.maximum.accumulate(slip), band.z)
    return deviation, upper - lower


def decades(band):
    """Over how many decades the shear falls from the middle to the ends, as a mean over the outer quarters."""
    z, shear = folded_shear(band)
    return np.log10(shear.max() / abs(shear[z > band.height * 3 / 8].mean()))


def fit_length(profile, friction):
    """The length with which the steady band of the law is nearest to a profile, and how near.

    Returns
    -------
    tuple of float
        The length, in diameters; the root mean square difference of the logarithms of the shear, where it is not noise.
    """
    band, pressures = measured_band(profile), Pressures.of(profile)
    shear = folded_shear(band)[1]
    clear = np.cumprod(shear > TAIL * shear.max()).astype(bool)          # from the middle to the first that is not

    def difference(length):
        model = folded_shear(steady_band(friction, length, pressures, len(band.z)))[1]
        return np.sqrt((np.log(shear[clear] / model[clear]) ** 2).mean())

    found = minimize_scalar(difference, bounds=LENGTHS, method="bounded", options={"xatol": 1e-4})
    return float(found.x), float(found.fun)


# ---- after a reversal ------------------------------------------------------------------------------------------------------

@dataclass(frozen=True)
class Reversal:
    """What follows the flip of the rate, which was forward.

    Attributes
    ----------
    path : array (rows)
        Slip of the box from end to end since then, 0 first, in d.
    tau : array (rows)
        Shear stress, at first that of steady shear.
    slip : array (rows, layers)
        Displacement of the layers against their steady motion since then.
    z : array (layers)
    """

    path: np.ndarray
    tau: np.ndarray
    slip: np.ndarray
    z: np.ndarray

    @classmethod
    def of(cls, table):
        """That of a measured history, whose last step it is, or of several of its kind, as their mean."""
        strain = np.diff(table["gamma"], prepend=0)
        rows = table["step"] == table["step"].max()
        before = max(int(np.argmax(rows)) - 1, 0)
        slip = -np.where(rows[:, None], of_layers(table, "slip"), 0).cumsum(axis=0)
        path = -np.where(rows, strain * table["height"], 0).cumsum()
        layers = slip.shape[1]
        z = ((np.arange(layers) + 0.5) / layers - 0.5) * table["height"].mean()
        return cls(path[before:], -table["sigma_xz"][before:], slip[before:], z)

    def path_to(self, share, steady):
        """The slip at which the shear stress first is this share of the steady one, negative in the new direction."""
        row = int(np.argmax(self.tau <= share * steady))
        return float(np.interp(-share * steady, -self.tau[row - 1:row + 1], self.path[row - 1:row + 1]))

    def outside(self, half, start, end):
        """Share of the slip between two slips of the box that is lost further than `half` from the middle.

        Returns
        -------
        tuple of float
            Of all slip; and without the elastic slip, which goes with the change of stress by the slope at the start of the reversal.
        """
        height = (self.z[1] - self.z[0]) * len(self.z)
        edges = np.array([np.interp([-half, half], self.z, slip) for slip in self.slip])

        def change(values):
            return np.interp(end, self.path, values) - np.interp(start, self.path, values)

        within, total = change(edges[:, 1] - edges[:, 0]), end - start
        elastic = change(self.tau) * self.path[1] / (self.tau[1] - self.tau[0])
        return 1 - within / total, 1 - (within - elastic * 2 * half / height) / (total - elastic)


# ---- all -------------------------------------------------------------------------------------------------------------------

MIDDLE = 0.97               # of the slip of steady shear is lost in what counts as the band
EARLY = 3.0                 # slip after a reversal, in d
STEADY = {"steady": "reversal", "slow": "slow"}         # programme with steady shear: that with the reversal after it


def half_height(band):
    """Half the height in the middle over which MIDDLE of the slip is lost."""
    z, shear = folded_shear(band)
    share = 2 * np.r_[0, np.cumsum(shear)] * (z[1] - z[0])
    return float(np.interp(MIDDLE, share, np.r_[0, z + (z[1] - z[0]) / 2]))


def seeds_of(folder, name):
    """Collected tables of a programme by seed."""
    return {int(table.stem.rpartition("_s")[2]): read(table) for table in sorted(folder.glob(f"{name}_s[0-9]*.csv"))}


def homogeneous_ratio(folder):
    """-sigma_xz/sigma_zz without a gradient, of each seed."""
    return np.array([-profile["sigma_xz"].mean() / profile["sigma_zz"].mean()
                     for profile in seeds_of(folder / "gradient0", "homogeneous-profile").values()])


def rows_of(folder, frictions):
    """What is found, a dict for each collected run of steady shear under a gradient.

    Parameters
    ----------
    folder : Path
    frictions : dict of str to Friction
        By closure.
    """
    homogeneous = homogeneous_ratio(folder).mean()
    for place in sorted(folder.glob("gradient0.*")):
        for programme, reversal in STEADY.items():
            reversals = seeds_of(place, reversal)
            for seed, profile in seeds_of(place, f"{programme}-profile").items():
                band, pressures = measured_band(profile), Pressures.of(profile)
                deviation, ninety = width(band)
                row = {"gradient": pressures.gradient, "programme": programme, "seed": seed, "deviation": deviation, "width": ninety,
                       "decades": decades(band), "ratio": band.tau / pressures.at(0) / homogeneous}
                for closure, friction in frictions.items():
                    length, difference = fit_length(profile, friction)
                    predicted = steady_band(friction, length, pressures, len(band.z)).tau / pressures.at(0)
                    row |= {f"l {closure}": length, f"rms {closure}": difference,
                            f"ratio {closure}": predicted / friction.homogeneous}
                if seed in reversals:
                    after, half = Reversal.of(reversals[seed]), half_height(band)
                    for start, end in ((0, EARLY), (after.path[-1] - 2, after.path[-1])):
                        row |= {f"outside {start:.0f}-{end:.0f}": after.outside(half, start, end)}
                    row |= {"zero": after.path_to(0, band.tau), "most": after.path_to(-0.9, band.tau)}
                yield row


def main():
    frictions = {closure: Friction.of(Material(0.5, closure=closure, elastic_strain=0.01)) for closure in ("full", "kinematic")}
    ratios = homogeneous_ratio(COLLECTED)
    print(f"homogeneous ratio {ratios.mean():.4f}, {len(ratios)} packings, scatter {ratios.std(ddof=len(ratios) > 1):.4f}")
    for row in rows_of(COLLECTED, frictions):
        print("  ".join(f"{name} {value if isinstance(value, (str, int)) else np.round(value, 3)}" for name, value in row.items()))


if __name__ == "__main__":
    main()
