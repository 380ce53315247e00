"""The structure that draws are taken from: its FRFs without noise, and its modes."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from modalax.study.settings import of_key

BUILT_IN = "five_dof"


def load_simulation(name: str, folder: Path) -> Any:
    """Matrices or a modal model from a file (paths count from ``folder``), or the built-in system.

    Raises
    ------
    ValueError
        If the file holds something else.
    """
    from modalax.files import load
    from modalax.model import ModalModel, Structure
    from modalax.model.examples import five_dof

    if name == BUILT_IN and not (folder / name).exists():
        return five_dof()
    with of_key("[system] simulation"):
        found = load(folder / name)
    if not isinstance(found, Structure | ModalModel):
        raise ValueError(
            f"[system] simulation: {folder / name} holds a {type(found).__name__}; matrices M, C, K or modes are needed"
        )
    return found


def response(structure: Any, settings: Mapping[str, Any], joints: Any = ()) -> Any:
    """FRFs without noise, as a measurement with a run for each force amplitude.

    Parameters
    ----------
    structure
        Matrices or a modal model.
    settings
        The table ``[system]``.
    joints
        Further joints, each ``(law, where)``, beside those of the settings.

    Raises
    ------
    ValueError
        If there are joints and no force, a DoF is not in the structure, or the step makes one line or too many.
    """
    from modalax.data.lines import lines_of_band
    from modalax.model.receptance import dof_names
    from modalax.simulate.harmonic import simulate
    from modalax.simulate.joints.text import joint_of_table

    placed = [*(joint_of_table(f"[[system.joint]] {k + 1}", t) for k, t in enumerate(settings["joint"] or ())), *joints]
    if placed and not settings["force"]:
        raise ValueError(
            "[system] has joints, whose response depends on the force, but no force; give force = [N, ...]"
        )
    _check_dofs(structure, settings, placed)
    low, high = settings["band"]
    options: dict[str, Any] = {"harmonics": settings["harmonics"]} if placed else {}
    return simulate(
        structure, [law for law, _ in placed], [where for _, where in placed],
        lines_of_band(low, high, settings["step"], "[system] step"), np.array(settings["force"] or [np.nan]),
        inputs=settings["inputs"] or [dof_names(structure)[0]], outputs=settings["outputs"], form=settings["form"],
        **options,
    )  # fmt: skip


def _check_dofs(structure: Any, settings: Mapping[str, Any], placed: Sequence[Any]) -> None:
    """Refuse names of DoFs that the structure has not, by the key that holds them."""
    from modalax.model.receptance import directions

    for key in ("inputs", "outputs"):
        with of_key(f"[system] {key}"):
            directions(structure, [[name] for name in settings[key] or ()])
    for k in range(len(settings["joint"] or ())):
        with of_key(f"[[system.joint]] {k + 1} where"):
            directions(structure, [placed[k][1]])


def poles_in(structure: Any, band: Any) -> np.ndarray:
    """Poles of the modes with natural frequencies in a band, by rising frequency [rad/s]."""
    from modalax.model import ModalModel

    model = structure if isinstance(structure, ModalModel) else structure.modal()
    poles = np.asarray(model.poles)
    f = np.abs(poles) / (2 * np.pi)
    kept = poles[(f >= band[0]) & (f <= band[1])]
    return kept[np.argsort(np.abs(kept))]
