# make demo   set up and run the main job: data set, training, true and cached FE², comparison
# make test   set up and run the tests
# make bench  set up and run the benchmarks in full, on a quiet machine; MODE=quick: less of each

PYTHON ?= python3
BIN := .venv/bin

.PHONY: demo test test-slow lint bench bench-quick clean

demo: .venv/.installed
	$(BIN)/surrofe2 demo

test: .venv/.installed
	$(BIN)/pytest -m "not slow"

test-slow: .venv/.installed
	$(BIN)/pytest -m slow

lint: .venv/.installed
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports

bench: .venv/.installed
	$(BIN)/python -m benchmarks $(if $(filter quick,$(MODE)),--quick)

bench-quick: .venv/.installed
	$(BIN)/python -m benchmarks --quick

clean:
	rm -rf .venv out .pytest_cache .mypy_cache .ruff_cache .import_linter_cache *.egg-info
	find . -name __pycache__ -type d -prune -exec rm -rf {} +

.venv/.installed: pyproject.toml constraints.txt
	$(PYTHON) -c "import sys; sys.exit(sys.version_info < (3, 11) and 'Python 3.11 or newer is needed; name one by PYTHON=')"
	$(PYTHON) -m venv .venv
	$(BIN)/python -m pip install --quiet -c constraints.txt -e ".[dev]"
	touch $@
