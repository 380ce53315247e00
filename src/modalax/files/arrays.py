"""Measurements, structures and modal models as named arrays, the content of ``.npz`` and ``.mat`` files."""

import difflib
import warnings
from collections.abc import Mapping
from typing import Any

import numpy as np

from modalax.data.frf import FRF
from modalax.data.measurement import Measurement
from modalax.files.gaps import mended
from modalax.files.guard import LONGEST_NAME, check_names
from modalax.files.plain import PLAIN_KEYS, Told, understood
from modalax.model.elements import Elements
from modalax.model.groups import Groups
from modalax.model.modal import ModalModel, poles_from
from modalax.model.structure import Structure

Arrays = Mapping[str, Any]
Saved = Measurement | Structure | ModalModel | Any

MEASUREMENT_KEYS = (
    "freq", "H", "variance", "averages", "coherence", "added_decay", "level", "force", "outputs", "inputs", "form",
    "axes",
)  # fmt: skip
CLAIMS = ("stiffness_std", "mass_std")
ELEMENTS = ("stiffness_elements", "mass_elements", "element_places")
OF_ELEMENTS = "element_dofs"
GROUPS = ("group_names", "group_K", "group_M")
STRUCTURE_KEYS = (
    "M", "C", "K", "D", "dofs", "frequency_std", "damping_std", *CLAIMS, "pairs", *ELEMENTS, OF_ELEMENTS, *GROUPS,
)  # fmt: skip
MODEL_KEYS = (
    "poles", "frequency_hz", "damping_ratio", "shapes", "participation", "modal_a", "modal_mass", "upper", "lower",
    "outputs", "inputs", "frequency_std", "damping_std",
)  # fmt: skip
READ_KEYS = frozenset((*MEASUREMENT_KEYS, *STRUCTURE_KEYS, *MODEL_KEYS)) | PLAIN_KEYS
NOTHING = Told()
# Relative difference within which two participations are the same, and within which they may be estimates of one
SAME, ALIKE = 1e-3, 0.5
EXTENDED = "causes"  # the array that marks an extended simulation


def to_arrays(what: Any) -> dict[str, np.ndarray]:
    """Named arrays of ``what``, as the file contract has them; an :class:`FRF` becomes a measurement of one run."""
    if isinstance(what, FRF):
        what = Measurement.from_frfs([what])
    if isinstance(what, Measurement):
        return _measurement_arrays(what)
    if hasattr(what, "arrays"):
        return what.arrays()
    if isinstance(what, Structure):
        damping = ("C", "D") if np.any(np.asarray(what.D)) else ("C",)
        claims = [name for name in CLAIMS if getattr(what, name) is not None]
        names = ("M", *damping, "K", "frequency_std", "damping_std", *claims)
        labels = ("dofs",) if what.pairs is None else ("dofs", "pairs")
    elif isinstance(what, ModalModel):
        names = ("poles", "shapes", "participation", "upper", "lower", "frequency_std", "damping_std")
        labels = ("outputs", "inputs")
    else:
        raise ValueError(
            f"a {type(what).__name__} cannot be saved; give a Measurement, FRF, Structure, ModalModel "
            "or extended simulation"
        )
    arrays = {name: np.asarray(getattr(what, name)) for name in names}
    if isinstance(what, Structure) and what.elements is not None:
        e = what.elements
        parts = np.asarray(e.stiffness), np.asarray(e.mass), np.array(e.places, dtype=str).reshape(-1, 2)
        arrays |= dict(zip(ELEMENTS, parts, strict=True))
        if e.dofs:
            arrays[OF_ELEMENTS] = np.array(e.dofs, dtype=str)
    if isinstance(what, Structure) and what.groups is not None:
        g = what.groups
        parts = np.array(g.names, dtype=str), np.asarray(g.stiffness), np.asarray(g.mass)
        arrays |= {name: part for name, part in zip(GROUPS, parts, strict=True) if part.dtype.kind == "U" or part.any()}
    shape = {"pairs": (-1, 2)}
    return arrays | {k: np.array(getattr(what, k), dtype=str).reshape(shape.get(k, -1)) for k in labels}


def _measurement_arrays(measurement: Measurement) -> dict[str, np.ndarray]:
    arrays = {
        "freq": np.asarray(measurement.freq), "H": np.asarray(measurement.H), "level": np.asarray(measurement.level),
        "outputs": np.array(measurement.outputs, dtype=str), "inputs": np.array(measurement.inputs, dtype=str),
        "form": np.array(measurement.form),
    }  # fmt: skip
    for name in ("variance", "coherence", "averages", "force"):
        if getattr(measurement, name) is not None:
            arrays[name] = np.asarray(getattr(measurement, name))
    if float(measurement.added_decay) != 0:
        arrays["added_decay"] = np.asarray(measurement.added_decay)
    return arrays


def from_arrays(arrays: Arrays, told: Told = NOTHING, **options: Any) -> Saved:
    """The measurement, structure or modal model that named arrays hold, told apart by their names.

    What measured FRFs do not say themselves may be ``told``.

    Raises
    ------
    ValueError
        If an array is missing, has wrong axes, holds NaN, or the set is of none of the three kinds.
    """
    if EXTENDED in arrays:
        # The one import upward (named in the test of the layers): only the diagnosis knows what its causes are.
        from modalax.diagnose.extend import from_arrays as extended

        return extended(arrays, **options)
    if options:
        raise ValueError(f"option {', '.join(options)} is for extended simulations and UFF files, this is neither")
    if not {"M", "K", "poles", "shapes"} & set(arrays):
        arrays = understood(arrays, told)
    elif told.words:
        raise ValueError(f"option {', '.join(told.words)} is for measured FRFs, and this is a simulation")
    if "H" in arrays or "freq" in arrays:
        _hint(arrays, MEASUREMENT_KEYS)
        return _measurement(arrays)
    if {"M", "K"} & set(arrays):
        _hint(arrays, STRUCTURE_KEYS)
        return _structure(arrays)
    if {"poles", "shapes"} & set(arrays):
        _hint(arrays, MODEL_KEYS)
        return _model(arrays)
    raise ValueError(
        f"holds {', '.join(sorted(arrays)) or 'nothing'}; a measurement needs freq, H, form, outputs, inputs, "
        "a structure M, C, K, dofs, a modal model poles, shapes, participation, outputs, inputs"
    )


def _hint(arrays: Arrays, known: tuple[str, ...]) -> None:
    """Warn where a name that is not read looks like a misspelling of one that is."""
    for name in sorted(set(arrays) - set(known)):
        lower = {k.lower(): k for k in known if k not in arrays}
        close = difflib.get_close_matches(name.lower(), list(lower), n=1, cutoff=0.8)
        if close:
            warnings.warn(
                f"array {name!r} is not read; should it be named {lower[close[0]]!r}?", UserWarning, stacklevel=4
            )


def _need(arrays: Arrays, names: tuple[str, ...], kind: str) -> None:
    missing = [name for name in names if name not in arrays]
    if missing:
        raise ValueError(
            f"no {' and no '.join(missing)} in it; a {kind} file needs {', '.join(names)} "
            f"(here: {', '.join(sorted(arrays))})"
        )


def _numbers(arrays: Arrays, name: str, complex_: bool = False) -> np.ndarray:
    """An array converted to double precision, which is exact for files that store single precision."""
    value = np.asarray(arrays[name])
    if value.dtype.kind not in ("biufc" if complex_ else "biuf"):
        raise ValueError(f"{name} has type {value.dtype}; it needs {'complex' if complex_ else 'real'} numbers")
    return value.astype(np.complex128 if complex_ else np.float64)


def _words(arrays: Arrays, name: str) -> list[str]:
    """Names from an array of text, bytes or whole numbers."""
    value = np.atleast_1d(np.asarray(arrays[name]))
    check_names(value.size, name)
    if value.dtype.kind == "S":
        try:
            value = np.char.decode(value, "utf-8")
        except UnicodeDecodeError as error:
            raise ValueError(f"{name} holds bytes that are no text in UTF-8 ({error})") from error
    if value.dtype.kind not in "UTOiu":
        raise ValueError(f"{name} has type {value.dtype}; it needs text, one name for each channel")
    words = [str(item).strip() for item in value.ravel()]
    if any(len(word) > LONGEST_NAME or not word.isprintable() for word in words):
        raise ValueError(f"{name} holds text that is no name: at most {LONGEST_NAME} letters, all printable, are read")
    return words


def _word(arrays: Arrays, name: str) -> str:
    """Read an array that holds one word, such as the form."""
    words = _words(arrays, name)
    if len(words) != 1 or not words[0]:
        raise ValueError(f"{name} holds {len(words)} words ({', '.join(words[:4])}); it needs one")
    return words[0]


def _number(arrays: Arrays, name: str) -> float:
    value = _numbers(arrays, name)
    if value.size != 1 or not np.isfinite(value).all():
        raise ValueError(f"{name} is {value.ravel()[:4].tolist()}, shape {value.shape}; it needs one finite number")
    return float(value.item())


def _measurement(arrays: Arrays) -> Measurement:
    _need(arrays, ("freq", "H", "form"), "measurement")
    nameless = [side for side in ("outputs", "inputs") if side not in arrays]
    if nameless:
        raise ValueError(
            f"no {' and no '.join(nameless)} in it; a measurement file needs the names of both outputs and inputs, or "
            f"none (here: {', '.join(sorted(arrays))})"
        )
    if np.asarray(arrays["H"]).dtype.kind != "c":
        raise ValueError(f"H has type {np.asarray(arrays['H']).dtype}; FRFs are complex, a magnitude is not enough")
    freq, H = _numbers(arrays, "freq").squeeze(), _numbers(arrays, "H", complex_=True)
    freq = np.atleast_1d(freq)
    outputs, inputs = _words(arrays, "outputs"), _words(arrays, "inputs")
    plain = H.shape == (len(freq), len(outputs), len(inputs))  # one run, of which freq and the names tell every axis
    axes = " ".join(_words(arrays, "axes") if "axes" in arrays else ["f o i" if plain else "run f o i"]).split()
    if axes not in (["run", "f", "o", "i"], ["f", "o", "i"]):
        raise ValueError(f"axes says {' '.join(axes)!r}; it must be 'run f o i' or 'f o i'")
    single = axes == ["f", "o", "i"]
    _check_axes(H, axes, {"f": len(freq), "o": len(outputs), "i": len(inputs)})
    optional: dict[str, Any] = {}
    for name in ("variance", "coherence"):
        if name in arrays:
            value = _numbers(arrays, name)
            if value.shape != H.shape:
                raise ValueError(f"{name} has shape {value.shape} and H {H.shape}; they must be the same")
            optional[name] = value[None] if single else value
    if "averages" in arrays:
        optional["averages"] = _whole(arrays, "averages")
    if "added_decay" in arrays:
        optional["added_decay"] = _number(arrays, "added_decay")
    if "force" in arrays:
        optional["force"] = np.atleast_2d(_numbers(arrays, "force"))
    level = np.atleast_1d(_numbers(arrays, "level").squeeze()) if "level" in arrays else None
    H = H[None] if single else H
    freq, H, outputs, inputs, optional = mended(freq, H, outputs, inputs, optional, stacklevel=5)
    return Measurement(freq, H, form=_word(arrays, "form"), level=level, outputs=outputs, inputs=inputs, **optional)


def _whole(arrays: Arrays, name: str) -> int:
    value = _number(arrays, name)
    if value != int(value):
        raise ValueError(f"{name} is {value:g}; it needs one whole number")
    return int(value)


def _check_axes(H: np.ndarray, axes: list[str], lengths: dict[str, int]) -> None:
    """Compare the axes of H with the lengths of freq, outputs and inputs, and name the one that is wrong."""
    wanted = f"({', '.join(axes)}) = ({', '.join(str(lengths.get(a, 'run')) for a in axes)})"
    if H.ndim != len(axes):
        advice = "; for one run save H[None], or add axes = 'f o i'" if (H.ndim, len(axes)) == (3, 4) else ""
        raise ValueError(f"H has {H.ndim} axes, shape {H.shape}; it needs {wanted}{advice}")
    wrong = [k for k, a in enumerate(axes) if a in lengths and H.shape[k] != lengths[a]]
    if not wrong:
        return
    k = wrong[0]
    what = {"f": "frequency lines", "o": "outputs", "i": "inputs"}[axes[k]]
    elsewhere = [j for j in range(H.ndim) if H.shape[j] == lengths[axes[k]]]
    hint = f"; axis {elsewhere[0]} has that length: are the axes in another order?" if elsewhere else ""
    raise ValueError(
        f"H has shape {H.shape}: its axis {k} holds {H.shape[k]} for {lengths[axes[k]]} {what}; it needs {wanted}{hint}"
    )


def _structure(arrays: Arrays) -> Structure:
    _need(arrays, ("M", "C", "K"), "structure")
    if "dofs" not in arrays:
        warnings.warn(
            "its DoFs have no names and are called 1, 2, ...; the array dofs names them", UserWarning, stacklevel=4
        )
    for name in ("M", "C", "K"):
        if np.asarray(arrays[name]).dtype == np.float32:
            warnings.warn(
                f"{name} is stored in single precision; natural frequencies, differences of large numbers, suffer",
                UserWarning,
                stacklevel=4,
            )
    M, C, K = (np.atleast_2d(_numbers(arrays, name)) for name in ("M", "C", "K"))
    D = np.atleast_2d(_numbers(arrays, "D")) if "D" in arrays else None
    claims = _claims(arrays, ("frequency_std", "damping_std")) | _claims(arrays, CLAIMS)
    dofs = _words(arrays, "dofs") if "dofs" in arrays else None
    parts = {"pairs": _pairs(arrays, "pairs"), "elements": _elements(arrays), "groups": _groups(arrays)}
    return Structure(M, C, K, dofs, D=D, **parts, **claims)


def _elements(arrays: Arrays) -> Elements | None:
    """Elements of stiffness and mass; None where there are none in the file."""
    if not any(name in arrays for name in ELEMENTS):
        return None
    _need(arrays, ELEMENTS, "set of elements")
    places = _pairs(arrays, ELEMENTS[2])
    stiffness, mass = (_numbers(arrays, name) for name in ELEMENTS[:2])
    return Elements(stiffness, mass, places or (), _words(arrays, OF_ELEMENTS) if OF_ELEMENTS in arrays else ())


def _groups(arrays: Arrays) -> Groups | None:
    """Groups of elements that share a parameter; None where there are none in the file."""
    if not any(name in arrays for name in GROUPS):
        return None
    _need(arrays, GROUPS[:1], "structure with groups of elements")
    own = {key: _numbers(arrays, name) for key, name in zip(("stiffness", "mass"), GROUPS[1:], strict=True)
           if name in arrays}  # fmt: skip
    return Groups(_words(arrays, GROUPS[0]), **own)


def _pairs(arrays: Arrays, key: str) -> list[tuple[str, str]] | None:
    """Pairs of DoF names, shape ``(p, 2)``; None where there are none in the file."""
    if key not in arrays:
        return None
    shape, names = np.shape(arrays[key]), _words(arrays, key)
    if len(shape) != 2 or shape[1] != 2:
        raise ValueError(f"{key} has shape {shape}; it needs (p, 2), two DoF names for each pair")
    return list(zip(names[::2], names[1::2], strict=True))


def _claims(arrays: Arrays, names: tuple[str, ...]) -> dict[str, np.ndarray]:
    claims = {}
    for name in names:
        if name in arrays:
            value = _numbers(arrays, name).squeeze()
            if not (np.isfinite(value) & (value >= 0)).all():
                raise ValueError(f"{name} is {value.tolist()}; a relative standard deviation is 0 or positive")
            claims[name] = value
    return claims


def _model(arrays: Arrays) -> ModalModel:
    if "poles" in arrays or "frequency_hz" not in arrays:
        _need(arrays, ("poles", "shapes", "outputs"), "modal model")
        poles = np.atleast_1d(_numbers(arrays, "poles", complex_=True).squeeze())
    else:
        _need(arrays, ("frequency_hz", "damping_ratio", "shapes", "outputs"), "modal model")
        poles = np.asarray(
            poles_from(*(np.atleast_1d(_numbers(arrays, k).squeeze()) for k in ("frequency_hz", "damping_ratio")))
        )
    shapes = np.atleast_2d(_numbers(arrays, "shapes", complex_=True))
    outputs = _words(arrays, "outputs")
    if shapes.shape != (len(poles), len(outputs)):
        raise ValueError(
            f"shapes has shape {shapes.shape}; {len(poles)} poles and {len(outputs)} outputs need "
            f"({len(poles)}, {len(outputs)})"
        )
    inputs, participation = _participation(arrays, poles, shapes, outputs)
    terms = {k: _numbers(arrays, k, complex_=True) for k in ("upper", "lower") if k in arrays}
    claims = _claims(arrays, ("frequency_std", "damping_std"))
    return ModalModel(poles, shapes, participation, outputs=outputs, inputs=inputs, **terms, **claims)


def _participation(
    arrays: Arrays, poles: np.ndarray, shapes: np.ndarray, outputs: list[str]
) -> tuple[list[str], np.ndarray]:
    """Inputs and their participation, given as such or through modal a or modal mass and reciprocity."""
    scaled = "modal_a" in arrays or "modal_mass" in arrays
    if "participation" in arrays:
        _need(arrays, ("participation", "inputs"), "modal model")
        inputs, given = _words(arrays, "inputs"), np.atleast_2d(_numbers(arrays, "participation", complex_=True))
        both = [(outputs.index(name), k) for k, name in enumerate(inputs) if name in outputs]
        if not scaled or not both or given.shape != (len(poles), len(inputs)):
            return inputs, given
        at, column = (list(x) for x in zip(*both, strict=True))
        expected = shapes[:, at] / _modal_a(arrays, poles)[:, None]
        differs = _differ(given[:, column], expected, ALIKE)
        if not differs.any():
            return inputs, given
        if len(both) == len(inputs) and not _differ(given, shapes[:, at], SAME).any():
            return inputs, expected  # the shape itself stands for it, and the modal mass tells its scale
        k = int(np.argmax(differs))
        scale = "modal_a" if "modal_a" in arrays else "modal_mass"
        raise ValueError(
            f"participation and {scale} contradict each other: mode {k + 1} "
            f"has a participation of {given[k, column[0]]:.3g} at {inputs[column[0]]}, and {expected[k, 0]:.3g} by its "
            "shape and scale; leave out the wrong one"
        )
    if not scaled:
        raise ValueError("no participation in it; a modal model file needs participation, modal_a or modal_mass")
    a = _modal_a(arrays, poles)
    inputs = _words(arrays, "inputs") if "inputs" in arrays else outputs
    unknown = [name for name in inputs if name not in outputs]
    if unknown:
        raise ValueError(f"inputs {', '.join(unknown)} have no shape component: they are not among the outputs")
    return inputs, shapes[:, [outputs.index(name) for name in inputs]] / a[:, None]


def _modal_a(arrays: Arrays, poles: np.ndarray) -> np.ndarray:
    """Modal a of each mode, given as such or through the modal mass."""
    if "modal_a" in arrays:
        a = _numbers(arrays, "modal_a", complex_=True).reshape(-1)
    else:
        mass = _numbers(arrays, "modal_mass", complex_=True).reshape(-1)
        a = 2j * np.imag(poles) * mass if len(mass) == len(poles) else mass
    if len(a) != len(poles) or (a == 0).any():
        raise ValueError(f"{len(a)} modal scalings, {int((a == 0).sum())} of them zero, for {len(poles)} poles")
    return a


def _differ(given: np.ndarray, expected: np.ndarray, share: float) -> np.ndarray:
    """Modes whose participations are not as expected, within a share of the largest."""
    size = np.abs(expected).max(axis=1, initial=1e-300)
    return np.abs(given - expected).max(axis=1, initial=0.0) > share * size
