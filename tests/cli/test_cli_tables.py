"""Tables on a terminal of 80 columns."""

import io

from rich.console import Console

from modalax.cli.tables import mode_table, print_uncut


def printed(*modes):
    """The table of modes, each of frequency [Hz], damping ratio and their deviations, as lines."""
    names = ("frequency_hz", "frequency_std_hz", "damping_ratio", "damping_ratio_std", "predicted_damping_bias")
    out = io.StringIO()
    rows = [dict(zip(names, mode, strict=True), mpc=1.0, grade=1.0) for mode in modes]
    print_uncut(Console(width=80, file=out), mode_table(rows))
    return out.getvalue().splitlines()


def test_sure_modes_keep_80_columns():
    """Twenty digits and a small bias, which wanted 82."""
    lines = printed((314.823338, 7.7e-5, 0.00265664, 2.4e-7, -1e-7), (244.295498, 2.0e-5, 0.001041084, 8.1e-8, None))
    assert "Bias [%]" in lines[2] and "314.823338 ± 0.000077" in lines[4]
    assert max(map(len, lines)) <= 80


def test_no_number_is_cut():
    """A resonance of 3 MHz known to a hundredth of a Hz: a longer line if need be, and every digit."""
    lines = printed((3080511.7312345, 1.2e-2, 1.0000022e-4, 3.9e-11, -1.3e-7))
    assert not any("…" in line for line in lines)
    assert "3080511.731 ± 0.012" in lines[4] and "1.000" in lines[4]
