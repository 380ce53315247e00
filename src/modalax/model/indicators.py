r"""Numbers that compare mode shapes and FRFs, and curves that show where modes are.

Shapes are arrays ``(n, o)``, mode by row, real or complex; FRFs are :class:`modalax.data.frf.FRF`. A shape, DoF or
line that is zero agrees with nothing: its indicator is 0 (unless said otherwise), never NaN, and so is its gradient.
"""

from types import ModuleType
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Complex, Float

from modalax._numerics.checks import as_double
from modalax._numerics.known import Numbers, by_numpy, constant, module_of
from modalax.data.frf import DERIVATIVES, FRF
from modalax.model.entry import check_frf

# Size, relative to the FRF of the line, below which an excitation pattern counts as giving no response.
NO_RESPONSE = 1e-12


def mac(a: Any, b: Any) -> Float[Array, "n m"]:
    r"""Modal assurance criterion between every two shapes, :math:`|a_r^H b_s|^2 / (a_r^H a_r \; b_s^H b_s)`.

    1 for shapes that differ by a complex factor only, 0 for orthogonal ones and where a shape is zero.

    Parameters
    ----------
    a, b
        Shapes, shapes ``(n, o)`` and ``(m, o)`` [-].

    Raises
    ------
    ValueError
        If the two hold different numbers of DoFs.

    References
    ----------
    R. J. Allemang, D. L. Brown, A correlation coefficient for modal vector analysis, IMAC 1, 1982, 110-116.
    """
    a, b = _shapes(a, "a"), _shapes(b, "b")
    _same("DoFs", a.shape[1], b.shape[1])
    return _mac(a, b)


@by_numpy
def _mac(xp: ModuleType, a: Numbers, b: Numbers) -> Float[Numbers, "n m"]:
    # Unit vectors first: squares of very small or large shapes would leave the range of numbers.
    return _square(_unit(a).conj() @ _unit(b).T)


def auto_mac(shapes: Any) -> Float[Array, "n n"]:
    """MAC of a set of shapes with itself: large values off the diagonal mean that the DoFs cannot tell modes apart."""
    return mac(shapes, shapes)


def comac(a: Any, b: Any) -> Float[Array, " o"]:
    r"""Coordinate MAC of paired shapes, DoF by DoF.

    .. math:: \mathrm{CoMAC}_o = \frac{\left(\sum_r |a_{ro} b_{ro}^*|\right)^2}{\sum_r |a_{ro}|^2 \sum_r |b_{ro}|^2}

    Every shape counts alike: each is scaled to unit 2-norm first, so that the scaling given does not matter.
    1 where both sets agree in magnitude; phases are not compared, see :func:`ecomac`. 0 where a DoF never moves.

    Parameters
    ----------
    a, b
        Shapes, row ``r`` of one paired with row ``r`` of the other, shape ``(n, o)`` [-].

    References
    ----------
    N. A. J. Lieven, D. J. Ewins, Spatial correlation of mode shapes, the coordinate modal assurance criterion
    (COMAC), IMAC 6, 1988.
    """
    return _comac(*_pairs(a, b))


@by_numpy
def _comac(xp: ModuleType, a: Numbers, b: Numbers) -> Float[Numbers, " o"]:
    a, b = _unit(a), _unit(b)
    product = _abs(a * b.conj()).sum(axis=0)
    return _ratio(product**2, _square(a).sum(axis=0) * _square(b).sum(axis=0))


def ecomac(a: Any, b: Any) -> Float[Array, " o"]:
    r"""Enhanced CoMAC, the mean distance of paired shapes at each DoF, :math:`\frac1{2n}\sum_r |a_{ro} - b_{ro}|`.

    Each shape is scaled to root mean square 1 and each ``b`` turned into phase with its ``a`` first. 0 where both
    sets agree; a DoF wired with the wrong sign gives its mean magnitude, which CoMAC cannot see.

    Parameters
    ----------
    a, b
        Shapes, row ``r`` of one paired with row ``r`` of the other, shape ``(n, o)`` [-].

    References
    ----------
    D. L. Hunt, Application of an enhanced coordinate modal assurance criterion, IMAC 10, 1992.
    """
    return _ecomac(*_pairs(a, b))


@by_numpy
def _ecomac(xp: ModuleType, a: Numbers, b: Numbers) -> Float[Numbers, " o"]:
    a, b = (_unit(s) * np.sqrt(1.0 * s.shape[1]) for s in (a, b))
    turn = _direction((a * b.conj()).sum(axis=1, keepdims=True))
    return _abs(a - turn * b).mean(axis=0) / 2


def msf(a: Any, b: Any) -> Complex[Array, " n"]:
    r"""Modal scale factor of paired shapes, :math:`(b_r^H a_r)/(b_r^H b_r)`: times ``b`` it is closest to ``a``.

    Parameters
    ----------
    a, b
        Shapes, row ``r`` of one paired with row ``r`` of the other, shape ``(n, o)`` [-].

    References
    ----------
    R. J. Allemang, D. L. Brown, A correlation coefficient for modal vector analysis, IMAC 1, 1982, 110-116.
    """
    return _msf(*_pairs(a, b))


@by_numpy
def _msf(xp: ModuleType, a: Numbers, b: Numbers) -> Complex[Numbers, " n"]:
    return _ratio((_unit(b).conj() * a).sum(axis=1), _size(b)[:, 0])


def mpc(shapes: Any) -> Float[Array, " n"]:
    r"""Modal phase collinearity, :math:`|\psi^T\psi|^2 / (\psi^H\psi)^2`.

    With :math:`S_{xx}, S_{yy}, S_{xy}` the sums of squares and products of real and imaginary parts this is the
    usual :math:`((S_{xx}-S_{yy})^2 + 4S_{xy}^2)/(S_{xx}+S_{yy})^2`. 1 for a real shape times any complex factor,
    0 for one with no main phase, such as a rotating wave.

    Parameters
    ----------
    shapes
        Shape ``(n, o)`` [-].

    References
    ----------
    R. S. Pappa, K. B. Elliott, A. Schenk, Consistent-mode indicator for the eigensystem realization algorithm,
    Journal of Guidance, Control, and Dynamics 16 (1993) 852-858.
    """
    return _mpc(_shapes(shapes, "shapes"))


_mpc = by_numpy(lambda xp, shapes: _square((_unit(shapes) ** 2).sum(axis=1)))


def mean_phase(shapes: Any) -> Float[Array, " n"]:
    r"""Phase :math:`\theta = \frac12\mathrm{arg}(\psi^T\psi)` [rad] of the line through 0 nearest to the components.

    :math:`\psi e^{-j\theta}` has the largest real part that a turn can give. It is known up to half a turn and lies
    within :math:`\pm\pi/2`; 0 for a shape with no main phase.

    Parameters
    ----------
    shapes
        Shape ``(n, o)`` [-].
    """
    return _mean_phase(_shapes(shapes, "shapes"))


def phase_of(xp: ModuleType, shapes: Numbers) -> Float[Numbers, " n"]:
    """:func:`mean_phase` by JAX or NumPy."""
    return xp.angle(_direction((_unit(shapes) ** 2).sum(axis=1))) / 2


_mean_phase = by_numpy(phase_of)


def mpd(shapes: Any) -> Float[Array, " n"]:
    r"""Mean phase deviation [rad]: how far the components lie from the line of :func:`mean_phase`.

    .. math:: \mathrm{MPD} = \frac{\sum_o |\psi_o|\,\arctan|\mathrm{Im}\,\psi_o e^{-j\theta} /
              \mathrm{Re}\,\psi_o e^{-j\theta}|}{\sum_o |\psi_o|}

    0 for a real shape times any complex factor; :math:`\pi/4` for phases spread evenly, and for a zero shape.

    Parameters
    ----------
    shapes
        Shape ``(n, o)`` [-].

    References
    ----------
    E. Reynders, J. Houbrechts, G. De Roeck, Fully automated (operational) modal analysis, Mechanical Systems and
    Signal Processing 29 (2012) 228-250.
    """
    return _mpd(_shapes(shapes, "shapes"))


@by_numpy
def _mpd(xp: ModuleType, shapes: Numbers) -> Float[Numbers, " n"]:
    unit = _unit(shapes)
    turned = unit * xp.exp(-1j * phase_of(xp, unit))[:, None]
    still = turned == 0
    turned = xp.where(still, 1.0, turned)
    angle = xp.arctan2(xp.abs(turned.imag), xp.abs(turned.real))
    weight = _abs(unit)
    total = weight.sum(axis=1)
    return xp.where(total > 0, _ratio((weight * angle).sum(axis=1), total), np.pi / 4)


def frac(a: FRF, b: FRF) -> Float[Array, "o i"]:
    r"""Frequency response assurance criterion of each channel.

    .. math:: \mathrm{FRAC}_{oi} = \frac{|\sum_f a_{foi}^* b_{foi}|^2}{\sum_f |a_{foi}|^2 \sum_f |b_{foi}|^2}

    1 where the two differ by a complex factor only.

    Raises
    ------
    ValueError
        If the two differ in lines, channels or form.

    References
    ----------
    W. Heylen, S. Lammens, FRAC: a consistent way of comparing frequency response functions, Identification in
    Engineering Systems, Swansea, 1996.
    """
    _comparable(a, b)
    if a.shape[0] != b.shape[0]:
        raise ValueError(f"the FRFs have {a.shape[0]} and {b.shape[0]} lines; FRAC needs the same lines")
    return _frac(a.H, b.H)


@by_numpy
def _frac(xp: ModuleType, a: Numbers, b: Numbers) -> Float[Numbers, "o i"]:
    a, b = (_unit(xp.moveaxis(H, 0, -1)) for H in (a, b))
    return _square((a.conj() * b).sum(axis=-1))


def fdac(a: FRF, b: FRF) -> Float[Array, "f g i"]:
    r"""Frequency domain assurance criterion: MAC of the deflection of ``a`` at line f and of ``b`` at line g.

    .. math:: \mathrm{FDAC}_{fgi} = \frac{|\sum_o a_{foi}^* b_{goi}|^2}{\sum_o |a_{foi}|^2 \sum_o |b_{goi}|^2}

    A ridge beside the diagonal means that the same shapes come at other frequencies.

    Raises
    ------
    ValueError
        If the two differ in channels or form; their lines may differ.

    References
    ----------
    R. Pascual, J.-C. Golinval, M. Razeto, A frequency domain correlation technique for model correlation and
    updating, IMAC 15, 1997.
    """
    _comparable(a, b)
    return _fdac(a.H, b.H)


@by_numpy
def _fdac(xp: ModuleType, a: Numbers, b: Numbers) -> Float[Numbers, "f g i"]:
    left, right = (_unit(xp.transpose(H, (2, 0, 1))) for H in (a, b))
    return _square(xp.moveaxis(left.conj() @ xp.swapaxes(right, 1, 2), 0, -1))


def sum_frf(frf: FRF) -> Float[Array, " f"]:
    r"""Sum of the magnitudes of all FRFs, :math:`\sum_{oi} |H_{oi}(\omega_f)|` [unit of the FRF]."""
    return _sum(frf.H)


_sum = by_numpy(lambda xp, H: _abs(H).sum(axis=(1, 2)))


@jax.jit
def cmif(frf: FRF) -> Float[Array, "f k"]:
    r"""Complex mode indicator function: squared singular values :math:`\sigma_k^2` of the FRF matrix at each line.

    Largest first, ``k`` as many as the smaller of outputs and inputs [square of the FRF's unit]. A peak of the first
    is a mode; a peak of the second at the same line is another one close to it.

    References
    ----------
    C. Y. Shih, Y. G. Tsuei, R. J. Allemang, D. L. Brown, Complex mode indication function and its applications to
    spatial domain parameter estimation, Mechanical Systems and Signal Processing 2 (1988) 367-377.
    """
    check_frf(frf, "CMIF")
    return jnp.linalg.svd(frf.H, compute_uv=False) ** 2


@jax.jit
def mvmif(frf: FRF) -> Float[Array, "f i"]:
    r"""Multivariate mode indicator function, smallest first.

    Over real force patterns p it holds the stationary values, between 0 and 1, of the share of the response that is
    in phase with the force,

    .. math:: \frac{p^T A p}{p^T (A + B) p}, \quad A = \mathrm{Re}H^T\mathrm{Re}H, \; B = \mathrm{Im}H^T\mathrm{Im}H.

    A minimum of the first near 0 is an undamped natural frequency, at which one pattern of forces makes the
    structure vibrate in quadrature; a minimum of the second at the same line is a repeated one. For mobility real and
    imaginary parts change places. With one input it is the ordinary mode indicator function. 1 for a pattern without
    any response.

    Raises
    ------
    ValueError
        If there are fewer outputs than inputs: some pattern of forces then always seems to excite nothing.

    References
    ----------
    R. Williams, J. Crowley, H. Vold, The multivariate mode indicator function in modal analysis, IMAC 3, 1985.
    """
    _, outputs, inputs = frf.shape
    if outputs < inputs:
        raise ValueError(
            f"MvMIF of {outputs} outputs and {inputs} inputs; it needs at least as many outputs as inputs "
            "(with reciprocity, .transpose() exchanges them)"
        )
    H = frf.H * 1j ** -DERIVATIVES[frf.form]
    scale = jnp.max(jnp.abs(H), axis=(1, 2), keepdims=True)
    H = H / jnp.where(scale > 0, scale, 1.0)
    # The cosines of the QR factor's upper block solve the eigenproblem without forming A and B, which would square
    # the condition. The rows of NO_RESPONSE make a pattern that excites nothing count as fully in phase.
    nothing = jnp.broadcast_to(NO_RESPONSE * jnp.eye(inputs), (len(H), inputs, inputs))
    q = jnp.linalg.qr(jnp.concatenate([H.real, nothing, H.imag], axis=1))[0]
    return jnp.linalg.svd(q[:, : outputs + inputs], compute_uv=False)[:, ::-1] ** 2


def _shapes(value: Any, what: str) -> Complex[Array, "n o"]:
    if isinstance(value, eqx.Module):
        raise ValueError(f"{what} is a {type(value).__name__}; give its shapes: model.shapes, or fit.model.shapes")
    shapes = as_double(value, what, complex_=True)
    if shapes.ndim != 2:
        raise ValueError(
            f"{what} has shape {shapes.shape}; shapes need (n, o), a row for each mode: write shape[None] for one"
        )
    return shapes


def _pairs(a: Any, b: Any) -> tuple[Complex[Array, "n o"], Complex[Array, "n o"]]:
    a, b = _shapes(a, "a"), _shapes(b, "b")
    _same("modes", a.shape[0], b.shape[0])
    _same("DoFs", a.shape[1], b.shape[1])
    return a, b


def _same(what: str, a: int, b: int) -> None:
    if a != b:
        raise ValueError(f"a has {a} {what} and b has {b}; they need the same")


def _comparable(a: FRF, b: FRF) -> None:
    check_frf(a, "a comparison")
    check_frf(b, "a comparison")
    for what in ("form", "outputs", "inputs"):
        if getattr(a, what) != getattr(b, what):
            raise ValueError(f"the FRFs have {what} {getattr(a, what)} and {getattr(b, what)}; they must be the same")


def _square(x: Complex[Numbers, "..."]) -> Float[Numbers, "..."]:
    """|x|^2, with a gradient at 0 too."""
    return x.real**2 + x.imag**2


def _abs(x: Complex[Numbers, "..."]) -> Float[Numbers, "..."]:
    """|x|, with gradient 0 at 0."""
    zero = x == 0
    xp = module_of(x)
    return xp.where(zero, 0.0, xp.abs(xp.where(zero, 1.0, x)))


def _direction(x: Complex[Numbers, "..."]) -> Complex[Numbers, "..."]:
    """x/|x|, and 1 at 0."""
    xp = module_of(x)
    x = xp.where(x == 0, 1.0, x)
    return x / xp.abs(x)


def _ratio(numerator: Numbers, denominator: Float[Numbers, "..."]) -> Numbers:
    """Quotient, and 0 where the denominator is 0."""
    xp, zero = module_of(numerator, denominator), denominator == 0
    return xp.where(zero, 0.0, numerator / xp.where(zero, 1.0, denominator))


def _size(x: Complex[Numbers, "..."]) -> Float[Numbers, "..."]:
    """2-norm over the last axis, kept as an axis of length 1; gradient 0 for a zero vector."""
    # The scale guards squares against overflow; the norm does not depend on it, nor does its gradient.
    xp = module_of(x)
    top = constant(xp, xp.max(_abs(x), axis=-1, keepdims=True))
    scale = xp.where(top > 0, top, 1.0)
    total = _square(x / scale).sum(axis=-1, keepdims=True)
    return xp.where(top > 0, scale * xp.sqrt(xp.where(top > 0, total, 1.0)), 0.0)


def _unit(x: Complex[Numbers, "..."]) -> Complex[Numbers, "..."]:
    """Vectors of the last axis over their 2-norm; a zero vector stays zero."""
    return _ratio(x, _size(x))
