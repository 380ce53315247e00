r"""The normal matrix of the polynomial estimators from the products of a few columns, for large sets of FRFs.

With the columns :math:`h_o u^k` and the orthogonal projection :math:`P_n` off the numerators
:math:`\mathrm{span}\{u^0 \dots u^n\}`, the normal matrix is

.. math:: M_{jk} = \sum_o \langle P_n h_o u^j,\; h_o u^k\rangle .

On the unit circle multiplication by :math:`u` is unitary. It moves the span by one degree, and of the moved span only
one direction is new and one is gone, :math:`\varphi` and :math:`\psi`, what :math:`u^n` and :math:`u^{-1}` have beyond
:math:`\mathrm{span}\{u^0 \dots u^{n-1}\}`. So the matrix follows from its first row along the diagonals,

.. math:: M_{j+1,k+1} = M_{jk} + \sum_o \bar a_{oj} a_{ok} - \bar b_{oj} b_{ok}, \qquad
          a_{ok} = \langle\varphi, h_o u^k\rangle, \quad b_{ok} = \langle\psi, h_o u^k\rangle ,

and a few products of matrices do for all outputs, where each output would need two of its own. All directions are
orthonormal, so that nothing is lost but what squaring costs: :math:`10^{-8}` of the largest FRF. A matrix of such low
displacement rank is treated by Kailath and Sayed (1995), SIAM Review 37, 297.
"""

from types import ModuleType

from jaxtyping import Complex, Float, Inexact

from modalax._numerics.known import Numbers, cholesky, scan
from modalax._numerics.powers import powers_of
from modalax.identify.zoom import moved_span

RIDGE = 1e-15  # ridge for each row of the normal matrix, relative to its mean diagonal: ten times its rounding errors

SPARE = 0.1  # part of the highest order by which the numerators go beyond it


def with_spare(order: int, lines: int) -> int:
    """Degree of the numerators for a diagram up to ``order``, as far as the number of lines allows.

    Modes outside the band and the map of the band on the circle leave a smooth rest in each FRF, which the numerators
    follow. Those of the highest orders have nothing left for it, and there it goes into the poles (1e-7 of their
    frequencies without noise); of a few more degrees noise takes no notice.
    """
    return max(order, min(order + int(SPARE * order), lines // 2 - 1))


def normal_from_moments(
    xp: ModuleType,
    H: Complex[Numbers, "f row i"],
    weight: Float[Numbers, " f"],
    u: Complex[Numbers, " f"],
    order: int,
    numerator: int,
    real: bool,
) -> tuple[Inexact[Numbers, "m m"], Numbers | float]:
    r"""Normal matrix :math:`\sum_o D_o^H P_n D_o` of some outputs, and the mean diagonal of it with :math:`P_n = I`.

    Parameters are those of :func:`triangular_factor` with one weight a line for all outputs.
    """
    f, _, size = H.shape
    h = (H * weight[:, None, None]).reshape(f, -1)
    Q, phi, psi = moved_span(xp, u, weight, numerator, real)
    span = powers_of(xp, u, order + 1)
    stack = lambda x: xp.concatenate([x.real, x.imag]) if real else x
    given = stack(h)
    left = given - stack(Q) @ (stack(Q).conj().T @ given)
    left = left[:f] + 1j * left[f:] if real else left
    first = xp.swapaxes(left.reshape(H.shape).conj(), 1, 2) @ h.reshape(H.shape)
    first = xp.swapaxes(xp.tensordot(first, span, axes=(0, 0)), 1, 2)  # (i, k, i)
    first = first.real if real else first

    def products(direction: Numbers) -> Numbers:
        """Sum over the outputs of the products of their columns along one direction, ``(k, i, k, i)``."""
        moved = direction.conj()[:, None] * span
        # with real coefficients the product is the real part of that of complex columns
        a = stack(moved.conj() if real else moved).T @ given
        a = xp.swapaxes(a.reshape(order + 1, -1, size), 0, 1).reshape(-1, (order + 1) * size)
        return (a.conj().T @ a).reshape(order + 1, size, order + 1, size)

    def below(row: Numbers, given: tuple[Numbers, Numbers]) -> tuple[Numbers, Numbers]:
        change, start = given
        row = xp.concatenate([start[:, None], (row + change)[:, :-1]], axis=1)
        return row, row

    change = (products(phi) - products(psi))[:-1]
    starts = xp.transpose(first, (1, 2, 0)).conj()[1:]  # the first column, by symmetry
    _, rest = scan(xp, below, first, (change, starts))
    M = xp.concatenate([first[None], rest]).reshape((order + 1) * size, -1)
    return (M + M.conj().T) / 2, xp.sum(h.real**2 + h.imag**2) / size


def factor_of_normal(
    xp: ModuleType, M: Inexact[Numbers, "m m"], energy: Numbers | float, order: int, ridge: Numbers | float
) -> tuple[Inexact[Numbers, "m m"], Numbers | float]:
    """Triangular factor of a normal matrix with a ridge, and what of the ridge was not asked for."""
    m = len(M)
    asked, needed = ridge * (order + 1) * energy, RIDGE * m * energy
    factor = cholesky(xp, M + xp.maximum(asked, needed) * xp.eye(m)).conj().T
    return factor, xp.maximum(needed - asked, 0.0)


def factor_from_moments(
    xp: ModuleType,
    H: Complex[Numbers, "f row i"],
    weight: Float[Numbers, " f"],
    u: Complex[Numbers, " f"],
    order: int,
    numerator: int,
    real: bool,
    ridge: Numbers | float,
) -> tuple[Inexact[Numbers, "m m"], Numbers | float]:
    """Triangular factor of :func:`normal_from_moments`, and the ridge in it that was not asked for."""
    M, energy = normal_from_moments(xp, H, weight, u, order, numerator, real)
    return factor_of_normal(xp, M, energy, order, ridge)
