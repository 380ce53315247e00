"""First poles: those that come back in many orders of a common denominator."""

import numpy as np

# Model orders of the denominator; each in-band mode takes one, noise takes the rest.
LOWEST_ORDER, HIGHEST_ORDER, ORDER_STEP = 8, 44, 2
# Lines and principal FRFs used to find poles: enough for 40 modes, few enough for seconds.
MOST_LINES, MOST_FRFS = 3000, 10
# A root counts as seen again in another order within this share of its half bandwidth in frequency, and of its decay.
SAME_FREQUENCY, SAME_DECAY = 0.35, 0.5
# Share of the orders in which a root has to be seen to be tried as a mode.
STABLE = 0.4


def principal_frfs(X: np.ndarray) -> np.ndarray:
    """The strongest principal FRFs: combinations of all channels that hold nearly all that is above the noise."""
    if X.shape[1] <= MOST_FRFS:
        return X
    # Tall and thin: the eigenvectors of the small Gram matrix suffice.
    _, vectors = np.linalg.eigh(X.conj().T @ X)
    return X @ vectors[:, ::-1][:, :MOST_FRFS]


def telling_lines(X: np.ndarray) -> np.ndarray:
    """All lines, or of very many an even choice together with the lines that stand out from their surroundings."""
    count = len(X)
    if count <= MOST_LINES:
        return np.arange(count)
    size = np.log(np.sum(np.abs(X) ** 2, axis=1) + np.finfo(float).tiny)
    span = max(3, count // 50)
    mean = np.convolve(np.pad(size, span, mode="edge"), np.ones(2 * span + 1) / (2 * span + 1), "valid")
    even = np.linspace(0, count - 1, MOST_LINES // 2).round().astype(int)
    above = np.argsort(mean - size)[: MOST_LINES // 2]
    return np.unique(np.concatenate([even, above]))


def stable_poles(omega: np.ndarray, X: np.ndarray, weight: np.ndarray) -> np.ndarray:
    """Poles that come back in many orders of a common denominator (least squares complex frequency, Guillaume 1998)."""
    top = int(min(HIGHEST_ORDER, len(omega) // 4))
    orders = [n for n in range(min(LOWEST_ORDER, top), top + 1, ORDER_STEP)]
    if not orders or top < 2:
        return np.zeros(0, complex)
    period = 0.8 * 2 * np.pi / (omega[-1] - omega[0])
    z = np.exp(1j * period * (omega - omega[0]))
    powers = z[:, None] ** np.arange(top + 1)
    weighted = weight[:, None] * powers
    Q, _ = np.linalg.qr(weighted)
    normal = np.zeros((top + 1, top + 1), complex)
    for k in range(X.shape[1]):
        columns = X[:, k, None] * weighted
        columns = columns / (np.linalg.norm(columns[:, 0]) + np.finfo(float).tiny) * np.linalg.norm(X[:, k])
        columns = columns - Q @ (Q.conj().T @ columns)
        normal += columns.conj().T @ columns
    found = []
    for n in orders:
        # The lowest coefficient is 1, so that the roots of noise come out unstable.
        a = np.linalg.lstsq(normal[1 : n + 1, 1 : n + 1], -normal[1 : n + 1, 0], rcond=1e-13)[0]
        roots = np.roots(np.concatenate([[1.0], a])[::-1])
        roots = roots[np.abs(roots) > 0]
        poles = np.log(roots) / period + 1j * omega[0]
        # The logarithm takes angles from -pi to pi; those of the band are 0 to 0.8 * 2 pi.
        poles += 1j * 2 * np.pi / period * (poles.imag < omega[0] - 0.1 * 2 * np.pi / period)
        inside = (poles.real < 0) & (poles.imag > omega[0]) & (poles.imag < omega[-1])
        narrow = -poles.real < 0.25 * np.minimum(poles.imag, omega[-1] - omega[0])
        found.append(poles[inside & narrow])
    return _clusters(found)


def _clusters(found: list[np.ndarray]) -> np.ndarray:
    """The middle of each cloud of poles that holds a share ``STABLE`` of the orders."""
    everything = np.concatenate(found) if found else np.zeros(0, complex)
    middles = []
    taken = np.zeros(len(everything), bool)
    near = _near(everything[:, None], everything[None, :])
    counts = near.sum(axis=1)
    while True:
        free = np.where(taken, 0, (near & ~taken[None, :]).sum(axis=1))
        if not len(free) or free.max() < max(2, STABLE * len(found)):
            break
        best = int(np.argmax(free * (1 + 1e-6 * counts)))
        members = near[best] & ~taken
        cloud = everything[members]
        middles.append(np.median(cloud.real) + 1j * np.median(cloud.imag))
        taken |= members
    return np.array(sorted(middles, key=lambda p: p.imag), complex)


def _near(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    decay = np.maximum(-a.real, -b.real)
    return (np.abs(a.imag - b.imag) < SAME_FREQUENCY * decay) & (np.abs(a.real - b.real) < SAME_DECAY * decay)
