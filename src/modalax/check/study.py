"""The measurement as the detectors use it: plain arrays, noise, modes, drive points."""

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from jaxtyping import Complex, Float

from modalax.check.basis import ALL_POWERS
from modalax.check.modes import Modes, estimate_modes, noise_of, residues_at
from modalax.check.noise import local_noise
from modalax.check.starts import principal_frfs, telling_lines
from modalax.data.causality import CERTAIN, phase_fall
from modalax.data.dofs import same_place
from modalax.data.frf import DERIVATIVES
from modalax.data.measurement import Measurement

# A mode counts in an FRF if its residue exceeds its standard deviation by this factor.
CLEAR = 6.0
# Modes closer than this many times the sum of their decay rates share their phases.
CLOSE = 2.0
# What modes leave of an FRF that they follow in its outlines, root mean square.
FOLLOWED = 0.2


class DrivePoint(NamedTuple):
    """An output and an input at one place; ``sign`` is -1 where their directions are opposite."""

    o: int
    i: int
    sign: int
    name: str


@dataclass(frozen=True)
class Study:
    """Arrays of a measurement in the convention of a positive time, lines above 0 Hz.

    Attributes
    ----------
    freq
        Lines [Hz], shape ``(f,)``.
    H
        FRFs, ``(run, f, o, i)``.
    variance
        As stated, or None.
    level
        Force of each run [N], NaN where unknown.
    power
        0 for receptance, 1 for mobility, 2 for accelerance.
    conjugated
        Whether the FRFs were conjugated and have been turned back here.
    """

    freq: Float[np.ndarray, " f"]
    H: Complex[np.ndarray, "run f o i"]
    variance: Float[np.ndarray, "run f o i"] | None
    level: Float[np.ndarray, " run"]
    averages: int | None
    form: str
    power: int
    outputs: tuple[str, ...]
    inputs: tuple[str, ...]
    added_decay: float
    fall: float

    @property
    def conjugated(self) -> bool:
        """Whether the FRFs came conjugated."""
        return self.fall < -CERTAIN

    @cached_property
    def sigma(self) -> Float[np.ndarray, "run f o i"]:
        """Root of E|e|^2 of each sample: stated and smoothed over lines, else estimated from neighbouring lines."""
        runs, lines, outs, ins = self.H.shape
        flat = self.H.transpose(1, 0, 2, 3).reshape(lines, -1)
        if self.variance is None:
            sigma = local_noise(self.freq, flat, self.power)
        else:
            stated = self.variance.transpose(1, 0, 2, 3).reshape(lines, -1)
            sigma = np.sqrt(stated if self.averages is None else running_mean(stated, 4))
        floor = 1e-9 * np.sqrt(np.mean(np.abs(flat) ** 2, axis=0)) + np.sqrt(np.finfo(float).tiny)
        return np.maximum(sigma, floor).reshape(lines, runs, outs, ins).transpose(1, 0, 2, 3)

    @cached_property
    def silent(self) -> np.ndarray:
        """FRFs that are zero or constant throughout, ``(run, o, i)``: no mode can be seen in them."""
        return np.ptp(self.H.real, axis=1) + np.ptp(self.H.imag, axis=1) == 0

    @cached_property
    def modes(self) -> Modes:
        """Modes of the first run, channels in the order (o, i)."""
        return self.modes_of(self.H[0], self.sigma[0])

    def modes_of(self, H: np.ndarray, sigma: np.ndarray) -> Modes:
        """Modes of some FRFs ``(f, o, i)``."""
        lines = len(self.freq)
        return estimate_modes(self.freq, H.reshape(lines, -1), sigma.reshape(lines, -1), self.power)

    @cached_property
    def telling(self) -> np.ndarray:
        """Lines that tell poles: all, or of very many an even choice and those that stand out."""
        H, sigma = (a[0].reshape(len(self.freq), -1) for a in (self.H, self.sigma))
        return telling_lines(principal_frfs(H / np.sqrt(np.mean(sigma**2, axis=0))))

    @cached_property
    def residues(self) -> Complex[np.ndarray, "n o i"]:
        """Residues of the first run."""
        return self.modes.residues.reshape(-1, len(self.outputs), len(self.inputs))

    @cached_property
    def residue_std(self) -> Float[np.ndarray, "n o i"]:
        """Their standard deviations."""
        return self.modes.std.reshape(-1, len(self.outputs), len(self.inputs))

    @cached_property
    def groups(self) -> tuple[np.ndarray, ...]:
        """Modes within the band by rising frequency; of those closer than their bandwidths only the sum counts."""
        poles = self.modes.poles
        order = np.argsort(poles.imag)
        groups: list[list[int]] = []
        for r in order:
            last = groups[-1][-1] if groups else None
            close = last is not None and abs(poles[r] - poles[last]) < CLOSE * -(poles[r].real + poles[last].real)
            groups[-1].append(r) if close else groups.append([r])
        return tuple(np.array(g) for g in groups if self.modes.inside[g].all())

    @cached_property
    def summed(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Circular frequency, residues and their standard deviations of the groups, ``(g,)``, ``(g, o, i)`` twice."""
        if not self.groups:
            empty = np.zeros((0, len(self.outputs), len(self.inputs)))
            return np.zeros(0), empty.astype(complex), empty
        omega = np.array([self.modes.poles[g].imag.mean() for g in self.groups])
        residues = np.stack([self.residues[g].sum(axis=0) for g in self.groups])
        std = np.stack([np.sqrt((self.residue_std[g] ** 2).sum(axis=0)) for g in self.groups])
        return omega, residues, std

    @cached_property
    def unsure(self) -> Float[np.ndarray, "g o i"]:
        """By how much the residues of the groups change with more smooth terms for modes beyond the band."""
        lines, shape = len(self.freq), self.residues.shape
        H, sigma = (a[0].reshape(lines, -1) for a in (self.H, self.sigma))
        omega, noise = 2 * np.pi * self.freq, noise_of(H, sigma)
        more = residues_at(omega, H, noise, self.modes.poles, self.power, ALL_POWERS).residues.reshape(shape)
        change = [np.abs((more - self.residues)[g].sum(axis=0)) for g in self.groups]
        return np.stack(change) if change else np.zeros((0, *shape[1:]))

    @cached_property
    def drive_points(self) -> tuple[DrivePoint, ...]:
        """Places both driven and measured."""
        return tuple(
            DrivePoint(o, i, sign, out)
            for o, out in enumerate(self.outputs)
            for i, into in enumerate(self.inputs)
            if (sign := same_place(out, into))
        )

    @cached_property
    def explained(self) -> bool:
        """Whether the modes explain the first run well enough to judge phases by."""
        return len(self.modes.poles) > 0 and float(np.median(self.modes.misfit)) < 30

    @cached_property
    def followed(self) -> bool:
        """Whether the modes follow the first run in its outlines, as they do also in a wrong form."""
        H = self.H[0].reshape(len(self.freq), -1)
        left = np.linalg.norm(H - self.modes.fitted, axis=0) / np.maximum(np.linalg.norm(H, axis=0), 1e-300)
        return len(self.modes.poles) > 0 and (self.explained or float(np.median(left)) < FOLLOWED)


def study_of(measurement: Measurement) -> Study:
    """Take a measurement apart; lines at 0 Hz are left out.

    Raises
    ------
    ValueError
        If fewer than 8 lines above 0 Hz are left.
    """
    fall = phase_fall(measurement)
    freq, H = np.asarray(measurement.freq, float), np.array(measurement.H, complex)
    keep = freq > 0
    if keep.sum() < 8:
        raise ValueError(f"holds {keep.sum()} lines above 0 Hz; at least 8 are needed to judge a measurement")
    variance = None if measurement.variance is None else np.asarray(measurement.variance, float)[:, keep]
    if variance is not None and not variance.any():
        variance = None
    return Study(
        freq=freq[keep], H=(H.conj() if fall < -CERTAIN else H)[:, keep], variance=variance,
        level=np.asarray(measurement.level, float), averages=measurement.averages, form=measurement.form,
        power=DERIVATIVES[measurement.form], outputs=measurement.outputs, inputs=measurement.inputs,
        added_decay=float(measurement.added_decay), fall=fall,
    )  # fmt: skip


def running_mean(values: np.ndarray, half: int) -> np.ndarray:
    """Mean over ``2 half + 1`` lines, along the first axis, in logarithms where all are positive."""
    half = min(half, (len(values) - 1) // 2)
    window = np.ones(2 * half + 1) / (2 * half + 1)
    padded = np.pad(values, ((half, half), (0, 0)), mode="edge")
    return np.stack([np.convolve(column, window, "valid") for column in padded.T], axis=1)


def line_step(freq: np.ndarray, at: np.ndarray) -> np.ndarray:
    """Distance of lines near some frequencies [Hz]."""
    gaps = np.diff(freq)
    return gaps[np.clip(np.searchsorted(freq, at) - 1, 0, len(gaps) - 1)]
