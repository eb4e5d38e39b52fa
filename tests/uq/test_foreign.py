"""Laws of SciPy and chaospy: as families of our own or of SciPy's, with their tails held to
account.
"""

from __future__ import annotations

import pickle
import warnings
from typing import Any

import numpy as np
import pytest
from scipy import stats

from uqsphere.uq.foreign import as_law, law_table
from uqsphere.uq.forms import LawError, form_of

with warnings.catch_warnings():
    warnings.simplefilter("ignore")
    from uqsphere.uq.interop import load_chaospy

    chaospy = load_chaospy()

P = np.array([1e-12, 1e-3, 0.3, 0.9])
SCIPY = {
    "normal": stats.norm(1, 2),
    "lognormal": stats.lognorm(0.3, scale=2),
    "uniform": stats.uniform(2, 3),
    "loguniform": stats.loguniform(1, 4),
    "triangular": stats.triang(0.3, 1, 2),
    "beta": stats.beta(2, 3, 1, 2),
    "gamma": stats.gamma(2, 0, 3),
    "weibull": stats.weibull_min(3, 1, 2),
    "gumbel": stats.gumbel_r(1, 2),
    "frechet": stats.invweibull(3, 1, 2),
    "exponential": stats.expon(0, 2),
    "rayleigh": stats.rayleigh(0, 2),
    "student_t": stats.t(5, 1, 2),
    "scipy.lognorm": stats.lognorm(0.3, 1, 2),
    "scipy.johnsonsu": stats.johnsonsu(1, 2, 3, 4),
    "scipy.gumbel_l": stats.gumbel_l(1, 2),
    "scipy.genpareto": stats.genpareto(-0.2, 1, 2),
}


@pytest.mark.parametrize("family", SCIPY)
def test_a_law_of_scipy_is_the_same_law(family: str) -> None:
    given = SCIPY[family]
    law = as_law(given)
    assert law.family.name == family
    for ours, theirs in ((law.ppf, given.ppf), (law.isf, given.isf)):
        np.testing.assert_allclose(ours(P), theirs(P), rtol=1e-9, atol=1e-9)
    x = law.ppf(P)
    np.testing.assert_allclose(law.pdf(x), given.pdf(x), rtol=1e-6)
    np.testing.assert_allclose([law.mean(), law.sd()], [given.mean(), given.std()], rtol=1e-9)
    again = pickle.loads(pickle.dumps(law))
    assert again.ppf(P).tolist() == law.ppf(P).tolist()
    assert as_law(law_table(law)).ppf(P).tolist() == law.ppf(P).tolist()


@pytest.mark.parametrize(
    ("given", "family"),
    [
        (lambda: chaospy.Normal(1, 2), "normal"),
        (lambda: chaospy.LogNormal(0.3, 0.5), "lognormal"),
        (lambda: chaospy.LogNormal(0.3, 0.5, shift=1, scale=2), "scipy.lognorm"),
        (lambda: chaospy.Uniform(2, 5), "uniform"),
        (lambda: chaospy.Beta(2, 3, 1, 4), "beta"),
        (lambda: chaospy.Weibull(3, 2), "weibull"),
        (lambda: chaospy.TruncNormal(lower=-1, upper=2, mu=0.5, sigma=1.5), "normal"),
        (lambda: chaospy.Trunc(chaospy.Gamma(2, 3), upper=8), "gamma"),
        (lambda: chaospy.Triangle(1, 2, 3), "triangular"),
        (lambda: chaospy.Trunc(chaospy.Trunc(chaospy.Normal(1, 2), lower=-1), upper=1.5), "normal"),
        (lambda: chaospy.StudentT(5, 1, 2), "student_t"),
        (lambda: chaospy.LogUniform(1, 2), "loguniform"),
        (lambda: chaospy.LogWeibull(2, 1), "gumbel"),
        (lambda: chaospy.Exponential(2), "gamma"),
        *(
            (lambda made=made: made, "functions")
            for made in (
                chaospy.Kumaraswamy(2, 3),
                chaospy.Frechet(3, 2),
                chaospy.ChiSquared(4),
                chaospy.Burr(1.3, 2.2),
                chaospy.Cauchy(1, 2),
                chaospy.Logistic(2, 1, 3),
            )
        ),
    ],
)
def test_a_law_of_chaospy_is_the_same_law(given: Any, family: str) -> None:
    made = given()
    law = as_law(made)
    assert law.family.name == family
    p = np.linspace(0.01, 0.99, 9)
    np.testing.assert_allclose(law.ppf(p), made.inv(p), rtol=1e-6, atol=1e-6)
    assert pickle.loads(pickle.dumps(law)).isf(p).tolist() == law.isf(p).tolist()


def test_a_law_of_chaospy_by_its_functions_has_moments_where_its_tails_allow_them() -> None:
    law = as_law(chaospy.ChiSquared(4))
    assert (law.mean(), law.sd()) == pytest.approx((5.0, 12.0**0.5), rel=1e-6)
    assert np.isnan(as_law(chaospy.Cauchy(1, 2)).mean())
    with pytest.raises(LawError, match="a study file has no table for it"):
        law_table(law)


def test_a_law_that_chaospy_truncates_at_both_ends_is_taken_by_its_parameters() -> None:
    # chaospy's own quantiles of it are those of another law
    law = as_law(chaospy.Trunc(chaospy.Normal(), lower=-1, upper=1.5))
    assert law.ppf(P) == pytest.approx(stats.truncnorm(-1.0, 1.5).ppf(P), rel=1e-9)


def test_converted_tails_are_our_own_where_chaospy_cuts_them_off() -> None:
    far = np.array([1e-20])
    assert float(as_law(chaospy.Normal(0, 1)).ppf(far)[0]) == pytest.approx(
        stats.norm.ppf(1e-20), rel=1e-12
    )
    assert float(chaospy.Normal(0, 1).inv(far)[0]) == pytest.approx(-8.22)


@pytest.mark.parametrize(
    ("given", "message"),
    [
        (lambda: stats.poisson(3), "discrete"),
        (lambda: 3.0, "found float"),
        (lambda: chaospy.J(chaospy.Normal(), chaospy.Normal()), "give each number its own law"),
        (lambda: chaospy.Laplace(1, 2), "the lower tail of Laplace of chaospy is wrong"),
        (
            lambda: chaospy.Trunc(chaospy.Beta(2, 3), upper=0.5),
            "by its table, with lower and upper",
        ),
        (lambda: _Broken(name="broken")(), "has no law 'broken'"),
        (lambda: {"dist": "scipy.johnsonsu", "a": 1.0}, r"takes \(a, b\)"),
        (lambda: {"dist": "scipy.johnsonsu", "a": 1.0, "b": -1.0}, "no law with these shapes"),
    ],
)
def test_what_is_no_law_is_refused(given: Any, message: str) -> None:
    with pytest.raises(LawError, match=message):
        as_law(given())


class _Broken(stats.rv_continuous):
    def _pdf(self, x: Any) -> Any:
        return np.exp(-x)


def test_a_tail_that_contradicts_itself_is_refused() -> None:
    law = stats.norm(0.0, 1.0)
    law.sf = lambda x: np.maximum(stats.norm.sf(x), 1e-8)  # type: ignore[method-assign]
    with pytest.raises(LawError, match="upper tail of w is wrong from the probability 1e-09 on"):
        form_of("w", law, "")
