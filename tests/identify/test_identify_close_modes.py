"""Two modes or one: finite records, columns that disagree, and true doublets, each from a simulation of its kind."""

import numpy as np
import pytest

from modalax.data import FRF
from modalax.identify import close_modes, record_kind, residues
from modalax.identify.best_poles import best_poles
from modalax.identify.close_modes import _apart, two_modes, windows_split
from modalax.identify.disagreement import CERTAIN, _left, of_channels, of_lines, together
from modalax.identify.neighbourhood import around, residual_of
from modalax.identify.record_kind import record_of, through
from modalax.identify.record_window import record_kernel
from modalax.model.modal import poles_from

FREQ = np.arange(40.0, 141.0)  # lines 1 Hz apart: records of 1 s


def measured(frequency, zeta, outputs, inputs, record="steady", noise=1e-3, seed=0, shape_seed=1):
    """FRFs of modes with random shapes seen through a kind of record, with even noise that is not told."""
    rng, shapes = np.random.default_rng(seed), np.random.default_rng(shape_seed)
    s = 2j * np.pi * FREQ
    H = np.zeros((len(s), outputs, inputs), complex)
    for pole in np.asarray(poles_from(frequency, zeta)):
        R = np.outer(shapes.normal(size=outputs), shapes.normal(size=inputs)) / (2j * pole.imag)
        near, far = record_kernel(s, pole, 1.0, record), record_kernel(s, pole.conj(), 1.0, record)
        H += near[:, None, None] * R + far[:, None, None] * R.conj()
    e = rng.normal(size=H.shape) + 1j * rng.normal(size=H.shape)
    return FRF(FREQ, H + noise * np.abs(H).mean() * e)


def disagreeing(shift, zeta=0.005):
    """One structure whose frequencies differ from column to column by the given parts."""
    parts = [
        measured(np.array([60.0, 120.0]) * (1 + d), [zeta, zeta], 3, 1, seed=k, noise=3e-4) for k, d in enumerate(shift)
    ]
    return FRF(FREQ, np.concatenate([p.H for p in parts], axis=2), inputs=["a", "b", "c"][: len(parts)])


def fitted(frf, frequency, zeta):
    model = residues(frf, poles_from(frequency, zeta))
    return model, residual_of(frf, model)


@pytest.mark.parametrize("record", ["steady", "hann", "random", "padded", "burst_half", "burst_most"])
def test_one_mode_in_any_record_is_not_two(record):
    frf = measured([60.0, 120.0], [5e-4, 0.01], 3, 1, record)
    model, residual = fitted(frf, [59.9, 60.1, 120.0], [0.004, 0.004, 0.01])
    assert not two_modes(frf, model, residual, (0, 1))


def test_where_records_are_known_to_be_cut_one_mode_mostly_explained_by_them_is_not_two():
    """Bursts over another part of the block than any kernel has leave what a second mode would explain better."""
    frf = measured([60.0, 120.0], [5e-4, 0.01], 3, 1, "burst_most", noise=1e-5)
    between = measured([60.0, 120.0], [5e-4, 0.01], 3, 1, "burst_half", noise=1e-5)
    frf = frf.replace(H=0.5 * (frf.H + between.H))
    model, residual = fitted(frf, [59.9, 60.1, 120.0], [0.004, 0.004, 0.01])
    assert not two_modes(frf, model, residual, (0, 1), cut=True)
    true = measured([60.0, 62.0, 120.0], [0.01] * 3, 3, 1, noise=1e-5)
    model, residual = fitted(true, [60.0, 62.0, 120.0], [0.01] * 3)
    assert two_modes(true, model, residual, (0, 1), cut=True)


def test_modes_among_many_that_overlap_stay_two():
    """A record must not explain a mode by further unknowns of the neighbours that are seen through it."""
    f, zeta = np.arange(50.0, 130.0, 5.0), np.full(16, 0.04)
    frf = measured(f, zeta, 6, 2, noise=5e-3)
    model, residual = fitted(frf, f, zeta)
    assert two_modes(frf, model, residual, (6, 8))
    assert two_modes(frf, model, residual, (8, 9))


def test_a_window_that_splits_several_modes_is_told_from_true_pairs():
    """Two poles about each peak that Hann's taper made, its records drawn so that no kernel explains all of it."""
    f, pairs = np.array([60.0, 120.0]), np.array([59.5, 60.5, 119.5, 120.5])
    made = [measured(f, [5e-4, 5e-4], 3, 1, record, noise=1e-4) for record in ("hann", "random")]
    split = made[0].replace(H=0.9 * made[0].H + 0.1 * made[1].H)
    true = measured(pairs, np.full(4, 5e-3), 3, 1, noise=1e-4)
    for frf, zeta, said in ((split, 8e-3, True), (true, 5e-3, False)):
        model, residual = fitted(frf, pairs, np.full(4, zeta))
        hoods = [around(frf, model, residual, [a, a + 1], smooth=True) for a in (0, 2)]
        assert windows_split(frf, hoods) == said
        assert not windows_split(frf, hoods[:1])


@pytest.mark.parametrize(
    ("apart", "outputs", "inputs", "two"),
    [(5e-4, 6, 2, True), (0.01, 6, 2, True), (0.01, 18, 2, True), (5e-4, 6, 1, False)],
)
def test_two_modes_of_one_frequency_are_told_by_two_inputs(apart, outputs, inputs, two):
    """As those of a disk: all but at one frequency, with different shapes, that no shift from place to place makes."""
    f, zeta = np.array([60.0, 60.0 + apart, 75.0, 120.0]), np.full(4, 0.02)
    frf = measured(f, zeta, outputs, inputs, noise=2e-3)
    assert two_modes(frf, *fitted(frf, f, zeta), (0, 1)) == two
    assert two_modes(frf, *fitted(frf, f, zeta), (0, 2))


@pytest.mark.parametrize("record", ["random", "hann"])
def test_neighbours_are_seen_through_a_record_too(record):
    """Both resonances of a record are explained through it, the neighbour by the pole that it has there."""
    f, zeta = np.array([60.0, 66.0]), np.array([0.002, 0.004])
    frf = measured(f, zeta, 4, 1, record, noise=1e-4)
    steady = around(frf, *fitted(frf, f, [0.006, 0.008]), [0])
    seen = through(steady, record, 1.0)
    assert seen.fixed.shape == steady.fixed.shape
    pole, left = best_poles(seen, seen.poles)
    assert left < 0.1 * best_poles(steady, steady.poles)[1]
    assert abs(pole[0] - poles_from(f, zeta)[0]) < 0.1


def test_a_search_finds_poles_from_afar():
    f, zeta = np.array([60.0, 66.0, 120.0]), np.array([0.01, 0.004, 0.01])
    frf = measured(f, zeta, 3, 1, noise=1e-6)
    hood = around(frf, *fitted(frf, f, zeta), [0, 1])
    poles = best_poles(hood, np.array([-3.0 + 372.0j, -6.0 + 420.0j]))[0]
    assert np.abs(poles - np.asarray(poles_from(f, zeta))[:2]).max() < 1e-3


def test_one_mode_that_columns_see_apart_is_not_two():
    frf = disagreeing([0.0, 5e-4, -7e-4])
    model, residual = fitted(frf, [59.96, 60.02, 120.0], [0.005, 0.005, 0.005])
    assert not two_modes(frf, model, residual, (0, 1))


@pytest.mark.parametrize(("outputs", "inputs"), [(4, 2), (6, 1), (1, 1)])
def test_true_doublets_stay_two(outputs, inputs):
    """A third of a line apart, half of it at one sensor: the evidence says two."""
    apart = 0.3 if outputs > 1 else 0.8
    frf = measured([60.0, 60.0 + apart, 120.0], [0.005] * 3, outputs, inputs, noise=1e-4)
    model, residual = fitted(frf, [60.0, 60.0 + apart, 120.0], [0.005] * 3)
    assert two_modes(frf, model, residual, (0, 1))


@pytest.mark.parametrize("record", ["hann", "random"])
def test_record_is_named_and_its_damping_taken_out(record):
    frf = measured([60.0, 120.0], [5e-4, 4e-4], 3, 1, record)
    model, residual = fitted(frf, [60.0, 120.0], [0.006, 0.004])
    found = record_of(frf, model, residual, np.arange(2))
    assert found is not None and found.kind == record and found.plain and found.probability > 0.999
    assert np.allclose(found.damping_ratio, [5e-4, 4e-4], rtol=0.05)
    assert np.allclose(found.frequency_hz, [60.0, 120.0], rtol=1e-5)


@pytest.mark.parametrize("zeta", [0.01, 1e-3])
def test_no_record_is_named_where_a_steady_state_explains_all(zeta):
    frf = measured([60.0, 120.0], [zeta, zeta], 3, 1)
    model, residual = fitted(frf, [60.0, 120.0], [zeta, zeta])
    found = record_of(frf, model, residual, np.arange(2))
    assert found is None or (not found.plain and found.probability < 0.9)


@pytest.mark.parametrize("seen", ["all", "one"])
def test_a_record_is_that_of_all_modes(seen):
    """The strongest mode alone, as continuous random excitation bends it, is a misfit; all three are a record."""
    rng, s = np.random.default_rng(0), 2j * np.pi * np.arange(10.0, 130.0, 0.5)
    poles = 2 * np.pi * np.array([-0.4 + 30j, -0.35 + 60j, -0.45 + 90j])
    H = np.zeros(len(s), complex)
    for k, pole in enumerate(poles):
        record = "random" if k == 1 or seen == "all" else "steady"
        for factor, p in ((-1j, pole), (1j, pole.conj())):
            H += (20 if k == 1 else 1) * factor * record_kernel(s, p, 2.0, record)
    H = H[:, None, None] * np.array([1.0, 0.6])[None, :, None]
    e = rng.normal(size=H.shape) + 1j * rng.normal(size=H.shape)
    frf = FRF(s.imag / (2 * np.pi), H + 1e-3 * np.sqrt(np.mean(np.abs(H) ** 2)) * e)
    model = residues(frf, poles)
    found = record_of(frf, model, residual_of(frf, model), np.arange(3))
    assert found is None if seen == "one" else found is not None and found.kind == "random" and found.plain


def test_a_mode_beside_a_stronger_one_is_not_asked_about_the_record():
    """Around it stands what the window makes of the other; of four modes two pairs leave two to be asked."""
    frf = measured([60.0, 63.0, 110.0, 114.0], [0.004, 0.006, 0.004, 0.006], 3, 1, record="hann")
    model, residual = fitted(frf, [60.0, 63.0, 110.0, 114.0], [0.004, 0.006, 0.004, 0.006])
    hoods = record_kind._telling(frf, model, residual, np.array([0, 1, 3, 2]))
    assert [round(abs(h.poles[0]) / (2 * np.pi)) for h in hoods] == [60, 114]


def test_record_is_named_by_modes_that_die_out_within_it():
    """Of a mode whose amplitude falls to 4e-4 within the record a Hann taper still makes one of more damping."""
    frf = measured([60.0, 120.0], [0.02, 0.01], 3, 1, "hann")
    model, residual = fitted(frf, [60.0, 120.0], [0.0207, 0.0103])
    found = record_of(frf, model, residual, np.arange(2))
    assert found is not None and found.kind == "hann" and found.plain
    assert np.allclose(found.damping_ratio, [0.02, 0.01], rtol=0.02)


def test_columns_tell_by_how_much_they_disagree():
    frf = disagreeing([0.0, 5e-4, -7e-4])
    model, residual = fitted(frf, [60.0, 120.0], [0.005, 0.005])
    hood = around(frf, model, residual, [0])
    inputs = of_channels(hood, np.tile(np.arange(3), 3))
    assert inputs.chance < 1e-12
    assert np.ptp(inputs.shift) == pytest.approx(60 * 12e-4, rel=0.1)
    assert np.argsort(inputs.shift).tolist() == [2, 0, 1]
    assert 0.5 < inputs.between[0] / np.std(inputs.shift, ddof=1) < 2
    assert of_channels(hood, np.repeat(np.arange(3), 3)).chance > CERTAIN


def test_the_deviation_of_a_pole_reaches_the_mean_of_inputs_that_disagree():
    """The strongest input leads a fit; the mean of three that are known well and differ is as far as it is."""
    frf = disagreeing([0.0, 4e-4, 9e-4])
    model, residual = fitted(frf, [60.0, 120.0], [0.005, 0.005])
    inputs = of_channels(around(frf, model, residual, [0]), np.tile(np.arange(3), 3))
    to_mean, scatter = np.mean(inputs.shift), np.std(inputs.shift, ddof=1) / np.sqrt(3)
    assert inputs.error[0] == pytest.approx(np.hypot(to_mean, scatter), rel=0.2)
    assert together([0.5, 0.5]) == pytest.approx(0.25 * (1 + np.log(4)))


def test_what_a_basis_leaves_is_known_to_the_last_channel():
    """By a difference of sums where that is exact, else line by line: here of two channels next to nothing is left."""
    rng = np.random.default_rng(4)
    columns = np.linalg.qr(rng.normal(size=(50, 5)) + 1j * rng.normal(size=(50, 5)))[0]
    Q, own = columns[:, :4], 3 * columns[:, 4]
    left = (rng.normal(size=(50, 6)) + 1j * rng.normal(size=(50, 6))) * [1, 1, 1e-6, 1, 1e-9, 1]
    left -= columns @ (columns.conj().T @ left)
    part = rng.normal(size=6) + 1j * rng.normal(size=6)
    data = left + Q @ rng.normal(size=(4, 6)) + own[:, None] * part
    np.testing.assert_allclose(_left(data, Q, own, part), np.sum(np.abs(left) ** 2, axis=0), rtol=1e-6)


def test_parts_of_sound_data_agree():
    """Over forty draws of the noise: chances are even, and the deviation of the mean is that of all data."""
    chances, shifts = [], []
    for seed in range(40):
        frf = measured([60.0, 120.0], [0.01, 0.01], 3, 2, noise=0.02, seed=seed)
        frf = frf.replace(variance=np.full(frf.H.shape, 2 * (0.02 * np.abs(np.asarray(frf.H)).mean()) ** 2))
        hood = around(frf, *fitted(frf, [60.0, 120.0], [0.01, 0.01]), [0])
        chances += [of_channels(hood, np.tile(np.arange(2), 3)).chance, of_lines(hood).chance]
        spread = of_channels(hood, np.zeros(6, int))
        shifts.append(spread.shift[0] / spread.std[0])
    assert 0.3 < np.mean(chances) < 0.75
    assert min(chances) > CERTAIN / 10
    assert 0.75 < np.std(shifts) < 1.3


def test_groups_of_channels_are_fitted_apart_by_search_or_by_a_step(monkeypatch):
    """Channels whose poles differ by a tenth of a half-bandwidth: one step explains what a search for each does."""
    parts = [measured([60.0 * (1 + d)], [0.01], 2, 1, noise=1e-3, seed=7) for d in np.linspace(-1e-3, 1e-3, 6)]
    frf = FRF(FREQ, np.concatenate([p.H for p in parts], axis=1))
    hood = around(frf, *fitted(frf, [60.0], [0.01]), [0])
    place = np.repeat(np.arange(6), 2)
    searched = _apart(hood, hood.poles, place)
    monkeypatch.setattr(close_modes, "MANY", 2)
    step = _apart(hood, hood.poles, place)
    assert step.unknowns == searched.unknowns == 2 * (6 + 12)
    together = 2 * float(np.sum(np.abs(hood.left(hood.poles)) ** 2))
    assert searched.chi2 < step.chi2 < 0.02 * together


def test_few_columns_stand_for_many_channels():
    """A search over the principal columns ends where one over all channels does."""
    frf = measured([60.0, 120.0], [0.01, 0.01], 40, 1, noise=0.05)
    hood = around(frf, *fitted(frf, [60.0, 120.0], [0.01, 0.01]), [0])
    assert hood.leading().shape[1] < 40
    few, all_ = (best_poles(hood, hood.poles, data)[0][0] for data in (None, hood.data))
    assert abs(few - all_) < 1e-3 * -all_.real
