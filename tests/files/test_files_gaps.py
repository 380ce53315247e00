"""Lines and channels without any finite number are left out and named; single samples are damage."""

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


@pytest.mark.parametrize("where", [np.s_[1, 3, 0, 1], np.s_[0, 3], np.s_[:, 3, 0], np.s_[:]])
def test_other_gaps_are_refused(tmp_path, where):
    H = some()
    H[where] = NAN
    with pytest.raises(ValueError, match=f"H holds {(~np.isfinite(H)).sum()} values that are not finite"):
        load(written(tmp_path, H))
