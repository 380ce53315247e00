"""How far the demo's slipping joint is told from the truth, in stated standard deviations, over seeds of the noise.

usage: python experiments/diagnosis/demo_joint.py [--seeds 20] [--harmonics 9]
"""

import argparse

import jax

jax.config.update("jax_enable_x64", True)

import numpy as np  # noqa: E402

from modalax.cli.virtual import FREQ, JOINT, LEVELS, NOISE, SLIP, hidden_joint  # noqa: E402
from modalax.data import Measurement  # noqa: E402
from modalax.diagnose.causes.joints import ElastoSlip  # noqa: E402
from modalax.diagnose.causes.scene import Place  # noqa: E402
from modalax.diagnose.comparison import make_comparison, with_noise_beside  # noqa: E402
from modalax.diagnose.fitting.hypothesis import Hypothesis  # noqa: E402
from modalax.diagnose.search.harmonics import fitted_in_full  # noqa: E402
from modalax.model import Structure  # noqa: E402
from modalax.model.examples import five_dof  # noqa: E402
from modalax.simulate.harmonic import simulate  # noqa: E402


def main() -> None:
    """Fit the joint at its place with one harmonic and with all, for each seed."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--harmonics", type=int, default=9, help="of the virtual test")
    args = parser.parse_args()
    structure, (hidden, law) = five_dof(), hidden_joint()
    actual = Structure(*hidden.matrices(structure.M, structure.C, structure.K), structure.dofs)
    clean = simulate(actual, [law], [JOINT], FREQ, np.array(LEVELS), inputs=["1"], harmonics=args.harmonics)
    k = float(law.k)
    truth, place = np.array([k, np.log(SLIP / k)]), Place(JOINT, (*(structure.index(n) for n in JOINT), 0))
    off = {"one harmonic": [], "all": []}
    for seed in range(args.seeds):
        keys = jax.random.split(jax.random.key(seed), clean.runs)
        frfs = [clean.run(r).add_noise(key, NOISE) for r, key in enumerate(keys)]
        comparison = with_noise_beside(make_comparison(Measurement.from_frfs(frfs), structure))
        still = np.zeros((2, comparison.problem.modal_form.stiffness.shape[0]))
        null = comparison.fit([Hypothesis(theta=still)], 1)[0]
        start = null.with_cause(ElastoSlip(True), place, None, np.array([k, SLIP / k]))
        one = comparison.fit([start], 50)[0]
        for name, h in zip(off, (one, fitted_in_full(comparison, null, one)), strict=True):
            error = np.array([h.params[0][0], np.log(h.params[0][1])]) - truth
            off[name].append([*error / np.sqrt(np.diag(h.covariance)), error @ np.linalg.inv(h.covariance) @ error])
    print("fit           stiffness, slip force: largest deviation   mean squared distance (2 is expected)")
    for name, rows in off.items():
        table = np.array(rows)
        largest = np.abs(table[:, :2]).max(axis=0)
        print(f"{name:13} {largest[0]:9.2f}, {largest[1]:10.2f} {'':18} {table[:, 2].mean():.2f}")


if __name__ == "__main__":
    main()
