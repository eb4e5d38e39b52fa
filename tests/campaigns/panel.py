"""Random settings of the what-if panel against full runs: every value within its printed interval, and the run's.

    python -m tests.campaigns.panel --study studies/granite.toml --settings 50

The page's own script answers, by node; each setting is then run as the panel's command would have it.
"""

from __future__ import annotations

import json
import shutil
import subprocess
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from importlib import resources
from pathlib import Path
from typing import Any, Final

import numpy as np

import uqsphere
from tests.campaigns import options, table, tell
from uqsphere.report.contents import read_contents
from uqsphere.report.whatif import panels
from uqsphere.results.entries import Est
from uqsphere.study import Study

NODE: Final = shutil.which("node") or ""
_ASK: Final = """
const { makeModel } = require(process.argv[1]), fs = require("fs");
const { data, settings } = JSON.parse(fs.readFileSync(0, "utf8"));
const model = makeModel(data), limit = data.limits[0];
console.log(JSON.stringify(settings.map(one => {
  const setting = model.start();
  Object.assign(setting.limits[limit.name], one.strength);
  Object.assign(setting.at, one.at);
  const found = model.answer(limit, setting);
  return found && { value: found.value, low: found.low, high: found.high, kind: found.kind,
    verdict: model.verdict(limit, setting, found).word };
})));
"""


@dataclass(frozen=True, kw_only=True)
class Setting:
    """What is moved: of the strength `mean` (SI), `scatter` and `spearman`; `at`: numbers of the scene by path (SI)."""

    strength: Mapping[str, float]
    at: Mapping[str, float]


def ask(data: Mapping[str, Any], settings: Sequence[Setting]) -> list[dict[str, Any] | None]:
    """What the panel's script answers for its first limit; None where it has no answer."""
    script = str(resources.files("uqsphere.report").joinpath("whatif.js"))
    given = {"data": data, "settings": [{"strength": one.strength, "at": one.at} for one in settings]}
    command = [NODE, "-e", _ASK, script]
    done = subprocess.run(command, input=json.dumps(given), capture_output=True, text=True, check=True, timeout=300)
    found: list[dict[str, Any] | None] = json.loads(done.stdout)
    return found


def panel_of(folder: Path) -> dict[str, Any]:
    """The data of the first panel of a folder."""
    first = panels(read_contents(folder))[0]
    if not first.data:
        raise SystemExit(f"no panel: {first.reason}")
    data: dict[str, Any] = json.loads(first.data)
    return data


def random_settings(data: Mapping[str, Any], count: int, seed: int) -> list[Setting]:
    """Settings that move one to four things at once, anywhere that the panel covers."""
    rng, limit, found = np.random.default_rng(seed), data["limits"][0], []
    for _ in range(count):
        strength: dict[str, float] = {}
        at: dict[str, float] = {}
        choices = [
            "mean",
            "scatter",
            *(["spearman"] if limit["tie"] else []),
            *(one["path"] for one in data["sliders"]),
        ]
        for name in rng.choice(choices, size=int(rng.integers(1, 5)), replace=False):
            if name == "mean":
                strength["mean"] = limit["mean"] * float(np.exp(rng.uniform(-0.3, 0.3)))
            elif name == "scatter":
                strength["scatter"] = limit["law"]["m"] * float(np.exp(rng.uniform(-0.4, 0.4)))
            elif name == "spearman":
                strength["spearman"] = float(rng.uniform(-0.5, 0.9))
            else:
                one = next(s for s in data["sliders"] if s["path"] == name)
                at[one["path"]] = one["low"] * (one["high"] / one["low"]) ** float(rng.uniform())
        found.append(Setting(strength=strength, at=at))
    return found


def full_run(study: Path, setting: Setting, data: Mapping[str, Any], place: Path, evaluations: int) -> Est:
    """The probability of a miss by a run of the study with the setting in its file."""
    limit = data["limits"][0]
    key = f"limits.{limit['name']}.strength"
    overrides = []
    for one in data["sliders"]:
        if one["path"] in setting.at:
            keys = {one["set"]: 1.0, **{f"{one['key']}.{key}": ratio for key, ratio in one["cut"].items()}}
            value = setting.at[one["path"]] * one["factor"]
            overrides += [f'{key}="{ratio * value!r} {one["file_unit"]}"' for key, ratio in keys.items()]
    if "mean" in setting.strength:
        overrides.append(f'{key}.mean="{setting.strength["mean"] * limit["factor"]!r} {limit["file_unit"]}"')
    if "scatter" in setting.strength:
        overrides.append(f"{key}.modulus={setting.strength['scatter']!r}")
    found = _brief(uqsphere.load_study(study, tuple(overrides)), evaluations)
    if "spearman" in setting.strength:
        groups = tuple(replace(group, spearman=setting.strength["spearman"]) for group in found.dependence)
        found = replace(found, dependence=groups)
    return uqsphere.run(found, out=place, fresh=True).results.limits[limit["name"]].miss


def _brief(study: Study, evaluations: int) -> Study:
    """The study without margins, ways and the moment of fracture, for so many evaluations."""
    budget = replace(study.analysis.budget, evaluations=evaluations)
    limits = tuple(replace(limit, fracture=False) for limit in study.limits)
    analysis = replace(study.analysis, budget=budget, ways="given")
    return replace(study, margins=None, limits=limits, analysis=analysis)


def agrees(found: Mapping[str, Any], known: Est) -> bool:
    """Whether the printed interval holds the run's value, or meets its interval."""
    return bool(found["low"] <= known.high and known.low <= found["high"])


def compare(
    study: Path, data: Mapping[str, Any], settings: Sequence[Setting], place: Path, evaluations: int
) -> list[tuple[Setting, dict[str, Any], Est]]:
    """Every setting with the panel's answer and the run's."""
    rows = []
    for k, (one, found) in enumerate(zip(settings, ask(data, settings), strict=True)):
        assert found is not None
        rows.append((one, found, full_run(study, one, data, place / f"run{k}", evaluations)))
        told = "held" if agrees(found, rows[-1][2]) else "NOT HELD"
        tell(f"{k + 1}/{len(settings)} {one.strength} {one.at} {found} {rows[-1][2].value:.6g} {told}")
        shutil.rmtree(place / f"run{k}", ignore_errors=True)
    return rows


def main() -> None:
    given = options(__doc__, study=Path("studies/granite.toml"), folder=Path, settings=50, evaluations=20_000, seed=1)
    with tempfile.TemporaryDirectory() as temporary:
        place = Path(temporary)
        folder = given.folder or uqsphere.run(uqsphere.load_study(given.study), out=place / "study").folder
        data = panel_of(folder)
        rows = compare(given.study, data, random_settings(data, given.settings, given.seed), place, given.evaluations)
    shown = []
    for kind in ("exact", "estimate"):
        own = [(found, known) for _, found, known in rows if found["kind"] == kind]
        off = [abs(f["value"] / k.number - 1.0) for f, k in own if k.number > 0.0]
        wide = [(f["high"] - f["low"]) / (2.0 * f["value"]) for f, _ in own if f["value"] > 0.0]
        held = sum(agrees(f, k) for f, k in own)
        shown.append(
            (kind, len(own), held, f"{np.median(off):.2%}" if off else "", f"{np.median(wide):.2%}" if wide else "")
        )
    print(table(("kind", "settings", "held", "median difference", "median half-width"), shown))


if __name__ == "__main__":
    main()
