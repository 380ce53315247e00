"""A steel beam and Euler and Bernoulli's: ``MODALAX_DATA=... python experiments/measured/steel.py [--out out/steel]``.

The simulation is a free beam without shear, its only number the frequency of the first mode. The FRFs of a roving
hammer are fitted; the beam's length and the place of its end follow from the shapes, so that nothing of it has to be
known. Then one cause at a time bends the ratios of the frequencies: shear and rotary inertia (one slenderness, the
ratio of moduli that of steel and a rectangle), rotary inertia alone, a mass at the sensor, a spring at the ends. Each
has two numbers for four frequencies; the last frequency is then predicted from the other three.
"""

import argparse
import time
from collections.abc import Callable
from pathlib import Path

import jax
import matplotlib
import matplotlib.pyplot as plt
import numpy as np
import scipy.linalg
import scipy.optimize
from rich.console import Console
from rich.table import Table
from threadpoolctl import threadpool_limits

from modalax.data.datasets import steel_beam
from modalax.identify import Fit, fit

matplotlib.use("Agg")
jax.config.update("jax_enable_x64", True)
threadpool_limits(1)

ELEMENTS = 60
SENSOR = 3  # which of the points has the accelerometer
SHEAR = 2 * (1 + 0.29) * 6 / 5  # E/(kappa G) of steel and a rectangular section
USUAL = 0.001  # relative error of a frequency by what no cause here tells


def beam(
    *, shear: float = 0.0, rotary: float = 0.0, mass: float = 0.0, at: float = 0.5, spring: float = 0.0, modes: int = 4
) -> tuple[np.ndarray, np.ndarray]:
    """Elastic frequencies and shapes of a free beam of unit length, mass and bending stiffness; ``(mode, node)``.

    ``rotary`` is the square of the section's radius of gyration, ``shear`` that times E/(kappa G), ``mass`` a lump at
    ``at``, ``spring`` a support under both ends. Elements of Przemieniecki (1968), exact in statics.
    """
    h, n = 1 / ELEMENTS, ELEMENTS + 1
    phi = 12 * shear / h**2
    bend = np.array([
        [12, 6 * h, -12, 6 * h], [6 * h, (4 + phi) * h**2, -6 * h, (2 - phi) * h**2],
        [-12, -6 * h, 12, -6 * h], [6 * h, (2 - phi) * h**2, -6 * h, (4 + phi) * h**2],
    ]) / (h**3 * (1 + phi))  # fmt: skip
    # shape functions of translation and rotation under shear, integrated by Gauss's rule
    x, w = np.polynomial.legendre.leggauss(6)
    x, w = (x + 1) / 2, w / 2
    move = np.stack([
        1 + phi - phi * x - 3 * x**2 + 2 * x**3, h * ((1 + phi / 2) * x - (2 + phi / 2) * x**2 + x**3),
        phi * x + 3 * x**2 - 2 * x**3, h * (-phi / 2 * x - (1 - phi / 2) * x**2 + x**3),
    ]) / (1 + phi)  # fmt: skip
    turn = np.stack([
        (-6 * x + 6 * x**2) / h, 1 + phi - (4 + phi) * x + 3 * x**2, (6 * x - 6 * x**2) / h, (phi - 2) * x + 3 * x**2,
    ]) / (1 + phi)  # fmt: skip
    weigh = h * ((move * w) @ move.T + rotary * (turn * w) @ turn.T)
    K, M = np.zeros((2, 2 * n, 2 * n))
    for e in range(ELEMENTS):
        i = slice(2 * e, 2 * e + 4)
        K[i, i] += bend
        M[i, i] += weigh
    place = 2 * round(at * ELEMENTS)
    M[place, place] += mass
    for end in (0, 2 * n - 2):
        K[end, end] += spring
    square, shapes = scipy.linalg.eigh(K, M, subset_by_index=[0, modes + 1])
    return np.sqrt(square[2:]), shapes[::2, 2:].T


def ends(found: Fit, places: np.ndarray) -> tuple[float, float]:
    """The beam's beginning and length [m], by which its shapes match those of the simulation best."""
    residues = np.asarray(found.model.participation) * np.asarray(found.model.shapes)[:, :1]
    turned = residues * np.exp(-0.5j * np.angle(np.sum(residues**2, axis=1)))[:, None]
    shapes = np.real(turned)
    nodes, simulated = np.linspace(0, 1, ELEMENTS + 1), beam()[1]

    def unlike(p: np.ndarray) -> float:
        total = 0.0
        for own, shape in zip(shapes, simulated, strict=True):
            there = np.interp((places - p[0]) / p[1], nodes, shape)
            total += 1 - (own @ there) ** 2 / (own @ own) / (there @ there)
        return total

    span = places[-1] - places[0]
    best = min(
        (scipy.optimize.minimize(unlike, [places[0] - (s - 1) * span / 2, s * span], method="Nelder-Mead")
         for s in (1.05, 1.2, 1.4)), key=lambda r: r.fun,
    )  # fmt: skip
    return float(best.x[0]), float(best.x[1])


def ratios(measured: np.ndarray, cause: Callable[[float], np.ndarray], size: float, used: slice) -> np.ndarray:
    """Relative errors of all frequencies, the first number scaled to those used."""
    f = cause(size)
    off = np.log(measured / f)
    return off - off[used].mean()


def fitted(
    measured: np.ndarray, cause: Callable[[float], np.ndarray], most: float, used: slice
) -> tuple[float, np.ndarray]:
    """Size of a cause, and the errors it leaves."""
    sizes = np.geomspace(most * 1e-5, most, 40)
    cost = [np.sum(ratios(measured, cause, s, used)[used] ** 2) for s in sizes]
    k = int(np.clip(np.argmin(cost), 1, len(sizes) - 2))
    best = scipy.optimize.minimize_scalar(
        lambda s: np.sum(ratios(measured, cause, np.exp(s), used)[used] ** 2),
        bounds=(np.log(sizes[k - 1]), np.log(sizes[k + 1])), method="bounded",
    )  # fmt: skip
    size = float(np.exp(best.x))
    return size, ratios(measured, cause, size, used)


def main() -> None:
    """Fit, bend, tell."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, help="folder for the picture")
    options = parser.parse_args()
    console, began, cpu = Console(width=130), time.time(), time.process_time()
    data = steel_beam()
    found = fit(data.frf)
    f, std = np.asarray(found.model.frequency_hz), np.asarray(found.refined.frequency_std_hz)
    places = np.asarray(data.geometry.xyz)[:, 2]
    sensor = float(places[SENSOR])
    start, length = ends(found, places)
    at = float(np.clip((sensor - start) / length, 0, 1))
    console.print(
        f"modes at {', '.join(f'{x:.2f} ± {2 * s:.2f}' for x, s in zip(f, std, strict=True))} Hz; by their shapes the "
        f"beam begins at {1e3 * start:.0f} mm and is {1e3 * length:.0f} mm long, the sensor at {at:.3f} of it"
    )
    whole, fewer = slice(0, 4), slice(0, 3)
    causes = {
        "none (Euler and Bernoulli)": (lambda _: beam()[0], 1.0),
        "shear and rotary inertia": (lambda s: beam(rotary=s, shear=SHEAR * s)[0], 1e-2),
        "rotary inertia alone": (lambda s: beam(rotary=s)[0], 1e-2),
        "mass at the sensor": (lambda s: beam(mass=s, at=at)[0], 1.0),
        "spring under the ends": (lambda s: beam(spring=s)[0], 1e4),
    }
    rows = Table("cause", "size", "errors of the four frequencies [%]", "probability", "mode 4 from 1 to 3 [%]")
    left = {}
    for name, (cause, most) in causes.items():
        size, e = fitted(f, cause, most, whole)
        _, ahead = fitted(f, cause, most, fewer)
        numbers = 1 if name.startswith("none") else 2
        left[name] = (size, e, float(ahead[3]), -0.5 * np.sum((e / USUAL) ** 2) - 0.5 * numbers * np.log(len(f)))
    top = max(x[3] for x in left.values())
    total = sum(np.exp(x[3] - top) for x in left.values())
    for name, (size, e, ahead, score) in left.items():
        told = f"radius of gyration {1e3 * np.sqrt(size) * length:.2f} mm" if "rotary" in name else f"{size:.3g}"
        rows.add_row(
            name, "" if name.startswith("none") else told, ", ".join(f"{100 * x:+.3f}" for x in e),
            f"{np.exp(score - top) / total:.3f}", f"{100 * ahead:+.3f}",
        )  # fmt: skip
    console.print(rows)
    console.print(f"{time.process_time() - cpu:.0f} CPU s, {time.time() - began:.0f} s")
    if options.out:
        options.out.mkdir(parents=True, exist_ok=True)
        fig, ax = plt.subplots(figsize=(7, 4), layout="constrained")
        for name, (_, e, _, _) in left.items():
            ax.plot(np.arange(1, 5), 100 * e, "o-", label=name)
        ax.set(xlabel="Mode", ylabel="Measured over simulated frequency [%]", xticks=[1, 2, 3, 4])
        ax.legend()
        fig.savefig(options.out / "ratios.png")


if __name__ == "__main__":
    main()
