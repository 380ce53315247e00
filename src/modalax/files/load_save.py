"""``load`` and ``save``: one call for every kind of file."""

import os
import warnings
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np

from modalax._numerics.checks import require_double
from modalax.data.causality import looks_conjugated
from modalax.data.measurement import Measurement
from modalax.files.arrays import Saved, from_arrays
from modalax.files.messages import about
from modalax.files.npz import read_npz, write_npz
from modalax.files.plain import Told, check_told_form
from modalax.files.sniff import kind_to_write, sniff
from modalax.files.table import names_of_columns, read_table
from modalax.files.units import plain
from modalax.files.write import replacing

TOLD_OF_UFF = {"form", "frequency_unit"}  # what a universal file may not tell itself, or tell wrongly
SMALLEST, LARGEST = 1e-60, 1e30  # m/N, (m/s)/N or (m/s^2)/N; a grain of dust moves by 1e12 (m/s^2)/N


def load(
    path: str | os.PathLike[str],
    *,
    conjugate: bool | str = "detect",
    form: str | None = None,
    unit: str | None = None,
    frequency_unit: str | None = None,
    outputs: Sequence[str] | None = None,
    inputs: Sequence[str] | None = None,
    axes: str | None = None,
    **options: Any,
) -> Saved:
    """Read a measurement, a structure, a modal model or an extended simulation from a file of any kind.

    What the file is, is told from its content: NumPy ``.npz``, UFF (58 ASCII and binary, 55, 2414), MATLAB ``.mat``,
    NetCDF, Zarr, or matrices and modes of a finite-element program (Nastran, Abaqus, Ansys, Matrix Market; what was
    found and assumed is told in warnings). Files of the published measurements in :mod:`modalax.data.datasets` are
    recognised, with a warning that says so.

    Parameters
    ----------
    path
        The file, or the folder of a Zarr store.
    conjugate
        ``"detect"``: FRFs that look conjugated (:func:`modalax.data.looks_conjugated`) are turned back, with a
        warning that says so. True: they are conjugated. False: they are taken as they are.
    form, unit, frequency_unit, outputs, inputs, axes
        What a file of FRFs does not say itself (:class:`modalax.files.plain.Told`), as plain ``.npz`` and ``.mat``
        files of frequencies and FRFs, and CSV: the form or the unit (``g/N``), names of the channels, the order of the
        axes (``f o i``). What is guessed is said in a warning; what may mean two things is asked for. A form that
        differs from the one in the file is an error, except of a universal file, where ``form`` and
        ``frequency_unit`` count more.
    **options
        Choices for UFF files, passed to :func:`modalax.files.uff.read_uff`: ``complete``; for an extended
        simulation ``causes``, those of one's own that it holds; for finite elements those of
        :func:`modalax.files.finite_elements.import_finite_elements`: ``mass``, ``grids``, ``units``, ...

    Raises
    ------
    FileNotFoundError
        If there is no such file.
    ValueError
        If the file cannot be used; the message, of one line, names the file, what was seen and what would be right.
    """
    path = as_path(path)
    require_double("load")
    with about(path):
        kind = sniff(path)
        if kind == "modes":
            raise ValueError("holds a table of modes without scale; modalax.files.load_mode_table reads it")
        what = _read(path, kind, Told(form, unit, frequency_unit, outputs, inputs, axes), options)
        if isinstance(what, Measurement):
            _check_magnitude(what)
            what = _in_convention(what, conjugate)
    return what


def as_path(path: Any) -> Path:
    """Return ``path`` as a path; ``ValueError`` if it is none."""
    if not isinstance(path, str | os.PathLike) or "\0" in str(path):
        named = repr(path) if isinstance(path, str) else f"a value of type {type(path).__name__}"
        raise ValueError(f"a file is named by text or a path, not by {named}")
    return Path(path)


def _check_options(kind: str, told: Told, options: dict[str, Any]) -> None:
    """Refuse what may be told, or chosen, of files of other kinds only."""
    words = set(told.words) - (TOLD_OF_UFF if kind == "uff" else set())
    if kind in ("uff", "fe") and words:
        raise ValueError(
            f"option {', '.join(sorted(words))} is for files that do not say it themselves, this one is {kind}"
        )
    if kind == "uff" and set(options) - {"complete"}:
        raise ValueError(f"option {', '.join(options)} is for other kinds of files, this one is {kind}")
    if kind != "uff" and "complete" in options:
        raise ValueError(f"option complete is for UFF files, this one is {kind}")
    if kind not in ("uff", "npz", "fe") and options:
        raise ValueError(f"option {', '.join(options)} is for .npz files, this one is {kind}")


def _read(path: Path, kind: str, told: Told, options: dict[str, Any]) -> Saved:
    _check_options(kind, told, options)
    if kind == "uff":
        from modalax.files.uff import read_uff

        return read_uff(path, form=told.form, frequency_unit=told.frequency_unit, **options)
    if kind == "npz":
        return _published(path, told) or read_npz(path, told, **options)
    if kind == "fe":
        from modalax.files.finite_elements import import_finite_elements

        found = import_finite_elements(path, **options)
        for sentence in found.notes:
            warnings.warn(sentence, UserWarning, stacklevel=2)
        return found.simulation
    if kind in ("mat", "mat73"):
        from modalax.files.mat import read_mat

        return read_mat(path, told)
    if kind == "table":
        arrays = names_of_columns(read_table(path), told.outputs, told.inputs)
        return from_arrays(arrays, _with_unit(told, arrays.pop("unit", None)))
    from modalax.files.labelled import read_labelled

    return read_labelled(path, kind, told)


def _with_unit(told: Told, unit: str | None) -> Told:
    """What the user tells of a table, with the unit that its titles name.

    Raises
    ------
    ValueError
        If the user gave another unit.
    """
    if unit is not None and told.unit is not None and plain(told.unit) != plain(unit):
        raise ValueError(f"its titles say {unit} and unit says {told.unit}; one is wrong")
    return told if unit is None else replace(told, unit=unit)


def _published(path: Path, told: Told) -> Measurement | None:
    """A published measurement that is known here, whose file holds neither names nor units.

    Raises
    ------
    ValueError
        If the user told another form.
    """
    from modalax.data.datasets import known_measurement

    known = known_measurement(path)
    if known is None:
        return None
    check_told_form(known.form, told.form)
    warnings.warn(
        f"the published measurement {path.absolute().parent.name}, which modalax.data.datasets knows: names, signs and "
        "units are from there",
        UserWarning,
        stacklevel=2,
    )
    return known if isinstance(known, Measurement) else Measurement.from_frfs([known])


def _check_magnitude(measurement: Measurement) -> None:
    """Refuse values that no structure has, as bytes in the wrong order make them."""
    size = np.abs(np.asarray(measurement.H))
    if size.size and size.max() > LARGEST:
        raise ValueError(
            f"H reaches {size.max():.3g} (median {np.median(size):.3g}); no structure has such FRFs: is the byte order "
            "or the kind of number wrong in the file's header?"
        )
    if size.size and 0 < size.max() < SMALLEST:
        raise ValueError(f"H is {size.max():.3g} at most; no structure has such FRFs: is the unit or a scale wrong?")


def _in_convention(measurement: Measurement, conjugate: bool | str) -> Measurement:
    if conjugate not in (True, False, "detect"):
        raise ValueError(f"conjugate is {conjugate!r}; it must be True, False or 'detect'")
    if conjugate == "detect":
        conjugate = looks_conjugated(measurement)
        if conjugate:
            warnings.warn(
                "the FRFs look conjugated (their phase rises through the resonances, time convention e^-jwt) and "
                "were conjugated back; load(..., conjugate=True) does so without this warning, conjugate=False "
                "keeps them as they are",
                UserWarning,
                stacklevel=2,
            )
    return measurement.replace(H=jnp.conj(measurement.H)) if conjugate else measurement


def save(
    what: Any,
    path: str | os.PathLike[str],
    overwrite: bool = False,
    **options: Any,
) -> None:
    """Write a measurement, a structure, a modal model or an extended simulation; the ending of ``path`` says the kind.

    ``.npz``, ``.uff`` (also ``.unv``, ``.uf``), ``.mat``, ``.nc`` (NetCDF) or ``.zarr``. Nothing is left half
    written: the old file stands until the new one is whole and on the disk.

    Parameters
    ----------
    what
        A :class:`Measurement`, :class:`FRF` (written as one run), :class:`Structure` or :class:`ModalModel`;
        structures go to ``.npz`` and ``.mat`` only, an extended simulation to ``.npz``.
    path
        The file.
    overwrite
        Whether a file or Zarr store of that name may be replaced; another folder never is, and of a symbolic link the
        file it points to.
    **options
        Choices for UFF files, passed to :func:`modalax.files.uff.write_uff`: ``binary``, ``geometry``.

    Raises
    ------
    ValueError
        If the file exists and ``overwrite`` is False, a folder that is not a Zarr store has its name, or its kind
        cannot hold ``what``.
    FileNotFoundError
        If the folder does not exist.
    OSError
        If the disk is full or the folder read-only; what stood there is then unchanged.
    """
    if isinstance(what, str | os.PathLike) and not isinstance(path, str | os.PathLike):
        raise ValueError(f"save(what, path) takes the {type(path).__name__} first and the path after it")
    path = as_path(path)
    with about(path):
        kind = kind_to_write(path)
        if options and kind != "uff":
            raise ValueError(f"option {', '.join(options)} is for UFF files, this one is {kind}")
        with replacing(path, overwrite, store=kind == "zarr") as part:
            _write(what, part, kind, options)


def _write(what: Any, path: Path, kind: str, options: dict[str, Any]) -> None:
    if kind == "npz":
        write_npz(what, path)
    elif hasattr(what, "arrays"):
        raise ValueError(f"a {type(what).__name__} goes to .npz only, not to {path.suffix}")
    elif kind == "uff":
        from modalax.files.uff import write_uff

        write_uff(what, path, **options)
    elif kind == "mat":
        from modalax.files.mat import write_mat

        write_mat(what, path)
    else:
        from modalax.files.labelled import write_labelled

        write_labelled(what, path, kind)
