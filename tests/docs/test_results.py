"""What a run tells is declared: the page of documentation and the schema follow from the types."""

import json
import runpy
from pathlib import Path

import jsonschema
import pytest

import uqsphere
from uqsphere import Study
from uqsphere.cli import main
from uqsphere.results.types import Kind, Results

DOCS = Path(__file__).parents[2] / "docs"


def test_the_page_on_results_is_as_the_types_say() -> None:
    page = (DOCS / "results.md").read_text(encoding="utf-8")
    made = runpy.run_path(str(DOCS / "results_page.py"))
    assert page == made["build_page"](page), "python docs/results_page.py"


def test_every_kind_of_answer_is_described() -> None:
    assert all(kind.subject and kind.meaning and kind.unit for kind in Kind)


def test_the_printed_schema_holds_for_a_run(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    limits = {"high": {"quantity": "y", "strength": 3.0, "aim": "survive", "target": 0.1}}
    inputs = {"a": {"dist": "normal", "mean": 0.0, "sd": 1.0}}
    study = Study(inputs=inputs, outputs="y", limits=limits)
    run = uqsphere.run(study, lambda x: {"y": x["a"]}, out=tmp_path)
    assert main(["schema", "results"]) == 0
    schema = json.loads(capsys.readouterr().out)
    stored = json.loads((tmp_path / "results.json").read_text(encoding="utf-8"))
    jsonschema.validate(stored, schema)
    assert Results.model_validate(stored) == run.results
    stored["answers"][0]["answer"] = "no such kind"
    with pytest.raises(jsonschema.ValidationError):
        jsonschema.validate(stored, schema)
