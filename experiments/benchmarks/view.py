"""How long ``modalax view`` lets a person wait: ``python experiments/benchmarks/view.py [plane|large]``.

``plane``: the laboratory aeroplane (219 FRFs, 1601 lines; needs the measured data) from opening to a saved, corrected
selection. ``large``: 458 outputs x 1 input x 3000 lines with 42 modes, made here. Printed are wall-clock and CPU
seconds of each step, the median of several clicks as the server answers them, and, where there is a Chromium, the
median from the click to the last curve drawn.
"""

import contextlib
import os
import shutil
import statistics
import subprocess
import sys
import tempfile
import threading
import time
import warnings
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
CLICKS = 12
PROBE = """
(async function () {
  const wait = (ms) => new Promise((done) => setTimeout(done, ms)), root = document.documentElement, took = [];
  const rest = async () => { do { await wait(30); } while (document.body.classList.contains("busy")); };
  while (!root.dataset.ready || !root.dataset.checked) await wait(100);
  await rest();
  for (let k = 0; k < %d; k++) {
    if (k %% 2) document.getElementById("undo").click(); else document.querySelector("#modes tbody button").click();
    await rest();
    took.push(Number(root.dataset.took));
  }
  await fetch("took", {method: "POST", body: JSON.stringify({took: took})});
})();
"""


def large():
    """FRFs of the size of a large aircraft's ground vibration test."""
    import jax
    import jax.numpy as jnp
    import numpy as np

    from modalax.model import ModalModel
    from modalax.model.modal import poles_from

    rng = np.random.default_rng(0)
    f, zeta = np.linspace(0.06, 0.94, 42) * 300 * (1 + 0.004 * rng.uniform(-1, 1, 42)), rng.uniform(0.003, 0.01, 42)
    shapes, names = rng.normal(size=(42, 458)), [f"{k + 1}:+Z" for k in range(458)]
    part = shapes[:, :1] / (2j * np.asarray(poles_from(f, zeta)).imag)[:, None]
    model = ModalModel(poles_from(f, zeta), shapes, part, outputs=names, inputs=names[:1])
    frf = model.frf(jnp.linspace(0.1, 300, 3000), form="accelerance")
    return frf.add_noise(jax.random.key(0), 0.05).replace(variance=None), None


def plane():
    """The laboratory aeroplane."""
    from modalax.data.datasets import uliege_plane

    found = uliege_plane()
    return found.frf, found.geometry


@contextlib.contextmanager
def timed(name):
    """Print the seconds that a step takes."""
    wall, cpu = time.perf_counter(), time.process_time()
    yield
    print(f"{name:34} {time.perf_counter() - wall:8.2f} s, {time.process_time() - cpu:8.2f} CPU s", flush=True)


def clicks(server):
    """Median wall and CPU seconds of a click as the server answers it: a pick dropped, and the drop undone."""
    found = []
    for k in range(CLICKS):
        start = time.perf_counter(), time.process_time()
        server.session._fits.clear()
        server.answer("undo" if k % 2 else "drop", {"number": 1 + k, "channel": [0, 0], "mode": 2})
        found.append((time.perf_counter() - start[0], time.process_time() - start[1]))
    return [statistics.median(column) for column in zip(*found, strict=True)]


def in_browser(make):
    """Median seconds from a click to the last curve drawn, in Chromium."""
    from modalax.view import Server

    browser = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
    if browser is None:
        return None
    told, done = [], threading.Event()

    class Probed(Server):
        """A server whose page clicks by itself and tells how long it waited."""

        def file(self, name):
            """The probe, or the page with it."""
            if name == "probe.js":
                return (PROBE % CLICKS).encode(), "text/javascript"
            found = super().file(name)
            if name or found is None:
                return found
            return found[0].replace(b"</body>", b'<script src="probe.js"></script></body>'), found[1]

        def answer(self, name, asked):
            """Keep what the probe tells."""
            if name != "took":
                return super().answer(name, asked)
            told.extend(asked["took"])
            done.set()
            return {}

    server = make(Probed)
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as folder:
        flags = ["--headless", "--no-sandbox", "--disable-gpu", "--no-first-run", f"--user-data-dir={folder}"]
        command = [browser, *flags, "--remote-debugging-port=0", "--window-size=1500,1200", server.url]
        process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        done.wait(120)
        process.terminate()
        process.wait(20)
    server.close()
    return statistics.median(told) / 1000 if told else None


def main(which):
    """Print the times of one case."""
    with timed("imports"):
        from modalax.cli.common import start

        start()
        from modalax.check import check
        from modalax.view import Server, Session
        from modalax.view.files import save
    frf, geometry = {"plane": plane, "large": large}[which]()
    with timed("diagram and automatic choice"):
        session = Session(frf, geometry=geometry)
    server = Server(session)
    with timed("first answers"):
        server.answer("opening", {})
        server.answer("diagram", {})
        server.answer("now", {})
    print(
        f"{len(session.state.picks)} modes of order {session.state.order} in {len(session.diagram.lines)} lines drawn"
    )
    server.answer("drop", {"number": 2})
    with tempfile.TemporaryDirectory() as folder:
        if which == "plane":
            with timed("check, aside"):
                check(frf)
            with timed("refine"):
                server.answer("refine", {})
        with timed("save selection and modal model"):
            save(session, "selection", Path(folder) / "a.json", False, which)
            save(session, "model", Path(folder) / "a.npz", False, which)
        if which == "plane":
            with timed("save report"):
                save(session, "report", Path(folder) / "a.html", False, which)
            server.answer("undo", {})
    wall, cpu = clicks(server)
    print(f"{'a click, server, median':34} {1000 * wall:8.0f} ms, {1000 * cpu:8.0f} CPU ms")
    server.close()
    seen = in_browser(lambda kind: kind(session))
    print(f"{'a click until all is drawn, median':34} {'no browser' if seen is None else f'{1000 * seen:8.0f} ms'}")


if __name__ == "__main__":
    warnings.simplefilter("ignore")
    main(sys.argv[1] if len(sys.argv) > 1 else "plane")
