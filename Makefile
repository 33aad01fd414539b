# make demo   set up and run the main job: data set, training, true and cached FE², comparison
# make test   set up and run the tests
# make bench  set up and measure in full, on a quiet machine, into docs/measured.json; MODE=quick: less
# make accept-cache  set up and audit every answer of the cache on five bars, into docs/measured.json
# make docs   set up and build the documentation site, into out/site/index.html
# make paper  set up and reproduce the paper's figures with both presets, into out/paper

PYTHON ?= python3
BIN := .venv/bin

.PHONY: paper demo docs test test-slow lint bench accept-cache clean

demo: .venv/.installed
	$(BIN)/surrofe2 study data/bending-bar.toml --out out/demo

test: .venv/.installed
	$(BIN)/pytest -m "not slow" -n 2 --dist loadfile

test-slow: .venv/.installed
	$(BIN)/pytest -m slow -n 2 --dist loadfile

docs: .venv/.installed
	$(BIN)/python -m sphinx -q -W --keep-going -c docs . out/site

lint: .venv/.installed
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports

bench: .venv/.installed
	$(BIN)/python -m benchmarks $(if $(filter quick,$(MODE)),--quick)


accept-cache: .venv/.installed
	$(BIN)/python -m benchmarks trust || exit 1
	for preset in printed water; do \
	    $(BIN)/python -m validation worst-answer --cell $$preset --out out/bench --fresh || exit 1; \
	done

paper: .venv/.installed
	for preset in printed water; do \
	    for figure in fig5 fig6 fig8 rates; do \
	        $(BIN)/python -m validation $$figure --cell $$preset --out out/paper || exit 1; \
	    done; \
	    $(BIN)/surrofe2 moduli --preset $$preset --tables --memory out/paper --stability out/paper \
	        --out out/paper/moduli-$$preset.json || exit 1; \
	done

clean:
	rm -rf .venv out .pytest_cache .mypy_cache .ruff_cache .import_linter_cache *.egg-info
	find . -name __pycache__ -type d -prune -exec rm -rf {} +

.venv/.installed: pyproject.toml constraints.txt
	$(PYTHON) -c "import sys; sys.exit(sys.version_info < (3, 11) and 'Python 3.11 or newer is needed; name one by PYTHON=')"
	$(PYTHON) -m venv .venv
	$(BIN)/python -m pip install --quiet -c constraints.txt -e ".[dev]"
	$(BIN)/python -m pip install --quiet -c constraints.txt --no-deps \
	    micro-manager-precice precice-adapter-schema # tests stand in for preCICE, which has no wheel
	touch $@
