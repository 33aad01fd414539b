# Each target first sets up .venv with pinned versions: demo and paper the package alone, the others
# also what tests, documentation and benchmarks need.
#
# make demo          the main job: data set, training, full and cached FE², comparison, in out/demo
# make test          the quick tests
# make test-slow     the slow tests; test-nightly: those that take longest
# make lint          ruff, mypy, contract of imports
# make docs          the documentation site, out/site/index.html
# make bench         measure in full, on a quiet machine, into docs/measured.json; MODE=quick: less
# make accept-cache  audit every answer of the cache on five bars, into docs/measured.json
# make paper         reproduce the paper's figures with both presets, into out/paper

PYTHON ?= python3
BIN := .venv/bin

.PHONY: demo test test-slow test-nightly lint docs bench accept-cache paper clean

demo: .venv/.package
	$(BIN)/surrofe2 study data/demo.toml --out out/demo

test: .venv/.development
	$(BIN)/pytest -m "not slow and not nightly" -n 2 --dist loadfile

test-slow: .venv/.development
	$(BIN)/pytest -m "slow and not nightly" -n 2 --dist loadfile

test-nightly: .venv/.development
	$(BIN)/pytest -m nightly -n 2 --dist loadfile

docs: .venv/.development
	$(BIN)/python -m sphinx -q -W --keep-going -c docs . out/site

lint: .venv/.development
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports

bench: .venv/.development
	$(BIN)/python -m benchmarks $(if $(filter quick,$(MODE)),--quick)

accept-cache: .venv/.development
	$(BIN)/python -m benchmarks trust || exit 1
	for preset in printed water; do \
	    $(BIN)/python -m validation worst-answer --cell $$preset --out out/bench --fresh || exit 1; \
	done

paper: .venv/.package
	for preset in printed water; do \
	    for figure in fig5 fig6 fig8 rates; do \
	        $(BIN)/python -m validation $$figure --cell $$preset --out out/paper || exit 1; \
	    done; \
	    $(BIN)/surrofe2 moduli --cell $$preset --memory out/paper --stability out/paper \
	        --out out/paper/moduli-$$preset.json || exit 1; \
	done

clean:
	rm -rf .venv out .pytest_cache .mypy_cache .ruff_cache .import_linter_cache *.egg-info
	find . -name __pycache__ -type d -prune -exec rm -rf {} +

.venv/.package: pyproject.toml constraints.txt
	$(PYTHON) -c "import sys; sys.exit(sys.version_info < (3, 11) and 'Python 3.11 or newer is needed; name one by PYTHON=')"
	$(PYTHON) -m venv .venv
	$(BIN)/python -m pip install --quiet -c constraints.txt -e .
	touch $@

.venv/.development: .venv/.package
	$(BIN)/python -m pip install --quiet -c constraints.txt -e ".[cluster,docs,mpi,dev]"
	$(BIN)/python -m pip install --quiet -c constraints.txt --no-deps \
	    micro-manager-precice precice-adapter-schema # tests stand in for preCICE, which has no wheel
	touch $@
