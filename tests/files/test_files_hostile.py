"""Files that declare, hide or claim what they should not are refused in one line that names file, place and remedy."""

import io
import json
import os
import struct
import time
import zipfile

import numpy as np
import pytest
import scipy.io
import scipy.sparse

import modalax
from modalax import Measurement
from modalax.files import guard, inside
from modalax.files.labelled import from_xarray, to_xarray
from modalax.files.load_save import as_path, save
from modalax.files.units import force_factor, frequency_factor, response_unit

F = np.linspace(10.0, 21.0, 12)


def arrays() -> dict[str, np.ndarray]:
    H = (1 / (225 - F**2 + 3j))[None, :, None, None] * np.ones((2, 1, 2, 1))
    names = {"outputs": np.array(["1:+Z", "2:+Z"]), "inputs": np.array(["1:+Z"])}
    return {"freq": F, "H": H, "level": np.array([1.0, 2.0]), "form": np.array("receptance"), **names}


def measurement() -> Measurement:
    a = arrays()
    return Measurement(a["freq"], a["H"], level=a["level"], outputs=["1:+Z", "2:+Z"], inputs=["1:+Z"])


def refused(path, pattern: str) -> None:
    begin = time.process_time()
    with pytest.raises(ValueError, match=pattern) as caught:
        modalax.load(path)
    words = str(caught.value)
    assert str(path) in words and "\n" not in words and "cannot be used: unexpected" not in words, words
    assert time.process_time() - begin < 5


def npz(path, **changes) -> None:
    np.savez(path, **{k: v for k, v in {**arrays(), **changes}.items() if v is not None})


def with_header(path, header: bytes) -> None:
    """An archive whose H has a header of one's own."""
    npz(path, H=None)
    content = b"\x93NUMPY\x01\x00" + struct.pack("<H", len(header)) + header + bytes(64)
    with zipfile.ZipFile(path, "a") as archive:
        archive.writestr("H.npy", content)


@pytest.mark.parametrize(
    "shape", ["(1, 1000000000000, 2, 1)", "(1000000, 1000000, 1000000, 1000000)", "(-1, 12, 2, 1)"]
)
def test_npz_array_that_declares_more_than_there_is(tmp_path, shape):
    with_header(tmp_path / "x.npz", b"{'descr': '<c16', 'fortran_order': False, 'shape': %s}\n" % shape.encode())
    refused(tmp_path / "x.npz", "array 'H' declares|array 'H' is damaged|cannot be read")


def test_npz_names_without_letters(tmp_path):
    npz(tmp_path / "x.npz", outputs=None)
    header = b"{'descr': '<U0', 'fortran_order': False, 'shape': (40000000,)}\n"
    with zipfile.ZipFile(tmp_path / "x.npz", "a") as archive:
        archive.writestr("outputs.npy", b"\x93NUMPY\x01\x00" + struct.pack("<H", len(header)) + header)
    refused(tmp_path / "x.npz", "outputs")


def test_npz_of_forty_thousand_names(tmp_path):
    npz(tmp_path / "x.npz", outputs=np.arange(40000))
    refused(tmp_path / "x.npz", "outputs holds 40000 names; at most 20000 are read")


def test_npz_that_unpacks_to_a_thousand_times_its_size(tmp_path, monkeypatch):
    monkeypatch.setattr(guard, "MORE", 2**20)
    arrays_ = arrays() | {"coherence": np.zeros((2, 120000, 2, 1))}
    np.savez_compressed(tmp_path / "x.npz", **arrays_)
    refused(tmp_path / "x.npz", r"declares 3\.8\d+ MB; read is at most .* save it uncompressed")
    np.savez(tmp_path / "y.npz", **arrays_)
    refused(tmp_path / "y.npz", "coherence has shape")  # uncompressed it is read


@pytest.mark.parametrize(("field", "value"), [(6, 1), (8, 99)])
def test_npz_that_is_encrypted_or_packed_in_another_way(tmp_path, field, value):
    npz(tmp_path / "x.npz")
    content = bytearray((tmp_path / "x.npz").read_bytes())
    for mark, shift in ((b"PK\x01\x02", 2), (b"PK\x03\x04", 0)):
        at = content.find(mark)
        while at >= 0:
            content[at + field + shift : at + field + shift + 2] = struct.pack("<H", value)
            at = content.find(mark, at + 4)
    (tmp_path / "x.npz").write_bytes(bytes(content))
    refused(tmp_path / "x.npz", "encrypted|compression|Bad magic|cannot be read")


@pytest.mark.parametrize(
    ("changes", "pattern"),
    [
        ({"averages": np.array(np.inf)}, "averages is .inf.*one finite number"),
        ({"form": np.array([], dtype=str)}, "form holds 0 words"),
        ({"form": np.array("")}, "form holds 1 words .*needs one"),
        ({"axes": np.arange(4)}, "axes says '0 1 2 3'"),
        ({"axes": np.array(1.0)}, "axes has type float64"),
        ({"outputs": np.array([b"\xff\xfe", b"1"])}, "outputs holds bytes that are no text"),
        ({"outputs": np.array(["a\nb", "c"])}, "outputs holds text that is no name"),
        ({"outputs": np.array(["a" * 300, "c"])}, "outputs holds text that is no name"),
        ({"outputs": np.array(["", "c"])}, "outputs holds an empty name"),
        ({"H": np.zeros((0, 12, 2, 1), dtype=complex), "level": None}, "at least one run"),
        ({"H": np.full((2, 12, 2, 1), 1e307 + 0j)}, "H reaches 1e.307.*byte order"),
        ({"level": np.array([1.0, np.inf])}, "level is inf .*above 0 N"),
        ({"level": np.array([1.0, 0.0])}, "level is 0 .*above 0 N"),
        ({"level": np.array([1.0, -2.0])}, "level is -2 .*above 0 N"),
        ({"added_decay": np.array(np.nan)}, "added_decay is .nan.*one finite number"),
        ({"added_decay": np.array(np.inf)}, "added_decay is .inf.*one finite number"),
        ({"added_decay": np.array(-1.0)}, "added_decay is -1; .*0 .*or more"),
        ({"force": np.zeros((2, 12))}, "force is 0 .*above 0 N"),
        ({"force": np.full((2, 12), -1.0)}, "force is -1 .*above 0 N"),
        ({"coherence": np.full((2, 12, 2, 1), 1.2)}, "coherence is 1.2 .*between 0 and 1"),
        ({"coherence": np.full((2, 12, 2, 1), -0.2)}, "coherence is -0.2 .*between 0 and 1"),
    ],
)
def test_npz_of_numbers_that_cannot_be(tmp_path, changes, pattern):
    npz(tmp_path / "x.npz", **changes)
    refused(tmp_path / "x.npz", pattern)


@pytest.mark.parametrize(
    ("changes", "pattern"),
    [
        ({"shapes": np.full((2, 2), np.nan)}, "shapes holds 4 values that are not finite"),
        ({"participation": np.full((2, 1), np.inf)}, "participation holds 2 values that are not finite"),
        ({"frequency_std": np.full(3, 0.1)}, r"frequency_std has shape \(3,\); .* 2 modes"),
        ({"outputs": np.array([], dtype=str), "shapes": np.zeros((2, 0))}, "0 outputs"),
    ],
)
def test_modal_model_of_numbers_that_cannot_be(tmp_path, changes, pattern):
    model = {"poles": [-1 + 60j, -2 + 90j], "shapes": np.ones((2, 2)), "participation": np.ones((2, 1))}
    model |= {"outputs": np.array(["1", "2"]), "inputs": np.array(["1"])}
    np.savez(tmp_path / "m.npz", **{**model, **changes})
    refused(tmp_path / "m.npz", pattern)


@pytest.mark.parametrize(
    ("changes", "pattern"),
    [
        ({"frequency_std": np.full(3, 0.1)}, r"frequency_std has shape \(3,\); .* 2 modes"),
        ({"damping_std": np.array([0.1, np.nan])}, "damping_std"),
        ({k: np.zeros((0, 0)) for k in "MCK"} | {"dofs": np.array([], dtype=str)}, "at least one degree of freedom"),
    ],
)
def test_structure_of_numbers_that_cannot_be(tmp_path, changes, pattern):
    np.savez(tmp_path / "s.npz", **{**dict.fromkeys("MCK", np.eye(2)), "dofs": np.array(["1", "2"]), **changes})
    refused(tmp_path / "s.npz", pattern)


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="this system has no pipes in folders")
def test_a_pipe_is_not_waited_for(tmp_path):
    os.mkfifo(tmp_path / "x.npz")
    refused(tmp_path / "x.npz", "neither a file nor a folder")


def test_mat_with_a_damaged_compressed_part(tmp_path):
    scipy.io.savemat(tmp_path / "x.mat", arrays(), do_compression=True)
    content = bytearray((tmp_path / "x.mat").read_bytes())
    content[140:150] = bytes(10)
    (tmp_path / "x.mat").write_bytes(bytes(content))
    refused(tmp_path / "x.mat", "the .mat file is damaged")


def test_mat_that_unpacks_to_a_thousand_times_its_size(tmp_path, monkeypatch):
    monkeypatch.setattr(guard, "MORE", 2**20)
    scipy.io.savemat(tmp_path / "x.mat", arrays() | {"other": np.zeros(2**19)}, do_compression=True)
    refused(tmp_path / "x.mat", "the .mat file declares .* save it uncompressed")


@pytest.mark.parametrize(
    ("count", "most"),
    [(20_001, inside.MOST_CELLS), (2_001, 2_000), pytest.param(100_001, inside.MOST_CELLS, marks=pytest.mark.slow)],
)
def test_mat_of_very_many_names(tmp_path, count, most, monkeypatch):
    """Up to the most cells they are read and counted. To write more than are read takes seconds, so fewer are read."""
    monkeypatch.setattr(inside, "MOST_CELLS", most)
    cells = np.empty(count, dtype=object)
    cells[:] = "1"
    scipy.io.savemat(tmp_path / "x.mat", arrays() | {"outputs": cells}, do_compression=True)
    said = "outputs holds 20001 names" if count <= most else f"outputs is a cell .* over {most} cells"
    refused(tmp_path / "x.mat", said)


@pytest.mark.parametrize(
    "changes", [{"H": "text"}, {"H": {"a": 1}}, {"outputs": {"a": 1}}, {"freq": np.array([{"a": 1}], dtype=object)}]
)
def test_mat_with_text_or_structures_where_arrays_should_be(tmp_path, changes):
    scipy.io.savemat(tmp_path / "x.mat", arrays() | changes)
    refused(tmp_path / "x.mat", "H has type|has type|holds other things than words")


def test_mat_with_sparse_matrices_is_read(tmp_path):
    K = scipy.sparse.csc_matrix(np.diag([2.0, 3.0]))
    scipy.io.savemat(tmp_path / "s.mat", {"M": np.eye(2), "C": np.zeros((2, 2)), "K": K, "dofs": ["1", "2"]})
    np.testing.assert_array_equal(modalax.load(tmp_path / "s.mat").K, np.diag([2.0, 3.0]))


def mat73(path, change) -> None:
    h5py = pytest.importorskip("h5py")
    with h5py.File(path, "w", userblock_size=512) as file:
        for name, value in arrays().items():
            if value.dtype.kind in "fc":
                file[name] = value.T
        change(file, h5py)
    content = bytearray(path.read_bytes())
    content[:19] = b"MATLAB 7.3 MAT-file"
    path.write_bytes(bytes(content))


@pytest.mark.parametrize(
    ("change", "pattern"),
    [
        (lambda f, h: f.__setitem__("outputs", h.SoftLink("/outputs")), "outputs is a link"),
        (lambda f, h: f.__setitem__("outputs", h.ExternalLink("/etc/passwd", "/")), "outputs is a link"),
        (lambda f, h: f.create_group("outputs"), "outputs is a group"),
        (lambda f, h: f.__setitem__("outputs", h.Empty("f8")), "outputs is empty"),
        (
            lambda f, h: f.create_dataset("variance", (10**6, 10**6), dtype="f8", chunks=(10, 10)),
            "variance .*declares 8e.06 MB",
        ),
        (lambda f, h: f.create_dataset("outputs", (40000,), dtype=h.ref_dtype), "outputs holds 40000 names"),
        (lambda f, h: f.create_dataset("outputs", (2,), dtype=h.ref_dtype), "the .mat file is damaged"),
        (lambda f, h: f.__setitem__("outputs", "text"), "damaged|has type"),
        (lambda f, h: None, "no form"),
    ],
)
def test_mat_of_version_7_3_with_what_should_not_be_there(tmp_path, change, pattern):
    mat73(tmp_path / "x.mat", change)
    refused(tmp_path / "x.mat", pattern)


def test_netcdf_without_frequencies_or_with_links(tmp_path):
    h5py = pytest.importorskip("h5py")
    path = tmp_path / "x.nc"
    modalax.save(measurement(), path)
    with h5py.File(path, "a") as file:
        del file["level"]
        file["level"] = h5py.ExternalLink("/etc/passwd", "/")
    refused(path, "level is a link")
    to_xarray(measurement()).drop_vars(["freq", "H"]).to_netcdf(tmp_path / "y.nc", engine="h5netcdf")
    refused(tmp_path / "y.nc", "no H, freq in the dataset")


@pytest.mark.parametrize("unit", ["kHz", "rad/s"])
def test_frequencies_in_other_units_are_converted(unit):
    factor = {"kHz": 1e-3, "rad/s": 2 * np.pi}[unit]
    dataset = to_xarray(measurement())
    turned = dataset.assign_coords(freq=("freq", F * factor, {"units": unit}))
    np.testing.assert_allclose(from_xarray(turned).freq, F, rtol=1e-14)


def test_the_unit_of_the_frfs_is_read_and_compared_with_the_form():
    dataset = to_xarray(measurement().replace(variance=np.ones((2, 12, 2, 1))))
    millimetres = dataset.assign(H=(dataset["H"] * 1e3).assign_attrs(units="mm/N"))
    millimetres["variance"] = (dataset["variance"] * 1e6).assign_attrs(units="(mm/N)^2")
    np.testing.assert_allclose(from_xarray(millimetres).H, measurement().H, rtol=1e-14)
    np.testing.assert_allclose(from_xarray(millimetres).variance, 1.0, rtol=1e-14)
    for name, unit, pattern in (
        ("H", "(m/s^2)/N", "the unit of accelerance, and form says 'receptance'"),
        ("H", "furlong/N", "the unit of the FRFs is 'furlong/N'"),
        ("variance", "m/N", "variance is in 'm/N'"),
        ("freq", "octave", "the unit of frequencies is 'octave'; known are Hz"),
        ("level", "MN", "the unit of forces is 'MN'"),
    ):
        wrong = dataset.copy()
        wrong[name].attrs["units"] = unit
        with pytest.raises(ValueError, match=pattern):
            from_xarray(wrong)


def test_units_as_text():
    assert response_unit("m/N") == ("receptance", 1.0) and response_unit("(m/s^2)/N") == ("accelerance", 1.0)
    assert response_unit("m s-2 N-1") == ("accelerance", 1.0) and response_unit("1/kg") == ("accelerance", 1.0)
    form, factor = response_unit("g/lbf")
    assert form == "accelerance" and factor == pytest.approx(9.80665 / 4.4482216152605)
    assert response_unit("(in/s)/lbf")[1] == pytest.approx(0.0254 / 4.4482216152605)
    assert frequency_factor("rad/s") == pytest.approx(1 / (2 * np.pi)) and force_factor("kN") == 1e3


def store(tmp_path):
    path = tmp_path / "x.zarr"
    modalax.save(measurement(), path)
    return path


def test_zarr_store_that_was_half_written(tmp_path):
    path = store(tmp_path)
    (path / "level" / "0").unlink()
    refused(path, "level lacks 1 of its 1 chunks: the store was half written")


def test_zarr_chunk_that_is_cut(tmp_path):
    path = store(tmp_path)
    chunk = next(p for p in (path / "H_real").iterdir() if not p.name.startswith("."))
    chunk.write_bytes(chunk.read_bytes()[:-20])
    refused(path, "the Zarr store is damaged")


@pytest.mark.parametrize(
    ("change", "pattern"),
    [
        ({"shape": [10**12], "chunks": [10**12]}, "output .*declares"),
        ({"chunks": [10**12]}, "output .*declares"),
        ({"chunks": [0]}, "has the shape"),
        ({"compressor": {"id": "pickle"}}, "output is packed by pickle"),
        ({"dtype": "|O", "filters": [{"id": "pickle"}]}, "output is packed by pickle"),
    ],
)
def test_zarr_store_that_declares_what_is_not_there_or_would_run_code(tmp_path, change, pattern):
    path = store(tmp_path)
    about = path / "output" / ".zarray"
    about.write_text(json.dumps(json.loads(about.read_text()) | change))
    refused(path, pattern)


def uff(tmp_path, change, binary=False) -> None:
    pytest.importorskip("pyuff")
    path = tmp_path / "x.uff"
    modalax.save(measurement(), path, binary=binary)
    (tmp_path / "x.uff").write_bytes(change(path.read_bytes()))


@pytest.mark.parametrize(
    ("old", "new", "binary", "pattern"),
    [
        (b"         6        12", b"         4        12", False, "function 1.* real numbers|damaged"),
        (b"         6        12", b"         4        12", True, "function 1.* real numbers"),
        (b"         6        12", b"         2        12", True, "function 1.* real numbers"),
        (b"         6        12", b"         3        12", True, "ordinate data type 3"),
        (b"         6        12", b"         6         6", True, "does not fit its header: it holds 12 of the 6|12"),
        (b"         6        12", b"         6      9999", True, "cut short: it holds 12 of the 9999"),
        (b"58b     1     2", b"58b     2     2", True, "byte order"),
        (b"58b     1     2", b"58b     3     2", True, "byte order 3"),
    ],
)
def test_universal_files_whose_headers_lie(tmp_path, old, new, binary, pattern):
    seen = []
    uff(tmp_path, lambda content: (seen.append(content.count(old)), content.replace(old, new))[1], binary)
    assert seen[0] >= 1
    refused(tmp_path / "x.uff", pattern)


def test_what_is_no_file_name():
    for wrong in (3, None, ["a.npz"], io.BytesIO()):
        with pytest.raises(ValueError, match="a file is named by text or a path, not by"):
            as_path(wrong)


def test_a_path_before_what_is_saved_is_told(tmp_path):
    with pytest.raises(ValueError, match="takes the dict first and the path after it"):
        save(tmp_path / "a.npz", {})
