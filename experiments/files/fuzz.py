"""Damaged and hostile files of every format: each is refused in one line, or what it holds is sound.

A sound file is damaged (bytes flipped, cut out, put in, repeated, taken from another file; numbers in text replaced by
extreme ones; arrays of a wrong shape, type or value), then loaded. Failures are: an error that is neither a ValueError
nor one of the operating system or that does not name the file in one line; over ten seconds; over twice the file's
size and 1 GB of memory; anything executed; anything accepted that the file contract refuses.

usage: python experiments/files/fuzz.py [--files 10000] [--seed 0] [FORMAT ...]
"""

import argparse
import contextlib
import random
import resource
import shutil
import signal
import sys
import tempfile
import time
import warnings
from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import jax
import numpy as np

jax.config.update("jax_enable_x64", True)

import modalax  # noqa: E402
from modalax.data import Measurement  # noqa: E402
from modalax.files.arrays import to_arrays  # noqa: E402
from modalax.model import ModalModel  # noqa: E402
from modalax.model.examples import five_dof  # noqa: E402

SECONDS, BYTES = 10, 1e9
FORMATS = (
    "npz",
    "npz_structure",
    "npz_modes",
    "uff_text",
    "uff_binary",
    "uff_modes",
    "mat",
    "mat73",
    "nc",
    "zarr",
    "csv",
)
EXECUTION = (
    "pickle.find_class",
    "os.system",
    "os.exec",
    "os.posix_spawn",
    "os.fork",
    "subprocess.Popen",
    "socket.connect",
)
executed: list[str] = []
EXTREME = [b"nan", b"inf", b"-inf", b"1e999", b"1e308", b"-1", b"0", b"99999999999", b"1.5", b"", b"x", b"-6", b"58b"]


def measurement() -> Measurement:
    """A small sound measurement with everything in it."""
    freq = np.linspace(10.0, 30.0, 24)
    frf = five_dof().frf(freq, inputs=["1"], outputs=["1", "2"])
    H = np.asarray(frf.H)[None] * np.array([1.0, 0.9])[:, None, None, None]
    return Measurement(
        freq, H, variance=np.abs(H) ** 2 * 1e-4, coherence=np.full(H.shape, 0.99), level=[1.0, 2.0], averages=5,
        outputs=["1:+Z", "2:+Z"], inputs=["1:+Z"],
    )  # fmt: skip


def sound_files(folder: Path) -> dict[str, Path]:
    """One sound file of each format."""
    model = five_dof().modal()
    model = model.replace(outputs=[f"{n}:+X" for n in model.outputs], inputs=[f"{n}:+X" for n in model.inputs])
    what = {
        "npz": ("npz", measurement(), {}), "npz_structure": ("npz", five_dof(), {}), "npz_modes": ("npz", model, {}),
        "uff_text": ("uff", measurement(), {"binary": False}), "uff_binary": ("uff", measurement(), {}),
        "uff_modes": ("uff", model, {}), "mat": ("mat", measurement(), {}), "nc": ("nc", measurement(), {}),
        "zarr": ("zarr", measurement(), {}),
    }  # fmt: skip
    paths = {}
    for name, (ending, value, options) in what.items():
        paths[name] = folder / f"{name}.{ending}"
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            modalax.save(value, paths[name], **options)
    paths["csv"] = folder / "csv.csv"
    write_table(paths["csv"], measurement())
    paths["mat73"] = folder / "mat73.mat"
    write_mat73(paths["mat73"], to_arrays(measurement()))
    return paths


def write_table(path: Path, data: Measurement) -> None:
    """A table of real and imaginary parts."""
    H = np.asarray(data.H)[0].reshape(len(data.freq), -1)
    names = [f"{o}/{i}" for o in data.outputs for i in data.inputs]
    rows = [["freq", *(f"{part} {name}" for name in names for part in ("re", "im"))]]
    for f, line in zip(np.asarray(data.freq), H, strict=True):
        rows.append([f"{v:.12g}" for v in (f, *(p for value in line for p in (value.real, value.imag)))])
    path.write_text("\n".join(",".join(row) for row in rows) + "\n", encoding="utf-8")


def write_mat73(path: Path, arrays: dict[str, Any]) -> None:
    """A file as MATLAB writes it since version 7.3: 512 bytes of its own, then HDF5 with the axes reversed."""
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
            else:
                file[name] = value.T
    content = bytearray(path.read_bytes())
    content[:19] = b"MATLAB 7.3 MAT-file"
    path.write_bytes(bytes(content))


def damaged(content: bytes, other: bytes, rng: random.Random) -> bytes:
    """Damage some bytes."""
    data = bytearray(content)
    for _ in range(rng.choice([1, 1, 2, 4, 16])):
        at, count = rng.randrange(len(data) + 1), rng.choice([1, 2, 4, 8, 64, 512])
        kind = rng.choice(["flip", "random", "zeros", "ones", "cut", "insert", "repeat", "splice", "end", "number"])
        if kind == "flip" and at < len(data):
            data[at] ^= 1 << rng.randrange(8)
        elif kind in ("random", "zeros", "ones"):
            fill = {"random": rng.randbytes(count), "zeros": bytes(count), "ones": b"\xff" * count}[kind]
            data[at : at + count] = fill[: max(0, len(data) - at)]
        elif kind == "cut":
            del data[at : at + count]
        elif kind == "insert":
            data[at:at] = rng.randbytes(count)
        elif kind == "repeat":
            data[at:at] = data[at : at + count]
        elif kind == "splice":
            start = rng.randrange(len(other))
            data[at : at + count] = other[start : start + count]
        elif kind == "end" and rng.random() < 0.3:
            del data[at:]
        elif kind == "number":
            number = rng.choice([2**31 - 1, 2**32 - 1, 2**24, 10**12, 0])
            data[at : at + 8] = number.to_bytes(8, rng.choice(["little", "big"]))
    return bytes(data)


def retold(content: bytes, rng: random.Random) -> bytes:
    """Replace a word of a text by an extreme one of the same width."""
    lines = content.split(b"\n")
    for _ in range(rng.choice([1, 2, 5])):
        if not lines:
            break
        k = rng.randrange(min(len(lines), 60)) if rng.random() < 0.6 else rng.randrange(len(lines))
        words = lines[k].replace(b",", b" ").split()
        if words:
            word, new = rng.choice(words), rng.choice(EXTREME)
            width = max(len(word), len(new))
            lines[k] = lines[k].replace(word.rjust(width), new.rjust(width), 1).replace(word, new.rjust(len(word)), 1)
        if rng.random() < 0.1:
            del lines[k]
    return b"\n".join(lines)


def hostile(arrays: dict[str, Any], rng: random.Random) -> dict[str, Any]:
    """Arrays of which one or two have a wrong value, shape or type, or are missing."""
    arrays = {name: np.array(value) for name, value in arrays.items()}
    for _ in range(rng.choice([1, 1, 2])):
        name = rng.choice(sorted(arrays))
        value = arrays[name]
        choices: list[Callable[[], Any]] = [
            lambda v=value: v[None], lambda v=value: np.ravel(v), lambda v=value: np.zeros((0, *v.shape)),
            lambda: np.array(np.nan), lambda: np.array(np.inf), lambda: np.array(-1.0), lambda: np.array("x" * 3000),
            lambda: np.array(["a", ""]), lambda: np.array([], dtype=str), lambda: np.array(0),
            lambda: np.array([b"\xff"]),
            lambda v=value: np.swapaxes(v, 0, -1) if v.ndim > 1 else v[::-1] if v.ndim else v,
            lambda v=value: np.abs(v) if v.dtype.kind in "fc" else v, lambda: np.zeros(3, dtype="M8[s]"),
            lambda v=value: v * np.nan if v.dtype.kind in "fc" else v, lambda: np.ones((2, 2), dtype=bool),
            lambda v=value: v * 1e300 if v.dtype.kind in "fc" else v, lambda v=value: -v if v.dtype.kind in "fc" else v,
            lambda v=value: v * 0 if v.dtype.kind in "fc" else v, lambda: np.zeros(2, dtype=[("a", "f8")]),
            lambda: np.arange(50000).astype(str),
        ]  # fmt: skip
        if rng.random() < 0.1:
            arrays.pop(name)
        else:
            arrays[name] = rng.choice(choices)()
        if not arrays:
            break
    return arrays


def write_hostile(name: str, path: Path, rng: random.Random) -> None:
    """A well-formed file with wrong content."""
    import scipy.io

    base = {"npz_structure": five_dof, "npz_modes": lambda: five_dof().modal()}.get(name, measurement)()
    arrays = hostile(to_arrays(base), rng)
    if name.startswith("npz"):
        (np.savez if rng.random() < 0.5 else np.savez_compressed)(path, **arrays)
    elif name == "mat":
        whole = {k: np.ascontiguousarray(v).reshape(v.shape) for k, v in arrays.items() if v.dtype.kind not in "M"}
        scipy.io.savemat(path, whole, do_compression=True)
    else:
        write_mat73(path, {k: v for k, v in arrays.items() if v.dtype.kind in "fciuU"})


def damage_store(path: Path, rng: random.Random) -> None:
    """Damage, remove or empty a file of a Zarr store."""
    files = sorted(p for p in path.rglob("*") if p.is_file())
    chosen, kind = rng.choice(files), rng.random()
    content = chosen.read_bytes()
    if kind < 0.15:
        chosen.unlink()
    elif kind < 0.25:
        chosen.write_bytes(b"")
    elif chosen.name.startswith(".") and kind < 0.8:
        chosen.write_bytes(retold(content, rng))
    else:
        chosen.write_bytes(damaged(content, rng.choice(files).read_bytes() or b"x", rng))


def make(name: str, sound: dict[str, Path], folder: Path, rng: random.Random) -> Path:
    """One damaged file."""
    source = sound[name]
    path = folder / source.name
    if path.is_dir():
        shutil.rmtree(path)
    if name == "zarr":
        shutil.copytree(source, path)
        damage_store(path, rng)
        return path
    if name in ("npz", "npz_structure", "npz_modes", "mat", "mat73") and rng.random() < 0.5:
        write_hostile(name, path, rng)
        return path
    content, other = source.read_bytes(), rng.choice([p for p in sound.values() if p.is_file()]).read_bytes()
    text = name.startswith(("uff", "csv")) and rng.random() < 0.7
    path.write_bytes(retold(content, rng) if text else damaged(content, other, rng))
    return path


def unsound(found: Any) -> str:
    """What is wrong with an object that was loaded; nothing if it is sound."""
    names = {"M": ("M", "C", "K", "D"), "poles": ("poles", "shapes", "participation", "upper", "lower")}
    if isinstance(found, Measurement):
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
    mark = "poles" if isinstance(found, ModalModel) else "M"
    return ", ".join(n for n in names[mark] if not np.isfinite(np.asarray(getattr(found, n))).all())


@contextlib.contextmanager
def limited(seconds: int) -> Iterator[None]:
    """Stop what takes too long."""

    def late(*_: Any) -> None:
        raise TimeoutError(f"over {seconds} s")

    before = signal.signal(signal.SIGALRM, late)
    signal.alarm(seconds)
    try:
        yield
    finally:
        signal.alarm(0)
        signal.signal(signal.SIGALRM, before)


def tried(path: Path) -> tuple[str, str]:
    """Load a file: how it ended (``refused``, ``sound`` or a failure), and the words."""
    before, count = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss, len(executed)
    outcome, words = _loaded(path)
    grown = 1024 * (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before)
    size = sum(p.stat().st_size for p in [path, *path.rglob("*")] if p.is_file())
    if len(executed) > count:
        return "executed", str(executed[count:])
    if grown > 2 * size + BYTES:
        return "memory", f"{grown / 1e6:.0f} MB for a file of {size / 1e6:.3g} MB; {words}"
    return outcome, words


def _loaded(path: Path) -> tuple[str, str]:
    try:
        with warnings.catch_warnings(), limited(SECONDS):
            warnings.simplefilter("ignore")
            problem = unsound(modalax.load(path, **({"form": "receptance"} if path.suffix == ".csv" else {})))
        return ("accepted", problem) if problem else ("sound", "")
    except TimeoutError as error:
        return "hang", str(error)
    except (ValueError, OSError) as error:
        words = str(error)
        good = str(path) in words and "\n" not in words and "cannot be used: unexpected" not in words
        return ("refused" if good else "unclear"), words
    except BaseException as error:
        return "foreign", f"{type(error).__name__}: {error}"


def watch() -> None:
    """Take down everything that would execute something."""
    sys.addaudithook(lambda event, args: executed.append(event) if event.startswith(EXECUTION) else None)


def run(count: int, seed: int, formats: list[str], keep: Path | None = None) -> Iterator[tuple[str, str, str]]:
    """Try ``count`` files in turn over the formats; each as format, end and words."""
    rng = random.Random(seed)
    with tempfile.TemporaryDirectory() as name:
        (Path(name) / "sound").mkdir()
        sound = sound_files(Path(name) / "sound")
        for path in sound.values():
            assert _loaded(path)[0] == "sound", _loaded(path)
        for k in range(count):
            which = formats[k % len(formats)]
            path = make(which, sound, Path(name), rng)
            end, words = tried(path)
            if keep is not None and end not in ("refused", "sound"):
                keep.mkdir(exist_ok=True)
                (shutil.copytree if path.is_dir() else shutil.copy)(path, keep / f"{k}-{end}-{path.name}")
            yield which, end, words


def main(argv: list[str] | None = None) -> int:
    """Try as many files as the command line asks for, and count how they end."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("formats", nargs="*", default=list(FORMATS), metavar="FORMAT")
    parser.add_argument("--files", type=int, default=10000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--keep", type=Path, help="folder to keep the files that failed")
    options = parser.parse_args(argv)
    watch()
    ends: dict[str, Counter[str]] = {name: Counter() for name in options.formats}
    begin, failures = time.process_time(), 0
    for which, end, words in run(options.files, options.seed, options.formats, options.keep):
        ends[which][end] += 1
        if end not in ("refused", "sound"):
            failures += 1
            print(f"{which}: {end}: {words[:300]}", flush=True)
    for name, counted in ends.items():
        print(f"{name}: " + ", ".join(f"{n} {end}" for end, n in counted.most_common()))
    total: Counter[str] = sum(ends.values(), Counter())
    print(
        f"{total.total()} files: {total['refused']} refused in one line, {total['sound']} read and sound, "
        f"{failures} failures; {time.process_time() - begin:.0f} s of processor time"
    )
    return min(failures, 1)


if __name__ == "__main__":
    sys.exit(main())
