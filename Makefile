# Two commands matter: `make demo` and `make test`. Each does all of its own set-up, alone, on a fresh machine.
# Variables: PYTHON=python3.12 (the interpreter), PYTEST_ARGS='-k evidence', TEST_JOBS=1 (test files at a time; one per
# processor, four at most), KEEP=1 (the demo goes on serving).
SHELL := /bin/bash
.DEFAULT_GOAL := help
.PHONY: help setup demo test lint bench figures images e2e lock protobuf clean

export PYTHON
BIN := .venv/bin
TEST_JOBS ?= $(shell n=$$(nproc 2>/dev/null || echo 2); echo $$((n < 4 ? n : 4)))

help: ## Say what there is to make
	@echo "slamcu: what can be made"
	@awk -F ':.*## ' '/^[a-z0-9]+:.*## / { printf "  make %-9s %s\n", $$1, $$2 }' $(MAKEFILE_LIST)

setup: ## Install PostGIS and .venv if they are missing (the other targets do it by themselves)
	@scripts/install-postgis
	@scripts/setup-venv

demo: setup ## Drive a fleet over a changed road and show what the cloud makes of it (KEEP=1: go on serving)
	@$(BIN)/slamcu-eval demo --out demo-output

test: setup ## Run every test, the fast ones first
	@command -v curl >/dev/null || scripts/apt-install "curl, for the README's tour" curl
	@$(BIN)/python -m pytest -n $(TEST_JOBS) --dist loadfile --no-loadscope-reorder $(PYTEST_ARGS)

lint: setup ## Check style, types and the import rules
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy --strict
	$(BIN)/lint-imports

bench: setup ## Measure the filter, the ingest and the aggregation on this machine, with their curves (SCALE=full: the largest sizes)
	@OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 $(BIN)/slamcu-eval bench $(if $(SCALE),--scale $(SCALE)) $(BENCH_ARGS)

figures: setup ## Measure again what the documentation quotes: takes hours (STAGES='paper plots' does not; MRCLAM_DIR=...: recorded robots too)
	@scripts/figures $(STAGES)

images: setup ## Build the images of docker-compose.yml, and make its secrets
	@scripts/docker-engine scripts/images

e2e: setup ## Run the end-to-end test in containers (starts a Docker engine if none runs and root asks)
	@scripts/docker-engine scripts/e2e

lock: ## Write requirements.lock anew (needs uv)
	scripts/lock

protobuf: setup ## Generate the SENSORIS code from the .proto files anew
	PYTHON= scripts/generate-protobuf

clean: ## Remove .venv, caches and outputs; data directories of the server are left alone
	rm -rf .venv .mypy_cache .ruff_cache .pytest_cache .import_linter_cache .hypothesis build dist demo-output
	find . -name __pycache__ -type d -prune -exec rm -rf {} +
