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
EXTRAS ?= dev,video,sweep,results,report,likeness,docs
# Which build of torch is tried first; `make install TORCH_BUILD=` takes the index's own (GPU) build.
TORCH_BUILD ?= cpu

PACKAGES := configs envs losses pipeline
CODE := $(wildcard bcsac.py $(PACKAGES) tests benchmarks docs)
VENV_PYTHON := $(VENV)/bin/python
RUN_PYTHON = $(VENV_PYTHON) -u
# One stamp for each set of extras, so that asking for another set installs it.
comma := ,
STAMP := $(VENV)/.installed-$(subst $(comma),-,$(EXTRAS))
PIP := $(VENV_PYTHON) -m pip --disable-pip-version-check
# Tests start make, which shall not be given what this one was.
APART := env -u MAKEFLAGS -u MFLAGS -u MAKELEVEL -u ARGS
LOWEST := .venv-lowest
AUDIT := .venv-audit
LOWEST_PIP = $(LOWEST)/bin/python -m pip --disable-pip-version-check install -qq
TORCH_VERSION := $(shell sed -n 's/^torch==//p' constraints.txt)

# glibc gives freed memory back to the kernel and pages it in again at the next update, for networks
# 1024 wide up to 5,000 times: 6 % of an update (docs/performance.md). Other C libraries ignore these.
export MALLOC_MMAP_THRESHOLD_ ?= 33554432
export MALLOC_TRIM_THRESHOLD_ ?= 8589934592
# Of the command bcsac (bcsac.py): what make starts names targets of make.
unexport BCSAC_STARTED_AS

# ---- what a command was given -----------------------------------------------------------------
# $(call quoted,NAME): the value of NAME as one word of the shell, whatever it holds: of $, quotes
# and spaces too. $(call path,key,NAME): key='value', whose quotes pipeline/literals.py takes off.
quoted = '$(subst ','\'',$(value $(1)))'
path = $(if $(value $(2)),$(1)=\'$(call quoted,$(2))\')
TRAIN_ARGS = $(if $(VARIANT),variant=$(VARIANT)) $(if $(PRESET),preset=$(PRESET)) \
	$(call path,task.name,TASK) $(call path,demos.source,DEMOS) $(call path,run_dir,RUN) \
	$(call path,resume,RESUME) $(ARGS)
OUT_ARGS = $(if $(value OUT),--out $(call quoted,OUT))
TASK_ARGS = $(if $(value TASK),--task $(call quoted,TASK))
EPISODE_ARGS = $(if $(EPISODES),--episodes $(EPISODES))
# Doors were what one could begin at; STARTS is of every task.
CHOSEN = $(if $(STARTS),$(STARTS),$(DOORS))
CHOICE_ARGS = $(EPISODE_ARGS) $(if $(CHOSEN),--starts "$(CHOSEN)") $(if $(WORST),--worst $(WORST))
VIEW_ARGS = $(if $(value WITH),--with $(call quoted,WITH)) $(if $(value CAMERA),--camera $(call quoted,CAMERA))
VARIANTS ?= $(sort $(basename $(notdir $(wildcard configs/variant/*.yaml))))
SMOKE_EPISODES ?= 4
JOBS ?= 2
SEED ?= 0
KILLS ?= 200
FILES ?= 1000

# $(call require,targets,NAME,example): stop before anything is installed when NAME is missing.
require = $(foreach goal,$(filter $(1),$(MAKECMDGOALS)),$(if $(value $(2)),,$(error \
	make $(goal) needs $(2)=..., for example: make $(goal) $(2)=$(3))))
$(call require,eval robust video play plot,RUN,runs/my_run)
$(if $(value RUN)$(value POLICY),,$(call require,record,RUN,runs/my_run or TASK=... POLICY=path.py:function))
$(call require,table report strip,RUNS,"runs/one runs/two")

# ---- the rows of the tables: one run for each row and seed ------------------------------------
ROWS ?= sac bc bc_sac_0.1 bc_sac_1 bc_sac_10 dbc_sac sid_bc sid_dbc ila_bc ila_dbc da_sac
SEEDS ?= 0 1 2 3 4
# Each task and reward has a folder of its own, the door's own reward the one that it always had.
# A target's name can hold neither spaces nor colons, whatever the task is called.
ROW_TASK := $(if $(value TASK),$(shell printf %s $(call quoted,TASK) | LC_ALL=C tr -c 'A-Za-z0-9._-' _),door)
ROW_REWARD := $(if $(value REWARD),$(REWARD),dense)
ifndef ROW_RUNS
ROW_RUNS := $(if $(filter-out door_dense,$(ROW_TASK)_$(ROW_REWARD)),runs/tasks/$(ROW_TASK)_$(ROW_REWARD),runs/rows)
endif
$(if $(filter rows,$(MAKECMDGOALS)),$(if $(filter-out dense sparse,$(ROW_REWARD)),$(error \
	make rows takes REWARD=dense or REWARD=sparse, got $(ROW_REWARD))))
ROW_PRESET ?= $(if $(PRESET),$(PRESET),table)
# Seed by seed, so that an interrupted set has the same seeds in every row.
ROW_EVALUATIONS = $(foreach seed,$(SEEDS),$(foreach row,$(ROWS),$(ROW_RUNS)/$(row)/seed$(seed)/evaluation.json))

##@ Use

.PHONY: help
help: ## print this list
	@awk 'function wrapped(text, apart, mark,   n, i, part, line) { \
	    n = split(text, part, apart); line = part[1]; \
	    for (i = 2; i <= n; i++) { \
	      if (length(line mark part[i]) > 99) { print line; line = sprintf("%16s%s%s", "", mark, part[i]) } \
	      else line = line " " mark part[i] } \
	    print line } \
	  BEGIN { FS = ":.*## " } \
	  /^##@/ { printf "\n%s\n", substr($$0, 5) } \
	  /^[a-z][a-z-]*:.*## / { at = index($$2, " ["); \
	    wrapped(sprintf("  %-13s %s", $$1, at ? substr($$2, 1, at - 1) : $$2), "[ ]", ""); \
	    if (at) wrapped(sprintf("%16s%s", "", substr($$2, at + 1)), " [[]", "[") } \
	  END { print "\nTASK is door, hammer, pen, relocate, gymnasium:ID, gymnasium:MODULE:ID, dm_control:DOMAIN/TASK,"; \
	    print "path/to/file.py[:NAME] (a Task, a gymnasium.Env class or a function that makes one), or an entry"; \
	    print "point of bcsac.tasks." }' $(firstword $(MAKEFILE_LIST))

.PHONY: install
install: $(STAMP) ## create or update .venv [EXTRAS=dev,video,sweep,wandb,mlflow] [TORCH_BUILD=cpu]

.PHONY: train
train: $(STAMP) ## train a policy [TASK=door|hammer|pen|relocate|gymnasium:ID|dm_control:DOMAIN/TASK|file.py[:NAME]] [VARIANT=...] [PRESET=smoke|default|table|paper|control] [DEMOS=...] [RUN=dir] [RESUME=dir] [ARGS="..."]
	@$(RUN_PYTHON) -m pipeline.train $(TRAIN_ARGS)

.PHONY: eval
eval: $(STAMP) ## evaluate RUN=dir over its task's fixed episodes [EPISODES=1000] [TASK=...] [DEMOS=path: how alike to these it moves] [STRATEGIES=0: not how it goes about it] [OUT=file] [ARGS="..."]
	@$(RUN_PYTHON) -m pipeline.cli eval $(call quoted,RUN) $(TASK_ARGS) $(EPISODE_ARGS) $(if $(value DEMOS),--demos $(call quoted,DEMOS)) $(if $(STRATEGIES),--$(if $(filter 0,$(STRATEGIES)),no-)strategies) $(OUT_ARGS) $(ARGS)

.PHONY: robust
robust: $(STAMP) ## play RUN=dir under noise, delays, other models and starts, and say what breaks it [EPISODES=200] [BAR=0.9] [ONLY=delay,mass] [TASK=...] [OUT=dir]
	@$(RUN_PYTHON) -m pipeline.cli robust $(call quoted,RUN) $(TASK_ARGS) $(EPISODE_ARGS) $(if $(BAR),--bar $(BAR)) $(if $(ONLY),--only $(call quoted,ONLY)) $(OUT_ARGS) $(ARGS)

.PHONY: settings
settings: $(STAMP) ## every key of a run and what it means, or those about FIND="multiply speed"
	@$(RUN_PYTHON) -m pipeline.cli settings $(FIND)

.PHONY: table
table: $(STAMP) ## RUNS="dir dir ..." beside the paper's Tables I and II [OUT=file]
	@$(RUN_PYTHON) -m pipeline.cli table $(RUNS) $(OUT_ARGS) $(ARGS)

.PHONY: rows
rows: ## train and evaluate rows of the tables, or go on with them; -j2 runs two at a time [TASK=door] [REWARD=dense|sparse] [ROWS="..."] [SEEDS="0 1"] [DEMOS=...] [PRESET=table] [EPISODES=1000] [ROW_RUNS=runs/rows|runs/tasks/TASK_REWARD]
	@$(MAKE) --no-print-directory --keep-going $(ROW_EVALUATIONS) || { \
	  for file in $(ROW_EVALUATIONS); do test -s "$$file" || echo "make rows: no $$file" >&2; done; exit 1; }

# A row is a variant; bc_sac_X is bc_sac with lambda = X. One thread a run: runs share the cores.
# What runs somebody's code is named again when a run goes on, and when it is evaluated.
$(ROW_RUNS)/%/evaluation.json: | $(STAMP)
	@set -e; run="$(@D)"; row="$(patsubst %/,%,$(dir $*))"; seed="$(patsubst seed%,%,$(notdir $*))"; \
	demos=$(call quoted,DEMOS); task=$(call quoted,TASK); reward=$(if $(filter sparse,$(ROW_REWARD)),env.reward=sparse); \
	threads="torch_threads=1 env.num_threads=1 logging.progress=false"; \
	case "$$row" in \
	  bc_sac_*) what="variant=bc_sac loss.bc_weight.init=$${row#bc_sac_}";; *) what="variant=$$row";; esac; \
	if test -f "$$run/config.yaml"; then what="resume=$$run"; demos=; reward=; \
	else rm -rf "$$run"; what="$$what preset=$(ROW_PRESET) seed=$$seed run_dir=$$run $(ARGS)"; fi; \
	OMP_NUM_THREADS=1 $(RUN_PYTHON) -m pipeline.train $$what $$reward $${task:+"task.name='$$task'"} $${demos:+"demos.source='$$demos'"} $$threads; \
	OMP_NUM_THREADS=1 $(RUN_PYTHON) -m pipeline.cli eval "$$run" $(TASK_ARGS) $(EPISODE_ARGS) env.num_threads=1

.PHONY: results
results: $(STAMP) ## publish evaluated runs to docs/results: the door's tables from ROW_RUNS=runs/rows, of other tasks and rewards a table over tasks [RUNS="runs/tasks ..."] [OUT=dir] [ARGS="..."]
	@$(RUN_PYTHON) -m pipeline.cli results $(if $(value RUNS),$(RUNS),$(call quoted,ROW_RUNS)) $(OUT_ARGS) $(ARGS)

.PHONY: report
report: $(STAMP) ## one page about RUNS="dir dir ..." (also folders of them, docs/results): intervals, curves, maps, failures, provenance [ONLY=strategies,robustness] [OUT=runs/report]
	@$(RUN_PYTHON) -m pipeline.cli report $(RUNS) $(if $(ONLY),--only $(call quoted,ONLY)) $(OUT_ARGS) $(ARGS)

.PHONY: plot
plot: $(STAMP) ## diagnostics of RUN=dir over frames [OUT=file]
	@$(RUN_PYTHON) -m pipeline.cli plot $(call quoted,RUN) $(OUT_ARGS)

.PHONY: demos-check
demos-check: $(STAMP) ## validate and replay demonstrations [DEMOS=bundled|path|minari:ID] [TASK=...] [ARGS="task.success=... env.horizon=N"]
	@$(RUN_PYTHON) -m pipeline.cli demos-check $(if $(value DEMOS),$(call quoted,DEMOS)) $(TASK_ARGS) $(ARGS)

.PHONY: record
record: $(STAMP) ## write successful episodes as demonstrations: of RUN=dir, or of TASK=... POLICY=path.py:function [TASK=...] [EPISODES=25] [OUT=x.h5|x.hdf5|minari:ID]
	@$(RUN_PYTHON) -m pipeline.cli record $(call quoted,RUN) $(TASK_ARGS) $(if $(value POLICY),--policy $(call quoted,POLICY)) $(EPISODE_ARGS) $(OUT_ARGS) $(ARGS)

.PHONY: video
video: $(STAMP) ## film RUN=dir at its task [EPISODES=n | STARTS=3,17 | WORST=n] [WITH=dir|demos|source: beside it] [CAMERA=name] [TASK=...] [OUT=x.mp4|x.gif]
	@$(RUN_PYTHON) -m pipeline.cli video $(call quoted,RUN) $(TASK_ARGS) $(CHOICE_ARGS) $(VIEW_ARGS) $(OUT_ARGS) $(ARGS)

.PHONY: play
play: $(STAMP) ## watch RUN=dir in a window, where there is a display [EPISODES=n | STARTS=3,17 | WORST=n] [TASK=...]
	@$(RUN_PYTHON) -m pipeline.cli play $(call quoted,RUN) $(TASK_ARGS) $(CHOICE_ARGS) $(ARGS)

.PHONY: strip
strip: $(STAMP) ## one picture with a row of moments for each of RUNS="dir dir ..." [WITH=demos|source: the first row] [CAMERA=name] [OUT=x.png] [ARGS="--episode 3 --until 120"]
	@$(RUN_PYTHON) -m pipeline.cli strip $(RUNS) $(TASK_ARGS) $(VIEW_ARGS) $(OUT_ARGS) $(ARGS)

##@ Develop

.PHONY: bench
bench: ## measure speed and memory against other packages [SECTION="update loop"] [QUICK=1] [OUT=dir] [ARGS="..."]
	@$(MAKE) --no-print-directory install EXTRAS="$(if $(EXTRAS),$(EXTRAS)$(comma))bench" ARGS=
	@$(RUN_PYTHON) -m benchmarks $(addprefix --section ,$(SECTION)) $(if $(QUICK),--quick) $(OUT_ARGS) $(ARGS)

.PHONY: test
test: $(STAMP) ## run the tests [ARGS="-k name" or "-m slow" or a path]
	@$(APART) OMP_NUM_THREADS=1 MKL_NUM_THREADS=1 $(VENV_PYTHON) -m pytest -q -n auto --maxprocesses 4 --dist worksteal $(ARGS)

.PHONY: torture
torture: $(STAMP) ## damage the files of a run and of others, kill runs, and count what comes of it [SEED=0] [KILLS=200] [FILES=1000]
	@OMP_NUM_THREADS=1 $(VENV_PYTHON) -m tests.faults.torture --seed $(SEED) $(ARGS)
	@OMP_NUM_THREADS=1 $(VENV_PYTHON) -m tests.faults.mutants --seed $(SEED) --files $(FILES)
	@OMP_NUM_THREADS=1 $(VENV_PYTHON) -m tests.faults.kills --seed $(SEED) --kills $(KILLS)

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

# The older releases stand in front of the pins of everything else, and torch is the same build.
.PHONY: check-lowest
check-lowest: ## tests of envs and losses and a smoke training with the oldest releases of constraints-lowest.txt, in .venv-lowest
	@$(MAKE) --no-print-directory $(LOWEST)/bin/python VENV=$(LOWEST)
	@awk -F== 'NR == FNR { low[$$1]; print; next } !($$1 in low)' constraints-lowest.txt constraints.txt > $(LOWEST)/constraints.txt
	@{ test -n "$(TORCH_BUILD)" && $(LOWEST_PIP) -c $(LOWEST)/constraints.txt "torch==$(TORCH_VERSION)+$(TORCH_BUILD)" 2>/dev/null; } \
	  || $(LOWEST_PIP) -c $(LOWEST)/constraints.txt "torch==$(TORCH_VERSION)"
	@$(LOWEST_PIP) -c $(LOWEST)/constraints.txt -e . pytest hypothesis packaging
	@$(LOWEST)/bin/python -m pip check
	@OMP_NUM_THREADS=1 $(LOWEST)/bin/python -m pytest -q tests/envs tests/losses $(ARGS)
	@$(LOWEST)/bin/bcsac eval --help > /dev/null
	@set -e; run=$$(mktemp -d); trap 'rm -rf "$$run"' EXIT; \
	OMP_NUM_THREADS=1 $(LOWEST)/bin/python -m bcsac train variant=dbc_sac preset=smoke run_dir="$$run/smoke"; \
	OMP_NUM_THREADS=1 $(LOWEST)/bin/python -m bcsac eval "$$run/smoke" --episodes $(SMOKE_EPISODES)

# In an environment of its own: what audits is no part of what is audited. It calls a package of
# which it was told nothing skipped, and everything skipped no known vulnerabilities.
.PHONY: audit
audit: $(AUDIT)/bin/pip-audit ## compare the pinned versions of constraints.txt with known vulnerabilities [ARGS="--ignore-vuln ID"]
	@told=$$(mktemp); trap 'rm -f "$$told"' EXIT; \
	$(AUDIT)/bin/pip-audit --no-deps --disable-pip --progress-spinner off -r constraints.txt $(ARGS) > "$$told" 2>&1; failed=$$?; \
	all=$$(grep -c == constraints.txt); missed=$$(grep -c 'could not be audited' "$$told"); \
	test "$$missed" -ge "$$all" || cat "$$told"; \
	test "$$missed" -eq 0 || { echo "make audit: $$missed of $$all packages were not compared: the package index here tells nothing of their vulnerabilities. Audit where it does." >&2; exit 2; }; \
	exit $$failed

$(AUDIT)/bin/pip-audit:
	@$(PYTHON) -m venv $(AUDIT)
	@$(AUDIT)/bin/python -m pip --disable-pip-version-check install -qq 'pip-audit>=2.7'

.PHONY: smoke
smoke: $(STAMP) ## train and evaluate every variant for a few seconds [VARIANTS="sac bc"] [TASK=...] [DEMOS=...] [JOBS=2] [ARGS="..."]
	@test -n "$(strip $(VARIANTS))" || { echo "make smoke: no configs/variant/*.yaml found" >&2; exit 2; }
	@OMP_NUM_THREADS=1 $(VENV_PYTHON) -m tests.smoke $(VARIANTS) --jobs $(JOBS) --episodes $(SMOKE_EPISODES) \
	  $(TASK_ARGS) -- $(call path,demos.source,DEMOS) $(ARGS)

.PHONY: docs
docs: $(STAMP) ## build the documentation site; a warning or a dead link is an error [OUT=site]
	@OMP_NUM_THREADS=1 $(VENV_PYTHON) -m docs.site $(if $(value OUT),$(call quoted,OUT))

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
	rm -rf build dist site *.egg-info .coverage* htmlcov .pytest_cache .mypy_cache .ruff_cache .import_linter_cache .hypothesis
	find $(CODE) -name __pycache__ -type d -exec rm -rf {} +

.PHONY: distclean
distclean: clean ## clean, and remove .venv and the project's cache too
	rm -rf $(VENV) $(LOWEST) $(AUDIT) .cache

# ---- the virtual environment ------------------------------------------------------------------
$(VENV_PYTHON):
	@command -v $(PYTHON) >/dev/null || { echo "make: no $(PYTHON) found; name one: make PYTHON=..." >&2; exit 2; }
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || \
	  { echo "make: Python >= 3.11 is needed, $$($(PYTHON) --version) was found; name another: make PYTHON=..." >&2; exit 2; }
	@echo "creating $(VENV) with $$($(PYTHON) --version)"
	@$(PYTHON) -m venv $(VENV) || { rm -rf $(VENV); \
	  echo "make: could not create $(VENV); on Debian: apt-get install python3-venv" >&2; exit 2; }

define of_this_checkout
import importlib.metadata as m, json, os, sys, urllib.parse as u, urllib.request as r
found = next((d for d in m.distributions(name="bc-sac") if d.read_text("direct_url.json")), None)
url = json.loads(found.read_text("direct_url.json"))["url"] if found else ""
there = r.url2pathname(u.urlparse(url).path)
if there and os.path.isdir(there) and not os.path.samefile(there, os.getcwd()):
    sys.exit("make: VENV=$(VENV) is of the checkout " + there + "; name another: make VENV=.venv")
endef
export of_this_checkout

# torch comes first and alone: a build that is there already is kept, else the one named by
# TORCH_BUILD is tried, and an index without it (pip says so; hence no output) has its usual one.
# An environment imports one checkout: installing another into it would change what its owner runs.
$(STAMP): pyproject.toml constraints.txt | $(VENV_PYTHON)
	@$(VENV_PYTHON) -c "$$of_this_checkout"
	@echo "installing into $(VENV): torch first, then everything else (2.7 GB; the first time takes minutes)"
	@$(VENV_PYTHON) -c 'import sys, importlib.metadata as m; \
	sys.exit(m.version("torch").split("+")[0] != "$(TORCH_VERSION)")' 2>/dev/null \
	|| { test -n "$(TORCH_BUILD)" && \
	     $(PIP) install -qq "torch==$(TORCH_VERSION)+$(TORCH_BUILD)" -c constraints.txt 2>/dev/null; } \
	|| $(PIP) install -qq "torch==$(TORCH_VERSION)" -c constraints.txt
	@echo "torch $(TORCH_VERSION) is there; now everything else of $(EXTRAS)"
	@$(PIP) uninstall -qqy bc-sac-door  # the distribution's name before it was bc-sac
	@$(PIP) install -qq -c constraints.txt -e ".$(if $(EXTRAS),[$(EXTRAS)])"
	@$(PIP) check
	@touch $@
