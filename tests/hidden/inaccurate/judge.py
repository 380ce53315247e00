"""How often a perfect namer, who knows how the elements scatter, would be right about a gross error.

The FRF is linearised about the structure as it is, in every element's stiffness and mass, every modal damping, and
every gross error that could be named at every place. With whitened derivatives ``J`` of the general errors (times
their standard deviations) and ``u_h`` of the nameable ones, the data are ``a u_h + J z + n``, ``z`` and ``n`` standard
normal, so all that matters are the products ``V = U' (I + J J')^-1 U``: the statistic ``t = U' (I + J J')^-1 r`` is
normal with mean ``a V[:, h]`` and covariance ``V``, and the odds of ``h`` against none are
``exp(tau^2 t_h^2 / 2 / (1 + tau^2 V_hh)) / sqrt(1 + tau^2 V_hh)`` for a size of standard deviation ``tau``. The
namer gives half his prior to none and the rest evenly to the kinds, then to their places. ``d = |a| sqrt(V_hh)`` is
the distance beyond the general inaccuracy; a joint's ``a`` is its best fit at the linear motion.
"""

from dataclasses import dataclass, field
from typing import Any

import numpy as np
import scipy.linalg
from generator.effect import Setup
from generator.plant import DERIVATIVES
from generator.rivals import describing
from generator.systems import System

from .gross import JOINTS, Gross, Scene, Test
from .structures import Build, modes
from .world import Spread, World

CHUNK = 64
DRAWS = 2000
TYPICAL = {"joint_stiffness": 0.35, "beam_stiffness": 0.35, "added_mass": 0.05, "local_damper": 2.5}
CHANNEL_TYPICAL = {"channel_gain": 0.3, "force_gain": 0.3, "time_delay": 0.6}


@dataclass(frozen=True)
class Verdict:
    """``right``: share of redraws in which the perfect namer has name and place; ``d``: see above."""

    d: float
    right: float
    rivals: dict[str, float] = field(default_factory=dict)

    def described(self) -> dict[str, Any]:
        return {"d": self.d, "perfect_right": self.right, "perfect_calls": self.rivals}


@dataclass
class Column:
    """One nameable error: kind, place, typical size, and its derivative on a chunk of lines (run, f, o, i)."""

    kind: str
    place: tuple[str, ...]
    typical: float
    slope: Any


class Sensitivities:
    """Derivatives of the FRF of one structure, chunk by chunk."""

    def __init__(self, build: Build, world: World, general: World, test: Test, spread: Spread, gross: Gross | None):
        self.build, self.world, self.test, self.spread, self.gross = build, world, test, spread, gross
        omega, shapes = modes(general.M, general.K)
        top = 2.0 * test.omega[-1]
        keep = omega < top
        left = general.M @ shapes[:, keep]
        self.dampings = (left, 2 * general.zeta[keep] * omega[keep])
        inside = (omega > test.omega[0]) & (omega < test.omega[-1])
        self.scene = Scene(build, general, test, inside, test)
        self.total = self.scene.total
        self.references = {
            j: 1 / self.scene.added_damping(build.direction(build.elements[j].where)) for j in build.springs
        }

    def general(self, Ho, Hi, s):
        """Columns (f, o, i, p) of the general errors, times their standard deviations."""
        columns = []
        for e in self.build.elements:
            left, right = Ho[:, :, e.at], Hi[:, e.at]
            if e.k.any() and self.spread.stiffness:
                columns.append(-self.spread.stiffness * ((left @ e.k) @ right))
            if e.m.any() and self.spread.mass:
                columns.append(-self.spread.mass * s**2 * ((left @ e.m) @ right))
        if self.spread.damping:
            L, c = self.dampings
            left, right = Ho @ L, np.swapaxes(L.T @ Hi, 1, 2)
            for r, size in enumerate(c):
                columns.append(-self.spread.damping * size * s * left[:, :, r, None] * right[:, None, :, r])
        return np.stack(columns, axis=-1) if columns else np.zeros((*np.shape(Ho @ Hi), 0))

    def nameable(self, Ho, Hi, H, s, which: slice) -> list[Column]:
        """Every gross error of the catalogue that is linear in its size."""
        build, names, found = self.build, self.scene.names, []
        rank_one = lambda b: (Ho @ b)[:, :, None] * (b @ Hi)[:, None, :]
        for j, e in enumerate(build.elements):
            if e.kind == "spring":
                unit, place = rank_one(build.direction(e.where)), tuple(sorted(names(e.where)))
                typical = TYPICAL["joint_stiffness"]
                found.append(Column("joint_stiffness", place, typical, -e.k[0, 0] * unit))
                damper = -self.references[j] * s * unit
                found.append(Column("local_damper", place, TYPICAL["local_damper"], damper))
            elif e.kind == "beam":
                slope = -(Ho[:, :, e.at] @ e.k) @ Hi[:, e.at]
                found.append(Column("beam_stiffness", (f"element {j}",), TYPICAL["beam_stiffness"], slope))
        for at in build.deflections:
            unit = -self.total * s**2 * rank_one(build.direction((at,)))
            found.append(Column("added_mass", (build.dofs[at],), TYPICAL["added_mass"], unit))
        for kind, typical in CHANNEL_TYPICAL.items():
            axis = self.test.inputs if kind == "force_gain" else self.test.outputs
            for k, at in enumerate(axis):
                slope = np.zeros_like(H)
                cut = (slice(None), slice(None), k) if kind == "force_gain" else (slice(None), k)
                slope[cut] = H[cut]
                if kind == "time_delay":
                    slope = slope * (-s / self.test.omega[-1])
                found.append(Column(kind, (build.dofs[at],), typical, slope))
        return [Column(c.kind, c.place, c.typical, c.slope[None]) for c in found]

    def joints(self, Ho, Hi, freq) -> list[Column]:
        """Describing functions at the linear motion: the law at every spring, every law at the right place."""
        g = self.gross
        assert g is not None and g.b is not None
        found = []
        for j in self.build.springs:
            where = self.build.elements[j].where
            b = self.build.direction(where)
            mine = bool(np.array_equal(b, g.b))
            drive = (b @ Hi)[None] * self.test.level[:, None, None]
            peak = self.peaks[j]
            unit = (Ho @ b)[:, :, None] * (b @ Hi)[:, None, :]
            for k, (slug, Z) in enumerate(self._laws(drive, peak, freq)):
                if mine or slug == g.name:
                    place = tuple(sorted(self.scene.names(where)))
                    found.append(Column(slug, (*place, str(k)), np.inf, -Z[:, :, None, :] * unit[None]))
        return found

    def _laws(self, drive, peak, freq):
        """Laws with thresholds as shares of the place's largest motion over all lines."""
        test = self.test
        setup = Setup(SYSTEM, freq, test.form, [], [], test.level, False)
        extra = np.full((1, *drive.shape[1:]), peak)  # so that thresholds refer to the whole band
        for slug, Z in describing(setup, np.concatenate([drive, extra])):
            if slug in JOINTS:
                yield slug, Z[:-1] / peak ** {"cubic_stiffness": 2, "quadratic_damping": 1}.get(slug, 0)

    @property
    def peaks(self) -> dict[int, float]:
        if not hasattr(self, "_peaks"):
            top = float(np.max(self.test.level))
            self._peaks = {
                j: top * self.scene.motion(self.build.direction(self.build.elements[j].where))
                for j in self.build.springs
            }
        return self._peaks


SYSTEM = System(np.eye(1), np.eye(1), np.eye(1), ["1"], [], "none", "none", "none")


def gram(sense: Sensitivities, world: World, test: Test, sigma: np.ndarray, change: np.ndarray | None):
    """Products of all whitened columns over all samples: general errors first, then the nameable ones."""
    total, labels, count = None, [], 0
    for start in range(0, len(test.freq), CHUNK):
        which = slice(start, start + CHUNK)
        s = 1j * test.omega[which, None, None]
        inverse = np.linalg.inv(world.K + s * world.C + s**2 * world.M)
        Ho, Hi = inverse[:, test.outputs], inverse[:, :, test.inputs]
        H = Hi[:, test.outputs]
        J = sense.general(Ho, Hi, s)
        columns = sense.nameable(Ho, Hi, H, s, which)
        if sense.gross is not None and sense.gross.law is not None:
            columns += sense.joints(Ho, Hi, test.freq[which])
        factor = s ** DERIVATIVES[test.form]
        runs = len(test.level)
        weight = np.sqrt(2) / sigma[:, which]
        U = np.stack([np.broadcast_to(c.slope, (runs, *H.shape)) for c in columns], axis=-1)
        wide = np.concatenate([np.broadcast_to(J, (runs, *J.shape)), U], axis=-1) * factor[None, ..., None]
        if change is not None:
            wide = np.concatenate([wide, change[:, which, ..., None]], axis=-1)
        wide = (wide * weight[..., None]).reshape(-1, wide.shape[-1])
        part = (wide.real.T @ wide.real) + (wide.imag.T @ wide.imag)
        total = part if total is None else total + part
        labels, count = columns, J.shape[-1]
    return total, labels, count


def judge(
    build: Build, world: World, general: World, test: Test, sigma: np.ndarray, spread: Spread, gross: Gross | None,
    H: np.ndarray,
) -> Verdict:  # fmt: skip
    """The perfect namer's record on redraws of the general errors and the noise of one case."""
    sense = Sensitivities(build, world, general, test, spread, gross)
    finite = gross is not None and (gross.law is not None or gross.family in ("channel_sign", "channel_swap", "units"))
    change = None
    if finite:
        s = 1j * test.omega[:, None, None]
        eye = np.eye(build.n)
        inverse = np.linalg.solve(world.K + s * world.C + s**2 * world.M, eye[:, test.inputs][None])
        change = H - (inverse[:, test.outputs] * s ** DERIVATIVES[test.form])[None]
    total, labels, count = gram(sense, world, test, sigma, change)
    G = total[count:, count:]
    if count:
        core = np.eye(count) + total[:count, :count]
        half = scipy.linalg.solve_triangular(np.linalg.cholesky(core), total[:count, count:], lower=True)
        G = G - half.T @ half
    kinds = [c.kind for c in labels]
    places = [c.place for c in labels]
    tau = np.array([c.typical for c in labels])
    own = None
    if finite:
        side, square = G[:-1, -1], float(G[-1, -1])
        if gross.law is not None:
            mine = [k for k, c in enumerate(labels) if c.kind == gross.name and set(gross.where) <= set(c.place)]
            best = max(mine, key=lambda k: max(side[k], 0.0) ** 2 / G[k, k])
            own, size = best, max(side[best], 0.0) / G[best, best]
            G = G[:-1, :-1]
            scale = np.sqrt(square / np.maximum(np.diag(G), 1e-300))  # a law's size is free: as large as this effect
            tau = np.where(np.isinf(tau), scale, tau)
        else:
            own, size = len(labels), 1.0
            kinds, places, tau = [*kinds, gross.family], [*places, tuple(gross.where)], np.append(tau, 1.0)
    elif gross is not None:
        place = (f"element {gross.element}",) if gross.family == "beam_stiffness" else tuple(sorted(gross.where))
        own = next(k for k, c in enumerate(labels) if (c.kind, c.place) == (gross.family, place))
        size = gross.size
    return _record(G, kinds, places, tau, own, size if own is not None else 0.0)


def _record(V, kinds, places, tau, own: int | None, size: float) -> Verdict:
    scale = np.sqrt(np.maximum(np.diag(V), 1e-300))
    V, tau, size = V / scale / scale[:, None], tau * scale, size * (scale[own] if own is not None else 0.0)
    prior = np.array([0.5 / len(set(kinds)) / kinds.count(k) for k in kinds])
    values, vectors = np.linalg.eigh((V + V.T) / 2)
    root = vectors * np.sqrt(np.maximum(values, 0))
    t = np.random.default_rng(0).normal(size=(DRAWS, len(V))) @ root.T
    if own is not None:
        t = t + size * V[own]
    gain = tau**2
    odds = 0.5 * tau**2 * t**2 / (1 + gain) - 0.5 * np.log1p(gain) + np.log(prior)
    odds = np.concatenate([np.full((DRAWS, 1), np.log(0.5)), odds], axis=1)
    called = odds.argmax(axis=1)
    names = [("none",), *((k, *(p[:-1] if k in JOINTS else p)) for k, p in zip(kinds, places, strict=True))]
    aim = ("none",) if own is None else names[own + 1]
    said = [names[c] for c in called]
    right = float(np.mean([s == aim for s in said]))
    wrong = {" ".join(s): said.count(s) / DRAWS for s in set(said) if s != aim}
    return Verdict(abs(float(size)), right, dict(sorted(wrong.items(), key=lambda item: -item[1])[:5]))
