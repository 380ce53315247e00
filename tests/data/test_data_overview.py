import jax
import numpy as np
import pytest

import modalax
from modalax.data.overview import shortened


def runs(**changes):
    given = dict(
        form="accelerance", variance=np.ones((2, 5, 3, 1)), averages=8, level=[10.0, np.nan], outputs=["a", "b", "c"],
        inputs=["a"],
    )  # fmt: skip
    return modalax.Measurement(np.arange(4.0, 6.5, 0.5), np.ones((2, 5, 3, 1), complex), **{**given, **changes})


def test_a_measurement_prints_what_it_holds():
    assert str(runs(added_decay=2.5)).splitlines() == [
        "Measurement of 2 runs: accelerance [(m/s^2)/N]",
        "  5 lines from 4 to 6 Hz, 0.5 Hz apart",
        "  3 outputs: a, b, c",
        "  1 input: a",
        "  force: 10 N, unknown",
        "  noise: variance of each sample, estimated from 8 averages",
        "  an exponential window added a decay of 2.5 1/s",
    ]


def test_what_is_not_known_is_left_out_or_said():
    frf = modalax.FRF([1.0, 2.0, 4.0], np.ones((3, 1, 1), complex), coherence=0.5)
    assert str(frf).splitlines() == [
        "FRF: receptance [m/N]",
        "  3 lines from 1 to 4 Hz, unevenly spaced",
        "  1 output: o1",
        "  1 input: i1",
        "  noise: coherence",
    ]
    alone = str(frf.lines(slice(0, 1)).replace(coherence=None))
    assert "  1 line from 1 to 1 Hz\n" in alone and alone.endswith("noise: not known")


def test_of_many_names_the_first_and_the_last_are_shown():
    names = [str(k) for k in range(1, 13)]
    assert shortened(names) == "1, 2, 3, 4, 5, 6, ..., 12"
    assert shortened(names[:8]) == "1, 2, 3, 4, 5, 6, 7, 8"


@pytest.mark.parametrize("what", [runs(), runs().run(0)])
def test_inside_a_compiled_function_the_plain_text_is_shown(what):
    seen = []
    jax.jit(lambda x: (seen.append(str(x)), x.H)[1])(what)
    assert "H=" in seen[0]
