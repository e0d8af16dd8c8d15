# Everything here creates what it needs: a virtual environment in .venv with the versions of constraints.txt.
PYTHON ?= python3
BIN := .venv/bin
RUN := runs/demo
DATA := datasets/demo-pointmaze-large.hdf5

.PHONY: demo test browser mutants drill lint

.venv/installed: pyproject.toml constraints.txt
	$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11) and "guider needs Python 3.11 or newer; try: make PYTHON=python3.11 ...")'
	$(PYTHON) -m venv .venv
	$(BIN)/python -m pip install --quiet --constraint constraints.txt --editable ".[dev]"
	touch $@

demo: .venv/installed  ## Record data, train, evaluate and draw: a few minutes on two cores.
	rm -rf $(RUN) $(DATA)
	$(BIN)/guider collect pointmaze-large --out $(DATA)
	$(BIN)/guider train pointmaze-large --method guider-routes --data $(DATA) --out $(RUN) --set low.updates=6000
	$(BIN)/guider evaluate $(RUN)
	$(BIN)/guider plot $(RUN)

test: .venv/installed
	$(BIN)/python -m pytest --numprocesses auto --dist loadfile --no-loadscope-reorder

browser: .venv/installed  ## A headless Chromium in .venv/browser, by npm (x86): with it, `make test` tries the pages, too.
	$(BIN)/python -m pip install --quiet --constraint constraints.txt "playwright>=1.50,<2"
	npm install --silent --no-audit --no-fund --prefix .venv/browser @sparticuz/chromium@153.0.0
	cd .venv/browser && TMPDIR=$$PWD node --input-type=module -e 'import found from "@sparticuz/chromium"; await found.executablePath()'

mutants: .venv/installed  ## Break the package in some 480 places, one at a time, and see that a test fails each time.
	$(BIN)/python -m mutants

drill: .venv/installed  ## Kill, damage, mutate, trap: under an hour on two cores; writes docs/reliability.md.
	$(BIN)/python -m drills

lint: .venv/installed
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .
	$(BIN)/pyright
