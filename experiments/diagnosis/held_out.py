"""Held-out chi-square of an extended simulation beside what the true model has there, on the very same samples."""

import re
from pathlib import Path

import numpy as np
from marks import Mark

ASKED = 1.05


def held_out_mask(words: str, shape: tuple[int, int, int, int]) -> np.ndarray:
    """The samples that an answer's ``gain.held_out`` names, of runs, lines, outputs and inputs.

    Raises
    ------
    ValueError
        If the words are not of a kind that a diagnosis says.
    """
    mask = np.zeros(shape, bool)
    if found := re.match(r"runs? ([\d, ]+)", words):
        mask[[int(k) - 1 for k in found[1].replace(",", " ").split()]] = True
    elif words.startswith("the column of input"):
        mask[..., -1] = True
    elif found := re.match(r"every fourth of (\d+) blocks", words):
        edges = np.linspace(0, shape[1], int(found[1]) + 1).astype(int)
        for k in range(1, len(edges) - 1, 4):
            mask[:, edges[k] : edges[k + 1]] = True
    else:
        raise ValueError(f"held out is {words!r}; a run, a column or every fourth block was expected")
    return mask


def excess(folder: Path, mark: Mark) -> float:
    """Chi-square per sample after the extension over the true model's, both on the block that was held out."""
    gain = mark.said["gain"]
    with (
        np.load(folder / "truth" / f"{mark.name}.npz") as true,
        np.load(folder / "cases" / mark.name / "measurement.npz") as measured,
    ):
        H = measured["H"].reshape(true["H_true"].shape)
        error = np.abs(H - true["H_true"]) ** 2 / true["sigma"] ** 2
    return float(gain["chi2_after"] / error[held_out_mask(gain["held_out"], error.shape)].mean())


def excesses(folder: Path, marks: list[Mark]) -> dict[str, np.ndarray]:
    """Of singles and pairs named right, by how the variance was known."""
    found: dict[str, list[float]] = {}
    for mark in marks:
        if mark.kind in ("single", "pair") and mark.named_right and mark.said.get("gain"):
            kind = mark.truth["noise"]["variance"]
            key = {"exact": "exact", "missing": "missing"}.get(kind, "from repeats")
            found.setdefault(key, []).append(excess(folder, mark))
    return {k: np.array(v) for k, v in sorted(found.items())}
