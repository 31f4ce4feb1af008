# `make help` lists what there is. `make run` and `make test` do all of the set-up from a bare Debian 12.
SHELL := /bin/bash
.SHELLFLAGS := -eu -o pipefail -c
.DEFAULT_GOAL := help
MAKEFLAGS += --no-builtin-rules

BIN := .venv/bin
NATIVE_BUILD := build/native
JOBS ?= $(shell env -u OMP_NUM_THREADS nproc)
RANKS ?= 2
SCENE ?= examples/ten_bunches.toml
ARGS ?=
ISA ?= host
REPORTS := $(if $(PUBLISH),docs/reports,runs/reports)
SYSTEM := build-essential cmake ninja-build python3-venv python3-dev libopenmpi-dev openmpi-bin trilinos-all-dev
PEERS := libhypre-dev
NATIVE := CMakeLists.txt pyproject.toml $(wildcard native/* native/*/*.cpp native/*/*.hpp)

# Ranks compute by themselves, may be root, and may be more than there are cores.
# Without bytecode each process compiles all sources anew: a third of its start.
unexport PYTHONDONTWRITEBYTECODE
export OMP_NUM_THREADS := 1
export OMPI_ALLOW_RUN_AS_ROOT := 1
export OMPI_ALLOW_RUN_AS_ROOT_CONFIRM := 1
export OMPI_MCA_rmaps_base_oversubscribe := 1

.PHONY: always bundle wheel stub docs gallery help setup build run test nehalem aarch64 verify impactx sanitize bench solvers lint format clean

help:  ## list the targets
	@sed -nE 's/^([a-z0-9]+):.*## (.*)/  make \1\t\2/p' Makefile | expand -t 16

# Ctrl-C and TERM reach the ranks as USR1, so that they have all the time that a checkpoint takes; the second time they are killed.
RUN := mpiexec -n $(RANKS) $(BIN)/amrpic run $(SCENE)
run: setup  ## the main job: SCENE on RANKS ranks
	@echo '$(RUN)'; how=USR1; setsid $(RUN) </dev/null & run=$$!; \
	trap 'kill -$$how $$run 2>/dev/null || true; how=TERM' INT TERM HUP; \
	status=0; while wait $$run || status=$$?; kill -0 $$run 2>/dev/null; do status=0; done; exit $$status

# A file more than there are cores: many tests wait for processes that end.
test: setup build/waiting.so  ## all tests, some files at a time; ARGS go to pytest
	$(SLEEPING) $(BIN)/python -m pytest -n $$(($(JOBS) + 1)) --dist loadfile --no-loadscope-reorder $(ARGS)

SLEEPING := env LD_PRELOAD=$(CURDIR)/build/waiting.so
build/waiting.so: tests/support/waiting.c .venv/.system
	@mkdir -p build; cc -O2 -shared -fPIC -o $@ $<

# An old and a middling processor, as QEMU has them: the set that each gets, and a refined problem with a known potential.
nehalem: setup .venv/.qemu  ## the solver on processors with SSE4.2 and AVX2 alone, emulated
	@for kind in Nehalem:v2 Haswell:v3; do \
	  mpiexec -n 1 qemu-x86_64 -cpu $${kind%:*} $(BIN)/python -W ignore -c "from mpi4py import MPI; from amrpic import isa; from amrpic.commands import doctor; \
	assert isa.in_use == '$${kind#*:}', isa.in_use; print('$${kind%:*},', isa.description() + ':', doctor.solve_known(MPI.COMM_WORLD))" 2> >(grep -v 'TCG doesn.t support' >&2); \
	done

.venv/.qemu: .venv/.system
	@command -v qemu-x86_64 >/dev/null || { root=; [ "$$(id -u)" = 0 ] || root=sudo; echo "installing Debian packages: qemu-user"; \
	  $$root apt-get update -q >/dev/null; \
	  $$root env DEBIAN_FRONTEND=noninteractive apt-get install -y -q --no-install-recommends qemu-user >/dev/null; }
	@touch $@

# Another kind of processor: Debian's packages for it in a folder, the module cross-compiled, its Python under QEMU.
ARM := build/aarch64
ARM_PACKAGES := trilinos-all-dev,libopenmpi-dev,openmpi-bin,python3.11,libpython3.11-dev,libopenblas0-pthread
ARM_TESTS ?= tests/solver/test_poisson.py tests/solver/test_matrixfree.py tests/solver/test_composite.py tests/solver/test_solver_oracle.py
aarch64: setup .venv/.qemu $(ARM)/.packages  ## cross-compile for 64-bit ARM and run the solver's tests there on one rank
	@export AMRPIC_ARM64_ROOT=$(CURDIR)/$(ARM)/root; \
	[ -e $(ARM)/native/build.ninja ] || cmake -S . -B $(ARM)/native -G Ninja -DCMAKE_TOOLCHAIN_FILE=cmake/aarch64.cmake -DPython_EXECUTABLE=$(CURDIR)/$(BIN)/python >/dev/null; \
	nice ninja -C $(ARM)/native -j $(JOBS) --quiet
	@ln -sfn $(CURDIR)/amrpic/* -t $(ARM)/packages/amrpic; cp tests/support/aarch64_python $(ARM)/python
	@for module in _native_baseline _processor; do cp $(ARM)/native/$$module*.so $(ARM)/packages/amrpic/$$module.so; done
	AMRPIC_TEST_PATIENCE=10 $(ARM)/python -m pytest -p no:cacheprovider -k "not 2r and not 3r and not 4r" $(ARM_TESTS) $(ARGS)

$(ARM)/.packages: .venv/.packages .venv/.qemu
	@missing=; for tool in mmdebstrap aarch64-linux-gnu-g++; do command -v $$tool >/dev/null || missing=yes; done; \
	root=; [ "$$(id -u)" = 0 ] || root=sudo; \
	if [ -n "$$missing" ]; then echo "installing Debian packages: mmdebstrap g++-aarch64-linux-gnu"; \
	  $$root env DEBIAN_FRONTEND=noninteractive apt-get install -y -q --no-install-recommends mmdebstrap g++-aarch64-linux-gnu >/dev/null; fi; \
	echo "unpacking Debian packages for arm64 into $(ARM)"; rm -rf $(ARM); mkdir -p $(ARM)/packages/amrpic; \
	$$root mmdebstrap --quiet --variant=extract --arch=arm64 --mode=root --include=$(ARM_PACKAGES) bookworm $(ARM)/root
	@$(BIN)/python -m pip install -q --disable-pip-version-check --target $(ARM)/packages --only-binary=:all: --implementation cp \
	  --python-version 3.11 $$(printf -- '--platform manylinux_2_%s_aarch64 ' 17 27 28) --platform manylinux2014_aarch64 \
	  $$($(BIN)/python -c 'import tomllib; project = tomllib.load(open("pyproject.toml", "rb"))["project"]; \
	  print(*(p.replace(" ", "") for p in project["dependencies"]), "pytest", "pytest-xdist")')
	@touch $@

verify: setup build/waiting.so .venv/.docs .venv/.browser .venv/.hosts  ## accuracy against exact answers, and the long tests; PUBLISH=1: into docs/reports
	@failed=0; try() { echo "$$@"; "$$@" || failed=1; }; \
	rm -f $(REPORTS)/verification.md; \
	try $(SLEEPING) AMRPIC_REPORTS=$(CURDIR)/$(REPORTS) $(BIN)/python -m pytest -m "long or browser" --need-browser $(ARGS); \
	try $(SLEEPING) $(BIN)/python -m pytest tests/hosts $(ARGS); \
	try mpiexec -n $(RANKS) $(BIN)/amrpic verify --quick examples/drift.toml examples/waist.toml --output $(REPORTS); \
	exit $$failed

# For machines without a network: docs/machine.md.
KIND ?= cuda
bundle: .venv/.system  ## an archive that unpacks anywhere and runs, with kernels for graphics cards; KIND=cuda, openmp or serial
	@docker/card/bundle $(KIND)

wheel: .venv/.system  ## a wheel without Trilinos, compilers and MPI where it is installed; SETS: fewer kernels, PYTHON: another release
	@docker/wheel

# What the verification compares with where a peer is needed to make it.
impactx: setup .venv/.peers  ## ImpactX's values for the verification, made anew: tests/verify/beam_line.json
	$(BIN)/python benchmarks impactx_line

setup: .venv/.system .venv/.packages .venv/.built  ## Debian packages, .venv, native build; ISA=all: for all processors, nothing twice
	@:

.venv/.system: Makefile
	@command -v dpkg-query >/dev/null || { mkdir -p .venv; touch $@; exit 0; }; \
	missing=$$({ dpkg-query -W -f '$${db:Status-Abbrev} $${Package}\n' $(SYSTEM) 2>/dev/null || true; } | \
	  sed -n 's/^ii  *//p' | sort | comm -13 - <(printf '%s\n' $(SYSTEM) | sort)); \
	if [ -n "$$missing" ]; then \
	  root=; [ "$$(id -u)" = 0 ] || root=sudo; \
	  echo "installing Debian packages:" $$missing; \
	  $$root apt-get update -q >/dev/null; \
	  $$root env DEBIAN_FRONTEND=noninteractive apt-get install -y -q --no-install-recommends $$missing >/dev/null; \
	fi
	@mkdir -p .venv && touch $@

# The package is installed by the names of its modules, and anew when these change.
MODULES := $(sort $(wildcard amrpic/*.py amrpic/*/*.py amrpic/*/*/*.py))
build/.modules: always
	@mkdir -p build; echo '$(MODULES)' | cmp -s - $@ || echo '$(MODULES)' > $@

# Which kernels are built: the set that is fastest on this processor (host), or all. Another choice builds anew; none keeps the last.
build/.isa: always
	@mkdir -p build; $(if $(filter file,$(origin ISA)),[ -e $@ ] ||) { echo '$(ISA)' | cmp -s - $@ || echo '$(ISA)' > $@; }

.venv/.packages: pyproject.toml .venv/.system build/.modules build/.isa
	@echo "installing Python packages into .venv"
	@[ -x $(BIN)/python ] || /usr/bin/python3 -m venv .venv
	@$(BIN)/python -m pip install -q --disable-pip-version-check $$($(BIN)/python -c 'import tomllib; \
	  project = tomllib.load(open("pyproject.toml", "rb"))["project"]; more = project["optional-dependencies"]; \
	  print(*(p.replace(" ", "") for p in project["dependencies"] + more["test"] + more["dev"] if "[" not in p))')
	@mkdir -p build; exec 9>build/.lock; flock 9; export CMAKE_BUILD_PARALLEL_LEVEL=$(JOBS) AMRPIC_SETS="$$(cat build/.isa)"; \
	nice $(BIN)/python -m pip install -q --disable-pip-version-check --no-build-isolation --no-deps -e .
	@touch $@

.venv/.built: $(NATIVE) .venv/.packages
	@$(MAKE) --no-print-directory build
	@touch $@

# A new module is checked before it takes the old one's place: all its symbols are found, and it loads where the processor
# has its instruction set. A running process keeps the file it has mapped.
build:  ## compile what changed; one build at a time
	@mkdir -p build; exec 9>build/.lock; flock 9; \
	nice ninja -C $(NATIVE_BUILD) -j $(JOBS) --quiet | { grep -v '^ninja: no work' || true; }; \
	runs=" native baseline processor $$(PYTHONPATH=$(NATIVE_BUILD) $(BIN)/python -c 'import _processor; print(*_processor.sets())') "; \
	for new in $(NATIVE_BUILD)/_native_*.so $(NATIVE_BUILD)/_processor.*.so; do \
	  old=$$(echo .venv/lib/python3*/site-packages/amrpic)/$$(basename $$new); \
	  ! cmp -s $$new $$old || continue; \
	  missing=$$(ldd -r $$new 2>&1 | sed -n 's/^undefined symbol: \([^ \t]*\).*/\1/p' | grep -v '^_*Py' || true); \
	  [ -z "$$missing" ] || { echo "$$new lacks" $$missing; exit 1; }; \
	  set=$${new##*/_}; set=$${set#native_}; set=$${set%%.*}; \
	  case "$$runs" in *" $$set "*) $(BIN)/python -c "import ctypes; ctypes.CDLL('$$new')";; esac; \
	  cp $$new $$old.new; mv -f $$old.new $$old; \
	done

# The typed stub of the native module, as its own signatures give it.
build/_native.pyi: .venv/.built
	@$(BIN)/python -m nanobind.stubgen -q -m amrpic._native -o $@
	@sed -Ei 's/Annotated\[(NDArray\[[a-z0-9_.]+\]), dict\(([^()]|\([^)]*\))*\)\]/\1/g; /^from typing import Annotated$$/d' $@
	@$(BIN)/ruff format -q $@

stub: build/_native.pyi  ## write amrpic/_native.pyi anew
	@cmp -s $< amrpic/_native.pyi || cp $< amrpic/_native.pyi

docs: .venv/.built .venv/.docs  ## the documentation as a site, into build/site; docs/scene.md, the reference of scenes, anew
	@$(BIN)/amrpic schema --markdown --output docs/scene.md
	@$(BIN)/amrpic schema --method mpm --markdown --output docs/mpm_scene.md
	@NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build -q -f .mkdocs.yml && echo build/site/index.html

gallery: .venv/.built  ## run every example, draw it, and write docs/gallery.md anew
	@$(BIN)/python docs/site/gallery.py

.venv/.browser: .venv/.system
	@command -v chromium >/dev/null || { root=; [ "$$(id -u)" = 0 ] || root=sudo; echo "installing Debian packages: chromium"; \
	  $$root apt-get update -q >/dev/null; \
	  $$root env DEBIAN_FRONTEND=noninteractive apt-get install -y -q --no-install-recommends chromium >/dev/null; }
	@touch $@

.venv/.docs: pyproject.toml .venv/.packages
	@$(BIN)/python -m pip install -q --disable-pip-version-check $$($(BIN)/python -c 'import tomllib; \
	  print(*tomllib.load(open("pyproject.toml", "rb"))["project"]["optional-dependencies"]["docs"])')
	@touch $@

bench: setup .venv/.peers  ## speed next to peers and goals, into runs/bench; ARGS=--quick: under 2 minutes
	$(BIN)/python benchmarks bench $(if $(PUBLISH),--publish) $(ARGS)

# What benchmarks run beside, as far as it can be had here: those that are not are left out of the tables, with a line.
.venv/.peers: pyproject.toml Makefile
	@dpkg-query -W $(PEERS) >/dev/null 2>&1 || { root=; [ "$$(id -u)" = 0 ] || root="sudo -n"; \
	  echo "installing Debian packages:" $(PEERS); { $$root apt-get update -q && $$root env DEBIAN_FRONTEND=noninteractive \
	  apt-get install -y -q --no-install-recommends $(PEERS); } >/dev/null 2>&1 || echo "without $(PEERS)"; }
	@for peer in $$($(BIN)/python -c 'import tomllib; \
	  print(*tomllib.load(open("pyproject.toml", "rb"))["project"]["optional-dependencies"]["bench"])'); do \
	  $(BIN)/python -m pip install -q --disable-pip-version-check $$peer || echo "without $$peer"; done
	@touch $@

# Tracking codes whose elements amrpic.hosts has, as far as they can be had here; tests skip the others by name.
.venv/.hosts: pyproject.toml .venv/.packages
	@for host in $$($(BIN)/python -c 'import tomllib; \
	  print(*tomllib.load(open("pyproject.toml", "rb"))["project"]["optional-dependencies"]["hosts"])'); do \
	  $(BIN)/python -m pip install -q --disable-pip-version-check $$host || echo "without $$host"; done
	@touch $@

# A module with sanitizers and without the pool of memory, beside the ordinary one; sitecustomize.py lets Python find it first.
SANITIZE := build/sanitize
SANITIZERS := -fsanitize=address,undefined -fno-sanitize=vptr -fno-omit-frame-pointer -O1 -g1 -DAMRPIC_NO_POOL
SANITIZED = env PYTHONPATH=$(CURDIR)/$(SANITIZE)/python \
  LD_PRELOAD="$$(gcc -print-file-name=libasan.so) $$(gcc -print-file-name=libstdc++.so)" \
  ASAN_OPTIONS=detect_leaks=0:detect_stack_use_after_return=0:quarantine_size_mb=64:allocator_may_return_null=1:handle_abort=1 \
  UBSAN_OPTIONS=print_stacktrace=1:halt_on_error=1
# The history of residuals is that of the ordinary build, which fuses products and sums; and there is no pool to be tested.
ONE_RANK := not 2r and not 3r and not 4r and not static_64_takes_six_cycles and not used_again and not idle_memory
NATIVE_TESTS := $(foreach name,solver_oracle poisson matrixfree composite deposit particles clouds free_space compensation fourth_order fem_operators cut_rows executions gaps surfaces_across_levels,$(wildcard tests/*/test_$(name).py))

sanitize: setup  ## tests of the native side under sanitizers, with bounds of boxes checked
	@mkdir -p $(SANITIZE)/python
	@[ -f $(SANITIZE)/build.ninja ] || cmake -G Ninja -S . -B $(SANITIZE) -DCMAKE_BUILD_TYPE=None -DAMRPIC_SETS=native \
	  -DPython_EXECUTABLE=$(CURDIR)/$(BIN)/python -DCMAKE_CXX_FLAGS="$(SANITIZERS)" >/dev/null
	@nice ninja -C $(SANITIZE) -j $(JOBS) --quiet | { grep -v '^ninja: no work' || true; }
	@rm -rf $(SANITIZE)/python/amrpic && cp -r amrpic $(SANITIZE)/python/ && cp $(SANITIZE)/_native_native.*.so $(SANITIZE)/_processor.*.so $(SANITIZE)/python/amrpic/
	@cp tests/support/sanitized/sitecustomize.py $(SANITIZE)/python/
	@$(SANITIZED) $(BIN)/python -c 'import amrpic._native as n; assert "$(SANITIZE)" in n.__file__, n.__file__'
	@failed=0; \
	$(SANITIZED) $(BIN)/python -m pytest -p no:cacheprovider -k "$(ONE_RANK)" $(NATIVE_TESTS) $(ARGS) || failed=1; \
	$(SANITIZED) $(BIN)/python tests/support/fuzz.py --cases 60 --seed 1 --only-crashes || failed=1; \
	exit $$failed

solvers: setup  ## measure the solver's menu on 1 and 2 ranks; PUBLISH=1: into docs/reports
	$(BIN)/python benchmarks solvers --output $(REPORTS)/solvers.md $(ARGS)

lint: build/_native.pyi  ## ruff, mypy, clang-format and the two dependency graphs
	$(BIN)/ruff check
	$(BIN)/ruff format --check
	$(BIN)/mypy
	$(BIN)/clang-format --dry-run -Werror $(wildcard native/*/*.cpp native/*/*.hpp)
	cmp build/_native.pyi amrpic/_native.pyi || { echo 'the stub is old: make stub'; exit 1; }
	$(BIN)/amrpic schema --markdown | cmp - docs/scene.md || { echo 'the reference of scenes is old: make docs'; exit 1; }
	$(BIN)/amrpic schema --method mpm --markdown | cmp - docs/mpm_scene.md || { echo 'that of material points is old: make docs'; exit 1; }
	$(BIN)/python -m pytest -q tests/test_architecture.py

format: .venv/.packages  ## let ruff and clang-format rewrite the sources
	$(BIN)/ruff check --fix-only --quiet
	$(BIN)/ruff format
	$(BIN)/clang-format -i $(wildcard native/*/*.cpp native/*/*.hpp)

clean:  ## remove .venv, build and caches; runs stay
	rm -rf .venv build .mypy_cache .pytest_cache .ruff_cache
