"""The tables of the answers: quantities, limits, margins and what they are made of, how all was computed."""

from __future__ import annotations

import math
import shlex
from collections.abc import Callable, Iterable, Iterator, Sequence

from uqsphere.quantities import OUTPUTS, lookup
from uqsphere.report.cautions import assumption
from uqsphere.report.contents import Contents, family_of
from uqsphere.report.figures.canvas import shorten
from uqsphere.report.phrases import (
    ABSENT,
    Table,
    answer_text,
    at_most,
    begin,
    breaks,
    call,
    cell,
    counted,
    index_cell,
    input_name,
    limit_name,
    listed,
    mathematical,
    number_text,
    plain_percent,
    powers,
    probability_range,
    rounded,
    symbol,
    thousands,
    two_digits,
    unit_text,
    value_text,
)
from uqsphere.results import IndexEntry, LimitEntry, MeasureEntry, MeasureRow, PartEntry, QuestionRow, SharesEntry
from uqsphere.results.entries import CheckEntry, Est, Ests, MarginEntry
from uqsphere.units import told_apart


def quantity_table(contents: Contents, quantity: str) -> Table:
    """Mean, standard deviation, quantiles and censored share with their intervals."""
    entry = contents.results.quantities[quantity]
    rows = [("mean", cell(entry.mean, quantity)), ("standard deviation", cell(entry.sd, quantity))]
    rows += [(f"{100.0 * float(p):g} % quantile", cell(e, quantity)) for p, e in entry.quantiles.items()]
    if entry.censored_share.value or lookup(quantity).censored:
        rows.append(("share that outlasts the record", cell(entry.censored_share, probability=True)))
    caption = f"{symbol(quantity)}: values with 95 % intervals"
    return Table(caption=caption, header=("", "value (95 % interval)"), rows=tuple(rows))


def limits_table(contents: Contents) -> Table:
    """Probability of missing the aim, what the tests leave open of it, reliability index and margin of every limit."""
    rows: list[tuple[str, ...]] = []
    limits = contents.results.limits
    tested = any(limit.ignorance for limit in limits.values())
    for name, limit in limits.items():
        index, ends, opened = limit.reliability_index, limit.reliability_index_interval, limit.ignorance
        least, most = (cell(limit.margin[p], digits=3) for p in ("0.05", "0.95"))
        rows.append((
            limit_name(name), limit.aim, ABSENT if limit.target is None else plain_percent(limit.target),
            cell(limit.miss, probability=True),
            *((probability_range(*opened.miss) if opened.known else ABSENT,) if tested else ()),
            ABSENT if index is None else cell(Est.of(index, *(ends or ())), digits=3),
            cell(limit.margin["median"], digits=3), f"{least} / {most}",
        ))  # fmt: skip
    header = ("limit", "aim", "target", "probability of missing it", *(("left open by the tests",) if tested else ()),
              "reliability index", "strength over demand, median", "5 % / 95 %")  # fmt: skip
    return Table(caption="Limits with 95 % intervals", header=header, rows=tuple(rows))


def margins_table(contents: Contents, name: str, *, only_own: bool = False) -> Table:
    """Values of the free scalar at the probabilities asked for, or at the one of the limit's target alone."""
    entry = contents.results.margins[name]
    solve = entry.solve
    subject = contents.subject(solve)
    what = "the sphere breaks" if breaks(contents.results, name) else f"{limit_name(name)} is exceeded"
    header = ["probability", "value (95 % interval of the computation alone)"]
    opened, decisive = entry.ignorance, format(entry.probability or 0.0, ".15g")
    tested = opened.low is not None and opened.high is not None
    yields = bool(entry.bars.yields_at)
    header[1:1] = ["what the tests leave open (95 %)"] if tested else []
    header += ["bars yield under the sphere"] if yields else []
    rows = []
    for p, e in entry.values.items():
        if only_own and p != decisive:
            continue
        row = [plain_percent(float(p)), cell(e, subject)]
        if tested:
            ends = f"{value_text(opened.low, subject, 3)} to {value_text(opened.high, subject, 3)}"
            row[1:1] = [ends if p == decisive else ABSENT]
        if yields:
            part = entry.bars.yields_at.get(p)
            row.append(ABSENT if part is None else plain_percent(float(f"{part:.2g}")))
        rows.append(tuple(row))
    caption = f"{begin(solve, input_name(solve))} at which {what} with a given probability"
    return Table(caption=caption, header=tuple(header), rows=tuple(rows), note=_when_bars_yield(entry, subject))


def _when_bars_yield(entry: MarginEntry, subject: str) -> str:
    """Where bars that are elastic by law begin to yield; empty where they do not, or nobody knows."""
    part, bars = plain_percent(entry.bars.contact_probability), entry.bars
    if bars.contact.value is not None:
        return f"The bars yield under the sphere in {part} of the rows at {cell(bars.contact, subject)}."
    everywhere = bars.contact_everywhere == "yields"
    return f"The bars yield in more than {part} of the rows at every value." if everywhere else ""


# --- How the answers were computed and how far to believe them: checks, model, methods, accuracy, repetition.


def answer_checks_table(contents: Contents, name: str) -> Table | None:
    """The checks at the answer of a limit's inverse question; None where none were made."""
    entry = contents.results.margins.get(name)
    if entry is None or not entry.validity:
        return None
    at = answer_text(contents, name)
    caption = f"At the answer for {limit_name(name)}, {at}, on {entry.validity.samples} rows"
    return _checks(entry.validity.checks, caption)


def checks_table(contents: Contents, *, broken: bool = False) -> Table | None:
    """Validity checks, graded, with the share of the rows that break each; those alone that are `broken`."""
    caption = "Assumptions of the model, checked on a pilot of the study as planned"
    if contents.results.fracture.check:
        caption += "; at fracture on spheres that break"
    checks = [c for c in contents.results.validity if not broken or c.share_failure + c.share_warning > 0.0]
    return _checks(checks, caption) if checks else None


def _checks(checks: Sequence[CheckEntry], caption: str) -> Table:
    rows = []
    for check in checks:
        shares = {grade: getattr(check, f"share_{grade}") for grade in ("failure", "warning", "information")}
        broken = {grade: f"{plain_percent(share)} {grade}" for grade, share in shares.items() if share > 0.0}
        grade = next(iter(broken), "not checked" if check.worst is None else "ok")
        told = ", ".join(broken.values()) or "none"
        rows.append((check.check.replace("_", " "), grade, told, mathematical(check.text)))
    return Table(caption=caption, rows=tuple(rows), header=("assumption", "grade", "share", "finding"))


def granted_table(contents: Contents) -> Table | None:
    """Every assumption about a strength, what is put instead, and the probability and verdict that follow."""
    limits = contents.results.limits
    several, rows = len(limits) > 1, []

    def word(limit: LimitEntry, met: bool | None) -> str:
        return "no target" if limit.target is None else {True: "met", False: "not met", None: "undecided"}[met]

    for name, limit in limits.items():
        own = (limit_name(name),) if several else ()
        known = [row for row in limit.assumed if row.miss.value is not None]
        opened = limit.ignorance
        if not known and not opened.known:
            continue
        rows.append((*own, "as the study has it", cell(limit.miss, probability=True, digits=3), word(limit, limit.met)))
        if opened.known:
            tests = listed([counted(entry.tests, "test") for entry in opened.fitted])
            text = probability_range(*opened.miss)
            rows.append((*own, f"by all laws that the {tests} allow (95 %)", text, word(limit, opened.met)))
        rows += [(*own, assumption(r), cell(r.miss, probability=True, digits=3), word(limit, r.met)) for r in known]
    if not rows:
        return None
    header = (*(("limit",) if several else ()), "what is assumed", "probability of missing the aim", "target")
    return Table(caption="The probability under other assumptions on the strength", header=header, rows=tuple(rows))


def paper_table(contents: Contents) -> Table | None:
    """The paper's formulas as printed beside the corrected and the full answers."""
    rows = []
    for row in contents.results.paper:
        known = row.quantity in OUTPUTS
        like = row.quantity if known else _LIKE.get(row.unit, "")
        texts = [value_text(number, like, 5) for number in (row.as_printed, row.corrected, row.full)]
        off = ABSENT
        if row.as_printed is not None and row.full:
            off = number_text(f"{100.0 * (row.as_printed / row.full - 1.0):+.3g}") + " %"
        what = call(row.quantity) if known else str(row.quantity).replace("_", " ")
        rows.append((what, *texts, off, str(row.note)))
    header = ("quantity", "as printed", "corrected", "full model", "printed against full", "note")
    note = "No intervals: one row, computed to the tolerance of the study."
    return Table(caption="At the means of the inputs", rows=tuple(rows), header=header, note=note) if rows else None


#: SI unit -> a named quantity with that unit's display, for rows that are no quantity of interest
_LIKE = {"Pa": "p_max", "N": "P_max", "m": "alpha_max", "s": "contact_time", "J": "energy"}


def accuracy_table(contents: Contents) -> Table | None:
    """Half-widths asked and reached and what the rest would take, one row per question."""
    rows = []
    for row in contents.results.accuracy.questions:
        _, comma, scale = str(row.question).partition(", ")
        verdict = {True: "reached", False: "not reached", None: "not pursued"}[row.met]
        reached = ABSENT if row.reached is None else number_text(told_apart(row.reached, row.asked))
        needed = ABSENT if row.met or row.met is None else "not known"
        needed = f"about {thousands(int(row.needed))} evaluations" if row.needed else needed
        rows.append((f"{question_name(row)}{comma}{scale}", f"{row.asked:g}", reached, verdict, needed))
    header = ("question", "asked", "reached", "", "it would take")
    caption = "Half-widths of the 95 % intervals, asked and reached"
    return Table(caption=caption, header=header, rows=tuple(rows)) if rows else None


def question_name(row: QuestionRow) -> str:
    """What an accuracy is of, such as "worst quantile of p_max"."""
    head, _, rest = str(row.quantity).partition(".")
    name, _, where = rest.partition(" at ")
    subject = limit_name(name) if head in ("limits", "margins") and rest else symbol(str(row.quantity))
    subject += f" at {where}" if where else ""
    return f"{str(row.question).partition(', ')[0]} of {subject}"


def model_table(contents: Contents) -> Table:
    """Model chosen, why, its measured error, its evaluations, the scene's numbers."""
    model = contents.results.model
    rows = [("model", model.chosen), ("why", model.why)]
    for name, error in model.measured_error.items():
        text = f"{ABSENT} (could not be measured)" if error is None else f"{error:.2g} standard deviations"
        rows.append((f"measured error of {symbol(name)}", number_text(text)))
    for name, seen in model.considered.items():  # what was not tried for want of promise tells nobody anything
        errors = [error for error in seen.error.values() if error is not None]
        off = f"errs by up to {max(errors):.2g} standard deviations, " if errors else ""
        rows.append((f"considered: {name}", f"{off}costs {seen.cost:.2g} of the full model"))
    rows += model.savings()
    rows += [(f"evaluations, {name}", thousands(number)) for name, number in model.evaluations.items()]
    rows.append(("failed evaluations", thousands(model.failures)))
    if model.undecided:
        rows.append(("evaluations with two possible answers", thousands(model.undecided)))
    for key, label, like in (
        ("mu_median", "mass number μ, median", ""),
        ("theta_median", "pulse number θ = t_i/t_c, median", ""),
        ("P_0_median", "force scale P_0 = Z v_0/2, median", "P_max"),
        ("t_c_median", "time scale t_c, median", "contact_time"),
    ):
        if key in model.numbers:
            rows.append((label, value_text(model.numbers[key], like)))
    note = "Errors are the largest on the pilot sample, other numbers its medians: neither has an interval."
    return Table(caption="How the answers were computed", header=("", ""), rows=tuple(rows), note=note)


def repeat_rows(contents: Contents) -> list[tuple[str, str]]:
    """What another must know to get the same numbers."""
    results, manifest = contents.results, contents.manifest
    budget, total = contents.resolved.analysis.budget, manifest.seconds.get("total")
    again = f", {thousands(manifest.evaluations_reused)} of them stored before" if manifest.evaluations_reused else ""
    rows = (
        ("study", str(results.study.hash)),
        ("seed", str(results.study.seed)),
        ("versions", ", ".join(f"{k} {v}" for k, v in results.versions.items())),
        ("machine", " ".join(str(v) for v in manifest.platform.values())),
        ("evaluations", thousands(manifest.evaluations) + again if manifest.evaluations else ""),
        ("time", "" if total is None else f"{total:.3g} s"),
        ("budget", f"{thousands(budget.evaluations)} evaluations, {thousands(budget.time)} s"),
    )
    return [row for row in rows if row[1]]


def commands(contents: Contents) -> Sequence[str]:
    """The commands that repeat the run from its own folder, and build this page again."""
    reference = contents.resolved.model_reference or "FILE.py:FUNCTION"
    model = f" --model {shlex.quote(str(reference))}" if contents.black_box else ""
    changed = "".join(f" --set {shlex.quote(str(text))}" for text in contents.resolved.overrides)
    return (f"uqsphere run study.toml --out again{changed}{model}", "uqsphere report .")


# --- methods ----------------------------------------------------------------------------------------


def _named(contents: Contents) -> Iterator[tuple[str, str]]:
    """Methods in full, and what each answered."""
    results = contents.results
    for name, entry in results.quantities.items():
        yield entry.mean.method, f"distribution of {symbol(name)}"
    for name, limit in results.limits.items():
        yield limit.miss.method, f"probability of {limit_name(name)}"
    known = {f"fragility of {limit_name(name)}": margin.values for name, margin in results.margins.items()}
    for name, indices in results.sensitivity.items():
        orders = (indices.first, indices.total, indices.shapley, indices.second)
        known[f"indices of {symbol(name)}"] = {
            f"{k} {n}": e for k, found in enumerate(orders) for n, e in found.items()
        }
    for what, estimates in known.items():
        yield from ((estimate.method, what) for estimate in estimates.values() if estimate.value is not None)


def plan_table(contents: Contents) -> Table | None:
    """What was planned and what it took; None for runs without a plan.  What was missed stands with the accuracies."""
    plan, costs = contents.results.plan, contents.manifest.plan
    if not plan:
        return None
    spent = sum(contents.results.model.evaluations.values())
    budget = contents.resolved.analysis.budget.evaluations
    rows = [
        ("way", f"{plan.way}: {plan.why}"),
        ("forecast", f"{thousands(plan.sampling_evaluations)} evaluations by sampling, some "
                     f"{thousands(plan.surrogate_evaluations)} by a surrogate, whatever the budget"),
        ("taken", f"{thousands(spent)} evaluations of at most {thousands(budget)}"),
    ]  # fmt: skip
    # seconds of every part, from those at which the parts ended, one after the other
    seconds, before = {}, 0.0
    for name, end in contents.manifest.seconds.items():
        if name != "total":
            seconds[name], before = float(end) - before, float(end)
    rows += [part_row(part, seconds.get(part.part)) for part in plan.parts or ()]
    cost, crossover = costs.cost_seconds_per_evaluation, costs.crossover_seconds_per_evaluation
    if cost:
        text = f"{number_text(f'{cost:.2g}')} s; a surrogate is taken above {number_text(f'{crossover:.2g}')} s"
        rows.append(("cost of an evaluation", text))
    return Table(caption="Plan and account", header=("", ""), rows=tuple(rows))


def part_row(part: PartEntry, seconds: float | None) -> tuple[str, str]:
    """A part of the run: planned and taken, and in what time."""
    text = f"planned {thousands(part.likely)}, at most {thousands(part.most)}; took {thousands(part.taken)}"
    if seconds is not None and seconds >= 0.05:
        text += f" in {thousands(round(seconds)) if seconds >= 10.0 else f'{seconds:.2g}'} s"
    return str(part.part), text


def methods_table(contents: Contents) -> Table:
    """Every method once: its name in full, and what it answered."""
    used: dict[str, list[str]] = {}
    for method, what in _named(contents):
        found = used.setdefault(str(method), [])
        if what not in found:
            found.append(what)
    rows = ((name, listed(of[:6]) + (" and others" if len(of) > 6 else "")) for name, of in used.items())
    return Table(caption="Methods", header=("method", "used for"), rows=tuple(rows))


# --- Where the numbers of a study come from: inputs with their laws, fixed numbers, dependence, sources.

_WORDS = {
    "sd": "standard deviation",
    "cov": "coefficient of variation",
    "dof": "degrees of freedom",
    "log_mean": "mean of the logarithm (SI)",
    "log_sd": "standard deviation of the logarithm",
}


def _law_text(contents: Contents, name: str) -> str:
    law, subject = contents.resolved.random[name], contents.subject(name)
    family = family_of(law)
    # what was fitted to observations is known no better than they tell; the table of the tests has the intervals
    digits = 3 if law.data else 6
    parts = []
    for key, value in (law.given or law.parameters).items():
        if key == "rate":
            unit = unit_text(lookup(subject).unit)
            parts.append(f"rate {value:.6g}" + (f" per {unit}" if unit else ""))
        elif isinstance(value, (int, float)):
            text = value_text(value, subject, digits) if key in family.dimensional else f"{value:.{digits}g}"
            parts.append(f"{_WORDS.get(key, key)} {text}")
    words = ("from", "to") if family.bounded else ("cut off below", "cut off above")
    ends = zip(words, (law.lower, law.upper), strict=True)
    parts += [f"{word} {value_text(end, subject, 6)}" for word, end in ends if end is not None]
    if law.data:
        stopped = f" and {len(law.censored)} stopped before" if law.censored else ""
        parts.append(f"{len(law.data)} observations{stopped}")
    return ", ".join([family.label, *parts])


def _source(contents: Contents, name: str) -> str:
    source = contents.resolved.sources.get(name)
    if source is None:
        return "stated in the study"
    return str(source.text) + ("" if source.seen else " [source not seen: taken on the word of others]")


def inputs_table(contents: Contents) -> Table:
    """Random inputs with their laws; mean and standard deviation are those of the law in force."""
    rows = []
    for name, entry in contents.results.inputs.items():
        mean, sd = (value_text(v, contents.subject(name), k) for v, k in ((entry.mean, 4), (entry.sd, 3)))
        rows.append((input_name(name), _law_text(contents, name), mean, sd, _source(contents, name)))
    header = ("input", "law", "mean in force", "sd in force", "source")
    note = "Exact: these laws are what the answers are computed for."
    return Table(caption="Random inputs", header=header, rows=tuple(rows), note=note)


def fixed_table(contents: Contents) -> Table | None:
    """Fixed numbers and choices of the scene with their sources."""
    study, stated = contents.resolved, "stated in the study or default"
    rows = [(input_name(n), value_text(value, n, 6), _source(contents, n)) for n, value in study.fixed.items()]
    for name, value in study.options.items():
        text = ("yes" if value else "no") if isinstance(value, bool) else str(value)
        rows.append((name.replace(".", ": ").replace("_", " "), text.replace("_", " "), stated))
    for part, material in study.materials.items():
        of = "sphere" if part == "sphere" else "bars"
        rows.append((f"material of the {of}", str(material).replace("_", " "), "material library"))
    note = "Exact: the numbers that the answers are computed for."
    header = ("input", "value", "source")
    return Table(caption="Fixed numbers", header=header, rows=tuple(rows), note=note) if rows else None


def dependence_texts(contents: Contents) -> list[str]:
    """The rank correlations in sentences."""
    texts = []
    for group in contents.resolved.dependence:
        named = (("Spearman rank correlation", group.spearman), ("Kendall rank correlation", group.kendall))
        strength = next((f"{word} {value:g}" for word, value in named if value is not None), "dependent")
        copula = str(group.copula).replace("_", " ").capitalize()
        freedom = f" with {group.dof:g} degrees of freedom" if group.dof else ""
        texts.append(f"{' and '.join(input_name(n) for n in group.of)}: {strength}, {copula} copula{freedom}.")
    return texts


# --- what a margin is made of: safety factors, partial factors, scatter, ignorance, error -----------------------


def parts_table(contents: Contents, name: str) -> Table | None:
    """Everything that is known of a margin beside its curve; None for a folder of an earlier version."""
    entry, limit = contents.results.margins[name], contents.results.limits[name]
    if "factors" not in entry.model_fields_set:
        return None
    subject, solve = contents.subject(entry.solve), input_name(entry.solve)
    rows = [*_reserve_rows(contents, entry, limit), *_factor_rows(contents, name)]
    rows += _partial_rows(entry, limit)
    split = entry.split
    for spread, words in (
        (split.scatter, "scatter from sphere to sphere, in the probability already"),
        (split.ignorance, "uncertainty of the answer from few tests"),
        (split.numerical, "uncertainty of the answer from computing"),
    ):
        if spread is not None:
            rows.append((f"{words} (standard deviation of its logarithm)", number_text(f"{spread:#.2g}")))
    opened = entry.ignorance
    # what the tests leave open of value and probability stands in the tables of these
    if opened.mean_law is not None:
        words = f"{solve} with the mean over all laws that the tests allow"
        rows.append((words, rounded(Est.of(opened.mean_law), subject, 3)))
    caption = f"Margin of {limit_name(name)}; the answer is where {plain_percent(entry.probability or 0.0)} exceed it"
    return Table(caption=caption, header=("", "value"), rows=tuple(rows)) if rows else None


def _reserve_rows(contents: Contents, entry: MarginEntry, limit: LimitEntry) -> Iterator[tuple[str, str]]:
    """Factor by which the free scalar may move before the target is reached; below 1 where it is missed."""
    here, value = contents.at_mean(entry.solve), entry.value.value
    if here is None or value is None or not (here > 0.0 and value > 0.0):
        return
    factor = value / here if at_most(entry, limit.aim) else here / value
    word = "reserve" if factor >= 1.0 else "shortfall (reserve below 1)"
    # in three digits, never more than it is
    whole = f"{math.floor(100.0 * factor + 1e-9) / 100.0:.2f}" if factor < 100.0 else f"{math.floor(factor)}"
    told = whole if factor >= 1.0 else f"{factor:.3g}"
    yield f"{word} in {input_name(entry.solve)}: the answer against the planned value", told


def _factor_rows(contents: Contents, name: str) -> Iterator[tuple[str, str]]:
    factors, of = contents.results.margins[name].factors, contents.results.margins[name].factors.fractiles_of
    if factors.medians:
        # safe above 1 where the sphere is to survive, short where it is to break
        survive = contents.results.limits[name].aim == "survive"
        safe = "safety factor" if survive else "strength over demand (above 1: short of breaking)"
        fractiles = f"{plain_percent(of.strength)} fractile of the strength over {plain_percent(of.demand)} fractile"
        apart = "of the demand (each by itself, without their dependence)"
        medians = _ranged(contents, name, factors.medians, 0.5)
        yield f"{safe} as planned: median strength over median demand", medians
        yield f"{safe} as planned: {fractiles} {apart}", _ranged(contents, name, factors.fractiles, of.demand)


def _partial_rows(entry: MarginEntry, limit: LimitEntry) -> Iterator[tuple[str, str]]:
    """The partial factors at the answer."""
    survive = limit.aim == "survive"
    likeliest, fractile = ("failure", "5 %") if survive else ("survival", "95 %")
    for key, part in entry.lost_to.partial.items():
        own, what, values = (
            key,
            f"its value at the likeliest {likeliest} over its median",
            (part.design, part.characteristic),
        )
        if key.endswith(".strength"):
            own, what = limit.quantity, f"its {fractile} fractile over its value at the likeliest {likeliest}"
            values = values[::-1]
        text = f"{part.factor:.3f} ({value_text(values[0], own)} over {value_text(values[1], own)})"
        yield f"at the answer, partial factor of {input_name(key)}: {what}", text


def _ranged(contents: Contents, name: str, factor: float, fractile: float) -> str:
    """A safety factor with the relative interval of the demand under it; the strength over it is exact by its law."""
    limit = contents.resolved.limits[name]
    quantity = contents.results.quantities.get(limit.quantity)
    demand = quantity.quantiles.get(f"{fractile:g}", Est()) if quantity is not None else Est()
    if limit.model_factor != 1.0 or not demand.value or not demand.low or not demand.high:
        return f"{factor:.3g} (no interval: the demand has none of its own)"
    low, high = sorted((factor * demand.value / demand.high, factor * demand.value / demand.low))
    return cell(Est.of(factor, low, high))


# --- what drives quantities and failure, indices beyond variance, what to measure first ---------------------


_ALONE = ("input", "first (alone)", "total (with interactions)")


def _largest_first(table: Ests | None) -> list[str]:
    """Names with a value, the largest first."""
    known = [name for name, entry in (table or {}).items() if entry.value is not None]
    return sorted(known, key=lambda name: -(table or {})[name].number)


def _table(
    caption: str,
    header: tuple[str, ...],
    names: Iterable[str],
    *columns: Ests,
    note: str = "",
    words: Callable[[str], str] = input_name,
) -> Table | None:
    """A row of indices for each name; None without any."""
    rows = tuple((words(name), *(index_cell(column.get(name)) for column in columns)) for name in names)
    return Table(caption=caption, header=header, rows=rows, note=note) if rows else None


def ranked(entry: IndexEntry) -> list[str]:
    """Inputs with an index, the most important first: by the total index where interactions are seen."""
    known = [n for n, e in entry.total.items() if e.value is not None and entry.first[n].value is not None]

    def interacts(name: str) -> bool:
        # by more than the intervals, and by what matters
        first, total = entry.first[name], entry.total[name]
        apart = first.high is not None and total.low is not None and total.low > first.high
        return apart and total.number - first.number > 0.01

    order = entry.total if any(map(interacts, known)) else entry.first
    return sorted(known, key=lambda name: -(order[name].value or 0.0))


def _shared(caption: str, entry: IndexEntry | SharesEntry) -> Table | None:
    """Shapley effects and Kucherenko's indices, where inputs depend on each other."""
    names, both = sorted(entry.shapley, key=lambda name: -(entry.shapley[name].value or 0.0)), entry.kucherenko
    header = ("input", "Shapley effect", "Kucherenko, first", "Kucherenko, total")
    return _table(caption, header, names, entry.shapley, both.first, both.total)


# --- quantities -----------------------------------------------------------------------------------------


def index_table(contents: Contents, quantity: str) -> Table | None:
    """First and total indices with intervals, or the shares of inputs that depend on each other."""
    entry = contents.results.sensitivity.get(quantity, IndexEntry())
    caption = f"Sobol’ indices of {symbol(quantity)} with 95 % intervals"
    found = _table(caption, _ALONE, ranked(entry), entry.first, entry.total, note=entry.check.text)
    caption = f"Shares of dependent inputs in the variance of {symbol(quantity)}, with 95 % intervals"
    return found or _shared(caption, entry)


def pair_table(contents: Contents, quantity: str) -> Table | None:
    """Indices of pairs with intervals, the largest first."""
    pairs = contents.results.sensitivity.get(quantity, IndexEntry()).second
    rows = tuple((*map(input_name, name.split("|", 1)), index_cell(pairs[name])) for name in _largest_first(pairs))
    caption = f"Second-order indices of {symbol(quantity)} with 95 % intervals"
    return Table(caption=caption, header=("input", "with", "share of the variance"), rows=rows) if rows else None


def group_table(contents: Contents, quantity: str) -> Table | None:
    """Indices of groups with intervals."""
    groups = contents.results.sensitivity.get(quantity, IndexEntry()).groups
    caption = f"Indices of groups of inputs, {symbol(quantity)}, with 95 % intervals"
    header = ("group", "by themselves (closed)", "with interactions (total)")
    return _table(caption, header, groups.total, groups.first, groups.total, words=lambda name: shorten(name, 60))


def distances_table(contents: Contents, quantity: str) -> Table | None:
    """Borgonovo's delta and PAWN."""
    entry = contents.results.sensitivity.get(quantity, IndexEntry())
    threshold = entry.pawn_threshold
    idle = "" if threshold is None else f"; without any effect PAWN stays below {number_text(f'{threshold:.2g}')}"
    caption = f"How far an input moves the whole law of {symbol(quantity)}{idle}"
    return _table(caption, ("input", "Borgonovo’s δ", "PAWN"), _largest_first(entry.delta), entry.delta, entry.pawn)


# --- failure --------------------------------------------------------------------------------------------


def failure_table(contents: Contents, name: str) -> Table | None:
    """Indices of missing the aim of a limit."""
    entry = contents.results.limits[name].drivers
    if not entry:
        return None
    caption = f"Indices of {entry.of}, {limit_name(name)}, with 95 % intervals"
    return _shared(caption, entry) or _table(caption, _ALONE, _largest_first(entry.total), entry.first, entry.total)


def given_failure_table(contents: Contents, name: str) -> Table | None:
    """Inputs where the aim is missed, beside their laws."""
    rows = []
    for variable, found in (contents.results.limits[name].drivers.given_failure or {}).items():
        if found.mean.value is None:
            continue
        subject, law = contents.subject(variable), found.law
        low, high = (value_text(law.quantiles[p], subject) for p in ("0.05", "0.95"))
        there = (found.mean, found.quantiles["0.05"], found.quantiles["0.95"])
        # four digits: with more the table is wider than the page
        cells = [cell(one, subject, digits=4) for one in there]
        rows.append((input_name(variable), *cells, value_text(law.mean, subject), f"{low} to {high}"))
    if not rows:
        return None
    return Table(
        caption=f"The inputs where the aim of {limit_name(name)} is missed, with 95 % intervals",
        header=("input", "mean there", "5 % there", "95 % there", "mean of the law", "5 to 95 % of the law"),
        rows=tuple(rows),
        note="What belongs to the law is exact.",
    )


# --- what to measure first ------------------------------------------------------------------------------


def specimens(entry: MeasureEntry, row: MeasureRow) -> int | None:
    """Specimens after which the mean of an input leaves the smaller side of a probability known as wanted.

    What is stored counts to a tenth, say, of the probability itself: of one near 1 any single specimen tells that,
    and nothing is learnt about how near it is.

    >>> row = MeasureRow(input="x", tests=1, share=1.0, sway=Est.of(1.83149e-4))
    >>> specimens(MeasureEntry(of="probability", wanted=0.1, probability=1.0 - 4.45344e-5), row)
    1692
    """
    p, sway = entry.probability, row.sway.value
    if entry.of != "probability" or p is None or not 0.5 < p < 1.0 or sway is None:
        return row.tests
    return max(1, math.ceil((float(sway) / (float(entry.wanted) * (1.0 - float(p)))) ** 2))


def measure_table(entry: MeasureEntry | None, caption: str) -> Table | None:
    """Inputs by what knowing them better is worth, with the number of specimens."""
    if not entry or not entry.rows:
        return None
    probability = entry.of == "probability"
    # one power of ten for the whole column
    largest = max(abs(row.sway.value or 0.0) for row in entry.rows) if probability else 0.0
    power = math.floor(math.log10(largest)) if 0.0 < largest < 0.1 else 0
    rows = tuple((input_name(row.input), *_worth(entry, row, power)) for row in entry.rows)
    wanted = f"{100.0 * entry.wanted:g} %"
    if not probability:
        left = f"tests in all until {wanted} of today’s variance is left to it"
        note = "Numbers of tests rise with the share, and have its relative interval."
        return Table(caption=caption, header=("input", "share of the variance", left), rows=rows, note=note)
    scale = f" [{powers(f'1e{power}').removeprefix('1 × ')}]" if power else ""
    side = "the probability to the contrary" if (entry.probability or 0.0) > 0.5 else "the probability"
    moves = f"tests in all until its error moves {side} by {wanted} of its value"
    change = f"change of the probability per standard deviation{scale}"
    note = "Shares and numbers of tests rise with the square of the change, and have twice its relative interval."
    return Table(caption=caption, header=("input", change, "share in its uncertainty", moves), rows=rows, note=note)


def _worth(entry: MeasureEntry, row: MeasureRow, power: int) -> tuple[str, ...]:
    """What not knowing an input does, a change in units of 10^power, and the tests that make it small."""
    seen, count, sway = row.observations, specimens(entry, row), row.sway
    tests = (thousands(count) if count else "none") + ("" if seen is None else f" (the law rests on {seen})")
    if entry.of != "probability":
        return index_cell(row.effect), tests
    ends = (None if end is None else 10.0**-power * end for end in (sway.value, sway.low, sway.high))
    return cell(Est.of(*ends)), two_digits(row.part), tests


def design_table(contents: Contents, name: str) -> Table | None:
    """The design point of a limit: the likeliest values at which its aim is missed; None where there is none."""
    limit = contents.results.limits[name]
    point = limit.design_point
    if not point:
        return None
    shares = limit.governing_inputs or {}
    rows = []
    for key in sorted(point, key=lambda k: -float(shares.get(k, 0.0))):
        part = two_digits(float(shares[key])) if key in shares else ABSENT
        mean = contents.results.inputs[key].mean if key in contents.results.inputs else None
        subject = contents.subject(key)
        usual = ABSENT if mean is None else value_text(mean, subject)
        rows.append((input_name(key), value_text(point[key], subject), usual, part))
    return Table(
        caption=f"Design point of {limit_name(name)}",
        header=("input", "value there", "mean", "importance factor"),
        rows=tuple(rows),
        note="No intervals: the point is where a search ended, not an estimate from samples; the means are exact.",
    )
