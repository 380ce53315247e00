import jax
import numpy as np
import pytest

import modalax
from modalax.data import FRF, BestLinear, DetectionLines, Geometry, Recording
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


def test_a_geometry_prints_its_extent():
    geometry = Geometry(["1", "2"], [[0.0, 0.0, 0.0], [1.0, 0.5, 0.0]], [["1", "2"]])
    assert str(geometry).splitlines() == ["Geometry of 2 nodes: 1, 2", "  1 line", "  extent in x, y, z: 1 x 0.5 x 0 m"]


def test_a_recording_prints_its_duration_and_channels():
    recording = Recording(np.zeros((3, 200, 2)), 100.0, ("hammer", "a"), ("N", "m/s^2"), (1, 2))
    assert str(recording).splitlines() == [
        "Recording: 3 records of 2 s, 200 samples at 100 Hz",
        "  2 channels: 1 hammer [N], 2 a [m/s^2]",
    ]


def test_a_best_linear_approximation_prints_how_large_noise_and_distortion_are():
    frf = FRF([10.0, 20.0], np.full((2, 1, 1), 2.0 + 0j), form="receptance")
    none = DetectionLines(np.zeros(0), np.zeros((0, 1)), None)
    text = str(BestLinear(frf, np.full((2, 1, 1), 4e-4), np.full((2, 1, 1), 4e-2), none, none)).splitlines()
    assert text[0].startswith("Best linear approximation: receptance")
    assert text[-2:] == [
        "  part of the FRF (root mean square): noise 1 %, distortion 10 %",
        "  lines without force: 0 even, 0 odd",
    ]
