"""Batches over all devices of this machine, such as several accelerators."""

from typing import Any

import jax
import numpy as np
from jax.sharding import Mesh, NamedSharding, PartitionSpec

from modalax._numerics.checks import as_array


def over_devices(batch: Any, axis: int = 0) -> jax.Array:
    """The array with one axis shared out to all devices, so that programs over it run on each with its own part.

    With one device, or an axis that does not divide by their number, the array stays whole.
    """
    devices = jax.devices()
    if len(devices) < 2 or batch.shape[axis] % len(devices):
        return as_array(batch)
    parts = PartitionSpec(*[None] * axis, "batch")
    return jax.device_put(batch, NamedSharding(Mesh(np.array(devices), ("batch",)), parts))
