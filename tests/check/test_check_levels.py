"""The size of a sensor's clipping, from sines that are clipped in time."""

import numpy as np
import pytest

from modalax.check.levels import _at_the_peak


def fundamental(amplitude, limit):
    """Of a sine that is clipped, from its samples over a cycle."""
    phase = 2 * np.pi * (np.arange(4096) + 0.5) / 4096
    return 2 * np.mean(np.clip(amplitude * np.sin(phase), -limit, limit) * np.sin(phase))


@pytest.mark.parametrize("limit", [0.42, 0.6, 0.9])
def test_one_limit_explains_all_loud_lines(limit):
    """Two levels, of which a limit of 0.42 clips the lower one as well; the loss is against a sensor without limit."""
    response = np.array([0.82, 0.9, 0.97, 1.0, 0.95, 0.86])
    high = np.array([fundamental(a, limit) for a in response])
    low = np.array([fundamental(a / 2, limit) for a in response])
    loss = np.log(2 * low / high)
    size, least, most = _at_the_peak(loss, np.full(6, 0.01), low / low.max(), 0.5)
    true = 1 - fundamental(1.0, limit)
    assert least < true < most < least + 0.1
    assert size == pytest.approx(true, abs=0.01)
    assert limit > 0.5 or 1 - np.exp(-loss.max()) < true - 0.02  # what is lost between the levels is not all
