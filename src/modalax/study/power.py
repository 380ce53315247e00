"""Diagnosis studies: how often an effect of some size, hidden in a measurement, is named rightly (the power).

The hidden effect is put in by the routes that simulate (local elements, harmonic balance, rows of the FRFs), not by the
maps that the diagnosis itself fits. A size of 0 is a measurement that agrees with the simulation: what is named there
is a false alarm.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from modalax.study.settings import of_key
from modalax.study.system import load_simulation, response
from modalax.study.work import Quantity, Row, Work, chunk_for, key_of

ELEMENTS = {"added_mass": "Mass", "local_damper": "Damper", "joint_stiffness": "Spring"}
STRENGTH = {"added_mass": "mass", "local_damper": "damping", "joint_stiffness": "stiffness", "channel_gain": "gain"}
STRENGTH |= {"time_delay": "delay"}  # the parameter of the diagnosis that the size is a value of
EXACT = 1e-6  # noise, as a fraction of the reference, that stands for none: no measurement is exact


@dataclass(frozen=True)
class PowerWork(Work):
    """Diagnoses of measurements with an effect hidden at each size in turn.

    Attributes
    ----------
    measurements
        FRFs without noise, one for each size.
    simulation
        What the diagnosis compares them with.
    noise, reference
        As for :meth:`modalax.data.FRF.add_noise`.
    hidden, diagnose
        The tables ``[hidden]`` and ``[diagnose]``.
    """

    measurements: tuple[Any, ...]
    simulation: Any
    noise: float
    reference: str
    hidden: dict[str, Any]
    diagnose: dict[str, Any]

    def item(self, index: int) -> Row:
        """The verdict on draw ``index``: draws of the first size first."""
        import jax

        from modalax.data import Measurement
        from modalax.diagnose import diagnose

        size = self.labels(index)["size"]
        clean = self.measurements[self.hidden["sizes"].index(size)]
        keys = jax.random.split(key_of(self.seed, index), clean.runs)
        runs = [clean.run(r).add_noise(keys[r], self.noise, self.reference) for r in range(clean.runs)]
        answer = diagnose(
            Measurement.from_frfs(runs),
            self.simulation,
            question=self.diagnose["question"],
            causes=self.diagnose["causes"],
        ).to_dict()
        return judged(answer, self.hidden, size)

    def labels(self, index: int) -> Row:
        """The size of the effect hidden in draw ``index``."""
        return {"size": self.hidden["sizes"][index // (self.count // len(self.measurements))]}


def judged(answer: Mapping[str, Any], hidden: Mapping[str, Any], size: float) -> Row:
    """What a diagnosis says, beside what was hidden.

    ``right``: the effect alone is named, at its place (nothing at all for a size of 0). ``found``: it is among the
    causes or their alternatives. ``value`` and ``std`` are those of its parameter where it is named.
    """
    causes = answer["causes"]
    where = [str(w) for w in hidden["where"]]
    own = [c for c in causes if c["name"] == hidden["cause"] and [str(w) for w in c["where"]] == where]
    offered = [c for group in answer["alternatives"] for c in group if c["name"] == hidden["cause"]]
    there = own or any([str(w) for w in c["where"]] == where for c in offered)
    parameter = own[0]["parameters"].get(STRENGTH.get(hidden["cause"], ""), {}) if own else {}
    number = lambda name: float("nan") if parameter.get(name) is None else float(parameter[name])
    verdict = answer["verdict"]
    right = verdict == "clean" if size == 0 else verdict == "named" and bool(own) and len(causes) == 1
    return {
        "verdict": verdict,
        "causes": "; ".join(f"{c['name']} {' - '.join(map(str, c['where']))}".strip() for c in causes),
        "right": right,
        "found": bool(there),
        "probability": float(own[0]["probability"]) if own else 0.0,
        "value": number("value"),
        "std": number("std"),
    }


def prepare(settings: dict[str, Any], folder: Path) -> Work:
    """The work of a diagnosis study.

    Raises
    ------
    ValueError
        If the effect, a place or a parameter is unknown.
    """
    from modalax.diagnose.causes import as_causes

    system, hidden = settings["system"], settings["hidden"]
    as_causes(settings["diagnose"]["causes"])  # which knows all names
    simulation = load_simulation(system["simulation"], folder)
    measurements = tuple(with_effect(simulation, system, hidden, size) for size in hidden["sizes"])
    count = settings["draws"] * len(measurements)
    truth = "size" if hidden["cause"] in STRENGTH else None
    return PowerWork(
        count, chunk_for(count, settings["chunk"], 1), settings["seed"], measurements, simulation,
        max(system["noise"], EXACT), system["noise_reference"], hidden, settings["diagnose"],
        quantities=[Quantity("right"), Quantity("found"), Quantity("value", "std", truth)], group=("size",),
    )  # fmt: skip


def with_effect(simulation: Any, system: Mapping[str, Any], hidden: Mapping[str, Any], size: float) -> Any:
    """The FRFs of the simulation with an effect of some size, without noise.

    Raises
    ------
    ValueError
        If the effect is none of those that can be hidden, or its place is not there.
    """
    from modalax.model import receptance
    from modalax.simulate.joints import CATALOGUE
    from modalax.simulate.joints.text import make_joint

    cause, where = hidden["cause"], hidden["where"]
    known = [*ELEMENTS, "tuned_mass", *CHANNELS, *CATALOGUE]
    if cause not in known:
        raise ValueError(f"[hidden] cause is {cause!r}; effects that can be hidden are {', '.join(known)}")
    if cause not in CHANNELS:
        with of_key("[hidden] where"):
            receptance.directions(simulation, [where])
    if size == 0:
        return response(simulation, system)
    fixed = dict(hidden["fixed"] or {})
    if cause in CATALOGUE:
        parameter = hidden["parameter"] or next(iter(CATALOGUE[cause].units))
        joint = make_joint(f"[hidden] {cause}", cause, where, {**fixed, parameter: size})
        return response(simulation, system, [joint])
    if cause in CHANNELS:
        return _in_channels(response(simulation, system), cause, where, size)
    if cause == "tuned_mass":
        element = receptance.TunedMass.at(size, **_numbers(fixed, ("frequency_hz", "damping_ratio")))
    else:
        element = getattr(receptance, ELEMENTS[cause])(size)
    return response(receptance.change(simulation, where, element), system)


def _numbers(fixed: Mapping[str, Any], names: tuple[str, ...]) -> dict[str, float]:
    if set(fixed) != set(names):
        raise ValueError(f"[hidden] fixed has {', '.join(fixed) or 'nothing'}; it needs {' and '.join(names)}")
    return {name: float(fixed[name]) for name in names}


def _gain(H: np.ndarray, omega: np.ndarray, rows: list[int], size: float) -> np.ndarray:
    H[:, :, rows] *= 1 + size
    return H


def _sign(H: np.ndarray, omega: np.ndarray, rows: list[int], size: float) -> np.ndarray:
    H[:, :, rows] *= -1
    return H


def _swap(H: np.ndarray, omega: np.ndarray, rows: list[int], size: float) -> np.ndarray:
    H[:, :, rows] = H[:, :, rows[::-1]]
    return H


def _delay(H: np.ndarray, omega: np.ndarray, rows: list[int], size: float) -> np.ndarray:
    rows = rows or list(range(H.shape[2]))
    H[:, :, rows] *= np.exp(-1j * omega * size)[:, None, None]
    return H


Fault = Callable[[np.ndarray, np.ndarray, list[int], float], np.ndarray]
CHANNELS: dict[str, Fault] = {"channel_gain": _gain, "channel_sign": _sign, "channel_swap": _swap, "time_delay": _delay}


def _in_channels(measurement: Any, cause: str, where: list[str], size: float) -> Any:
    """A measurement with a fault of some of its outputs."""
    unknown = [name for name in where if name not in measurement.outputs]
    wanted = {"channel_swap": (2,), "time_delay": (0, 1)}.get(cause, (1,))
    if unknown or len(where) not in wanted:
        raise ValueError(
            f"[hidden] where is {where}; {cause} needs {' or '.join(map(str, wanted))} of the outputs "
            f"{', '.join(measurement.outputs)}"
        )
    rows = [measurement.outputs.index(name) for name in where]
    changed = CHANNELS[cause](np.array(measurement.H), 2 * np.pi * np.asarray(measurement.freq), rows, size)
    return measurement.replace(H=changed)
