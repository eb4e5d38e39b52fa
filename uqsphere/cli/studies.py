"""What each command does that begins with a study and runs nothing but scenes: new, check, history, schema, serve."""

from __future__ import annotations

import argparse
import contextlib
import json
import math
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Final

import numpy as np

from uqsphere.console import answer, plain, print_document, say, screen_width, table, wrap
from uqsphere.errors import AccessError, UqsphereError, UsageError, told
from uqsphere.files import Json
from uqsphere.quantities import OUTPUTS, format_value, lookup, reading_units
from uqsphere.study import Study, json_schema, load_study, shipped_studies
from uqsphere.units import UnitError, parse_value

if TYPE_CHECKING:
    from http.server import ThreadingHTTPServer

    from uqsphere.runner.forecast import Plan


#: characters of a source that are shown
_LONGEST: Final = 60


def number_of(text: str, dimension: str, option: str, *, unit: str = "", above: float | None = None) -> float:
    """The value of an option in SI; a bare number has the `unit`.

    Raises UsageError where it is none of that dimension, or not above a number.
    """
    bare = False
    with contextlib.suppress(ValueError):
        bare = bool(unit) and math.isfinite(float(text))
    try:
        value = parse_value(f"{text.strip()} {unit}" if bare else text.strip(), dimension)
    except UnitError as error:
        raise UsageError(f"{option}: {error}") from None
    if above is not None and not value > above:
        raise UsageError(f"{option} must be above {above:g}, found {text}")
    return value


def study_of(chosen: argparse.Namespace) -> Study:
    """The study of a command, once said what a user should know of it, and of its services what was not said yet."""
    study = load_study(chosen.study, chosen.overrides)
    for text in study.warnings:
        say(f"warning: {text}")
    said = set(study.warnings)
    for name, service in study.services.items():
        for text in service.warnings:
            if text not in said:
                say(f"warning: service {plain(name)}: {text}")
        said |= set(service.warnings)
    return study


def command_new(chosen: argparse.Namespace) -> int:
    """Write a shipped study to a new file."""
    found = shipped_studies()
    if chosen.template not in found:
        raise UsageError(f"unknown template {chosen.template!r} (allowed: {', '.join(found)})")
    place = chosen.output or Path(f"{chosen.template}.toml")
    _write_new(place, found[chosen.template])
    written, said = [str(place)], [f"wrote {place}; next: uqsphere check {place}"]
    study = found[chosen.template]
    # a study may have a model of its own, and tests of its own
    for source in (study.with_suffix(".py"), *sorted(study.parent.glob(f"{study.stem}_*.csv"))):
        target = place.parent / source.name
        if source.is_file() and not target.exists():
            _write_new(target, source)
            written.append(str(target))
            said.append(f"wrote {target}, {'its model' if target.suffix == '.py' else 'its data'}")
    return answer(chosen, {"written": written}, "\n".join(said))


def _write_new(path: Path, source: Path) -> None:
    """Copy `source` to a file that must not exist yet; nothing is left behind where that fails."""
    try:
        text = source.read_text(encoding="utf-8")
        with open(path, "x", encoding="utf-8") as file:
            try:
                file.write(text)
                file.flush()
            except OSError:
                path.unlink(missing_ok=True)
                raise
    except FileExistsError as error:
        raise UsageError(f"{path} exists already: choose another name") from error
    except OSError as error:
        raise AccessError(f"{path}: {error.strerror}") from error


def command_check(chosen: argparse.Namespace) -> int:
    """Validate a study; print the resolved scene and what a run will cost, and the same of its services."""
    from uqsphere.model import check_quantities, check_range
    from uqsphere.runner.forecast import plan_run

    study = study_of(chosen)
    for part in study.parts.values():
        check_range(part)
        check_quantities(part)
    plan = plan_run(study)
    plans = plan.pop("services", {})
    services = {name: {**own.resolved(), "hash": own.hash, "plan": plans[name]} for name, own in study.services.items()}
    document = {**study.resolved(), "hash": study.hash, "plan": plan, **({"services": services} if services else {})}
    texts = [wrap(f"{study.title}: the study is valid", screen_width())]
    for name, part in study.parts.items() if not chosen.json else ():
        texts += [f"\nservice {plain(name)}"] * bool(name) + [_part_text(part, plans[name] if name else plan)]
    return answer(chosen, document, "\n".join(texts))


def _part_text(study: Study, plan: Plan) -> str:
    """The numbers of one rig, and its plan."""
    from uqsphere.runner.forecast import plan_text

    width, rows = screen_width(), []
    for name, value in study.at_means().items():
        law = study.random.get(name)
        text = format_value(value, name) if not study.black_box else f"{value:.6g}"
        source = study.sources[name].text if name in study.sources else "study"
        short = source if len(source) <= _LONGEST else f"{source[: _LONGEST - 1].rstrip()}…"
        rows.append((name, text, law.family.name if law else "fixed", short))
    scene = [] if plan["scene"] is None else _scene_lines(study, plan["scene"])
    lines = "\n".join(wrap(line, width) for line in [*scene, *plan_text(study, plan).split("\n")])
    return "\n" + table(("number", "mean", "law", "source"), rows, width) + "\n\n" + lines


def _scene_lines(study: Study, numbers: Mapping[str, float | None]) -> list[str]:
    """What loads the sphere, with the similarity numbers at the means."""
    if study.rig == "bars":
        bars = "infinite" if study.options["bars.infinite"] else "finite"
        theta = f"{numbers['theta']:.4g}" if numbers["theta"] is not None else "infinite"
        text = f"mu = {numbers['mu']:.4g} (mass of the sphere), theta = {theta} (length of the pulse); at the means"
        return [f"pulse: {study.options['pulse.shape']}; bars: {bars}", text]
    words = [f"{name.partition('.')[0]}: {word}" for name, word in study.options.items() if name.endswith(".kind")]
    speed = numbers["speed"]
    closing = "" if speed is None else f"; the bodies close at {format_value(speed, 'rig.speed')} square to the face"
    return [f"{'; '.join(words)}{closing}"]


def command_history(chosen: argparse.Namespace) -> int:
    """One deterministic scene over time."""
    from uqsphere.report.figures.history import units_of_history, write_history
    from uqsphere.runner.deterministic import history_of, history_summary

    study = study_of(chosen)
    if study.black_box:
        raise UsageError("history shows an impact scene; this study is a black box")
    if study.rig == "none":
        raise UsageError("history shows the study's own rig, and this study has none but its services")
    trace = history_of(study)
    with reading_units(units_of_history(trace)):
        summary = history_summary(trace)
    if chosen.out is not None:
        summary["written"] = [str(path) for path in write_history(trace, chosen.out)]
    rows = [(lookup(name).meaning if name in OUTPUTS else name, text) for name, text in summary["lines"]]
    text = f"{plain(study.title)}: one scene, every number at its mean\n\n{table(('what', 'value'), rows)}"
    return answer(chosen, summary, text, summary.get("written", ()))


def command_schema(chosen: argparse.Namespace) -> int:
    """Print the JSON schema of study files."""
    print_document(json_schema())
    return 0


# --- the impact model behind an address ---------------------------------------------------------------------


#: the one model that is served
NAME: Final = "impact"
#: bytes of a request; a row of all numbers of a scene has some thousands
_LARGEST: Final = 1 << 20


class _Refused(Exception):
    """A request without an answer: what kind of fault, as the protocol names it, and what is wrong."""

    def __init__(self, kind: str, message: str) -> None:
        super().__init__(message)
        self.kind = kind


def command_serve(chosen: argparse.Namespace) -> int:
    """Serve the impact model of a study until it is interrupted."""
    study = load_study(chosen.study, chosen.overrides)
    with server_of(study, chosen.port) as server:
        address = f"http://localhost:{server.server_address[1]}"
        inputs, outputs = [*inputs_of(study)], [*study.analysis.quantities]
        answer(chosen, {"model": NAME, "server": address, "inputs": inputs, "outputs": outputs},
               f"model {NAME!r} at {address}: {', '.join(inputs)} give {', '.join(outputs)}")  # fmt: skip
        print("end it with Ctrl-C", file=sys.stderr, flush=True)
        server.serve_forever()
    return 0


def inputs_of(study: Study) -> tuple[str, ...]:
    """The inputs of the served model in their order: what scatters in the study."""
    return tuple(study.random)


def server_of(study: Study, port: int) -> ThreadingHTTPServer:
    """A server on this machine alone; `port` 0 takes one that is free.

    One vector of inputs (SI, order of `inputs_of`) gives one vector of outputs (SI, order of the study's
    `analysis.quantities`); a request's config may have `fidelity` and `tolerance`.

    Raises UsageError for a study without inputs that scatter or of a black box, and for a port that is taken.
    """
    from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer

    if study.black_box or not study.random or not study.analysis.quantities:
        raise UsageError("a study of the impact model with inputs that scatter and analysis.quantities is due")

    class Handler(BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            self._answer(*_answered("GET", self.path, b"", study))

        def do_POST(self) -> None:
            length = min(int(self.headers.get("Content-Length") or 0), _LARGEST)
            self._answer(*_answered("POST", self.path, self.rfile.read(length), study))

        def _answer(self, code: int, document: Json) -> None:
            body = json.dumps(document).encode()
            self.send_response(code)
            self.send_header("Content-Type", "application/json")
            self.send_header("Content-Length", str(len(body)))
            self.end_headers()
            self.wfile.write(body)

        def log_message(self, *args: object) -> None:
            pass

    try:
        return ThreadingHTTPServer(("localhost", port), Handler)
    except (OSError, OverflowError) as error:
        raise UsageError(f"port {port} cannot be had: {told(error)}") from error


def _answered(method: str, path: str, body: bytes, study: Study) -> tuple[int, Json]:
    """Code and document of one request."""
    try:
        if (method, path) == ("GET", "/Info"):
            return 200, {"protocolVersion": 1.0, "models": [NAME]}
        asked = json.loads(body)
        if asked["name"] != NAME:
            raise _Refused("ModelNotFound", f"there is no model {told(asked['name'], 60)!r}, but {NAME!r}")
        if path == "/ModelInfo":
            kinds = ("Gradient", "ApplyJacobian", "ApplyHessian")
            return 200, {"support": {"Evaluate": True, **dict.fromkeys(kinds, False)}}
        if path == "/InputSizes":
            return 200, {"inputSizes": [len(inputs_of(study))]}
        if path == "/OutputSizes":
            return 200, {"outputSizes": [len(study.analysis.quantities)]}
        if path != "/Evaluate":
            raise _Refused("UnsupportedFeature", f"there is no {told(path, 60)}")
        return 200, {"output": [_evaluated(study, asked["input"], asked.get("config") or {})]}
    except _Refused as error:
        return 400, {"error": {"type": error.kind, "message": str(error)}}
    except (ValueError, LookupError, TypeError, AttributeError, UqsphereError) as error:
        return 400, {"error": {"type": "InvalidInput", "message": told(error)}}


def _evaluated(study: Study, given: list[list[float]], config: Json) -> list[float]:
    """The outputs of one vector of inputs."""
    from uqsphere.model import evaluate

    names, outputs = inputs_of(study), study.analysis.quantities
    vector = np.asarray(given, dtype=float)
    if vector.shape != (1, len(names)):
        raise _Refused("InvalidInput", f"one vector of {len(names)} numbers is due: {', '.join(names)}")
    row = dict(zip(names, vector.T, strict=True))
    found = evaluate(study, row, outputs, str(config.get("fidelity", "full")), float(config.get("tolerance", 1e-8)))
    values = [float(found[name].iloc[0]) for name in outputs]
    if not np.isfinite(values).all():
        raise _Refused("InvalidOutput", f"no answer for this row (status {int(found['status'].iloc[0])})")
    return values
