import os
from pathlib import Path

# The matrices here are small: threads of the linear algebra library would only wait for each other.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("NPROC", "16")  # as modalax does on import, here before anything else can start JAX

import jax  # noqa: E402
import matplotlib  # noqa: E402
import pytest  # noqa: E402

matplotlib.use("Agg")
jax.config.update("jax_enable_x64", True)


@pytest.fixture(scope="module")
def measured():
    """Folder of the measured data, which MODALAX_DATA names meanwhile; a test that needs it is skipped without."""
    folder = Path(os.environ.get("MODALAX_DATA") or Path(__file__).parents[2] / "shared" / "data")
    if not folder.is_dir():
        pytest.skip(f"no measured data in {folder}; name their folder in MODALAX_DATA")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("MODALAX_DATA", str(folder))
        yield folder
