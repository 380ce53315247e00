"""A simulation corrected for the general inaccuracy: matrices, FRFs, and what is told of it and of its causes."""

from dataclasses import replace
from typing import Any

import jax.numpy as jnp
import numpy as np

from modalax._numerics.text import percent
from modalax._numerics.triangles import backward, forward
from modalax.data.frf import DERIVATIVES
from modalax.diagnose.causes import Cause, catalogue, imitators
from modalax.diagnose.causes.scene import Place
from modalax.diagnose.extend import ExtendedSimulation
from modalax.diagnose.modal_domain.causes.change import own_sizes, with_sizes
from modalax.diagnose.modal_domain.causes.given_elements import changed_by_elements
from modalax.diagnose.modal_domain.fitting.between_modes import RIGID
from modalax.diagnose.modal_domain.fitting.fit import Fit, scale_of, widths_of_sizes
from modalax.diagnose.modal_domain.fitting.inaccuracy import KINDS, THROUGHOUT, TOLD, WITHIN
from modalax.diagnose.modal_domain.fitting.linear import root_of_information
from modalax.diagnose.modal_domain.fitting.state import FARTHEST, Setting, off_by, slopes_at
from modalax.diagnose.modal_domain.fitting.throughout import throughout_told
from modalax.diagnose.modal_domain.levels.laws import NAMED
from modalax.diagnose.modal_domain.on_lines.polish import frf_on_lines
from modalax.diagnose.modal_domain.records.forced import Forced
from modalax.diagnose.modal_domain.stage import Stage
from modalax.diagnose.modal_domain.structure.coordinates import modes_of
from modalax.diagnose.modal_domain.structure.many_lines import receptance
from modalax.diagnose.modal_domain.structure.modes_only import ModesOnly, between_drives
from modalax.model import ModalModel, Structure

DRAWS, BESIDE = 16, 24  # draws of the sizes of the inaccuracy, and of its parts for each
CONSISTENT = 3.0  # nats of log evidence by which an inaccuracy must be better than none to exclude none
SEEN = 1e-9  # size of a shape, relative to the largest, from which a mode is seen
NONE = 1e-5  # relative size that counts as no inaccuracy


def corrected(stage: Stage, f: Fit) -> Structure | ModalModel:
    """The simulation corrected for the inaccuracy of a fit, whole elements that are off, and damping along."""
    if isinstance(stage.simulation, ModesOnly):
        return _corrected_modes(stage, stage.simulation, f)
    whole = tuple(c for c in f.causes if c.in_structure)
    u = [v for c, v in with_sizes(f.causes, f.u) if c.in_structure]
    s, sizes = stage.simulation, f.sizes
    along = sum(c.changes(v)["C"] for c, v in with_sizes(f.causes, f.u) if c.along)
    whole = tuple(replace(c, along="", loss=None) for c in whole)
    M, C, K = (np.asarray(A) for A in (s.M, s.C, s.K))
    if s.elements is not None and s.elements.dofs:
        own = {name: _of_elements(stage.setting, sizes, name) for name in WITHIN}
        each = list(zip(whole, u, strict=True))
        dK, dM = changed_by_elements(s, own, [(c, v) for c, v in each if c.factor is not None])
        K, M, each = K + dK, M + dM, [(c, v) for c, v in each if c.factor is None]
        whole, u = tuple(c for c, _ in each), [v for _, v in each]
        for name in (*own, *(THROUGHOUT[name] for name in own)):
            sizes = np.where(_of_group(stage.setting, name), 0.0, sizes)
    change = off_by(stage.setting, sizes, f.causes, f.u)
    for cause, size in zip(whole, u, strict=True):
        for kind, part in cause.changes(size).items() if cause.local else ():
            change[kind] = change[kind] + part
    left = np.asarray(s.M) @ stage.coordinates.shapes
    change["C"] = change["C"] + along
    back = {key: left @ value @ left.T for key, value in change.items()}
    return s.replace(M=M + back["M"], C=C + back["C"], K=K + back["K"])


def _corrected_modes(stage: Stage, simulation: ModesOnly, f: Fit) -> ModalModel:
    """Modes alone, corrected: those of their changed modal matrices.

    What further modes add is a residual term, on which what comes on top does not act. As measured columns at drive
    points tell it for all DoFs, the model stays one of a structure, which a residual term of some FRFs is not.
    """
    c, m = stage.setting.coordinates, stage.measurement
    spare = np.arange(c.size) >= c.size - c.spares - c.local
    rows, columns = ([simulation.dofs.index(name) for name in names] for names in (m.outputs, m.inputs))
    flexible = np.zeros((len(simulation.dofs),) * 2)
    flexible[np.ix_(rows, columns)] = (c.outputs[:, spare] / c.frequencies[spare] ** 2) @ c.inputs[:, spare].T
    above = between_drives(flexible, [k for k in columns if k in rows])
    change = off_by(stage.setting, f.sizes, f.causes, f.u)
    for cause, value in with_sizes(f.causes, f.u):
        if cause.in_structure and cause.local:
            for kind, part in cause.changes(value).items():
                change[kind] = change[kind] + part
    modes = modes_of(c, change["M"], change["C"], change["K"])
    high, squares = modes.high
    own = np.concatenate([modes.poles, 1j * np.sqrt(squares) - 0.5 * np.einsum("kn,nm,km->k", high, c.damping, high)])
    shapes = np.vstack([modes.vectors, high / np.sqrt(2j * own.imag[len(modes.poles) :])[:, None]]) @ c.shapes.T
    some = np.abs(shapes).max(axis=1) > SEEN * np.abs(shapes).max()
    rigid = modes.low[0][modes.low[1] < (RIGID * c.frequencies[-1]) ** 2] @ c.shapes.T
    return ModalModel(
        own[some], shapes[some], shapes[some], outputs=simulation.dofs, inputs=simulation.dofs, upper=above @ above.T,
        lower=rigid.T @ rigid,
    )  # fmt: skip


def _modes(base: Structure | ModalModel) -> int:
    """How many modes a simulation has."""
    return len(base.poles) if isinstance(base, ModalModel) else len(base.dofs)


def _of_group(setting: Setting, name: str) -> np.ndarray:
    """Which of all patterns belong to one group."""
    a = setting.inaccuracy
    return np.array(a.groups)[a.group_of] == name


def _of_elements(setting: Setting, sizes: np.ndarray, name: str) -> np.ndarray:
    """Relative change of each element's stiffness or mass: its own, and what all have in common."""
    return sizes[_of_group(setting, name)] + np.expm1(sizes[_of_group(setting, THROUGHOUT[name])]).sum()


def frf_of(stage: Stage, f: Fit | None) -> np.ndarray:
    """FRFs ``(f, o, i)`` of the simulation, or of a fit, at the measured lines and in their form."""
    c, s = stage.coordinates, 2j * np.pi * stage.measured.freq
    order = DERIVATIVES[stage.measurement.form]
    if f is None:
        M, C, K = np.eye(c.size), c.damping, np.diag(c.frequencies**2)
        return receptance(M, C, K, c.outputs, c.inputs, s) * s[:, None, None] ** order
    return frf_on_lines(stage.setting, f.causes, f.sizes, f.u, s, order)


def inaccuracy_told(setting: Setting, f: Fit) -> dict[str, Any]:
    r"""Root mean square relative error of the modes' stiffness, mass and damping in the band, with 95 % intervals.

    The value is that of the measured modes, of logarithmic errors :math:`\ln(1+\delta)`. The interval is for the size
    of which these modes are a sample, as a claim or another structure's inaccuracy would be: with ``m`` independent
    errors, a mean square of ``m`` is known to a factor :math:`m/\chi^2_m`. Modes share elements, so that ``m`` is
    :math:`(\mathrm{tr}\,S)^2/\mathrm{tr}\,S^2`, ``S`` their covariance (Satterthwaite 1946).
    """
    a, c = setting.inaccuracy, setting.coordinates
    J = slopes_at(setting, f.state, f.causes, f.u)
    gram, right = J.T @ J, J.T @ (f.state.difference + J @ np.concatenate([f.sizes, f.u]))
    group, width = a.group_of, widths_of_sizes(f, setting)
    inside = np.unique(np.minimum(f.state.pairs, c.size - 2))  # not the spare coordinate, to which nothing belongs
    inside = inside[c.frequencies[inside] > RIGID * c.frequencies[inside[-1]]]
    nominal = {"K": c.frequencies**2, "M": np.ones(c.size), "C": np.diag(c.damping)}
    every = [
        (np.einsum("pkk->kp", p)[inside] / np.maximum(nominal[KINDS[g]][inside, None], 1e-300))
        for g, p in zip(a.groups, a.patterns, strict=True)
    ]
    # the rest is told as stiffness, a factor that is not told by itself with the elements, as is what is off unevenly
    apart = throughout_told(setting, f)
    also = {"rest": "stiffness"} | {group: name for name, group in WITHIN.items()}
    also |= {group: name for name, group in THROUGHOUT.items() if name not in apart}
    of = [[j for j, g in enumerate(a.groups) if name in (g, also.get(g))] for name in TOLD]
    shares = [np.concatenate([every[j] for j in some], axis=1) for some in of]
    independent = [_independent(share) for share in shares]
    rng = np.random.default_rng(0)
    seen: list[list[float]] = [[] for _ in TOLD]
    for _ in range(DRAWS):
        epsilon = f.epsilon * np.exp(width * rng.standard_normal(len(width)))
        s = scale_of(setting, f, epsilon)
        L = root_of_information(J, gram, s)
        about_mean = forward(L, s * right)[:, None] + rng.standard_normal((len(s), BESIDE))
        sizes = (s[:, None] * backward(L, about_mean))[: len(group)]
        relative = np.where(a.positive[:, None], np.expm1(np.minimum(sizes, FARTHEST)), sizes)
        for k, share in enumerate(shares):
            off = np.log1p(np.maximum(share @ relative[np.isin(group, of[k])], -0.9))
            seen[k] += np.sqrt(np.mean(off**2, axis=0)).tolist()
    told = {}
    for k, name in enumerate(TOLD):
        middle = np.median(seen[k])
        few = rng.chisquare(independent[k], (len(seen[k]), BESIDE)) / independent[k]
        low, high = np.quantile(np.array(seen[k])[:, None] / np.sqrt(few), (0.025, 0.975))
        if _may_be_none(setting, f, of[k], J, gram, right):
            low = 0.0
        told[name] = {"value": float(middle), "interval": [float(low), float(high)]}
    return told


def _independent(share: np.ndarray) -> float:
    """How many independent errors the modes hold, from what each part has in each mode, shape ``(mode, part)``."""
    S = share @ share.T
    return max(1.0, float(np.trace(S) ** 2 / max(np.sum(S**2), 1e-300)))


def _may_be_none(
    setting: Setting, f: Fit, which: list[int], J: np.ndarray, gram: np.ndarray, right: np.ndarray
) -> bool:
    """Whether the data are nearly as likely without one kind of inaccuracy."""
    values = []
    for size in (f.epsilon[which], np.full(len(which), NONE)):
        epsilon = f.epsilon.copy()
        epsilon[which] = size
        s = scale_of(setting, f, epsilon)
        L = root_of_information(J, gram, s)
        h = forward(L, s * right)
        values.append(0.5 * float(h @ h) - np.log(np.diag(L)).sum())
    return bool(values[0] - values[1] < CONSISTENT)


def inaccuracy_said(inaccuracy: dict[str, Any]) -> str:
    """General inaccuracy in one sentence."""
    parts = [
        f"{percent(v['value'])} ({percent(v['interval'][0])} to {percent(v['interval'][1])}) in {name}"
        for name, v in inaccuracy.items()
    ]
    return f"the modes of the simulation are generally off by {', '.join(parts)}"


def extension_of(stage: Stage, f: Fit, forced: Forced | None = None) -> ExtendedSimulation:
    """The corrected simulation with the causes, as an ordinary simulation."""
    known: dict[str, Cause] = {}
    for cause in (*catalogue(), *imitators()):
        known.setdefault(cause.slug, cause)
    base, causes, places, params, spread, extras = corrected(stage, f), [], [], [], [], []
    spring = stage.whole.spring if stage.whole is not None and stage.whole.alone else None
    own = [own_sizes(f.causes, k) for k in range(len(f.causes))]
    every = [(c, u, f.covariance[at, at]) for (c, u), at in zip(with_sizes(f.causes, f.u), own, strict=True)]
    every += [] if forced is None else [(forced.cause, forced.u, forced.covariance)]
    for c, u, covariance in every:
        if c.in_structure or c.slug not in known or c == spring:
            continue
        m = stage.measurement
        names = stage.simulation.dofs if c.local else (m.inputs if c.at_inputs else m.outputs)
        index = [names.index(str(w)) for w in c.where] + [-1, -1]
        index[0] = index[0] if c.first_index is None else c.first_index
        values, errors, extra = c.as_catalogue(u, covariance)
        causes.append(c.in_catalogue or known[c.slug])
        places.append(Place(tuple(c.where), (index[0], index[1], c.variant)))
        params.append(jnp.asarray(values))
        spread.append(jnp.asarray(errors))
        extras.append(None if extra is None else jnp.asarray(extra))
    joint = None if stage.seen is None else stage.seen.joint
    if joint is not None and joint.fit.law in NAMED:
        index = [stage.simulation.dofs.index(w) for w in joint.spot.where] + [-1]
        law = joint.fit if stage.whole is None else stage.whole.fit
        causes.append(law.law)
        places.append(Place(joint.spot.where, (index[0], index[1], 0)))
        params.append(jnp.asarray(law.p))
        spread.append(jnp.asarray(law.std))
        extras.append(None)
    return ExtendedSimulation(
        base, tuple(params), tuple(spread), jnp.zeros((2, _modes(base))), tuple(extras), tuple(causes),
        tuple(places), stage.measurement.outputs, stage.measurement.inputs, float(stage.measured.freq[0]),
    )  # fmt: skip
