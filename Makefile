PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
READY := $(VENV)/.ready
# the workers fill the cores, and the many processes read what one has compiled, whatever the environment says
PYTEST := OMP_NUM_THREADS=1 PYTHONDONTWRITEBYTECODE= $(BIN)/pytest

.PHONY: demo test tests test-tools test-all lint docs studies studies-quick fuzz kills bench wheel clean

$(READY): pyproject.toml constraints.txt
	$(PYTHON) -m venv $(VENV)
	$(BIN)/pip install --quiet --constraint constraints.txt --editable '.[dev]'
	touch $@

# the main job on real data, then the excavator
demo: $(READY)
	$(BIN)/hydroopt identify kr300 data/kr300/run_A.mat --map data/kr300/map.toml --holdout 0.3 -o out/kr300
	$(BIN)/hydroopt simulate cat215b --truth random --truth-seed 1 --seed 1 -o out/cat215b/run1
	$(BIN)/hydroopt simulate cat215b --truth random --truth-seed 1 --seed 2 -o out/cat215b/run2
	$(BIN)/hydroopt identify cat215b out/cat215b/run1/log.csv --validate out/cat215b/run2/log.csv -o out/cat215b/estimate
	@echo "open out/kr300/report.html and out/cat215b/estimate/report.html"

# lint, types and every test that is not marked slow; two jobs, since mypy uses one core
test: $(READY)
	$(MAKE) --jobs=2 lint tests

tests: $(READY)
	$(PYTEST)

# the tests that need a tool beside Python, make and a C compiler; fails where one is missing
test-tools: $(READY)
	$(PYTEST) -m 'needs and not slow' --need-tools

test-all: $(READY) lint
	$(PYTEST) -m ''

lint: $(READY)
	$(BIN)/ruff check
	$(BIN)/mypy

# the documentation site, without the network: out/docs/index.html
docs: $(READY)
	$(BIN)/python -m sphinx -W --keep-going -q -d out/doctrees docs out/docs
	@echo "open out/docs/index.html"

studies: $(READY)
	$(BIN)/python -m studies

studies-quick: $(READY)
	$(BIN)/python -m studies --quick

# spoilt inputs and commands: figures to out/fuzz/table.md
fuzz: $(READY)
	PYTHONPATH=tests OMP_NUM_THREADS=1 nice $(BIN)/python -m fuzzing

bench: $(READY)
	$(BIN)/python -m studies.bench

# kill every command 500 times at random moments
kills: $(READY)
	OMP_NUM_THREADS=1 $(BIN)/python -m studies.kills

# the sdist, and the wheel built from it
wheel: $(READY)
	rm -rf dist
	$(BIN)/python -m build
	$(BIN)/twine check --strict dist/*

clean:
	rm -rf $(VENV) out build dist *.egg-info
