"""One peer's poles of one case, run inside the peer's environment: ``identification_peer.py NAME CASE DEGREE REPEATS``.

Every second degree up to the highest where the peer can choose, otherwise every degree. A peer whose first run takes
longer than ``LONG`` is not run again. Prints seconds, largest memory, and errors against the true poles as JSON.
"""

import contextlib
import io
import json
import os
import re
import sys
import time

import numpy as np

LONG = 10.0
os.environ["QT_QPA_PLATFORM"] = "offscreen"  # two of the peers import a window system


def sdypy(H, freq, degree):
    """sdypy-EMA: ``Model.get_poles``, given outputs x lines."""
    from sdypy import EMA

    model = EMA.Model(
        H, freq, lower=float(freq[1]), upper=float(freq[-1]), pol_order_high=degree // 2, frf_form="receptance"
    )
    model.get_poles(method="lscf", show_progress=False)
    return model.pole_freq[-1], model.pole_xi[-1]


def sdynpy(H, freq, degree):
    """SDynPy: ``PolyPy.compute_poles``."""
    import sdynpy

    outputs = np.array([(k + 1, 1) for k in range(len(H))])
    places = [[(*place, 1, 1)] for place in outputs]
    coordinate = sdynpy.coordinate_array([p[0][0] for p in places], 1)[:, np.newaxis, np.newaxis]
    reference = sdynpy.coordinate_array(1, 1)
    pair = np.concatenate([coordinate, np.broadcast_to(reference, coordinate.shape)], axis=-1)
    data = sdynpy.data_array(
        sdynpy.data.FunctionTypes.FREQUENCY_RESPONSE_FUNCTION,
        np.broadcast_to(freq, (len(H), 1, len(freq))), H[:, np.newaxis], pair,
    )  # fmt: skip
    found = sdynpy.modal.PolyPy(data, displacement_derivative=0)
    found.compute_poles(np.arange(2, degree + 1, 2))
    last = found.pole_list[0]
    return last["omega"] / (2 * np.pi), last["zeta"]


def pyfbs(H, freq, degree):
    """pyFBS: ``ModalID.p_lscf``, given lines x outputs x inputs."""
    from pyfbs.modal_id.modal_id import ModalID

    found = ModalID(freq, H.T[:, :, None])
    found.p_lscf(degree, step_order=2)
    last = found.poles[-1][0]
    return np.abs(last) / (2 * np.pi), -last.real / np.abs(last)


def pyoma2(H, freq, degree):
    """pyOMA2: its function for half spectra, handed FRFs in their place; from time records it has no other way."""
    from pyoma2.functions.plscf import pLSCF, pLSCF_poles

    dt = 1 / (2 * freq[-1])
    A, B = pLSCF(H[:, None, :], dt, degree, sgn_basf=1.0)
    f, zeta, *_ = pLSCF_poles(A, B, dt, "per", 1)
    keep = np.isfinite(f[:, -1])
    return f[keep, -1], zeta[keep, -1]


def errors(f, zeta, given):
    """Largest relative errors of frequency and damping of the poles nearest to the true ones."""
    near = [int(np.argmin(np.abs(f - t))) for t in given["true"]]
    return {
        "frequency": float(max(abs(f[k] / t - 1) for k, t in zip(near, given["true"], strict=True))),
        "damping": float(max(abs(zeta[k] / t - 1) for k, t in zip(near, given["zeta"], strict=True))),
    }


def main():
    name, path, degree, repeats = sys.argv[1], sys.argv[2], int(sys.argv[3]), int(sys.argv[4])
    given, times, found = np.load(path), [], None
    for _ in range(repeats + 1):
        H, freq = given["H"].copy(), given["freq"].copy()
        began = time.perf_counter(), time.process_time()
        with contextlib.redirect_stdout(io.StringIO()):
            found = globals()[name](H, freq, degree)
        times.append((time.perf_counter() - began[0], time.process_time() - began[1]))
        if times[-1][1] > LONG:
            break
    peak = re.search(r"VmHWM:\s+(\d+)", open("/proc/self/status").read())
    print(json.dumps({"times": times, "peak": int(peak[1]) / 1024, **errors(*found, given)}))


if __name__ == "__main__":
    main()
