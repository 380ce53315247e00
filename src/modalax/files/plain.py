"""Reading plain files of FRFs: arrays under the names that laboratories use, without form, axes or channel names."""

import itertools
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from typing import Any

import numpy as np

from modalax.data.frf import DERIVATIVES, default_names
from modalax.files.units import frequency_factor, plain, response_unit

# Names that stand for those of the file contract, in this order where several are there.
USUAL = {
    "freq": ("f", "Freq", "frequency", "Frequency", "frequencies", "freqs", "f_Hz", "freq_Hz", "freq_hz", "f_hz"),
    "omega": ("omega", "w", "om"),
    "H": ("FRF", "frf", "Frf", "FRFs", "frfs", "Hf"),
    "coherence": ("coh", "Coh", "gamma2"),
}
PARTS = (("H_re", "H_im"), ("H_real", "H_imag"), ("FRF_re", "FRF_im"), ("FRF_real", "FRF_imag"), ("re", "im"))
PLAIN_KEYS = frozenset(itertools.chain(*USUAL.values(), *PARTS))
AXES = ("run", "f", "o", "i")


@dataclass(frozen=True)
class Told:
    """Facts about a file that the user gives because the file does not hold them; None where nothing is given.

    Attributes
    ----------
    form
        ``receptance``, ``mobility`` or ``accelerance``.
    unit, frequency_unit
        Unit of the FRFs, such as ``g/N`` or ``mm/N``, and of the frequencies: Hz, kHz, rad/s or rpm.
    outputs, inputs
        DoF names.
    axes
        Axes of H in their order, out of run, f, o, i: ``f o``, for example.
    """

    form: str | None = None
    unit: str | None = None
    frequency_unit: str | None = None
    outputs: Sequence[str] | None = None
    inputs: Sequence[str] | None = None
    axes: str | None = None

    @property
    def words(self) -> list[str]:
        """The facts that were given, by name."""
        return [f.name for f in fields(self) if getattr(self, f.name) is not None]


def understood(arrays: Mapping[str, Any], told: Told) -> dict[str, Any]:
    """The arrays of the file contract, from arrays under other names and facts from the user; guesses are warned of.

    Raises
    ------
    ValueError
        If something is missing or may mean several things; the message names the option that tells it.
    """
    named = _renamed(dict(arrays))
    bare = not {"outputs", "inputs"} & set(named)
    if not told.words and not bare:
        return named
    if "H" not in named or "freq" not in named:
        return named  # the error for what is missing comes where the arrays are read
    named = _in_si(named, told)
    for side in ("outputs", "inputs"):
        if getattr(told, side) is not None:
            named[side] = np.array([str(name) for name in getattr(told, side)])
    if told.axes is not None or bare:
        axes = _axes(named, told)
        named["H"] = _arranged(np.asarray(named["H"]), axes)
        for name in ("variance", "coherence"):
            if name in named:
                named[name] = _arranged(np.asarray(named[name]), axes)
        named.pop("axes", None)
        _, _, n_out, n_in = named["H"].shape
        for side, count in (("outputs", n_out), ("inputs", n_in)):
            if side not in named:
                named[side] = np.array(default_names(count, side[0]))
                shown = named[side][0] if count == 1 else f"{named[side][0]} to {named[side][-1]}"
                _say(f"its {side} have no names and are called {shown}; {side}=[...] (--{side}) names them")
    return named


def _say(sentence: str) -> None:
    warnings.warn(sentence, UserWarning, stacklevel=3)


def _renamed(arrays: dict[str, Any]) -> dict[str, Any]:
    """Arrays under the names of the contract; a warning says where another name was taken."""
    for name, usual in USUAL.items():
        other = next((u for u in usual if u in arrays and arrays[u] is not None), None)
        target = "freq" if name == "omega" else name
        if other is None or arrays.get(target) is not None:
            continue
        arrays[target] = arrays.pop(other)
        if name == "omega":
            arrays[target] = np.asarray(arrays[target]) / (2 * np.pi)
            _say(f"{other} is taken as the circular frequency in rad/s")
        else:
            _say(f"{other} is taken as {target}")
    for real, imag in PARTS:
        if arrays.get("H") is None and arrays.get(real) is not None and arrays.get(imag) is not None:
            arrays["H"] = np.asarray(arrays.pop(real)) + 1j * np.asarray(arrays.pop(imag))
            _say(f"{real} and {imag} are taken as the real and imaginary part of H")
    return arrays


def _in_si(arrays: dict[str, Any], told: Told) -> dict[str, Any]:
    """Frequencies in Hz, FRFs in SI units, and their form, with the units that the user gave."""
    if told.frequency_unit is not None:
        arrays["freq"] = np.asarray(arrays["freq"]) * frequency_factor(told.frequency_unit)
    if told.unit is not None:
        form, factor = response_unit(told.unit)
        if told.form not in (None, form):
            raise ValueError(f"{told.unit} is the unit of {form}, and form says {told.form!r}; one is wrong")
        check_told_form(_text(arrays.get("form")), form, f"unit={told.unit!r} (--unit {told.unit})")
        arrays["H"], arrays["form"] = np.asarray(arrays["H"]) * factor, np.array(form)
        if "variance" in arrays:
            arrays["variance"] = np.asarray(arrays["variance"]) * factor**2
    elif told.form is not None:
        check_told_form(_text(arrays.get("form")), told.form)
        arrays["form"] = np.array(told.form)
    if "form" not in arrays:
        raise ValueError(
            "no form in it; a measurement file needs freq, H, form: tell whether it is receptance, mobility "
            "or accelerance by form='accelerance' (--form accelerance), or by unit='g/N' (--unit g/N)"
        )
    return arrays


def check_told_form(stated: str | None, told: str | None, option: str = "") -> None:
    """Refuse a form that differs from the one that a file states; ``option`` is how it was told, if not by its name.

    Raises
    ------
    ValueError
        Naming both.
    """
    if stated in DERIVATIVES and told is not None and told != stated:
        raise ValueError(
            f"it states that its FRFs are {stated}, and {option or f'form={told!r} (--form {told})'} says {told}; "
            "leave that out, or correct the form in the file if it is wrong"
        )


def _axes(arrays: Mapping[str, Any], told: Told) -> tuple[str, ...]:
    """Axes of H in their order: those the user gave, else the only ones that fit.

    Raises
    ------
    ValueError
        If none fit, or several do.
    """
    shape, lines = np.shape(arrays["H"]), int(np.size(arrays["freq"]))
    counts = {"f": lines} | {s[0]: np.size(arrays[s]) for s in ("outputs", "inputs") if s in arrays}
    said = told.axes if told.axes is not None else _text(arrays.get("axes"))
    if said is not None:
        axes = tuple(said.replace(",", " ").split())
        if len(set(axes)) != len(axes) or not set(axes) <= set(AXES) or "f" not in axes or len(axes) != len(shape):
            raise ValueError(
                f"axes says {said!r} for H of shape {shape}; it names each axis once out of run, f, o, i, with spaces "
                "between, such as 'f o i'"
            )
        if not _fits(axes, shape, counts):
            raise ValueError(f"axes says {said!r}, but H has shape {shape} for {_counted(counts)}")
        return axes
    if len(shape) == 4:
        if not _fits(AXES, shape, counts):
            raise ValueError(f"H has shape {shape}; four axes are run, f, o, i, and there are {_counted(counts)}")
        return AXES
    fitting = {}
    for axes in itertools.permutations(("f", "o", "i"), len(shape)):
        if _fits(axes, shape, counts):
            # Axes of length one may change places: the numbers stay the same.
            fitting[tuple((a, n) for a, n in zip(axes, shape, strict=True) if n > 1)] = axes
    if len(fitting) == 1:
        return next(iter(fitting.values()))
    why = "fits no order of axes" if not fitting else "does not tell outputs from inputs"
    raise ValueError(
        f"H has shape {shape} for {_counted(counts)}, which {why}; name the channels by outputs=[...] and inputs=[...] "
        "(--outputs, --inputs) or the axes in their order by axes='f o i' (--axes 'f o i'; also 'f o', 'f i', ...)"
    )


def _text(value: Any) -> str | None:
    return None if value is None else " ".join(str(word) for word in np.ravel(value))


def _counted(counts: Mapping[str, int]) -> str:
    words = {"f": "frequency lines", "o": "outputs", "i": "inputs"}
    return ", ".join(f"{n} {words[a]}" for a, n in counts.items())


def _fits(axes: Sequence[str], shape: Sequence[int], counts: Mapping[str, int]) -> bool:
    lengths = dict(zip(axes, shape, strict=True))
    return all(lengths.get(a, 1) == n for a, n in counts.items())


def _arranged(value: np.ndarray, axes: Sequence[str]) -> np.ndarray:
    """An array over (run, f, o, i), with axes of length one where it has none."""
    have = [a for a in AXES if a in axes]
    turned = value.transpose([list(axes).index(a) for a in have])
    return turned.reshape([turned.shape[have.index(a)] if a in have else 1 for a in AXES])


def plain_dataset(dataset: Any) -> Any:
    """An xarray dataset under the names of the contract: real and imaginary parts put together, axes renamed."""
    renames = {"f": "freq", "frequency": "freq", "o": "output", "out": "output", "outputs": "output",
               "response": "output", "i": "input", "in": "input", "inputs": "input", "reference": "input"}  # fmt: skip
    names = set(dataset.variables) | set(dataset.dims)
    found = {a: b for a, b in renames.items() if a in names and b not in names}
    dataset = dataset.rename({a: b for k, (a, b) in enumerate(found.items()) if b not in list(found.values())[:k]})
    main = next((n for n in ("H", *USUAL["H"]) if n in dataset), None)
    if main is not None and main != "H":
        dataset = dataset.rename({main: "H"})
    for real, imag in PARTS:
        if "H" not in dataset and real in dataset and imag in dataset:
            H = (dataset[real] + 1j * dataset[imag]).assign_attrs(dataset[real].attrs)
            dataset = dataset.drop_vars([real, imag]).assign(H=H)
    if "H" in dataset and dataset["H"].dtype.kind == "f":
        for dim in dataset["H"].dims:
            words = [plain(w)[:2] for w in dataset[dim].to_numpy()] if dim in dataset.coords else []
            if words == ["re", "im"]:
                H = dataset["H"]
                joined = H.isel({dim: 0}, drop=True) + 1j * H.isel({dim: 1}, drop=True)
                dataset = dataset.drop_vars(["H", dim]).assign(H=joined.assign_attrs(H.attrs))
                break
    return dataset
