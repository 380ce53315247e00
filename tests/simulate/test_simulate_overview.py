import jax
import numpy as np
import pytest

from modalax import simulate
from modalax.model import Structure
from modalax.simulate.joints import CubicSpring

M, K = np.eye(2), np.array([[4000.0, -1000.0], [-1000.0, 3000.0]])
JOINT = [CubicSpring(1e6)], [["a", "b"]]


@pytest.fixture(scope="module")
def structure():
    return Structure(M, 1e-3 * K, K, ["a", "b"])


def test_a_joint_prints_its_parameters_with_units():
    assert str(JOINT[0][0]) == "cubic_stiffness(k3 = 1e+06 N/m^3)"


def test_a_response_prints_what_is_solved(structure):
    found = simulate.harmonic_balance(structure, *JOINT, [5.0, 6.0, 7.0], [0.1, 1.0], inputs=["a"])
    assert str(found).splitlines()[:-1] == [
        "Harmonic balance: 3 lines from 5 to 7 Hz, 1 Hz apart",
        "  2 force levels: 0.1 to 1 N",
        "  2 outputs: a, b",
        "  1 input: a",
        "  harmonics: 1",
        "  solved: 6 of 6 points",
    ]
    largest = np.abs(found.fundamental).max()
    assert str(found).splitlines()[-1] == f"  largest displacement at the frequency of the force: {largest:.4g} m"


def test_a_stepped_sine_prints_what_is_settled(structure):
    found = simulate.stepped_sine(structure, [], [], [5.0, 6.0], 0.1, inputs=["a"])
    text = str(found).splitlines()
    assert text[:2] == ["Stepped sine: 2 lines from 5 to 6 Hz, 1 Hz apart", "  1 force level: 0.1 N"]
    assert text[4] == "  settled: 2 of 2 points"


def test_a_bench_and_its_records_print_channels_and_sampling(structure):
    bench = simulate.Bench(structure, *JOINT, fs=100.0, inputs=["a"])
    assert str(bench).splitlines()[:5] == [
        "Bench: accelerance [(m/s^2)/N], sampled at 100 Hz",
        "  2 outputs: a, b",
        "  1 input: a",
        "  cubic_stiffness(k3 = 1e+06 N/m^3) at a - b",
        "Structure of 2 degrees of freedom: a, b",
    ]
    linear = simulate.Bench(structure, fs=100.0, inputs=["a"])
    records = linear.record(jax.random.key(0), np.zeros((1, 1600, 1)))
    assert str(records).splitlines() == [
        "Records of 1 run: 2 s, 200 samples at 100 Hz",
        "  2 outputs [m/s^2]: a, b",
        "  1 input [N]: a",
    ]


def test_inside_a_compiled_function_the_plain_text_is_shown():
    seen = []
    jax.jit(lambda x: (seen.append(str(x)), 0.0)[1])(JOINT[0][0])
    assert seen[0].startswith("CubicSpring(")
