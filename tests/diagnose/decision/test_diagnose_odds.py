"""What counts against a finding before it is believed: tests looked at, repeats, further causes, rare causes, unknowns.

Each against a closed form that shares no code with it, or against draws.
"""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import scipy.optimize
import scipy.stats

from modalax.data import Measurement
from modalax.diagnose.causes import Cause, Parameter, PatternCause, Place, Scene, catalogue
from modalax.diagnose.causes.local import JointStiffness
from modalax.diagnose.causes.signals import HumLines
from modalax.diagnose.decision.beliefs import beliefs
from modalax.diagnose.decision.detection import detect
from modalax.diagnose.decision.omnibus import Omnibus
from modalax.diagnose.decision.posterior import evidence, posterior, promise
from modalax.diagnose.fitting.hypothesis import Hypothesis
from modalax.diagnose.screening.screen import Trial
from modalax.diagnose.screening.sensitivities import Residual
from modalax.diagnose.setup.noise import noise_of, scatter_freedom

QUIET = Omnibus(1.0, 0.0, "", (0.0, 0.0))
HERE = Place(("1",), (0, -1, 0))
OF_SCORES, ALARM = 0.55, 0.01  # share of the alarms that scores may make, and their chance where nothing is wrong
FURTHER = 5.0  # nats that each cause after the first costs


def found(directions, z, trials=None, nuisance=None):
    """The detection where the largest of the scores along ``directions`` is ``z``."""
    size = np.shape(directions)[1]
    G = np.zeros((0, size)) if nuisance is None else nuisance
    side = Residual(np.zeros((1, 1, size)), G[:, None, None], np.linalg.inv(np.eye(len(G)) + G @ G.T))
    t = Trial(JointStiffness(), HERE, z**2, z, np.ones(1), direction=directions, trials=trials or len(directions))
    return detect([t], {False: side}, QUIET)


def family(z, count):
    """Chance that the largest of ``count`` independent standard normal scores is beyond ``z`` in size."""
    return 1 - (1 - 2 * scipy.stats.norm.sf(z)) ** count


class TestLookElsewhere:
    """A score counts against all that were looked at."""

    @pytest.mark.parametrize("count", [1, 7, 200])
    def test_independent_tests_count_each(self, count):
        seen = found(np.eye(200)[:count], 3.5)
        assert seen.p_values["scores"] == pytest.approx(family(3.5, count), rel=1e-9)
        assert family(seen.threshold, count) == pytest.approx(ALARM * OF_SCORES, rel=1e-9)

    def test_the_same_test_many_times_counts_once(self):
        same = np.tile(np.eye(20)[:1], (50, 1))
        assert found(same, 3.5).p_values["scores"] == pytest.approx(family(3.5, 1), rel=1e-9)

    def test_what_the_modes_can_follow_does_not_count_as_different(self):
        """Directions that differ only along what is fitted anyway are one test."""
        rng = np.random.default_rng(0)
        shared, free = np.eye(40)[0], np.eye(40)[1:3]
        mixed = shared + rng.normal(size=(30, 2)) @ free
        D = mixed / np.linalg.norm(mixed, axis=1, keepdims=True)
        loose, held = (found(D, 3.5, nuisance=scale * free).p_values["scores"] for scale in (1e-6, 1e6))
        assert held == pytest.approx(family(3.5, 1), rel=1e-3) and loose > 2 * held

    def test_places_looked_at_but_not_kept_count_as_the_root_of_their_number(self):
        assert found(np.eye(200)[:4], 3.5, trials=36).p_values["scores"] == pytest.approx(family(3.5, 12), rel=1e-9)

    def test_alarms_are_as_rare_as_promised_where_tests_are_alike(self):
        """Scores of 60 places along a chain, each like its neighbours, 4000 draws of noise."""
        rng = np.random.default_rng(1)
        apart = np.abs(np.arange(60)[:, None] - np.arange(60)[None])
        values, vectors = np.linalg.eigh(np.exp(-apart / 4.0))
        D = vectors * np.sqrt(np.maximum(values, 0.0))
        largest = np.abs(D @ rng.normal(size=(60, 4000))).max(axis=0)
        one_in_ten = scipy.optimize.brentq(lambda z: found(D, z).p_values["scores"] - 0.1, 0.5, 6.0)
        assert 0.04 < np.mean(largest > one_in_ten) < 0.13  # one test would have 0.92, 60 of them 0.05


class TestRepeats:
    """Variances from few repeats are known to few degrees of freedom."""

    def measurement(self, like, **more):
        H = np.ones(like.shape, complex)
        names = [f"{k}" for k in range(like.shape[2])]
        return Measurement(np.arange(1.0, 1 + like.shape[1]), H, outputs=names, inputs=["1"], **more)

    @pytest.mark.parametrize("repeats", [2, 6, 40])
    def test_degrees_of_freedom_are_those_of_the_variance_of_complex_repeats(self, repeats):
        """By the scatter of drawn variances: a chi-square over its n degrees has the relative variance 2/n."""
        rng = np.random.default_rng(repeats)
        e = rng.normal(size=(repeats, 40_000, 2))
        drawn = e.var(axis=0, ddof=1).mean(axis=-1)
        expected = 2 * drawn.mean() ** 2 / drawn.var()
        variance = drawn[:100].reshape(1, 100, 1, 1)
        given = self.measurement(variance, variance=variance, averages=repeats)
        assert noise_of(given, np.ones((100, 1, 1))).freedom == pytest.approx(expected, rel=0.06)
        runs = np.ones((repeats, 1, 1, 1)) * variance
        repeated = self.measurement(runs, level=np.ones(repeats))
        assert noise_of(repeated, np.ones((100, 1, 1))).freedom == pytest.approx(expected, rel=0.06)
        # where the number of repeats is not told, it is read off the scatter between lines
        assert scatter_freedom(drawn.reshape(1, 400, 100, 1)) == pytest.approx(expected, rel=0.25)

    def test_coherence_of_several_averages(self):
        variance = np.ones((1, 50, 1, 1))
        data = self.measurement(variance, coherence=0.9 * variance, averages=9)
        assert noise_of(data, np.ones((50, 1, 1))).freedom == 16

    def test_few_repeats_widen_the_scores_and_many_do_not(self):
        variance = np.ones((1, 50, 1, 1))
        spread = [
            noise_of(self.measurement(variance, variance=variance, averages=n), np.ones((50, 1, 1))).spread
            for n in (3, 10, 1000)
        ]
        assert spread[0] > spread[1] > spread[2] == 1.0


class Shift(Cause):
    """A made cause with one parameter, at any of four places."""

    slug = "shift"
    parameters = (Parameter("size", "-"),)

    def places(self, scene):
        return [Place((str(k),), (k, -1, 0)) for k in range(4)]


class Rare(Shift):
    slug = "rare"
    prior = 0.02


class Bounded(Shift):
    slug = "bounded"

    def likely(self, p, scene):
        return 0.3


class Shaped(PatternCause):
    """Sizes free in every channel."""

    slug = "shaped"
    several = True
    parameters = (Parameter("size", "-"),)


SCENE = Scene(np.ones(3), (), (), (), np.ones(1), np.ones(1), np.ones(1), SimpleNamespace())


def hypothesis(*causes, chi2=0.0, freedom=0.0, extra=None):
    places = tuple(Place((str(k),), (k, -1, 0)) for k in range(len(causes)))
    return Hypothesis(
        causes, places, (extra,) * len(causes), tuple(np.ones(1) for _ in causes), chi2=chi2, freedom=freedom
    )


class TestEvidence:
    """Of a linear model the evidence has a closed form."""

    @pytest.mark.parametrize("samples", [400, 20_000])
    def test_it_is_the_exact_one_of_a_straight_line_with_the_prior_of_one_sample(self, samples):
        """y = a x + noise, a drawn with the spread that one sample alone would leave: Kass and Wasserman (1995)."""
        rng = np.random.default_rng(samples)
        x = rng.normal(size=samples)
        y = 6.0 / np.sqrt(samples) * x + rng.normal(size=samples)
        a = (x @ y) / (x @ x)
        chi2, null = float(np.sum((y - a * x) ** 2)), float(y @ y)
        precision = x @ x / samples
        exact = 0.5 * (x @ y) ** 2 / (x @ x + precision) - 0.5 * np.log1p(samples)
        got = evidence(hypothesis(Shift(), chi2=chi2, freedom=1.0), SCENE, samples, null)
        got -= evidence(hypothesis(chi2=null), SCENE, samples, null)
        place = np.log(1 / 4)
        assert got - place == pytest.approx(exact, abs=60 / samples)  # the prior pulls as one sample

    @pytest.mark.parametrize("gain", [30.0, 400.0])
    def test_free_sizes_are_weighed_with_the_prior_that_fits_them_best(self, gain):
        """Twelve sizes drawn with one spread; its likeliest value found numerically."""
        extra, samples, null = np.ones((1, 3, 4)), 5000, 9000.0
        h = hypothesis(Shaped(), chi2=null - gain, freedom=12.0, extra=extra)
        got = evidence(h, SCENE, samples, null) - evidence(hypothesis(chi2=null), SCENE, samples, null)

        def less(log_wider):  # minus the log evidence of sizes with the prior variance exp(log_wider) - 1
            return -0.5 * gain * (1 - np.exp(-log_wider)) + 6 * log_wider

        best = scipy.optimize.minimize_scalar(less, bounds=(0, 20), method="bounded", options={"xatol": 1e-10})
        assert got == pytest.approx(-best.fun, rel=1e-8)

    def test_a_users_belief_multiplies_the_odds(self):
        h = hypothesis(Shift(), chi2=90.0, freedom=1.0)
        plain = evidence(h, SCENE, 100, 200.0)
        with beliefs({"shift": 5.0}, {"shift"}):
            assert evidence(h, SCENE, 100, 200.0) - plain == pytest.approx(np.log(5))

    def test_each_cause_after_the_first_costs_its_price(self):
        one, two, three = (
            evidence(hypothesis(*[Shift()] * n, chi2=90.0, freedom=1.0), SCENE, 100, 200.0) for n in (1, 2, 3)
        )
        assert one - two == pytest.approx(FURTHER + np.log(4))  # its place is one of four
        assert two - three == pytest.approx(FURTHER + np.log(4))

    def test_a_further_cause_is_believed_once_it_pays_for_itself(self):
        """A second cause that costs no unknown: its gain must outweigh its price and its place."""
        pays = 2 * (FURTHER + np.log(4))
        for more, first in ((0.9, 1), (1.1, 2)):
            each = [hypothesis(*[Shift()] * n, chi2=90.0 - (n - 1) * more * pays, freedom=1.0) for n in (1, 2)]
            ranked = posterior([(h, evidence(h, SCENE, 100, 200.0)) for h in each])
            assert len(ranked[0].best.causes) == first

    @pytest.mark.parametrize(("cause", "weight"), [(Rare(), 0.02), (Bounded(), 0.3)])
    def test_rare_causes_and_unlikely_sizes_weigh_less(self, cause, weight):
        plain, other = (evidence(hypothesis(c, chi2=90.0, freedom=1.0), SCENE, 100, 200.0) for c in (Shift(), cause))
        assert plain - other == pytest.approx(-np.log(weight))
        ranked = posterior([(hypothesis(Shift()), plain), (hypothesis(cause), other)])
        assert [r.probability for r in ranked] == pytest.approx([1 / (1 + weight), weight / (1 + weight)])

    def test_screening_ranks_by_what_the_evidence_will_be(self):
        """Twice the nats of the evidence, for causes of unlike priors and gains."""
        for cause, gain in ((Shift(), 40.0), (Rare(), 40.0), (Shift(), 10.0)):
            h = hypothesis(cause, chi2=200.0 - gain, freedom=1.0)
            nats = evidence(h, SCENE, 100, 200.0) - evidence(hypothesis(chi2=200.0), SCENE, 100, 200.0)
            t = Trial(cause, h.places[0], gain, np.sqrt(gain), np.ones(1))
            assert promise(t, SCENE, 100) == pytest.approx(2 * nats)

    def test_forms_of_one_cause_at_one_place_add_up(self):
        forms = [hypothesis(Shift()), hypothesis(Shift()), hypothesis(Rare())]
        ranked = posterior(list(zip(forms, np.log([1.0, 2.0, 5.0]), strict=True)))
        assert [r.probability for r in ranked] == pytest.approx([5 / 8, 3 / 8])
        assert ranked[1].best is forms[1] and ranked[1].log_evidence == pytest.approx(np.log(2))

    def test_every_prior_of_the_catalogue_is_a_weight(self):
        assert all(0 < c.prior <= 1 for c in catalogue()) and max(c.prior for c in catalogue()) == 1

    def test_hum_counts_as_a_cause(self):
        one = hypothesis(Shift(), chi2=90.0, freedom=1.0)
        both = replace(one, hum=HumLines(np.zeros(3, bool), 0.0, 0.0, 0.0, 50.0, 1.0))
        assert evidence(one, SCENE, 100, 200.0) - evidence(both, SCENE, 100, 200.0) == pytest.approx(FURTHER)
