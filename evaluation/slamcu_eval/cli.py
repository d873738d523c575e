"""The command `slamcu-eval`: every figure that the project quotes comes from one of its subcommands.

A subcommand is a module of `slamcu_eval.commands` with a function `register(app)` that adds itself to the Typer
application; `COMMANDS` below lists them in the order of the help text. A command raises `SlamcuError` for what its
user did wrong, and `main` turns that into one line and exit code 1.
"""

from __future__ import annotations

from importlib import import_module

import typer

from slamcu_core import program
from slamcu_core.errors import SlamcuError
from slamcu_eval.console import error_console

COMMANDS: tuple[str, ...] = (
    "slamcu_eval.commands.simulate",
    "slamcu_eval.commands.score",
    "slamcu_eval.commands.paper",
    "slamcu_eval.commands.mrclam",
    "slamcu_eval.commands.ablation",
    "slamcu_eval.commands.law",
    "slamcu_eval.commands.fleet",
    "slamcu_eval.commands.demo",
    "slamcu_eval.commands.scenario",
    "slamcu_eval.commands.bench",
    "slamcu_eval.commands.attack",
    "slamcu_eval.commands.plots",
)


def build_app() -> typer.Typer:
    """Build the Typer application with every subcommand registered."""
    app = typer.Typer(
        name="slamcu-eval",
        help="Simulate drives, run the filter and the cloud on them, and score the results.",
        no_args_is_help=True,
        add_completion=False,
        pretty_exceptions_enable=False,
        rich_markup_mode="markdown",  # which lets paragraphs flow
    )

    @app.callback()
    def _root() -> None:
        """Simulate drives, run the filter and the cloud on them, and score the results."""

    with program.ends_at_once():
        for name in COMMANDS:
            import_module(name).register(app)
    return app


def run(arguments: list[str] | None = None) -> int:
    """Run one command line and return its exit code: 0 done, 1 bad input, 2 bad usage, 130 interrupted."""
    try:
        code = build_app()(arguments, standalone_mode=False)
    except typer.TyperException as error:
        return _fail(error.format_message(), code=error.exit_code)
    except SlamcuError as error:
        return _fail(str(error), code=1)
    except OSError as error:
        return _fail(f"{error.filename or 'file'}: {error.strerror or error}", code=1)
    except (typer.Abort, KeyboardInterrupt):
        return _fail("interrupted", code=program.INTERRUPTED)
    return code if isinstance(code, int) else 0


def _fail(message: str, *, code: int) -> int:
    if message:
        error_console.print(f"slamcu-eval: {message}", markup=False, highlight=False, soft_wrap=True)
    return code


def main() -> int:
    """Run the command line of this process and return its exit code."""
    return run()
