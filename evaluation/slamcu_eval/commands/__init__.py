"""The subcommands of `slamcu-eval`, one module each, with a function `register(app)`."""
