"""The table of rows: shapes, heads, continuations, rows without an answer."""

import numpy as np

from uqsphere.uq.sample import Sample, without


def _sample(rows: int, start: float = 0.0) -> Sample:
    scores = start + np.arange(2.0 * rows * 3).reshape(2, rows, 3)
    points = Sample.at(("a", "b", "c"), scores, 10.0 * scores)
    return points.with_answers(("y", "z"), np.stack([scores[..., 0], -scores[..., 1]], axis=-1))


def test_a_sample_is_read_by_name() -> None:
    sample = _sample(4)
    assert (sample.replicates, sample.count, sample.size) == (2, 4, 8)
    assert np.array_equal(sample.answer("z"), -sample.scores[..., 1])
    assert np.array_equal(sample.input("c"), 10.0 * sample.scores[..., 2])
    assert sample.knows("y")
    assert not sample.late("y").any()


def test_a_head_and_the_rows_that_continue_it_are_the_whole() -> None:
    sample = _sample(5)
    rest = _sample(3, start=100.0)
    joined = sample.head(2).join(rest)
    assert joined.count == 5
    assert np.array_equal(joined.answers[:, 2:], rest.answers)
    assert np.array_equal(joined.inputs[:, :2], sample.inputs[:, :2])


def test_replicates_keep_the_same_number_of_rows_that_have_an_answer() -> None:
    sample = _sample(4)
    failed = np.zeros((2, 4), dtype=bool)
    failed[0, 1] = True
    some = sample.with_answers(sample.quantities, sample.answers, failed=failed)
    assert np.isnan(some.outputs("y")).sum() == 1
    assert not some.knows("y")
    assert some.whole().count == 3
    assert np.array_equal(some.whole().answers[1], sample.answers[1, :3])
    assert np.array_equal(without(sample.scores, failed)[0], sample.scores[0, [0, 2, 3]])


def test_one_replicate_is_cut_into_blocks() -> None:
    sample = _sample(4)
    one = sample.head(4)
    blocks = (
        Sample.at(one.names, one.scores[:1], one.inputs[:1]).with_answers(one.quantities, one.answers[:1]).blocks(2)
    )
    assert (blocks.replicates, blocks.count) == (2, 2)
    assert np.array_equal(blocks.scores[1], sample.scores[0, 2:])
