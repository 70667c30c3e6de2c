"""Sea state: the JONSWAP spectrum as a short-crested sum of sinusoids, and wave encounter.

Lives here: `SeaSettings`, `jonswap`, `WaveField` (amplitude, frequency, wave number, direction and phase of each component).
Does not live here: how a hull answers to the waves (vessel.py).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import scipy.integrate
from numpy.typing import ArrayLike, NDArray

from riins_core.earth import STANDARD_GRAVITY
from riins_core.settings import setting

Array = NDArray[np.float64]

_WAVE_STREAM = 0x77617665
"""Separates the random numbers of the sea from those of the sensors under the same seed."""


@dataclass(frozen=True)
class SeaSettings:
    """Sea state; sea state 5 is 2.5-4 m, moderate (4) 1.25-2.5 m."""

    significant_wave_height_m: float = setting(0.0, "significant wave height; 0: flat water", "m", low=0.0, high=20.0)
    peak_period_s: float = setting(8.0, "period of the spectral peak", "s", low=2.0, high=25.0)
    direction_deg: float = setting(0.0, "mean direction the waves come from, clockwise from north", "deg", low=-360.0, high=360.0)
    spreading_deg: float = setting(20.0, "standard deviation of the components' directions; 0: long-crested", "deg", low=0.0, high=60.0)
    gamma: float = setting(3.3, "peak enhancement of JONSWAP; 1: Pierson-Moskowitz", "", low=1.0, high=7.0)
    components: int = setting(30, "number of sinusoids", "", low=1, high=500)
    seed: int = setting(-1, "seed of phases and directions; -1: the scenario's", low=-1)


def jonswap(omega: ArrayLike, significant_wave_height: float, peak_period: float, gamma: float = 3.3) -> Array:
    """One-sided JONSWAP spectrum of the surface elevation.

    Parameters
    ----------
    omega : (...), angular frequency, rad/s, > 0
    significant_wave_height : Hs = 4 sqrt(m0), m
    peak_period : Tp, s
    gamma : peak enhancement

    Returns
    -------
    (...), S(omega), m^2 s/rad, normalised so that its integral over 0..infinity is Hs^2 / 16 within 0.2 %

    Notes
    -----
    Hasselmann et al. (1973), in the form of DNV-RP-C205 (3.5.5), whose normalising factor 1 - 0.287 ln(gamma) is a fit to 2 %;
    here the fit is replaced by the integral on a grid.
    """
    omega = np.asarray(omega, dtype=np.float64)
    peak = 2.0 * math.pi / peak_period
    grid = np.linspace(0.2, 20.0, 20001) * peak
    m0 = float(scipy.integrate.trapezoid(_jonswap_shape(grid, peak, gamma), grid))
    return np.asarray(_jonswap_shape(omega, peak, gamma) * (significant_wave_height**2 / 16.0 / m0))


def _jonswap_shape(omega: Array, peak: float, gamma: float) -> Array:
    width = np.where(omega <= peak, 0.07, 0.09)
    bump = np.exp(-0.5 * ((omega - peak) / (width * peak)) ** 2)
    x = omega / peak
    return np.asarray(x**-5.0 * np.exp(-1.25 * x**-4.0) * gamma**bump)


def encounter_frequency(omega: ArrayLike, speed: ArrayLike, angle: ArrayLike) -> Array:
    """Angular frequency at which a moving ship meets a deep-water wave.

    Parameters
    ----------
    omega : (...), wave frequency, rad/s
    speed : (...), ship's speed, m/s
    angle : (...), from the ship's course to the direction the wave travels to, rad; 0: following, pi: head sea

    Returns
    -------
    (...), omega - omega^2 U cos(angle) / g, rad/s; negative where the ship overtakes the wave
    """
    omega = np.asarray(omega, dtype=np.float64)
    return np.asarray(omega - omega**2 * np.asarray(speed) * np.cos(angle) / STANDARD_GRAVITY)


@dataclass(frozen=True)
class WaveField:
    """Components of a sea: elevation eta = sum a cos(omega t - k_n N - k_e E + phase), N, E metres north and east of the start.

    Attributes
    ----------
    amplitude : (n,), a, m
    omega : (n,), rad/s
    wave_number : (n,), k = omega^2 / g (deep water), rad/m
    direction : (n,), direction of travel, clockwise from north, rad
    phase : (n,), rad
    """

    amplitude: Array
    omega: Array
    wave_number: Array
    direction: Array
    phase: Array

    @classmethod
    def draw(cls, sea: SeaSettings, seed: int) -> WaveField:
        """Draw the components of a sea.

        Parameters
        ----------
        sea : its settings
        seed : of the scenario; `sea.seed` goes before it

        Returns
        -------
        WaveField; no component when the significant wave height is 0

        Notes
        -----
        Bins of equal energy, so every amplitude is sqrt(2 m0 / n) and Hs is exact; the frequency is drawn within its bin, so the sum does not
        repeat itself after 2 pi / d omega as an equidistant one would (a minute and a half with 30 components).
        """
        n = sea.components if sea.significant_wave_height_m > 0.0 else 0
        rng = np.random.default_rng([_WAVE_STREAM, sea.seed if sea.seed >= 0 else seed])
        peak = 2.0 * math.pi / sea.peak_period_s
        grid = np.linspace(0.5, 6.0, 8001) * peak
        shape = _jonswap_shape(grid, peak, sea.gamma)
        energy = np.concatenate([[0.0], np.cumsum(0.5 * (shape[1:] + shape[:-1]))])
        share = (np.arange(n) + rng.random(n)) / max(n, 1)
        omega = np.interp(share * energy[-1], energy, grid)
        amplitude = np.full(n, sea.significant_wave_height_m / 4.0 * math.sqrt(2.0 / max(n, 1)))
        direction = np.deg2rad(sea.direction_deg + 180.0 + sea.spreading_deg * rng.standard_normal(n))
        phase = 2.0 * math.pi * rng.random(n)
        return cls(amplitude, omega, omega**2 / STANDARD_GRAVITY, direction, phase)

    @property
    def significant_wave_height(self) -> float:
        """4 sqrt(m0) of the components, m."""
        return float(4.0 * math.sqrt(0.5 * float(np.sum(self.amplitude**2))))

    def elevation(self, t: ArrayLike, north: ArrayLike = 0.0, east: ArrayLike = 0.0) -> Array:
        """Surface elevation.

        Parameters
        ----------
        t : (m,), s
        north, east : place, broadcast against t, m from the start

        Returns
        -------
        (m,), m, up
        """
        t, north, east = (np.asarray(v, dtype=np.float64)[..., None] for v in (t, north, east))
        k = self.wave_number
        angle = self.omega * t - k * np.cos(self.direction) * north - k * np.sin(self.direction) * east + self.phase
        return np.asarray(np.sum(self.amplitude * np.cos(angle), axis=-1))
