"""Simulated responses, benches and joints as text for ``print``."""

from typing import TYPE_CHECKING, Any

import numpy as np

from modalax.data.overview import UNITS, channels_text, counted, lines_text, shortened, unreadable

if TYPE_CHECKING:
    from modalax.simulate.backbone import Backbone
    from modalax.simulate.bench import Bench, Records
    from modalax.simulate.continuation import Branch
    from modalax.simulate.control import ControlledResponse
    from modalax.simulate.harmonic import Response
    from modalax.simulate.joints import Joint
    from modalax.simulate.stepped import SteppedSine


def of_response(found: "Response") -> str:
    """Lines, levels, harmonics and channels; how many points are solved, and the largest displacement."""
    if unreadable(found, found.freq):
        return repr(found)
    fold = int(np.asarray(found.at_fold).sum())
    return "\n".join([
        *_head("Harmonic balance", found),
        f"  harmonics: {', '.join(map(str, found.harmonics))}",
        f"  solved: {_part(found.converged)} points{f', {fold} at a fold' if fold else ''}",
        f"  largest displacement at the frequency of the force: {_largest(found.fundamental)} m",
    ])  # fmt: skip


def of_stepped(found: "SteppedSine") -> str:
    """Lines, levels and channels; how many points are settled, and the largest displacement."""
    if unreadable(found, found.freq):
        return repr(found)
    return "\n".join([
        *_head("Stepped sine", found),
        f"  settled: {_part(found.settled)} points",
        f"  largest displacement at the frequency of the force: {_largest(found.X)} m",
    ])  # fmt: skip


def of_controlled(found: "ControlledResponse") -> str:
    """Lines, the range of the force and channels."""
    if unreadable(found, found.freq):
        return repr(found)
    return "\n".join([
        f"Controlled response: {lines_text(np.asarray(found.freq))}",
        f"  force at {found.input}: {_range(found.force, 'N')}",
        f"  {counted(len(found.outputs), 'output')}: {shortened(found.outputs)}",
        f"  solved: {_part(found.converged)} lines",
    ])  # fmt: skip


def of_backbone(found: "Backbone") -> str:
    """How frequency and damping change over the amplitude."""
    if unreadable(found, found.amplitude):
        return repr(found)
    return "\n".join([
        f"Backbone over {counted(len(found.amplitude), 'amplitude')}: {_range(found.amplitude, 'm sqrt(kg)')}",
        f"  frequency: {_range(found.frequency_hz, 'Hz')}",
        f"  damping: {_range(100 * np.asarray(found.damping_ratio), '%')}",
        f"  harmonics: {', '.join(map(str, found.harmonics))}",
        f"  solved: {_part(found.converged)} amplitudes",
    ])  # fmt: skip


def of_branch(found: "Branch") -> str:
    """Points, range of frequencies and folds."""
    if unreadable(found, found.freq):
        return repr(found)
    valid = np.asarray(found.valid)
    freq, folds = np.asarray(found.freq)[valid], [f"{f:.6g}" for f in found.folds()]
    between = f" between {freq.min():.6g} and {freq.max():.6g} Hz" if len(freq) else ""
    turns = f"turns back at {shortened(folds)} Hz" if folds else "does not turn back"
    return f"Branch of {counted(len(freq), 'point')}{between}: {turns}"


def of_bench(bench: "Bench") -> str:
    """Structure, joints, channels and sampling."""
    if unreadable(bench):
        return repr(bench)
    joints = [f"  {joint} at {' - '.join(place)}" for joint, place in zip(bench.joints, bench.places, strict=True)]
    return "\n".join([
        f"Bench: {bench.form} [{UNITS[bench.form]}], sampled at {bench.fs:g} Hz",
        *channels_text(bench.outputs, bench.inputs),
        *(joints or ["  no joints"]),
        str(bench.structure),
    ])  # fmt: skip


def of_records(data: "Records") -> str:
    """Runs, duration, rate and channels."""
    if unreadable(data) or data.force.ndim != 3:
        return repr(data)
    runs, samples, _ = data.force.shape
    return "\n".join([
        f"Records of {counted(runs, 'run')}: {samples / data.fs:.6g} s, {counted(samples, 'sample')} at {data.fs:g} Hz",
        f"  {counted(len(data.outputs), 'output')} [{data.unit}]: {shortened(data.outputs)}",
        f"  {counted(len(data.inputs), 'input')} [N]: {shortened(data.inputs)}",
    ])  # fmt: skip


def of_joint(joint: "Joint") -> str:
    """Name and parameters with units."""
    if unreadable(joint) or any(np.ndim(value) for value in joint.parameters.values()):
        return repr(joint)
    sizes = [
        f"{name} = {float(np.asarray(value)):.6g} {joint.units[name].replace('-', '')}".strip()
        for name, value in joint.parameters.items()
    ]
    return f"{joint.slug}({', '.join(sizes)})"


def _head(title: str, found: Any) -> list[str]:
    levels = ", ".join(f"{x:.4g} N" for x in np.asarray(found.level)[:1])
    if len(found.level) > 1:
        levels = _range(found.level, "N")
    return [
        f"{title}: {lines_text(np.asarray(found.freq))}",
        f"  {counted(len(found.level), 'force level')}: {levels}",
        *channels_text(found.outputs, found.inputs),
    ]


def _part(good: Any) -> str:
    good = np.asarray(good)
    return f"{int(good.sum())} of {good.size}"


def _range(values: Any, unit: str) -> str:
    """First and last value of a series, and a largest or smallest one between them."""
    x = np.asarray(values)
    if not len(x):
        return f"none [{unit}]"
    low, high = x.min(), x.max()
    inner = [f"at most {high:.6g}"] if high > max(x[0], x[-1]) else []
    inner += [f"at least {low:.6g}"] if low < min(x[0], x[-1]) else []
    between = f" ({', '.join(inner)})" if inner else ""
    return f"{x[0]:.6g} to {x[-1]:.6g} {unit}{between}"


def _largest(x: Any) -> str:
    return f"{np.abs(np.asarray(x)).max(initial=0.0):.4g}"
