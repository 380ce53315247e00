"""``modalax frf``: FRFs from time records."""

import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated, Any

import typer

from modalax.cli.common import BandOption, OverwriteOption, check_free, note, start, working
from modalax.files.messages import naming
from modalax.files.record_kinds import kind_of

RecordsArgument = Annotated[
    list[Path], typer.Argument(metavar="RECORDS...", help="Time records: UFF 58, mat, npy, npz, csv, wav or HDF5.")
]
PAIR = "Repeat the option for several."


def frf(
    records: RecordsArgument,
    target: Annotated[Path, typer.Option("--out", "-o", metavar="DATA", help="File of FRFs to write (npz, uff, ...).")],
    force: Annotated[
        list[str] | None,
        typer.Option("--force", metavar="CH", help=f"Force channel, by name or number. {PAIR}"),
    ] = None,
    response: Annotated[
        list[str] | None, typer.Option("--response", metavar="CH", help=f"Response channel, by name or number. {PAIR}")
    ] = None,
    fs: Annotated[float | None, typer.Option("--fs", metavar="HZ", help="Sampling rate, if the file has none.")] = None,
    array: Annotated[
        str, typer.Option("--array", metavar="NAME", help="Name of the array to read, if the file holds several.")
    ] = "",
    unit: Annotated[
        str | None,
        typer.Option("--unit", metavar="U", help="Unit of responses that have none: m, mm, m/s, m/s^2, g ..."),
    ] = None,
    units: Annotated[
        list[str] | None, typer.Option("--units", metavar="CH=U", help=f"Unit of one channel. {PAIR}")
    ] = None,
    scale: Annotated[
        list[str] | None,
        typer.Option("--scale", metavar="CH=X", help=f"Factor by which the values of a channel are multiplied. {PAIR}"),
    ] = None,
    names: Annotated[
        list[str] | None,
        typer.Option("--name", metavar="CH=DOF", help=f"DoF measured by one channel, such as 12:+Z. {PAIR}"),
    ] = None,
    kind: Annotated[
        str | None,
        typer.Option(
            "--kind", help="Excitation: hits, multisine, stepped, sweep, blocks or random; found from the force."
        ),
    ] = None,
    time: Annotated[
        tuple[float, float] | None,
        typer.Option("--time", metavar="FROM TO", help="Part of the records to use, in seconds.", show_default=False),
    ] = None,
    runs: Annotated[
        bool, typer.Option("--runs", help="Make each file a run, for example at another force level.")
    ] = False,
    level: Annotated[
        list[float] | None, typer.Option("--level", metavar="N", help=f"Force amplitude of each run in N. {PAIR}")
    ] = None,
    band: BandOption = None,
    estimator: Annotated[str, typer.Option("--estimator", help="FRF estimator: H1, H2 or Hv.")] = "H1",
    block: Annotated[
        float | None,
        typer.Option("--block", metavar="S", help="Length of a block, or of the record of a hit, in seconds."),
    ] = None,
    overlap: Annotated[
        float, typer.Option("--overlap", help="Overlap of the blocks of random excitation, as a fraction.")
    ] = 0.5,
    window: Annotated[str, typer.Option("--window", help="Window on the blocks of random excitation.")] = "hann",
    period: Annotated[
        int | None,
        typer.Option("--period", metavar="SAMPLES", help="Period of a multisine; found from the force if not given."),
    ] = None,
    skip: Annotated[
        int | None,
        typer.Option("--skip", metavar="PERIODS", help="Periods left out at the start, while the response settles."),
    ] = None,
    trigger: Annotated[
        float, typer.Option("--trigger", help="Force at which a hit begins, as a fraction of the largest force.")
    ] = 0.2,
    pretrigger: Annotated[
        float | None, typer.Option("--pretrigger", metavar="S", help="Time kept before a hit, in seconds.")
    ] = None,
    contact: Annotated[
        float | None,
        typer.Option("--force-window", metavar="S", help="Set the force to zero this many seconds after a hit begins."),
    ] = None,
    remainder: Annotated[
        float | None,
        typer.Option(
            "--exponential", metavar="SHARE", help="Exponential window on hits that falls to this fraction at the end."
        ),
    ] = None,
    keep_all: Annotated[
        bool, typer.Option("--keep-all", help="Keep hits that are double or overload a channel.")
    ] = False,
    roving: Annotated[
        int,
        typer.Option("--roving", metavar="N", help="Roving hammer: N hits at each point, one point after the other."),
    ] = 0,
    overwrite: OverwriteOption = False,
) -> None:
    """Estimate FRFs, coherence and noise from time records; several files are repeats, or runs with --runs."""
    check_free(target, overwrite=overwrite, inputs=records, data=True)
    for path in records:
        kind_of(path)
    start()
    import numpy as np

    from modalax.data import Measurement
    from modalax.data.recording import of_one_length
    from modalax.data.reduction import common_lines, frf_from_recording
    from modalax.files import load_records, save

    choices: dict[str, Any] = {
        "kind": kind, "block": block, "overlap": overlap, "window": window, "estimator": estimator, "band": band,
        "period": period, "skip": skip, "trigger": trigger, "pretrigger": pretrigger, "contact": contact,
        "remainder": remainder, "keep_all": keep_all, "roving": roving,
    }  # fmt: skip
    called = _pairs(names, "--name")
    factors = {channel: _number(value, "--scale") for channel, value in _pairs(scale, "--scale").items()}
    in_units = _pairs(units, "--units")
    ends = {"force": _as_in_file(force, called), "response": _as_in_file(response, called)}
    _check_levels(level, len(records) if runs else 1)
    taken, frfs, said = [], [], set()
    with working("Estimating FRFs") as step:
        for paths in [[p] for p in records] if runs else [records]:
            step(f"reading {', '.join(p.name for p in paths[:3])}{' ...' if len(paths) > 3 else ''}")
            with naming(*paths), _once(said, paths):
                recording = load_records(paths, fs=fs, array=array)
                recording = recording if time is None else recording.between(*time)
                recording = recording.with_units(in_units).scaled(factors)
            taken.append(recording)
        for k, recording in enumerate(of_one_length(taken)):
            step(f"averaging spectra{f' of run {k + 1}' if runs else ''}")
            paths = [records[k]] if runs else records
            with naming(*paths), _once(said, paths):
                frf = frf_from_recording(recording, **ends, unit=unit, **choices)
                # A drive point gives its name to two channels, so they are named where force and response are parted.
                outputs, inputs = (
                    [new.get(name, name) for name in side]
                    for new, side in zip(_new_names(recording, called), (frf.outputs, frf.inputs), strict=True)
                )
                frfs.append(frf.replace(outputs=outputs, inputs=inputs))
    if level:
        frfs = [f.replace(level=amount) for f, amount in zip(frfs, level, strict=True)]
    with naming(*records):
        measurement = Measurement.from_frfs(common_lines(frfs))
    save(measurement, target, overwrite=overwrite)
    typer.echo(_told(measurement, frfs, taken[0].fs))
    if runs and not np.isfinite(np.asarray(measurement.level)).all():
        note("the force level of the runs is not known, because the excitation is no sine; give it in N with --level")
    note(f"{target} written")


@contextmanager
def _once(said: set[str], paths: list[Path]) -> Iterator[None]:
    """Print each warning once, however many files it comes from, also where an error ends the work."""
    with warnings.catch_warnings(record=True) as heard:
        warnings.simplefilter("always", UserWarning)
        try:
            yield
        finally:
            for warning in heard:
                bare = str(warning.message).removeprefix(f"{paths[0]}: ")
                if issubclass(warning.category, UserWarning) and bare not in said:
                    said.add(bare)
                    note(f"note: {' '.join(str(warning.message).split())}")


def _as_in_file(wanted: list[str] | None, new: dict[str, str]) -> list[str]:
    """The names in the file of channels that may be asked for under their new ones."""
    old = {name: channel for channel, name in new.items()}
    return [c if c in new else old.get(c, c) for c in wanted or []]


def _new_names(recording: Any, called: dict[str, str]) -> tuple[dict[str, str], dict[str, str]]:
    """New names of the outputs and of the inputs; of a force and a response of one name only the one asked for."""
    outputs, inputs = {}, {}
    for old, name in called.items():
        k = recording.index(old)
        channel = recording.channels[k]
        alone = recording.channels.count(channel) == 1
        for side, is_force in ((outputs, False), (inputs, True)):
            if alone or recording.is_force(k) == is_force:
                side[channel] = name
    return outputs, inputs


def _pairs(given: list[str] | None, option: str) -> dict[str, str]:
    pairs = {}
    for one in given or []:
        channel, equals, value = one.rpartition("=")
        if not equals or not channel or not value:
            raise ValueError(f"{option} {one}: needs CHANNEL=VALUE, such as 2=g")
        pairs[channel] = value
    return pairs


def _number(text: str, option: str) -> float:
    try:
        return float(text)
    except ValueError:
        raise ValueError(f"{option} {text}: a number is needed") from None


def _check_levels(level: list[float] | None, runs: int) -> None:
    if level and len(level) != runs:
        raise ValueError(f"--level is given {len(level)} times for {runs} runs; each run needs one, with --runs")


def _told(measurement: Any, frfs: list[Any], fs: float) -> str:
    """One line about the FRFs that were made from the records."""
    import numpy as np

    runs, lines, outputs, inputs = measurement.H.shape
    freq = np.asarray(measurement.freq)
    text = [
        f"{measurement.form}, {runs} run{'s' * (runs > 1)} of {outputs} output{'s' * (outputs > 1)} and {inputs} "
        f"input{'s' * (inputs > 1)}, {lines} lines from {freq[0]:.6g} to {freq[-1]:.6g} Hz, sampled at {fs:g} Hz"
    ]
    # Of several forces that act at once each explains a part of the response only, however good the test.
    several = any(f.multiple_coherence is not None for f in frfs)
    explained = [f.multiple_coherence if several else f.coherence for f in frfs]
    if all(part is not None for part in explained):
        share = np.median(np.concatenate([np.ravel(part) for part in explained]))
        text.append(f"median {'multiple ' * several}coherence {share:.4f}")
    if measurement.variance is not None:
        size = np.maximum(np.abs(np.asarray(measurement.H)), np.finfo(float).tiny)
        noise = np.median(np.sqrt(np.asarray(measurement.variance)) / size)
        text.append(f"median noise {100 * noise:.2g} % of the FRFs")
    text.append(f"{measurement.averages} averages" if measurement.averages else "no averages")
    if float(measurement.added_decay):
        text.append(f"added decay {float(measurement.added_decay):.4g} 1/s, which a fit removes")
    return "; ".join(text)
