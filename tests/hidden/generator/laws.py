"""Force laws of joints, each with its exact implicit step.

A step knows what the relative motion would be with no force at its end: ``q_free``, ``v_free``. The force moves it
by the (negative) compliances ``g = dq/df`` and ``h = dv/df``. ``solve`` returns the force that meets the law at the
end of the step exactly. The force runs straight from step to step, or where ``held`` it is constant over a step: a
rigid slider's force jumps, and a held force is its exact mean impulse both in a reversal and at rest.
"""

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Law:
    slug: str
    held = False

    def start(self, q, v):
        return np.zeros_like(q)

    def solve(self, q_free, v_free, g, h, q_old, v_old, f_old):
        raise NotImplementedError


@dataclass(frozen=True)
class Cubic(Law):
    k3: float

    def start(self, q, v):
        return self.k3 * q**3

    def solve(self, q_free, v_free, g, h, q_old, v_old, f_old):
        # q - g k3 q^3 = q_free has one real root for g k3 <= 0: Cardano by hyperbolic sine
        root = np.sqrt(np.maximum(-g * self.k3, 1e-200) / 3)
        q = 2 / (3 * root) * np.sinh(np.arcsinh(4.5 * root * q_free) / 3)
        return self.k3 * q**3


@dataclass(frozen=True)
class QuadraticDamper(Law):
    c: float

    def start(self, q, v):
        return self.c * v * np.abs(v)

    def solve(self, q_free, v_free, g, h, q_old, v_old, f_old):
        speed = np.abs(v_free)
        v = 2 * speed / (1 + np.sqrt(1 - 4 * h * self.c * speed))
        return np.sign(v_free) * self.c * v**2


@dataclass(frozen=True)
class Gap(Law):
    k: float
    clearance: float

    def start(self, q, v):
        return self.k * np.sign(q) * np.maximum(np.abs(q) - self.clearance, 0)

    def solve(self, q_free, v_free, g, h, q_old, v_old, f_old):
        return self.k * np.sign(q_free) * np.maximum(np.abs(q_free) - self.clearance, 0) / (1 - g * self.k)


@dataclass(frozen=True)
class Bilinear(Law):
    tension: float
    pressure: float

    def start(self, q, v):
        return np.where(q > 0, self.tension, self.pressure) * q

    def solve(self, q_free, v_free, g, h, q_old, v_old, f_old):
        k = np.where(q_free > 0, self.tension, self.pressure)
        return k * q_free / (1 - g * k)


@dataclass(frozen=True)
class Jenkins(Law):
    """Spring ``k`` in series with a slider that gives way at ``limit``.

    Where it stands in for a spring ``given`` = k that the structure has, that spring's force is taken off.
    """

    k: float
    limit: float
    given: float = 0.0

    def start(self, q, v):
        return np.clip(self.k * q, -self.limit, self.limit) - self.given * q

    def solve(self, q_free, v_free, g, h, q_old, v_old, f_old):
        held = f_old + self.given * q_old  # the slider's force at the start of the step
        soft = self.k - self.given
        stuck = (held + self.k * (q_free - q_old) - self.given * q_free) / (1 - g * soft)
        force = held + self.k * (q_free + g * stuck - q_old)
        limited = np.sign(force) * self.limit
        slid = (limited - self.given * q_free) / (1 + g * self.given)
        return np.where(np.abs(force) > self.limit, slid, stuck)


@dataclass(frozen=True)
class Coulomb(Law):
    """Rigid slider: |f| <= limit at rest, limit against the motion otherwise."""

    limit: float
    held = True

    def start(self, q, v):
        return self.limit * np.sign(v)

    def solve(self, q_free, v_free, g, h, q_old, v_old, f_old):
        # stops at the fraction theta of the step, then slides back: the mean of both forces, by the time of each;
        # or rests: the force that leaves no motion at the end
        rest = np.clip(-v_free / h, -self.limit, self.limit)
        sign, brake = np.sign(v_old), h * self.limit
        ahead, back = v_free + sign * brake, v_free - sign * brake
        turned = (sign * ahead < 0) & (sign * (back - v_old) < 0)
        theta = v_old / np.where(turned, v_old - ahead, 1.0)
        return np.where(turned, sign * self.limit * (2 * theta - 1), rest)


@dataclass(frozen=True)
class CubicDamper(Law):
    c: float

    def start(self, q, v):
        return self.c * v**3

    def solve(self, q_free, v_free, g, h, q_old, v_old, f_old):
        root = np.sqrt(np.maximum(-h * self.c, 1e-200) / 3)
        return self.c * (2 / (3 * root) * np.sinh(np.arcsinh(4.5 * root * v_free) / 3)) ** 3
