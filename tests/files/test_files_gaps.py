"""Lines in any order are sorted; lines and channels without numbers are left out; all of it is said."""

import numpy as np
import pytest

from modalax.files import load

NAN = np.nan


def written(tmp_path, H, **more):
    path = tmp_path / "gaps.npz"
    lines, outs, ins = H.shape[1:]
    names = {"outputs": [f"{k + 1}Z" for k in range(outs)], "inputs": [f"{k + 5}Z" for k in range(ins)]}
    np.savez(path, freq=np.arange(float(lines)), H=H, form="mobility", **names, **more)
    return path


def some():
    rng = np.random.default_rng(3)
    return rng.normal(size=(2, 12, 3, 2)) + 1j * rng.normal(size=(2, 12, 3, 2))


def test_lines_and_channels_of_NaN_are_left_out_and_named(tmp_path):
    H = some()
    H[:, [0, 7]] = NAN
    H[:, :, 1] = NAN
    H[:, :, :, 0] = NAN
    variance = np.where(np.isfinite(H), np.arange(12.0)[None, :, None, None], NAN)
    force = np.tile(np.arange(1.0, 13.0), (2, 1))
    with pytest.warns(UserWarning, match="no finite number at output 2Z and at input 5Z and at lines 0 Hz, 7 Hz; left"):
        found = load(written(tmp_path, H, variance=variance, force=force), conjugate=False)
    kept = np.delete(np.arange(12), [0, 7])
    assert found.outputs == ("1Z", "3Z") and found.inputs == ("6Z",)
    np.testing.assert_array_equal(found.freq, kept)
    np.testing.assert_array_equal(found.H, H[:, kept][:, :, [0, 2], 1:])
    np.testing.assert_array_equal(found.variance[0, :, 0, 0], kept)
    np.testing.assert_array_equal(found.force[0], kept + 1)


@pytest.mark.parametrize(
    ("where", "said"),
    [
        (np.s_[1, 3, 0, 1], "1 of 144 samples holds no .*all of output 1Z to input 6Z; line 3 Hz left out"),
        (np.s_[0, 3:6], r"18 of 144 samples hold no .* \(3 of 24\); lines 3 Hz, 4 Hz, 5 Hz left out for all channels"),
    ],
)
def test_lines_with_missing_samples_are_left_out_and_said(tmp_path, where, said):
    H = some()
    H[where] = NAN
    variance = np.tile(np.arange(12.0)[None, :, None, None], (2, 1, 3, 2))
    with pytest.warns(UserWarning, match=said):
        found = load(written(tmp_path, H, variance=variance), conjugate=False)
    kept = np.setdiff1d(np.arange(12), np.arange(12)[where[1]])
    np.testing.assert_array_equal(found.freq, kept)
    np.testing.assert_array_equal(found.H, H[:, kept])
    np.testing.assert_array_equal(found.variance[1, :, 2, 1], kept)


def test_a_line_of_which_the_variance_alone_is_missing_is_left_out_too(tmp_path):
    H = some()
    variance = np.ones(H.shape)
    variance[0, 5, 1, 1] = NAN
    with pytest.warns(UserWarning, match="1 of 144 .*all of output 2Z to input 6Z; line 5 Hz left out"):
        found = load(written(tmp_path, H, variance=variance), conjugate=False)
    assert 5.0 not in found.freq and len(found.freq) == 11


def test_a_channel_that_misses_most_of_its_samples_is_refused_by_name(tmp_path):
    H = some()
    H[:, :7, 1, 0] = NAN
    with pytest.raises(ValueError, match="14 of 144 samples .*all of output 2Z to input 5Z, at 7 of 12 lines"):
        load(written(tmp_path, H))


def test_a_file_without_any_number_is_refused(tmp_path):
    with pytest.raises(ValueError, match="144 of 144 samples hold no finite number"):
        load(written(tmp_path, NAN * some()))


def test_lines_in_another_order_are_sorted_with_all_that_belongs_to_them(tmp_path):
    H = some()
    order = np.random.default_rng(1).permutation(12)
    variance, force = np.abs(H) ** 2, np.tile(np.arange(1.0, 13.0), (2, 1))
    path = tmp_path / "mixed.npz"
    names = {"outputs": ["1Z", "2Z", "3Z"], "inputs": ["5Z", "6Z"], "form": "mobility"}
    arrays = {"H": H[:, order], "variance": variance[:, order], "force": force[:, order]}
    np.savez(path, freq=np.arange(12.0)[order], **arrays, **names)
    with pytest.warns(UserWarning, match="do not stand in rising order and were sorted"):
        found = load(path, conjugate=False)
    np.testing.assert_array_equal(found.freq, np.arange(12))
    for name, expected in (("H", H), ("variance", variance), ("force", force)):
        np.testing.assert_array_equal(getattr(found, name), expected)


@pytest.mark.parametrize("same", [True, False])
def test_a_line_that_stands_twice_is_kept_once_or_its_mean_is_taken(tmp_path, same):
    H, variance = some(), np.full((2, 12, 3, 2), 4.0)
    twice = np.r_[0:7, 6, 7:12]
    H, variance = H[:, twice], variance[:, twice]
    H[:, 7] += 0 if same else 2.0
    path = tmp_path / "twice.npz"
    names = {"outputs": ["1Z", "2Z", "3Z"], "inputs": ["5Z", "6Z"], "form": "mobility"}
    np.savez(path, freq=np.arange(12.0)[twice], H=H, variance=variance, **names)
    with pytest.warns(UserWarning, match="line 6 Hz stands several times, " + ("alike" if same else "and the mean")):
        found = load(path, conjugate=False)
    expected = np.delete(H, 7, axis=1)
    expected[:, 6] += 0 if same else 1.0
    np.testing.assert_allclose(found.H, expected, rtol=1e-14)
    # The mean of two independent values has half of their variance.
    np.testing.assert_array_equal(found.variance[0, :, 0, 0], [4.0] * 6 + [4.0 if same else 2.0] + [4.0] * 5)


def test_two_sweeps_in_one_run_are_refused(tmp_path):
    H = some()
    path = tmp_path / "sweeps.npz"
    names = {"outputs": ["1Z", "2Z", "3Z"], "inputs": ["5Z", "6Z"], "form": "mobility"}
    np.savez(path, freq=np.r_[0.0:6.0, 5:-1:-1], H=H, **names)
    with pytest.raises(ValueError, match="sweeps up and down"):
        load(path)
