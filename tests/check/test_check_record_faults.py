"""What is said of faults in single blocks of time records is what stands in them."""

import numpy as np
import pytest

from modalax.check import Records
from modalax.check.record_faults import record_findings


@pytest.mark.parametrize("converter", [0.0, 0.01])
def test_as_many_samples_as_are_clipped_are_told(converter):
    """Some stand at the limit alone, between others; with rounded values only runs of them count."""
    time = np.arange(400) / 400
    x = np.sin(2 * np.pi * 3 * time) * np.exp(-time) + 1e-4 * np.random.default_rng(0).normal(size=400)
    x = np.clip(x, -0.72, 0.8)
    x = x if not converter else converter * np.round(x / converter)
    force = np.where(np.arange(400) == 3, 1.0, 0.0) + 1e-6 * np.random.default_rng(1).normal(size=400)
    records = Records(force[None], x[None, :, None], 400.0, ("a",), kind="hits")
    (found,) = (f for f in record_findings(records) if f.what == "clipped")
    count = np.sum((x == x.max()) | (x == x.min()))
    assert (found.size, found.unit) == (count, "samples")
    assert found.evidence.startswith(f"{count} samples of block 1 stand at exactly")
