"""Sound files of every kind that is read, as others' programs write them."""

import warnings
import wave
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import scipy.io
import scipy.sparse

jax.config.update("jax_enable_x64", True)

import modalax  # noqa: E402
from modalax.data import Geometry, Measurement  # noqa: E402
from modalax.files.modes import save_modes  # noqa: E402
from modalax.model import ModalModel  # noqa: E402
from modalax.model.examples import five_dof  # noqa: E402

Arrays = dict[str, Any]
FS, SAMPLES = 512.0, 256


@cache
def measurement() -> Measurement:
    """A small sound measurement with everything in it."""
    freq = np.linspace(10.0, 30.0, 24)
    frf = five_dof().frf(freq, inputs=["1"], outputs=["1", "2"])
    H = np.asarray(frf.H)[None] * np.array([1.0, 0.9])[:, None, None, None]
    return Measurement(
        freq, H, variance=np.abs(H) ** 2 * 1e-4, coherence=np.full(H.shape, 0.99), level=[1.0, 2.0], averages=5,
        outputs=["1:+Z", "2:+Z"], inputs=["1:+Z"],
    )  # fmt: skip


@cache
def model() -> ModalModel:
    """Modes at named DoFs."""
    found = five_dof().modal()
    return found.replace(outputs=[f"{n}:+X" for n in found.outputs], inputs=[f"{n}:+X" for n in found.inputs])


@cache
def extended() -> Any:
    """An extended simulation: a mass that was missing at a place."""
    from modalax.diagnose.causes import saved_causes
    from modalax.diagnose.causes.scene import Place
    from modalax.diagnose.extend import ExtendedSimulation

    cause = next(c for c in saved_causes() if c.slug == "added_mass")
    return ExtendedSimulation(
        five_dof(), (jnp.array([0.1]),), (jnp.array([0.01]),), jnp.zeros((2, 5)), (None,), (cause,),
        (Place(("2",), (1, -1, -1)),), ("1", "2"), ("1",), 10.0,
    )  # fmt: skip


def plain_arrays() -> Arrays:
    """Frequencies and FRFs under names that laboratories use, and nothing else."""
    return {"f": np.asarray(measurement().freq), "FRF": np.asarray(measurement().H)[0, :, :, 0]}


def record_arrays() -> Arrays:
    """Time records under names: rate, force, two responses."""
    noise = np.random.default_rng(3).normal(size=(3, SAMPLES))
    return {"Fs": np.array(FS), "force": noise[0], "acc": noise[1:].T}


def geometry() -> Geometry:
    """Four nodes and the lines between them."""
    return Geometry(["1", "2", "3", "4"], np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0.5]]), [("1", "2", "3")])


def saved(what: Callable[[], Any], **options: Any) -> Callable[[Path], None]:
    """Writes with this package."""

    def write(path: Path) -> None:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            modalax.save(what(), path, **options)

    return write


def pack_npz(path: Path, arrays: Arrays) -> None:
    """As NumPy writes archives, packed where there is much."""
    (np.savez_compressed if sum(v.size for v in arrays.values()) % 2 else np.savez)(path, **arrays)


def pack_npy(path: Path, arrays: Arrays) -> None:
    """One of the arrays."""
    np.save(path, next((v for k, v in arrays.items() if k == "acc"), np.zeros(0)))


def pack_mat(path: Path, arrays: Arrays) -> None:
    """As scipy writes MATLAB's files."""
    whole = {k: np.ascontiguousarray(v).reshape(v.shape) for k, v in arrays.items() if v.dtype.kind not in "M"}
    scipy.io.savemat(path, whole, do_compression=True)


def pack_mat73(path: Path, arrays: Arrays) -> None:
    """As MATLAB writes since version 7.3: 512 bytes of its own, then HDF5 with the axes reversed."""
    import h5py

    with h5py.File(path, "w", userblock_size=512) as file:
        for name, value in arrays.items():
            value = np.asarray(value)
            if value.dtype.kind == "c":
                pair = np.zeros(value.shape[::-1], dtype=[("real", "f8"), ("imag", "f8")])
                pair["real"], pair["imag"] = value.T.real, value.T.imag
                file[name] = pair
            elif value.dtype.kind == "U" and value.ndim:
                refs = []
                for k, word in enumerate(value.ravel()):
                    file[f"#refs#/{name}{k}"] = np.array([[ord(c)] for c in word], dtype=np.uint16)
                    refs.append(file[f"#refs#/{name}{k}"].ref)
                file.create_dataset(name, data=np.array([refs], dtype=object), dtype=h5py.ref_dtype)
                file[name].attrs["MATLAB_class"] = np.bytes_("cell")
            elif value.dtype.kind == "U":
                file[name] = np.array([[ord(c)] for c in str(value)], dtype=np.uint16)
                file[name].attrs["MATLAB_class"] = np.bytes_("char")
            elif value.dtype.kind in "fiu":
                packed = {"compression": "gzip", "shuffle": True} if value.ndim and value.size else {}
                file.create_dataset(name, data=value.T, **packed)
    content = bytearray(path.read_bytes())
    content[:19] = b"MATLAB 7.3 MAT-file"
    path.write_bytes(bytes(content))


def pack_hdf5(path: Path, arrays: Arrays) -> None:
    """Records in HDF5, with the rate as an attribute and units at the arrays."""
    import h5py

    with h5py.File(path, "w") as file:
        for name, value in arrays.items():
            if value.dtype.kind in "fiu" and value.ndim:
                file.create_dataset(f"run/{name}", data=value, compression="gzip" if value.size else None)
                file[f"run/{name}"].attrs["unit"] = "N" if name == "force" else "m/s^2"
            elif value.dtype.kind in "fiu":
                file.attrs[name] = value


def pack_netcdf3(path: Path, arrays: Arrays) -> None:
    """The classic form of NetCDF, by scipy."""
    axes = {2: ("freq", "output"), 3: ("freq", "output", "input"), 1: ("freq",)}
    with scipy.io.netcdf_file(path, "w") as file:
        file.form = "receptance"
        for name, size in (("freq", 24), ("output", 2), ("input", 1), ("letters", 4)):
            file.createDimension(name, size)
        for name, value in arrays.items():
            shape = axes.get(value.ndim, ())
            fits = shape and value.shape == tuple(file.dimensions[a] for a in shape) and value.dtype.kind in "fi"
            if fits:
                file.createVariable(name, "d", shape)[...] = value
        for name, words in (("output", (b"1:+Z", b"2:+Z")), ("input", (b"1:+Z",))):
            file.createVariable(name, "c", (name, "letters"))[:] = np.array([list(w.decode()) for w in words], "S1")


def netcdf3_arrays() -> Arrays:
    """What a classic NetCDF file holds."""
    H = np.asarray(measurement().H)[0]
    return {"freq": np.asarray(measurement().freq), "H_real": H.real, "H_imag": H.imag}


def write_table(path: Path) -> None:
    """A table of real and imaginary parts."""
    data = measurement()
    H = np.asarray(data.H)[0].reshape(len(data.freq), -1)
    names = [f"{o}/{i}" for o in data.outputs for i in data.inputs]
    rows = [["freq", *(f"{part} {name}" for name in names for part in ("re", "im"))]]
    for f, line in zip(np.asarray(data.freq), H, strict=True):
        rows.append([f"{v:.12g}" for v in (f, *(p for value in line for p in (value.real, value.imag)))])
    path.write_text("\n".join(",".join(row) for row in rows) + "\n", encoding="utf-8")


def write_modes_table(path: Path) -> None:
    """Modes as a fit writes them."""
    save_modes(model(), path, frequency_std_hz=np.full(5, 0.01), damping_std=np.full(5, 1e-4), overwrite=True)


def write_records_table(path: Path) -> None:
    """Time, force and two responses in columns."""
    found = record_arrays()
    rows = [f"{k / FS:.9g};{f:.6g};{a:.6g};{b:.6g}" for k, (f, (a, b)) in enumerate(zip(found["force"], found["acc"],
                                                                                        strict=True))]  # fmt: skip
    path.write_text("\n".join(["time [s];force [N];acc 1 [m/s^2];acc 2 [g]", *rows]) + "\n", encoding="utf-8")


def write_wave(path: Path) -> None:
    """Two channels of 16 bits."""
    with wave.open(str(path), "wb") as file:
        file.setnchannels(2)
        file.setsampwidth(2)
        file.setframerate(int(FS))
        file.writeframes((3000 * record_arrays()["acc"]).astype("<i2").tobytes())


def write_time_records(binary: bool) -> Callable[[Path], None]:
    """Data sets 58 of function type 1."""

    def write(path: Path) -> None:
        import pyuff

        values = record_arrays()
        for node, kind, unit, data in (
            (5, 13, "N", values["force"]), (1, 12, "g", values["acc"][:, 0]), (2, 12, "g", values["acc"][:, 1]),
        ):  # fmt: skip
            one = {
                "type": 58, "binary": int(binary), "id1": f"channel {node}", "func_type": 1, "rsp_node": node,
                "rsp_dir": 3, "ref_node": 0, "ref_dir": 0, "ord_data_type": 4, "num_pts": SAMPLES,
                "abscissa_spacing": 1, "abscissa_min": 0.0, "abscissa_inc": 1 / FS, "x": np.arange(SAMPLES) / FS,
                "data": data, "rsp_ent_name": "NONE", "ref_ent_name": "NONE", "load_case_id": 0,
                "abscissa_spec_data_type": 17, "ordinate_spec_data_type": kind, "ordinate_axis_units_lab": unit,
                "orddenom_spec_data_type": 0, "z_axis_spec_data_type": 0,
            }  # fmt: skip
            with warnings.catch_warnings():
                warnings.simplefilter("ignore", ResourceWarning)
                pyuff.UFF(str(path)).write_sets(one, mode="add")

    return write


def chain(n: int = 6) -> tuple[np.ndarray, np.ndarray]:
    """Mass and stiffness of a chain between two walls."""
    return np.eye(n) + 0.1 * np.diag(np.arange(n)), 2e4 * (2 * np.eye(n) - np.eye(n, k=1) - np.eye(n, k=-1))


def write_punch(path: Path) -> None:
    """Stiffness and mass as Nastran punches them, and beside it the deck of its grid points."""
    text = ""
    for name, A in zip(("MAAX", "KAAX"), chain(), strict=True):
        lines = [f"DMIG    {name:<8}       0       6       2       0        {len(A):>16}"]
        for c in range(len(A)):
            lines.append(f"DMIG*   {name:<16}{c + 1:>16}{3:>16}")
            lines += [f"*       {r + 1:>16}{3:>16}{A[r, c]:16.9E}".replace("E", "D") for r in range(c + 1) if A[r, c]]
        text += "\n".join(lines) + "\n"
    path.write_text(text)
    write_deck(path.with_suffix(".bdf"))


def write_deck(path: Path) -> None:
    """Grid points, one of them in a cylinder's coordinates, and bars between them."""
    lines = [
        "CORD2C         7       0      0.      0.      0.      0.      0.      1.",
        "+             1.      0.      0.",
    ]
    lines += [f"GRID    {k + 1:>8}{7 if k == 5 else '':>8}{float(k):>8}{0.5:>8}{0.0:>8}{7 if k == 4 else '':>8}"
              for k in range(6)]  # fmt: skip
    lines += [f"CBAR    {k + 1:>8}{1:>8}{k + 1:>8}{k + 2:>8}" for k in range(5)]
    path.write_text("\n".join(lines) + "\n")


def write_deck_beside(path: Path) -> None:
    """A deck, and the punch file that it belongs to."""
    write_punch(path.with_suffix(".pch"))
    write_deck(path)


def write_eigenvectors(path: Path) -> None:
    """Modes as Nastran punches them."""
    lines = ["$TITLE   = CHAIN", "$SUBTITLE="]
    for k in range(3):
        lines += ["$EIGENVECTOR", "$REAL OUTPUT", "$SUBCASE ID =           1",
                  f"$EIGENVALUE =  {1e4 * (k + 1):.7E}  MODE = {k + 1:>5}"]  # fmt: skip
        for p in range(4):
            values = np.sin((k + 1) * (p + 1) + np.arange(6))
            lines.append(f"{p + 1:>10}       G" + "".join(f"{v:18.6E}" for v in values[:3]))
            lines.append(f"-CONT-{'':12}" + "".join(f"{v:18.6E}" for v in values[3:]))
    path.write_text("\n".join(lines) + "\n")


def write_abaqus(path: Path) -> None:
    """Stiffness, and the mass beside it."""
    for where, A in zip((path.with_suffix(".mass.mtx"), path), chain(), strict=True):
        rows = [f"{r + 1},3, {c + 1},3, {A[r, c]:.15e}" for r in range(len(A)) for c in range(r + 1) if A[r, c]]
        where.write_text("** \n" + "\n".join(rows) + "\n")


def write_market(path: Path) -> None:
    """Stiffness, and the mass beside it."""
    for where, A in zip((path.with_suffix(".mass.mtx"), path), chain(), strict=True):
        scipy.io.mmwrite(str(where), scipy.sparse.coo_matrix(A), symmetry="symmetric")


def write_boeing(path: Path) -> None:
    """Stiffness, and the mass beside it."""
    for where, A in zip((path.with_suffix(".mass.hb"), path), chain(), strict=True):
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            scipy.io.hb_write(str(where), scipy.sparse.csc_matrix(A))


def write_points(path: Path) -> None:
    """A table of nodes."""
    g = geometry()
    rows = [",".join([n, *(f"{v:g}" for v in p)]) for n, p in zip(g.nodes, np.asarray(g.xyz), strict=True)]
    path.write_text("\n".join(["node,x,y,z", *rows]) + "\n")


def write_triangles(binary: bool) -> Callable[[Path], None]:
    """Two triangles."""

    def write(path: Path) -> None:
        corners = np.asarray(geometry().xyz)[[[0, 1, 2], [0, 2, 3]]]
        if binary:
            one = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
            table = np.zeros(2, one)
            table["corners"] = corners
            path.write_bytes(b"part".ljust(80) + (2).to_bytes(4, "little") + table.tobytes())
            return
        words = ["solid part"]
        for triangle in corners:
            words += [
                "facet normal 0 0 1",
                "outer loop",
                *("vertex " + " ".join(f"{v:g}" for v in c) for c in triangle),
            ]
            words += ["endloop", "endfacet"]
        path.write_text("\n".join([*words, "endsolid part"]) + "\n")

    return write


def write_joints(path: Path) -> None:
    """Joints for a simulation."""
    path.write_text('[[joint]]\nlaw = "elasto_slip"\nwhere = ["1", "2"]\nk = 2e4\nslip_force = 4.0\n'
                    '[[joint]]\nlaw = "cubic_stiffness"\nwhere = "3"\nk3 = 1e9\n')  # fmt: skip
