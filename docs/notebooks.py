"""Executes the notebooks and keeps what their cells print and draw: python docs/notebooks.py"""

import base64
import contextlib
import io
import json
import os
from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt

HERE = Path(__file__).parent


def outputs_of(source: str, names: dict[str, object]) -> list[dict[str, object]]:
    """What a cell prints, and its figures."""
    with contextlib.redirect_stdout(io.StringIO()) as printed:
        exec(source, names)
    outputs: list[dict[str, object]] = []
    if printed.getvalue():
        text = printed.getvalue().splitlines(keepends=True)
        outputs.append({"name": "stdout", "output_type": "stream", "text": text})
    for number in plt.get_fignums():
        image = io.BytesIO()
        plt.figure(number).savefig(image, format="png", dpi=72, metadata={"Software": None})
        data = {"image/png": base64.b64encode(image.getvalue()).decode()}
        outputs.append({"data": data, "metadata": {}, "output_type": "display_data"})
    plt.close("all")
    return outputs


def main() -> None:
    os.chdir(HERE.parent)
    for path in sorted(HERE.glob("*.ipynb")):
        notebook, names = json.loads(path.read_text("utf-8")), dict[str, object]()
        for cell in notebook["cells"]:
            if cell["cell_type"] == "code":
                cell["outputs"] = outputs_of("".join(cell["source"]), names)
        path.write_text(json.dumps(notebook, indent=1, ensure_ascii=False) + "\n", "utf-8")


if __name__ == "__main__":
    main()
