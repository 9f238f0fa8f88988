"""Shear bands of the runs of gradient.toml beside the law with a length: how wide they are, and which length they have.

    python bands.py

In steady shear the law with a length l has one stress ratio mu(R) for each R, so that the nonlocal strain m obeys
l^2 m'' = m (1 - R(tau/sigma_zz)); there is a steady state for one shear stress tau only.
"""

from dataclasses import dataclass

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
TAIL = 0.03                 # of the largest shear: what is below does not count, since it takes long to become steady
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
    """Standard deviation of the slip in the middle half of the height, and the height over which 90 % of all slip is lost."""
    z, shear = folded_shear(band)
    near = z < band.height / 4
    deviation = np.sqrt((shear * z**2)[near].sum() / shear[near].sum())
    share = (band.slip - band.slip[0]) / (band.slip[-1] - band.slip[0])
    lower, upper = np.interp(SHARES, np.maximum.accumulate(share), band.z)
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
            Of all slip; and without the elastic slip, which goes with the stress by the slope at the start of the reversal.
        """
        height = (self.z[1] - self.z[0]) * len(self.z)
        edges = np.array([np.interp([-half, half], self.z, slip) for slip in self.slip])

        def change(values):
            return np.interp(end, self.path, values) - np.interp(start, self.path, values)

        within, total = change(edges[:, 1] - edges[:, 0]), end - start
        elastic = change(self.tau) * self.path[1] / (self.tau[1] - self.tau[0])
        return 1 - within / total, 1 - (within - elastic * 2 * half / height) / (total - elastic)


# ---- all -------------------------------------------------------------------------------------------------------------------

LAWS = {"full": {"closure": "full", "elastic_strain": 0.01}, "kinematic": {"closure": "kinematic", "elastic_strain": 0.01},
        "full dem-2026": {"closure": "full", "calibration": "dem-2026"},
        "mobilised dem-2026": {"closure": "mobilised", "calibration": "dem-2026"}}
MIDDLE = 0.97               # of the slip of steady shear is lost in what counts as the band
CORE = 2.0                  # from the middle, in d: where phi is that of the band
WINDOWS = ((0, 3), (3, 6), (6, 8))      # slip after a reversal, in d
TURNED = (0, -0.5, -0.9)    # of the stress before a reversal
REVERSALS = {"steady": "reversal", "slow": "slow"}      # programme with steady shear: that with the reversal after it


def half_height(band):
    """Half the height in the middle over which MIDDLE of the slip is lost."""
    z, shear = folded_shear(band)
    share = 2 * np.r_[0, np.cumsum(shear)] * (z[1] - z[0])
    return float(np.interp(MIDDLE, share, np.r_[0, z + (z[1] - z[0]) / 2]))


def seeds_of(folder, name):
    """Collected tables of a programme by seed."""
    return {int(table.stem.rpartition("_s")[2]): read(table) for table in sorted(folder.glob(f"{name}_s[0-9]*.csv"))}


def homogeneous(folder):
    """-sigma_xz/sigma_zz and phi without a gradient: arrays over the seeds."""
    return np.array([(-profile["sigma_xz"].mean() / profile["sigma_zz"].mean(), profile["phi"].mean())
                     for profile in seeds_of(folder / "gradient0", "homogeneous-profile").values()]).T


def of_steady(profile, frictions):
    """What a profile of steady shear tells, by name.

    Parameters
    ----------
    profile : dict of str to array
    frictions : dict of str to Friction
    """
    band, pressures = measured_band(profile), Pressures.of(profile)
    found = dict(zip(("deviation", "width"), width(band)))
    found |= {"decades": decades(band), "ratio": band.tau / pressures.at(0)}
    found["phi"] = profile["phi"][abs(band.z) < CORE].mean()
    for law, friction in frictions.items():
        found[f"l {law}"], found[f"rms {law}"] = fit_length(profile, friction)
        steady = steady_band(friction, found[f"l {law}"], pressures, len(band.z))
        found[f"rise {law}"] = steady.tau / pressures.at(0) / friction.homogeneous
    return found


def of_reversal(reversal, band):
    """What a reversal after a steady band tells, by name: shares of slip outside it, and slips to shares of the stress before."""
    windows = [window for window in WINDOWS if window[1] <= reversal.path[-1]]
    found = {}
    for start, end in windows:
        for name, share in zip(("outside", "plastic outside"), reversal.outside(half_height(band), start, end)):
            found[f"{name} {start}-{end}"] = share
    return found | {f"slip to {share}": reversal.path_to(share, band.tau) for share in TURNED
                    if reversal.tau.min() <= share * band.tau}


def summary(folder, frictions):
    """Means over seeds of what bands tell, and standard deviations between them, for each gradient and programme."""
    for place in sorted(folder.glob("gradient0.*")):
        for programme, other in REVERSALS.items():
            reversals, found = seeds_of(place, other), []
            for seed, profile in seeds_of(place, f"{programme}-profile").items():
                found.append(of_steady(profile, frictions))
                if seed in reversals:
                    found[-1] |= of_reversal(Reversal.of(reversals[seed]), measured_band(profile))
            if found:
                names = [name for name in found[0] if all(name in one for one in found)]
                values = np.array([[one[name] for name in names] for one in found])
                yield (place.name, programme, len(found),
                       {name: (column.mean(), column.std(ddof=len(found) > 1)) for name, column in zip(names, values.T)})


def main():
    frictions = {law: Friction.of(Material(0.5, **settings)) for law, settings in LAWS.items()}
    for name, values in zip(("ratio", "phi"), homogeneous(COLLECTED)):
        print(f"homogeneous {name}: {values.mean():.4f} +- {values.std(ddof=len(values) > 1):.4f}, {len(values)} packings")
    for place, programme, packings, found in summary(COLLECTED, frictions):
        print(f"\n{place} {programme}, {packings} packings")
        for name, (mean, scatter) in found.items():
            print(f"  {name:28} {mean:.3f} +- {scatter:.3f}")


if __name__ == "__main__":
    main()
