r"""What can be said at best of each virtual test of the wing: an ideal observer of the same FRFs.

``MODALAX_DATA=... python experiments/measured/ideal_wing.py [--only N ...] [--in-band]`` prints for each case of
``virtual_wing.py`` how much likelier, in nats, the FRFs are with an error at the true place than without one, and the
probability of that place, where the sizes of the general inaccuracy are known, and where they are learnt with the
priors of the package.

The observer knows the truth as the point about which the FRFs are linear in everything unknown: all elements, lumps,
modal dampings and one further error (a part of an element's stiffness with a standard deviation of 0.4, or a mass of
0.03 of the total). With derivatives J of FRFs of variance R, sizes S and data y, the log evidence is
:math:`\tfrac12 b^TS(I+SAS)^{-1}Sb-\tfrac12\ln|I+SAS|` for :math:`A=J^TR^{-1}J` and :math:`b=J^TR^{-1}y`. With
``--in-band`` it knows the modes in the band alone: what the rigid body and the three next modes above would add to each
FRF, by any residues, is projected out of J and y.
"""

import argparse
import os
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table
from virtual_wing import DAMPING, FREQ, INPUTS, OUTPUTS, TOLD, Hidden, Visible, Wing, draw, modes

from modalax.diagnose.modal_domain.fitting.inaccuracy import UNKNOWN, USUAL

ABOVE = 1.03  # of the band's end, from where on a mode lies beyond it
DAMPED = 30  # lowest modes whose damping is unknown
SPREAD = 0.2  # of the logarithm of damping
ERROR, LUMP = 0.4, 0.03  # usual gross error of an element, and mass relative to the total
KINDS = 15  # kinds of cause that a diagnosis looks for
ELEMENTS = 0.6  # chance of a whole element among all springs
STIFFNESS, MASS = np.geomspace(0.004, 0.1, 14), np.geomspace(0.001, 0.04, 9)  # sizes of the inaccuracy that are tried


def beyond(omega: np.ndarray) -> np.ndarray:
    """Accelerance of a rigid body and of the next modes above the band, over the lines, orthonormal ``(f, 4)``."""
    w = 2 * np.pi * FREQ
    above = np.sort(omega[omega > ABOVE * w[-1]])[:3]
    return np.linalg.qr(np.stack([np.ones_like(w), *(w**2 / (u**2 - w**2) for u in above)], axis=1))[0]


class Ideal:
    """Information of a case's FRFs on everything unknown: elements, lumps, dampings, then masses that are added."""

    def __init__(self, wing: Wing, hidden: Hidden, in_band: bool = False):
        self.wing, self.counts = wing, (len(wing.elements), len(wing.nodes))
        mass, k, phi = modes(hidden.K, hidden.M)
        c = 2 * hidden.zeta * np.sqrt(np.maximum(mass * k, 0.0))
        rows, columns = (phi[[wing.names.index(n) for n in names]] for names in (OUTPUTS, INPUTS))
        damped = np.argsort(np.where(mass > 1e-12 * mass.max(), np.abs(k / np.maximum(mass, 1e-300)), np.inf))[:DAMPED]
        root = np.ones(len(k))
        for factor, p in zip(hidden.mass, wing.nodes, strict=True):
            root[wing.at[p]] = np.sqrt(factor)
        lumped = wing.M * np.outer(root, root)
        slopes = []
        for w in 2 * np.pi * FREQ:
            D = 1 / (k - w**2 * mass + 1j * w * c)
            left, right = (phi * D) @ rows.T, (phi * D) @ columns.T
            of = [-(left[i].T @ matrix @ right[i]) for _, i, matrix in wing.elements]
            for p, factor in zip(wing.nodes, hidden.mass, strict=True):
                d = wing.at[p]
                both = left[d].T @ (lumped[d] @ right) + (lumped[d] @ left).T @ right[d]
                of.append(w**2 * both / (2 * factor))
            of += [-1j * w * c[r] * D[r] ** 2 * np.outer(rows[:, r], columns[:, r]) for r in damped]
            of += [w**2 * (left[d].T @ right[d]) for d in Visible.lumps(wing)]
            slopes.append(-(w**2) * np.array(of))
        J = (np.array(slopes) / hidden.sigma).transpose(1, 0, 2, 3)
        noise = (hidden.noisy - hidden.H) / hidden.sigma
        if in_band:
            Q = beyond(np.sqrt(np.maximum(k / np.maximum(mass, 1e-300), 0.0))[mass > 1e-12 * mass.max()])
            J, noise = (x - np.einsum("fa,ga,...gij->...fij", Q, Q, x, optimize=True) for x in (J, noise))
        J, noise = J.reshape(len(J), -1), noise.ravel()
        added = np.zeros(len(wing.nodes))
        truth = hidden.truth
        if truth["name"] == "added_mass":
            added[wing.nodes.index(truth["nodes"][0])] = truth["kg"]
        true = np.r_[hidden.stiffness - 1, hidden.mass - 1, np.log(hidden.zeta[damped] / DAMPING), added]
        self.A = 2 * np.real(J.conj() @ J.T)
        self.b = 2 * np.real(J.conj() @ noise) + self.A @ true
        e, n = self.counts
        self.causes = np.r_[np.arange(e), np.arange(len(true) - n, len(true))]
        ends = [list(x) for x, _, _ in wing.elements]
        mass_at = wing.nodes.index(truth["nodes"][0])
        self.true = e + mass_at if truth["name"] == "added_mass" else ends.index(list(truth["nodes"]))

    def evidence(self, stiffness: float, mass: float) -> tuple[float, np.ndarray]:
        """Log evidence without and with each cause, for given sizes of the inaccuracy."""
        e, n = self.counts
        base = np.arange(len(self.b) - n)
        S = np.r_[np.full(e, stiffness), np.full(n, mass), np.full(DAMPED, SPREAD)]
        L = np.linalg.cholesky(self.A[np.ix_(base, base)] * np.outer(S, S) + np.eye(len(S)))
        z = np.linalg.solve(L, S * self.b[base])
        X = np.linalg.solve(L, self.A[np.ix_(base, self.causes)] * S[:, None])
        energy = self.A[self.causes, self.causes] - (X**2).sum(axis=0)
        product = self.b[self.causes] - X.T @ z
        usual = np.r_[np.full(e, ERROR), np.full(n, LUMP * self.wing.mass)]
        none = 0.5 * float(z @ z) - float(np.log(np.diag(L)).sum())
        return none, none + 0.5 * product**2 / (energy + usual**-2) - 0.5 * np.log1p(energy * usual**2)

    def learnt(self) -> tuple[float, np.ndarray]:
        """The same, with sizes of the inaccuracy that nobody told."""
        far = lambda size, name: -0.5 * (np.log(size / USUAL[name]) / UNKNOWN) ** 2
        every = [
            (far(k, "stiffness") + far(m, "mass") + x, far(k, "stiffness") + far(m, "mass") + y)
            for k in STIFFNESS for m in MASS for x, y in [self.evidence(k, m)]
        ]  # fmt: skip
        none, each = (np.logaddexp.reduce(np.array(values), axis=0) for values in zip(*every, strict=True))
        return float(none), each

    def told(self, none: float, each: np.ndarray) -> tuple[float, float]:
        """Nats by which the true place is likelier than none, and its probability among all places and none."""
        e, n = self.counts
        prior = np.log(0.5 / KINDS) + np.r_[np.full(e, np.log(ELEMENTS / e)), np.full(n, -np.log(n))]
        value = each + prior
        total = np.logaddexp.reduce(np.r_[value, none + np.log(0.5)])
        return float(each[self.true] - none), float(np.exp(value[self.true] - total))


def main() -> None:
    """Every case, and how many are surely told."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", type=int, nargs="*", default=range(60))
    parser.add_argument("--in-band", action="store_true", help="know the modes in the band alone")
    options = parser.parse_args()
    wing = Wing(Path(os.environ["MODALAX_DATA"]) / "nastran" / "mAEWing1_v5p2")
    visible = Visible(wing)
    rows = Table("case", "hidden", "at", "size", "nats", "known: nats", "probability", "learnt: nats", "probability")
    sure = []
    for case in options.only:
        hidden = draw(wing, case)
        t, ideal = hidden.truth, Ideal(wing, hidden, options.in_band)
        nats = visible.nats(t)
        known, learnt = ideal.told(*ideal.evidence(t["spread"], t["spread"] / 3)), ideal.told(*ideal.learnt())
        sure.append((nats > TOLD, known[1] > 0.95, learnt[1] > 0.95))
        rows.add_row(
            str(case), t["name"], "-".join(map(str, t["nodes"])), f"{100 * t['size']:+.0f} %", f"{nats:.3g}",
            f"{known[0]:.3g}", f"{known[1]:.3f}", f"{learnt[0]:.3g}", f"{learnt[1]:.3f}",
        )  # fmt: skip
    Console(width=130).print(rows)
    for what, kind in (("above", True), ("below", False)):
        some = [s for s in sure if s[0] == kind]
        print(
            f"{len(some)} cases {what} {TOLD:.0f} nats: {sum(s[1] for s in some)} surely told with known sizes, "
            f"{sum(s[2] for s in some)} with learnt ones"
        )


if __name__ == "__main__":
    main()
