"""Measurements as labelled arrays of xarray, which also reads and writes NetCDF and Zarr."""

import io
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from modalax.data.frf import FRF
from modalax.data.measurement import Measurement
from modalax.data.overview import UNITS
from modalax.files.arrays import NOTHING, Saved, from_arrays, to_arrays
from modalax.files.guard import reading
from modalax.files.inside import check_datasets, check_store
from modalax.files.plain import PLAIN_KEYS, Told, check_told_form, plain_dataset
from modalax.files.units import force_factor, frequency_factor, plain, response_unit

DIMS = ("run", "freq", "output", "input")
SAMPLES = ("H", "variance", "coherence")
NAMES = {"o", "out", "outputs", "response", "i", "in", "inputs", "reference", "part", "complex", "reim"}
READ = {*SAMPLES, *DIMS, *PLAIN_KEYS, *NAMES, "H_real", "H_imag", "level", "force"}


def _xarray() -> Any:
    try:
        import xarray
    except ImportError as error:
        raise ValueError("labelled arrays need xarray: pip install 'modalax[files]'") from error
    return xarray


def to_xarray(measurement: Any) -> Any:
    """The measurement as an ``xarray.Dataset``: ``H``, ``variance``, ``coherence`` over (run, freq, output, input).

    Coordinates are ``freq`` [Hz], ``level`` [N] over the runs and the DoF names; attributes are ``form`` and, where
    known, ``averages`` and ``added_decay``. A force that differs from line to line is ``force`` over (run, freq).

    Parameters
    ----------
    measurement
        A :class:`Measurement`, or an :class:`FRF` as one run.

    Raises
    ------
    ValueError
        If the object is neither, or xarray is not there.
    """
    if not isinstance(measurement, Measurement | FRF):
        raise ValueError(f"a {type(measurement).__name__} has no labelled form; save it as .npz")
    arrays = to_arrays(measurement)
    form = str(arrays["form"])
    attributes: dict[str, Any] = {"form": form, "time_convention": "exp(+j omega t)"}
    attributes |= {name: arrays[name].item() for name in ("averages", "added_decay") if name in arrays}
    units = {"H": UNITS[form], "variance": f"({UNITS[form]})^2", "coherence": "1"}
    force = {"force": (DIMS[:2], arrays["force"], {"units": "N"})} if "force" in arrays else {}
    return _xarray().Dataset(
        {name: (DIMS, arrays[name], {"units": units[name]}) for name in SAMPLES if name in arrays} | force,
        coords={
            "freq": ("freq", arrays["freq"], {"units": "Hz"}),
            "level": ("run", arrays["level"], {"units": "N"}),
            "output": ("output", arrays["outputs"]),
            "input": ("input", arrays["inputs"]),
        },
        attrs=attributes,
    )


def from_xarray(dataset: Any, told: Told = NOTHING) -> Measurement:
    """The measurement of an ``xarray.Dataset`` as :func:`to_xarray` makes it; the order of the axes does not matter.

    Real and imaginary parts may stand apart, as ``H_re`` and ``H_im`` or along a dimension of ``re`` and ``im``.

    Raises
    ------
    ValueError
        If a variable, coordinate, axis or attribute is missing.
    """
    dataset = _as_told(plain_dataset(dataset), told)
    names = set(dataset.variables)
    missing = [name for name in ("H", "freq", "output", "input") if name not in names]
    if missing or "form" not in dataset.attrs:
        raise ValueError(
            f"no {', '.join(missing) or 'attribute form'} in the dataset, which holds "
            f"{', '.join(sorted(map(str, names)))}; needed are H (run, freq, output, input), freq, output, input "
            "and the attribute form"
        )
    absent = [d for d in DIMS[1:] if d not in dataset["H"].dims]
    if absent:
        raise ValueError(f"H has the axes {', '.join(map(str, dataset['H'].dims))}; it needs {', '.join(DIMS)}")
    if "run" not in dataset["H"].dims:
        dataset = dataset.expand_dims("run")
    _check_dims(dataset)
    arrays: dict[str, Any] = {
        name: dataset[name].transpose(*DIMS).to_numpy() for name in SAMPLES if name in dataset.variables
    }
    arrays |= {"freq": dataset["freq"].to_numpy(), "form": np.array(dataset.attrs["form"])}
    arrays |= {f"{axis}s": dataset[axis].to_numpy().astype(str) for axis in ("output", "input")}
    if "force" in dataset.variables:
        arrays["force"] = dataset["force"].transpose(*DIMS[:2]).to_numpy()
    if "level" in dataset.variables:
        arrays["level"] = dataset["level"].to_numpy()
    arrays |= {name: dataset.attrs[name] for name in ("averages", "added_decay") if name in dataset.attrs}
    measurement = from_arrays(_in_si(arrays, dataset))
    assert isinstance(measurement, Measurement)
    return measurement


def _as_told(dataset: Any, told: Told) -> Any:
    """The dataset with the form, units and names that the user gave; the form may follow from the unit of the FRFs."""
    if told.axes is not None:
        raise ValueError("option axes is for arrays without names of axes; this dataset names its own")
    for side in ("output", "input"):
        names = getattr(told, f"{side}s")
        if names is not None:
            dataset = dataset.assign_coords({side: (side, [str(n) for n in names])})
    if "H" in dataset and told.unit is not None:
        _check_unit(dataset["H"].attrs.get("units"), told.unit, "FRFs", "unit", response_unit)
        dataset = dataset.assign(H=dataset["H"].assign_attrs(units=told.unit))
    if "freq" in dataset.coords and told.frequency_unit is not None:
        _check_unit(
            dataset["freq"].attrs.get("units"), told.frequency_unit, "lines", "frequency_unit", frequency_factor
        )
        dataset = dataset.assign_coords(freq=dataset["freq"].assign_attrs(units=told.frequency_unit))
    form = told.form
    if form is None and "H" in dataset and (told.unit is not None or "form" not in dataset.attrs):
        unit = dataset["H"].attrs.get("units")
        form = None if unit is None else response_unit(unit)[0]
    told_by_unit = told.form is None and told.unit is not None
    check_told_form(dataset.attrs.get("form"), form, f"unit={told.unit!r} (--unit {told.unit})" if told_by_unit else "")
    return dataset if form is None else dataset.assign_attrs(form=form)


def _check_unit(stated: Any, told: str, what: str, option: str, read: Callable[[str], Any]) -> None:
    """Refuse a unit of another size than the one that the dataset states; one that is not known may be corrected."""
    try:
        known, wanted = read(str(stated)), read(told)
    except ValueError:
        return
    if known == wanted or option == "unit" and known[0] != wanted[0]:  # another form is told as that
        return
    flag = f"--{option.replace('_', '-')} {told}"
    raise ValueError(
        f"it states that its {what} are in {stated!r}, and {option}={told!r} ({flag}) says another; leave that out, or "
        "correct the unit in the file if it is wrong"
    )


def _check_dims(dataset: Any) -> None:
    """Refuse variables whose axes are not those of the format."""
    axes = {**dict.fromkeys(SAMPLES, DIMS), "force": DIMS[:2], "freq": DIMS[1:2], "level": DIMS[:1]}
    for name, wanted in axes.items():
        if name in dataset.variables and not set(dataset[name].dims) <= set(wanted):
            raise ValueError(
                f"{name} has the axes {', '.join(map(str, dataset[name].dims))}; needed: {', '.join(wanted)}"
            )


def _in_si(arrays: dict[str, Any], dataset: Any) -> dict[str, Any]:
    """The arrays in Hz, N and m, by the attributes ``units``; those without one are in SI already.

    Raises
    ------
    ValueError
        If a unit is not known, or that of the FRFs is one of another form.
    """
    unit = {name: dataset[name].attrs.get("units") for name in dataset.variables}
    form, told = str(dataset.attrs["form"]), unit.get("H") or unit.get("H_real")
    size = 1.0
    if told is not None:
        found, size = response_unit(told)
        if found != form:
            raise ValueError(f"H is in {told!r}, which is the unit of {found}, and form says {form!r}; one is wrong")
    factors = {"H": size, "variance": size**2}
    factors["freq"] = 1.0 if unit.get("freq") is None else frequency_factor(unit["freq"])
    for name in ("level", "force"):
        factors[name] = 1.0 if unit.get(name) is None else force_factor(unit[name])
    wrong = unit.get("variance")
    if wrong is not None and told is not None and plain(wrong) not in (plain(told) + "2", plain(f"({told})^2")):
        raise ValueError(f"variance is in {wrong!r}, and H in {told!r}; the variance is in the square of that")
    return {
        name: value if factors.get(name, 1.0) == 1.0 else np.asarray(value) * factors[name]
        for name, value in arrays.items()
    }


def read_labelled(path: Path, kind: str, told: Told = NOTHING) -> Saved:
    """Read a NetCDF file or a Zarr store.

    NetCDF has no complex numbers of its own; they stand as pairs of real ones, named ``<name>_real``, ``<name>_imag``.

    Raises
    ------
    ValueError
        If the file is damaged or holds no measurement.
    """
    xarray = _xarray()
    word = "Zarr store" if kind == "zarr" else "NetCDF file"
    with reading(f"the {word}"):
        others = _check(path, kind)
        how: dict[str, Any] = {"engine": "zarr", "consolidated": False} if kind == "zarr" else {}
        # Numbers stay numbers: units such as "days since" and packing by scale factors are of no use here.
        with xarray.open_dataset(path, **how, decode_times=False, drop_variables=others) as lazy:
            dataset = lazy.load()
    with reading(f"the {word}", said=ValueError):  # names that are no text show only where they are used
        return from_xarray(dataset, told)


def _check(path: Path, kind: str) -> list[str]:
    """Check the sizes that a file declares before it is read; returns the names of variables that are not needed."""
    if kind == "zarr":
        names = {p.name for p in path.iterdir() if p.is_dir()}
        check_store(path, READ & names)
        return sorted(names - READ)
    with path.open("rb") as file:
        if not file.read(8).startswith(b"\x89HDF"):
            return []  # NetCDF 3 keeps its numbers as they are: a file holds what it declares
    import h5py

    with h5py.File(path, "r") as file:
        check_datasets(file, READ & set(file), path)
        return sorted(set(file) - READ)


def write_labelled(what: Any, path: Path, kind: str) -> None:
    """Write a measurement as NetCDF or Zarr."""
    dataset = to_xarray(what)
    H = dataset["H"]
    parts = {"H_real": H.real.assign_attrs(H.attrs), "H_imag": H.imag.assign_attrs(H.attrs)}
    dataset = dataset.drop_vars("H").assign(parts)
    if kind == "zarr":
        # With empty chunks written too, a chunk that is missing is one that was lost.
        dataset.to_zarr(path, mode="w", consolidated=False, zarr_format=2, write_empty_chunks=True)
    else:
        path.write_bytes(_netcdf(dataset))


def _netcdf(dataset: Any) -> bytes:
    """Make a NetCDF file in memory, because the HDF5 library crashes when the disk is full."""
    try:
        import h5netcdf
        from xarray.backends import H5NetCDFStore
    except ImportError as error:
        raise ValueError(f"{error}: pip install 'modalax[files]'") from error
    content = io.BytesIO()
    with h5netcdf.File(content, "w") as file:
        dataset.dump_to_store(H5NetCDFStore(file))
    return content.getvalue()
