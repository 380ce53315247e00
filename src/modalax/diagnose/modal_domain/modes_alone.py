r"""A simulation that is known by its modes alone: frequencies, damping and shapes at some DoFs.

It tells no elements, so that its general inaccuracy is one between modes (:mod:`couplings`), and a spring may sit
between any of its DoFs. What modes beyond those that were exported do is known in two ways only:

- Couplings to them move shapes at each DoF by itself (:mod:`shape_scatter`).
- They add a static correction, without which no FRF is right between its peaks. It is estimated from the measurement.
  With U its part between forces at drive points and all outputs, and :math:`U_d` that between drive points,
  :math:`U U_d^{-1} U^T` is the symmetric correction of least rank that has these columns; it is put in as further
  modes.
"""

from dataclasses import dataclass, replace

import numpy as np

from modalax.diagnose.modal_domain.coordinates import AT_LEAST, FURTHER, SPARE, Coordinates
from modalax.diagnose.modal_domain.couplings import counted_with, couples_of, coupling_patterns
from modalax.diagnose.modal_domain.measured import Measured
from modalax.model import ModalModel
from modalax.model.elements import Elements
from modalax.model.groups import Groups

MOST = 100  # modes that are used; those above count as static
TURNED = 0.3  # imaginary part of a scaled shape, relative to the whole, from which damping makes it complex
BEYOND = (1.1, 1.3, 1.6, 2.0, 2.5, 3.5, 6.0, 30.0)  # frequencies of what was not exported, over the highest of all
SURE = 4.0  # standard deviations from which a flexibility at the drive points is one
NEXT, BESIDE = 3, 8  # modes above the band that are off in themselves, and that those below may be coupled with


@dataclass(frozen=True)
class ModesAlone:
    """Real modes at some DoFs, in the place of a structure of matrices.

    Attributes
    ----------
    dofs
        Names of the DoFs.
    frequencies, damping
        Circular frequencies [rad/s] and twice damping ratio times circular frequency [1/s], shape ``(n,)``.
    shapes
        Of unit modal mass, shape ``(dof, n)``.
    exported
        How many of them are modes of the simulation; what comes behind stands for the modes that were not exported.
    frequency_std, damping_std
        Relative standard deviations that the author claims.
    """

    dofs: tuple[str, ...]
    frequencies: np.ndarray
    damping: np.ndarray
    shapes: np.ndarray
    frequency_std: np.ndarray
    damping_std: np.ndarray
    exported: int
    stiffness_std: float | None = None
    mass_std: float | None = None
    pairs: tuple[tuple[str, str], ...] | None = None
    elements: Elements | None = None
    groups: Groups | None = None

    def index(self, dof: str) -> int:
        """Position of a DoF."""
        return self.dofs.index(dof)

    def coordinates(self, outputs: tuple[str, ...], inputs: tuple[str, ...], highest: float) -> Coordinates:
        """Its modal coordinates, for a band that ends at ``highest`` [rad/s]."""
        w = np.append(self.frequencies, SPARE * max(float(self.frequencies[-1]), highest))
        shapes = np.pad(self.shapes, ((0, 0), (0, 1)))
        rows, columns = ([self.index(name) for name in names] for names in (outputs, inputs))
        inside = int(np.count_nonzero(self.frequencies < highest))
        return Coordinates(
            w, np.diag(np.append(self.damping, 0.0)), shapes, shapes[rows], shapes[columns],
            min(len(w), max(inside + FURTHER, AT_LEAST)), self.dofs, shapes,
        )  # fmt: skip

    def model(self) -> ModalModel:
        """The same as a modal model."""
        phi = self.shapes.T
        poles = -self.damping / 2 + 1j * np.sqrt(self.frequencies**2 - self.damping**2 / 4)
        return ModalModel(
            poles, phi, phi / (2j * poles.imag)[:, None], outputs=self.dofs, inputs=self.dofs,
            frequency_std=self.frequency_std, damping_std=self.damping_std,
        )  # fmt: skip

    def inside(self, highest: float) -> int:
        """Number of modes in a band that ends at ``highest`` [rad/s]; at least one."""
        return max(int(np.count_nonzero(self.frequencies[: self.exported] < highest)), 1)

    def patterns(self, c: Coordinates, highest: float) -> tuple[np.ndarray, np.ndarray]:
        """General inaccuracy of stiffness and mass: changes between modes by the whole, each ``(p, n, n)``."""
        inside = min(self.inside(highest) + NEXT, self.exported)
        couples = couples_of(self.exported, inside, BESIDE)
        by = counted_with(c.frequencies, inside)
        return coupling_patterns(couples, by), coupling_patterns(couples, np.ones(c.size))


def modes_alone(model: ModalModel) -> ModesAlone | None:
    """A modal model as real modes; None where it has no scale (no drive point), or its modes are complex."""
    if not model.drive_points():
        return None
    dofs = model.outputs + tuple(name for name in model.inputs if name not in model.outputs)
    poles = np.asarray(model.poles)
    order = np.argsort(np.abs(poles))[:MOST]
    scale = np.sqrt(np.asarray(model.modal_mass()))
    shapes = (np.asarray(model.shapes_at(dofs)) / scale[:, None])[order]
    whole = np.linalg.norm(shapes, axis=1)
    if not (whole > 0).all() or (np.linalg.norm(shapes.imag, axis=1) > TURNED * whole).any():
        return None
    poles = poles[order]
    frequency_std, damping_std = (np.asarray(std)[order] for std in (model.frequency_std, model.damping_std))
    return ModesAlone(dofs, np.abs(poles), -2 * poles.real, shapes.real.T, frequency_std, damping_std, len(poles))


def with_static_correction(simulation: ModesAlone, c: Coordinates, measured: Measured, m: tuple) -> ModesAlone:
    """The simulation with the static correction that its modes lack.

    Parameters
    ----------
    c
        Its coordinates.
    measured
        The measurement, identified.
    m
        Names of the measured outputs and inputs.
    """
    outputs, inputs = m
    there = [k for k, name in enumerate(inputs) if name in outputs]
    if not there:
        return simulation
    U, error, w = _static(c, measured)
    rows = [outputs.index(inputs[k]) for k in there]
    own, spread = (A[np.ix_(rows, there)] for A in (U, error))
    values, turn = np.linalg.eigh((own + own.T) / 2)
    kept = values > SURE * np.sqrt((spread**2).mean())
    if not kept.any():
        return simulation
    at = U[:, there] @ turn[:, kept] / np.sqrt(values[kept])
    driven = np.linalg.lstsq(at, U, rcond=None)[0].T
    more = np.zeros((len(simulation.dofs), int(kept.sum())))
    none = np.zeros(more.shape[1])
    more[[simulation.index(name) for name in inputs]] = w * driven
    more[[simulation.index(name) for name in outputs]] = w * at
    return replace(
        simulation, frequencies=np.append(simulation.frequencies, none + w),
        damping=np.append(simulation.damping, none), shapes=np.concatenate([simulation.shapes, more], axis=1),
        frequency_std=np.append(simulation.frequency_std, none), damping_std=np.append(simulation.damping_std, none),
    )  # fmt: skip


def _static(c: Coordinates, measured: Measured) -> tuple[np.ndarray, np.ndarray, float]:
    """Static receptance of modes beyond those of band and simulation, its standard deviation, and their frequency."""
    ch, form = measured.channels, measured.channels.s**measured.channels.order
    low, high = float(abs(ch.s[0])), float(abs(ch.s[-1]))
    beyond = np.flatnonzero((c.frequencies < low) | (c.frequencies > high))[:-1]
    D = form[:, None] / (c.frequencies[beyond] ** 2 + ch.s[:, None] ** 2 + ch.s[:, None] * np.diag(c.damping)[beyond])
    known = np.einsum("fr,or,ir->foi", D, c.outputs[:, beyond], c.inputs[:, beyond]).reshape(ch.data.shape)
    kernels, shape = ch.kernels(measured.modes.poles), (len(c.outputs), len(c.inputs))
    found, least = (np.zeros(shape), np.ones(shape), high), np.inf
    for w in np.array(BEYOND) * max(float(c.frequencies[-2]), high):
        terms = np.stack([form / (1 + (ch.s / w) ** 2), form * (low / ch.s) ** 2], axis=1)
        value, error, left = _first(np.concatenate([terms, kernels], axis=1), ch.data - known, ch.weight)
        if left < least:
            found, least = (value.reshape(shape), np.sqrt(measured.misfit) * error.reshape(shape), w), left
    return found


def _first(columns: np.ndarray, data: np.ndarray, weight: np.ndarray) -> tuple[np.ndarray, np.ndarray, float]:
    """Of real factors of columns, fitted to each channel, the first with its deviation, and the chi-square left."""
    size, left = np.linalg.norm(columns, axis=0), 0.0
    value, error = np.zeros(data.shape[1]), np.zeros(data.shape[1])
    apart = lambda z: np.concatenate([z.real, z.imag])
    for k, root in enumerate(np.sqrt(weight.T)):
        A, e = apart((columns / size) * root[:, None]), apart(data[:, k] * root)
        inverse = np.linalg.pinv(A.T @ A, hermitian=True)
        x = inverse @ (A.T @ e)
        value[k], error[k] = x[0] / size[0], np.sqrt(max(inverse[0, 0], 0.0)) / size[0]
        left += float(((e - A @ x) ** 2).sum())
    return value, error, left
