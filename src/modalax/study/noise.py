"""Noise studies: fits of the same FRFs with another draw of the noise each time."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from modalax.study.fits import fit_row, quantities
from modalax.study.system import load_simulation, poles_in, response
from modalax.study.work import Row, Work, chunk_for, key_of

FITS = 16  # most fits in a chunk of those that are fitted one after the other


@dataclass(frozen=True)
class NoiseWork(Work):
    """Fits of FRFs with noise, each refined by maximum likelihood, one after the other.

    Attributes
    ----------
    frf
        The FRFs without noise.
    poles
        True poles of the modes in the band [rad/s].
    noise, reference
        As for :meth:`modalax.data.FRF.add_noise`.
    fit
        The table ``[fit]``.
    """

    frf: Any
    poles: np.ndarray
    noise: float
    reference: str
    fit: dict[str, Any]

    def item(self, index: int) -> Row:
        """The modes fitted to draw ``index`` of the noise."""
        noisy = self.frf.add_noise(key_of(self.seed, index), self.noise, self.reference)
        return fit_row(noisy, self.fit, self.poles)


def prepare(settings: dict[str, Any], folder: Path) -> Work:
    """The work of a noise study.

    Raises
    ------
    ValueError
        If there is no mode in the band, or more than one force amplitude.
    """
    system, fit = settings["system"], settings["fit"]
    structure = load_simulation(system["simulation"], folder)
    poles = poles_in(structure, system["band"])
    if not len(poles):
        raise ValueError(f"the simulation has no mode in the band {system['band'][0]:g} to {system['band'][1]:g} Hz")
    measurement = response(structure, system)
    if measurement.runs > 1:
        raise ValueError(f"[system] force has {measurement.runs} values; a noise study fits one run, give one force")
    known = not system["joint"]  # the modes of the linear part are not those of a structure with joints
    common: dict[str, Any] = {"quantities": quantities(poles, fit["refine"], known)}
    if not fit["refine"] and fit["method"] in (None, "lscf", "plscf"):
        from modalax.study.batch import BatchWork

        return BatchWork.make(settings, measurement.frf, poles, **common)
    chunk = chunk_for(settings["draws"], settings["chunk"], FITS)
    return NoiseWork(
        settings["draws"], chunk, settings["seed"], measurement.frf, poles, system["noise"],
        system["noise_reference"], fit, **common,
    )  # fmt: skip
