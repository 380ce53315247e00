"""Sweeps by a peer, run by ``harmonic_balance.py`` in the environment it makes: cases in, times and motions out."""

import logging
import sys
import time
from collections.abc import Callable
from typing import Any

import numpy as np


def tmdsimpy(case: Any) -> Callable[[], np.ndarray]:
    """Line by line, each started from the one before, by tmdsimpy's harmonic balance and its Newton solver."""
    from tmdsimpy.nlforces.vector_jenkins import VectorJenkins
    from tmdsimpy.solvers import NonlinearSolver
    from tmdsimpy.vibration_system import VibrationSystem

    M, C, K, b, h = (case[k] for k in ("M", "C", "K", "b", "harmonics"))
    n, solver = len(M), NonlinearSolver()
    system = VibrationSystem(M, K, C)
    system.add_nl_force(VectorJenkins(b[None], b[:, None], float(case["k"]), float(case["slip"])))
    force = np.zeros(n * 2 * len(h))
    force[0] = float(case["level"])

    def sweep() -> np.ndarray:
        motion, start = [], None
        for freq in case["freq"]:
            w = 2 * np.pi * freq

            def balance(X: np.ndarray, calc_grad: bool = True, w: float = w) -> tuple:
                return system.hbm_res(np.append(X, w), force, h, Nt=int(case["samples"]))[:2]

            if start is None:
                linear = np.linalg.solve(K + 1j * w * C - w**2 * M, np.eye(n)[0]) * float(case["level"])
                start = np.zeros_like(force)
                start[:n], start[n : 2 * n] = linear.real, -linear.imag
            start = solver.nsolve(balance, start, verbose=False)[0]
            motion.append(start[0] - 1j * start[n])
        return np.array(motion)

    return sweep


def pyharm(case: Any) -> Callable[[], np.ndarray]:
    """One response analysis of pyHarm: constant steps of frequency, each started from the one before."""
    from pyHarm.Maestro import Maestro

    M, C, K, b = (case[k] for k in ("M", "C", "K", "b"))
    w, n = 2 * np.pi * case["freq"], len(M)
    step = float(w[1] - w[0])
    analysis = {
        "study": "frf", "solver": "NewtonRaphson", "predictor": "previous", "corrector": "nocontinuation",
        "stepsizer": "constant", "ds0": step, "ds_max": step, "ds_min": 1e-12, "verbose": False,
        "puls_start": float(w[0]), "puls_inf": float(w[0]) - step / 2, "puls_sup": float(w[-1]) - step / 2,
    }  # fmt: skip
    slider = {"mu": 1.0, "N0": float(case["slip"]), "k": float(case["k"])}
    ends = {"s": [int(np.argmax(b))], "INTERNAL": [int(np.argmin(b))]}
    given = {
        "system": {"type": "Base", "nh": [int(k) for k in case["harmonics"]], "nti": int(case["samples"])},
        "substructures": {"s": {"matrix": {"M": M, "K": K, "C": C, "G": np.zeros_like(M)}, "ndofs": 1}},
        "connectors": {
            "joint": {"type": "Jenkins", "connect": ends, "dirs": [0], **slider},
            "force": {"type": "CosinusForcing", "connect": {"s": [0]}, "dirs": [0], "amp": float(case["level"])},
        },
        "analysis": {"frf": analysis},
    }

    def sweep() -> np.ndarray:
        maestro = Maestro(given)
        maestro.operate()
        found = np.array([s.x for s in maestro.nls["frf"].SolList])[: len(w)]
        assert np.allclose(found[:, -1], w)
        return found[:, 0] - 1j * found[:, n]

    return sweep


def main() -> None:
    name, case = sys.argv[1], np.load(sys.argv[2])
    logging.disable(logging.INFO)
    if len(sys.argv) > 4:
        sys.path.insert(0, sys.argv[4])
    sweep = {"tmdsimpy": tmdsimpy, "pyharm": pyharm}[name](case)
    took = []
    for _ in range(int(case["repeats"])):
        began = time.process_time()
        motion = sweep()
        took.append(time.process_time() - began)
    np.savez(sys.argv[3], first=took[0], cpu=min(took), motion=motion)


if __name__ == "__main__":
    main()
