"""What the kinds of strange files have in common: systems of known modes, their FRFs with noise, and the arrays."""

from collections.abc import Callable
from typing import Any

import numpy as np

POWER = {"receptance": 0, "mobility": 1, "accelerance": 2}
KINDS: dict[str, Callable[[np.random.Generator], tuple[dict[str, Any], np.ndarray]]] = {}


def kind(function: Callable[[np.random.Generator], tuple[dict[str, Any], np.ndarray]]) -> Callable:
    """Put a maker of a file among the kinds; it returns the arrays of the file and the true poles."""
    KINDS[function.__name__.replace("_", " ")] = function
    return function


class System:
    """Modes of frequency ``f`` [Hz] and damping ``zeta`` with real shapes of unit modal mass ``(n, dof)``."""

    def __init__(self, rng: np.random.Generator, f: Any, zeta: Any, dof: int = 5):
        self.f = np.asarray(f, float)
        self.zeta = np.broadcast_to(np.asarray(zeta, float), self.f.shape)
        self.shapes = rng.normal(size=(len(self.f), dof))
        w = 2 * np.pi * self.f
        self.poles = -self.zeta * w + 1j * w * np.sqrt(1 - self.zeta**2)

    def frf(self, s: np.ndarray, outputs: int = 3, inputs: int = 1, form: str = "accelerance") -> np.ndarray:
        """FRFs ``(f, o, i)`` at the Laplace variable s."""
        H = np.zeros((len(s), outputs, inputs), complex)
        for p, x in zip(self.poles, self.shapes, strict=True):
            residue = np.outer(x[:outputs], x[:inputs]) / (2j * p.imag)
            H += residue / (s - p)[:, None, None] + residue.conj() / (s - p.conj())[:, None, None]
        return H * s[:, None, None] ** POWER[form]


def noisy(rng: np.random.Generator, H: np.ndarray, part: float) -> np.ndarray:
    """FRFs with circular noise, a part of each channel's root mean square."""
    size = part * np.sqrt(np.mean(np.abs(H) ** 2, axis=0, keepdims=True))
    return H + size * (rng.normal(size=H.shape) + 1j * rng.normal(size=H.shape)) / np.sqrt(2)


def lines(freq: np.ndarray) -> np.ndarray:
    return 2j * np.pi * np.asarray(freq)


def file(freq: np.ndarray, H: np.ndarray, form: str = "accelerance", **more: Any) -> dict[str, Any]:
    names = {"outputs": [f"{k + 1}Z" for k in range(H.shape[1])], "inputs": [f"{k + 1}Z" for k in range(H.shape[2])]}
    return {"freq": np.asarray(freq), "H": H[None], "form": form, **names, **more}


FIVE = (18.0, 41.0, 43.5, 77.0, 103.0)
