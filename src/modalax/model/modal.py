"""The modal model: poles, shapes, participation and residual terms, and the FRF they make."""

from collections.abc import Sequence
from types import ModuleType
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Complex, Float

from modalax._numerics.checks import as_array, as_double, is_traced, require_finite, require_range
from modalax._numerics.cuts import cut, spread_over
from modalax._numerics.known import Numbers, by_numpy
from modalax.data.checks import check_axis
from modalax.data.dofs import as_names
from modalax.data.frf import DERIVATIVES, FRF, check_form, check_names
from modalax.model.overview import of_modes

ROUNDING = 1e-9  # part of a residual term, relative to its largest entry, that rounding explains


def poles_from(frequency_hz: Any, damping_ratio: Any) -> Complex[Array, " n"]:
    r"""Poles :math:`\lambda = -\zeta\omega + j\omega\sqrt{1-\zeta^2}` [rad/s] of frequencies [Hz] and ratios."""
    return _poles(as_double(frequency_hz, "frequency"), as_double(damping_ratio, "damping ratio"))


@by_numpy
def _poles(xp: ModuleType, frequency_hz: Any, zeta: Any) -> Complex[Numbers, "..."]:
    omega = 2 * np.pi * frequency_hz
    return -zeta * omega + 1j * omega * xp.sqrt(1 - zeta**2)


def claimed_std(value: Any, name: str, modes: int) -> Array:
    """Relative standard deviations that an author claims: one number, or one for each mode.

    Raises
    ------
    ValueError
        If their shape is another, or one is negative or not finite.
    """
    std = as_double(value, name)
    if std.shape not in ((), (1,), (modes,)):
        raise ValueError(f"{name} has shape {std.shape}; it needs one number, or one for each of {modes} modes")
    require_range(value, name, 0.0, np.inf, "a relative standard deviation is 0 or positive")
    return std


class ModalModel(eqx.Module):
    r"""A linear structure in modal form.

    The receptance between input ``i`` and output ``o`` is

    .. math:: H_{oi}(\omega) = \sum_r \left(\frac{\psi_{ro} L_{ri}}{j\omega - \lambda_r}
              + \frac{\psi_{ro}^* L_{ri}^*}{j\omega - \lambda_r^*}\right) + U_{oi} - \frac{W_{oi}}{\omega^2},

    and mobility and accelerance are :math:`j\omega` and :math:`-\omega^2` times that, so that each residual term
    takes the form that suits them. At 0 Hz the lower term of a receptance or mobility is left out: it stands for modes
    below the lines as seen from above them, and would be infinite there.

    Attributes
    ----------
    poles
        :math:`\lambda_r`, imaginary part positive, shape ``(n,)`` [rad/s].
    shapes
        Mode shapes :math:`\psi_{ro}`, shape ``(n, o)`` [-].
    participation
        Modal participation :math:`L_{ri}`, shape ``(n, i)``; ``shapes`` times ``participation`` are the residues
        of the receptance [m/(N s)].
    upper, lower
        Residual terms :math:`U` [m/N] and :math:`W` [1/kg] of the modes above and below the band, shape ``(o, i)``.
    outputs, inputs
        DoF names.
    frequency_std, damping_std
        Relative standard deviation that the author claims for each frequency and damping ratio, shape ``(n,)``.
    """

    poles: Complex[Array, " n"]
    shapes: Complex[Array, "n o"]
    participation: Complex[Array, "n i"]
    upper: Complex[Array, "o i"]
    lower: Complex[Array, "o i"]
    frequency_std: Float[Array, " n"]
    damping_std: Float[Array, " n"]
    outputs: tuple[str, ...] = eqx.field(static=True)
    inputs: tuple[str, ...] = eqx.field(static=True)

    def __init__(
        self,
        poles: Any,
        shapes: Any,
        participation: Any,
        *,
        outputs: Sequence[str],
        inputs: Sequence[str],
        upper: Any = None,
        lower: Any = None,
        frequency_std: Any = 0.0,
        damping_std: Any = 0.0,
    ):
        self.poles = as_double(poles, "poles", complex_=True)
        self.shapes = as_double(shapes, "shapes", complex_=True)
        self.participation = as_double(participation, "participation", complex_=True)
        n = self.poles.shape[0]
        if self.shapes.ndim != 2 or self.participation.ndim != 2 or {len(self.shapes), len(self.participation)} != {n}:
            raise ValueError(
                f"{n} poles with shapes {self.shapes.shape} and participation {self.participation.shape}; "
                "they need shapes (n, o) and (n, i)"
            )
        for value, name in ((poles, "poles"), (shapes, "shapes"), (participation, "participation")):
            require_finite(value, name)
        if not is_traced(self.poles) and (np.asarray(self.poles).imag <= 0).any():
            raise ValueError("a pole has no positive imaginary part; store each conjugate pair once, by its upper pole")
        o, i = self.shapes.shape[1], self.participation.shape[1]
        if not o or not i:
            raise ValueError(f"a modal model of {o} outputs and {i} inputs; at least one of each is needed")
        for value, name in ((upper, "upper"), (lower, "lower")):
            if value is not None:
                require_finite(value, name)
        zero = as_array(np.zeros((o, i), complex))
        self.upper = zero if upper is None else spread_over(as_double(upper, "upper", complex_=True), (o, i))
        self.lower = zero if lower is None else spread_over(as_double(lower, "lower", complex_=True), (o, i))
        self.frequency_std = spread_over(claimed_std(frequency_std, "frequency_std", n), (n,))
        self.damping_std = spread_over(claimed_std(damping_std, "damping_std", n), (n,))
        self.outputs = check_names(outputs, o, "outputs")
        self.inputs = check_names(inputs, i, "inputs")

    @classmethod
    def from_real_modes(
        cls, frequency_hz: Any, damping_ratio: Any, shapes: Any, modal_mass: Any, dofs: Sequence[str]
    ) -> "ModalModel":
        r"""Modes of a proportionally damped structure, residues :math:`\phi_o\phi_i/(2 j \omega_d m)`.

        Parameters
        ----------
        frequency_hz, damping_ratio, modal_mass
            Shape ``(n,)`` [Hz], [-], [kg].
        shapes
            Real shapes, shape ``(n, dof)`` [-].
        """
        require_range(damping_ratio, "damping_ratio", -1 + 1e-12, 1 - 1e-12, "it is a ratio below 1, 0.01 for 1 %")
        poles = poles_from(frequency_hz, damping_ratio)
        phi = as_double(shapes, "shapes")
        if poles.ndim != 1 or phi.ndim != 2 or len(phi) != len(poles):
            raise ValueError(
                f"frequency_hz and damping_ratio make poles of shape {poles.shape}, shapes have {phi.shape}; they need "
                "(n,) and (n, dof), a row for each mode"
            )
        mass = as_double(modal_mass, "modal_mass")
        return cls(poles, phi, _own_participation(phi, poles, mass), outputs=dofs, inputs=dofs)

    def __str__(self) -> str:
        """Channels and the table of modes."""
        return of_modes(self)

    @property
    def frequency_hz(self) -> Float[Array, " n"]:
        r"""Natural frequencies :math:`|\lambda|/2\pi` [Hz]."""
        return _frequency_hz(self.poles)

    @property
    def damping_ratio(self) -> Float[Array, " n"]:
        r"""Damping ratios :math:`-\mathrm{Re}\lambda/|\lambda|` [-]."""
        return _damping_ratio(self.poles)

    @property
    def residues(self) -> Complex[Array, "n o i"]:
        """Residues of the receptance [m/(N s)]."""
        return _residues(self.shapes, self.participation)

    def replace(self, **changes: Any) -> "ModalModel":
        """A copy with some attributes changed and everything checked again."""
        fields = dict(
            poles=self.poles, shapes=self.shapes, participation=self.participation, upper=self.upper,
            lower=self.lower, frequency_std=self.frequency_std, damping_std=self.damping_std, outputs=self.outputs,
            inputs=self.inputs,
        )  # fmt: skip
        return ModalModel(**{**fields, **changes})

    def transpose(self) -> "ModalModel":
        """Outputs and inputs exchanged; with reciprocity the same structure measured the other way round."""
        return self.replace(
            shapes=self.participation, participation=self.shapes, upper=self.upper.T, lower=self.lower.T,
            outputs=self.inputs, inputs=self.outputs,
        )  # fmt: skip

    def along_longer_side(self) -> "ModalModel":
        """The model with its shapes at the outputs, or at the inputs where there are more of them.

        A hammer that roves over a structure has its shapes at the points that it hits, not at the few sensors.
        """
        if len(self.inputs) <= len(self.outputs):
            return self
        return self.transpose().normalised("max")

    @property
    def fitted(self) -> bool:
        """Whether its residual terms are those of a fit to FRFs, and not of modes that a simulation leaves out.

        What rigid bodies and the modes above add is real, symmetric and not negative between all DoFs.
        """
        terms = [np.asarray(self.upper), np.asarray(self.lower)]
        return any(map(np.any, terms)) and not (self.outputs == self.inputs and all(map(_of_modes, terms)))

    def drive_points(self) -> tuple[str, ...]:
        """DoFs that are both output and input."""
        return tuple(name for name in self.inputs if name in self.outputs)

    def modal_a(self, drive_point: str | None = None) -> Complex[Array, " n"]:
        r"""Modal a of each mode, :math:`a_r = \psi_{rd}/L_{rd}`, so that residues are :math:`\psi\psi^T/a`.

        Parameters
        ----------
        drive_point
            The DoF that is output and input; the first such DoF if None.

        Raises
        ------
        ValueError
            If no DoF, or not this one, is both measured and driven: the scaling is then unknown.
        """
        known = self.drive_points()
        if not known:
            raise ValueError("no DoF is both output and input; modal mass needs a drive point FRF")
        if drive_point is not None and drive_point not in known:
            raise ValueError(f"{drive_point!r} is not a drive point; there are {', '.join(known)}")
        name = known[0] if drive_point is None else drive_point
        out, into = self.outputs.index(name), self.inputs.index(name)
        return _quotient(cut(self.shapes, (slice(None), out)), cut(self.participation, (slice(None), into)))

    def modal_mass(self, drive_point: str | None = None) -> Complex[Array, " n"]:
        r"""Modal mass :math:`m_r = a_r/(2j\omega_{d,r})` for the shapes as scaled [kg]; complex for complex modes."""
        return _modal_mass(self.modal_a(drive_point), self.poles)

    def normalised(self, how: str = "max") -> "ModalModel":
        """The same model with each shape scaled and turned: its largest component, or its 2-norm, becomes 1.

        Parameters
        ----------
        how
            ``max``: the largest component becomes exactly 1; ``norm``: the 2-norm becomes 1 and the largest
            component real and positive.
        """
        if how not in ("max", "norm"):
            raise ValueError(f"how is {how!r}; it must be max or norm")
        shapes, participation = _normalised(self.shapes, self.participation, how=how)
        return self.replace(shapes=shapes, participation=participation)

    def frf(
        self,
        freq: Any,
        *,
        form: str = "receptance",
        outputs: Sequence[str] | None = None,
        inputs: Sequence[str] | None = None,
        added_decay: Any = 0.0,
    ) -> FRF:
        """The FRF at any frequencies [Hz], and between any DoFs: unmeasured pairs follow from reciprocity.

        With ``added_decay`` [1/s] as an exponential window would make it measured. At 0 Hz the lower residual term of
        receptance and mobility, infinite there, is left out.

        Raises
        ------
        ValueError
            If a DoF is unknown, or an input that was not driven is asked for and there is no drive point.
        """
        check_axis(freq)
        freq = as_double(freq, "freq")
        out_names = self.outputs if outputs is None else as_names(outputs)
        in_names = self.inputs if inputs is None else as_names(inputs)
        unknown = [n for n in (*out_names, *in_names) if n not in self.outputs and n not in self.inputs]
        if unknown:
            raise ValueError(f"no DoF named {', '.join(unknown)}; the model has {', '.join(self.outputs)}")
        H = _synthesised(
            freq, as_double(added_decay, "added_decay"), self.poles, self.shapes_at(out_names),
            self.participation_at(in_names), self._residual(self.upper, out_names, in_names),
            self._residual(self.lower, out_names, in_names), power=DERIVATIVES[check_form(form)],
        )  # fmt: skip
        return FRF(freq, H, form=form, outputs=out_names, inputs=in_names, added_decay=added_decay)

    def shapes_at(self, names: tuple[str, ...]) -> Complex[Array, "n o"]:
        """Shape components at DoFs that may only have been driven (there by reciprocity)."""
        if names == self.outputs:
            return self.shapes
        columns = [
            cut(self.shapes, (slice(None), self.outputs.index(n)))
            if n in self.outputs
            else _product(cut(self.participation, (slice(None), self.inputs.index(n))), self.modal_a())
            for n in names
        ]
        return _beside(columns)

    def participation_at(self, names: tuple[str, ...]) -> Complex[Array, "n i"]:
        """Participation at DoFs that may only have been measured (there by reciprocity)."""
        if names == self.inputs:
            return self.participation
        columns = [
            cut(self.participation, (slice(None), self.inputs.index(n)))
            if n in self.inputs
            else _quotient(cut(self.shapes, (slice(None), self.outputs.index(n))), self.modal_a())
            for n in names
        ]
        return _beside(columns)

    def _residual(self, term: Array, outs: tuple[str, ...], ins: tuple[str, ...]) -> Complex[Array, "o i"]:
        """A residual term between DoFs, its transpose where only that was measured, zero where neither was."""
        if outs == self.outputs and ins == self.inputs:
            return term
        if not jnp.size(term):
            return as_array(np.zeros((len(outs), len(ins)), complex))
        zero, width = term.size, len(self.inputs)

        def place(o: str, i: str) -> int:
            if o in self.outputs and i in self.inputs:
                return self.outputs.index(o) * width + self.inputs.index(i)
            if i in self.outputs and o in self.inputs:
                return self.outputs.index(i) * width + self.inputs.index(o)
            return zero

        where = np.array([[place(o, i) for i in ins] for o in outs])
        if is_traced(term):
            return jnp.append(term.ravel(), 0.0)[where]
        return as_array(np.append(np.asarray(term), 0.0)[where])


def _of_modes(term: np.ndarray) -> bool:
    """Whether a residual term is what some modes add, but for rounding."""
    least, real = ROUNDING * np.abs(term).max(initial=0.0), (term.real + term.real.T) / 2
    return bool(np.abs(term - real).max(initial=0.0) <= least and np.linalg.eigvalsh(real)[0] >= -least)


@by_numpy
def _residues(xp: ModuleType, shapes: Any, participation: Any) -> Complex[Numbers, "n o i"]:
    return shapes[:, :, None] * participation[:, None, :]


@by_numpy
def _own_participation(xp: ModuleType, phi: Any, poles: Any, mass: Any) -> Complex[Numbers, "n i"]:
    return phi / (2j * poles.imag * mass)[:, None]


@by_numpy
def _modal_mass(xp: ModuleType, modal_a: Any, poles: Any) -> Complex[Numbers, " n"]:
    return modal_a / (2j * poles.imag)


@by_numpy
def _product(xp: ModuleType, a: Any, b: Any) -> Numbers:
    return a * b


@by_numpy
def _quotient(xp: ModuleType, a: Any, b: Any) -> Numbers:
    return a / b


@by_numpy
def _beside(xp: ModuleType, columns: Any) -> Numbers:
    return xp.stack(columns, axis=1)


@by_numpy
def _frequency_hz(xp: ModuleType, poles: Any) -> Float[Numbers, " n"]:
    return xp.abs(poles) / (2 * np.pi)


@by_numpy
def _damping_ratio(xp: ModuleType, poles: Any) -> Float[Numbers, " n"]:
    return -poles.real / xp.abs(poles)


@by_numpy
def _normalised(xp: ModuleType, shapes: Any, participation: Any, *, how: str) -> tuple[Numbers, Numbers]:
    scale = xp.take_along_axis(shapes, xp.argmax(xp.abs(shapes), axis=1)[:, None], axis=1)
    if how == "norm":
        scale = scale / xp.abs(scale) * xp.linalg.norm(shapes, axis=1, keepdims=True)
    return shapes / scale, participation * scale


@by_numpy
def _synthesised(
    xp: ModuleType, freq: Any, added_decay: Any, poles: Any, psi: Any, part: Any, upper: Any, lower: Any, *, power: int
) -> Complex[Numbers, "f o i"]:
    """The FRF of modes and residual terms, differentiated ``power`` times; see :meth:`ModalModel.frf`."""
    s = added_decay + 2j * np.pi * freq
    residues = (psi[:, :, None] * part[:, None, :]).reshape(len(poles), -1)
    H = 1 / (s[:, None] - poles) @ residues + 1 / (s[:, None] - poles.conj()) @ residues.conj()
    H = (H.reshape(len(freq), *upper.shape) + upper) * s[:, None, None] ** power
    safe = xp.where(s == 0, 1.0, s)
    mass_line = xp.where((s == 0) & (power < 2), 0.0, safe ** (power - 2))
    return H + lower * mass_line[:, None, None]


def in_order(model: ModalModel) -> ModalModel:
    """The same model with its modes by rising frequency."""
    order = np.argsort(np.asarray(model.frequency_hz))
    each_mode = ("poles", "shapes", "participation", "frequency_std", "damping_std")
    return model.replace(**{name: cut(getattr(model, name), order) for name in each_mode})
