# Everything a person or a machine does with this repository. `make` prints the targets.
# Needs GNU make, a POSIX shell and Python >= 3.11; everything else goes into $(VENV).

.DEFAULT_GOAL := help
.DELETE_ON_ERROR:
.SUFFIXES:
SHELL := /bin/sh

# ---- where things are ------------------------------------------------------------------------
VENV ?= .venv
PYTHON ?= python3
# Optional dependencies of pyproject.toml to install: e.g. make train EXTRAS=dev,video,sweep,wandb
EXTRAS ?= dev,video,sweep,results
# Which build of torch is tried first; `make install TORCH_BUILD=` takes the index's own (GPU) build.
TORCH_BUILD ?= cpu

PACKAGES := configs envs losses pipeline
CODE := $(wildcard $(PACKAGES) tests benchmarks)
VENV_PYTHON := $(VENV)/bin/python
RUN_PYTHON = $(VENV_PYTHON) -u
# One stamp for each set of extras, so that asking for another set installs it.
comma := ,
STAMP := $(VENV)/.installed-$(subst $(comma),-,$(EXTRAS))
PIP := $(VENV_PYTHON) -m pip --disable-pip-version-check
TORCH_VERSION := $(shell sed -n 's/^torch==//p' constraints.txt)

# glibc gives freed memory back to the kernel and pages it in again at the next update, for networks
# 1024 wide up to 5,000 times: 6 % of an update (docs/performance.md). Other C libraries ignore these.
export MALLOC_MMAP_THRESHOLD_ ?= 33554432
export MALLOC_TRIM_THRESHOLD_ ?= 8589934592

# ---- what a command was given -----------------------------------------------------------------
# Paths go to Hydra in single quotes, because a bare = or , in one would be read as grammar.
TRAIN_ARGS = $(if $(VARIANT),variant=$(VARIANT)) $(if $(PRESET),preset=$(PRESET)) \
	$(if $(DEMOS),"demos.source='$(DEMOS)'") $(if $(RUN),"run_dir='$(RUN)'") \
	$(if $(RESUME),"resume='$(RESUME)'") $(ARGS)
OUT_ARGS = $(if $(OUT),--out "$(OUT)")
EPISODE_ARGS = $(if $(EPISODES),--episodes $(EPISODES))
VARIANTS ?= $(sort $(basename $(notdir $(wildcard configs/variant/*.yaml))))
SMOKE_EPISODES ?= 4

# $(call require,targets,NAME,example): stop before anything is installed when NAME is missing.
require = $(foreach goal,$(filter $(1),$(MAKECMDGOALS)),$(if $($(2)),,$(error \
	make $(goal) needs $(2)=..., for example: make $(goal) $(2)=$(3))))
$(call require,eval record video plot,RUN,runs/my_run)
$(call require,table,RUNS,"runs/one runs/two")

# ---- the rows of the tables: one run for each row and seed ------------------------------------
ROWS ?= sac bc bc_sac_0.1 bc_sac_1 bc_sac_10 dbc_sac sid_bc sid_dbc ila_bc ila_dbc da_sac
SEEDS ?= 0 1 2 3 4
ROW_RUNS ?= runs/rows
ROW_PRESET ?= $(if $(PRESET),$(PRESET),table)
# Seed by seed, so that an interrupted set has the same seeds in every row.
ROW_EVALUATIONS = $(foreach seed,$(SEEDS),$(foreach row,$(ROWS),$(ROW_RUNS)/$(row)/seed$(seed)/evaluation.json))

##@ Use

.PHONY: help
help: ## print this list
	@awk 'BEGIN { FS = ":.*## " } \
	  /^##@/ { printf "\n%s\n", substr($$0, 5) } \
	  /^[a-z][a-z-]*:.*## / { printf "  %-13s %s\n", $$1, $$2 }' $(firstword $(MAKEFILE_LIST))

.PHONY: install
install: $(STAMP) ## create or update .venv [EXTRAS=dev,video,sweep,wandb,mlflow] [TORCH_BUILD=cpu]

.PHONY: train
train: $(STAMP) ## train a policy [VARIANT=...] [PRESET=smoke|default|paper] [DEMOS=...] [RUN=dir] [RESUME=dir] [ARGS="..."]
	@$(RUN_PYTHON) -m pipeline.train $(TRAIN_ARGS)

.PHONY: eval
eval: $(STAMP) ## evaluate RUN=dir over fixed doors [EPISODES=1000] [OUT=file] [ARGS="..."]
	@$(RUN_PYTHON) -m pipeline.cli eval "$(RUN)" $(EPISODE_ARGS) $(OUT_ARGS) $(ARGS)

.PHONY: table
table: $(STAMP) ## RUNS="dir dir ..." beside the paper's Tables I and II [OUT=file]
	@$(RUN_PYTHON) -m pipeline.cli table $(RUNS) $(OUT_ARGS) $(ARGS)

.PHONY: rows
rows: $(ROW_EVALUATIONS) ## train and evaluate the tables' rows, or go on with them; -j2 runs two at a time [ROWS="..."] [SEEDS="0 1"] [DEMOS=...]

# A row is a variant; bc_sac_X is bc_sac with lambda = X. One thread a run: runs share the cores.
$(ROW_RUNS)/%/evaluation.json: | $(STAMP)
	@set -e; run="$(@D)"; row="$(patsubst %/,%,$(dir $*))"; seed="$(patsubst seed%,%,$(notdir $*))"; \
	threads="torch_threads=1 env.num_threads=1 logging.progress=false"; \
	case "$$row" in \
	  bc_sac_*) what="variant=bc_sac loss.bc_weight.init=$${row#bc_sac_}";; *) what="variant=$$row";; esac; \
	if ls "$$run"/checkpoints/checkpoint-* >/dev/null 2>&1; then what="resume=$$run"; \
	else rm -rf "$$run"; what="$$what preset=$(ROW_PRESET) seed=$$seed run_dir=$$run $(if $(DEMOS),demos.source='$(DEMOS)') $(ARGS)"; fi; \
	OMP_NUM_THREADS=1 $(RUN_PYTHON) -m pipeline.train $$what $$threads; \
	OMP_NUM_THREADS=1 $(RUN_PYTHON) -m pipeline.cli eval "$$run" env.num_threads=1

.PHONY: results
results: $(STAMP) ## publish the evaluated runs below ROW_RUNS=runs/rows to docs/results [OUT=dir]
	@$(RUN_PYTHON) -m pipeline.cli results "$(ROW_RUNS)" $(OUT_ARGS) $(ARGS)

.PHONY: plot
plot: $(STAMP) ## diagnostics of RUN=dir over frames [OUT=file]
	@$(RUN_PYTHON) -m pipeline.cli plot "$(RUN)" $(OUT_ARGS)

.PHONY: demos-check
demos-check: $(STAMP) ## validate and re-simulate demonstrations, one line each [DEMOS=bundled|path|minari:ID]
	@$(RUN_PYTHON) -m pipeline.cli demos-check $(if $(DEMOS),"$(DEMOS)") $(ARGS)

.PHONY: record
record: $(STAMP) ## write successful episodes of RUN=dir as a demonstration file [EPISODES=n] [OUT=file]
	@$(RUN_PYTHON) -m pipeline.cli record "$(RUN)" $(EPISODE_ARGS) $(OUT_ARGS) $(ARGS)

.PHONY: video
video: $(STAMP) ## film RUN=dir opening doors [EPISODES=n] [OUT=file]
	@$(RUN_PYTHON) -m pipeline.cli video "$(RUN)" $(EPISODE_ARGS) $(OUT_ARGS) $(ARGS)

##@ Develop

.PHONY: bench
bench: ## measure speed and memory against other packages [SECTION="update loop"] [QUICK=1] [OUT=dir] [ARGS="..."]
	@$(MAKE) --no-print-directory install EXTRAS="$(if $(EXTRAS),$(EXTRAS)$(comma))bench" ARGS=
	@$(RUN_PYTHON) -m benchmarks $(addprefix --section ,$(SECTION)) $(if $(QUICK),--quick) $(OUT_ARGS) $(ARGS)

.PHONY: test
test: $(STAMP) ## run the tests [ARGS="-k name" or "-m slow" or a path]
	@OMP_NUM_THREADS=1 MKL_NUM_THREADS=1 $(VENV_PYTHON) -m pytest -q -n auto --maxprocesses 4 $(ARGS)

.PHONY: coverage
coverage: $(STAMP) ## run the tests and list the lines that they do not reach
	@OMP_NUM_THREADS=1 MKL_NUM_THREADS=1 $(VENV_PYTHON) -m pytest -q -n auto --maxprocesses 4 --cov $(ARGS)

.PHONY: check
check: format-check lint types arch spelling test ## all of the checks below, and the tests

.PHONY: format
format: $(STAMP) ## rewrite the code in the project's format
	@$(VENV_PYTHON) -m ruff check --quiet --fix --exit-zero $(CODE)
	@$(VENV_PYTHON) -m ruff format $(CODE)

.PHONY: format-check
format-check: $(STAMP) ## fail where `make format` would change something
	@$(VENV_PYTHON) -m ruff format --check --output-format concise $(CODE)

.PHONY: lint
lint: $(STAMP) ## ruff: errors, style, docstrings, complexity
	@$(VENV_PYTHON) -m ruff check $(CODE)

.PHONY: types
types: $(STAMP) ## mypy
	@$(VENV_PYTHON) -m mypy

.PHONY: arch
arch: $(STAMP) ## import-linter: which package may import which
	@$(VENV)/bin/lint-imports

.PHONY: spelling
spelling: $(STAMP) ## codespell
	@$(VENV_PYTHON) -m codespell_lib

.PHONY: smoke
smoke: $(STAMP) ## train and evaluate every variant for a few seconds [VARIANTS="sac bc"] [ARGS="..."]
	@test -n "$(strip $(VARIANTS))" || { echo "make smoke: no configs/variant/*.yaml found" >&2; exit 2; }
	@set -e; \
	runs=$$(mktemp -d); trap 'rm -rf "$$runs"' EXIT; trap 'exit 130' INT TERM; \
	for variant in $(VARIANTS); do \
	  began=$$(date +%s); echo "==== smoke: $$variant"; \
	  $(MAKE) --no-print-directory train VARIANT=$$variant PRESET=smoke RUN="$$runs/$$variant"; \
	  $(MAKE) --no-print-directory eval RUN="$$runs/$$variant" EPISODES=$(SMOKE_EPISODES) ARGS=; \
	  test -s "$$runs/$$variant/evaluation.json" || \
	    { echo "make smoke: $$variant wrote no evaluation.json" >&2; exit 1; }; \
	  echo "==== smoke: $$variant took $$(( $$(date +%s) - began )) s"; \
	done

.PHONY: hooks
hooks: $(STAMP) ## run the checks before each git commit (pre-commit)
	@$(VENV_PYTHON) -m pre_commit install --install-hooks

.PHONY: lock
lock: | $(VENV_PYTHON) ## write the versions that .venv holds now to constraints.txt
	@{ sed -n '/^#/p' constraints.txt; \
	  $(PIP) freeze --all --exclude-editable --exclude pip | sed 's/+[a-z0-9.]*$$//'; } > constraints.new
	@mv constraints.new constraints.txt

.PHONY: clean
clean: ## remove caches and build output; runs/ and .venv stay
	rm -rf build dist *.egg-info .coverage* htmlcov .pytest_cache .mypy_cache .ruff_cache .import_linter_cache .hypothesis
	find $(CODE) -name __pycache__ -type d -exec rm -rf {} +

.PHONY: distclean
distclean: clean ## clean, and remove .venv and the project's cache too
	rm -rf $(VENV) .cache

# ---- the virtual environment ------------------------------------------------------------------
$(VENV_PYTHON):
	@command -v $(PYTHON) >/dev/null || { echo "make: no $(PYTHON) found; name one: make PYTHON=..." >&2; exit 2; }
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || \
	  { echo "make: Python >= 3.11 is needed, $$($(PYTHON) --version) was found; name another: make PYTHON=..." >&2; exit 2; }
	@echo "creating $(VENV) with $$($(PYTHON) --version)"
	@$(PYTHON) -m venv $(VENV) || { rm -rf $(VENV); \
	  echo "make: could not create $(VENV); on Debian: apt-get install python3-venv" >&2; exit 2; }

# torch comes first and alone: a build that is there already is kept, else the one named by
# TORCH_BUILD is tried, and an index without it (pip says so; hence no output) has its usual one.
$(STAMP): pyproject.toml constraints.txt | $(VENV_PYTHON)
	@echo "installing into $(VENV) (the first time takes some minutes)"
	@$(VENV_PYTHON) -c 'import sys, importlib.metadata as m; \
	sys.exit(m.version("torch").split("+")[0] != "$(TORCH_VERSION)")' 2>/dev/null \
	|| { test -n "$(TORCH_BUILD)" && \
	     $(PIP) install -qq "torch==$(TORCH_VERSION)+$(TORCH_BUILD)" -c constraints.txt 2>/dev/null; } \
	|| $(PIP) install -qq "torch==$(TORCH_VERSION)" -c constraints.txt
	@$(PIP) install -qq -c constraints.txt -e ".$(if $(EXTRAS),[$(EXTRAS)])"
	@$(PIP) check
	@touch $@
