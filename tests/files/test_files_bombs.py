"""What unpacks, includes or declares far more than a file holds is refused before it is believed, and foreign errors
of readers become one line."""

import bz2
import gzip
import json
import struct
import time
import tracemalloc
import zlib
from pathlib import Path

import numpy as np
import pytest
import scipy.io

import modalax
from modalax import Measurement
from modalax.files import guard, load_records
from modalax.files.chunks import counted, packed_size, zstd_bound
from modalax.files.finite_elements import import_finite_elements
from modalax.simulate.joints.text import read_joints

pytestmark = pytest.mark.filterwarnings("ignore::UserWarning")
MB = 2**20
F = np.linspace(10.0, 21.0, 12)


def measurement() -> Measurement:
    H = (1 / (225 - F**2 + 3j))[None, :, None, None] * np.ones((2, 1, 2, 1))
    return Measurement(F, H, level=[1.0, 2.0], outputs=["1:+Z", "2:+Z"], inputs=["1:+Z"])


def refused(path: Path, pattern: str, read=modalax.load, most: float = 32 * MB) -> None:
    """Refused in one line, soon, and without the memory that was declared."""
    begin = time.process_time()
    tracemalloc.start()
    with pytest.raises(ValueError, match=pattern) as caught:
        read(path)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    words = str(caught.value)
    assert str(path) in words and "\n" not in words and "cannot be used: unexpected" not in words, words
    assert time.process_time() - begin < 8 and peak < most


def rle_frame(blocks: int) -> bytes:
    """A frame of Zstandard that does not tell its size: blocks that each stand for 128 KiB of one byte."""
    head = b"\x28\xb5\x2f\xfd" + bytes([0, 56])  # no size, a window of 128 KiB
    block = lambda last: struct.pack("<I", last | 1 << 1 | 2**17 << 3)[:3] + b"\0"
    return head + block(0) * (blocks - 1) + block(1)


def packed(packer: str, size: int) -> bytes:
    if packer in ("zlib", "gzip", "bz2"):
        return {"zlib": zlib.compress, "gzip": gzip.compress, "bz2": bz2.compress}[packer](bytes(size))
    numcodecs = pytest.importorskip("numcodecs")
    codec = {"zstd": numcodecs.Zstd, "lz4": numcodecs.LZ4, "blosc": numcodecs.Blosc}[packer]()
    return bytes(codec.encode(np.zeros(size, np.uint8)))


@pytest.mark.parametrize("packer", ["zlib", "gzip", "bz2", "zstd", "lz4", "blosc"])
def test_a_zarr_chunk_that_unpacks_to_more_than_its_shape(tmp_path, packer):
    pytest.importorskip("zarr")
    path = tmp_path / "x.zarr"
    modalax.save(measurement(), path)
    about = json.loads((path / "H_real" / ".zarray").read_text()) | {"compressor": {"id": packer}, "filters": None}
    (path / "H_real" / ".zarray").write_text(json.dumps(about))
    for chunk in path.glob("H_real/[0-9]*"):
        chunk.write_bytes(packed(packer, 48 * 8))
    np.testing.assert_array_equal(modalax.load(path, conjugate=False).H.real, 0.0)
    for chunk in path.glob("H_real/[0-9]*"):
        chunk.write_bytes(packed(packer, 64 * MB))
    refused(path, "a chunk of H_real unpacks to more than the")


def test_a_zarr_array_packed_twice_or_by_what_grows(tmp_path):
    pytest.importorskip("zarr")
    path = tmp_path / "x.zarr"
    modalax.save(measurement(), path)
    about = path / "H_real" / ".zarray"
    sound = json.loads(about.read_text())
    for change, pattern in (
        ({"filters": [{"id": "gzip"}], "compressor": {"id": "zlib"}}, "H_real is packed twice"),
        ({"filters": [{"id": "delta", "dtype": "f8", "astype": "i1"}]}, "H_real is packed by delta"),
    ):
        about.write_text(json.dumps(sound | change))
        refused(path, pattern)


def test_a_zarr_chunk_of_words_that_counts_more_of_them(tmp_path):
    numcodecs = pytest.importorskip("numcodecs")
    path = tmp_path / "x.zarr"
    modalax.save(measurement(), path)
    about = json.loads((path / "output" / ".zarray").read_text())
    about |= {"dtype": "|O", "filters": [{"id": "vlen-utf8"}], "compressor": {"id": "zstd"}, "fill_value": ""}
    (path / "output" / ".zarray").write_text(json.dumps(about))
    words = bytes(numcodecs.VLenUTF8().encode(np.array(["1:+Z", "2:+Z"], dtype=object)))
    chunk = next(path.glob("output/[0-9]*"))
    chunk.write_bytes(numcodecs.Zstd().encode(words))
    assert modalax.load(path).outputs == ("1:+Z", "2:+Z")
    chunk.write_bytes(numcodecs.Zstd().encode(struct.pack("<I", 2**32 - 1) + words[4:]))
    refused(path, "a chunk of output does not hold the 2 words")


def test_the_bound_on_a_frame_that_does_not_tell_its_size():
    numcodecs = pytest.importorskip("numcodecs")
    frame = rle_frame(3)
    assert zstd_bound(frame) == 3 * 2**17 == len(numcodecs.Zstd().decode(frame))
    assert zstd_bound(bytes(numcodecs.Zstd().encode(bytes(100_000)))) == 100_000
    assert zstd_bound(bytes(numcodecs.Zstd().encode(bytes(300)))) == 300
    with pytest.raises(EOFError):
        zstd_bound(frame[:-5])
    twice = gzip.compress(bytes(1000)) + gzip.compress(bytes(500))
    assert packed_size("gzip", twice, MB) == 1500
    assert counted(zlib.decompressobj, zlib.compress(bytes(1000)) + b"more", MB) == 1000


def hdf5_bomb(path: Path, name: str, shape: tuple[int, ...], chunks: tuple[int, ...]) -> None:
    """Replace a dataset by one whose chunk unpacks to 64 MB."""
    h5py = pytest.importorskip("h5py")
    with h5py.File(path, "r+") as file:
        attributes = dict(file[name].attrs) if name in file else {}
        if name in file:
            del file[name]
        node = file.create_dataset(name, shape, "f8", chunks=chunks, compression="gzip")
        for key, value in attributes.items():
            if key not in ("DIMENSION_LIST", "REFERENCE_LIST"):
                node.attrs[key] = value
        node.id.write_direct_chunk((0,) * len(shape), zlib.compress(bytes(64 * MB)))


def test_an_hdf5_chunk_that_unpacks_to_more_than_its_shape(tmp_path):
    h5py = pytest.importorskip("h5py")
    path = tmp_path / "x.nc"
    modalax.save(measurement(), path)
    hdf5_bomb(path, "H_real", (2, 12, 2, 1), (2, 12, 2, 1))
    refused(path, "a chunk of H_real unpacks to more than the")
    path = tmp_path / "x.h5"
    with h5py.File(path, "w") as file:
        file.attrs["fs"] = 100.0
        file["force"] = np.zeros(64)
    hdf5_bomb(path, "acc", (64,), (64,))
    refused(path, "a chunk of acc unpacks to more than the", load_records)
    with h5py.File(path, "w") as file:
        file.create_dataset("acc", (64,), "f8", chunks=(64,), compression="lzf")[:] = np.arange(64.0)
        file["force"], file.attrs["fs"] = np.ones(64), 100.0
    assert load_records(path).data.shape == (1, 64, 2)
    with h5py.File(path, "r+") as file:
        file["acc"].id.write_direct_chunk((0,), bytes(8 * MB))
    refused(path, "a chunk of acc unpacks to more than the", load_records)


@pytest.mark.parametrize("link", ["soft", "outside", "virtual"])
def test_records_in_other_files_are_not_read(tmp_path, link):
    h5py = pytest.importorskip("h5py")
    path = tmp_path / "x.h5"
    (tmp_path / "secret").write_bytes(bytes(512))
    with h5py.File(path, "w") as file:
        file["force"], file.attrs["fs"] = np.arange(64.0), 100.0
        if link == "soft":
            file["acc"] = h5py.SoftLink("/force")
        elif link == "outside":
            file.create_dataset("acc", (64,), "f8", external=[(str(tmp_path / "secret"), 0, 512)])
        else:
            layout = h5py.VirtualLayout((64,), "f8")
            layout[:] = h5py.VirtualSource(str(tmp_path / "secret"), "x", (64,))
            file.create_virtual_dataset("acc", layout)
    if link == "soft":
        assert load_records(path).data.shape[2] == 1
    else:
        refused(path, "acc is empty or its numbers lie in other files", load_records)


def test_records_that_unpack_to_a_thousand_times_their_size(tmp_path, monkeypatch):
    monkeypatch.setattr(guard, "MORE", MB)
    big = np.zeros((1, MB), np.float64)
    np.savez_compressed(tmp_path / "x.npz", Fs=100.0, acc=big)
    refused(tmp_path / "x.npz", r"the \.npz archive declares 8.* MB", load_records)
    scipy.io.savemat(tmp_path / "x.mat", {"Fs": 100.0, "acc": big}, do_compression=True)
    refused(tmp_path / "x.mat", r"the \.mat file declares", load_records)
    del big
    header = b"{'descr': '<f8', 'fortran_order': False, 'shape': (4, 1000000000000), }".ljust(117) + b"\n"
    (tmp_path / "x.npy").write_bytes(b"\x93NUMPY\x01\x00" + struct.pack("<H", len(header)) + header + bytes(64))
    refused(tmp_path / "x.npy", r"declares the shape \(4, 1000000000000\)", lambda p: load_records(p, fs=1.0))


@pytest.mark.parametrize("ending", ["npz", "mat", "wav", "h5", "npy"])
def test_damaged_records_are_refused_in_one_line(tmp_path, ending):
    rng, path = np.random.default_rng(0), tmp_path / f"x.{ending}"
    arrays = {"Fs": np.array(100.0), "force": rng.normal(size=64), "acc": rng.normal(size=64)}
    if ending == "npz":
        np.savez_compressed(path, **arrays)
    elif ending == "mat":
        scipy.io.savemat(path, arrays, do_compression=True)
    elif ending == "npy":
        np.save(path, arrays["acc"])
    elif ending == "wav":
        scipy.io.wavfile.write(path, 100, arrays["acc"])
    else:
        h5py = pytest.importorskip("h5py")
        with h5py.File(path, "w") as file:
            file["force"] = arrays["force"]
    content = path.read_bytes()
    path.write_bytes(content[: len(content) // 3] + b"\xff" * 40 + content[len(content) // 3 + 60 :])
    refused(path, "damaged|not finite|samples", lambda p: load_records(p, fs=100.0))


def test_a_deck_that_includes_itself_is_not_followed(tmp_path):
    path, deck = tmp_path / "x.mtx", tmp_path / "deck.bdf"
    scipy.io.mmwrite(path, np.eye(2))
    deck.write_text("INCLUDE 'deck.bdf'\n" * 60)
    refused(deck, "deck.bdf is included a second time", lambda p: import_finite_elements(path, mass=path, grids=p))


@pytest.mark.parametrize(
    ("text", "pattern"),
    [
        ("coordinate real general\n2 2 2\n1 1 1.0\n3 2 1.0\n", "outside the 2 rows"),
        ("coordinate real general\n2 2 2\n1 1 1.0\n0 2 1.0\n", "outside the 2 rows"),
        ("coordinate real general\n2000000000 2000000000 1\n1 1 1.0\n", "declares 2000000000 DoFs"),
        ("coordinate real general\n2 2 99999999999\n1 1 1.0\n", "2 entries and announces|1 entries and announces"),
        ("array real general\n300000 300000\n1.0\n", "declares 300000 DoFs"),
        ("coordinate real general\n2 2 2\n1 1 nan\n2 2 1.0\n", "1 of its 2 entries are not finite"),
        ("coordinate complex general\n2 2 1\n1 1 1.0 2.0\n", "a real matrix is needed"),
        ("coordinate real symmetric\n2 2 2\n1 2 1.0\n2 1 1.0\n", "called symmetric"),
    ],
)
def test_matrix_market_files_that_lie(tmp_path, text, pattern):
    path = tmp_path / "x.mtx"
    path.write_text("%%MatrixMarket matrix " + text)
    refused(path, pattern, lambda p: modalax.load(p, mass=p))


@pytest.mark.parametrize("form", ["coordinate", "array"])
@pytest.mark.parametrize("symmetry", ["general", "symmetric"])
def test_matrix_market_files_as_scipy_reads_them(tmp_path, form, symmetry):
    from modalax.files.matrices import read_plain

    A = np.array([[4.0, -1.5, 0.0], [-1.5, 3.0, -1.0], [0.0, -1.0, 5.0]])
    if symmetry == "general":
        A[0, 2] = 0.25
    path = tmp_path / "x.mtx"
    scipy.io.mmwrite(path, A if form == "array" else scipy.sparse.coo_matrix(A), symmetry=symmetry)
    np.testing.assert_array_equal(read_plain(path).values.toarray(), A)


def test_a_symmetric_harwell_boeing_matrix_with_columns_that_touch(tmp_path):
    """One triangle, exponents with D, no blank between numbers: as Fortran programs write them."""
    from modalax.files.matrices import read_plain

    path = tmp_path / "x.hb"
    head = ["a matrix".ljust(72) + "KEY     ", "".join(f"{n:14d}" for n in (4, 1, 1, 2, 0)),
            "RSA".ljust(14) + "".join(f"{n:14d}" for n in (3, 3, 5, 0)),
            "(4I3)".ljust(16) + "(5I3)".ljust(16) + "(1P,3D14.7)".ljust(20) + "(1P,3D14.7)".ljust(20)]  # fmt: skip
    values = [4.0, -1.5e-7, 3.0, -1.0, 5.0]
    shown = [f"{v:14.7E}".replace("E", "D") for v in values]
    body = ["  1  3  5  6", "  1  2  2  3  3", "".join(shown[:3]), "".join(shown[3:])]
    path.write_text("\n".join([*head, *body]) + "\n")
    wanted = np.array([[4.0, -1.5e-7, 0.0], [-1.5e-7, 3.0, -1.0], [0.0, -1.0, 5.0]])
    np.testing.assert_array_equal(read_plain(path, harwell_boeing=True).values.toarray(), wanted)
    path.write_text("\n".join([*head, body[0], "  1  2  2  3  9", *body[2:]]) + "\n")
    with pytest.raises(ValueError, match="outside the 3 rows"):
        read_plain(path, harwell_boeing=True)


@pytest.mark.parametrize(
    ("text", "pattern"),
    [
        ("1,3, 1,3, nan\n", "without whole nodes|not finite"),
        ("1,3, 1,3, 1.0\n1,3, 2,3\n", "line 2 has 4 numbers"),
        ("1.5,3, 1,3, 1.0\n", "1 of them without whole nodes"),
        ("1,3, 1,3, 1e36\n", "no entry but those of supports"),
        ("1,3, 1,3, x\n", "line 1 holds what is no number"),
    ],
)
def test_matrices_by_abaqus_that_cannot_be(tmp_path, text, pattern):
    path = tmp_path / "x.mtx"
    path.write_text(text)
    refused(path, pattern, lambda p: modalax.load(p, mass=p))


@pytest.mark.parametrize(
    ("content", "pattern"),
    [
        (b'[[joint]]\nlaw = "gap"\nwhere = 3.5\n', "joint 1: law is a name"),
        (b'[[joint]]\nlaw = 4\nwhere = "1"\n', "joint 1: law is a name"),
        (b"joint = 3\n", "holds no table"),
        (b'[[joint]]\nlaw = "\xff"\n', "can't decode"),
        (b'[[joint]]\nlaw = "cubic_stiffness"\nwhere = "3"\nk3 = inf\n', "k3 is inf; finite numbers are needed"),
    ],
)
def test_files_of_joints_that_cannot_be(tmp_path, content, pattern):
    path = tmp_path / "x.toml"
    path.write_bytes(content)
    refused(path, pattern, lambda p: read_joints(str(p)))


def test_an_option_for_another_kind_of_file_is_named(tmp_path):
    path = tmp_path / "x.mtx"
    path.write_text("    -1\n    58\n    -1\n")
    refused(path, "option mass is for other kinds of files, this one is uff", lambda p: modalax.load(p, mass=p))


def test_an_extended_simulation_that_lacks_something(tmp_path):
    arrays = {
        "kind": "structure", "M": np.eye(1), "C": np.eye(1), "K": 1e4 * np.eye(1), "D": np.zeros((1, 1)),
        "dofs": np.array(["1"]), "frequency_std": 0.0, "damping_std": 0.0, "theta": np.zeros((2, 1)),
        "outputs": np.array(["1"]), "inputs": np.array(["1"]), "lowest_hz": 1.0, "causes": np.zeros(0, str),
    }  # fmt: skip
    path = tmp_path / "x.npz"
    np.savez(path, **arrays)
    assert modalax.load(path).slugs == ()
    for change, pattern in (
        ({"theta": None}, "theta"), ({"theta": np.full((2, 1), np.nan)}, "theta .* must be finite"),
        ({"theta": np.zeros((3, 1))}, r"theta has shape \(3, 1\)"), ({"causes": np.array(["x"])}, "cause x is unknown"),
    ):  # fmt: skip
        np.savez(path, **{k: v for k, v in (arrays | change).items() if v is not None})
        refused(path, pattern)


READER = """
import os, sys
import numpy as np, scipy.sparse
class _File:
    def load_km(self, as_sparse):
        if FAULT:
            os.abort()
        K = scipy.sparse.triu(scipy.sparse.diags([[-1e4] * 2, [2e4] * 3, [-1e4] * 2], [-1, 0, 1]))
        return np.array([[1, 2], [2, 2], [3, 2]]), K.tocsc(), scipy.sparse.eye(3).tocsc()
def read_binary(path):
    return _File()
"""


@pytest.mark.parametrize("fault", [False, True])
def test_the_reader_of_ansys_files_may_end_without_ending_this_process(tmp_path, monkeypatch, fault):
    """By a stand-in for that package, which works or ends its process as the true one does on damaged files."""
    package = tmp_path / "lib" / "ansys" / "mapdl" / "reader"
    package.mkdir(parents=True)
    (package / "__init__.py").write_text(READER.replace("FAULT", str(fault)))
    monkeypatch.setenv("PYTHONPATH", str(tmp_path / "lib"))
    monkeypatch.syspath_prepend(tmp_path / "lib")
    path = tmp_path / "x.full"
    path.write_bytes(bytes(range(200)))
    if fault:
        refused(path, "ansys-mapdl-reader cannot take matrices")
    else:
        found = modalax.load(path)
        assert found.dofs == ("1:+Z", "2:+Z", "3:+Z")
        omega = np.sqrt(1e4 * (2 - np.sqrt(2) * np.array([1, 0, -1])))  # chain between walls
        np.testing.assert_allclose(found.modal().frequency_hz, omega / (2 * np.pi), rtol=1e-9)


def test_a_missing_reader_of_ansys_files_is_named(tmp_path, monkeypatch):
    from modalax.files import matrices

    monkeypatch.setattr(matrices, "_is_installed", lambda name: False)
    (tmp_path / "x.full").write_bytes(bytes(range(200)))
    refused(tmp_path / "x.full", r"needs ansys-mapdl-reader: pip install 'modalax\[ansys\]'")
