SHELL := /bin/bash
.SHELLFLAGS := -euo pipefail -c
.DEFAULT_GOAL := help
.DELETE_ON_ERROR:

STAMP := .venv/.stamp
PATH := $(CURDIR)/.venv/bin:$(PATH)
export PATH

.PHONY: help setup demo test slow docs faults fuzz package mutants check format bench fresh clean

help: ## Show the targets.
	@grep -E '^[a-z]+:.*##' $(firstword $(MAKEFILE_LIST)) | sed -E 's/^([a-z]+):[^#]*## /  make \1	/' | expand -t 15

$(STAMP): pyproject.toml constraints.txt .ci/setup.sh
	@PYTHON="$(PYTHON)" bash .ci/setup.sh

setup: $(STAMP) ## Create .venv with everything that ifo needs.

PRESET ?= quick
DEMO := runs/reach$(if $(filter-out quick,$(PRESET)),-$(PRESET))
demo: setup ## Learn to reach from videos in other contexts (PRESET=quick). Run it again to resume.
	@mkdir -p runs
	@ifo collect-demos reach --preset $(PRESET) | ifo train-translator --resume | ifo translate | ifo learn-policy --resume \
	    | ifo evaluate --json > runs/demo.json.part
	@mv runs/demo.json.part runs/demo.json
	@echo "Normalized final distance to the goal (1: the initial distance):"
	@python -m json.tool runs/demo.json | grep -E '"normalised_distance(_stochastic)?":|"success_[a-z]+":'
	@echo "All figures: runs/demo.json. Videos:"
	@ls $(DEMO).demos.mp4 $(DEMO)-c0.*.mp4 | sed 's/^/  /'

test: setup ## Run the tests that take seconds.
	@bash .ci/browser.sh
	@pytest -n auto --dist loadfile --no-loadscope-reorder

slow: setup ## Run the tests that take minutes.
	@pytest -m slow

docs: setup ## Build the documentation site, docs/_build/index.html, after the generated pages of its reference.
	@python -c 'import importlib.util, sys; sys.exit(not importlib.util.find_spec("furo"))' \
	    || python -m pip install --quiet -e '.[docs]' -c constraints.txt
	@python docs/make_reference.py
	@python -m sphinx -W --keep-going -q -b html docs docs/_build
	@echo docs/_build/index.html

N ?= 1000
faults: setup ## Inject N=1000 faults, drawn with SEED=1: damage, kills, hostile files. Run it again to resume.
	@python -m tests.faults --n $(N) --seed $(SEED) --log runs/faults-$(N)-$(SEED) --out results/faults.md

MINUTES ?= 2
fuzz: setup ## Coverage-guided fuzzing of what reads files and options, MINUTES=2 of CPU time for each target.
	@python -c 'import importlib.util, sys; sys.exit(not importlib.util.find_spec("atheris"))' \
	    || python -m pip install --quiet -e '.[fuzz]' -c constraints.txt
	@python -m tests.fuzzing --minutes $(MINUTES) --out results/faults.md

SEED ?= 1
mutants: setup ## Mutation testing with a random sample of code changes (SEED=1); takes an hour.
	@python -c 'import importlib.util, sys; sys.exit(not importlib.util.find_spec("mutmut"))' \
	    || python -m pip install --quiet -e '.[mutants]' -c constraints.txt
	@python tests/mutation/mutants.py --seed $(SEED)

package: setup ## Build the package, install it in a new environment and run the toy pipeline there.
	@pytest -m install -rs

check: setup ## Lint, formatting and types.
	@ruff check .
	@ruff format --check .
	@mypy

format: setup ## Fix lint and formatting.
	@ruff check --fix .
	@ruff format .

bench: setup ## Run the benchmarks that take minutes; each prints one JSON line. (translator_learning.py takes an hour.)
	@for benchmark in $(filter-out %/translator_learning.py,$(wildcard benchmarks/*.py)); do python "$$benchmark"; done

fresh: ## Try the current commit on a bare Debian in a temporary folder (needs root, debootstrap); TESTS=... selects tests.
	@TESTS="$(TESTS)" bash .ci/fresh.sh

clean: ## Remove caches and the virtual environment, but not runs/.
	rm -rf .venv build dist docs/_build *.egg-info .pytest_cache .mypy_cache .ruff_cache .hypothesis
	find . -name __pycache__ -type d -prune -exec rm -rf {} +
