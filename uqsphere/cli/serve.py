"""The impact model of a study behind an address, for programs that speak UM-Bridge (protocol version 1.0)."""

from __future__ import annotations

import argparse
import json
import sys
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Final

import numpy as np

from uqsphere.console import answer
from uqsphere.errors import UqsphereError, UsageError, told
from uqsphere.files import Json
from uqsphere.model import evaluate
from uqsphere.study import Study, load_study

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

    Raises
    ------
    UsageError
        For a study without inputs that scatter or of a black box, and for a port that is taken.
    """
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
