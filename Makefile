# Two commands on a fresh machine: `make render` and `make test`. See README.md.
#   make render VENV=/tmp/venv PYTHON=python3.12    another place, another Python (3.10 or newer)

VENV ?= .venv
PYTHON ?= python3
PY := $(VENV)/bin/python
# Tests run in as many processes as there are processors, up to four; the tests of a file stay together.
# They come in the order that tests/conftest.py gives them.
SIDE_BY_SIDE := -n auto --maxprocesses 4 --dist loadfile --no-loadscope-reorder
READY := $(VENV)/.djpt-ready

.PHONY: help setup render gallery test test-narrow lint format check check-cuda bench bench-cuda docs release clean

help:
	@echo 'make setup    create $(VENV), install djpt and what its tests and pages need, see to LLVM'
	@echo 'make render   render the Cornell box to cornell_box.png'
	@echo 'make gallery  render a ball of each material to gallery.png'
	@echo 'make test     run the tests (without the slow ones)'
	@echo 'make test-narrow   some of them again, with kernels as for AVX2'
	@echo 'make lint     ruff and mypy'
	@echo 'make format   let ruff format the code and sort the imports'
	@echo 'make check    lint and all tests; one of them builds the documentation'
	@echo 'make check-cuda    tests on a GPU, if there is one'
	@echo 'make bench    measure against Mitsuba, and note it in benchmarks/history.jsonl'
	@echo 'make bench-cuda    measure on a GPU, if there is one, against Mitsuba and the processor'
	@echo 'make docs     build the documentation in build/docs, warnings are errors'
	@echo 'make release  build the wheel, try it in an empty environment, write hashes, notes and a bill of materials to dist/'
	@echo 'make clean    remove $(VENV) and caches'

setup: $(READY)

$(READY): pyproject.toml
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 10) and "djpt needs Python 3.10 or newer, $(PYTHON) is " + sys.version.split()[0] + "; try make PYTHON=python3.12")'
	$(PYTHON) -m venv $(VENV)
	$(PY) -m pip install --quiet --disable-pip-version-check --editable '.[validate,dev,docs]'
	$(PY) -m djpt.jit.llvm --if-needed
	@touch $@

render: $(READY)
	$(PY) -m djpt render cornell_box -o cornell_box.png --spp 256

gallery: $(READY)
	$(PY) -m djpt gallery -o gallery.png

# Kernels compile in a fraction of the time, see tests/kit/quick_kernels.py. Bytecode is kept, whatever the shell says:
# processes that tests start would compile djpt anew.
test: $(READY)
	DJPT_TEST_QUICK=1 PYTHONDONTWRITEBYTECODE= $(PY) -m pytest -q $(SIDE_BY_SIDE)

# Only the files that have such tests are imported; kernels compile as users compile them.
test-narrow: $(READY)
	DJPT_TEST_LANES=8 PYTHONDONTWRITEBYTECODE= $(PY) -m pytest -q $(SIDE_BY_SIDE) -m 'narrow and not slow' \
	$$(grep -rl 'mark\.narrow' tests --include='test_*.py')

lint: $(READY)
	$(PY) -m ruff check .
	$(PY) -m ruff format --check .
	$(PY) -m mypy

format: $(READY)
	$(PY) -m ruff check --fix-only --quiet .
	$(PY) -m ruff format .

check: lint
	$(PY) -m pytest -q $(SIDE_BY_SIDE) -m ''

check-cuda: $(READY)  # without a GPU it says so and is content
	@if $(PY) -m tests.kit.devices; then DJPT_VARIANT=cuda_ad_rgb $(PY) -m pytest -q -m cuda; fi

bench: $(READY)
	@status=0; for name in versus_mitsuba meshes materials lights ptracer media; do \
	$(PY) benchmarks/$$name.py --history || status=1; done; $(PY) benchmarks/many_lights.py || status=1; \
	$(PY) benchmarks/history.py; exit $$status

bench-cuda: $(READY)  # without a GPU it says so and is content
	@$(PY) benchmarks/cuda.py

docs: $(READY)
	$(PY) -m sphinx -q -W --keep-going -b html docs build/docs
	@echo 'build/docs/index.html'

release: $(READY)  # needs the package index
	$(PY) packaging/release.py

clean:
	rm -rf $(VENV) build dist .pytest_cache .mypy_cache .ruff_cache .hypothesis
