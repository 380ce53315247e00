"""Batches on several devices give what one gives; the processor stands for four of them, in a process of its own."""

import os
import subprocess
import sys

import pytest

CODE = """
import jax, numpy as np
jax.config.update("jax_enable_x64", True)
from modalax._numerics.devices import over_devices
from modalax.identify import many
from modalax.model.examples import five_dof
from modalax.study.batch import BatchWork

assert len(jax.devices()) == 4
frf = five_dof().frf(np.arange(20.0, 70.0, 0.5), inputs=["1"])
poles = np.asarray(five_dof().modal().poles)
sigma = np.full(frf.H.shape, 1e-2 * np.abs(np.asarray(frf.H)).mean())

def rows(method):
    return BatchWork(8, 8, 1, frf, sigma, poles, method, 12).rows(0)

assert len(over_devices(np.zeros((8, 3))).sharding.device_set) == 4
assert len(over_devices(np.zeros((7, 3))).sharding.device_set) == 1  # does not divide
assert len(over_devices(np.zeros((3, 4)), axis=1).addressable_shards) == 4
four = [rows(method) for method in ("lscf", "plscf")]
H = np.random.default_rng(0).normal(size=(8, 2, 5, 100))
assert len(many.many_poles(np.asarray(frf.omega), H, 6)[0].sharding.device_set) == 4
all_of_them, jax.devices = jax.devices, lambda: all_of_them()[:1]
for several, one in zip(four, [rows(method) for method in ("lscf", "plscf")], strict=True):
    assert len(several) == len(one) == 8
    for a, b in zip(several, one, strict=True):
        assert a.keys() == b.keys() and a["modes_found"] == b["modes_found"] == 5
        numbers = [k for k in a if isinstance(a[k], float)]
        np.testing.assert_allclose([a[k] for k in numbers], [b[k] for k in numbers], rtol=1e-7)
"""


@pytest.mark.slow
def test_four_devices_share_a_batch():
    flags = f"{os.environ.get('XLA_FLAGS', '')} --xla_force_host_platform_device_count=4"
    done = subprocess.run(
        [sys.executable, "-c", CODE],
        env={**os.environ, "XLA_FLAGS": flags},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr[-2000:]
