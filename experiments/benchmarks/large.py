"""Files larger than memory should hold: ``python experiments/benchmarks/large.py [records] [uff] [fit]``.

``records``: random records of 16 channels as a ``.npy`` file (4 GB; ``--gigabytes 40``), made into FRFs by
``modalax frf`` in a process whose memory for data the operating system limits (``--limit``, 1.2 GB).

``uff``: a universal file of 1 GB, binary data sets 58, indexed (types, places and headers of
its sets) and read whole, beside pyuff.

``fit``: FRFs of 2,000 outputs x 8 inputs x 8,000 lines (2 GB) from a Zarr store: the poles of every order and those
that are stable; ``--scale`` makes them smaller. Every part runs in a process of its own, one thread.
"""

import argparse
import json
import sys
import tempfile
import time
from pathlib import Path

from common import Table, call, machine, peak

FS, CHANNELS, PIECE = 2048.0, 16, 2**20


def write_records(path: Path, gigabytes: float) -> None:
    """A random force and the accelerations of 15 oscillators, in single precision, written piece by piece."""
    import numpy as np
    import scipy.signal

    samples = int(gigabytes * 1e9 / 4 / CHANNELS)
    table = np.lib.format.open_memmap(path, mode="w+", dtype=np.float32, shape=(samples, CHANNELS))
    rng = np.random.default_rng(0)
    f = np.linspace(40, 400, CHANNELS - 1)
    force = rng.normal(size=PIECE).astype(np.float32)
    piece = [force]
    for one in f:
        p = np.exp((-0.01 + 1j) * 2 * np.pi * one / FS)
        poles = [1, -2 * p.real, abs(p) ** 2]
        clean = scipy.signal.lfilter([0, 1e-2], poles, np.concatenate([force, force]))[PIECE:]
        piece.append((clean + 1e-4 * rng.normal(size=PIECE)).astype(np.float32))
    block = np.stack(piece, axis=1)
    for start in range(0, samples, PIECE):
        table[start : start + PIECE] = block[: min(PIECE, samples - start)]
    table.flush()


def records(path: str, limit: float) -> dict:
    """``modalax frf`` under a limit on memory for data."""
    import resource

    import numpy as np

    resource.setrlimit(resource.RLIMIT_DATA, (int(limit * 1e9),) * 2)
    from modalax.cli import main
    from modalax.files import load

    target = Path(path).with_suffix(".npz")
    began = time.perf_counter(), time.process_time()
    units = [word for k in range(2, CHANNELS + 1) for word in ("--units", f"{k}=m/s^2")]
    status = main(["frf", path, "-o", str(target), "--fs", str(FS), "--force", "1", "--block", "2", *units])
    wall, cpu = time.perf_counter() - began[0], time.process_time() - began[1]
    if status:
        raise SystemExit(status)
    coherence = float(np.median(np.asarray(load(target).coherence)))
    return {"wall": wall, "cpu": cpu, "peak": peak(), "told": f"median coherence {coherence:.3f}"}


def write_uff(path: Path, gigabytes: float) -> None:
    """Receptances of 5,000 lines by our own writer, one set repeated under other node numbers."""
    import jax

    jax.config.update("jax_enable_x64", True)
    import numpy as np

    from modalax.data import FRF
    from modalax.files import save

    lines = 5000
    rng = np.random.default_rng(0)
    H = rng.normal(size=(lines, 50, 1)) + 1j * rng.normal(size=(lines, 50, 1))
    names = [f"{k}:+Z" for k in range(1000000, 1000050)]
    save(FRF(1.0 + np.arange(lines), H, form="receptance", outputs=names, inputs=["1:+Z"]), path)
    content = path.read_bytes()
    start = content.find(b"    -1\n    58b") if b"    -1\n    58b" in content else content.find(b"    -1\r\n    58b")
    head, body = content[:start], content[start:]
    with path.open("wb") as f:
        f.write(head)
        for k in range(int(np.ceil((gigabytes * 1e9 - len(head)) / len(body)))):
            f.write(body.replace(b"  10000", b"  1%04d" % k))


def uff(path: str, what: str) -> dict:
    """Index or read the file, by our reader or by pyuff."""
    import jax

    jax.config.update("jax_enable_x64", True)
    import pyuff

    from modalax.files import load
    from modalax.files.uff_index import index_of

    began = time.perf_counter(), time.process_time()
    if what == "index":
        told = f"{len(index_of(Path(path)))} sets"
    elif what == "read":
        told = f"{load(path, conjugate=False).H.shape[2]} outputs"
    elif what == "pyuff index":
        told = f"{len(pyuff.UFF(path).get_set_types())} sets"
    else:
        told = f"{len(pyuff.UFF(path).read_sets())} sets"
    wall, cpu = time.perf_counter() - began[0], time.process_time() - began[1]
    return {"wall": wall, "cpu": cpu, "peak": peak(), "told": told}


def write_frfs(path: Path, scale: float) -> None:
    """FRFs of 40 modes with 1 % noise, written to a Zarr store output by output."""
    import numpy as np
    import zarr

    outputs, inputs, lines, modes = int(2000 * scale), 8, int(8000 * scale), 40
    rng = np.random.default_rng(0)
    freq = np.linspace(1.0, 200.0, lines)
    w = 2 * np.pi * np.linspace(10, 190, modes)
    poles = w * (-0.004 + 1j * np.sqrt(1 - 0.004**2))
    s = 2j * np.pi * freq[:, None]
    kernels = 1 / (s - poles) / (2j * poles.imag) - 1 / (s - poles.conj()) / (2j * poles.imag)
    shapes, places = rng.normal(size=(modes, outputs)), rng.normal(size=(modes, inputs))
    group = zarr.open_group(str(path), mode="w", zarr_format=2)
    H = group.create_array(
        "H", shape=(1, lines, outputs, inputs), chunks=(1, lines, 50, inputs), dtype="complex128", compressors=None
    )
    for o in range(0, outputs, 50):
        part = kernels @ (shapes[:, o : o + 50, None] * places[:, None]).reshape(modes, -1)
        size = 0.01 * np.sqrt(np.mean(np.abs(part) ** 2)) / np.sqrt(2)
        part = part + size * (rng.normal(size=part.shape) + 1j * rng.normal(size=part.shape))
        H[0, :, o : o + 50] = part.reshape(lines, -1, inputs)
    np.savez(path.with_suffix(".facts.npz"), freq=freq, poles=poles)


def fit(path: str) -> dict:
    """Poles and the stable ones of FRFs in a Zarr store."""
    import jax

    jax.config.update("jax_enable_x64", True)
    import numpy as np
    import zarr

    from modalax.identify.chunked import diagram_of_chunks, outputs_in_turn

    facts = np.load(Path(path).with_suffix(".facts.npz"))
    began = time.perf_counter(), time.process_time()
    H = zarr.open_group(path, mode="r")["H"]
    _, found = diagram_of_chunks(facts["freq"], outputs_in_turn(H), range(2, 16))
    wall, cpu = time.perf_counter() - began[0], time.process_time() - began[1]
    poles = np.asarray(found.poles)
    near = np.abs(poles[:, None] - facts["poles"]).min(axis=0) / np.abs(facts["poles"].real)
    told = f"{int(np.sum(near < 1.0))} of {len(near)} modes within their half-bandwidth"
    return {"wall": wall, "cpu": cpu, "peak": peak(), "told": told}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("parts", nargs="*", metavar="PART", help="records, uff, fit; all if none is given")
    parser.add_argument("--gigabytes", type=float, default=4.0, help="size of the records")
    parser.add_argument("--limit", type=float, default=1.2, help="memory for data while they are read [GB]")
    parser.add_argument("--uff-gigabytes", type=float, default=1.0)
    parser.add_argument("--scale", type=float, default=1.0, help="part of the outputs and of the lines to fit")
    parser.add_argument("--csv", help="file for the table")
    parser.add_argument("--part", nargs="+", help=argparse.SUPPRESS)
    args = parser.parse_args()
    if args.part:
        what, path, *rest = args.part
        sides = {
            "records": lambda: records(path, args.limit),
            "uff": lambda: uff(path, rest[0]),
            "fit": lambda: fit(path),
        }
        print("\n" + json.dumps(sides[what]()))
        return
    print(machine() + "\n")
    head = ("part", "size [GB]", "wall [s]", "CPU [s]", "GB a CPU second", "largest memory [GB]", "found")
    table = Table(head, args.csv)
    with tempfile.TemporaryDirectory() as folder:
        runs = {
            "records": (Path(folder) / "records.npy", lambda p: write_records(p, args.gigabytes), [""]),
            "uff": (
                Path(folder) / "large.uff", lambda p: write_uff(p, args.uff_gigabytes),
                ["index", "read", "pyuff index", "pyuff read"],
            ),
            "fit": (Path(folder) / "frfs.zarr", lambda p: write_frfs(p, args.scale), [""]),
        }  # fmt: skip
        for part in args.parts or runs:
            path, write, whats = runs[part]
            write(path)
            files = [f for f in path.rglob("*") if f.is_file()] if path.is_dir() else [path]
            size = sum(f.stat().st_size for f in files) / 1e9
            for what in whats:
                options = ["--limit", args.limit, "--part", part, path, what]
                r = call([sys.executable, __file__, *options])
                table.add(
                    f"{part} {what}".strip(), f"{size:.2f}", f"{r['wall']:.1f}", f"{r['cpu']:.1f}",
                    f"{size / r['cpu']:.2f}", f"{r['peak'] / 1024:.2f}", r["told"],
                )  # fmt: skip
            for file in files:
                file.unlink()


if __name__ == "__main__":
    main()
