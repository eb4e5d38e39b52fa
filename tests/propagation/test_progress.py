"""Progress of a run: it moves within a stage, and never back."""

import uqsphere
from uqsphere import Study


def test_the_share_of_a_fast_black_box_moves_within_its_first_stage() -> None:
    study = Study(
        inputs={"a": {"dist": "normal", "mean": 0.0, "sd": 1.0}},
        outputs="y",
        analysis={"accuracy": {"mean": 0.1, "quantile": 0.5, "sobol": 0.5}},
    )
    shares: list[float] = []

    def progress(runs: int, share: float, text: str) -> None:
        shares.append(share)

    uqsphere.run(study, lambda x: {"y": x["a"] ** 2}, progress=progress)
    first = shares[: shares.index(max(shares))]
    assert len(set(first)) > 1
    assert first == sorted(first)
    assert max(shares) == 1.0


def test_the_line_of_a_slow_model_is_part_of_the_work() -> None:
    told: list[tuple[float, str]] = []
    study = Study(
        inputs={name: {"dist": "normal", "mean": 0.0, "sd": 1.0} for name in "ab"},
        outputs="y",
        limits={"high": {"quantity": "y", "strength": 3.0, "target": 0.1}},
        margins={"solve": "a", "between": [-5.0, 5.0]},
        analysis={"budget": {"evaluations": 100}},
    )
    uqsphere.run(
        study,
        lambda x: {"y": x["a"] + x["b"]},
        progress=lambda runs, share, text: told.append((share, text)),
    )
    before = [share for share, text in told if "design" in text or "along" in text]
    assert before == sorted(before)
    assert 0.6 <= max(before) < 0.7  # a stage that is under way moves it
    assert told[-1][0] == 1.0
