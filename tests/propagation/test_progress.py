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
