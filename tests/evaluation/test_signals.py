"""What Ctrl-C and the like do to a block of an experiment."""

from __future__ import annotations

import signal

import pytest

from slamcu_eval.signals import ctrl_c_held_back, ctrl_c_ignored, signals_as_exit

pytestmark = pytest.mark.usefixtures("ctrl_c")


def test_what_is_held_back_comes_at_the_end_of_the_block() -> None:
    done = []

    def work() -> None:
        with ctrl_c_held_back():
            signal.raise_signal(signal.SIGINT)
            done.append("all of it")

    with pytest.raises(KeyboardInterrupt):
        work()
    assert done == ["all of it"]
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler


def test_where_nothing_comes_nothing_is_raised() -> None:
    with ctrl_c_held_back():
        pass
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler


def test_what_is_ignored_does_not_come() -> None:
    with ctrl_c_ignored():
        signal.raise_signal(signal.SIGINT)
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGHUP])
def test_an_order_to_end_unwinds_the_stack(number: signal.Signals) -> None:
    before = signal.getsignal(number)
    with pytest.raises(SystemExit) as left, signals_as_exit():
        signal.raise_signal(number)
    assert left.value.code == 128 + number
    assert signal.getsignal(number) is before
