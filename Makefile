# Two commands matter: `make demo` and `make test`. Each does all of its own set-up.
