"""``modalax simulate``: FRFs that a model predicts, with non-linear joints or without."""

from enum import StrEnum
from pathlib import Path
from typing import Annotated, Any

import typer

from modalax.cli.common import OverwriteOption, check_free, check_readable, note, read_simulation, start, working
from modalax.files.messages import naming

HARMONICS = 3  # where no number of them is given


class Sweep(StrEnum):
    """Direction of a frequency sweep."""

    up = "up"
    down = "down"


class FRFForm(StrEnum):
    """Motion that an FRF is a ratio of: displacement, velocity or acceleration."""

    receptance = "receptance"
    mobility = "mobility"
    accelerance = "accelerance"


def simulate(
    simulation: Annotated[Path, typer.Argument(metavar="SIM", help="Simulation: matrices M, C, K or a modal model.")],
    joints: Annotated[
        list[str] | None,
        typer.Argument(
            metavar="JOINTS",
            help="Joints as law:DoFs:parameters in SI units, such as 'elasto_slip:3,5:k=2e4,slip_force=4', or a file "
            "(TOML).",
            show_default=False,
        ),
    ] = None,
    force: Annotated[
        list[float] | None, typer.Option("--force", metavar="N", help="Force amplitude in N; repeat for more runs.")
    ] = None,
    band: Annotated[
        tuple[float, float] | None, typer.Option("--band", metavar="LO HI", help="Frequency band [Hz] (required).")
    ] = None,
    step: Annotated[float, typer.Option("--step", metavar="HZ", help="Distance between frequency lines.")] = 0.1,
    output: Annotated[
        Path | None,
        typer.Option("-o", "--out", "--output", metavar="DATA", help="File of FRFs to write (required)."),
    ] = None,
    joint: Annotated[
        list[str] | None, typer.Option("--joint", help="A joint, written as in JOINTS; repeat for several.")
    ] = None,
    input: Annotated[
        str | None, typer.Option("--input", metavar="DOF", help="DoF where the force acts; the first by default.")
    ] = None,
    form: Annotated[FRFForm, typer.Option(help="Form of the FRFs.")] = FRFForm.receptance,
    sweep: Annotated[
        Sweep | None,
        typer.Option(
            help="Direction of the sweep, up if not given; decides which response is found where several are stable.",
            show_default=False,
        ),
    ] = None,
    amplitude: Annotated[
        list[float] | None,
        typer.Option(
            "--amplitude",
            metavar="M",
            help="Displacement amplitude in metres that the force is controlled to hold where there are joints, "
            "instead of --force; repeat for more runs.",
        ),
    ] = None,
    held: Annotated[
        str | None,
        typer.Option("--held", metavar="DOF", help="DoF whose amplitude is held; the driven one by default."),
    ] = None,
    harmonics: Annotated[
        int | None,
        typer.Option(help="Number of harmonics, where there are joints; 3 if not given.", show_default=False),
    ] = None,
    noise: Annotated[float, typer.Option(help="Noise to add, as a fraction of the rms value of each channel.")] = 0.0,
    seed: Annotated[int, typer.Option(help="Seed of the noise.")] = 0,
    overwrite: OverwriteOption = False,
) -> None:
    """Predict the FRFs of a simulation, at one or more force amplitudes where it has non-linear joints."""
    if output is None:
        raise ValueError("simulate needs -o DATA, the file to write the FRFs to")
    if band is None:
        raise ValueError("simulate needs --band LO HI, the frequencies to simulate [Hz]")
    levels, amplitudes, specs = force or [], amplitude or [], [*(joints or []), *(joint or [])]
    _check_control(levels, amplitudes, held)
    _check_held(amplitudes, bool(specs), sweep)
    if not 0 <= noise < float("inf"):
        raise ValueError(f"--noise {noise:g}: a fraction of the rms value of each channel, 0 or above, is needed")
    read = [simulation, *(Path(spec) for spec in specs if spec.endswith(".toml"))]
    check_free(output, overwrite=overwrite, inputs=read, data=True)
    check_readable(simulation)
    start()
    from modalax.files import save
    from modalax.model.receptance import directions
    from modalax.simulate.joints.text import read_joints

    freq = frequencies(*band, step)
    structure = read_simulation(simulation)
    parts = [part for spec in specs for part in read_joints(spec)]
    if parts and not levels and not amplitudes:
        raise ValueError("joints make the response depend on the force: give --force N, or --amplitude M to hold it")
    if not parts:
        for name, given in (("--sweep", sweep), ("--harmonics", harmonics)):
            if given is not None:
                note(f"{name} has no effect without joints, where the response is the same at every force")
    orders = HARMONICS if harmonics is None else harmonics
    known = getattr(structure, "dofs", None) or structure.inputs
    driven = known[0] if input is None else input
    with naming(simulation):
        directions(structure, [[driven], [held or driven], *(where for _, where in parts)])
    if amplitudes:
        with naming(simulation), working(f"Simulating {len(freq)} lines at {len(amplitudes)} held amplitudes"):
            measurement = hold(structure, parts, freq, amplitudes, driven, held or driven, form.value, orders)
    else:
        with naming(simulation), working(f"Simulating {len(freq)} lines at {len(levels) or 1} force amplitudes"):
            measurement = predict(structure, parts, freq, levels, driven, form.value, orders, (sweep or Sweep.up).value)
    if noise:
        measurement = with_noise(measurement, noise, seed)
    save(measurement, output, overwrite=overwrite)
    note(f"{output}: {measurement.runs} runs, {len(freq)} lines, {len(measurement.outputs)} outputs")


def frequencies(lower: float, upper: float, step: float) -> Any:
    """Frequency lines from the lower end of a band [Hz] in equal steps; the upper end counts if a step meets it.

    Raises
    ------
    ValueError
        If the band is empty, or the step is not positive, wider than the band or makes too many lines.
    """
    from modalax.data.lines import lines_of_band

    if not 0 <= lower < upper < float("inf"):
        raise ValueError(f"--band {lower:g} {upper:g}: needs 0 <= LO < HI")
    return lines_of_band(lower, upper, step, "--step")


def predict(
    structure: Any,
    joints: list[Any],
    freq: Any,
    levels: list[float],
    input: str,
    form: str,
    harmonics: int,
    sweep: str,
) -> Any:
    """Predict a measurement, exactly from the matrices or modes without joints, by harmonic balance with joints."""
    from modalax.simulate.harmonic import simulate as run

    laws, places = [law for law, _ in joints], [where for _, where in joints]
    level = levels or [float("nan")]
    options: dict[str, Any] = {"harmonics": harmonics, "sweep": sweep} if joints else {}
    return run(structure, laws, places, freq, level, inputs=[input], form=form, **options)


def hold(
    structure: Any,
    joints: list[Any],
    freq: Any,
    amplitudes: list[float],
    input: str,
    held: str,
    form: str,
    harmonics: int,
) -> Any:
    """Predict FRFs at constant response: the force is controlled so that each amplitude [m] is held, a run each.

    Raises
    ------
    ValueError
        If no force is found that holds the amplitude at some line.
    """
    from modalax.data import Measurement
    from modalax.simulate.control import constant_response

    laws, places = [law for law, _ in joints], [where for _, where in joints]
    runs = []
    for amplitude in amplitudes:
        run = constant_response(structure, laws, places, freq, amplitude, held=held, input=input, harmonics=harmonics)
        failed = run.freq[~run.converged]
        if len(failed):
            raise ValueError(
                f"--amplitude {amplitude:g}: no force was found that holds it at {len(failed)} of {len(freq)} lines, "
                f"the first at {float(failed[0]):g} Hz; take finer lines or fewer harmonics"
            )
        runs.append(run.measurement(form).run(0))
    return Measurement.from_frfs(runs)


def _check_control(levels: list[float], amplitudes: list[float], held: str | None) -> None:
    if any(not level > 0 for level in levels):
        raise ValueError(f"--force {min(levels):g}: a force amplitude must be above 0 N")
    if any(not amplitude > 0 for amplitude in amplitudes):
        raise ValueError(f"--amplitude {min(amplitudes):g}: a displacement amplitude must be above 0 m")
    if levels and amplitudes:
        raise ValueError("--force holds the force and --amplitude the response: give one of them")
    if held is not None and not amplitudes:
        raise ValueError(f"--held {held}: says where --amplitude is held; give --amplitude M")


def _check_held(amplitudes: list[float], joints: bool, sweep: Sweep | None) -> None:
    """Refuse what a held amplitude has no use for, or what has no use for it."""
    if amplitudes and not joints:
        raise ValueError(
            f"--amplitude {amplitudes[0]:g}: without joints the FRFs are the same at every amplitude; "
            "give the joints, or leave it out"
        )
    if amplitudes and sweep is not None:
        raise ValueError(
            f"--sweep {sweep.value}: has no effect where --amplitude holds the response; leave one of them out"
        )


def with_noise(measurement: Any, relative: float, seed: int) -> Any:
    """Add independent noise to every run."""
    import jax

    from modalax.data import Measurement

    keys = jax.random.split(jax.random.key(seed), measurement.runs)
    return Measurement.from_frfs([measurement.run(k).add_noise(keys[k], relative) for k in range(measurement.runs)])
