"""Damage to files: bytes, words of a text, arrays of wrong value, shape or type, files of a Zarr store."""

import random
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from fuzz_kinds import KINDS

EXTREME = (
    b"nan", b"inf", b"-inf", b"1e999", b"1e308", b"-1", b"0", b"99999999999", b"300000", b"1.5", b"", b"x", b"-6",
    b"58b", b"'", b"\xff",
)  # fmt: skip


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
            number, width = rng.choice([2**31 - 1, 2**32 - 1, 2**24, 10**12, 0, 300000]), rng.choice([4, 8])
            number &= 2 ** (8 * width) - 1
            data[at : at + width] = number.to_bytes(width, rng.choice(["little", "big"]))
    return bytes(data)


def retold(content: bytes, rng: random.Random) -> bytes:
    """Replace a word of a text by an extreme one of the same width; drop a line now and then."""
    lines = content.split(b"\n")
    for _ in range(rng.choice([1, 2, 5])):
        if not lines:
            break
        k = rng.randrange(min(len(lines), 60)) if rng.random() < 0.6 else rng.randrange(len(lines))
        words = lines[k].replace(b",", b" ").replace(b";", b" ").split()
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
    """One damaged file of a kind, in a folder."""
    source, kind = sound[name], KINDS[name]
    path = folder / source.name
    if path.is_dir():
        shutil.rmtree(path)
    if source.is_dir():
        shutil.copytree(source, path)
        damage_store(path, rng)
    elif kind.arrays is not None and kind.pack is not None and rng.random() < 0.5:
        kind.pack(path, hostile(kind.arrays(), rng))
    else:
        content, other = source.read_bytes(), rng.choice([p for p in sound.values() if p.is_file()]).read_bytes()
        text = kind.text and rng.random() < 0.7
        path.write_bytes(retold(content, rng) if text else damaged(content, other, rng))
    return path
