"""Hostile and unlucky surroundings of a run, one table: what happens, exit code, what is said,
which files are left.
"""

from __future__ import annotations

import os
import random
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

import uqsphere
from uqsphere.cli import main
from uqsphere.mechanics.integrator import compiled

WHOLE = {
    "SHA256SUMS",
    "answers.csv",
    "cache.sqlite",
    "figures",
    "log.txt",
    "report.html",
    "results.json",
    "samples.csv",
    "study.toml",
}
STUDY = """
title = "%s"
seed = 1
[inputs]
%s
[outputs]
names = ["y"]
[limits.high]
quantity = "y"
strength = 6.0
target = 0.1
"""
BOX = """
import os, time
def f(x):
    time.sleep(float(os.environ.get("SLOW", 0)) * len(x["a"]))
    return {"y": %s}
"""
NORMAL = '%s = { dist = "normal", mean = 0.0, sd = 1.0 }\n'
UQ = "$PY -m uqsphere"
CHECK = f"{UQ} check s.toml"
RUN = f"{UQ} run s.toml --model box.py:f"
#: the results of that, from the one run that all cases share
DONE = "cp -r $DONE/s-results ."

#: what is done in a folder with the study and its model, exit code, what is said, files of the
#: results
CASES: dict[str, tuple[str, int, str, set[str] | None]] = {
    # the terminal and the language
    "LC_ALL=C": (f"LC_ALL=C PYTHONUTF8=0 PYTHONCOERCECLOCALE=0 {RUN}", 0, r"Gr\?\?e", WHOLE),
    "tr_TR": (f"LC_ALL=tr_TR.ISO-8859-9 {RUN}", 0, r"Probability.*\d\.\d+ %", WHOLE),
    "dumb, 20 columns": (f"TERM=dumb COLUMNS=20 {RUN}", 0, "(?m)^Probability of$", WHOLE),
    "a pipe that closes": (f"{RUN} | head -c 10", 0, "", WHOLE),
    "all streams closed": (f"{RUN} >&- 2>&- <&-", 0, "", WHOLE),
    "a full terminal": (f"{RUN} > /dev/full", 6, "No space left", WHOLE),
    # the interpreter and the machine
    "-O -W error": (f"$PY -O -W error {RUN[4:]}", 0, "probability", WHOLE),
    "2 GB, one core, 40 files": (
        f"ulimit -v 2000000 -n 40; taskset -c 0 {RUN}",
        0,
        "probability",
        WHOLE,
    ),
    # files
    "a full disk": (f"ulimit -f 4; {RUN}", 6, "disk I/O error", {"cache.sqlite", "log.txt"}),
    "a full disk later": (
        f"{DONE}; ulimit -f 4; {RUN} && exit 1; {UQ} verify s-results",
        0,
        "all checksums match",
        WHOLE,
    ),
    "no place": (f"{RUN} --out /proc/x", 6, "/proc/x", None),
    "a file in its place": (f"{RUN} --out box.py", 5, "is not a directory", None),
    "files of another": (
        f"mkdir s-results; touch s-results/thesis; {RUN}",
        5,
        "'thesis', which uqsphere did not write",
        {"thesis"},
    ),
    "two at once": (
        f"SLOW=0.02 {RUN} >/dev/null 2>&1 & until test -e s-results/cache.sqlite; do sleep 0.1; "
        "done; "
        f"{RUN}; code=$?; kill $!; exit $code",
        5,
        "in use by another run",
        None,
    ),
    "killed, and again": (
        f"SLOW=0.001 {RUN} & for k in $(seq 400); do sleep 0.1; test $(cat s-results/cache* | wc "
        "-c) -gt 60000 && "
        f"break; done; kill -9 $!; wait; {RUN} --json | grep reused",
        0,
        '"reused": [1-9]',
        WHOLE,
    ),
    "moved and copied": (
        f"{DONE}; mv s-results m; cp -r m s-results; {UQ} report m && {UQ} verify m --again "
        "--model box.py:f && "
        f"{UQ} compare m s-results",
        0,
        "(?s)answers are the same.*no answer changed",
        WHOLE,
    ),
    "a log that is a link": (
        f"mkdir s-results; echo mine > t; ln -s ../t s-results/log.txt; {RUN}; wc -l t",
        0,
        "(?m)^1 t$",
        WHOLE,
    ),
    "a log that is a pipe": (
        f"mkdir s-results; mkfifo s-results/log.txt; {RUN}",
        0,
        "probability",
        WHOLE,
    ),
    "a link to elsewhere": (
        (
            f"mkdir t; {DONE}; rm -r s-results/figures; ln -s ../t s-results/figures; {UQ} report "
            "s-results"
        ),
        5,
        "is a link, which is not followed",
        WHOLE,
    ),
    **{
        f"results {name}": (
            f"{DONE}; cd s-results; {damage}; cd ..; {UQ} report s-results; {RUN}",
            5,
            f"(?s){says}.*{says}.*--fresh",
            WHOLE,
        )
        for name, damage, says in (
            ("truncated", "truncate -s 500 results.json", "not as it was written"),
            ("changed", "sed -i s/value/valve/ results.json", "not as it was written"),
            (
                "of another version",
                'sed -i s/version.:.4/version\\":1/ results.json; '
                "sha256sum results.json > SHA256SUMS",
                "of another version",
            ),
        )
    },
    "a cache that is none": (
        f"mkdir s-results; echo x > s-results/cache.sqlite; {RUN}",
        6,
        "not a database.*--fresh",
        {"cache.sqlite", "log.txt"},
    ),
    # the study
    "CRLF and a mark": (
        r"sed -i '1s/^/\xef\xbb\xbf/;s/$/\r/' s.toml; " + CHECK,
        0,
        "Größe µ: .* valid",
        None,
    ),
    "UTF-16": (f"iconv -t UTF-16 s.toml > t; mv t s.toml; {RUN}", 2, "as UTF-8", None),
    "a megabyte": (
        f"(printf '# '; head -c 1000000 /dev/zero | tr '\\0' x) >> s.toml; {CHECK}",
        0,
        "is valid",
        None,
    ),
    "an escape": (
        rf"sed -i 's/^title.*/title = \"\\u001b[31m\"/' s.toml; {CHECK}",
        0,
        r"\?\[31m: .* valid",
        None,
    ),
}


def shell(place: Path, command: str, study: str, done: Path | None = None) -> tuple[int, str]:
    (place / "s.toml").write_text(study, encoding="utf-8")
    (place / "box.py").write_text(BOX % "3 * x['a'] + 0 * x['b']")
    # no bytecode: under a limit of a file's size it would be cut off, and stay so
    env = {
        **os.environ,
        "PY": sys.executable,
        "PYTHONPATH": os.getcwd(),
        "DONE": str(done),
        "PYTHONDONTWRITEBYTECODE": "x",
    }
    told = subprocess.run(
        ["bash", "-c", command], cwd=place, env=env, capture_output=True, timeout=300, check=False
    )
    return told.returncode, (told.stdout + told.stderr).decode()


@pytest.fixture(scope="module")
def finished(tmp_path_factory: pytest.TempPathFactory) -> Path:
    place = tmp_path_factory.mktemp("finished")
    ended, text = shell(place, RUN, STUDY % ("Größe µ", NORMAL % "a" + NORMAL % "b"))
    assert ended == 0, text
    assert "Größe µ" in text
    assert {path.name for path in (place / "s-results").iterdir()} == WHOLE
    return place


#: an interpreter that compiles every file anew
SLOW = {
    "-O -W error",
    "tr_TR",
    "dumb, 20 columns",
    "a full terminal",
    "a log that is a link",
    "a log that is a pipe",
    "a full disk later",
    "two at once",
    "moved and copied",
}


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=[pytest.mark.slow] * (name in SLOW)) for name in CASES]
)
def test_surroundings(tmp_path: Path, name: str, finished: Path) -> None:
    command, code, says, files = CASES[name]
    ended, text = shell(
        tmp_path, command, STUDY % ("Größe µ", NORMAL % "a" + NORMAL % "b"), done=finished
    )
    assert ended == code, text
    assert re.search(says, text), text
    assert not re.search("Traceback|internal error", text)
    if files is not None:
        assert {path.name for path in (tmp_path / "s-results").iterdir()} == files


@pytest.mark.filterwarnings("ignore::RuntimeWarning")  # sums of numbers near the largest overflow
@pytest.mark.parametrize(
    ("count", "limits", "answer", "code", "says"),
    [
        (90, 1, "sum(x.values())", 3, "not met"),
        (1001, 1, "x['a']", 2, "at most 1000"),
        (2, 201, "x['a']", 2, "at most 200"),
        (2, 1, "1e308 + 0 * x['a']", 4, r"y = 1e\+308, too large"),
        (2, 1, "1e308 * x['a']", 4, r"y = -?\d.*, too large"),
        (2, 1, "1e76 * x['a']", 4, r"y = -?\d.*e\+7\d, too large"),
        (2, 1, "1e-300 * x['a']", 2, r"y is at most [34]\S*e-300 in \d+ rows, too small"),
        (2, 1, "5e-324 + 0 * x['a']", 0, "e-324"),
        (2, 1, "-0.0 * x['a']", 0, "below"),
        (2, 1, "x['a'] > 0", 0, "below"),
        (2, 1, "[10**400 for _ in x['a']]", 4, "not an array of numbers"),
    ],
)
def test_many_and_extreme_numbers(
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    count: int,
    limits: int,
    answer: str,
    code: int,
    says: str,
) -> None:
    names = ["a", "b", *(f"x{k}" for k in range(count - 2))]
    study = STUDY % ("x", "".join(NORMAL % name for name in names))
    study += "".join(f'[limits.l{k}]\nquantity = "y"\nstrength = 9.0\n' for k in range(limits - 1))
    (tmp_path / "s.toml").write_text(study, encoding="utf-8")
    (tmp_path / "box.py").write_text(BOX % answer)
    model = ["--model", str(tmp_path / "box.py:f"), "--set", "analysis.budget.evaluations=4200"]
    ended = main(["run", str(tmp_path / "s.toml"), "--out", str(tmp_path / "out"), *model])
    text = "".join(capsys.readouterr())
    assert ended == code, text
    assert re.search(says, text), text
    assert "internal error" not in text


def test_texts_stay_texts_on_the_page(tmp_path: Path) -> None:
    """Markup, a formula and Hebrew in a title; the page escapes them, and answers.csv has no cell
    that is a formula.
    """
    title = "<script>console.log(1)</script><img src=x onerror=alert(2)> =1+1 שלום"
    code, text = shell(tmp_path, RUN, STUDY % (title, NORMAL % "a" + NORMAL % "b"))
    assert code == 0, text
    page = (tmp_path / "s-results" / "report.html").read_text(encoding="utf-8")
    assert "&lt;script&gt;console.log(1)" in page
    assert "<img src=x" not in page
    assert "שלום" in page
    for name in ("answers.csv", "samples.csv"):
        cells = (
            (tmp_path / "s-results" / name)
            .read_text(encoding="utf-8")
            .replace("\n", ",")
            .split(",")
        )
        assert not [cell for cell in cells if re.match(r"[=@+]|-[^\d.]", cell)]


# --- compiled code --------------------------------------------------------------------------------


def double(x: float) -> float:
    return 2.0 * x


@pytest.mark.parametrize("damage", ["truncated", "flipped", "foreign", "a folder"])
def test_a_damaged_file_of_compiled_code_is_compiled_anew(
    tmp_path: Path, damage: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(compiled, "cache_folder", lambda: tmp_path)
    made: Any = compiled.compiled(entry=True)
    assert made(double)(2.0) == 4.0
    (file,) = tmp_path.glob("*.nbc")
    content = bytearray(file.read_bytes())
    content[random.Random(1).randrange(len(content))] ^= 4
    file.unlink()
    if damage == "a folder":
        file.mkdir()
    else:
        file.write_bytes({"truncated": content[:99], "flipped": content, "foreign": b"x"}[damage])
    again = made(double)
    assert again(2.0) == 4.0
    assert sum(again.stats.cache_hits.values()) == 0
    assert sum(made(double).stats.cache_hits.values()) == 0
    fresh = made(double)
    assert fresh(2.0) == 4.0
    assert sum(fresh.stats.cache_hits.values()) == (damage != "a folder")


def test_the_cache_of_other_functions_stays_where_it_was() -> None:
    import numba

    before = numba.config.CACHE_DIR
    compiled.compiled(entry=True)(double)
    assert before == numba.config.CACHE_DIR
    assert "uqsphere" not in before


def test_no_folder_for_compiled_code_is_no_fault(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("NUMBA_CACHE_DIR", "/proc/nowhere")
    assert compiled.cache_folder() is None
    made: Any = compiled.compiled(entry=True)
    assert made(double)(2.0) == 4.0


def test_many_runs_in_one_process_leave_nothing(tmp_path: Path) -> None:
    """No sample, file or process is left of runs that are over."""
    import gc

    from uqsphere.uq import Sample

    study = uqsphere.load_study(text=STUDY % ("x", NORMAL % "a" + NORMAL % "b"))

    def left() -> tuple[int, int, int]:
        uqsphere.run(
            study, lambda x: {"y": 3.0 * x["a"]}, out=tmp_path / "r", fresh=True, threads=1
        )
        gc.collect()
        samples = sum(type(one) is Sample for one in gc.get_objects())
        children = sum(
            len(path.read_text().split()) for path in Path("/proc/self/task").glob("*/children")
        )
        return samples, len(os.listdir("/proc/self/fd")), children

    left()
    before = left()
    assert [left() for _ in range(2)] == [before] * 2
    assert before[0] == 0
