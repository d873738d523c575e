"""Calls in processes of their own, from whichever thread they are made."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from functools import partial

import pytest

from slamcu_eval.copies import in_copies


def squares(numbers: range) -> list[int]:
    with in_copies(2, [partial(pow, number, 2) for number in numbers]) as futures:
        return [future.result() for future in futures]


def test_another_thread_than_the_main_one_may_ask_too() -> None:
    with ThreadPoolExecutor(1) as other:
        assert other.submit(squares, range(4)).result() == [0, 1, 4, 9]


def test_what_a_call_raises_comes_back() -> None:
    with pytest.raises(ZeroDivisionError), in_copies(1, [partial(divmod, 1, 0)]) as futures:
        futures[0].result()
