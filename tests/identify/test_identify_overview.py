import jax
import jax.numpy as jnp
import numpy as np
import pytest

from modalax import Measurement, identify
from modalax.identify import BandwidthTest, Bound, DampingBias, PoleTable, Selection
from modalax.identify.host import refine_on_host
from modalax.model import ModalModel, poles_from

POLES = poles_from(np.array([10.0, 20.0]), np.array([0.01, 0.02]))
SHAPES = np.array([[1.0, 0.5], [0.5, -1.0]])


@pytest.fixture(scope="module")
def measured():
    model = ModalModel.from_real_modes([10.0, 20.0], [0.01, 0.02], SHAPES, [1.0, 1.0], ["a", "b"])
    frf, rng = model.frf(np.arange(5.0, 25.0, 0.05)), np.random.default_rng(0)
    noise = rng.standard_normal((2, *frf.shape)) / np.sqrt(2)
    return model, frf.replace(H=frf.H + 1e-5 * (noise[0] + 1j * noise[1]), variance=1e-10)


def test_a_selection_prints_its_poles():
    chosen = Selection(POLES, None, jnp.array([1.0, 0.5]), jnp.array([1e-5, 0.01]), jnp.array([10, 12]))
    assert str(chosen).splitlines() == [
        "2 poles selected",
        "Mode  Frequency [Hz]  Damping [%]  Score  Spread  Order",
        "----  --------------  -----------  -----  ------  -----",
        "   1              10            1   1.00   1e-05     10",
        "   2              20            2   0.50    0.01     12",
    ]


def test_a_bound_prints_its_deviations():
    bound = Bound(jnp.array([1e-3]), jnp.array([2e-4]), jnp.array([[0.0, 0.003 + 0.004j]]))
    assert str(bound).splitlines()[-1].split() == ["1", "0.001", "0.02", "0.005"]


def test_a_bias_prints_its_last_order_and_what_is_lost():
    two = lambda x: jnp.array([[0.0, 0.0], [x, x]])
    bias = DampingBias(
        jnp.stack([POLES, POLES]), two(-1e-3), two(-0.1), two(1e-4), jnp.array([[True, True], [True, False]])
    )
    text = str(bias).splitlines()
    assert text[0] == "Predicted bias due to noise, the last of 2 orders: frequency found, error of the damping"
    assert [row.split() for row in text[3:5]] == [["1", "10", "-0.1", "-10", "+0.01"], ["2", "-", "-", "-", "-"]]
    assert text[5] == "-: lost in the noise, no bias can be told"


def test_a_bandwidth_test_prints_both_bands():
    pair = lambda a, b: jnp.array([a, b])
    test = BandwidthTest(pair(10.0, 10.01), pair(0.01, 0.011), pair(5e-4, 0.05), *map(jnp.asarray, (8.0, 0.018, True)))
    assert str(test).splitlines() == [
        "Mode in a wide and a narrow band: 10 and 10.01 Hz, damping 1 and 1.1 %",
        "  frequency differs by 0.100 ± 0.050 %, damping by 10.0 ± 5.0 % (± expected of a linear mode)",
        "  p = 0.018 if the structure is linear (statistic 8)",
    ]


def test_poles_print_estimator_and_orders():
    table = PoleTable(POLES[None], jnp.array([[True, True]]), None, (4,), "lscf")
    assert str(table) == "Poles by lscf, order 4 (1): at the highest 2, 2 of which could be modes"


def test_a_refinement_prints_modes_and_how_well_they_fit(measured):
    model, frf = measured
    text = str(refine_on_host(frf, model)).splitlines()
    assert text[0].startswith("2 modes, refined in") and text[0].endswith("the likelihood has a maximum here")
    assert text[3].split()[0] == "1" and text[3].split()[1].startswith("10.00") and "±" in text[3]
    assert text[-1].startswith("chi-square") and "whiteness p" in text[-1]


def test_modes_over_the_level_print_both_ends(measured):
    frf = measured[1].lines(slice(None, None, 4))
    runs = Measurement(
        frf.freq, jnp.stack(3 * [frf.H]), level=[1.0, 2.0, 4.0], form=frf.form, outputs=["a", "b"], inputs=["a", "b"]
    )
    found = identify.over_amplitude(runs)
    text = str(found).splitlines()
    assert text[0] == "2 modes at 3 force levels: 1, 2, 4 N (± one standard deviation)"
    assert "Frequency [Hz] at 1 N" in text[1] and "Damping [%] at 4 N" in text[1] and len(text) == 5


def test_inside_a_compiled_function_the_plain_text_is_shown():
    seen = []
    chosen = Selection(POLES, None, jnp.ones(2), jnp.ones(2), jnp.ones(2, int))
    jax.jit(lambda x: (seen.append(str(x)), 0.0)[1])(chosen)
    assert seen[0].startswith("Selection(")


def test_residues_take_a_selection(measured):
    _, frf = measured
    chosen = identify.select(identify.plscf(frf, range(6, 20)))
    named = identify.residues(frf, chosen.poles, chosen.participation)
    assert np.array_equal(identify.residues(frf, chosen).shapes, named.shapes)
