"""Stepped sine on a structure with non-linear joints: time marching to the periodic state, every line at once.

The structure's modes are propagated exactly over a step for a joint force that runs straight from its start to its
end; the force at the end meets the joint's law there exactly (``laws.py``). The linear answer to the sine is known in
closed form, so only the joint's share is marched. Periods are repeated until they do not change; between them the
starting state is moved towards the periodic one by Anderson mixing of the linear shooting step.
"""

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from .laws import Law
from .plant import Plant, state_modes

if TYPE_CHECKING:
    from .effect import Setup

MOST_SWEEPS, AGREED = 4, 1e-6  # over the joints of one step, until their forces agree to this share of the largest


@dataclass(frozen=True)
class Joint:
    """A law across the direction ``b`` (n,)."""

    law: Law
    b: np.ndarray


@dataclass(frozen=True)
class Steps:
    """One step's propagation for every row (a line, a run, an input) and state mode."""

    E: np.ndarray  # (row, m)
    A: np.ndarray  # (joint, row, m): what the force at the start of the step adds
    B: np.ndarray  # at its end
    out: np.ndarray  # (m, 2 joint): displacement and velocity across each joint
    compliance: np.ndarray  # (row, 2 joint, joint)
    dt: np.ndarray  # (row,)


def propagation(plant: Plant, joints: list[Joint], period: np.ndarray, steps: int):
    """Poles kept (one of each pair), and the exact step of length period/steps for each row."""
    n = len(plant.M)
    poles, V, W = state_modes(plant.M, plant.C, plant.K)
    keep = poles.imag >= 0
    weight = np.where(poles.imag > 0, 2.0, 1.0)[keep]
    poles, V, W = poles[keep], V[:, keep], W[keep]
    b = np.stack([np.pad(j.b, (0, n - len(j.b))) for j in joints])
    out = np.concatenate([V[:n].T @ b.T, V[n:].T @ b.T], axis=1) * weight[:, None]
    gain = -W @ np.linalg.solve(plant.M, b.T)  # (m, joint)
    dt = period / steps
    z = poles[None] * dt[:, None]
    E = np.exp(z)
    whole = np.where(np.abs(z) < 1e-3, 1 + z / 2 + z**2 / 6, (E - 1) / z)
    end = np.where(np.abs(z) < 1e-3, 0.5 + z / 6 + z**2 / 24, (E - 1 - z) / z**2)
    B = gain.T[:, None] * (end * dt[:, None])[None]
    A = gain.T[:, None] * ((whole - end) * dt[:, None])[None]
    for j, joint in enumerate(joints):
        if joint.law.held:
            A[j], B[j] = 0.0, A[j] + B[j]
    compliance = np.einsum("jrm,mk->rkj", B, out).real
    return poles, Steps(E, A, B, out, compliance, dt)


def one_period(step: Steps, laws: list[Law], p, f, q_lin, v_lin, steps: int):
    """March one period from state ``p`` (row, m), joint forces ``f`` (row, joint).

    ``q_lin``, ``v_lin`` are complex amplitudes (row, joint) of the linear answer. Returns the new state and forces and
    the fundamental of the forces (row, joint).
    """
    count = len(laws)
    of = np.ascontiguousarray(step.compliance.transpose(2, 1, 0))  # what each force moves, (joint, 2 joint, row)
    spin = np.exp(2j * np.pi * np.arange(steps + 1) / steps)
    middle = np.exp(1j * np.pi / steps) * np.sinc(1 / steps)
    linear = np.concatenate([q_lin, v_lin], axis=1).T.copy()
    f = f.T.copy()
    fundamental = np.zeros(f.shape, complex)
    now = linear.real + (p @ step.out).real.T
    for k in range(steps):
        p = p * step.E
        for j in range(count):
            p += step.A[j] * f[j, :, None]
        free = (linear * spin[k + 1]).real + (p @ step.out).real.T
        new, there = f.copy(), free + sum(of[j] * f[j] for j in range(count))
        for _ in range(1 if count == 1 else MOST_SWEEPS):
            before = new.copy()
            for j, law in enumerate(laws):
                there -= of[j] * new[j]  # where the forces of the others alone lead
                new[j] = law.solve(there[j], there[count + j], of[j, j], of[j, count + j], now[j], now[count + j], f[j])
                there += of[j] * new[j]
            if np.abs(new - before).max() < AGREED * np.abs(new).max():
                break
        for j, law in enumerate(laws):
            p += step.B[j] * new[j, :, None]
            fundamental[j] += new[j] * (spin[k] * middle if law.held else spin[k + 1]).conj()
        f, now = new, free + sum(of[j] * new[j] for j in range(count))
    return p, f.T, fundamental.T * 2 / steps


class Anderson:
    """Batched Anderson mixing with a short memory; rows are independent."""

    def __init__(self, memory: int = 8):
        self.memory, self.x, self.r = memory, [], []

    def step(self, x: np.ndarray, r: np.ndarray) -> np.ndarray:
        self.x, self.r = [*self.x, x][-self.memory :], [*self.r, r][-self.memory :]
        if len(self.x) == 1:
            return x + r
        dx = np.stack([a - b for a, b in zip(self.x[1:], self.x[:-1], strict=True)], axis=1)
        dr = np.stack([a - b for a, b in zip(self.r[1:], self.r[:-1], strict=True)], axis=1)
        size = np.linalg.norm(dr, axis=2, keepdims=True) + 1e-300
        dx, dr = dx / size, dr / size
        gram = np.einsum("rks,rls->rkl", dr, dr)
        gram += 1e-12 * np.eye(gram.shape[1])
        gamma = np.linalg.solve(gram, np.einsum("rks,rs->rk", dr, r)[..., None])[..., 0]
        return x + r - np.einsum("rk,rks->rs", gamma, dx + dr)

    def keep(self, rows: np.ndarray) -> None:
        self.x, self.r = [a[rows] for a in self.x], [a[rows] for a in self.r]


def take(step: Steps, rows: np.ndarray) -> Steps:
    return Steps(step.E[rows], step.A[:, rows], step.B[:, rows], step.out, step.compliance[rows], step.dt[rows])


def march(
    plant: Plant, setup: "Setup", joints: list[Joint], steps: int = 256, tolerance: float = 1e-4, periods: int = 60
) -> tuple[np.ndarray, dict]:
    """Change of the receptance (run, f, o, i) by the joints at each force level, and how well it settled.

    ``tolerance``: a row is settled when its joint force's fundamental changes by less than this share from one period
    to the next, twice, and the shooting step is as small.
    """
    n = len(plant.M)
    omega, level = setup.omega, setup.level
    b = np.stack([np.pad(j.b, (0, n - len(j.b))) for j in joints])
    across = plant.receptance(1j * omega, b, setup.columns)  # (f, joint, i)
    shape = (len(level), len(omega), len(setup.inputs))
    rows = lambda A: np.broadcast_to(A, (*shape, *A.shape[3:])).reshape(-1, *A.shape[3:])
    q_lin = rows(level[:, None, None, None] * np.moveaxis(across, 1, 2)[None])
    w = rows(omega[None, :, None])
    v_lin = 1j * w[:, None] * q_lin
    poles, step = propagation(plant, joints, 2 * np.pi / w, steps)
    laws = [j.law for j in joints]
    scale = np.abs(step.out[:, : len(joints)]).max(axis=1) + 1e-300
    p = np.zeros((len(w), len(poles)), complex)
    f = np.stack([law.start(q_lin[:, j].real, v_lin[:, j].real) for j, law in enumerate(laws)], axis=1)
    result = np.zeros_like(q_lin)
    loudest = np.abs(q_lin).sum(axis=1).reshape(shape).max(axis=1, keepdims=True)
    peak = np.array(np.broadcast_to(10 * loudest, shape)).ravel()
    change = np.full(len(w), np.inf)
    active, mix = np.arange(len(w)), Anderson()
    part, fundamental, calm = step, None, np.zeros(len(w), int)
    shooting = 1 / (1 - np.exp(poles[None] * (2 * np.pi / w)[:, None]))
    spent = 0
    for k in range(periods):
        spent += len(active)
        end, f, now = one_period(part, laws, p, f, q_lin[active], v_lin[active], steps)
        r = shooting[active] * (end - p) * scale
        size = np.abs(now).sum(axis=1)
        size = size + 1e-3 * size.max() + 1e-300  # a joint that is at rest has no share to settle
        moved = np.abs(now - fundamental).sum(axis=1) / size if fundamental is not None else np.full(len(active), 1.0)
        motion = np.abs(q_lin[active]).sum(axis=1) + np.abs(p * scale).sum(axis=1)
        rest = np.abs(r).sum(axis=1) / (motion + 1e-300)
        result[active] = now
        change[active] = moved
        calm[active] = np.where((moved < tolerance) & (rest < 10 * tolerance), calm[active] + 1, 0)
        moves = (size > 1e-290) | (np.abs(p).sum(axis=1) > 0)  # a joint may rest for one period on its way
        go = (calm[active] < 2) & moves
        if not go.any():
            break
        real = lambda a: np.concatenate([a.real, a.imag], axis=1)
        if k < 2:
            moved_p = p + r / scale
        elif k % 20 == 19:  # start the memory afresh with a plain period
            mix, moved_p = Anderson(), end
        else:
            x = mix.step(real(p * scale), real(r))
            moved_p = (x[:, : len(poles)] + 1j * x[:, len(poles) :]) / scale
        wild = ~(np.abs(moved_p * scale).sum(axis=1) < peak[active])  # then a plain period, which cannot run away
        moved_p[wild] = end[wild]
        mix.keep(go)
        p, f, fundamental, active = moved_p[go], f[go], now[go], active[go]
        part = take(step, active)
    left = int((calm < 2).sum()) if len(active) and go.any() else 0
    force = result.reshape(*shape, len(joints)) / level[:, None, None, None]
    response = plant.receptance(1j * omega, setup.rows, b)
    H = -np.einsum("foj,rfij->rfoi", response, force)
    return H, {"periods": k + 1, "row_periods": spent, "unsettled_rows": left, "rows": len(w)}
