"""A non-linear joint in a linear structure under a sine: harmonic balance on the joint's own displacement.

With ``x`` the relative displacement across the joint, ``x_h = x_lin,h - G(h omega) f_h``, where ``G`` is the linear
compliance across the joint and ``f`` the force of the law along the whole period (alternating frequency and time:
Cameron and Griffin, 1989). Odd harmonics; Newton's method on every line, level and input at once.
"""

import numpy as np
from generator.laws import Jenkins, Law
from generator.plant import Plant

HARMONICS = tuple(range(1, 24, 2))
FIRST = 4  # harmonics that are balanced alone first, from which the others are found at once
INSTANTS = 32  # of a period, for each harmonic


def force(law: Law, x: np.ndarray, omega: np.ndarray) -> np.ndarray:
    """Force harmonics (row, h) of the displacement harmonics ``x`` (row, h)."""
    harmonics, samples = HARMONICS[: x.shape[1]], INSTANTS * x.shape[1]
    phase = 2 * np.pi * np.outer(harmonics, np.arange(samples)) / samples
    wave = np.exp(1j * phase)
    q = (x @ wave).real
    if isinstance(law, Jenkins):
        moves = law.k * np.diff(q, axis=1, prepend=q[:, -1:]).T
        held = np.clip(law.k * q[:, -1], -law.limit, law.limit)
        f = np.empty(moves.shape)
        for _ in range(2):  # the second period is periodic
            for t in range(samples):
                held = f[t] = np.minimum(np.maximum(held + moves[t], -law.limit), law.limit)
        f = f.T - law.given * q
    else:
        v = ((1j * omega[:, None] * np.array(harmonics) * x) @ wave).real
        f = law.start(q, v)
    return 2 / samples * f @ wave.conj().T


def settle(law: Law, x_lin: np.ndarray, G: np.ndarray, omega: np.ndarray, x: np.ndarray, tolerance: float = 1e-8):
    """Displacement harmonics (row, h), and whether each row has converged.

    ``x_lin`` (row,): linear amplitude; ``G`` (row, h): compliance; ``x``: where to start.
    """
    rows, count = x.shape
    drive = np.zeros_like(x)
    drive[:, 0] = x_lin
    size = np.abs(x_lin) + 1e-300

    def rest(x, part):
        return x + G[part] * force(law, x, omega[part]) - drive[part]

    x = x.copy()
    active = np.arange(rows)
    r = rest(x, active)
    for _ in range(40):
        miss = np.linalg.norm(r, axis=1) / size[active]
        go = miss > tolerance
        active, r = active[go], r[go]
        if not len(active):
            break
        now, step = x[active], 1e-6 * size[active]
        J = np.empty((len(active), 2 * count, 2 * count))
        for k in range(2 * count):
            bump = np.zeros_like(now)
            bump[:, k % count] = step * (1.0 if k < count else 1j)
            d = (rest(now + bump, active) - r) / step[:, None]
            J[:, :, k] = np.concatenate([d.real, d.imag], axis=1)
        move = np.linalg.solve(J, np.concatenate([r.real, r.imag], axis=1)[..., None])[..., 0]
        move = move[:, :count] + 1j * move[:, count:]
        old = np.linalg.norm(r, axis=1)
        share = np.ones(len(active))
        for _ in range(6):
            new = rest(now - share[:, None] * move, active)
            worse = np.linalg.norm(new, axis=1) > old
            if not worse.any():
                break
            share = np.where(worse, share / 2, share)
        x[active] = now - share[:, None] * move
        r = rest(x[active], active)
    done = np.ones(rows, bool)
    done[active] = False
    return x, done


def joint_change(plant: Plant, b: np.ndarray, law: Law, freq, outputs, inputs, level):
    """Change of the receptance (run, f, o, i) at each force level by a joint across ``b``, and the share unsettled."""
    omega = 2 * np.pi * np.asarray(freq)
    eye = np.eye(len(plant.M))
    drive = plant.receptance(1j * omega, b[None], eye[inputs])[:, 0]  # (f, i)
    answer = plant.receptance(1j * omega, eye[outputs], b[None])[..., 0]  # (f, o)
    G = np.stack([plant.receptance(1j * h * omega, b[None], b[None])[:, 0, 0] for h in HARMONICS], axis=-1)
    rows = np.repeat(np.arange(len(omega)), len(inputs))
    x = np.zeros((len(rows), len(HARMONICS)), complex)
    changes, lost, before = [], 0, None
    for F in level:
        x_lin = F * drive.reshape(-1)
        if before is None:
            x[:, 0] = x_lin
        else:
            x = x * (F / before)
        x[:, :FIRST], _ = settle(law, x_lin, G[rows, :FIRST], omega[rows], x[:, :FIRST])
        x, done = settle(law, x_lin, G[rows], omega[rows], x)
        lost += int((~done).sum())
        f = force(law, x, omega[rows])[:, 0].reshape(len(omega), len(inputs)) / F
        changes.append(-answer[:, :, None] * f[:, None, :])
        before = F
    return np.stack(changes), lost / (len(rows) * len(level))
