"""Hand-written mutants: one small fault each, as a person could make it, and the tests that ought to see it.

(file below uqsphere/, what stands there once, what the mutant has in its place, test files)
"""

from __future__ import annotations

__all__ = ["MUTANTS"]

CONTACT, BARS, PULSES = "mechanics/contact.py", "mechanics/bars.py", "mechanics/pulses.py"
CLOSED, SCENE, CRITERIA = "mechanics/closed_form.py", "mechanics/scene.py", "mechanics/criteria.py"
VALIDITY, DYNAMICS = "mechanics/validity.py", "mechanics/integrator/solve.py"
ESTIMATORS, TOLERANCE, ESTIMATES = "uq/estimators.py", "uq/tolerance.py", "uq/estimates.py"
RELIABILITY, LAWS, FAMILIES = "uq/reliability.py", "uq/distribution.py", "uq/families.py"
COPULAS, MOMENTS, CONTROL, MARGINS = "uq/copulas.py", "uq/moments.py", "uq/control.py", "uq/margins.py"
RANKS, LIMITS, COMPARE, STORE = "uq/ranks.py", "runner/limits.py", "compare/__init__.py", "store.py"

MUTANTS: list[tuple[str, str, str, str]] = [
    # contact
    (CONTACT, "(1.0 - nu * nu) / E", "(1.0 + nu * nu) / E", "test_contact.py"),
    (
        CONTACT,
        "1.0 / radius + 1.0 / np.asarray(end_radius",
        "1.0 / radius - 1.0 / np.asarray(end_radius",
        "test_contact.py",
    ),
    (CONTACT, "(4.0 / 3.0) * modulus * np.sqrt", "(2.0 / 3.0) * modulus * np.sqrt", "test_contact.py"),
    (CONTACT, "(4.0 / 3.0) * math.pi * radius**3", "(4.0 / 3.0) * math.pi * radius**2", "test_scene.py"),
    (CONTACT, "np.cbrt(np.square(force / beta))", "np.cbrt(force / beta)", "test_contact.py"),
    (CONTACT, "np.cbrt(6.0 * force", "np.cbrt(3.0 * force", "test_contact.py"),
    (CONTACT, "(1.0 - 2.0 * nu) / 3.0 * pressure", "(1.0 - nu) / 3.0 * pressure", "test_contact.py"),
    (CONTACT, "0.4 * hertz_force", "0.5 * hertz_force", "test_contact.py"),
    (CONTACT, "(7.0 + 5.0 * nu)", "(7.0 - 5.0 * nu)", "test_contact.py"),
    # bars and pulses
    (BARS, "np.sqrt(E / density)", "np.sqrt(density / E)", "test_bars.py"),
    (BARS, "0.25 * math.pi", "0.5 * math.pi", "test_bars.py"),
    (BARS, "return 2.0 * length / wave_speed", "return length / wave_speed", "test_bars.py"),
    (BARS, "0.5 * density * wave_speed", "density * wave_speed", "test_bars.py"),
    (
        BARS,
        '"free": 1.0, "absorbing": 0.0, "fixed": -1.0',
        '"free": -1.0, "absorbing": 0.0, "fixed": 1.0',
        "test_bars.py",
    ),
    (PULSES, "3.0 * rise / length**2, -2.0", "3.0 * rise / length**2, 2.0", "test_pulses.py"),
    (
        PULSES,
        "duration - 0.5 * (rise + fall)\n    zero",
        "duration - (rise + fall)\n    zero",
        "test_pulses.py",
    ),
    (
        PULSES,
        "duration - 0.5 * (rise + fall)\n    roomy",
        "duration - (rise + fall)\n    roomy",
        "test_striker.py::test_ramps_of_steps_may_fill_the_width_and_no_more",
    ),
    (PULSES, "frequency=np.pi / duration", "frequency=2.0 * np.pi / duration", "test_pulses.py"),
    # closed forms and scales
    (CLOSED, "1.0 / (1.0 + 1.5 * k)", "1.0 / (1.0 + 2.5 * k)", "test_closed_form.py"),
    (CLOSED, "0.5 * np.log1p(root + root * root)", "np.log1p(root + root * root)", "test_closed_form.py"),
    (CLOSED, "small - 0.4 * small**2.5", "small + 0.4 * small**2.5", "test_closed_form.py"),
    (CLOSED, "** -2.0)", "** -1.5)", "test_closed_form.py"),
    (CLOSED, "square = 2.0 / mu - 0.25", "square = 2.0 / mu + 0.25", "test_closed_form.py"),
    (CLOSED, "return mean + half, mean - half", "return mean + half, mean + half", "test_closed_form.py"),
    (
        CLOSED,
        "energy = 2.0 * 0.4 * peak**2.5",
        "energy = 0.4 * peak**2.5",
        "test_closed_form.py test_closed_form_study.py",
    ),
    (CLOSED, "peak * 0.9 ** (2.0 / 3.0)", "peak * 0.9", "test_closed_form.py test_closed_form_study.py"),
    (SCENE, "force = 0.5 * impedance * speed", "force = impedance * speed", "test_scene.py"),
    (SCENE, "time = 2.0 * approach / speed", "time = approach / speed", "test_scene.py"),
    (SCENE, "mass / (impedance * time)", "impedance * time / mass", "test_scene.py"),
    (SCENE, '> self.columns["bars.diameter"]] = 1', '< self.columns["bars.diameter"]] = 1', "test_scene.py"),
    # criteria and validity
    (CRITERIA, "np.cbrt(np.square(np.maximum(rate", "np.sqrt(np.square(np.maximum(rate", "test_criteria.py"),
    (CRITERIA, "E / (AUERBACH * np.asarray(radius))", "E / (AUERBACH / np.asarray(radius))", "test_criteria.py"),
    (CRITERIA, "0.9 * np.asarray(force)", "0.7 * np.asarray(force)", "test_criteria.py"),
    (CRITERIA, "/ size) ** (1.0 / np.asarray(modulus", "/ size) ** (3.0 / np.asarray(modulus", "test_criteria.py"),
    (
        CRITERIA,
        "4.0 / 3.0 * math.pi * radius**3 / parameters",
        "4.0 * math.pi * radius**3 / parameters",
        "test_criteria.py",
    ),
    (
        VALIDITY,
        '2.0 * c["sphere.radius"] / bars.wave_speed',
        'c["sphere.radius"] / bars.wave_speed',
        "test_validity.py",
    ),
    (VALIDITY, "measured > threshold if rule.rising", "measured < threshold if rule.rising", "test_validity.py"),
    (VALIDITY, '2.0 * answers.values["a_max"] / scene', 'answers.values["a_max"] / scene', "test_validity.py"),
    # the batch integrator's units
    (
        DYNAMICS,
        "for begin in range(0, len(rows), _BLOCK)]",
        "for begin in range(_BLOCK, len(rows), _BLOCK)]",
        "test_model.py test_plain.py",
    ),
    # laws
    (FAMILIES, "-_normal_ppf(q, shapes)", "_normal_ppf(q, shapes)", "test_laws.py"),
    (FAMILIES, "math.sqrt(1.0 / 12.0)", "math.sqrt(1.0 / 6.0)", "test_laws.py"),
    (FAMILIES, "(1.0 + shapes[0]) / 3.0", "(1.0 + shapes[0]) / 2.0", "test_laws.py"),
    (FAMILIES, "(-np.log1p(-p)) ** (1.0 / shapes[0])", "(-np.log1p(-p)) ** shapes[0]", "test_laws.py"),
    (FAMILIES, "math.pi / math.sqrt(6.0)", "math.pi / math.sqrt(3.0)", "test_laws.py"),
    (FAMILIES, "shapes[0] / (shapes[0] + shapes[1])", "shapes[1] / (shapes[0] + shapes[1])", "test_laws.py"),
    (LAWS, "mass = 1.0 - below_a - above_b", "mass = 1.0 - below_a + above_b", "test_laws.py"),
    (LAWS, '+ 0.5 * law.parameters["log_sd"] ** 2', '+ law.parameters["log_sd"] ** 2', "test_laws.py"),
    (LAWS, "return _inverse(law, 1.0 - q, q)", "return _inverse(law, q, 1.0 - q)", "test_laws.py"),
    # dependence
    (
        COPULAS,
        "return 2.0 * math.sin(math.pi * value / 6.0)",
        "return math.sin(math.pi * value / 6.0)",
        "test_copulas.py",
    ),
    (COPULAS, "return 2.0 * value / (1.0 - value)", "return value / (1.0 - value)", "test_copulas.py"),
    (COPULAS, "return 1.0 / (1.0 - value)", "return 2.0 / (1.0 - value)", "test_copulas.py"),
    (COPULAS, "1.0 - 4.0 * (1.0 - debye) / theta", "1.0 - 2.0 * (1.0 - debye) / theta", "test_copulas.py"),
    # estimates
    (
        ESTIMATES,
        "stdtrit(replicates - 1, 0.975)",
        "stdtrit(replicates - 1, 0.95)",
        "test_estimates.py test_coverage.py",
    ),
    (
        ESTIMATES,
        "np.std(values, ddof=1)) / math.sqrt(values.size), floor)",
        "np.std(values, ddof=1)), floor)",
        "test_estimates.py test_coverage.py",
    ),
    (
        ESTIMATES,
        "high=-math.expm1(math.log(0.05) / total)",
        "high=-math.expm1(math.log(0.5) / total)",
        "test_estimates.py",
    ),
    (ESTIMATES, "max(p * total - 0.5 - lower, 0.0)", "max(p * total + 0.5 - lower, 0.0)", "test_estimates.py"),
    (ESTIMATES, "elif estimate.half_width > max(", "elif estimate.half_width < max(", "test_estimates.py"),
    (MOMENTS, "math.sqrt(one) / second.scale", "math.sqrt(one) * second.scale", "test_estimates.py"),
    (MOMENTS, "three - 3.0 * one * two", "three - 2.0 * one * two", "test_estimates.py"),
    (ESTIMATORS, "block_mean(b * (ab - a))", "block_mean(a * (ab - a))", "test_indices.py test_sensitivity.py"),
    (
        ESTIMATORS,
        "v - 0.5 * block_mean((b - ab) ** 2)",
        "v - block_mean((b - ab) ** 2)",
        "test_indices.py test_sensitivity.py",
    ),
    (
        ESTIMATORS,
        "return 0.5 * block_mean((a - ab) ** 2)",
        "return 0.5 * block_mean((b - ab) ** 2)",
        "test_indices.py test_sensitivity.py",
    ),
    (
        ESTIMATORS,
        "2.0 * block_mean((ba - b) * (a - ab))",
        "block_mean((ba - b) * (a - ab))",
        "test_indices.py test_sensitivity.py",
    ),
    (TOLERANCE, "left_out = sides * order", "left_out = order", "test_tolerance.py"),
    (TOLERANCE, "rising[order - 1]", "rising[order]", "test_tolerance.py"),
    (RANKS, "np.roll(centred, -lag, axis=-1)).mean", "np.roll(centred, 0, axis=-1)).mean", "test_given.py"),
    (
        CONTROL,
        "float(dear.mean()) - alpha * float(gap.mean())",
        "float(dear.mean()) + alpha * float(gap.mean())",
        "test_control.py",
    ),
    (
        CONTROL,
        "(math.sqrt(1.0 - square) + math.sqrt(cost * square)) ** 2",
        "(math.sqrt(1.0 - square) + math.sqrt(cost * square))",
        "test_control.py",
    ),
    # probabilities
    (RELIABILITY, "return -float(ndtri(probability))", "return float(ndtri(probability))", "test_reliability.py"),
    (RELIABILITY, "missed.high < 0.01 * target", "missed.high < 100.0 * target", "test_reliability.py"),
    (
        RELIABILITY,
        "if missed.low is not None and missed.low > target:",
        "if missed.low is not None and missed.low < target:",
        "test_reliability.py",
    ),
    (
        RELIABILITY,
        "low = p * math.exp(-half) / (q + p * math.exp(-half))",
        "low = p * math.exp(-half)",
        "test_reliability.py",
    ),
    (RELIABILITY, "quantiles=[1.0 - p for p in keys]", "quantiles=[p for p in keys]", "test_reliability.py"),
    (
        RELIABILITY,
        "(demands > strength).astype(float), (demands <= strength)",
        "(demands < strength).astype(float), (demands >= strength)",
        "test_reliability.py",
    ),
    (MARGINS, "wanted = direction * float(ndtri(target))", "wanted = float(ndtri(target))", "test_margins.py"),
    (MARGINS, "return 0.5 * (rising + falling)", "return rising", "test_margins.py"),
    (LIMITS, "demands * limit.model_factor", "demands / limit.model_factor", "test_limits_agree.py test_runner.py"),
    # what is stored and compared
    (STORE, "if hashlib.sha256(data).hexdigest()[:16] == name[-20:-4]:", "if data:", "test_store.py"),
    (STORE, "os.replace(temporary, path)", "os.rename(temporary, path)", "test_store.py"),
    (STORE, "            os.fsync(file.fileno())\n", "", "test_store.py"),
    (COMPARE, "math.hypot(b[0] - b[1], a[2] - a[0])", "math.hypot(b[0] - b[1], a[0] - a[1])", "test_compare.py"),
    (COMPARE, "_LEVEL / (len(known) - rank)", "_LEVEL / (1 + rank)", "test_compare.py"),
    (
        COMPARE,
        "towards = below if difference > 0.0 else above",
        "towards = above if difference > 0.0 else below",
        "test_compare.py",
    ),
]

#: mutants that no test can see, by their replacement, with the reason
EQUIVALENT: dict[str, str] = {
    "os.rename(temporary, path)": "the same system call on POSIX; on Windows alone it refuses to replace",
    "small + 0.4 * small**2.5": "a value to start from: the iteration that follows ends at the same root",
}
