"""The state of a view: a band, an order and the modes picked, with every earlier state to go back to."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np

from modalax.data.frf import FRF
from modalax.data.geometry import Geometry
from modalax.data.measurement import Measurement
from modalax.identify.band import usable_lines
from modalax.identify.chosen import by_frequency, fit_chosen
from modalax.identify.diagram import ESTIMATORS, diagram
from modalax.identify.fit import Fit, summed_up
from modalax.identify.noise import smooth_variance
from modalax.identify.refine import Refined
from modalax.identify.residues import residues
from modalax.identify.select import Selection
from modalax.identify.settle import settle_diagram
from modalax.identify.stabilize import Stability, stabilization
from modalax.identify.tables import PoleTable
from modalax.model.entry import check_measured
from modalax.model.modal import ModalModel
from modalax.show.report.plots import thinned
from modalax.view.quick import Responses, Synthesis

POLES = 80  # poles of the highest order of the first diagram: a person asks for more where they are missing
SAME = 0.5  # distance of two poles, in the larger of their half-bandwidths, up to which they are one mode
ROUNDING = 1e-9  # relative distance from a pole of the diagram below which a pole that was read is that pole
REACH = 0.01  # largest distance from a pick, relative to its frequency, at which an order of the diagram has the mode


class Pick(NamedTuple):
    """A mode picked: its pole [rad/s], the order of the diagram it was taken from (None: refined), and a name."""

    pole: complex
    order: int | None = None
    name: str = ""

    @property
    def frequency_hz(self) -> float:
        """Natural frequency [Hz]."""
        return abs(self.pole) / (2 * np.pi)


@dataclass(frozen=True)
class State:
    """What a step of the user changes: band [Hz], highest order, picks by rising frequency, and their refinement."""

    band: tuple[float, float]
    order: int
    picks: tuple[Pick, ...] = ()
    refined: Refined | None = None

    def picked(self, picks: Sequence[Pick], refined: Refined | None = None) -> "State":
        """The state with other picks, which are not refined unless said so."""
        return replace(self, picks=tuple(sorted(picks, key=lambda p: abs(p.pole))), refined=refined)


@dataclass(frozen=True, eq=False)
class Diagram:
    """The diagram of one band and order: the FRF, the poles, their stability, and what was chosen automatically."""

    frf: FRF
    table: PoleTable
    stability: Stability
    selection: Selection
    turned: bool
    notes: tuple[str, ...]

    @cached_property
    def responses(self) -> Responses:
        """The FRFs, ready for quick fits."""
        return Responses(self.frf)

    @cached_property
    def lines(self) -> np.ndarray:
        """Lines that are drawn: all, or of very many the peaks."""
        return thinned(self.frf)

    @cached_property
    def weighted(self) -> FRF:
        """The FRFs with the variance that weighs them."""
        return smooth_variance(self.frf)

    @property
    def automatic(self) -> tuple[Pick, ...]:
        """The modes that last over the orders, without those that noise makes."""
        found = self.selection
        if not found.poles.size:
            return ()
        try:
            model, _ = settle_diagram(self.weighted, found.poles)
        except ValueError:  # nothing stands out of the noise
            return ()
        poles, orders = np.asarray(found.poles), np.asarray(found.order)
        kept = [int(np.argmin(np.abs(poles - p))) for p in np.asarray(model.poles)]
        return tuple(Pick(complex(poles[k]), int(orders[k])) for k in kept if self.holds(complex(poles[k])))

    def holds(self, pole: complex) -> bool:
        """Whether a pole's frequency lies in the band."""
        return self.frf.ends[0] <= abs(pole) / (2 * np.pi) <= self.frf.ends[1]


class Session:
    """Modes picked from a stabilization diagram, step by step, and every step undone.

    Parameters
    ----------
    measurement
        The FRFs of one run.
    band, order, method
        As for :func:`modalax.identify.fit`; the order is one with room for 80 poles if None.
    geometry
        Positions of the DoFs, where known.
    progress
        Called with a word on each step.

    Raises
    ------
    ValueError
        If the method is unknown or the FRFs cannot be used.
    """

    def __init__(
        self,
        measurement: FRF | Measurement,
        *,
        band: tuple[float, float] | None = None,
        order: int | None = None,
        method: str | None = None,
        geometry: Geometry | None = None,
        progress: Callable[[str], None] | None = None,
    ):
        whole = measurement.frf if isinstance(measurement, Measurement) else measurement
        check_measured(whole)
        self.method = method or ("plscf" if min(whole.shape[1:]) > 1 else "lscf")
        if self.method not in ESTIMATORS:
            raise ValueError(f"method is {method!r}; it must be one of {', '.join(ESTIMATORS)}")
        self.whole, self.geometry = whole, geometry
        self.tell = progress or (lambda text: None)
        frf, self.notes = usable_lines(whole if band is None else whole.band(*band), choose=band is None)
        size = min(whole.shape[1:]) if self.method in ("plscf", "lsce") else 1
        first = max(2, min(POLES // size, frf.shape[0] // 4 - 1)) if order is None else order
        self._diagrams: dict[tuple[float, float, int], Diagram] = {}
        self._fits: dict[tuple[complex, ...], Synthesis] = {}
        self.past: list[State] = []
        self.future: list[State] = []
        self.state = State(frf.ends, first)
        self.state = self.state.picked(self.diagram.automatic)

    @property
    def diagram(self) -> Diagram:
        """The stabilization diagram of the band and order."""
        key = (*self.state.band, self.state.order)
        if key not in self._diagrams:
            self.tell("stabilization diagram")
            self._diagrams[key] = self._diagram()
        return self._diagrams[key]

    def _diagram(self) -> Diagram:
        frf, notes = usable_lines(self.whole.band(*self.state.band), choose=False)
        turned = frf.shape[2] > frf.shape[1] and self.method in ("plscf", "lsce", "fdpi")
        table, selection = diagram(frf.transpose() if turned else frf, self.method, self.state.order)
        return Diagram(frf, table, stabilization(table), selection, turned, (*self.notes, *notes))

    @property
    def poles(self) -> np.ndarray:
        """Poles of the picks [rad/s], by rising frequency."""
        return np.array([p.pole for p in self.state.picks], complex)

    @property
    def synthesis(self) -> Synthesis:
        """Residues at the poles picked, all channels weighing the same."""
        key = (*self.state.band, *self.poles)
        if key not in self._fits:
            if len(self._fits) > 20:
                self._fits.clear()
            self._fits[key] = self.diagram.responses.fit(self.poles)
        return self._fits[key]

    def pole(self, order: int, frequency_hz: float) -> complex:
        """The pole of an order of the diagram nearest to a frequency.

        Raises
        ------
        ValueError
            If the diagram has no such order, or no pole at it.
        """
        table = self.diagram.table
        if order not in table.orders:
            raise ValueError(f"the diagram has no order {order}; it has {table.orders[0]} to {table.orders[-1]}")
        row = table.orders.index(order)
        poles = np.asarray(table.poles)[row][np.asarray(table.valid)[row]]
        poles = poles[(poles.imag > 0) & (poles.real < 0)]
        if not len(poles):
            raise ValueError(f"order {order} has no pole of a stable mode")
        return complex(poles[np.argmin(np.abs(np.abs(poles) / (2 * np.pi) - frequency_hz))])

    def pick(self, order: int, frequency_hz: float) -> None:
        """Pick the pole of an order nearest to a frequency; drop it where it is picked already.

        A pick of the same mode at another order moves: one that is less than half a half-bandwidth away, unless this
        order has that mode as a pole of its own.
        """
        pole, picks = self.pole(order, frequency_hz), list(self.state.picks)
        if pole in [p.pole for p in picks]:
            self._do(self.state.picked([p for p in picks if p.pole != pole]))
            return
        name = ""
        for old in list(picks):
            near = abs(old.pole - pole) < SAME * max(abs(old.pole.real), abs(pole.real))
            if near and self.pole(order, old.frequency_hz) == pole:
                picks.remove(old)
                name = old.name
        self._do(self.state.picked([*picks, Pick(pole, order, name)]))

    def drop(self, number: int) -> None:
        """Drop a pick by its number, from 1."""
        k = self._index(number)
        self._do(self.state.picked([p for j, p in enumerate(self.state.picks) if j != k]))

    def clear(self) -> None:
        """Drop all picks."""
        self._do(self.state.picked(()))

    def choose(self) -> None:
        """Replace the picks by the automatic choice."""
        self._do(self.state.picked(self.diagram.automatic))

    def name(self, number: int, text: str) -> None:
        """Name a pick by its number, from 1."""
        k, picks = self._index(number), list(self.state.picks)
        picks[k] = picks[k]._replace(name=" ".join(text.split())[:60])
        self._do(replace(self.state, picks=tuple(picks)))

    def look(self, band: tuple[float, float] | None = None, order: int | None = None) -> None:
        """Change the band [Hz] or the highest order; picks outside the band are left out, and undo brings them back.

        Raises
        ------
        ValueError
            If the band is empty or has too few lines, or the order is too high for it; nothing is changed then.
        """
        before = self.state
        lower, upper = (float(f) for f in (before.band if band is None else band))
        if not lower < upper:
            raise ValueError(f"the band is {lower:g} to {upper:g} Hz; the second frequency must be the higher one")
        keep = [p for p in before.picks if lower <= p.frequency_hz <= upper]
        refined = before.refined if len(keep) == len(before.picks) and band is None else None
        self.state = replace(before, band=(lower, upper), order=before.order if order is None else order)
        self.state = self.state.picked(keep, refined)
        try:
            _ = self.diagram  # made here, so that a mistake is seen before the step counts
        except ValueError:
            self.state = before
            raise
        self.past.append(before)
        self.future.clear()

    def refine(self) -> None:
        """Refine all picks together by maximum likelihood; no mode is added or dropped.

        Raises
        ------
        ValueError
            If nothing is picked, or no finite modes are found.
        """
        self._require()
        model, refined = fit_chosen(self.diagram.weighted, self.poles, self.tell, True)
        if refined is None or not np.isfinite(np.asarray(model.poles)).all():
            raise ValueError("the refinement found no finite modes; drop those of which the data say nothing")
        # Close modes may have changed places: picks and names go with them, and all stand by rising frequency again.
        picks = [Pick(complex(p), None, old.name) for p, old in zip(model.poles, self.state.picks, strict=True)]
        self._do(self.state.picked(picks, by_frequency(refined)))

    def undo(self) -> None:
        """Go back one step."""
        if self.past:
            self.future.append(self.state)
            self.state = self.past.pop()

    def redo(self) -> None:
        """Repeat the step that was undone last."""
        if self.future:
            self.past.append(self.state)
            self.state = self.future.pop()

    def restore(self, picks: Sequence[Pick]) -> None:
        """Replace the picks by others, for example those of a file; ones outside the band are left out."""
        table = self.diagram.table
        own = np.asarray(table.poles)[np.asarray(table.valid)]

        def snapped(pick: Pick) -> Pick:
            near = complex(own[np.argmin(np.abs(own - pick.pole))])
            return pick._replace(pole=near) if abs(near - pick.pole) < ROUNDING * abs(near) else pick

        self._do(self.state.picked([snapped(p) for p in picks if self.diagram.holds(p.pole)]))

    def model(self) -> ModalModel:
        """The modal model of the picks: as refined, else residues weighted by the noise where it is known.

        Raises
        ------
        ValueError
            If nothing is picked.
        """
        self._require()
        if self.state.refined is not None:
            return self.state.refined.model
        return residues(self.diagram.weighted, self.poles)

    def fit(self) -> Fit:
        """The picks as a :class:`modalax.identify.Fit`, with flags, grades and notes.

        Raises
        ------
        ValueError
            If nothing is picked.
        """
        here, model = self.diagram, self.model()
        self.tell("summing up")
        return summed_up(
            here.frf, here.weighted, model, self.state.refined, here.table, self.selection(), here.turned,
            list(here.notes),
        )  # fmt: skip

    def selection(self) -> Selection:
        """The picks as a selection; the score is the part of the orders, from the first on, that have the mode."""
        table = self.diagram.table
        poles, valid = np.asarray(table.poles), np.asarray(table.valid)
        score, spread = [], []
        for pick in self.state.picks:
            apart = np.where(valid, np.abs(poles - pick.pole), np.inf).min(axis=1) / abs(pick.pole)
            seen = np.flatnonzero(apart < REACH)
            score.append(len(seen) / (len(poles) - seen[0]) if len(seen) else 0.0)
            spread.append(float(np.median(apart[seen])) if len(seen) else float("inf"))
        orders = [table.orders[-1] if p.order is None else p.order for p in self.state.picks]
        return Selection(
            jnp.asarray(self.poles), None, jnp.asarray(score, float), jnp.asarray(spread, float),
            jnp.asarray(orders, int),
        )  # fmt: skip

    def _index(self, number: int) -> int:
        count = len(self.state.picks)
        if not 1 <= number <= count:
            raise ValueError(f"there is no mode {number}; {count} are picked")
        return number - 1

    def _require(self) -> None:
        if not self.state.picks:
            raise ValueError("no mode is picked; click poles in the diagram first")

    def _do(self, state: State) -> None:
        self.past.append(self.state)
        self.future.clear()
        self.state = state
