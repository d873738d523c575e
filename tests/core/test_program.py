"""How Ctrl-C ends a program, and where it is left as it was."""

from __future__ import annotations

import signal
import subprocess
import sys
import threading
from pathlib import Path

import pytest

from slamcu_core import program

pytestmark = pytest.mark.usefixtures("ctrl_c")


def module(folder: Path, name: str, text: str) -> str:
    (folder / f"{name}.py").write_text(text)
    return name


@pytest.mark.parametrize(("body", "code"), [("pass", 0), ("return 3", 3), ("raise KeyboardInterrupt", 130)])
def test_the_exit_code_is_that_of_the_program_or_says_that_it_was_interrupted(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, body: str, code: int
) -> None:
    monkeypatch.syspath_prepend(tmp_path)
    assert program.run(module(tmp_path, f"ends_with_{code}", f"def main():\n    {body}\n")) == code


@pytest.mark.parametrize("swallows", ["KeyboardInterrupt", "BaseException"])
def test_no_import_can_swallow_ctrl_c(tmp_path: Path, swallows: str) -> None:
    raises = "signal.raise_signal(signal.SIGINT)"
    module(tmp_path, "greedy", f"import signal\ntry:\n    {raises}\nexcept {swallows}:\n    pass\nmain = print\n")
    code = "import sys; from slamcu_core import program; sys.exit(program.run('greedy'))"
    done = subprocess.run([sys.executable, "-c", code], cwd=tmp_path, capture_output=True, check=False)
    assert (done.returncode, done.stdout, done.stderr) == (130, b"", b"")


def test_after_the_block_it_is_raised_as_before_also_after_one_within_another() -> None:
    with program.ends_at_once():
        ending = signal.getsignal(signal.SIGINT)
        assert ending is not signal.default_int_handler
        with program.ends_at_once():
            pass
        assert signal.getsignal(signal.SIGINT) is ending
    with pytest.raises(KeyboardInterrupt):
        signal.raise_signal(signal.SIGINT)


def test_who_ignores_it_goes_on_ignoring_it() -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    with program.ends_at_once():
        assert signal.getsignal(signal.SIGINT) is signal.SIG_IGN
    assert signal.getsignal(signal.SIGINT) is signal.SIG_IGN


def test_in_another_thread_it_is_left_as_it_is() -> None:
    seen: list[object] = []

    def work() -> None:
        with program.ends_at_once():
            seen.append(signal.getsignal(signal.SIGINT))

    thread = threading.Thread(target=work)
    thread.start()
    thread.join()
    assert seen == [signal.default_int_handler]
