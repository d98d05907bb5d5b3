# `make run` and `make test` are enough to start. Each target first creates the environment in .venv.
.DEFAULT_GOAL := help
.PHONY: help run test bounds long mutants lint venv wheel screenshots docs bench results validate stress soak errors \
	broad-phase peers clean

# The newest Python that Taichi has wheels for; PYTHON=... overrides.
PYTHON ?= $(shell for p in python3.13 python3.12 python3.11 python3 python; do \
	command -v $$p >/dev/null 2>&1 && $$p -c 'import sys; sys.exit(not (3, 11) <= sys.version_info < (3, 14))' 2>/dev/null \
	&& echo $$p && break; done)
ifeq ($(OS),Windows_NT)
BIN := .venv/Scripts
else
BIN := .venv/bin
endif

# Results of this machine, which the documents quote.
MACHINE ?= two-cores
RESULTS := benchmarks/results/$(MACHINE)

# The shipped scenes, in the order of the documents.
SCENES := curtain drape15 table denim net slope fast-ball veil poles responses fold stack towel knot twist tear \
	sphere flag sail hammock cape banner relief bias skirt trellis

help:
	@echo "make run          open the window (without a display: render 240 frames to out/run_curtain)"
	@echo "make test         run the tests (REQUIRE_WINDOW=1: fail instead of skipping the tests of the real window)"
	@echo "make bounds       run the tests of kernels and collision with bounds checks of all array accesses"
	@echo "make long         run the tests that take minutes each; write tests/long_result.toml"
	@echo "make mutants      mutation testing: a test must fail with each mutation; write tests/mutants_result.toml"
	@echo "                  (ONLY=NAME: run that mutation)"
	@echo "make lint         run ruff and mypy"
	@echo "make bench        measure frame times on this machine, with C and JavaScript (BENCH=--all: everything)"
	@echo "make results      bench and performance goals, stored in $(RESULTS); update docs/ (MACHINE=name)"
	@echo "make validate     compare every solver with analytic and converged solutions; write docs/validation.md"
	@echo "make stress       run 40 stability cases with every solver, ten runs a variant; write docs/stability.md (hours)"
	@echo "make soak         run a sheet for a million frames with every solver; write benchmarks/results/soak.json (hours)"
	@echo "make errors       measure time and error of solver settings; write docs/scene_errors.md"
	@echo "make broad-phase  compare the broad phase with brute force, an octree and a k-d tree"
	@echo "make peers        time the same cloth in other programs, installed in their own environments"
	@echo "make screenshots  render the images in screenshots/ and docs/pictures/"
	@echo "make docs         build the documentation site in site/"

run: .venv/ready
	$(BIN)/taichi-cloth run $(SCENE)

test: .venv/tools
	$(BIN)/python -m pytest

bounds: .venv/tools
	TI_DEBUG=1 $(BIN)/python -m pytest -m "bounds and not long"

# The result is written even if a test fails; the exit status is that of the tests. Single tests take minutes, so a free
# process takes over tests of the other (worksteal).
long: .venv/tools
	@mkdir -p out
	$(BIN)/python -m pytest -m long --dist worksteal -o faulthandler_timeout=3600 --junitxml=out/long.xml; status=$$?; \
		$(BIN)/python tests/long_result.py out/long.xml && exit $$status

mutants: .venv/tools
	$(BIN)/python tests/mutants/run_mutants.py $(addprefix --only ,$(ONLY))

lint: .venv/tools
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy

screenshots: .venv/tools
	$(BIN)/python screenshots/make.py
	$(BIN)/python screenshots/parameters.py
	$(BIN)/python screenshots/pages.py

# NO_MKDOCS_2_WARNING turns off an advertisement of the theme.
docs: .venv/tools
	$(BIN)/python docs/generate.py
	NO_MKDOCS_2_WARNING=1 $(BIN)/python -m mkdocs build --strict

bench: .venv/ready
	$(BIN)/taichi-cloth bench $(BENCH)

# `results`, `validate`, `stress` and `errors` update the documents that quote their results even if the command fails;
# the exit status is that of the command. docs/generate.py needs Pillow, which .venv/tools installs.
results: .venv/tools
	mkdir -p $(RESULTS)
	$(BIN)/taichi-cloth bench --json $(RESULTS)/bench.json --csv $(RESULTS)/bench.csv --force \
		&& $(BIN)/taichi-cloth bench --goals --json $(RESULTS)/goals.json --force; status=$$?; \
		$(BIN)/python docs/generate.py && exit $$status

# `ablate` compares motions until a disturbance has grown 100 times, which takes three frames in these scenes.
NOT_COMPARABLE := bias skirt trellis
validate: .venv/tools
	mkdir -p $(RESULTS)
	$(BIN)/taichi-cloth ablate $(filter-out $(NOT_COMPARABLE),$(SCENES)) round \
		--json $(RESULTS)/ablation.json --markdown docs/scenes_rows.md --force \
		&& $(BIN)/taichi-cloth validate --json benchmarks/results/validation.json --markdown docs/validation.md --force; \
		status=$$?; $(BIN)/python docs/generate.py && exit $$status

# Stored results are kept if this program repeats their last start bit by bit, so an interrupted run continues, on another
# machine too. Each result names its machine.
stress: .venv/tools
	$(BIN)/taichi-cloth stress --json benchmarks/results/stability.json --resume --recheck --explain --markdown docs/stability.md --force; \
		status=$$?; $(BIN)/python docs/generate.py && exit $$status

soak: .venv/tools
	$(BIN)/taichi-cloth stress --filter 32 --soak --quick --json benchmarks/results/soak.json --resume; \
		status=$$?; $(BIN)/python docs/generate.py && exit $$status

# Scenes without a float64 reference solution; docs/scene_errors.md gives the reasons.
NO_REFERENCE := fold knot stack towel twist
errors: .venv/tools
	mkdir -p $(RESULTS)
	$(BIN)/taichi-cloth bench --error --all --csv assets/error.csv --json $(RESULTS)/error.json --plot docs/pictures --force \
		&& $(BIN)/taichi-cloth bench --error $(addprefix --scene ,$(filter-out $(NO_REFERENCE),$(SCENES) round walker)) \
		--json $(RESULTS)/scene_errors.json --markdown docs/scene_errors_rows.md --force; status=$$?; \
		$(BIN)/python docs/generate.py && exit $$status

broad-phase: .venv/tools
	$(BIN)/python benchmarks/broad_phase/run.py

peers: .venv/ready
	$(BIN)/python benchmarks/peers/run.py

wheel: .venv/tools
	$(BIN)/python -m pip wheel --no-deps --wheel-dir dist .

venv: .venv/ready

.venv/python:
	@test -n "$(PYTHON)" || { echo "make: Python 3.11, 3.12 or 3.13 is needed (PYTHON=/path/to/python3.12 make run)"; exit 2; }
	$(PYTHON) -m venv .venv
	@touch $@

.venv/ready: pyproject.toml .venv/python
	@echo "installing taichi_cloth and Taichi in .venv (once)"
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --editable .
	@touch $@

.venv/tools: pyproject.toml .venv/python
	@echo "installing taichi_cloth with the tools of its tests in .venv (once)"
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --editable '.[test,dev,docs]'
	@touch .venv/ready $@

clean:
	rm -rf .venv out dist build site
