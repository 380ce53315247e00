"""The pictures of pages that the documentation shows, by a headless Chromium: ``python .github/docs/pictures.py``."""

import shutil
import subprocess
import tempfile
from pathlib import Path

import numpy as np

from modalax.cli.common import start

PICTURES = Path(__file__).parents[1] / "pictures"


def shot(address: str, name: str, size: tuple[int, int]) -> None:
    """Save what a browser shows at an address."""
    browser = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))))
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as folder:
        flags = ["--headless", "--no-sandbox", "--disable-gpu", "--no-first-run", f"--user-data-dir={folder}"]
        flags += [f"--window-size={size[0]},{size[1]}", "--hide-scrollbars", "--virtual-time-budget=20000"]
        command = [browser, *flags, f"--screenshot={PICTURES / name}", address]
        subprocess.run(command, check=True, capture_output=True)


def main() -> None:
    """A plate of 15 points, hit at one, from a virtual test with noise: the view and the report."""
    start()
    import jax

    from modalax.data import Geometry
    from modalax.files import save
    from modalax.identify import fit
    from modalax.model import ModalModel, poles_from
    from modalax.show.report import fit_report
    from modalax.view import Server, Session, read_beside

    x, y = np.meshgrid(np.linspace(0, 1, 5), np.linspace(0, 0.5, 3))
    x, y = x.ravel(), y.ravel()
    names = [str(k + 1) for k in range(15)]
    lines = [[names[5 * r + c] for c in range(5)] for r in range(3)]
    lines += [[names[5 * r + c] for r in range(3)] for c in range(5)]
    places = Geometry(names, np.stack([x, y, 0 * x], axis=1), lines)
    bent, turned = 1 - 4.5 * x * (1 - x), 4 * y - 1
    shapes = np.array([bent, (2 * x - 1) * turned, np.cos(3 * np.pi * x) + 0.1, turned * bent])
    poles = poles_from([31.0, 38.0, 84.0, 91.0], [0.006, 0.005, 0.008, 0.004])
    part = shapes[:, :1] / (2j * np.asarray(poles).imag)[:, None]
    dofs = [f"{name}:+Z" for name in names]
    model = ModalModel(poles, shapes, part, outputs=dofs, inputs=dofs[:1])
    frf = model.frf(np.linspace(10, 120, 881), form="accelerance").add_noise(jax.random.key(0), 0.03)
    with tempfile.TemporaryDirectory() as folder:
        # Beside it a model that is stiffer, and whose third mode bends one corner.
        other = shapes + np.where((x == 1) & (y == 0), 0.6, 0) * np.array([0, 0, 1, 0])[:, None]
        made = ModalModel(poles * 1.04, other, part, outputs=dofs, inputs=dofs[:1])
        save(made, Path(folder) / "model.npz")
        beside = read_beside(Path(folder) / "model.npz")
        session = Session(frf, geometry=places)
        server = Server(session, name="plate.uff", folder=Path("/measured/plate"), beside=beside)
        shot(server.url, "view.png", (1400, 1500))
        server.close()
        page = Path(folder) / "report.html"
        page.write_text(fit_report(fit(frf), "Modes of a plate", geometry=places), encoding="utf-8")
        shot(page.as_uri(), "report.png", (1200, 3300))


if __name__ == "__main__":
    main()
