# make demo      set up .venv, simulate a drive, run it and say where the report is
# make test      check style, types and layers, and run all tests but the slow ones
# make test-all  run the slow tests, which make test leaves out: whole commands of the README, notebooks, clusters, browsers
# make docs      build the documentation in build/site, and stop at a link or a name that leads nowhere
# make dist      build sdist and wheel, and try both without extras in a clean environment of each Python that mqslam supports
# make lint      check style, types and layers only
# make bench     make the short measurements of BENCHMARKS.md and compare them with the committed ones, which takes half an hour
# make clean     remove .venv and everything that is built or generated

PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
INSTALLED := $(VENV)/.installed
READY := $(VENV)/.ready
TYPED := build/typed
KERNELS := $(VENV)/.kernels

# The tests of a file stay in one process, so that what they share is made once. More than four processes would only make it more often.
PYTEST := $(BIN)/python -m pytest --numprocesses auto --maxprocesses 4 --dist loadfile

.PHONY: demo docs test test-all fuzz dist lint types bench clean

# What a user needs; what the tests need comes on top.
$(INSTALLED): pyproject.toml
	@$(PYTHON) -c 'import sys; sys.exit(0 if sys.version_info >= (3, 11) else "mqslam needs Python 3.11 or newer: make PYTHON=python3.11 ...")'
	@echo "installing mqslam and what it needs in $(VENV): 0.8 GB, a minute or two"
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --disable-pip-version-check --editable .
	touch $(INSTALLED)

$(READY): $(INSTALLED)
	@echo "installing what the tests need in $(VENV): 2.5 GB more, some minutes"
	$(BIN)/python -m pip install --disable-pip-version-check --editable '.[test]'
	sh .ci/system-libraries $(BIN)/python
	touch $(READY)

demo: $(INSTALLED)
	@rm -rf demo/run && mkdir -p demo
	@test -d demo/drive || $(BIN)/mqslam simulate demo/drive
	@echo "running SLAM on demo/drive: a minute, longer at the first time, when kernels are compiled"
	$(BIN)/mqslam run demo/drive --out demo/run
	@echo "open demo/run/report.html in a browser; trajectory, map and numbers lie beside it"

$(KERNELS): $(READY) tests/support/kernels.py $(shell grep -rl 'nb\.njit' --include '*.py' mqslam tests/worlds)
	PYTHONPATH=tests $(BIN)/python -m support.kernels
	touch $(KERNELS)

test: $(READY) lint $(KERNELS)
	@echo "running the tests: ten minutes on two quiet cores"
	$(PYTEST) -m 'not slow'

test-all: $(READY) $(KERNELS)
	$(PYTEST) -m slow

fuzz: $(READY) $(KERNELS)
	$(PYTEST) -m 'slow or not slow' tests/fuzz

dist: $(READY)
	$(BIN)/python .ci/dist.py

lint: $(READY) types
	$(BIN)/ruff check .
	$(BIN)/ruff format --check --quiet .
	cd $(TYPED) && $(CURDIR)/$(BIN)/lint-imports --config $(CURDIR)/pyproject.toml

types: $(READY)
	rm -rf build && $(BIN)/python -m pip install --quiet --disable-pip-version-check --no-deps --target $(TYPED) . && rm -rf mqslam.egg-info
	MYPYPATH=$(TYPED):tests $(BIN)/mypy --strict -p mqslam -p worlds.hard -m worlds.statistics -m worlds.writing

docs: $(READY)
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --strict

verdict-page: $(READY)
	cd docs/hooks && ../../$(BIN)/python -c "import generate; open('../explanation/verdict.md', 'w').write(generate.describe_verdict())"

bench: $(READY)
	$(BIN)/python tests/bench/run.py

clean:
	rm -rf $(VENV) .editable build dist demo .mypy_cache .ruff_cache .pytest_cache *.egg-info
