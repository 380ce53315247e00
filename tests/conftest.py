import ctypes
import gc
import os
import platform
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

import jaxlib.version
import pytest
import threadpoolctl

# The matrices here are small: threads of the linear algebra library would only wait for each other.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
os.environ.setdefault("OMP_NUM_THREADS", "1")
# Fresh interpreters that tests start read compiled modules rather than 400 sources, a third of the time of an import.
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
sys.dont_write_bytecode = False
os.environ.setdefault("NPROC", "16")  # as modalax does on import, here before anything else can start JAX
# Most of a test is the compilation of programs that run once, so they are not optimised. A user's programs are; the
# numbers differ by rounding. Fused loops by the older of two emitters, each program in one piece: a diagnosis compiles
# in 12 instead of 29 s of processor time. jaxlib ends a process that names a flag it does not have.
FLAGS = ["--xla_backend_optimization_level=0", "--xla_llvm_disable_expensive_passes=true"]
if jaxlib.version.__version_info__ >= (0, 8):
    FLAGS += ["--xla_cpu_parallel_codegen_split_count=1"]
if (0, 8) <= jaxlib.version.__version_info__ < (0, 11):
    FLAGS += ["--xla_cpu_use_fusion_emitters=false"]
os.environ.setdefault("XLA_FLAGS", " ".join(FLAGS))

import jax  # noqa: E402
import matplotlib  # noqa: E402

# A plugin of pytest may have loaded NumPy before the numbers of threads above were set.
threadpoolctl.threadpool_limits(1, user_api="blas")

matplotlib.use("Agg")
matplotlib.rcParams["savefig.dpi"] = 40  # nobody looks at them
jax.config.update("jax_enable_x64", True)
jax.config.update("jax_traceback_in_locations_limit", 0)  # no lines of Python beside each operation of a program
PROGRAMS = pytest.StashKey[str]()
ROOM = 0.6  # share of the machine's memory that all processes may grow by before they let their programs go
WORTH = 0.3  # seconds of compilation; to write down a smaller program takes longer than others save by it


def pytest_configure(config):
    """What one process of the tests has compiled serves the others, for as long as they run."""
    if hasattr(config, "workerinput") or "JAX_COMPILATION_CACHE_DIR" in os.environ:
        return
    folder = config.stash[PROGRAMS] = tempfile.mkdtemp(prefix="modalax-programs-")
    os.environ["JAX_COMPILATION_CACHE_DIR"] = folder  # for processes to come
    os.environ["JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS"] = str(WORTH)
    jax.config.update("jax_compilation_cache_dir", folder)
    jax.config.update("jax_persistent_cache_min_compile_time_secs", WORTH)


def keep_freed_memory():
    """Let a process keep what it has freed: getting it back from the system took a tenth of the time of some tests."""
    if platform.libc_ver()[0] == "glibc":
        trim_threshold, mmap_threshold = -1, -3
        ctypes.CDLL(None).mallopt(mmap_threshold, 32 * 2**20)  # the most that it takes
        ctypes.CDLL(None).mallopt(trim_threshold, 512 * 2**20)


keep_freed_memory()
gc.disable()  # what packages and tests are made of stays to the end


def pytest_collection_finish():
    """JAX makes many small objects that stay or go by themselves: look for garbage among them seldom."""
    gc.collect()
    gc.freeze()
    gc.set_threshold(200_000, 20, 50)
    gc.enable()


def pytest_unconfigure(config):
    if PROGRAMS in config.stash:
        shutil.rmtree(config.stash[PROGRAMS], ignore_errors=True)


@pytest.fixture(scope="module", autouse=True)
def room_for_programs():
    """A process that has compiled for many tests lets its programs go before it runs out of memory maps."""
    from modalax._numerics import programs

    programs.GROWN = ROOM / int(os.environ.get("PYTEST_XDIST_WORKER_COUNT", "1"))
    programs.release_programs()


@pytest.fixture(scope="module")
def measured():
    """Folder of the measured data, which MODALAX_DATA names meanwhile; a test that needs it is skipped without."""
    folder = Path(os.environ.get("MODALAX_DATA") or Path(__file__).parents[2] / "shared" / "data")
    if not folder.is_dir():
        pytest.skip(f"no measured data in {folder}; name their folder in MODALAX_DATA")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("MODALAX_DATA", str(folder))
        yield folder


@pytest.fixture
def chromium(tmp_path):
    """Opens an address in a fresh headless browser; gives its document and its console's lines."""
    names = ("chromium", "chromium-browser", "google-chrome", "chrome")
    browser = next(filter(None, map(shutil.which, names)), None)
    if browser is None:
        pytest.skip("no chromium or chrome on this machine")

    def browse(address, *flags):
        command = [
            browser, "--headless", "--no-sandbox", "--disable-gpu", "--disable-background-networking",
            "--no-first-run", f"--user-data-dir={tmp_path / 'profile'}", "--enable-logging=stderr", *flags, address,
        ]  # fmt: skip
        done = subprocess.run(command, capture_output=True, text=True, timeout=120, check=True)
        return done.stdout, [line for line in done.stderr.splitlines() if "CONSOLE" in line]

    return browse
