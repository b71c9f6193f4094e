# make demo   set everything up, run the main job on a built-in simulated mine, end with a table and a report page
# make test   set everything up, lint, run the core tests
# The rest is for those who work on semmap. PYTHON=python3.12 chooses the interpreter of .venv.

.PHONY: help demo test lint test-slow setup setup-dev clean
BIN := .venv/bin
OUT ?= demo

help:
	@sed -n '1,3s/^# //p' Makefile

demo: setup
	$(BIN)/semmap demo --out $(OUT)

test: lint
	$(BIN)/python -m pytest

test-slow: setup-dev
	$(BIN)/python -m pytest -n 0 -m slow

lint: setup-dev
	$(BIN)/ruff check --no-cache .
	$(BIN)/mypy
	$(BIN)/python -m pytest tests/test_import_direction.py

setup:
	@sh tools/setup.sh

setup-dev:
	@sh tools/setup.sh dev

clean:
	rm -rf .venv demo .mypy_cache .ruff_cache .pytest_cache
	find . -name __pycache__ -type d -prune -exec rm -rf {} +
