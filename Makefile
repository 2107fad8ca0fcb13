# Two commands do all the set-up: `make demo` and `make test`. Needs Python 3.11+ and make, nothing else.
PYTHON ?= python3
VENV ?= .venv
BIN := $(VENV)/$(if $(filter Windows_NT,$(OS)),Scripts,bin)
# Without bytecode every process, of which the tests start many, compiles all sources anew.
unexport PYTHONDONTWRITEBYTECODE

.PHONY: help demo test test-all check docs format bench reproduce clean

help:
	@echo "make demo       environment, install, the splitter plate deformed, report and picture in demo/"
	@echo "make test       environment, install, the tests but for the long ones: a few minutes on two cores"
	@echo "make test-all   all tests"
	@echo "make check      ruff, format, tracked files, mypy, import contracts"
	@echo "make docs       the documentation as a site in build/site"
	@echo "make fuzz       mutated files and random grids, judged independently (N=20000, SEED=1)"
	@echo "make bench      speed and memory tables (see docs/performance.md)"
	@echo "make reproduce  the paper's tables and figures (QUICK=1 for the small sizes)"

# Bytecode is written where a module is first imported; most of what these packages contain never is.
PIP := $(BIN)/python -m pip install --quiet --disable-pip-version-check --no-compile

# What runs the program; `installed` adds what tests and checks it.
$(VENV)/program: pyproject.toml
	$(PYTHON) -m venv $(VENV)
	$(PIP) -e .
	@touch $@

$(VENV)/installed: $(VENV)/program
	$(PIP) -e '.[test,check]'
	@touch $@

# Compiled once, before several processes ask for the same loops; again only when a source has changed.
SOURCES := $(shell find meshdeform_core formats -name '*.py')
$(VENV)/compiled: $(VENV)/installed $(SOURCES)
	$(BIN)/meshdeform warm-up
	@touch $@

test: $(VENV)/compiled
	$(BIN)/pytest -n auto -m 'not slow'

test-all: $(VENV)/compiled
	$(BIN)/pytest -n auto

check: $(VENV)/installed
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/python tests/tracked_files.py
	@mkdir -p build/names
	@for pair in cli:meshdeform_cli formats:meshdeform_formats sample_cases:meshdeform_samples; do \
	  ln -sfn "../../$${pair%%:*}" "build/names/$${pair##*:}"; done
	MYPYPATH=build/names $(BIN)/mypy
	MYPYPATH=build/names:. $(BIN)/mypy --strict --follow-imports=silent examples/coupling.py examples/optimise.py
	$(BIN)/lint-imports

# All sizes take about twenty minutes; make bench OPTIONS=--quick two.
bench: $(VENV)/program
	$(BIN)/python benchmarks/run.py $(OPTIONS)

# The site in build/site, readable without a network; OPTIONS=--quick leaves the gallery out.
docs: $(VENV)/installed
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -e '.[docs]'
	PYTHONPATH=docs $(BIN)/python docs/build.py $(OPTIONS)
	@echo "Open build/site/index.html."

# Mutated files, tables, formulas and grids, judged independently; SEED=1 repeats a campaign.
fuzz: $(VENV)/installed
	PYTHONPATH=tests $(BIN)/python -P -m fuzz.campaign $(or $(N),2000) $(if $(SEED),--seed $(SEED)) \
	  --jobs $(or $(JOBS),1)

format: $(VENV)/installed
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .

clean:
	rm -rf build dist demo reproduced .pytest_cache .mypy_cache .ruff_cache

reproduce: $(VENV)/program
	$(BIN)/meshdeform reproduce all -o reproduced --force $(if $(QUICK),--quick)
	@echo "Look at reproduced/results.md and the figures beside them."

# What the time goes into is printed at the end; build/ has when it began.
.PHONY: demo-begins
demo-begins:
	@mkdir -p build
	@date +%s > build/demo-begins

demo: demo-begins $(VENV)/program
	@date +%s > build/demo-works
	rm -rf demo
	$(BIN)/meshdeform sample splitter-plate -o demo --size 16
	$(BIN)/meshdeform deform demo/grid.cgns -c demo/case.toml -o demo/deformed.cgns \
	  --report demo/report.json --report demo/report.txt
	$(BIN)/meshdeform plot demo/deformed.cgns -o demo/deformed.png --plane k=1 --title "splitter plate, IDW-TFI"
	@echo "Look at demo/deformed.png; the report is in demo/report.txt and demo/report.json."
	@$(BIN)/python -c 'import json, time; \
	  begins, works = (int(open("build/demo-" + name).read()) for name in ("begins", "works")); \
	  compiling = json.load(open("demo/report.json"))["timing"].get("compile", 0.0); \
	  print(f"environment {works - begins} s, compiling {compiling:.0f} s, work {time.time() - works - compiling:.0f} s")'
