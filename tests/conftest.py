"""What all tests share: where they find each other, and one thread of linear algebra."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from threadpoolctl import threadpool_limits

#: `tests.campaigns` and `tests.independent` are run as programs too, and go by their whole names
sys.path.insert(0, str(Path(__file__).parent.parent))
sys.path.insert(0, str(Path(__file__).parent))

#: processes that tests start would compile the package again
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)

#: programs, each run by a command of its own (docs/validation.md)
collect_ignore = ["campaigns", "independent"]


@pytest.fixture(scope="session", autouse=True)
def one_blas_thread() -> Iterator[None]:
    """Sums of linear algebra in one fixed order."""
    with threadpool_limits(limits=1, user_api="blas"):
        yield
