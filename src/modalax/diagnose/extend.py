"""The extended simulation: the old one and the causes found, as an ordinary simulation."""

from collections.abc import Sequence
from types import ModuleType
from typing import Any

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Array, Complex, Float

from modalax._numerics.checks import as_array, as_double
from modalax._numerics.cuts import cut, spread_over
from modalax._numerics.known import Numbers, by_numpy, circular
from modalax.data import FRF
from modalax.data.dofs import as_names
from modalax.data.frf import DERIVATIVES, check_form
from modalax.diagnose.causes import saved_causes
from modalax.diagnose.causes.base import Cause, JointCause
from modalax.diagnose.causes.free_law import free_law_of
from modalax.diagnose.causes.scene import Place
from modalax.diagnose.fitting.hypothesis import Hypothesis, slopes
from modalax.diagnose.overview import of_extended
from modalax.diagnose.prediction.frf import predict
from modalax.diagnose.prediction.harmonics import HIGHEST, with_harmonics
from modalax.diagnose.setup.modal_form import kept_coupling, modal_form_of
from modalax.diagnose.setup.problem import Problem
from modalax.files.guard import reading
from modalax.model import ModalModel, Structure


@by_numpy
def _of_form(
    xp: ModuleType, H: Any, omega: Any, level: Any, *, steps: int
) -> tuple[Complex[Numbers, "f o i"], Numbers]:
    """Derivatives of the only run's receptances, and the middling force level."""
    return H[0] * ((1j * omega) ** steps)[:, None, None], xp.asarray(xp.mean(level))


class ExtendedSimulation(eqx.Module):
    r"""A simulation with causes added, which predicts any DoF, level and band.

    Attributes
    ----------
    base
        The simulation as it was.
    params
        Parameters of each cause; the leaves that gradients flow to.
    spread
        Standard deviation of each parameter, None where it is not known.
    theta
        Adapted logarithms of the modal frequencies and damping ratios, shape ``(2, n)``.
    extras
        Sizes over the channels of causes that need them, or None.
    causes, places
        What was added, and where.
    outputs, inputs
        Channels that places of channel faults refer to.
    harmonics
        Highest harmonic of the motion with which each joint was fitted and is predicted; 1 for the fundamental alone,
        as everything else and several joints together have it.
    """

    base: Structure | ModalModel
    params: tuple[Array, ...]
    spread: tuple[Array, ...]
    theta: Float[Array, "two n"]
    extras: tuple[Any, ...]
    causes: tuple[Cause, ...] = eqx.field(static=True)
    places: tuple[Any, ...] = eqx.field(static=True)
    outputs: tuple[str, ...] = eqx.field(static=True)
    inputs: tuple[str, ...] = eqx.field(static=True)
    lowest_hz: float = eqx.field(static=True)
    harmonics: tuple[int, ...] = eqx.field(static=True, default=())

    def __str__(self) -> str:
        """What was added where, and the simulation as it was."""
        return of_extended(self)

    @property
    def slugs(self) -> tuple[str, ...]:
        """Causes by name."""
        return tuple(c.slug for c in self.causes)

    def predict(
        self, level: Any, freq: Any, *, form: str = "receptance", outputs: Sequence[str] | None = None,
        inputs: Sequence[str] | None = None, measured: bool = True,
    ) -> FRF:  # fmt: skip
        """The FRF at a force level [N], one number or one for each line, and frequencies [Hz] between DoFs by name.

        Parameters
        ----------
        measured
            Whether faults of the measurement (gains, delays, windows) are to be seen in it; False gives the
            structure itself.

        Raises
        ------
        ValueError
            If a fault of a channel is to be shown on other channels than the measured ones.
        """
        outputs = self.outputs if outputs is None else as_names(outputs)
        inputs = self.inputs if inputs is None else as_names(inputs)
        keep = [k for k, c in enumerate(self.causes) if measured or c.in_structure]
        other = [self.causes[k].slug for k in keep if self.causes[k].on_measured_channels]
        if other and (outputs, inputs) != (self.outputs, self.inputs):
            raise ValueError(
                f"{', '.join(other)} is known on the measured channels only; ask for these, or for measured=False"
            )
        coupling = kept_coupling(zip(self.causes, self.params, strict=True))
        modal_form = modal_form_of(self.base, self.lowest_hz, concrete(self.theta), concrete(coupling))
        freq, level = as_double(freq, "freq"), as_double(level, "level")
        omega, steps = circular(freq), DERIVATIVES[check_form(form)]
        shape = (1, freq.shape[0], len(outputs), len(inputs))
        problem = Problem(
            omega, as_array(np.zeros(shape, complex)), as_array(np.ones(shape)),
            cut(spread_over(level, freq.shape), None),
            as_array(np.array([modal_form.index(n) for n in outputs])),
            as_array(np.array([modal_form.index(n) for n in inputs])),
            modal_form, shape[1], (shape[2], shape[3]), None, steps,
        )  # fmt: skip
        index = np.array([self.places[k].index for k in keep], dtype=np.int64).reshape(-1, 3)
        theta = self.theta[:, : modal_form.poles.shape[0]]
        causes, params = tuple(self.causes[k] for k in keep), tuple(self.params[k] for k in keep)
        extras = with_harmonics(
            causes, index, tuple(self.extras[k] for k in keep), params, theta, problem,
            [self.harmonics[k] if self.harmonics else 1 for k in keep],
        )  # fmt: skip
        H = predict(causes, index, extras, params, theta, problem)
        H, level = _of_form(H, omega, level, steps=steps)
        return FRF(freq, H, form=form, outputs=outputs, inputs=inputs, level=level)

    def frf(
        self, freq: Any, *, level: Any = 1.0, form: str = "receptance", outputs: Sequence[str] | None = None,
        inputs: Sequence[str] | None = None,
    ) -> FRF:  # fmt: skip
        """The same with the level last, as the other simulations have it."""
        return self.predict(level, freq, form=form, outputs=outputs, inputs=inputs)

    def arrays(self) -> dict[str, np.ndarray]:
        """Everything as plain arrays, for a file; :func:`from_arrays` reads them."""
        base = self.base
        if isinstance(base, Structure):
            out = {"kind": "structure", "M": base.M, "C": base.C, "K": base.K, "D": base.D, "dofs": list(base.dofs)}
        else:
            out = {
                "kind": "modal", "poles": base.poles, "shapes": base.shapes, "participation": base.participation,
                "upper": base.upper, "lower": base.lower, "model_outputs": list(base.outputs),
                "model_inputs": list(base.inputs),
            }  # fmt: skip
        out |= {
            "frequency_std": base.frequency_std, "damping_std": base.damping_std, "theta": self.theta,
            "outputs": list(self.outputs), "inputs": list(self.inputs), "lowest_hz": self.lowest_hz,
            "causes": [_key(c) for c in self.causes], "harmonics": list(self.harmonics),
        }  # fmt: skip
        for k, place in enumerate(self.places):
            out |= {f"where_{k}": [str(w) for w in place.where], f"index_{k}": list(place.index)}
            out |= {f"params_{k}": self.params[k], f"spread_{k}": self.spread[k]}
            if self.extras[k] is not None:
                out[f"extra_{k}"] = self.extras[k]
        return {name: np.asarray(value) for name, value in out.items()}

    def save(self, path: Any, overwrite: bool = False) -> None:
        """Write to an ``.npz`` file; :func:`modalax.load` reads it."""
        from modalax.files import save

        save(self, path, overwrite)


def concrete(a: Any) -> np.ndarray | None:
    """What complex modes are made exact about; None under a derivative by it."""
    return None if isinstance(a, jax.core.Tracer) else np.asarray(a)


def _key(cause: Cause) -> str:
    own = ",".join(
        f"{k}={v}" for k, v in sorted(vars(cause).items()) if isinstance(v, bool | int | str) and k != "summary"
    )
    return f"{type(cause).__name__}({own})"


def as_given(simulation: Structure | ModalModel | ExtendedSimulation) -> Structure | ModalModel | ExtendedSimulation:
    """A corrected simulation without causes as the matrices or modes that it is; any other as it is."""
    if isinstance(simulation, ExtendedSimulation) and not simulation.causes and not np.any(simulation.theta):
        return simulation.base
    return simulation


def extend(comparison: Any, h: Hypothesis) -> ExtendedSimulation:
    """The extended simulation of a fitted hypothesis."""
    old = comparison.simulation if isinstance(comparison.simulation, ExtendedSimulation) else None
    n = len(comparison.scene.modal_form.poles)
    assert h.theta is not None
    theta = as_array((h.theta * comparison.nuisance.spread)[:, :n])
    spread, k = [], 0
    for cause, p in zip(h.causes, h.params, strict=True):
        count = len(p)
        variance = np.diag(h.covariance)[k : k + count] if h.covariance is not None else np.full(count, np.nan)
        spread.append(as_array(np.sqrt(np.maximum(variance, 0.0)) * np.abs(slopes(cause, p))))
        k += count
    n_out, n_in = comparison.problem.channels
    in_full = [isinstance(c, JointCause) and e is not None for c, e in zip(h.causes, h.extras, strict=True)]
    harmonics = tuple(HIGHEST if full else 1 for full in in_full)
    extras = tuple(
        None if e is None or full else as_array(e[:, :n_out, :n_in]) for e, full in zip(h.extras, in_full, strict=True)
    )
    params = tuple(as_array(p) for p in h.params)
    channels = comparison.scene.outputs, comparison.scene.inputs, float(comparison.scene.freq[0])
    if old is None:
        return ExtendedSimulation(
            comparison.simulation, params, tuple(spread), theta, extras, h.causes, h.places, *channels, harmonics
        )  # fmt: skip
    return ExtendedSimulation(
        old.base, old.params + params, old.spread + tuple(spread), old.theta + theta, old.extras + extras,
        old.causes + h.causes, old.places + h.places, *channels,
        (old.harmonics or (1,) * len(old.causes)) + harmonics,
    )  # fmt: skip


def from_arrays(arrays: Any, causes: Sequence[Cause] | None = None) -> ExtendedSimulation:
    """Read back what :meth:`ExtendedSimulation.arrays` gave (an open ``.npz`` file does as well).

    Parameters
    ----------
    causes
        Causes of one's own, beside those of the catalogue.

    Raises
    ------
    ValueError
        If a cause is not known, an array is missing or holds what cannot be.
    """
    with reading("the extended simulation", ValueError):
        found = _from_arrays(arrays, causes)
    _check(found)
    return found


def _check(found: ExtendedSimulation) -> None:
    """Refuse numbers that no extension has."""
    least = len(found.base.poles) if isinstance(found.base, ModalModel) else 0
    if found.theta.ndim != 2 or found.theta.shape[0] != 2 or found.theta.shape[1] < least:
        raise ValueError(f"theta has shape {found.theta.shape}; it needs (2, n), a column a mode")
    numbers = {"theta": found.theta, "lowest_hz": found.lowest_hz}
    if found.harmonics and (
        len(found.harmonics) != len(found.causes) or not all(1 <= h <= 99 for h in found.harmonics)
    ):
        raise ValueError(f"harmonics are {found.harmonics}; they need one number from 1 to 99 for each cause")
    for k, (cause, place) in enumerate(zip(found.causes, found.places, strict=True)):
        params, spread = found.params[k], found.spread[k]
        if params.shape != (len(cause.parameters),) or spread.shape != params.shape or len(place.index) != 3:
            raise ValueError(
                f"params_{k}, spread_{k}, index_{k} have {params.shape}, {spread.shape}, ({len(place.index)},) items; "
                f"{cause.slug} needs {len(cause.parameters)} parameters and 3 indices"
            )
        numbers[f"params_{k}"] = params
        if found.extras[k] is not None:
            numbers[f"extra_{k}"] = found.extras[k]
    wrong = [name for name, value in numbers.items() if not np.isfinite(np.asarray(value)).all()]
    if wrong:
        raise ValueError(f"{', '.join(wrong)} of the extended simulation must be finite")


def _from_arrays(arrays: Any, causes: Sequence[Cause] | None) -> ExtendedSimulation:
    known = {_key(c): c for c in (*saved_causes(), *(causes or ()))}
    claims = {"frequency_std": arrays["frequency_std"], "damping_std": arrays["damping_std"]}
    names = lambda key: [str(n) for n in arrays[key]]
    if str(arrays["kind"]) == "structure":
        base = Structure(arrays["M"], arrays["C"], arrays["K"], names("dofs"), D=arrays["D"], **claims)
    else:
        base = ModalModel(
            arrays["poles"], arrays["shapes"], arrays["participation"], upper=arrays["upper"],
            lower=arrays["lower"], outputs=names("model_outputs"), inputs=names("model_inputs"), **claims,
        )  # fmt: skip
    keys = names("causes")
    known |= {key: law for key in keys if (law := free_law_of(key)) is not None}
    strange = [k for k in keys if k not in known]
    if strange:
        raise ValueError(
            f"cause {strange[0]} is unknown: pass causes of your own to load(..., causes=[...]); known are "
            f"{', '.join(sorted(known))}"
        )
    every = range(len(keys))
    places = tuple(Place(tuple(names(f"where_{k}")), tuple(int(v) for v in arrays[f"index_{k}"])) for k in every)
    return ExtendedSimulation(
        base, tuple(as_array(arrays[f"params_{k}"]) for k in every),
        tuple(as_array(arrays[f"spread_{k}"]) for k in every), as_array(arrays["theta"]),
        tuple(as_array(arrays[f"extra_{k}"]) if f"extra_{k}" in arrays else None for k in every),
        tuple(known[k] for k in keys), places, tuple(names("outputs")), tuple(names("inputs")),
        float(arrays["lowest_hz"]),
        tuple(int(v) for v in arrays["harmonics"]) if "harmonics" in arrays else (),
    )  # fmt: skip
