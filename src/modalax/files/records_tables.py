"""Time records from tables that hold little else: one NumPy array, CSV or other text, WAV."""

import itertools
import re
import warnings
from pathlib import Path

import numpy as np

from modalax.data.recording import Recording, rate_of
from modalax.data.streaming import HEAD, Streamed
from modalax.files.guard import reading
from modalax.files.lines import LONGEST_LINE, lines_of, table_of
from modalax.files.npz import check_header
from modalax.files.units import TIMES, plain

MOST_HEADINGS = 10_000
STREAMED = 2**28  # bytes above which an array stays in its file and is read piece by piece
_TIME = re.compile(r"^\s*(t|time|zeit|temps)\b", re.IGNORECASE)
_UNIT = re.compile(r"^(?P<name>.*?)\s*[\[(](?P<unit>[^\[\]()]*)[\])]\s*$")


def recording_of(table: np.ndarray, fs: float | None, names: list[str], units: list[str]) -> Recording:
    """A recording from columns ``(t, column)``; a column of evenly rising time gives the rate.

    Raises
    ------
    ValueError
        If there is no rate, or nothing but time.
    """
    time = next((k for k, name in enumerate(names) if _TIME.match(name)), None)
    if time is None and _is_time(table[:, 0]):
        time = 0
        warnings.warn(f"column 1 rises evenly from {table[0, 0]:g} and is taken as time in s", stacklevel=2)
    keep = [k for k in range(table.shape[1]) if k != time]
    if not keep:
        raise ValueError(f"holds {table.shape[1]} columns, none beside time; a force and a response are needed")
    if time is not None:
        factor = TIMES.get(plain(units[time]), 1.0)
        own = rate_of(table[:, time] * factor)
        if fs is not None and abs(own - fs) > 1e-3 * fs:
            warnings.warn(f"its time column says {own:g} Hz; the {fs:g} Hz asked for count", stacklevel=2)
        fs = own if fs is None else fs
    if fs is None:
        raise ValueError(
            f"holds no sampling rate ({len(table)} samples of {table.shape[1]} channels); give it in Hz (fs, --fs)"
        )
    return Recording(
        np.ascontiguousarray(table[None][:, :, keep]), fs, tuple(names[k] or f"channel {k + 1}" for k in keep),
        tuple(units[k] for k in keep), tuple(k + 1 for k in keep),
    )  # fmt: skip


def _is_time(column: np.ndarray) -> bool:
    if len(column) < 4 or not np.isfinite(column).all():
        return False
    try:
        rate_of(column)
    except ValueError:
        return False
    return True


def split_unit(label: str) -> tuple[str, str]:
    """Name and unit of a heading such as ``Force [N]`` or ``acc (m/s^2)``."""
    found = _UNIT.match(label.strip())
    return (found["name"].strip(), found["unit"].strip()) if found else (label.strip(), "")


def read_npy(path: Path, fs: float | None) -> Recording:
    """One array, time along its longest axis: ``(channel, t)``, ``(t, channel)`` or ``(segment, channel, t)``.

    Raises
    ------
    ValueError
        If it holds no numbers, is damaged, or its rate is not known.
    """
    with reading("the .npy file"), path.open("rb") as file:
        check_header(file, path.stat().st_size, "the .npy file")
        file.seek(0)
        if path.stat().st_size > STREAMED:
            return streamed(np.load(path, mmap_mode="r"), fs)
        value = np.lib.format.read_array(file, allow_pickle=False)
    return from_array(value, fs, "")


def streamed(value: np.ndarray, fs: float | None) -> Recording:
    """A recording whose samples stay in their file; names, rate and what is time are told from its beginning.

    Raises
    ------
    ValueError
        As of :func:`from_array`.
    """
    long = np.moveaxis(value, int(np.argmax(value.shape)), -1) if value.ndim else value
    head = from_array(np.array(long[..., :HEAD]), fs, "")
    rows = long if long.ndim == 3 else np.atleast_2d(long)[None]
    keep = slice(head.numbers[0] - 1, None)  # only a first column can be time here
    return Streamed(rows[:, keep].transpose(0, 2, 1), head.fs, head.channels, head.units, head.numbers)


def from_array(value: np.ndarray, fs: float | None, name: str) -> Recording:
    """A recording from one array of numbers, time along its longest axis.

    Raises
    ------
    ValueError
        If it has no or more than three axes, or no numbers.
    """
    value = np.asarray(value)
    if value.dtype.kind not in "iuf" or not 1 <= value.ndim <= 3 or min(value.shape) == 0:
        raise ValueError(
            f"holds {value.dtype} of shape {value.shape}; records are real numbers of shape (channel, t), (t, channel) "
            "or (segment, channel, t)"
        )
    value = np.moveaxis(value.astype(float), int(np.argmax(value.shape)), -1)
    label = lambda count: [f"{name or 'channel'} {k + 1}" for k in range(count)]
    if value.ndim < 3:
        rows = np.atleast_2d(value)
        return recording_of(rows.T, fs, label(len(rows)), [""] * len(rows))
    warnings.warn(
        f"an array of shape {value.shape} is taken as {value.shape[0]} records of {value.shape[1]} channels",
        stacklevel=2,
    )
    first = recording_of(value[0].T, fs, label(value.shape[1]), [""] * value.shape[1])
    keep = [k - 1 for k in first.numbers]
    data = np.ascontiguousarray(value[:, keep].transpose(0, 2, 1))
    return Recording(data, first.fs, first.channels, first.units, first.numbers)


def read_wav(path: Path, fs: float | None) -> Recording:
    """A WAV file; whole numbers are brought to shares of full scale.

    Raises
    ------
    ValueError
        If it is damaged.
    """
    from scipy.io import wavfile

    with reading("the WAV file"), warnings.catch_warnings():
        warnings.simplefilter("ignore", wavfile.WavFileWarning)
        rate, data = wavfile.read(path)
    data = np.reshape(data, (len(data), -1))
    if data.dtype.kind in "iu":
        middle = 128.0 if data.dtype == np.uint8 else 0.0
        full = 128.0 if data.dtype == np.uint8 else float(np.iinfo(data.dtype).max) + 1
        data = data.astype(float)
        data -= middle
        data /= full
        warnings.warn(
            "its samples are shares of full scale, not physical units; scale each channel by what full scale is",
            stacklevel=2,
        )
    if fs is not None and fs != rate:
        warnings.warn(f"the file says {rate:g} Hz; the {fs:g} Hz asked for count", stacklevel=2)
    names = [f"channel {k + 1}" for k in range(data.shape[1])]
    return Recording(
        np.asarray(data, float)[None],
        float(fs or rate),
        tuple(names),
        ("",) * len(names),
        tuple(range(1, len(names) + 1)),
    )


def read_text(path: Path, fs: float | None) -> Recording:
    """Columns of numbers under lines of headings: commas, semicolons, tabs or blanks between; a comma in decimals too.

    Raises
    ------
    ValueError
        If there are no columns of numbers, or a line has another number of them.
    """
    separator, comma = _layout(_last_line(path))
    split = lambda line: [c.strip().strip('"') for c in (line.split(separator) if separator else line.split())]
    number = (lambda c: c.replace(",", ".")) if comma else (lambda c: c)
    rows, heads, first, values = lines_of(path, "%"), [], (0, ""), None
    for first in rows:
        values = _numbers(split(first[1]), number)
        if values is not None:
            break
        heads.append(first[1])
        if len(heads) > MOST_HEADINGS:
            break
    if len(heads) > MOST_HEADINGS or values is None:
        raise ValueError(f"holds no line of numbers; its first line is {(heads or [''])[0][:60]!r}")

    def numbers(line: str, place: int) -> list[float]:
        found = _numbers(split(line), number)
        if found is None or len(found) != len(values):
            raise ValueError(f"line {place} reads {line[:60]!r}; {len(values)} numbers as before are needed")
        return found

    table = table_of(itertools.chain([first], rows), numbers, len(values))
    names, units = _headings([split(line) for line in heads], table.shape[1])
    try:
        return recording_of(table, fs, names, units)
    except ValueError as error:
        bad = ~np.isfinite(table).all(axis=1)
        if not bad.any():
            raise
        place = next(itertools.islice(lines_of(path, "%"), len(heads) + int(bad.argmax()), None))[0]
        raise ValueError(f"line {place}: {error}") from error


def _last_line(path: Path) -> str:
    """The last line with something in it."""
    with path.open("rb") as file:
        file.seek(max(0, path.stat().st_size - LONGEST_LINE))
        lines = file.read().decode("latin-1").splitlines()
    return next((line for line in reversed(lines) if line.strip() and not line.lstrip().startswith("%")), "")


def _layout(last: str) -> tuple[str, bool]:
    """Separator (empty: blanks) and whether decimals have a comma, from the last line of the file."""
    for separator in (";", "\t"):
        if separator in last.strip():
            return separator, "," in last
    if "," in last:
        alone = re.fullmatch(r"\s*[-+]?\d+,\d+(\s+[-+]?\d+,\d+)*\s*", last) and " " in last.strip()
        return ("", True) if alone else (",", False)
    return "", False


def _numbers(cells: list[str], number) -> list[float] | None:
    cells = cells[:-1] if len(cells) > 1 and not cells[-1] else cells
    try:
        return [float(number(c)) for c in cells]
    except ValueError:
        return None


def _headings(rows: list[list[str]], columns: int) -> tuple[list[str], list[str]]:
    """Names from the first heading with a cell for each column, units from brackets or from the next such line."""
    rows = [[c.lstrip("#").strip() for c in row] for row in rows]
    fitting = [row[:columns] for row in rows if columns <= len([*row]) <= columns + 1 and any(row)]
    if not fitting:
        return [f"channel {k + 1}" for k in range(columns)], [""] * columns
    named = [split_unit(c) for c in fitting[0]]
    names, units = [n for n, _ in named], [u for _, u in named]
    if not any(units) and len(fitting) > 1:
        units = [c.strip("[]() ") for c in fitting[1]]
    return names, units
