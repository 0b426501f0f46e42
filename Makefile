# Two commands do everything on a fresh machine with Python >= 3.11: `make run` and `make test`.
PYTHON ?= python3
BIN := .venv/bin
# Hundreds of processes load the same modules: Python compiles them at their first import, and once,
# also where the user's environment says otherwise.
export PYTHONDONTWRITEBYTECODE :=
export PYTHONPYCACHEPREFIX :=

TESTS := $(BIN)/python -m pytest -q -n 2 --dist loadfile --no-loadscope-reorder

.PHONY: run test types test-long survey attack bench pictures digits clean

.venv/installed: pyproject.toml
	$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11) and "stepbench needs Python 3.11 or newer; set PYTHON=...")'
	test -x $(BIN)/python || $(PYTHON) -m venv .venv
	$(BIN)/python .ci/install -e ".[mujoco,sympy,notebook]"
	touch $@

.venv/tested: .venv/installed
	$(BIN)/python .ci/install -e ".[test]"
	touch $@

run: .venv/installed  ## run the quick suite and write its report
	$(BIN)/stepbench run quick

test: .venv/tested  ## check style, and pass the tests; five minutes
	$(BIN)/ruff check .
	$(TESTS)

types: .venv/tested  ## check types; half a minute
	$(BIN)/pyright

test-long: .venv/tested  ## further scenes and sweeps of what `make test` proves
	$(TESTS) -m long

survey: .venv/tested  ## every method on a scene of each kind: none is wrong without a note; 45 minutes of one core
	$(BIN)/python -m pytest -q tests/test_survey.py -m survey

attack: .venv/tested  ## hostile plugins, signals, inputs and machines: tried and held
	$(TESTS) tests/attacks -m "attack or not attack"

bench: .venv/tested  ## our time loop against C, exudyn and other solvers; microseconds per step; half an hour
	$(BIN)/python tests/benchmarks/start_up.py
	$(BIN)/python tests/benchmarks/race.py
	$(BIN)/python tests/benchmarks/sizes.py
	$(BIN)/python -m pytest -q tests/benchmarks --benchmark-only --benchmark-disable-gc --benchmark-json=stepbench-speed.json

pictures: .venv/tested  ## the gallery, README's picture and times of docs/iftomm.md; half an hour, in Chromium
	$(BIN)/python tests/pictures.py

digits: .venv/tested  ## certain digits of all scenes, problems/truth/digits.json; a quarter of an hour
	$(BIN)/python tests/digits.py

clean:
	rm -rf .venv .cache build *.egg-info stepbench-*
