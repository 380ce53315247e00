"""Kinds of files that are read: how a sound one is written, how it is read, and whether what was read is sound."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import jax
import numpy as np
import sound_files as sf
from sound_files import FS, Arrays, pack_hdf5, pack_mat, pack_mat73, pack_netcdf3, pack_npy, pack_npz, saved

import modalax
from modalax.data import Geometry, Measurement
from modalax.data.recording import Recording
from modalax.files import load_geometry, load_mode_table, load_modes, load_records
from modalax.files.arrays import to_arrays
from modalax.files.uff_nodes import Modes
from modalax.model import ModalModel, Structure
from modalax.model.examples import five_dof
from modalax.model.mode_table import ModeTable
from modalax.simulate.joints.text import read_joints


@dataclass(frozen=True)
class Kind:
    """One kind of file.

    Attributes
    ----------
    ending
        Of its name.
    write
        Writes a sound file, and what it needs beside it.
    read
        Reads a file; the second path is that of the sound one, beside which others stand.
    text
        Whether words of it are replaced by extreme ones.
    arrays, pack
        What such a file holds by name, and how it is written, for files of sound form and wrong content.
    """

    ending: str
    write: Callable[[Path], None]
    read: Callable[[Path, Path], Any] = lambda path, sound: modalax.load(path)
    text: bool = False
    arrays: Callable[[], Arrays] | None = None
    pack: Callable[[Path, Arrays], None] | None = None


def beside(**names: str) -> Callable[[Path, Path], Any]:
    """Reads with the sound files that stand beside the sound one, by their endings."""
    return lambda path, sound: modalax.load(path, **{k: sound.with_suffix(end) for k, end in names.items()})


def deck_of(ending: str) -> Callable[[Path, Path], Any]:
    """Reads a deck with the sound matrices that stand beside the sound one."""
    return lambda path, sound: modalax.load(sound.with_suffix(ending), grids=path)


def records(**options: Any) -> Callable[[Path, Path], Any]:
    """Reads time records."""
    return lambda path, sound: load_records(path, **options)


def told(**options: str) -> Callable[[Path, Path], Any]:
    """Reads FRFs of which the form is told, and more."""
    return lambda path, sound: modalax.load(path, form="receptance", **options)


def of(what: Callable[[], Any]) -> Callable[[], Arrays]:
    """Arrays that the file contract has of an object."""
    return lambda: to_arrays(what())


def packed(arrays: Callable[[], Arrays], pack: Callable[[Path, Arrays], None], ending: str, **more: Any) -> Kind:
    """A file of named arrays, written as others write it."""
    return Kind(ending, lambda path: pack(path, arrays()), arrays=arrays, pack=pack, **more)


MEASURED, STRUCTURE, MODES = of(sf.measurement), of(five_dof), of(sf.model)
EXTENDED: Callable[[], Arrays] = lambda: sf.extended().arrays()
PLAIN, RECORDS = {"read": told(axes="f o")}, {"read": records()}
GEOMETRY: Callable[[Path, Path], Any] = lambda path, sound: load_geometry(path)
KINDS: dict[str, Kind] = {
    "npz": Kind("npz", saved(sf.measurement), arrays=MEASURED, pack=pack_npz),
    "npz_structure": Kind("npz", saved(five_dof), arrays=STRUCTURE, pack=pack_npz),
    "npz_modes": Kind("npz", saved(sf.model), arrays=MODES, pack=pack_npz),
    "npz_extended": Kind("npz", saved(sf.extended), arrays=EXTENDED, pack=pack_npz),
    "npz_plain": packed(sf.plain_arrays, pack_npz, "npz", **PLAIN),
    "uff_text": Kind("uff", saved(sf.measurement, binary=False), text=True),
    "uff_binary": Kind("uff", saved(sf.measurement), text=True),
    "uff_modes": Kind("uff", saved(sf.model), text=True),
    "uff_shapes": Kind("uff", saved(sf.model), lambda path, sound: load_modes(path), text=True),
    "uff_nodes": Kind("uff", saved(sf.measurement, geometry=sf.geometry()), GEOMETRY, text=True),
    "mat": Kind("mat", saved(sf.measurement), arrays=MEASURED, pack=pack_mat),
    "mat_plain": packed(sf.plain_arrays, pack_mat, "mat", **PLAIN),
    "mat73": packed(MEASURED, pack_mat73, "mat"),
    "nc": Kind("nc", saved(sf.measurement)),
    "nc3": packed(sf.netcdf3_arrays, pack_netcdf3, "nc"),
    "zarr": Kind("zarr", saved(sf.measurement)),
    "csv": Kind("csv", sf.write_table, told(), text=True),
    "csv_modes": Kind("csv", sf.write_modes_table, lambda path, sound: load_mode_table(path), text=True),
    "nastran_matrices": Kind("pch", sf.write_punch, text=True),
    "nastran_deck": Kind("bdf", sf.write_deck_beside, deck_of(".pch"), text=True),
    "nastran_modes": Kind("pch", sf.write_eigenvectors, text=True),
    "abaqus": Kind("mtx", sf.write_abaqus, beside(mass=".mass.mtx"), text=True),
    "market": Kind("mtx", sf.write_market, beside(mass=".mass.mtx"), text=True),
    "boeing": Kind("hb", sf.write_boeing, beside(mass=".mass.hb"), text=True),
    "points": Kind("csv", sf.write_points, GEOMETRY, text=True),
    "stl_text": Kind("stl", sf.write_triangles(False), GEOMETRY, text=True),
    "stl_binary": Kind("stl", sf.write_triangles(True), GEOMETRY),
    "joints": Kind("toml", sf.write_joints, lambda path, sound: read_joints(str(path)), text=True),
    "records_uff_text": Kind("uff", sf.write_time_records(False), records(), text=True),
    "records_uff_binary": Kind("uff", sf.write_time_records(True), records(), text=True),
    "records_mat": packed(sf.record_arrays, pack_mat, "mat", **RECORDS),
    "records_mat73": packed(sf.record_arrays, pack_mat73, "mat", **RECORDS),
    "records_hdf5": packed(sf.record_arrays, pack_hdf5, "h5", **RECORDS),
    "records_npz": packed(sf.record_arrays, pack_npz, "npz", **RECORDS),
    "records_npy": packed(sf.record_arrays, pack_npy, "npy", read=records(fs=FS)),
    "records_csv": Kind("csv", sf.write_records_table, records(), text=True),
    "records_wav": Kind("wav", sf.write_wave, records()),
}


def unsound(found: Any) -> str:
    """What is wrong with an object that was read; nothing if it is sound."""
    if isinstance(found, Measurement):
        return _unsound_measurement(found)
    if isinstance(found, Recording):
        checks = {
            "data": np.isfinite(found.data).all() and found.data.size > 0,
            "fs": np.isfinite(found.fs) and found.fs > 0,
            "names": len(found.channels) == found.data.shape[2],
        }
        return ", ".join(name for name, good in checks.items() if not good)
    if isinstance(found, list):  # joints
        return (
            "" if all(np.isfinite(np.asarray(v)).all() for law, _ in found for v in jax.tree.leaves(law)) else "joint"
        )
    finite = {
        Structure: ("M", "C", "K", "D"), ModalModel: ("poles", "shapes", "participation", "upper", "lower"),
        Geometry: ("xyz",), ModeTable: ("frequency_hz", "shapes"), Modes: ("poles", "shapes", "modal_a"),
    }.get(type(found), ("theta",))  # fmt: skip
    wrong = [n for n in finite if not np.isfinite(np.asarray(getattr(found, n))).all()]
    wrong += [n for n in finite[:1] if np.asarray(getattr(found, n)).size == 0]
    if hasattr(found, "base"):
        wrong += [unsound(found.base)] + ["params"] * (not all(np.isfinite(p).all() for p in found.params))
    return ", ".join(w for w in wrong if w)


def _unsound_measurement(found: Measurement) -> str:
    freq, H = np.asarray(found.freq), np.asarray(found.H)
    level, coherence = np.asarray(found.level), found.coherence
    checks = {
        "freq": np.isfinite(freq).all() and (np.diff(freq) > 0).all() and freq[0] >= 0,
        "H": np.isfinite(H).all() and np.abs(H).max() <= 1e30 and H.size > 0,
        "shape": H.shape == (len(level), len(freq), len(found.outputs), len(found.inputs)),
        "names": len(set(found.outputs)) == len(found.outputs) and all(n.strip() for n in found.outputs),
        "form": found.form in ("receptance", "mobility", "accelerance"),
        "level": (np.isnan(level) | ((level > 0) & np.isfinite(level))).all(),
        "decay": 0 <= float(found.added_decay) < np.inf,
        "variance": found.variance is None or bool((np.asarray(found.variance) >= 0).all()),
        "coherence": coherence is None or bool((np.abs(np.asarray(coherence) - 0.5) <= 0.51).all()),
        "averages": found.averages is None or found.averages >= 1,
    }
    return ", ".join(name for name, good in checks.items() if not good)
