"""Where the numbers of a study come from: inputs with their laws, fixed numbers, dependence, sources."""

from __future__ import annotations

from uqsphere.quantities import lookup
from uqsphere.report.contents import Contents
from uqsphere.report.tables import Table
from uqsphere.report.wording import input_name, law_name, unit_text, value_text

__all__ = ["dependence_texts", "fixed_table", "inputs_table"]

_BARE = frozenset({"cov", "modulus", "shape", "alpha", "beta", "dof", "log_mean", "log_sd", "bandwidth"})
_WORDS = {
    "sd": "standard deviation",
    "cov": "coefficient of variation",
    "dof": "degrees of freedom",
    "log_mean": "mean of the logarithm (SI)",
    "log_sd": "standard deviation of the logarithm",
}


def _law_text(contents: Contents, name: str) -> str:
    law = contents.resolved["random"][name]
    subject = contents.subject(name)
    given = law["given"] or law["parameters"]
    # what was fitted to observations is known no better than they tell; the table of the tests has the intervals
    digits = 3 if law["data"] else 6
    parts = []
    for key, value in given.items():
        if key == "rate":
            unit = unit_text(lookup(subject).unit)
            parts.append(f"rate {value:.6g}" + (f" per {unit}" if unit else ""))
        elif isinstance(value, (int, float)):
            parts.append(
                f"{_WORDS.get(key, key)} "
                + (f"{value:.{digits}g}" if key in _BARE else value_text(value, subject, digits))
            )
    bounded = law["dist"] in ("uniform", "loguniform", "triangular", "beta")
    for key, word in (
        ("lower", "from" if bounded else "cut off below"),
        ("upper", "to" if bounded else "cut off above"),
    ):
        if law[key] is not None:
            parts.append(f"{word} {value_text(law[key], subject, 6)}")
    if law["data"]:
        stopped = len(law.get("censored", ()))
        parts.append(f"{len(law['data'])} observations" + (f" and {stopped} stopped before" if stopped else ""))
    return ", ".join([law_name(str(law["dist"])), *parts])


def _source(contents: Contents, name: str) -> str:
    source = contents.resolved.get("sources", {}).get(name)
    if source is None:
        return "stated in the study"
    return str(source["text"]) + ("" if source["seen"] else " [source not seen: taken on the word of others]")


def inputs_table(contents: Contents) -> Table:
    """Random inputs with their laws; mean and standard deviation are those of the law in force."""
    rows = []
    for name, entry in contents.results["inputs"].items():
        subject = contents.subject(name)
        rows.append(
            (
                f"{input_name(name)}",
                _law_text(contents, name),
                value_text(entry["mean"], subject),
                value_text(entry["sd"], subject, 3),
                _source(contents, name),
            )
        )
    return Table(
        caption="Random inputs",
        header=("input", "law", "mean in force", "sd in force", "source"),
        rows=tuple(rows),
        note="Exact: these laws are what the answers are computed for.",
    )


def fixed_table(contents: Contents) -> Table | None:
    """Fixed numbers and choices of the scene with their sources."""
    rows = [
        (input_name(name), value_text(value, name, 6), _source(contents, name))
        for name, value in contents.resolved["fixed"].items()
    ]
    for name, value in contents.resolved.get("options", {}).items():
        text = {True: "yes", False: "no"}.get(value, str(value)) if isinstance(value, bool) else str(value)
        rows.append(
            (name.replace(".", ": ").replace("_", " "), text.replace("_", " "), "stated in the study or default")
        )
    rows += [
        (
            f"material of the {'sphere' if part == 'sphere' else 'bars'}",
            str(material).replace("_", " "),
            "material library",
        )
        for part, material in contents.resolved.get("materials", {}).items()
    ]
    if not rows:
        return None
    note = "Exact: the numbers that the answers are computed for."
    return Table(caption="Fixed numbers", header=("input", "value", "source"), rows=tuple(rows), note=note)


def dependence_texts(contents: Contents) -> list[str]:
    """The rank correlations in sentences."""
    texts = []
    for group in contents.resolved.get("dependence", []):
        named = [(f"{key.capitalize()} rank correlation", group.get(key)) for key in ("spearman", "kendall")]
        strength = next((f"{word} {value:g}" for word, value in named if value is not None), "dependent")
        copula = str(group["copula"]).replace("_", " ").capitalize()
        freedom = f" with {group['dof']:g} degrees of freedom" if group.get("dof") else ""
        texts.append(f"{' and '.join(input_name(n) for n in group['of'])}: {strength}, {copula} copula{freedom}.")
    return texts
