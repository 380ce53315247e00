"""Sweeps by tmdsimpy, run by ``harmonic_balance.py`` in the environment it makes: cases in, times and motions out."""

import sys
import time

import numpy as np

sys.path.insert(0, sys.argv[1])

from tmdsimpy.nlforces.vector_jenkins import VectorJenkins  # noqa: E402
from tmdsimpy.solvers import NonlinearSolver  # noqa: E402
from tmdsimpy.vibration_system import VibrationSystem  # noqa: E402


def main() -> None:
    case = np.load(sys.argv[2])
    M, C, K, b, h = (case[k] for k in ("M", "C", "K", "b", "harmonics"))
    n, solver = len(M), NonlinearSolver()
    system = VibrationSystem(M, K, C)
    system.add_nl_force(VectorJenkins(b[None], b[:, None], float(case["k"]), float(case["slip"])))
    force = np.zeros(n * 2 * len(h))
    force[0] = float(case["level"])
    motion, start = [], None
    began, cpu = time.perf_counter(), time.process_time()
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
    np.savez(sys.argv[3], seconds=time.perf_counter() - began, cpu=time.process_time() - cpu, motion=motion)


if __name__ == "__main__":
    main()
